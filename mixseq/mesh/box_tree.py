r"""A tree of bounding boxes of triangles, for searches near a point or a box.

The tree is complete and binary, without pointers: node 1 is the root, node n has the children 2n and 2n + 1, and the
last L = 2^d nodes are the leaves. Level l divides the triangles, in the order of the tree, into 2^l ranges of equal
size. Its j-th node has the positions from floor(F j / 2^l) to floor(F (j + 1) / 2^l). A node is split at the median of
its triangles' box centres, along the axis in which the centres extend most (Bentley 1975, "Multidimensional binary
search trees used for associative searching").

*Closest points.* With corners a, b, c relative to the query, the closest point of a triangle is the closest of four:

- on each side :math:`pq` the point :math:`p + t (q - p)`, with :math:`t = -p \cdot (q - p) / |q - p|^2` within [0, 1];
- the foot of the perpendicular, if it is inside: with :math:`n = (b - a) \times (c - a)` it has the weights
  :math:`w_b = n \cdot (c \times a) / |n|^2` and :math:`w_c = n \cdot (a \times b) / |n|^2`.

The foot is inaccurate for slivers and undefined for triangles without area, but the points on sides are accurate. So
all four points are compared, instead of selecting a region (Ericson, Real-Time Collision Detection, 2005, 5.1.5).

*Crossings.* Two triangles cross (Möller 1997, "A fast triangle-triangle intersection test") if each has corners on both
sides of the other's plane, and their segments on the intersection line of the planes overlap. With unit normals n, m
the line has the direction :math:`n \times m`. Points on the line are compared by the coordinate in which the direction
is largest, which keeps their order. From a corner at distance d, alone on its side of the plane, a side to a corner at
distance e meets the plane at the fraction :math:`d / (d - e)`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.errors import InvalidSequenceError
from mixseq.runtime.jit import compiled
from mixseq.types import Float, FloatArray, Index, IntArray

PRUNING_FACTOR = 1.0 - 1e-14  # rounding may put a box farther away than a triangle in it
COSINE_TOLERANCE = 1e-14  # rounding error of bounds of cosines


@compiled
def _closest_on_segment(p0: float, p1: float, p2: float, q0: float, q1: float, q2: float) -> tuple[float, float]:
    """Return the squared distance from the origin to the segment pq, and the weight of q at the closest point."""
    e0, e1, e2 = q0 - p0, q1 - p1, q2 - p2
    square = e0 * e0 + e1 * e1 + e2 * e2
    t = -(p0 * e0 + p1 * e1 + p2 * e2)
    t = 0.0 if t <= 0.0 else 1.0 if t >= square else t / square
    if t == 1.0:  # use the exact corner, so that all triangles around it have equal distances
        return q0 * q0 + q1 * q1 + q2 * q2, t
    r0, r1, r2 = p0 + t * e0, p1 + t * e1, p2 + t * e2
    return r0 * r0 + r1 * r1 + r2 * r2, t


@compiled
def _closest_on_triangle(corners: Float, q0: float, q1: float, q2: float) -> tuple[float, float, float]:
    """Return the squared distance from a query to a triangle abc, and the closest point's weights of b and c."""
    a0, a1, a2 = corners[0, 0] - q0, corners[0, 1] - q1, corners[0, 2] - q2
    b0, b1, b2 = corners[1, 0] - q0, corners[1, 1] - q1, corners[1, 2] - q2
    c0, c1, c2 = corners[2, 0] - q0, corners[2, 1] - q1, corners[2, 2] - q2
    best, second = _closest_on_segment(a0, a1, a2, b0, b1, b2)
    third = 0.0
    square, t = _closest_on_segment(a0, a1, a2, c0, c1, c2)
    if square < best:
        best, second, third = square, 0.0, t
    square, t = _closest_on_segment(b0, b1, b2, c0, c1, c2)
    if square < best:
        best, second, third = square, 1.0 - t, t
    u0, u1, u2 = b0 - a0, b1 - a1, b2 - a2
    v0, v1, v2 = c0 - a0, c1 - a1, c2 - a2
    n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
    square = n0 * n0 + n1 * n1 + n2 * n2
    s = (n0 * (v1 * a2 - v2 * a1) + n1 * (v2 * a0 - v0 * a2) + n2 * (v0 * a1 - v1 * a0)) / square
    t = (n0 * (a1 * u2 - a2 * u1) + n1 * (a2 * u0 - a0 * u2) + n2 * (a0 * u1 - a1 * u0)) / square
    if s > 0.0 and t > 0.0 and s + t < 1.0:  # false for NaN, where the square is 0
        r0, r1, r2 = a0 + s * u0 + t * v0, a1 + s * u1 + t * v1, a2 + s * u2 + t * v2
        square = r0 * r0 + r1 * r1 + r2 * r2
        if square < best:
            best, second, third = square, s, t
    return best, second, third


