r"""A tree of bounding boxes of triangles, for searches near a point or a box.

The tree is complete and binary, without pointers: node 1 is the root, node n has the children 2n and 2n + 1, and the
last L = 2^d nodes are the leaves. Level l splits the triangles, in the order of the tree, into 2^l ranges of equal
size: its j-th node has the places from floor(F j / 2^l) to floor(F (j + 1) / 2^l). A node's triangles are divided at
the median of their boxes' centres along the axis in which the centres spread most (Bentley 1975, "Multidimensional
binary search trees used for associative searching").

*Closest points.* With corners a, b, c relative to the query, the closest point of a triangle is the closest of four:

- on each side :math:`pq` the point :math:`p + t (q - p)`, with :math:`t = -p \cdot (q - p) / |q - p|^2` within [0, 1];
- the foot of the perpendicular, if it is inside: with :math:`n = (b - a) \times (c - a)` it has the weights
  :math:`w_b = n \cdot (c \times a) / |n|^2` and :math:`w_c = n \cdot (a \times b) / |n|^2`.

For slivers and triangles without area the foot is inaccurate or missing, but not the points on the sides. So all are
tried, instead of the regions of Ericson (Real-Time Collision Detection, 2005, 5.1.5).

*Crossings.* Two triangles cross (Möller 1997, "A fast triangle-triangle intersection test") if each has corners on both
sides of the other's plane, and their segments on the common line of both planes overlap. With unit normals n, m the
line has the direction :math:`n \times m`; positions on it are measured along the axis in which that is largest, which
keeps their order. A corner at distance d from the plane, alone on its side, has sides to corners at distances e that
meet the plane at the fraction :math:`d / (d - e)` of their length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.errors import InvalidSequenceError
from mixseq.runtime.jit import compiled
from mixseq.types import Float, FloatArray, Index, IntArray

PRUNING_FACTOR = 1.0 - 1e-14  # a box is as close as a triangle in it, but for rounding
COSINE_TOLERANCE = 1e-14  # of cosines, likewise


@compiled
def _on_side(p0: float, p1: float, p2: float, q0: float, q1: float, q2: float) -> tuple[float, float]:
    """Return the squared distance of the origin to the segment pq, and the weight of q."""
    e0, e1, e2 = q0 - p0, q1 - p1, q2 - p2
    square = e0 * e0 + e1 * e1 + e2 * e2
    t = -(p0 * e0 + p1 * e1 + p2 * e2)
    t = 0.0 if t <= 0.0 else 1.0 if t >= square else t / square
    if t == 1.0:  # the bits of the corner, so that all triangles around it are equally far
        return q0 * q0 + q1 * q1 + q2 * q2, t
    r0, r1, r2 = p0 + t * e0, p1 + t * e1, p2 + t * e2
    return r0 * r0 + r1 * r1 + r2 * r2, t


@compiled
def _on_triangle(corners: Float, q0: float, q1: float, q2: float) -> tuple[float, float, float]:
    """Return the squared distance of a query to a triangle, and the weights of its second and third corner."""
    a0, a1, a2 = corners[0, 0] - q0, corners[0, 1] - q1, corners[0, 2] - q2
    b0, b1, b2 = corners[1, 0] - q0, corners[1, 1] - q1, corners[1, 2] - q2
    c0, c1, c2 = corners[2, 0] - q0, corners[2, 1] - q1, corners[2, 2] - q2
    best, second = _on_side(a0, a1, a2, b0, b1, b2)
    third = 0.0
    square, t = _on_side(a0, a1, a2, c0, c1, c2)
    if square < best:
        best, second, third = square, 0.0, t
    square, t = _on_side(b0, b1, b2, c0, c1, c2)
    if square < best:
        best, second, third = square, 1.0 - t, t
    u0, u1, u2 = b0 - a0, b1 - a1, b2 - a2
    v0, v1, v2 = c0 - a0, c1 - a1, c2 - a2
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    square = n0 * n0 + n1 * n1 + n2 * n2
    s = (n0 * (v1 * a2 - v2 * a1) + n1 * (v2 * a0 - v0 * a2) + n2 * (v0 * a1 - v1 * a0)) / square
    t = (n0 * (a1 * u2 - a2 * u1) + n1 * (a2 * u0 - a0 * u2) + n2 * (a0 * u1 - a1 * u0)) / square
    if s > 0.0 and t > 0.0 and s + t < 1.0:  # never where the square is 0 and they are NaN
        r0, r1, r2 = a0 + s * u0 + t * v0, a1 + s * u1 + t * v1, a2 + s * u2 + t * v2
        square = r0 * r0 + r1 * r1 + r2 * r2
        if square < best:
            best, second, third = square, s, t
    return best, second, third


@compiled
def _to_box(box: Float, q0: float, q1: float, q2: float) -> float:
    """Return the squared distance of a query to a box."""
    d0 = max(box[0] - q0, q0 - box[3], 0.0)
    d1 = max(box[1] - q1, q1 - box[4], 0.0)
    d2 = max(box[2] - q2, q2 - box[5], 0.0)
    square: float = d0 * d0 + d1 * d1 + d2 * d2
    return square


@compiled
def _faces_away(bounds: Float, m0: float, m1: float, m2: float, cosine: float) -> bool:
    """Return whether all normals within bounds have less than the cosine with the given one, or there are none."""
    product = m0 * (bounds[3] if m0 > 0.0 else bounds[0])
    product += m1 * (bounds[4] if m1 > 0.0 else bounds[1])
    product += m2 * (bounds[5] if m2 > 0.0 else bounds[2])
    return not product >= cosine - COSINE_TOLERANCE


@compiled
def closest(
    corners: Float,
    normals: Float,
    order: Index,
    leaf_starts: Index,
    boxes: Float,
    bounds: Float,
    queries: Float,
    facing: Float,
    cosine: float,
    faces: Index,
    weights: Float,
    squares: Float,
) -> None:
    """Write the triangle, weights and squared distance of the closest point to every query.

    Corners and normals are in the order of the tree; boxes, and bounds of the normals, are of its nodes. Triangles
    count if their normal has at least the given cosine with the query's; all where `facing` is empty.
    """
    leaves = len(leaf_starts) - 1
    nodes = np.empty(64, dtype=np.int64)
    nearness = np.empty(64)
    gated = len(facing) > 0
    for k in range(len(queries)):
        q0, q1, q2 = queries[k, 0], queries[k, 1], queries[k, 2]
        best, found, second, third = np.inf, -1, 0.0, 0.0
        nodes[0], nearness[0] = 1, 0.0
        height = 1
        while height > 0:
            height -= 1
            if not nearness[height] * PRUNING_FACTOR <= best:
                continue
            node = nodes[height]
            if gated and _faces_away(bounds[node], facing[k, 0], facing[k, 1], facing[k, 2], cosine):
                continue
            if node < leaves:
                near, far = 2 * node, 2 * node + 1
                to_near, to_far = _to_box(boxes[near], q0, q1, q2), _to_box(boxes[far], q0, q1, q2)
                if to_far < to_near:
                    near, far, to_near, to_far = far, near, to_far, to_near
                nodes[height], nearness[height] = far, to_far
                nodes[height + 1], nearness[height + 1] = near, to_near
                height += 2
                continue
            for place in range(leaf_starts[node - leaves], leaf_starts[node - leaves + 1]):
                if gated:
                    product = (
                        normals[place, 0] * facing[k, 0]
                        + normals[place, 1] * facing[k, 1]
                        + normals[place, 2] * facing[k, 2]
                    )
                    if not product >= cosine:  # nor where one of them is NaN
                        continue
                square, s, t = _on_triangle(corners[place], q0, q1, q2)
                if square < best or (square == best and (found < 0 or order[place] < found)):
                    best, found, second, third = square, order[place], s, t
        faces[k], squares[k] = found, best
        weights[k, 0], weights[k, 1], weights[k, 2] = 1.0 - second - third, second, third


@compiled
def _lonely(distances: Float, corners: Float, normal: Float, origin: Float, least: float) -> int:
    """Write the distances of corners to a plane; return the corner alone on its side, -1 if a side is empty."""
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
    """Return the interval in which a triangle meets a plane, along an axis, from the origin."""
    p, q, r = alone, (alone + 1) % 3, (alone + 2) % 3
    x = corners[p, axis] - origin
    first = x + (corners[q, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[q]))
    second = x + (corners[r, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[r]))
    return min(first, second), max(first, second)


@compiled
def _cross(
    f: Float, g: Float, n: Float, m: Float, least: float, of_f: Float, of_g: Float, along: Float
) -> bool:
    """Return whether triangles f, g with normals n, m cross by more than the least length."""
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
    leaf_starts: Index,
    boxes: Float,
    least: float,
    pairs: Index,
) -> int:
    """Count pairs of crossing triangles without a common place; write pairs ``(n, 2)`` while they fit, smaller first.

    Corners ``(F, 3, 3)``, unit normals, places ``(F, 3)`` are in the order of the tree (`BoxTree`). Depths and lengths
    up to `least`, in the unit of the corners, are contact. Triangles without area, with a NaN normal, cross nothing.
    """
    leaves = len(leaf_starts) - 1
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
            for b in range(max(leaf_starts[node - leaves], a + 1), leaf_starts[node - leaves + 1]):
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


MAX_LEAF_TRIANGLES = 4
"""Largest number of triangles in a leaf; from 2 to 8 times are the same."""

BOX_MARGIN = 1e-14
"""Enlargement of boxes, relative to the largest coordinate, against rounding."""

DEGENERATE_HEIGHT_RATIO = 1e-12
"""Ratio of height to longest side below which triangles have no area: their normals are rounding."""


def triangle_corners(points: FloatArray, faces: IntArray) -> Float:
    """Return the corners ``(F, 3, 3)`` of the triangles ``(F, 3)`` of points ``(V, 3)``."""
    points, faces = np.asarray(points, dtype=np.float64), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise InvalidSequenceError(
            f"points of shape {points.shape} and faces of shape {faces.shape} are no triangle mesh; "
            "give points (V, 3) and faces (F, 3)"
        )
    missing = ((faces < 0) | (faces >= len(points))).any(axis=1)
    if missing.any():
        face = int(missing.argmax())
        raise InvalidSequenceError(
            f"triangle {face} is of vertices {faces[face].tolist()}, but there are {len(points)} points; "
            f"vertices are numbered from 0 to {len(points) - 1}"
        )
    corners = np.ascontiguousarray(points[faces], dtype=np.float64)
    broken = ~np.isfinite(corners).all(axis=(1, 2))
    if broken.any():
        raise InvalidSequenceError(
            f"triangle {int(broken.argmax())} has a corner that is not finite; give finite points"
        )
    return corners


def unit_normals(corners: Float) -> Float:
    """Return the unit normals ``(F, 3)`` of triangles ``(F, 3, 3)``; NaN below `DEGENERATE_HEIGHT_RATIO`."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("fki,fki->fk", sides, sides).max(axis=1, initial=0.0)
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(
            normals / np.where(areas > DEGENERATE_HEIGHT_RATIO * longest, areas, np.nan)[:, None]
        )


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A tree of bounding boxes of triangles."""

    order: Index  # (F,) triangle at every place of the tree
    leaf_starts: Index  # (L + 1,) first place of every leaf, and F
    # (2 L, 6) least x, y, z and largest x, y, z of every node; infinite and minus infinite where a node is empty.
    boxes: Float

    @classmethod
    def from_triangles(cls, corners: Float) -> BoxTree:
        """Build the tree of triangles ``(F, 3, 3)``, deterministically."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        depth = max((len(corners) - 1) // MAX_LEAF_TRIANGLES, 0).bit_length()
        order = _order(low + high, depth)
        leaf_starts = _firsts(len(corners), 1 << depth)
        margin = BOX_MARGIN * max(-low.min(initial=0.0), high.max(initial=0.0))
        return cls(order, leaf_starts, _boxes(low[order] - margin, high[order] + margin, leaf_starts))

    def node_bounds(self, values: Float) -> Float:
        """Return the bounding boxes ``(2 L, 6)`` of values ``(F, 3)`` of the triangles in every node, ignoring NaN."""
        values = values[self.order]
        low, high = (np.where(np.isnan(values), none, values) for none in (np.inf, -np.inf))
        return _boxes(low, high, self.leaf_starts)


