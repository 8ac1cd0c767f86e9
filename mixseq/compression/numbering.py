"""Choose the numbering of vertices and polygons in a compressed file that takes the fewest bytes.

Numbers take more bytes than connectivity, twenty times as many if random. So a compressed file may leave out the order
of polygons, or of vertices, too, and use that of `mixseq.compression.bitstream.connectivity`. It is a function of the
mesh, so it is not stored, and originals can be renumbered in the same way, with all attributes.

Triangles stay triangles with the same winding: a triangle may begin at another corner, a quad at the one opposite, and
larger polygons keep their first corner, so that all are cut into the same triangles. Hard edges only record which
corners share a normal, so normals are numbered in order of first use.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mixseq.choices import ORDERS, OrderName
from mixseq.compression.bitstream.connectivity import encode_polygons, walk_polygons
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons, match_polygons
from mixseq.mesh.surface import FaceSet, Surface, renumber_by_first_use
from mixseq.sequence.header import SequenceHeader, header_fields
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence
from mixseq.types import FloatArray, Index


@dataclass(frozen=True, eq=False)
class Renumbering:
    """A permutation of the vertices, polygons and corners of a mesh: old numbers in their new order."""

    vertices: Index  # (V,) old number of every vertex
    polygons: Index  # (P,) the old number of every polygon
    corners: Index  # (sum of counts,) the old place of every corner

    @property
    def order(self) -> OrderName:
        """Which numbers are kept: of vertices and polygons, of vertices only, or neither."""
        if not _is_sorted(self.vertices):
            return "free"
        return "keep" if _is_sorted(self.corners) else "vertices"

    @property
    def inverse(self) -> Renumbering:
        """The inverse numbering."""
        return Renumbering(*map(_inverse, (self.vertices, self.polygons, self.corners)))

    def renumber_polygons(self, polygons: Polygons) -> Polygons:
        """Return the polygons in their new order, on vertices with their new numbers."""
        new = _inverse(self.vertices)
        return Polygons(polygons.counts[self.polygons], new[polygons.indices[self.corners]])

    def renumber_header(self, header: SequenceHeader) -> SequenceHeader:
        """Return the same mesh with all its attributes, at the same times."""
        renumbered = {
            "polygons": self.renumber_polygons(header.polygons),
            "surface": self._of_surface(header.surface),
        }
        return SequenceHeader(**{**header_fields(header), **renumbered})

    def renumber_frames(self, frames: Frames) -> Frames:
        """Return the same frames of the same mesh: in memory if they are, else read on demand."""
        if not isinstance(frames, MeshSequence):
            header = self.renumber_header(frames.header)
            return LazyFrames(header, lambda size: map(self._of_points, frames.blocks(size)))
        velocities = None if frames.velocities is None else self._of_points(frames.velocities)
        return MeshSequence.from_header(
            self.renumber_header(frames.header), self._of_points(frames.points), velocities
        )

    def _of_points(self, points: FloatArray) -> FloatArray:
        """Return points ``(B, V, 3)``; the same array if vertices keep their numbers."""
        return points if _is_sorted(self.vertices) else points[:, self.vertices]

    def _of_surface(self, surface: Surface) -> Surface:
        new = _inverse(self.polygons)
        uvs, colours, hard_edges = surface.uvs, surface.colours, surface.hard_edges
        return replace(
            surface,
            uvs=uvs and uvs.select(self.corners),
            colours=colours and colours.select(self.corners),
            hard_edges=None if hard_edges is None else renumber_by_first_use(hard_edges[self.corners]),
            face_sets=tuple(
                FaceSet(each.name, new[each.polygons], each.material) for each in surface.face_sets
            ),
        )


def identity_numbering(polygons: Polygons, vertex_count: int) -> Renumbering:
    """Return the identity numbering of a mesh."""
    return Renumbering(*map(np.arange, (vertex_count, len(polygons.counts), polygons.indices.size)))


def walk_numbering(polygons: Polygons, sizes: Sequence[int], *, vertices: bool) -> Renumbering:
    """Return the numbering in which connectivity takes few bits."""
    order, entered = walk_polygons(polygons, sum(sizes))
    counts, starts = polygons.counts.astype(np.int64), np.cumsum(polygons.counts) - polygons.counts
    counts, starts = counts[order], starts[order]
    place = entered - starts
    begin = np.where(counts == 3, place, np.where(counts == 4, (place + place % 2) % 4, 0))
    numbers = np.arange(sum(sizes))
    if vertices:
        met, first = np.unique(polygons.indices[_corners(starts, counts, place)], return_index=True)
        when = np.full(len(numbers), polygons.indices.size)
        when[met] = first
        numbers = np.lexsort((when, np.repeat(np.arange(len(sizes)), sizes)))
    return Renumbering(numbers, order, _corners(starts, counts, begin))


def cheapest_numbering(header: SequenceHeader, order: OrderName) -> Renumbering:
    """Return the numbering in which polygons take the fewest bytes."""
    if order not in ORDERS:
        raise SettingsError(f"order is {order!r}; one of {', '.join(ORDERS)} is expected")
    polygons, sizes = header.polygons, object_vertex_counts(header)
    kept = identity_numbering(polygons, header.vertex_count)
    if order == "keep":
        return kept
    walks = [walk_numbering(polygons, sizes, vertices=each) for each in (False, True)[: ORDERS.index(order)]]
    return min(
        [kept, *walks],
        key=lambda each: len(encode_polygons(each.renumber_polygons(polygons), header.vertex_count)),
    )


def find_numbering(other: Polygons, polygons: Polygons, sizes: Sequence[int]) -> Renumbering | None:
    """Return the numbering of a mesh's vertices in a file of it, None if the file has another mesh."""
    if not np.array_equal(np.sort(polygons.counts), np.sort(other.counts)):
        return None
    if match_polygons(polygons, other) is not None:
        return identity_numbering(polygons, sum(sizes))
    found = walk_numbering(polygons, sizes, vertices=True)
    return None if match_polygons(found.renumber_polygons(polygons), other) is None else found


def object_vertex_counts(header: SequenceHeader) -> list[int]:
    """Return the number of vertices of every object joined in a sequence."""
    return [each.vertex_count for each in header.objects]


def _corners(starts: Index, sizes: Index, begin: Index) -> Index:
    """Return the corners of polygons, one polygon after the other, each from its corner number `begin` on."""
    first = np.cumsum(sizes) - sizes
    along = np.arange(int(sizes.sum())) - np.repeat(first - begin, sizes)
    return np.asarray(np.repeat(starts, sizes) + along % np.repeat(sizes, sizes), dtype=np.int64)


def _is_sorted(numbers: Index) -> bool:
    return bool((np.diff(numbers) > 0).all())


def _inverse(order: Index) -> Index:
    inverse = np.empty(len(order), dtype=np.int64)
    inverse[order] = np.arange(len(order))
    return inverse
