"""What every format's writer has in common: blocks of points, checked before they reach the file."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import DTypeLike

from mixseq.errors import InvalidSequenceError, MixseqWarning
from mixseq.sequence import FloatArray, SequenceHeader, check_block


def checked(
    header: SequenceHeader, blocks: Iterable[FloatArray]
) -> tuple[np.dtype[np.floating], Iterator[tuple[int, FloatArray]]]:
    """Look at the first block, and check every block as it passes.

    Returns
    -------
    dtype : numpy.dtype
        float32 or float64, that of the first block; formats decide how to store the points by it.
    numbered : iterator of (int, (B, V, 3) array)
        Index of each block's first frame, and the block.

    Raises
    ------
    InvalidSequenceError
        While iterating: if a block does not fit the header, or changes dtype, or if there are more or fewer
        frames than the header has times.
    """
    rest = iter(blocks)
    first = next(rest, None)
    if first is None:
        raise InvalidSequenceError(f"there are no points for the header's {header.frame_count} times")
    dtype = _as_floats(first).dtype
    return dtype, _numbered(header, first, rest, dtype)


def _numbered(
    header: SequenceHeader, first: FloatArray, rest: Iterator[FloatArray], dtype: DTypeLike
) -> Iterator[tuple[int, FloatArray]]:
    frame = 0
    block: FloatArray | None = first
    while block is not None:
        points = _as_floats(block)
        check_block(header, points, frame)
        if points.dtype != dtype:
            raise InvalidSequenceError(
                f"frame {frame}: points turn from {dtype} into {points.dtype}; one dtype is expected"
            )
        if frame + len(points) > header.frame_count:
            raise InvalidSequenceError(f"there are more frames of points than {header.frame_count} times")
        yield frame, points
        frame += len(points)
        block = next(rest, None)
    if frame < header.frame_count:
        raise InvalidSequenceError(f"there are {frame} frames of points for {header.frame_count} times")


def _as_floats(block: FloatArray) -> FloatArray:
    points = np.asarray(block)
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    return np.ascontiguousarray(points)


def as_float32(points: FloatArray, first_frame: int, what: str) -> FloatArray:
    """Round points to float32, the precision of the format called `what`.

    Raises
    ------
    InvalidSequenceError
        If a coordinate is too large for float32; the message names the frame and vertex.
    """
    with np.errstate(over="ignore", under="ignore"):
        rounded = points.astype(np.float32)
    finite = np.isfinite(rounded)
    if not finite.all():
        frame, vertex = (int(i) for i in np.argwhere(~finite)[0, :2])
        raise InvalidSequenceError(
            f"frame {first_frame + frame}: vertex {vertex} is {points[frame, vertex].tolist()}, too large "
            f"for {what}, which stores float32; scale the points down, or write .npz or .h5"
        )
    return rounded


def warn(message: str) -> None:
    """Warn on behalf of the first caller outside mixseq, whose line is the one to look at."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_ours(frame.f_globals.get("__name__", "")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, MixseqWarning, stacklevel=level)


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in ("mixseq", "mixseq_io")