def _firsts(count: int, parts: int) -> Index:
    return np.asarray(count * np.arange(parts + 1) // parts, dtype=np.int64)


def _order(centres: Float, depth: int) -> Index:
    order = np.arange(len(centres))
    for level in range(depth):
        leaf_starts = _firsts(len(centres), 1 << level)
        at = centres[order]
        spread = np.maximum.reduceat(at, leaf_starts[:-1]) - np.minimum.reduceat(at, leaf_starts[:-1])
        node = np.repeat(np.arange(1 << level), np.diff(leaf_starts))
        along = at[np.arange(len(order)), spread.argmax(axis=1)[node]]
        order = order[np.lexsort((along, node))]
    return order


def _boxes(low: Float, high: Float, leaf_starts: Index) -> Float:
    leaves = len(leaf_starts) - 1
    boxes = np.full((2 * leaves, 6), np.inf)
    boxes[:, 3:] = -np.inf
    if len(low):
        boxes[leaves:, :3] = np.minimum.reduceat(low, leaf_starts[:-1])
        boxes[leaves:, 3:] = np.maximum.reduceat(high, leaf_starts[:-1])
    while leaves > 1:
        leaves //= 2
        children = boxes[2 * leaves : 4 * leaves].reshape(leaves, 2, 6)
        boxes[leaves : 2 * leaves, :3] = children[:, :, :3].min(axis=1)
        boxes[leaves : 2 * leaves, 3:] = children[:, :, 3:].max(axis=1)
    return boxes
