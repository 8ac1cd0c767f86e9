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
    """Which polygon and which corner of another mesh those of a mesh are.

    Parameters
    ----------
    polygons : (P,) int64
        The other mesh's polygon for every polygon.
    corners : (sum of counts,) int64
        The other mesh's corner for every corner.
    """

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
    if not np.array_equal(np.sort(ours.counts), np.sort(theirs.counts)):
        return None
    polygons = np.zeros(len(ours.counts), dtype=np.int64)
    corners = np.zeros(ours.indices.size, dtype=np.int64)
    for size in np.unique(ours.counts).tolist():
        (own, own_corners), (other, other_corners) = (_cycles(each, size) for each in (ours, theirs))
        if not np.array_equal(ours.indices[own_corners], theirs.indices[other_corners]):
            return None
        polygons[own] = other
        corners[own_corners] = other_corners
    return PolygonMatch(polygons, corners)


def _cycles(polygons: Polygons, size: int) -> tuple[Index, Index]:
    """Return the polygons ``(m,)`` of a size and their corners ``(m, size)``, both in an order that cycles alone tell.

    Every polygon begins where its list of vertices is the first of all its rotations in lexicographic order.
    """
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

    Parameters
    ----------
    ours, theirs : Polygons
        The meshes.
    names : (str, str)
        What they are called in messages.

    Raises
    ------
    InvalidSequenceError
        If they have other polygons; the message says which is the first that differs.
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
