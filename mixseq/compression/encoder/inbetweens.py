"""Find the in-betweens: numbers with which players show the motion of the fitted model between frames.

A spline of the vertices through the frames shrinks parts that rotate. The model that is fitted to the decoded frames
does not. At the middles between frames, the offsets of its vertices from the spline are projected to a basis by least
squares, rounded, and coded like the coefficients at the frames. The spline then also passes through the middles, and
the next level follows, at the middles between its knots. Levels end when the spline is as near to the model as the
frames are to the original, or when a level does not pay.

The basis is the spatial basis, or if that is nearer to the model, the affine basis of the labelled parts: few frames
that differ much have a spatial basis that does not contain the poses between them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.compressed_sequence import (
    MAX_INBETWEEN_LEVELS,
    CompressedSequence,
    Playback,
    inbetween_intervals,
    parts_basis_of,
)
from mixseq.compression.bitstream.signal_coder import Signal
from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.encoder.components import solve_damped
from mixseq.compression.encoder.trial import code_coefficients, round_coefficients
from mixseq.errors import MixseqError, MixseqWarning, SettingsError
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.progress import Progress
from mixseq.sequence.sequence import block_size
from mixseq.signals.decoding import largest_distance, quarter_times
from mixseq.signals.model import Model
from mixseq.spaces.temporal import insert_midpoints
from mixseq.types import Float

MAX_SIZE_RATIO = 0.15  # largest ratio of the bytes of in-betweens to those of basis, coefficients and residual layer
MAX_ERROR_RATIO = 0.8  # largest ratio of root mean square errors, after to before a level, at which the level is kept
ROUNDING_RATIO = 0.2  # ratio of mean squares: rounding errors of in-betweens to distances of the basis from the model
MAX_COMPARED_LEVELS = 2  # number of levels at whose times two bases are compared: middles and quarters of frames
STEP_FACTORS = (1, 2, 4, 8, 16, 32)  # multiples of the step tried for the middles, until the bytes suffice


class Levels(NamedTuple):
    """Levels of in-betweens in a basis."""

    playback: Playback  # with the levels
    streams: list[bytes]  # of every chunk
    step: float  # quantisation step
    largest: float  # largest distance from the model


def add_inbetweens(
    coded: CompressedSequence, playback: Playback, size: int | None, between: bool, progress: Progress
) -> CompressedSequence:
    """Add in-betweens to a compressed sequence of two or more frames, and the error between frames.

    `size` is the largest number of bytes of the signals; None allows `MAX_SIZE_RATIO` more bytes than without. If the
    bound is to be kept `between` frames, levels take as many bytes as they need.
    """
    parameters = coded.parameters
    bytes_at_frames = sum(map(len, coded.basis)) + sum(len(c.coefficients) + len(c.residuals) for c in coded.chunks)
    max_bytes = MAX_SIZE_RATIO * bytes_at_frames if size is None else size - bytes_at_frames
    max_bytes, max_error_ratio = (np.inf, np.inf) if between else (max_bytes, MAX_ERROR_RATIO)
    try:
        model = CompressedModel.from_playbacks([playback]).fit(progress)
    except MixseqError as error:
        if between:
            raise
        warnings.warn(
            f"there are no in-betweens, as no model fits the decoded frames: {error}", MixseqWarning, stacklevel=4
        )
        return coded

    @cache
    def exact(level: int) -> tuple[Float, LargeArray]:
        times = _middles(playback.times, level)
        return times, _decode(model, times)

    def error_of(levels: Levels) -> float:
        if between:
            return levels.largest
        return sum(_distances(levels.playback, *exact(level))[1] for level in range(MAX_COMPARED_LEVELS))

    bound = parameters.max_error * parameters.diagonal
    found = _add_levels(coded, playback, exact, max_bytes, max_error_ratio)
    if found.largest > bound and coded.labels is not None:
        of_parts = replace(playback, parts_basis=parts_basis_of(coded, playback.basis, playback.coefficients))
        found = min(found, _add_levels(coded, of_parts, exact, max_bytes, max_error_ratio), key=error_of)
    largest_error = found.largest
    if between:
        times = quarter_times(playback.times)
        largest_error = max(largest_error, largest_distance(model.blocks(times), found.playback.blocks(times)))
    largest_error /= parameters.diagonal
    if between and largest_error > parameters.max_error:
        raise SettingsError(
            f"between frames, players would be {largest_error:.2g} diagonals from the model, not "
            f"{parameters.max_error:g}; allow this error (max_error, --max-error)"
        )
    parameters = replace(parameters, inbetween_error=float(f"{largest_error:.3g}"))
    if levels := len(found.playback.inbetweens):
        parameters = replace(parameters, inbetween_levels=levels, inbetween_step=found.step)
        parameters = replace(parameters, inbetween_parts=found.playback.parts_basis is not None or None)
    chunks = tuple(replace(chunk, inbetweens=data) for chunk, data in zip(coded.chunks, found.streams, strict=True))
    return replace(coded, parameters=parameters, chunks=chunks)


def _middles(times: Float, level: int) -> Float:
    """Return the times between the knots of a level of in-betweens, of frames at times ``(T,)``."""
    for _ in range(level + 1):
        times = insert_midpoints(times)
    return times[1::2]


def _add_levels(
    coded: CompressedSequence,
    playback: Playback,
    exact: Callable[[int], tuple[Float, LargeArray]],
    max_bytes: float,
    max_error_ratio: float,
) -> Levels:
    """Add levels in the basis of in-betweens; `exact` returns times ``(N,)`` and points ``(N, V, 3)`` of a level."""
    parameters, basis = coded.parameters, playback.inbetween_basis
    intervals = [inbetween_intervals(c.first, c.count, parameters.frame_count) for c in coded.chunks]
    known: list[list[Signal]] = [[] for _ in coded.chunks]
    streams = [b"" for _ in coded.chunks]
    step = largest_error = 0.0
    while True:
        level = len(playback.inbetweens)
        times, points = exact(level)
        largest, squares = _distances(playback, times, points)
        is_within = largest <= parameters.max_error * parameters.diagonal
        if is_within or level == MAX_INBETWEEN_LEVELS or not basis.coefficient_shape[0]:
            break
        offsets = _project(playback, times, points)
        for frame in playback.between.cuts:  # the splines end there
            offsets[(frame - 1) << level : frame << level] = 0.0
        if not level:
            least = _distances(_with_level(playback, offsets), times, points)[1]
            step = max(parameters.step, float(np.sqrt(12 * ROUNDING_RATIO * least / offsets.size)))
        spans = [range(chunk.start << level, chunk.stop << level) for chunk in intervals]
        for factor in (1,) if level else STEP_FACTORS:
            rounded, signals = round_coefficients(basis, offsets, factor * step, spans)
            signals = [[*earlier, *of_level] for earlier, of_level in zip(known, signals, strict=True)]
            longer = [
                code_coefficients(chunk) if any(signal.numbers.any() for signal in chunk) else b"" for chunk in signals
            ]
            is_small = sum(map(len, longer)) <= max_bytes
            if is_small:
                break
        finer = _with_level(playback, rounded)
        largest_left, squares_left = _distances(finer, times, points)
        if not is_small or squares_left > max_error_ratio**2 * squares:
            break
        playback, known, streams, step = finer, signals, longer, factor * step
        largest_error = max(largest_error, largest_left)
    return Levels(playback, streams, step, max(largest, largest_error))


def _with_level(playback: Playback, offsets: Float) -> Playback:
    """Return a playback with one more level of in-betweens ``(N, K, d)``."""
    return replace(playback, inbetweens=(*playback.inbetweens, offsets))


def _decode(model: Model, times: Float) -> LargeArray:
    """Return the points ``(N, V, 3)`` of a model at times ``(N,)``."""
    points = new_large_array((len(times), model.header.vertex_count, 3))
    start = 0
    for block in model.blocks(times, block_size(model.header.vertex_count)):
        points[start : start + len(block)] = block
        start += len(block)
    return points


def _distances(playback: Playback, times: Float, points: LargeArray) -> tuple[float, float]:
    """Return the largest distance of a vertex from points ``(N, V, 3)`` at times ``(N,)``, and the sum of squares."""
    largest = total = 0.0
    start = 0
    for block in playback.blocks(times):
        squares = np.square(points[start : start + len(block)] - block).sum(axis=2)
        largest, total = max(largest, float(squares.max())), total + float(squares.sum())
        start += len(block)
    return float(np.sqrt(largest)), total


def _project(playback: Playback, times: Float, points: LargeArray) -> Float:
    """Return the in-betweens ``(N, K, d)`` nearest to points ``(N, V, 3)`` at times ``(N,)``, by least squares."""
    basis = playback.inbetween_basis
    part_ids, norms = basis.part_ids[basis.varying], basis.norms[basis.varying]
    vectors = [part.vectors.reshape(len(part.vectors), -1)[basis.varying] for part in basis.part_bases]
    units = [of_part / norms[part_ids == part, None] for part, of_part in enumerate(vectors)]
    coefficients = np.empty((len(times), *basis.coefficient_shape))
    for row, time in enumerate(times):
        target = points[row : row + 1][0] - playback.decode_points(time[None])[0]
        for part, (vertices, _) in enumerate(basis.part_bases):
            moved = target[vertices] if basis.kind == "trajectories" else target.T.reshape(-1, 1)
            coefficients[row, part_ids == part] = units[part] @ moved
    for part, unit in enumerate(units):
        products = coefficients[:, part_ids == part].transpose(1, 0, 2)
        nearest = solve_damped(unit @ unit.T, products.reshape(len(unit), -1)).reshape(products.shape)
        coefficients[:, part_ids == part] = nearest.transpose(1, 0, 2)
    return coefficients / norms[:, None]
