"""A mesh with fewer vertices, on which ways to code a large one are compared quickly.

Its vertices are those that are coded first, its edges those that close the holes that the others leave
(`mixseq.coding.bitstream.signal_graph`): what is coded of it is about what is coded first of the whole mesh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.signal_graph import MOST, coarser_levels


def coarse_mesh(faces: NDArray[np.integer], vertex_count: int, most: int) -> tuple[Index, Index]:
    """Take vertices away until there are few enough.

    Parameters
    ----------
    faces : (F, 3) int
        Triangles.
    vertex_count : int
        Number V of vertices.
    most : int
        So many vertices are few enough; more are left where edges do not hold them together.

    Returns
    -------
    vertices : (n,) int64
        Those that are left, increasing.
    faces : (E, 3) int64
        The edges between them, as triangles with two corners at one vertex.
    """
    ends = np.sort(
        np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64), axis=1
    )
    keys = np.unique(ends[ends[:, 0] < ends[:, 1]] @ np.array([vertex_count, 1]))
    edges = np.stack(np.divmod(keys, vertex_count), axis=1)
    left = np.ones(vertex_count, dtype=bool)
    scratch = np.zeros((vertex_count, MOST), dtype=np.int64), np.zeros(vertex_count, dtype=np.int64)
    for level in coarser_levels(edges, vertex_count, *scratch):
        left[level.gone] = False
        edges = np.stack(
            [np.repeat(np.arange(vertex_count), np.diff(level.new_starts)), level.new_beside], axis=1
        )
        if np.count_nonzero(left) <= most:
            break
    vertices = np.flatnonzero(left)
    edges = np.searchsorted(vertices, edges[edges[:, 0] < edges[:, 1]])
    return vertices, edges[:, [0, 1, 1]]