@compiled
def _box_distance(box: Float, q0: float, q1: float, q2: float) -> float:
    """Return the squared distance from a query to a box."""
    d0 = max(box[0] - q0, q0 - box[3], 0.0)
    d1 = max(box[1] - q1, q1 - box[4], 0.0)
    d2 = max(box[2] - q2, q2 - box[5], 0.0)
    square: float = d0 * d0 + d1 * d1 + d2 * d2
    return square


@compiled
def _is_outside_cone(bounds: Float, m0: float, m1: float, m2: float, min_cosine: float) -> bool:
    """Return whether all normals within the bounds have a cosine below `min_cosine` with m; true for empty bounds."""
    product = m0 * (bounds[3] if m0 > 0.0 else bounds[0])
    product += m1 * (bounds[4] if m1 > 0.0 else bounds[1])
    product += m2 * (bounds[5] if m2 > 0.0 else bounds[2])
    return not product >= min_cosine - COSINE_TOLERANCE


@compiled
def closest(
    corners: Float,
    normals: Float,
    order: Index,
    leaf_starts: Index,
    boxes: Float,
    normal_bounds: Float,
    queries: Float,
    directions: Float,
    min_cosine: float,
    max_distance: float,
    faces: Index,
    weights: Float,
    distances: Float,
) -> None:
    """Write the triangle, weights and distance of the closest point to every query, up to `max_distance`.

    Corners and normals are in the order of the tree; boxes and bounds of normals are per node. If `directions` are
    given, only triangles whose normal has a cosine of at least `min_cosine` with the query's direction are searched.
    """
    leaves = len(leaf_starts) - 1
    nodes = np.empty(64, dtype=np.int64)
    node_squares = np.empty(64)
    has_directions = len(directions) > 0
    first_best = max_distance * max_distance / PRUNING_FACTOR  # above all squares whose root is `max_distance`
    for k in range(len(queries)):
        q0, q1, q2 = queries[k, 0], queries[k, 1], queries[k, 2]
        best, face, second, third = first_best, -1, 0.0, 0.0
        nodes[0], node_squares[0] = 1, 0.0
        height = 1
        while height > 0:
            height -= 1
            if not node_squares[height] * PRUNING_FACTOR <= best:
                continue
            node = nodes[height]
            if has_directions and _is_outside_cone(
                normal_bounds[node], directions[k, 0], directions[k, 1], directions[k, 2], min_cosine
            ):
                continue
            if node < leaves:
                near, far = 2 * node, 2 * node + 1
                near_square = _box_distance(boxes[near], q0, q1, q2)
                far_square = _box_distance(boxes[far], q0, q1, q2)
                if far_square < near_square:
                    near, far, near_square, far_square = far, near, far_square, near_square
                nodes[height], node_squares[height] = far, far_square
                nodes[height + 1], node_squares[height + 1] = near, near_square
                height += 2
                continue
            for position in range(leaf_starts[node - leaves], leaf_starts[node - leaves + 1]):
                if has_directions:
                    product = (
                        normals[position, 0] * directions[k, 0]
                        + normals[position, 1] * directions[k, 1]
                        + normals[position, 2] * directions[k, 2]
                    )
                    if not product >= min_cosine:  # also true for NaN
                        continue
                square, s, t = _closest_on_triangle(corners[position], q0, q1, q2)
                if square < best or (square == best and (face < 0 or order[position] < face)):
                    best, face, second, third = square, order[position], s, t
        distances[k] = np.sqrt(best)
        if face < 0 or distances[k] > max_distance:
            face, distances[k] = -1, np.inf
        faces[k] = face
        weights[k, 0], weights[k, 1], weights[k, 2] = 1.0 - second - third, second, third


