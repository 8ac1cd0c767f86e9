r"""The inner loops of `mixseq.geometry.intersections`, compiled.

Two triangles cross (Möller 1997, "A fast triangle-triangle intersection test") if each has corners on both sides of
the other's plane, and the segments in which they meet the line that the planes share overlap. With unit normals n, m
the line has the direction :math:`n \times m`; positions on it are measured along the axis in which that is largest,
which keeps their order. A corner at distance d from the plane, alone on its side, has sides to corners at distances e
that meet the plane at the fraction :math:`d / (d - e)` of their length.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled


@compiled
def _lonely(distances: Float, corners: Float, normal: Float, origin: Float, least: float) -> int:
    """Write the distances of corners to a plane; return the corner alone on its side, -1 if none is on one side."""
    above = below = 0
    for k in range(3):
        distance = 0.0
        for i in range(3):
            distance += normal[i] * (corners[k, i] - origin[i])
        if distance > least:
            above += 1
        elif distance < -least:
            below += 1
        else:
            distance = 0.0
        distances[k] = distance
    if above == 0 or below == 0:
        return -1
    for k in range(3):
        if (distances[k] > 0.0 and above == 1) or (distances[k] < 0.0 and above == 2):
            return k
    return -1


@compiled
def _segment(distances: Float, corners: Float, alone: int, axis: int, origin: float) -> tuple[float, float]:
    """Return where a triangle meets a plane, along an axis, from the origin."""
    p, q, r = alone, (alone + 1) % 3, (alone + 2) % 3
    x = corners[p, axis] - origin
    first = x + (corners[q, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[q]))
    second = x + (corners[r, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[r]))
    return min(first, second), max(first, second)


@compiled
def _cross(
    f: Float, g: Float, n: Float, m: Float, least: float, of_f: Float, of_g: Float, along: Float
) -> bool:
    """Tell whether triangles f, g with normals n, m cross by more than the least length."""
    in_g = _lonely(of_g, g, n, f[0], least)
    if in_g < 0:
        return False
    in_f = _lonely(of_f, f, m, g[0], least)
    if in_f < 0:
        return False
    along[0] = abs(n[1] * m[2] - n[2] * m[1])
    along[1] = abs(n[2] * m[0] - n[0] * m[2])
    along[2] = abs(n[0] * m[1] - n[1] * m[0])
    axis = 0
    for i in range(1, 3):
        if along[i] > along[axis]:
            axis = i
    low, high = _segment(of_f, f, in_f, axis, f[0, axis])
    start, end = _segment(of_g, g, in_g, axis, f[0, axis])
    return min(high, end) - max(low, start) > least


@compiled
def crossing_pairs(
    corners: Float,
    normals: Float,
    places: Index,
    order: Index,
    firsts: Index,
    boxes: Float,
    least: float,
    pairs: Index,
) -> int:
    """Count the pairs of crossing triangles without a place in common; write as many as fit, smaller first.

    Triangles without area, whose normal is NaN, cross nothing.

    Parameters
    ----------
    corners, normals : (F, 3, 3), (F, 3) float64
        Triangles and their unit normals, in the order of the tree.
    places : (F, 3) int64
        Numbers of the corners' positions, in the same order.
    order, firsts, boxes : (F,) int64, (L + 1,) int64, (2L, 6) float64
        The tree, see `BoxTree`.
    least : float
        Depths and lengths up to this are contact; in the unit of the corners.
    pairs : (n, 2) int64
        Written to.
    """
    leaves = len(firsts) - 1
    nodes = np.empty(64, dtype=np.int64)
    of_f, of_g, along = np.empty(3), np.empty(3), np.empty(3)
    low, high = np.empty(3), np.empty(3)
    count = 0
    for a in range(len(corners)):
        f = corners[a]
        for i in range(3):
            low[i], high[i] = min(f[0, i], f[1, i], f[2, i]), max(f[0, i], f[1, i], f[2, i])
        nodes[0], height = 1, 1
        while height > 0:
            height -= 1
            node = nodes[height]
            box = boxes[node]
            if box[0] > high[0] or box[1] > high[1] or box[2] > high[2]:
                continue
            if box[3] < low[0] or box[4] < low[1] or box[5] < low[2]:
                continue
            if node < leaves:
                nodes[height], nodes[height + 1] = 2 * node + 1, 2 * node
                height += 2
                continue
            for b in range(max(firsts[node - leaves], a + 1), firsts[node - leaves + 1]):
                shared = False
                for i in range(3):
                    for k in range(3):
                        shared |= places[a, i] == places[b, k]
                if shared or not _cross(f, corners[b], normals[a], normals[b], least, of_f, of_g, along):
                    continue
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = min(order[a], order[b]), max(order[a], order[b])
                count += 1
    return count
