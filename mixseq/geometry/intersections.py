"""Self-intersections of a mesh."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.geometry.box_tree import BoxTree, corners_of, unit_normals

TOUCH = 1e-12
"""Depths and lengths up to this, in diagonals of the mesh's bounding box, are contact."""


def self_intersections(points: FloatArray, faces: IntArray) -> Index:
    """Find pairs ``(k, 2)`` of triangles ``(F, 3)`` of points ``(V, 3)`` that cross and have no common corner.

    Each has corners on both sides of the other's plane, and they share a segment longer than `TOUCH`. Contact, overlap
    in one plane, and triangles without area do not count. Vertices at the same place, as at seams, are common corners.
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
    """Number the positions ``(F, 3)`` of corners, equal ones alike."""
    flat = corners.reshape(-1, 3)
    order = np.lexsort(flat.T)
    new = (np.diff(flat[order], axis=0, prepend=np.nan) != 0).any(axis=1)
    result = np.empty(len(flat), dtype=np.int64)
    result[order] = np.cumsum(new)
    return result.reshape(-1, 3)
