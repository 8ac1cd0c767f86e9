"""Blocks of points and velocities, checked on their way to every format's writer."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator
from itertools import chain, tee

import numpy as np
from numpy.typing import DTypeLike

from mixseq.arrays import FloatArray
from mixseq.errors import InvalidSequenceError, MixseqWarning
from mixseq.sequence import SequenceHeader, check_block

Numbered = tuple[int, FloatArray, FloatArray | None]
"""Index of a block's first frame, its points ``(B, V, 3)``, and its velocities or None."""


def checked(
    header: SequenceHeader, blocks: Iterable[FloatArray], velocities: Iterable[FloatArray] | None = None
) -> tuple[np.dtype[np.floating], Iterator[Numbered]]:
    """Return the points' dtype, from the first block, and the numbered blocks, checked as they pass."""
    rest = iter(blocks)
    first = next(rest, None)
    if first is None:
        raise InvalidSequenceError(f"there are no points for the header's {header.frame_count} times")
    dtype = _as_floats(first).dtype
    speeds = None if velocities is None else iter(velocities)
    return dtype, _numbered(header, chain([first], rest), speeds, dtype)


def _numbered(
    header: SequenceHeader,
    blocks: Iterator[FloatArray],
    velocities: Iterator[FloatArray] | None,
    dtype: DTypeLike,
) -> Iterator[Numbered]:
    frame = 0
    for block in blocks:
        points = _as_floats(block)
        check_block(header, points, frame)
        if points.dtype != dtype:
            raise InvalidSequenceError(
                f"{header.frame_name(frame)}: points turn from {dtype} into {points.dtype}; one dtype is expected"
            )
        if frame + len(points) > header.frame_count:
            raise InvalidSequenceError(f"there are more frames of points than {header.frame_count} times")
        yield (
            frame,
            points,
            (None if velocities is None else _like(header, points, next(velocities, None), frame)),
        )
        frame += len(points)
    if frame < header.frame_count:
        raise InvalidSequenceError(f"there are {frame} frames of points for {header.frame_count} times")
    if velocities is not None and next(velocities, None) is not None:
        raise InvalidSequenceError("there are more velocities than points; give one velocity per point")


def _like(header: SequenceHeader, points: FloatArray, block: FloatArray | None, frame: int) -> FloatArray:
    """Return a block of velocities in the dtype of its block of points."""
    if block is None:
        raise InvalidSequenceError(
            f"velocities end before {header.frame_name(frame)}; give one velocity per point"
        )
    velocities = _as_floats(block)
    if velocities.shape != points.shape:
        raise InvalidSequenceError(
            f"velocities from {header.frame_name(frame)} on have shape {velocities.shape}, points {points.shape}; "
            "give as many"
        )
    check_velocities(header, velocities, frame)
    if points.dtype == np.float64:
        return velocities.astype(np.float64, copy=False)
    return as_float32(velocities, frame, "the precision of its point", "the velocity of vertex", header)


def check_velocities(header: SequenceHeader, velocities: FloatArray, first_frame: int) -> None:
    """Check that all velocities ``(B, V, 3)`` of a block are finite."""
    if not np.isfinite(velocities).all():
        frame, vertex = (int(i) for i in np.argwhere(~np.isfinite(velocities))[0, :2])
        raise InvalidSequenceError(
            f"{header.frame_name(first_frame + frame)}: the velocity of vertex {vertex} is "
            f"{velocities[frame, vertex].tolist()}; velocities must be finite"
        )


def _as_floats(block: FloatArray) -> FloatArray:
    points = np.asarray(block)
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    return np.ascontiguousarray(points)


def in_step(
    pairs: Iterable[tuple[FloatArray, FloatArray]],
) -> tuple[Iterator[FloatArray], Iterator[FloatArray]]:
    """Split pairs of blocks of points and velocities (`Model.moving_blocks`) into two iterators, advanced in turns."""
    one, other = tee(pairs)
    return (points for points, _ in one), (velocities for _, velocities in other)


def as_float32(
    values: FloatArray,
    first_frame: int,
    what: str,
    of: str = "vertex",
    header: SequenceHeader | None = None,
) -> FloatArray:
    """Round points or velocities to float32; errors name the format `what`."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = values.astype(np.float32)
    finite = np.isfinite(rounded)
    if not finite.all():
        frame, vertex = (int(i) for i in np.argwhere(~finite)[0, :2])
        index = first_frame + frame
        name = f"frame {index}" if header is None else header.frame_name(index)
        raise InvalidSequenceError(
            f"{name}: {of} {vertex} is {values[frame, vertex].tolist()}, too large "
            f"for {what}, which stores float32; scale the points down, or write .npz or .h5"
        )
    return rounded


def warn(message: str) -> None:
    """Warn at the line of the first caller outside mixseq."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_ours(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, MixseqWarning, stacklevel=level)


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in ("mixseq", "mixseq_io")
