"""A tree of bounding boxes of triangles, for searches near a point or a box.

The tree is complete and binary, without pointers: node 1 is the root, node n has the children 2n and 2n + 1, and the
last L = 2^d nodes are the leaves. Level l splits the triangles, in the order of the tree, into 2^l ranges of equal
size: its j-th node has the places from floor(F j / 2^l) to floor(F (j + 1) / 2^l). A node's triangles are divided at
the median of their boxes' centres along the axis in which the centres spread most (Bentley 1975, "Multidimensional
binary search trees used for associative searching").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.errors import InvalidSequenceError

LEAF = 4
"""Largest number of triangles in a leaf; from 2 to 8 times are the same."""

MARGIN = 1e-14
"""Enlargement of boxes, relative to the largest coordinate, against rounding."""

NO_AREA = 1e-12
"""Ratio of height to longest side below which triangles have no area: their normals are rounding."""


def corners_of(points: FloatArray, faces: IntArray) -> Float:
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
    """Return the unit normals ``(F, 3)`` of triangles ``(F, 3, 3)``; NaN for those without area (`NO_AREA`)."""
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("fki,fki->fk", sides, sides).max(axis=1, initial=0.0)
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(normals / np.where(areas > NO_AREA * longest, areas, np.nan)[:, None])


@dataclass(frozen=True, eq=False)
class BoxTree:
    """A tree of bounding boxes of triangles."""

    order: Index  # (F,) triangle at every place of the tree
    firsts: Index  # (L + 1,) first place of every leaf, and F
    # (2 L, 6) least x, y, z and largest x, y, z of every node; infinite and minus infinite where a node is empty.
    boxes: Float

    @classmethod
    def of(cls, corners: Float) -> BoxTree:
        """Build the tree of triangles ``(F, 3, 3)``, deterministically."""
        low, high = corners.min(axis=1), corners.max(axis=1)
        depth = max((len(corners) - 1) // LEAF, 0).bit_length()
        order = _order(low + high, depth)
        firsts = _firsts(len(corners), 1 << depth)
        margin = MARGIN * max(-low.min(initial=0.0), high.max(initial=0.0))
        return cls(order, firsts, _boxes(low[order] - margin, high[order] + margin, firsts))

    def bounds(self, values: Float) -> Float:
        """Return the bounding boxes ``(2 L, 6)`` of values ``(F, 3)`` of the triangles in every node, ignoring NaN."""
        values = values[self.order]
        low, high = (np.where(np.isnan(values), none, values) for none in (np.inf, -np.inf))
        return _boxes(low, high, self.firsts)


def _firsts(count: int, parts: int) -> Index:
    return np.asarray(count * np.arange(parts + 1) // parts, dtype=np.int64)


def _order(centres: Float, depth: int) -> Index:
    order = np.arange(len(centres))
    for level in range(depth):
        firsts = _firsts(len(centres), 1 << level)
        at = centres[order]
        spread = np.maximum.reduceat(at, firsts[:-1]) - np.minimum.reduceat(at, firsts[:-1])
        node = np.repeat(np.arange(1 << level), np.diff(firsts))
        along = at[np.arange(len(order)), spread.argmax(axis=1)[node]]
        order = order[np.lexsort((along, node))]
    return order


def _boxes(low: Float, high: Float, firsts: Index) -> Float:
    leaves = len(firsts) - 1
    boxes = np.full((2 * leaves, 6), np.inf)
    boxes[:, 3:] = -np.inf
    if len(low):
        boxes[leaves:, :3] = np.minimum.reduceat(low, firsts[:-1])
        boxes[leaves:, 3:] = np.maximum.reduceat(high, firsts[:-1])
    while leaves > 1:
        leaves //= 2
        children = boxes[2 * leaves : 4 * leaves].reshape(leaves, 2, 6)
        boxes[leaves : 2 * leaves, :3] = children[:, :, :3].min(axis=1)
        boxes[leaves : 2 * leaves, 3:] = children[:, :, 3:].max(axis=1)
    return boxes
