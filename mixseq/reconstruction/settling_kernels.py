"""The inner loop of `mixseq.reconstruction.settling`, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.compiled import compiled

Float = NDArray[np.float64]
Index = NDArray[np.int64]


@compiled
def add_motions(
    blocks: Index,
    pairs: Index,
    derivatives: Float,
    residuals: Float,
    free: int,
    places: Index,
    values: Float,
    gradient: Float,
) -> None:
    """Add what residuals ``(n,)`` know of moving parts to the lower triangle of ``J^T J``, and to ``J^T r``.

    Derivatives ``(n, k, 3)`` are by the triples of unknowns `blocks` ``(n, k)``; the first `free` triples are free
    vertices, whose own blocks are there already.
    """
    for r in range(len(blocks)):
        for a in range(blocks.shape[1]):
            row = blocks[r, a]
            if row < 0:
                continue
            if row >= free:
                for i in range(3):
                    gradient[3 * row + i] += residuals[r] * derivatives[r, a, i]
            for b in range(blocks.shape[1]):
                column = blocks[r, b]
                if column < 0 or column > row or row < free:
                    continue
                # Both orders of two triples of one part are met, so a block of the diagonal gets both products.
                block = pairs[r, a, b]
                for j in range(3):
                    for i in range(j if row == column else 0, 3):
                        values[places[block, j] + i] += derivatives[r, a, i] * derivatives[r, b, j]