@compiled
def _corner_alone(distances: Float, corners: Float, normal: Float, origin: Float, tolerance: float) -> int:
    """Write the distances of corners from a plane; return the only corner on one side, -1 if a side has no corner."""
    above = below = 0
    for k in range(3):
        distance = 0.0
        for i in range(3):
            distance += normal[i] * (corners[k, i] - origin[i])
        if distance > tolerance:
            above += 1
        elif distance < -tolerance:
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
def _plane_interval(distances: Float, corners: Float, corner: int, axis: int, origin: float) -> tuple[float, float]:
    """Return the interval of the coordinate, relative to `origin`, in which a triangle intersects a plane."""
    p, q, r = corner, (corner + 1) % 3, (corner + 2) % 3
    x = corners[p, axis] - origin
    first = x + (corners[q, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[q]))
    second = x + (corners[r, axis] - corners[p, axis]) * (distances[p] / (distances[p] - distances[r]))
    return min(first, second), max(first, second)


@compiled
def _cross(f: Float, g: Float, n: Float, m: Float, tolerance: float, scratch: Float) -> bool:
    """Return whether triangles f, g with normals n, m cross by more than the tolerance; scratch is ``(3, 3)``."""
    f_distances, g_distances, direction = scratch[0], scratch[1], scratch[2]
    g_corner = _corner_alone(g_distances, g, n, f[0], tolerance)
    if g_corner < 0:
        return False
    f_corner = _corner_alone(f_distances, f, m, g[0], tolerance)
    if f_corner < 0:
        return False
    direction[0] = abs(n[1] * m[2] - n[2] * m[1])
    direction[1] = abs(n[2] * m[0] - n[0] * m[2])
    direction[2] = abs(n[0] * m[1] - n[1] * m[0])
    axis = 0
    for i in range(1, 3):
        if direction[i] > direction[axis]:
            axis = i
    low, high = _plane_interval(f_distances, f, f_corner, axis, f[0, axis])
    start, end = _plane_interval(g_distances, g, g_corner, axis, f[0, axis])
    return min(high, end) - max(low, start) > tolerance


@compiled
def crossing_pairs(
    corners: Float,
    normals: Float,
    position_ids: Index,
    order: Index,
    leaf_starts: Index,
    boxes: Float,
    tolerance: float,
    pairs: Index,
) -> int:
    """Count pairs of crossing triangles without a common corner position; write the first pairs ``(n, 2)`` that fit.

    Corners ``(F, 3, 3)``, unit normals and the corners' `position_ids` ``(F, 3)`` are in the order of the tree. Depths
    and lengths up to the tolerance are contact. Triangles without area (normal NaN) are skipped. Pairs are ascending.
    """
    leaves = len(leaf_starts) - 1
    nodes = np.empty(64, dtype=np.int64)
    scratch, low, high = np.empty((3, 3)), np.empty(3), np.empty(3)
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
                is_shared = False
                for i in range(3):
                    for k in range(3):
                        is_shared |= position_ids[a, i] == position_ids[b, k]
                if is_shared or not _cross(f, corners[b], normals[a], normals[b], tolerance, scratch):
                    continue
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = min(order[a], order[b]), max(order[a], order[b])
                count += 1
    return count


MAX_LEAF_TRIANGLES = 4  # queries take the same time with 2 to 8
BOX_MARGIN = 1e-14  # margin against rounding, relative to the largest coordinate
MIN_QUERIED_HEIGHT_RATIO = 1e-12  # ratio of height to longest side up to which a queried triangle has no normal


def triangle_corners(points: FloatArray, faces: IntArray) -> Float:
    """Return the corners ``(F, 3, 3)`` of the triangles ``(F, 3)`` of points ``(V, 3)``."""
    points, faces = np.asarray(points, dtype=np.float64), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise InvalidSequenceError(
            f"points of shape {points.shape} and faces of shape {faces.shape} are not a triangle mesh; "
            "give points (V, 3) and faces (F, 3)"
        )
    is_invalid = (faces < 0) | (faces >= len(points))
    if is_invalid.any():
        face = int(is_invalid.any(axis=1).argmax())
        raise InvalidSequenceError(
            f"triangle {face} has vertices {faces[face].tolist()}, but there are {len(points)} points; "
            f"vertices are numbered from 0 to {len(points) - 1}"
        )
    corners = np.ascontiguousarray(points[faces], dtype=np.float64)
    is_finite = np.isfinite(corners)
    if not is_finite.all():
        raise InvalidSequenceError(
            f"triangle {int(is_finite.all(axis=(1, 2)).argmin())} has a corner that is not finite; give finite points"
        )
    return corners


