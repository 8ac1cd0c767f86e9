"""Registration of parts of frames to their mean shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.compiled import compiled
from mixseq.geometry.rigid import aligning_rotations


@compiled
def centred_parts(x: Float, vertices: Index, ends: Index, shapes: Float) -> tuple[Float, Float, Float]:
    """Return centred part vertices ``(N, 3)``, centres ``(p, 3)``, and products with shapes ``(p, 3, 3)``."""
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
    """Return part vertices ``(N, 3)`` rotated by the inverse rotations of parts ``(p, 3, 3)``."""
    result = np.empty((len(moved), 3))
    start = 0
    for part in range(len(ends)):
        r = rotations[part]
        for row in range(start, ends[part]):
            for i in range(3):
                result[row, i] = moved[row, 0] * r[0, i] + moved[row, 1] * r[1, i] + moved[row, 2] * r[2, i]
        start = ends[part]
    return result


def registered(shapes: Float, parts: Sequence[Index], x: FloatArray) -> tuple[Float, Float, Float]:
    """Register parts of a frame to mean shapes ``(N, 3)``; return aligned vertices, rotations and centres per part."""
    from mixseq.spaces.registered import centred_parts, turned_back

    ends = np.cumsum([len(vertices) for vertices in parts])
    vertices = np.concatenate(parts)
    moved, centres, covariances = centred_parts(
        np.ascontiguousarray(x, dtype=np.float64), vertices, ends, shapes
    )
    rotations = aligning_rotations(covariances)
    return turned_back(moved, ends, rotations), rotations, centres
