"""Where a mesh goes through itself."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.geometry.box_tree import BoxTree, corners_of, unit_normals

TOUCH = 1e-12
"""Depths and lengths up to this, in diagonals of the mesh's bounding box, are contact, not crossing; ours."""


def self_intersections(points: FloatArray, faces: IntArray) -> Index:
    """Find the pairs of triangles that cross each other and have no corner in common.

    Triangles cross if each has corners on both sides of the other's plane, and they share a segment of some length
    (`TOUCH`). Contact does not count: corners or sides that end in the other triangle, and triangles that overlap in
    one plane. Neither do triangles without area. Corners are in common also if they are different vertices at the
    same place, as at seams.

    Shapes: points ``(V, 3)``; faces ``(F, 3)``; result ``(k, 2)``.

    Examples
    --------
    >>> points = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [1, 1, -1], [1, 1, 1], [0, 2, 1]])
    >>> self_intersections(points, np.array([[0, 1, 2], [3, 4, 5]])).tolist()
    [[0, 1]]
    """
    from mixseq.geometry.box_tree_kernels import crossing_pairs

    corners = corners_of(points, faces)
    tree = BoxTree.of(corners)
    sizes = tree.boxes[1, 3:] - tree.boxes[1, :3]
    least = TOUCH * float(np.sqrt(sizes @ sizes)) if len(corners) else 0.0
    order = tree.order
    arrays = corners[order], unit_normals(corners)[order], _places(corners)[order]
    pairs = np.empty((len(corners), 2), dtype=np.int64)
    count = crossing_pairs(*arrays, order, tree.firsts, tree.boxes, least, pairs)
    if count > len(pairs):
        pairs = np.empty((count, 2), dtype=np.int64)
        crossing_pairs(*arrays, order, tree.firsts, tree.boxes, least, pairs)
    pairs = pairs[:count]
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _places(corners: Float) -> Index:
    """Number ``(F, 3)`` the positions of corners: the same number at the same position."""
    flat = corners.reshape(-1, 3)
    order = np.lexsort(flat.T)
    new = (np.diff(flat[order], axis=0, prepend=np.nan) != 0).any(axis=1)
    result = np.empty(len(flat), dtype=np.int64)
    result[order] = np.cumsum(new)
    return result.reshape(-1, 3)
