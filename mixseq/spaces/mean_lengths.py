"""Mean edge lengths of a sequence, by which lengths are weighed against each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray
from mixseq.disk_array import LargeArray
from mixseq.frame_store import blocks_of
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.mapping import Executor
from mixseq.progress import Progress


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
