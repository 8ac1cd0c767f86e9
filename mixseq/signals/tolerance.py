"""Signals within a tolerance, and exact models: the error of all decoded frames is measured.

For a tolerance the coarsest signals that keep it are searched for. If not even the finest do, an error is raised.
"""

from __future__ import annotations

from hashlib import blake2b

import numpy as np

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.frame_store import FrameStore, block_size, digits_end, farthest, largest_coordinate
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.sequence import MeshSequence, bounding_diagonal
from mixseq.signals.decoding import FRAMES
from mixseq.signals.detail import Detail, Encoded, build
from mixseq.signals.model import Model

LOSSLESS_TO_THE_EYE = 5e-4
"""Default tolerance in diagonals: half a pixel, where a mesh fills a picture of 1000 pixels."""

EXACT = 1e-8
"""Tolerance of exact models in diagonals, for rounding; near the origin the error is some 1e-15."""

EXACT_STEP = 2.0**-38
"""Rounding step of signals of exact models, in diagonals: frames are off by some 1e-11."""

STEPS = 64
"""Ratio of the tolerance to the rounding step of signals; the step is refined where it is too coarse."""

ENOUGH = 0.6
"""Ratio of error to tolerance above which a model is not made coarser."""

ROUNDS = 7
"""Largest number of models that are tried before the finest one."""


def within(
    encoded: Encoded,
    sequence: FrameStore | MeshSequence,
    tolerance: float,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> Model:
    """Find signals that reproduce a sequence to a tolerance.

    Slack of the signals and error of the frames grow together, unevenly: the slack is scaled by the measured error, and
    bisected once it was both too small and too large.
    """
    low, high, slack = 0.0, np.inf, tolerance / 4
    best: Model | None = None
    step = 2.0 ** np.floor(np.log2(tolerance / STEPS))
    errors: dict[bytes, float] = {}  # of tried models: short sequences have few
    for number in range(ROUNDS):
        progress(number, ROUNDS, "choosing modes and knots")
        model = build(encoded, Detail(slack=slack, step=step))
        signals = _digest(model)
        if signals not in errors:
            errors[signals] = largest_error(model, sequence, 2 * tolerance, workers)
        elif errors[signals] > tolerance:  # these are all modes and knots
            step /= 2
        error = errors[signals]
        if error <= tolerance:
            low, best = slack, model
            if error > ENOUGH * tolerance or len(model.shapes) == 1 or number > ROUNDS // 2:
                break
        else:
            high = slack
        scaled = slack * float(np.clip(0.8 * tolerance / max(error, tolerance / 100), 0.1, 10.0))
        slack = scaled if low < scaled < high else float(np.sqrt(max(low, high / 100) * high))
    progress(ROUNDS, ROUNDS, "choosing modes and knots")
    if best is not None:
        return best
    finest = build(encoded, Detail(step=min(step, EXACT_STEP)))
    return made_sure(finest, sequence, tolerance, workers)


def _digest(model: Model) -> bytes:
    """Hash the curves of a model, to compare models of one sequence."""
    digest = blake2b()
    for curve in model.curves:
        digest.update(curve.times.data)
        digest.update(np.ascontiguousarray(curve.values).data)
    return digest.digest()


def made_sure(
    model: Model,
    sequence: FrameStore | MeshSequence,
    promise: float,
    workers: Executor | None = None,
    progress: Progress = silent,
) -> Model:
    """Return a model after verifying the tolerance `promise` at all frames."""
    error = largest_error(model, sequence, workers=workers)
    progress(1, 1, "checking")
    if error <= promise:
        return model
    missed = (
        f"{sequence.header.name!r}: a vertex of the most accurate model is off by {error:.3g} diagonals, more than "
        f"{promise:g}"
    )
    unit = bounding_diagonal(sequence.points[:1][0]) or 1.0
    away, largest = farthest(sequence.points), largest_coordinate(sequence.points)
    if promise * unit < digits_end(away):  # wherever the sequence is
        raise SettingsError(
            f"{missed}: vertices get up to {away / unit:.3g} diagonals of the first frame away from it, beside which "
            "double precision has no digits for that; give a larger tolerance, or fit the frames that have grown or "
            "moved so far apart from the first ones"
        )
    if promise * unit < digits_end(largest):
        raise SettingsError(
            f"{missed}: coordinates are up to {largest / unit:.3g} diagonals, beside which double precision has no "
            "digits for that; move the sequence to the origin, or give a larger tolerance"
        )
    raise ReconstructionError(f"{missed}; give a larger tolerance, or another space or placement")


def largest_error(
    model: Model,
    sequence: FrameStore | MeshSequence,
    stop: float = np.inf,
    workers: Executor | None = None,
) -> float:
    """Return the largest distance of a vertex at the frames, in diagonals."""
    unit = bounding_diagonal(sequence.points[:1][0]) or 1.0
    # Every 4th frame first, then those between: violations occur at many frames.
    frames = np.concatenate([np.arange(first, len(sequence.points), 4) for first in (0, 2, 1, 3)])
    largest, done = 0.0, 0
    size = min(FRAMES, block_size(sequence.header.vertex_count))
    for block in model.blocks(model.times[frames], size, workers=workers):
        apart = block - sequence.points[frames[done : done + len(block)]]
        error = float(np.sqrt(np.einsum("tvi,tvi->tv", apart, apart).max())) / unit
        if not np.isfinite(error):
            return np.inf
        largest, done = max(largest, error), done + len(block)
        if largest > stop:
            break
    return largest
