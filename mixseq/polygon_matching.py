"""The polygons of one mesh found among those of another one with the same vertices.

Programs keep the order of vertices and change that of polygons, as Blender does, which groups the faces of OBJ files by
material; and they begin polygons at other corners. So a polygon is the cycle of its vertices, wherever it is listed and
wherever it begins: two polygons are the same if their cycles are, in the same direction.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Index
from mixseq.errors import InvalidSequenceError
from mixseq.polygons import Polygons


@dataclass(frozen=True, eq=False)
class PolygonMatch:
    """Which polygon and which corner of another mesh those of a mesh are."""

    polygons: Index
    corners: Index


def matched(ours: Polygons, theirs: Polygons) -> PolygonMatch | None:
    """Return how polygons are found among others, None if they are not the same.

    Examples
    --------
    >>> ours = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 3, 2, 4]))
    >>> theirs = Polygons(np.array([3, 4]), np.array([4, 3, 2, 2, 3, 0, 1]))
    >>> found = matched(ours, theirs)
    >>> found.polygons.tolist(), found.corners.tolist()
    ([1, 0], [5, 6, 3, 4, 1, 2, 0])
    """
    if ours.same_as(theirs):
        return PolygonMatch(np.arange(len(ours.counts)), np.arange(ours.indices.size))
    own, other = in_canonical_order(ours), in_canonical_order(theirs)
    if not (
        np.array_equal(ours.counts[own.polygons], theirs.counts[other.polygons])
        and np.array_equal(ours.indices[own.corners], theirs.indices[other.corners])
    ):
        return None
    polygons, corners = np.empty_like(own.polygons), np.empty_like(own.corners)
    polygons[own.polygons] = other.polygons
    corners[own.corners] = other.corners
    return PolygonMatch(polygons, corners)


def in_canonical_order(polygons: Polygons) -> PolygonMatch:
    """Return which polygons and corners are first, second, ... in an order that cycles alone tell.

    The smallest polygons come first, those of a size in lexicographic order; each begins where its list of vertices is
    the first of all its rotations in that order.

    Examples
    --------
    >>> found = in_canonical_order(Polygons(np.array([4, 3]), np.array([2, 3, 0, 1, 4, 3, 2])))
    >>> found.polygons.tolist(), found.corners.tolist()
    ([1, 0], [6, 4, 5, 2, 3, 0, 1])
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
    """Return the other mesh's triangle ``(F,)`` for every triangle; within a polygon any of its triangles.

    Meshes may be cut into triangles, one of them or both.
    """
    if np.array_equal(ours.triangles, theirs.triangles):
        return np.arange(len(ours.triangles))
    found = matched(ours, theirs)
    if found is not None:
        own, other = (np.cumsum(each.counts - 2) - each.counts + 2 for each in (ours, theirs))
        sizes = ours.counts - 2
        within = np.arange(len(ours.triangles)) - np.repeat(own, sizes)
        return np.asarray(np.repeat(other[found.polygons], sizes) + within, dtype=np.int64)
    found = matched(*(Polygons.from_triangles(each.triangles) for each in (ours, theirs)))
    if found is None:
        raise InvalidSequenceError(difference(ours, theirs, names))
    return found.polygons


def difference(ours: Polygons, theirs: Polygons, names: tuple[str, str]) -> str:
    """Return the first polygon that one of two meshes has and the other has not, in words; "" if there is none.

    Examples
    --------
    >>> ours, theirs = (Polygons.from_triangles([[0, 1, 2], [2, 1, last]]) for last in (3, 4))
    >>> difference(ours, theirs, ("A", "B"))
    'polygon 1 of A (vertices 2 1 3) is not in B'
    """
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
