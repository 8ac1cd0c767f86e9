"""The inner loop of growing regions, compiled: Kruskal's algorithm."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled


@compiled
def kruskal(ends: Index, heights: Float, bottoms: Float, areas: Float) -> tuple[Index, Float, Float]:
    """Join nodes by edges in the order in which these are given.

    Parameters
    ----------
    ends : (m, 2) int64
        Nodes of every edge.
    heights : (m,) float64
        Height of every edge, ascending.
    bottoms, areas : (n,) float64
        Height and area of every node; both are overwritten.

    Returns
    -------
    tree : (k,) int64
        Edges that joined two sets of nodes.
    area : (k,) float64
        Area of the smaller one.
    depth : (k,) float64
        Height of the edge above the bottom of the shallower one.
    """
    parent = np.arange(len(areas))
    tree = np.empty(len(areas), dtype=np.int64)
    area, depth = np.empty(len(areas)), np.empty(len(areas))
    count = 0
    for edge in range(len(ends)):
        a, b = ends[edge]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a == b:
            continue
        tree[count] = edge
        area[count] = min(areas[a], areas[b])
        depth[count] = heights[edge] - max(bottoms[a], bottoms[b])
        count += 1
        if areas[a] < areas[b]:
            a, b = b, a
        parent[b] = a
        areas[a] += areas[b]
        bottoms[a] = min(bottoms[a], bottoms[b])
    return tree[:count], area[:count], depth[:count]
