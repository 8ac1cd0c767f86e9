"""Weights of lengths, angles and rotations in the metric: how far they move vertices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, Index
from mixseq.disk_array import LargeArray
from mixseq.frame_store import blocks_of
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.mapping import Executor
from mixseq.progress import Progress

ANGLE = 0.3
"""Weight of a radian relative to the length of the hinge's edge, in the metrics of all spaces with both."""

SMALLEST = 1e-3
"""Least radius of gyration of a part, in diagonals."""


def radii_of_gyration(shapes: Float, parts: Sequence[Index]) -> Float:
    """Return the radii of gyration ``(p,)`` of centred shapes ``(N, 3)``, part by part, at least `SMALLEST`."""
    squares = np.square(shapes).sum(axis=1)
    sizes = [len(vertices) for vertices in parts]
    starts = np.cumsum([0, *sizes[:-1]])
    return np.maximum(np.sqrt(np.add.reduceat(squares, starts) / sizes), SMALLEST)


def mean_lengths(
    points: LargeArray, edges: NDArray[np.integer], scale: float, workers: Executor, progress: Progress
) -> Float:
    """Return mean lengths ``(E,)`` of edges ``(E, 2)`` over frames ``(T, V, 3)``, in units of the scale."""
    total, done = np.zeros(len(edges)), 0
    for block in workers(_lengths, edges, blocks_of(points)):
        for lengths in block:  # one by one: the sum must not depend on the blocks
            total += lengths
        done += len(block)
        progress(done, len(points), "measuring edges")
    return total / (done * scale)


def _lengths(edges: NDArray[np.integer], points: FloatArray) -> list[Float]:
    return [edge_lengths(frame.astype(np.float64), edges) for frame in points]
