"""Choose the numbering of vertices and polygons that takes the fewest bytes in a compressed file.

The original numbering takes more bytes than the connectivity, and twenty times more if it is random. So a compressed
file may replace the order of polygons, or of both polygons and vertices, by the walk of
`mixseq.compression.bitstream.corners`. The walk is a function of the mesh, so it is not stored. An original with
all its attributes can be renumbered by the same walk.

Windings and triangulations are kept: a triangle may begin at any corner, a quad at its first or third corner, and
larger polygons keep their first corner. Hard edges only record which corners share a normal, so normals are numbered in
order of first use.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from typing import overload

import numpy as np

from mixseq.choices import ORDERS, OrderName
from mixseq.compression.bitstream.connectivity import encode_polygons
from mixseq.compression.bitstream.corners import walk_polygons
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.polygons import Polygons, canonical_order, match_polygons, match_triangles
from mixseq.mesh.surface import FaceSet, Surface, renumber_by_first_use
from mixseq.sequence.header import SequenceHeader, header_fields
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence
from mixseq.types import FloatArray, Index, IntArray

Mesh = tuple[Polygons, Sequence[int]]
"""Polygons of a mesh, and the number of vertices of every object that is joined in it."""


@dataclass(frozen=True, eq=False)
class Renumbering:
    """A permutation of the vertices, polygons and corners of a mesh, stored as old numbers in new order."""

    vertices: Index  # (V,) old number of every vertex
    polygons: Index  # (P,) old number of every polygon
    corners: Index  # (sum of counts,) old number of every corner

    @property
    def order(self) -> OrderName:
        """Name of the kept numbering: of vertices and polygons, of vertices only, or of neither."""
        if not _is_sorted(self.vertices):
            return "free"
        return "keep" if _is_sorted(self.corners) else "vertices"

    @property
    def reorders_faces(self) -> bool:
        """Whether polygons have other numbers."""
        return not _is_sorted(self.polygons)

    @property
    def inverse(self) -> Renumbering:
        """The inverse permutation."""
        return Renumbering(*map(np.argsort, (self.vertices, self.polygons, self.corners)))

    def renumber_polygons(self, polygons: Polygons) -> Polygons:
        """Return the polygons in their new order, on renumbered vertices."""
        new_ids = np.argsort(self.vertices)
        return Polygons(polygons.counts[self.polygons], new_ids[polygons.indices[self.corners]])

    def renumber_labels(self, labels: IntArray, polygons: Polygons) -> IntArray:
        """Return labels ``(F,)`` of the triangles of polygons in the order of the renumbered polygons."""
        if labels.shape != (len(polygons.triangles),) or self.order == "keep":
            return labels  # another shape is refused where labels are used
        if len(self.polygons) != len(polygons.counts):
            polygons = Polygons.from_triangles(polygons.triangles)
        old = Polygons(polygons.counts, np.argsort(self.vertices)[polygons.indices])
        return labels[match_triangles(self.renumber_polygons(polygons), old, ("", ""))]

    def renumber_header(self, header: SequenceHeader) -> SequenceHeader:
        """Return the header with its mesh and all attributes renumbered."""
        polygons = self.renumber_polygons(header.polygons)
        surface = self._renumber_surface(header.surface)
        return SequenceHeader(**{**header_fields(header), "polygons": polygons, "surface": surface})

    @overload
    def renumber_frames(self, frames: MeshSequence) -> MeshSequence: ...

    @overload
    def renumber_frames(self, frames: Frames) -> Frames: ...

    def renumber_frames(self, frames: Frames) -> Frames:
        """Return the frames with renumbered vertices: in memory if `frames` are, otherwise read on demand."""
        header = self.renumber_header(frames.header)
        if not isinstance(frames, MeshSequence):
            return LazyFrames(header, lambda size: map(self._renumber_points, frames.blocks(size)))
        velocities = None if frames.velocities is None else self._renumber_points(frames.velocities)
        return MeshSequence.from_header(header, self._renumber_points(frames.points), velocities)

    def _renumber_points(self, points: FloatArray) -> FloatArray:
        """Return points ``(B, V, 3)``; the same array if vertices keep their numbers."""
        return points if _is_sorted(self.vertices) else points[:, self.vertices]

    def _renumber_surface(self, surface: Surface) -> Surface:
        new_ids = np.argsort(self.polygons)
        uvs, colours, hard_edges = surface.uvs, surface.colours, surface.hard_edges
        return replace(
            surface,
            uvs=uvs and uvs.select(self.corners),
            colours=colours and colours.select(self.corners),
            hard_edges=None if hard_edges is None else renumber_by_first_use(hard_edges[self.corners]),
            face_sets=tuple(
                FaceSet(faces.name, new_ids[faces.polygons], faces.material) for faces in surface.face_sets
            ),
        )


def identity_numbering(polygons: Polygons, vertex_count: int) -> Renumbering:
    """Return the identity numbering of a mesh."""
    return Renumbering(*map(np.arange, (vertex_count, len(polygons.counts), polygons.indices.size)))


def walk_numbering(polygons: Polygons, sizes: Sequence[int], *, vertices: bool) -> Renumbering:
    """Return the numbering of polygons, and optionally of `vertices`, in the order of the walk.

    Vertices are numbered in order of first use within each object; `sizes` has the vertex counts of the objects.
    """
    order, entry_corners = walk_polygons(polygons, sum(sizes))
    counts, starts = polygons.counts.astype(np.int64), np.cumsum(polygons.counts) - polygons.counts
    counts, starts = counts[order], starts[order]
    entries = entry_corners - starts
    begin = np.where(counts == 3, entries, np.where(counts == 4, (entries + entries % 2) % 4, 0))
    vertex_ids = np.arange(sum(sizes))
    if vertices:
        used, first = np.unique(polygons.indices[_corners(starts, counts, entries)], return_index=True)
        first_uses = np.full(len(vertex_ids), polygons.indices.size)
        first_uses[used] = first
        vertex_ids = np.lexsort((first_uses, np.repeat(np.arange(len(sizes)), sizes)))
    return Renumbering(vertex_ids, order, _corners(starts, counts, begin))


def cheapest_numbering(header: SequenceHeader, order: OrderName) -> Renumbering:
    """Return the numbering that keeps `order` and in which polygons take the fewest bytes."""
    if order not in ORDERS:
        raise SettingsError(f"order is {order!r}; one of {', '.join(ORDERS)} is expected")
    polygons, sizes = header.polygons, object_vertex_counts(header)
    numberings = [identity_numbering(polygons, header.vertex_count)]
    for vertices in (False, True)[: ORDERS.index(order)]:
        numberings.append(walk_numbering(polygons, sizes, vertices=vertices))

    def size_of(numbering: Renumbering) -> int:
        return len(encode_polygons(numbering.renumber_polygons(polygons), header.vertex_count))

    return min(numberings, key=size_of) if len(numberings) > 1 else numberings[0]


def find_numbering(other: Polygons, polygons: Polygons, sizes: Sequence[int]) -> Renumbering | None:
    """Return the renumbering of a mesh that gives the polygons of a file, or None if the file has another mesh."""
    if not np.array_equal(np.sort(polygons.counts), np.sort(other.counts)):
        return None
    if match_polygons(polygons, other) is not None:
        return identity_numbering(polygons, sum(sizes))
    walked = walk_numbering(polygons, sizes, vertices=True)
    return None if match_polygons(walked.renumber_polygons(polygons), other) is None else walked


def match_meshes(a: Mesh, b: Mesh) -> Renumbering | None:
    """Return the renumbering of mesh `a` that gives mesh `b`; return None if they are different meshes.

    Polygons may be in any order. Vertices have the same numbers, or a compressed file has renumbered those of a mesh.
    If only the triangles of the polygons match, the renumbering is of these.
    """
    numbering = _match_polygons(a, b)
    if numbering is None and len(a[0].triangles) == len(b[0].triangles):
        cut = [(Polygons.from_triangles(polygons.triangles), sizes) for polygons, sizes in (a, b)]
        is_cut = not (a[0].only_triangles and b[0].only_triangles)
        numbering = _match_polygons(*cut) if is_cut else None
    return numbering


def _match_polygons(a: Mesh, b: Mesh) -> Renumbering | None:
    numbering = find_numbering(b[0], *a)
    if numbering is None:
        inverse = find_numbering(a[0], *b)
        if inverse is None:
            return None
        numbering = replace(identity_numbering(a[0], sum(a[1])), vertices=inverse.inverse.vertices)
    match = match_polygons(b[0], numbering.renumber_polygons(a[0]))
    if match is None:
        return None
    polygons, corners = numbering.polygons[match.polygons], numbering.corners[match.corners]
    return Renumbering(numbering.vertices, polygons, corners)


def match_headers(a: SequenceHeader, b: SequenceHeader) -> Renumbering | None:
    """Return `match_meshes` of two headers; warn if vertices or faces have other numbers."""
    numbering = match_meshes(mesh_of(a), mesh_of(b))
    if numbering is not None:
        warn_of_numbers(a.file_name, b.file_name, vertices=numbering.order == "free", faces=numbering.reorders_faces)
    return numbering


def warn_of_numbers(name: str, other: str, **are_renumbered: bool) -> None:
    """Warn that vertices or faces of two files are matched, if they have other numbers."""
    what = " and ".join(each for each, is_renumbered in are_renumbered.items() if is_renumbered)
    if what:
        warnings.warn(f"{what} of {name} have other numbers in {other}; they are matched", MixseqWarning, stacklevel=4)


def match_vertices(a: SequenceHeader, b: SequenceHeader, *, quiet: bool = False) -> Index | None:
    """Return the vertex ``(V,)`` of mesh `a` for every vertex of mesh `b`; return None if they are different meshes.

    A warning says that vertices have other numbers, unless `quiet`.
    """
    if a.vertex_count != b.vertex_count:
        return None
    if np.array_equal(a.faces, b.faces):
        return np.arange(a.vertex_count)
    numbering = match_meshes(mesh_of(a), mesh_of(b))
    if numbering is None:
        return None
    if not quiet:
        warn_of_numbers(a.file_name, b.file_name, vertices=numbering.order == "free")
    return numbering.vertices


@dataclass(frozen=True)
class NumberedVertices:
    """Checksums of a mesh, and numbers of some vertices in the order of its walk, to find these in other files of it.

    Checksums do not depend on the order of faces. Walking a walked mesh changes nothing, so both orders can be found.
    """

    checksum: str  # of the triangles
    walk_checksum: str  # of the triangles of renumbered vertices
    walk_ids: Mapping[int, int]  # number in the order of the walk, by vertex

    @classmethod
    def from_mesh(cls, header: SequenceHeader, vertex_ids: Index) -> NumberedVertices:
        """Return the checksums of a mesh, and its vertices ``(n,)`` in the order of the walk."""
        walk = walk_numbering(*mesh_of(header), vertices=True)
        walk_ids = np.argsort(walk.vertices)[vertex_ids].tolist()
        walked = walk.renumber_polygons(header.polygons)
        return cls(_checksum(header.polygons), _checksum(walked), dict(zip(vertex_ids.tolist(), walk_ids, strict=True)))

    def find_in(self, header: SequenceHeader, vertex_ids: Index, name: str) -> Index:
        """Return vertices ``(n,)`` in the numbers of another file; raise SettingsError if its mesh is another one."""
        if _checksum(header.polygons) == self.checksum:
            return vertex_ids
        walk = walk_numbering(*mesh_of(header), vertices=True)
        walk_ids = np.array([self.walk_ids.get(vertex, -1) for vertex in vertex_ids.tolist()], dtype=np.int64)
        is_same = _checksum(walk.renumber_polygons(header.polygons)) == self.walk_checksum
        if not (is_same and (walk_ids >= 0).all() and (walk_ids < header.vertex_count).all()):
            raise SettingsError(
                f"{name} are of another mesh than {header.file_name}, or of other numbers; set them on this file, or "
                "delete 'meshes' from their file if vertices have the same numbers"
            )
        warn_of_numbers(name, header.file_name, vertices=True)
        return walk.vertices[walk_ids]


def _checksum(polygons: Polygons) -> str:
    """Return a checksum of triangles in any order."""
    triangles = Polygons.from_triangles(polygons.triangles)
    return sha256(triangles.indices[canonical_order(triangles).corners].astype("<i4").tobytes()).hexdigest()[:16]


def with_mesh_of(frames: Frames, header: SequenceHeader, vertex_ids: Index) -> LazyFrames:
    """Return frames with their vertices ``(V,)`` in the order of another header of the mesh, and its polygons."""
    changed = replace(frames.header, polygons=header.polygons, surface=header.surface)
    return LazyFrames(changed, lambda size: (block[:, vertex_ids] for block in frames.blocks(size)))


def mesh_of(header: SequenceHeader) -> Mesh:
    """Return the polygons of a header, and the number of vertices of every object, for `match_meshes`."""
    return header.polygons, object_vertex_counts(header)


def object_vertex_counts(header: SequenceHeader) -> list[int]:
    """Return the number of vertices of every object joined in a sequence."""
    return [mesh.vertex_count for mesh in header.objects]


def _corners(starts: Index, sizes: Index, begin: Index) -> Index:
    """Return the corners of consecutive polygons; the corners of a polygon begin at corner `begin`, cyclically."""
    first = np.cumsum(sizes) - sizes
    along = np.arange(int(sizes.sum())) - np.repeat(first - begin, sizes)
    return np.asarray(np.repeat(starts, sizes) + along % np.repeat(sizes, sizes), dtype=np.int64)


def _is_sorted(numbers: Index) -> bool:
    return bool((np.diff(numbers) > 0).all())
