"""Polygons of a mesh, their triangulation, and their matching to polygons of a mesh with the same vertices.

Programs keep the order of vertices but may reorder polygons (Blender groups faces of OBJ files by material) and rotate
their corners. A polygon is therefore identified by the directed cycle of its vertices.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import InvalidSequenceError
from mixseq.types import Index, IntArray


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of an array, for frozen dataclasses."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, eq=False)
class Polygons:
    """The faces of a mesh as its author made them: triangles, quads and n-gons.

    Parameters
    ----------
    counts : (P,) int
        Number of corners of each polygon, at least 3.
    indices : (sum(counts),) int
        Vertex index of each corner, polygon by polygon.
    """

    counts: IntArray
    indices: IntArray

    def __post_init__(self) -> None:
        counts = as_indices(self.counts, "polygon corner counts").reshape(-1)
        indices = as_indices(self.indices, "polygon corners").reshape(-1)
        if counts.size and counts.min() < 3:
            bad = int(np.argmax(counts < 3))
            raise InvalidSequenceError(
                f"polygon {bad} has {counts[bad]} corners; a face needs at least 3 (remove points and lines)"
            )
        if int(counts.sum()) != indices.size:
            raise InvalidSequenceError(
                f"polygon corner counts add up to {int(counts.sum())} but {indices.size} corners are given"
            )
        object.__setattr__(self, "counts", read_only(counts))
        object.__setattr__(self, "indices", read_only(indices))

    @classmethod
    def from_triangles(cls, faces: ArrayLike) -> Polygons:
        """Make polygons of an ``(F, 3)`` array of triangles."""
        triangles = as_indices(faces, "faces")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise InvalidSequenceError(f"faces have shape {triangles.shape}; (F, 3) is expected")
        return cls(np.full(len(triangles), 3, dtype=np.int32), triangles.reshape(-1))

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """Triangulation ``(F, 3)``: a fan about each polygon's first corner.

        The triangulation depends on indices only, so that connectivity is the same in every frame.

        Examples
        --------
        >>> Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 3, 2, 4])).triangles.tolist()
        [[0, 1, 2], [0, 2, 3], [3, 2, 4]]
        """
        if self.only_triangles:
            return read_only(self.indices.reshape(-1, 3))
        starts = np.cumsum(self.counts) - self.counts
        per_polygon = self.counts - 2
        first = np.repeat(starts, per_polygon)
        step = np.arange(int(per_polygon.sum())) - np.repeat(np.cumsum(per_polygon) - per_polygon, per_polygon)
        corners = np.stack([first, first + step + 1, first + step + 2], axis=1)
        return np.asarray(read_only(self.indices[corners]), dtype=np.int32)

    @property
    def only_triangles(self) -> bool:
        """Whether every polygon has three corners."""
        return bool(np.all(self.counts == 3))

    def same_as(self, other: Polygons) -> bool:
        """Return whether both have the same polygons, in the same order and with the same first corners."""
        return np.array_equal(self.counts, other.counts) and np.array_equal(self.indices, other.indices)


def reversed_winding(counts: IntArray, *, keep_first: bool) -> NDArray[np.intp]:
    """Return the order of corners that reverses polygons with counts ``(P,)``: new corner ``c`` is old ``order[c]``.

    Examples
    --------
    >>> reversed_winding(np.array([4, 3]), keep_first=True).tolist()
    [0, 3, 2, 1, 4, 6, 5]
    >>> reversed_winding(np.array([4, 3]), keep_first=False).tolist()
    [3, 2, 1, 0, 6, 5, 4]
    """
    sizes = np.repeat(counts, counts)
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    corner = np.arange(len(starts)) - starts
    new = -corner if keep_first else -corner - 1
    return np.asarray(starts + new % sizes, dtype=np.intp)


def label_vertices(faces: IntArray, labels: Index, vertex_count: int) -> Index:
    """Return the most frequent label ``(V,)`` of every vertex's triangles, the lowest of several, without unused ones.

    Compressed files depend on it.
    """
    votes = np.zeros((vertex_count, int(labels.max(initial=0)) + 1), dtype=np.int64)
    np.add.at(votes, (faces.reshape(-1), np.repeat(labels, 3)), 1)
    return np.unique(votes.argmax(axis=1), return_inverse=True)[1].astype(np.int64)


def as_indices(values: ArrayLike, what: str) -> NDArray[np.int32]:
    """Return integers as int32; raise InvalidSequenceError, naming `what`, for other types or values beyond 32 bits."""
    array = np.asarray(values)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise InvalidSequenceError(f"{what} have type {array.dtype}; integers are expected")
    if array.size and (array.max() > np.iinfo(np.int32).max or array.min() < np.iinfo(np.int32).min):
        raise InvalidSequenceError(f"{what} do not fit into 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class PolygonMatch:
    """Indices of corresponding polygons and corners."""

    polygons: Index
    corners: Index


def match_polygons(first: Polygons, second: Polygons) -> PolygonMatch | None:
    """Match every polygon and corner of `first` to one of `second`; return None if the meshes differ."""
    if first.same_as(second):
        return PolygonMatch(np.arange(len(first.counts)), np.arange(first.indices.size))
    a, b = canonical_order(first), canonical_order(second)
    if not (
        np.array_equal(first.counts[a.polygons], second.counts[b.polygons])
        and np.array_equal(first.indices[a.corners], second.indices[b.corners])
    ):
        return None
    polygons, corners = np.empty_like(a.polygons), np.empty_like(a.corners)
    polygons[a.polygons], corners[a.corners] = b.polygons, b.corners
    return PolygonMatch(polygons, corners)


def canonical_order(polygons: Polygons) -> PolygonMatch:
    """Return polygons and corners in an order that depends only on the vertex cycles.

    Corners of each polygon are rotated to the lexicographically first order; polygons are sorted by size, then corners.
    """
    cycles = [_cycles(polygons, size) for size in np.unique(polygons.counts).tolist()]
    empty = [np.zeros(0, dtype=np.int64)]
    return PolygonMatch(
        np.concatenate(empty + [polygon_ids for polygon_ids, _ in cycles]),
        np.concatenate(empty + [corners.reshape(-1) for _, corners in cycles]),
    )


def _cycles(polygons: Polygons, size: int) -> tuple[Index, Index]:
    """Return the polygons ``(m,)`` of a size and their corners ``(m, size)`` in canonical order."""
    polygon_ids = np.flatnonzero(polygons.counts == size)
    starts = (np.cumsum(polygons.counts) - polygons.counts)[polygon_ids]
    corners = starts[:, None] + np.arange(size)
    vertices = polygons.indices[corners]
    first = np.argmin(vertices, axis=1)
    # A welded polygon may have its lowest vertex twice; then all its rotations are compared.
    for row in np.flatnonzero((vertices == vertices.min(axis=1, keepdims=True)).sum(axis=1) > 1).tolist():
        first[row] = min(range(size), key=lambda start: np.roll(vertices[row], -start).tolist())
    corners = np.take_along_axis(corners, (first[:, None] + np.arange(size)) % size, axis=1)
    order = np.lexsort(polygons.indices[corners].T[::-1])
    return polygon_ids[order], corners[order]


def match_triangles(first: Polygons, second: Polygons, names: tuple[str, str]) -> Index:
    """Match each triangle of `first` to a triangle ``(F,)`` of `second`; InvalidSequenceError if the meshes differ."""
    if np.array_equal(first.triangles, second.triangles):
        return np.arange(len(first.triangles))
    match = match_polygons(first, second)
    if match is not None:
        first_starts, second_starts = (np.cumsum(mesh.counts - 2) - mesh.counts + 2 for mesh in (first, second))
        sizes = first.counts - 2
        offsets = np.arange(len(first.triangles)) - np.repeat(first_starts, sizes)
        # Quads that begin at opposite corners have the same triangles, in the other order.
        begin = np.cumsum(first.counts) - first.counts, (np.cumsum(second.counts) - second.counts)[match.polygons]
        is_opposite = np.repeat((first.counts == 4) & (match.corners[begin[0]] - begin[1] == 2), sizes)
        offsets = np.where(is_opposite, 1 - offsets, offsets)
        return np.asarray(np.repeat(second_starts[match.polygons], sizes) + offsets, dtype=np.int64)
    match = match_polygons(*(Polygons.from_triangles(mesh.triangles) for mesh in (first, second)))
    if match is None:
        raise InvalidSequenceError(describe_difference(first, second, names))
    return match.polygons


def describe_difference(first: Polygons, second: Polygons, names: tuple[str, str]) -> str:
    """Describe the first polygon missing from one of two meshes; return "" if none is missing."""
    for mesh, other, (name, other_name) in ((first, second, names), (second, first, names[::-1])):
        unmatched = Counter(_cycle_keys(other))
        for polygon, key in enumerate(_cycle_keys(mesh)):
            unmatched[key] -= 1
            if unmatched[key] < 0:
                start = int(mesh.counts[:polygon].sum())
                vertices = mesh.indices[start : start + int(mesh.counts[polygon])].tolist()
                relation = "flipped in" if unmatched.get(_cycle_key(vertices[::-1]), 0) > 0 else "not in"
                corners = " ".join(map(str, vertices))
                return f"polygon {polygon} of {name} (vertices {corners}) is {relation} {other_name}"
    return ""


def count_common_polygons(first: Polygons, second: Polygons) -> int:
    """Count polygons with the same vertices in the same cyclic order in both meshes."""
    return (Counter(_cycle_keys(first)) & Counter(_cycle_keys(second))).total()


def _cycle_keys(polygons: Polygons) -> list[tuple[int, ...]]:
    ends = np.cumsum(polygons.counts)[:-1]
    return [_cycle_key(vertices.tolist()) for vertices in np.split(polygons.indices, ends)]


def _cycle_key(vertices: list[int]) -> tuple[int, ...]:
    """Return the lexicographically first rotation of a polygon's vertices."""
    lowest = min(vertices)
    starts = (start for start, vertex in enumerate(vertices) if vertex == lowest)
    return tuple(min(vertices[start:] + vertices[:start] for start in starts))
