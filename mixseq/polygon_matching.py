"""Correspondence of the polygons of two meshes with the same vertices.

Programs keep the order of vertices but may reorder polygons (Blender groups faces of OBJ files by material) and rotate
their corners. A polygon is therefore identified by the directed cycle of its vertices.
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
    """Indices of the corresponding polygons and corners in another mesh."""

    polygons: Index
    corners: Index


def matched(ours: Polygons, theirs: Polygons) -> PolygonMatch | None:
    """Return the polygons and corners of `theirs` for those of `ours`, None if the meshes differ."""
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