def unit_normals(corners: Float) -> Float:
    """Return the unit normals ``(F, 3)`` of triangles ``(F, 3, 3)``; NaN for triangles without area."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("fki,fki->fk", sides, sides).max(axis=1, initial=0.0)
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(normals / np.where(areas > MIN_QUERIED_HEIGHT_RATIO * longest, areas, np.nan)[:, None])


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A tree of bounding boxes of triangles."""

    order: Index  # (F,) triangle at every position of the tree
    leaf_starts: Index  # (L + 1,) first position of every leaf, followed by F
    # (2 L, 6) least and largest x, y, z of every node; inf and -inf for empty nodes.
    boxes: Float

    @classmethod
    def from_triangles(cls, corners: Float, order: Index | None = None) -> BoxTree:
        """Build the tree of triangles ``(F, 3, 3)``, optionally in the order of the tree of similar triangles.

        Equal triangles give equal trees. The order decides how fast a search is, and not what it finds.
        """
        a, b, c = corners.transpose(1, 0, 2)  # NumPy reduces short axes slowly
        low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
        depth = max((len(corners) - 1) // MAX_LEAF_TRIANGLES, 0).bit_length()
        order = _tree_order(low + high, depth) if order is None else order
        leaf_starts = _range_starts(len(corners), 1 << depth)
        margin = BOX_MARGIN * max(-low.min(initial=0.0), high.max(initial=0.0))
        return cls(order, leaf_starts, _node_boxes(low[order] - margin, high[order] + margin, leaf_starts))

    def node_bounds(self, values: Float) -> Float:
        """Return the bounds ``(2 L, 6)`` in every node of the values ``(F, 3)`` of its triangles, ignoring NaN."""
        values = values[self.order]
        low, high = (np.where(np.isnan(values), empty, values) for empty in (np.inf, -np.inf))
        return _node_boxes(low, high, self.leaf_starts)


def _range_starts(count: int, range_count: int) -> Index:
    """Return the ``(range_count + 1,)`` limits of ranges of equal size."""
    return np.asarray(count * np.arange(range_count + 1) // range_count, dtype=np.int64)


def _tree_order(centres: Float, depth: int) -> Index:
    """Sort triangles with centres ``(F, 3)`` level by level, along the axis of largest extent of every node."""
    order = np.arange(len(centres))
    for level in range(depth):
        starts = _range_starts(len(centres), 1 << level)
        sorted_centres = centres[order]
        low, high = (extreme.reduceat(sorted_centres, starts[:-1]) for extreme in (np.minimum, np.maximum))
        node = np.repeat(np.arange(1 << level), np.diff(starts))
        coordinates = sorted_centres[np.arange(len(order)), (high - low).argmax(axis=1)[node]]
        order = order[np.lexsort((coordinates, node))]
    return order


def _node_boxes(low: Float, high: Float, leaf_starts: Index) -> Float:
    """Return the boxes ``(2 L, 6)`` of nodes, given triangle boxes from `low` to `high` ``(F, 3)`` in tree order."""
    leaves = len(leaf_starts) - 1
    boxes = np.full((2 * leaves, 6), np.inf)
    boxes[:, 3:] = -np.inf
    if len(low):
        boxes[leaves:, :3] = np.minimum.reduceat(low, leaf_starts[:-1])
        boxes[leaves:, 3:] = np.maximum.reduceat(high, leaf_starts[:-1])
    while leaves > 1:
        leaves //= 2
        first, second = boxes[2 * leaves : 4 * leaves : 2], boxes[2 * leaves + 1 : 4 * leaves : 2]
        boxes[leaves : 2 * leaves, :3] = np.minimum(first[:, :3], second[:, :3])
        boxes[leaves : 2 * leaves, 3:] = np.maximum(first[:, 3:], second[:, 3:])
    return boxes
