"""Writing over an original: results are a copy of the file that a sequence came from, with new points."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import FormatError, InvalidSequenceError, OutputError
from mixseq.frame_numbers import NEAR
from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import warn
from mixseq_io.choosing import listed

Opened = TypeVar("Opened")


def opened_original(
    path: Path,
    header: SequenceHeader,
    onto: str | os.PathLike[str] | None,
    kind: str,
    opened: Callable[[Path], Opened],
) -> Opened | None:
    """Open the file that is copied, if there is one.

    Parameters
    ----------
    path : Path
        What is written.
    header : SequenceHeader
        The sequence; it tells which file of what format it came from.
    onto : path-like, optional
        Another file.
    kind : str
        The format, as `Origin.format`.
    opened : callable
        Opens the file.

    Raises
    ------
    OutputError
        If the file would be lost, or it is `onto` and the sequence does not fit it.

    Warns
    -----
    MixseqWarning
        If the sequence does not fit the file that it came from, and so is written alone.
    """
    origin = header.surface.origin
    if onto is not None:
        file = Path(onto)
    elif origin is not None and origin.format == kind:
        file = Path(origin.path)
    else:
        return None
    if path.exists() and file.exists() and path.samefile(file):
        raise OutputError(f"{path} is the original and would be lost; write to another name")
    try:
        return opened(file)
    except (FormatError, InvalidSequenceError) as error:
        if onto is not None:
            raise OutputError(f"cannot write {path} onto another file: {error}") from error
        warn(
            f"{error}; the sequence is written alone, without what else that file had (onto=FILE names another)"
        )
        return None


def is_retimed(header: SequenceHeader, sources: ArrayLike | None) -> bool:
    """Whether frames show other times of an original, in seconds, than their own; without `sources` they do not."""
    return sources is not None and not np.allclose(sources, header.times, rtol=0, atol=NEAR / header.fps)


def warn_of_other_times(
    path: Path,
    header: SequenceHeader,
    moving: Mapping[str, tuple[float, float]],
    sources: ArrayLike | None,
) -> None:
    """Tell what else moves if the sequence shows other times than its own, or goes on for more than a frame.

    Parameters
    ----------
    path : Path
        What is written.
    header : SequenceHeader
        The sequence.
    moving : mapping of str to (float, float)
        What else moves in the original, from when to when, in seconds.
    sources : (T,) float, optional
        Times of the original that the frames show, by default their own.
    """
    first, last = (float(time) for time in header.times[[0, -1]])
    frame, retimed = 1 / header.fps, is_retimed(header, sources)
    told = [
        each
        for each, (start, end) in moving.items()
        if retimed or first < start - frame or last > end + frame
    ]
    if told:
        start, end = min(moving[each][0] for each in told), max(moving[each][1] for each in told)
        warn(
            f"{path}: what else moves keeps its own times, {start:g} to {end:g} s, and is not retimed: {listed(told)}"
        )
