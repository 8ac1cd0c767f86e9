"""The polygons of a mesh, their triangulation, and the correspondence of those of two meshes with the same vertices.

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

        It depends on indices only, so that connectivity is the same in every frame.

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
        step = np.arange(int(per_polygon.sum())) - np.repeat(
            np.cumsum(per_polygon) - per_polygon, per_polygon
        )
        corners = np.stack([first, first + step + 1, first + step + 2], axis=1)
        return np.asarray(read_only(self.indices[corners]), dtype=np.int32)

    @property
    def only_triangles(self) -> bool:
        """Whether every polygon has three corners."""
        return bool(np.all(self.counts == 3))

    def same_as(self, other: Polygons) -> bool:
        """Whether both have the same polygons in the same order with the same first corners."""
        return np.array_equal(self.counts, other.counts) and np.array_equal(self.indices, other.indices)


def reversed_winding(counts: IntArray, *, keep_first: bool) -> NDArray[np.intp]:
    """Return corner indices that reverse every polygon, an involution: new corner ``c`` is old ``order[c]``.

    Shapes: counts ``(P,)``.

    Examples
    --------
    >>> reversed_corners(np.array([4, 3]), keep_first=True).tolist()
    [0, 3, 2, 1, 4, 6, 5]
    >>> reversed_corners(np.array([4, 3]), keep_first=False).tolist()
    [3, 2, 1, 0, 6, 5, 4]
    """
    sizes = np.repeat(counts, counts)
    starts = np.repeat(np.cumsum(counts) - counts, counts)
    corner = np.arange(len(starts)) - starts
    new = -corner if keep_first else -corner - 1
    return np.asarray(starts + new % sizes, dtype=np.intp)


def as_indices(values: ArrayLike, what: str) -> NDArray[np.int32]:
    """Return whole numbers as int32; InvalidSequenceError with the name `what` for other types or ranges."""
    array = np.asarray(values)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise InvalidSequenceError(f"{what} have type {array.dtype}; integers are expected")
    if array.size and (array.max() > np.iinfo(np.int32).max or array.min() < np.iinfo(np.int32).min):
        raise InvalidSequenceError(f"{what} do not fit into 32 bits")
    return np.ascontiguousarray(array, dtype=np.int32)


@dataclass(frozen=True, eq=False)
class PolygonMatch:
    """Indices of the corresponding polygons and corners in another mesh."""

    polygons: Index
    corners: Index


def match_polygons(ours: Polygons, theirs: Polygons) -> PolygonMatch | None:
    """Return the polygons and corners of `theirs` for those of `ours`, None if the meshes differ."""
    if ours.same_as(theirs):
        return PolygonMatch(np.arange(len(ours.counts)), np.arange(ours.indices.size))
    own, other = canonical_order(ours), canonical_order(theirs)
    if not (
        np.array_equal(ours.counts[own.polygons], theirs.counts[other.polygons])
        and np.array_equal(ours.indices[own.corners], theirs.indices[other.corners])
    ):
        return None
    polygons, corners = np.empty_like(own.polygons), np.empty_like(own.corners)
    polygons[own.polygons] = other.polygons
    corners[own.corners] = other.corners
    return PolygonMatch(polygons, corners)


def canonical_order(polygons: Polygons) -> PolygonMatch:
    """Return polygon and corner indices in an order that depends on cycles only.

    Polygons are sorted by size, then lexicographically; each begins at its lexicographically first rotation.
    """
    cycles = [_cycles(polygons, size) for size in np.unique(polygons.counts).tolist()]
    none = [np.zeros(0, dtype=np.int64)]
    return PolygonMatch(
        np.concatenate(none + [number for number, _ in cycles]),
        np.concatenate(none + [corners.reshape(-1) for _, corners in cycles]),
    )


def _cycles(polygons: Polygons, size: int) -> tuple[Index, Index]:
    """Return the polygons ``(m,)`` of a size and their corners ``(m, size)`` in canonical order."""
    number = np.flatnonzero(polygons.counts == size)
    starts = (np.cumsum(polygons.counts) - polygons.counts)[number]
    corners = starts[:, None] + np.arange(size)
    rows = polygons.indices[corners]
    turn = np.argmin(rows, axis=1)
    # A vertex that a polygon has twice, because it was welded, leaves it open which is first.
    for row in np.flatnonzero((rows == rows.min(axis=1, keepdims=True)).sum(axis=1) > 1).tolist():
        turn[row] = min(range(size), key=lambda first: np.roll(rows[row], -first).tolist())
    corners = np.take_along_axis(corners, (turn[:, None] + np.arange(size)) % size, axis=1)
    order = np.lexsort(polygons.indices[corners].T[::-1])
    return number[order], corners[order]


def match_triangles(ours: Polygons, theirs: Polygons, names: tuple[str, str]) -> Index:
    """Return triangles ``(F,)`` of the other mesh, within equal polygons; InvalidSequenceError if they differ."""
    if np.array_equal(ours.triangles, theirs.triangles):
        return np.arange(len(ours.triangles))
    found = match_polygons(ours, theirs)
    if found is not None:
        own, other = (np.cumsum(each.counts - 2) - each.counts + 2 for each in (ours, theirs))
        sizes = ours.counts - 2
        within = np.arange(len(ours.triangles)) - np.repeat(own, sizes)
        return np.asarray(np.repeat(other[found.polygons], sizes) + within, dtype=np.int64)
    found = match_polygons(*(Polygons.from_triangles(each.triangles) for each in (ours, theirs)))
    if found is None:
        raise InvalidSequenceError(describe_difference(ours, theirs, names))
    return found.polygons


def describe_difference(ours: Polygons, theirs: Polygons, names: tuple[str, str]) -> str:
    """Describe the first polygon that one of two meshes lacks, "" if there is none."""
    for one, other, (name, beside) in ((ours, theirs, names), (theirs, ours, names[::-1])):
        left = Counter(_keys(other))
        for polygon, key in enumerate(_keys(one)):
            left[key] -= 1
            if left[key] < 0:
                start = int(one.counts[:polygon].sum())
                vertices = one.indices[start : start + int(one.counts[polygon])].tolist()
                turned = _key(vertices[::-1]) in left and left[_key(vertices[::-1])] > 0
                there = "the other way round in" if turned else "not in"
                return f"polygon {polygon} of {name} (vertices {' '.join(map(str, vertices))}) is {there} {beside}"
    return ""


def _keys(polygons: Polygons) -> list[tuple[int, ...]]:
    ends = np.cumsum(polygons.counts)[:-1]
    return [_key(each.tolist()) for each in np.split(polygons.indices, ends)]


def _key(vertices: list[int]) -> tuple[int, ...]:
    least = min(vertices)
    rotations = (vertices[first:] + vertices[:first] for first, each in enumerate(vertices) if each == least)
    return tuple(min(rotations))
