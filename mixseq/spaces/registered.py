"""The parts of frames, registered to their mean shapes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.geometry.rigid import aligning_rotations

SMALLEST = 1e-3
"""Radius of a part that has none, in diagonals."""


def registered(shapes: Float, parts: Sequence[Index], x: FloatArray) -> tuple[Float, Float, Float]:
    """Register parts, vertices of a frame ``(V, 3)``, to their mean shapes ``(N, 3)``, part by part.

    Returns the vertices as aligned to the shapes ``(N, 3)``, rotations ``(p, 3, 3)`` and centres ``(p, 3)``.
    """
    from mixseq.spaces.registered_kernels import centred_parts, turned_back

    ends = np.cumsum([len(vertices) for vertices in parts])
    vertices = np.concatenate(parts)
    moved, centres, covariances = centred_parts(
        np.ascontiguousarray(x, dtype=np.float64), vertices, ends, shapes
    )
    rotations = aligning_rotations(covariances)
    return turned_back(moved, ends, rotations), rotations, centres


def radii_of_gyration(shapes: Float, parts: Sequence[Index]) -> Float:
    """Return the radii of gyration ``(p,)`` of centred shapes ``(N, 3)``, part by part, at least `SMALLEST`."""
    squares = np.square(shapes).sum(axis=1)
    sizes = [len(vertices) for vertices in parts]
    starts = np.cumsum([0, *sizes[:-1]])
    return np.maximum(np.sqrt(np.add.reduceat(squares, starts) / sizes), SMALLEST)
