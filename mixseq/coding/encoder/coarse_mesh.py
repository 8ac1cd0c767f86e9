"""A mesh with fewer vertices, for comparing candidates on a large one.

Its vertices are those coded first, its edges those that close the holes of the others
(`mixseq.coding.bitstream.signal_graph`): its streams resemble the first ones of the whole mesh.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.signal_graph import MOST, coarser_levels, mesh_neighbours


def coarse_mesh(faces: NDArray[np.integer], vertex_count: int, most: int) -> tuple[Index, Index]:
    """Remove vertices until at most `most` are left: faces ``(F, 3)``; result ``(n,)``, ``(E, 3)``."""
    starts, beside = mesh_neighbours(faces, vertex_count)
    left = np.ones(vertex_count, dtype=bool)
    scratch = np.zeros((vertex_count, MOST), dtype=np.int64), np.zeros(vertex_count, dtype=np.int64)
    for level in coarser_levels(starts, beside, *scratch):
        left[level.gone] = False
        starts, beside = level.new_starts, level.new_beside
        if np.count_nonzero(left) <= most:
            break
    edges = np.stack([np.repeat(np.arange(vertex_count), np.diff(starts)), beside], axis=1)
    vertices = np.flatnonzero(left)
    edges = np.searchsorted(vertices, edges[edges[:, 0] < edges[:, 1]])
    return vertices, edges[:, [0, 1, 1]]
