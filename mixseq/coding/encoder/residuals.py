"""The residual layer of an encoder: displacements where decoded frames are farther than a bound from the original."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.residual_layer import write_residuals
from mixseq.coding.encoder.trial import Trial
from mixseq.frame_store import FrameStore


def width(bound: float) -> float:
    """Return the unit w of the residual layer for a bound, both in the units of the sequence."""
    return float(2.0 * bound / np.sqrt(3.0))


def needed(apart: Float, bound: float) -> Index:
    r"""Return the residuals ``(T, V, 3)`` that bring differences ``(T, V, 3)`` within a bound :math:`\varepsilon`.

    Where a difference exceeds the bound, it is rounded to multiples of :math:`w = 2 \varepsilon / \sqrt 3` in every
    coordinate, which leaves at most :math:`w / 2` in each, so :math:`\varepsilon` in all. Elsewhere residuals are zero.
    """
    far = np.einsum("tvi,tvi->tv", apart, apart) > bound * bound
    return np.where(far[..., None], np.rint(apart / width(bound)), 0.0).astype(np.int64)


def with_residuals(sequence: FrameStore, trial: Trial, bound: float) -> Trial:
    """Return a trial with the residual layer that keeps a bound, in the units of the sequence."""

    def numbers(frame: int) -> NDArray[np.int64]:
        one = slice(frame, frame + 1)
        apart = np.asarray(sequence.points[one] - trial.basis.frames(trial.coefficients[one]))
        return np.asarray(needed(apart, bound)[0])

    layers = (write_residuals(numbers, frames, trial.candidate.graph) for frames in trial.spans)
    return replace(trial, residuals=tuple(layers), bound=bound)
