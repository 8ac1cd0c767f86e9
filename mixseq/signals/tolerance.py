"""Promises, of a tolerance and of exact models: no vertex of any decoded frame is off by more, measured.

For a tolerance the coarsest signals are searched for that keep it. Where not even the finest do, nothing is promised.
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
"""What an exact model may be off by in diagonals: rounding. Near the origin it is off by some 1e-15."""

EXACT_STEP = 2.0**-38
"""Step to which signals of exact models are rounded, in diagonals: frames are off by some 1e-11."""

STEPS = 64
"""Signals of other models are rounded to the tolerance over this, or less where that is what is too coarse."""

ENOUGH = 0.6
"""A model is not made coarser if its error is above this fraction of the tolerance."""

ROUNDS = 7
"""At most so many models are tried before the finest of them."""


def within(
    encoded: Encoded,
    sequence: FrameStore | MeshSequence,
    tolerance: float,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> Model:
    """Find signals that reproduce a sequence to a tolerance.

    Slack of the signals and error of the decoded frames grow together, though not evenly; so the slack is scaled
    with the error that was measured, and bisected once it was both too small and too large.
    """
    low, high, slack = 0.0, np.inf, tolerance / 4
    best: Model | None = None
    step = 2.0 ** np.floor(np.log2(tolerance / STEPS))
    errors: dict[bytes, float] = {}  # of what was tried: short sequences have few models
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
    """Tell models of one sequence from each other, by their curves over time."""
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
    """Return a model that keeps a promise at all frames."""
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
    # Every 4th frame first, then those between: what is out of tolerance is out of it at many frames.
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
