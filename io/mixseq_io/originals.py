"""Writing over an original: results are a copy of the file that a sequence came from, with new points."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from mixseq.errors import FormatError, InvalidSequenceError, OutputError
from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import warn

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
