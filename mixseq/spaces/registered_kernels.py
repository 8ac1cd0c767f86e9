"""The inner loops of `mixseq.spaces.registered`, compiled: what registering all parts of a frame looks at."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled


@compiled
def centred_parts(x: Float, vertices: Index, ends: Index, shapes: Float) -> tuple[Float, Float, Float]:
    """Return part vertices ``(N, 3)`` about their centres, these ``(p, 3)``, and products with shapes ``(p, 3, 3)``."""
    moved = np.empty((len(vertices), 3))
    centres, covariances = np.zeros((len(ends), 3)), np.zeros((len(ends), 3, 3))
    start = 0
    for part in range(len(ends)):
        for row in range(start, ends[part]):
            for i in range(3):
                moved[row, i] = x[vertices[row], i]
                centres[part, i] += moved[row, i]
        for i in range(3):
            centres[part, i] /= ends[part] - start
        for row in range(start, ends[part]):
            for i in range(3):
                moved[row, i] -= centres[part, i]
                for j in range(3):
                    covariances[part, i, j] += moved[row, i] * shapes[row, j]
        start = ends[part]
    return moved, centres, covariances


@compiled
def turned_back(moved: Float, ends: Index, rotations: Float) -> Float:
    """Return part vertices ``(N, 3)``, each times the rotation ``(p, 3, 3)`` of its part: turned by its inverse."""
    result = np.empty((len(moved), 3))
    start = 0
    for part in range(len(ends)):
        r = rotations[part]
        for row in range(start, ends[part]):
            for i in range(3):
                result[row, i] = moved[row, 0] * r[0, i] + moved[row, 1] * r[1, i] + moved[row, 2] * r[2, i]
        start = ends[part]
    return result
