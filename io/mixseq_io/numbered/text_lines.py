"""Lines of OBJ, OFF and STL text: numbers with all digits, colours behind coordinates, excerpts for messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError
from mixseq_io.colours import from_text
from mixseq_io.numbered.frame_files import MeshFile

WRITTEN_BY = b"# Written by mixseq, "
"""Start of the comment in files of mixseq, followed by the points' precision: float32 or float64."""


def excerpt(line: bytes) -> str:
    """Return the beginning of a line for a message."""
    return repr(line.strip()[:40].decode("ascii", errors="replace"))


def number_lines(keyword: str, rows: FloatArray, ends: Sequence[str] = ()) -> bytes:
    """Return a line per row of numbers, with the digits that give back the same number, and optional ends."""
    line = keyword + " ".join(["%.9g" if rows.dtype == np.float32 else "%.17g"] * rows.shape[1])
    lines = "".join(f"{line}{end}\n" for end in ends) if ends else f"{line}\n" * len(rows)
    text: str = lines % tuple(rows.reshape(-1).tolist())
    return text.encode()


def colours_of_words(
    file: Path, vertices: Sequence[int], rows: Sequence[Sequence[bytes]], like: MeshFile | None
) -> FloatArray:
    """Return the colours ``(n, 3)`` or ``(n, 4)`` of some vertices; unreadable ones are NaN in later frames."""
    try:
        return from_text(np.array(rows, dtype=np.float64))
    except ValueError:
        if like is not None:
            return np.full((len(rows), len(rows[0])), np.nan)
        vertex, row = next(
            each for each in zip(vertices, rows, strict=True) if not all(map(_is_number, each[1]))
        )
        raise FormatError(
            f"{file}, vertex {vertex}: the colour {excerpt(b' '.join(row))} is not {len(row)} numbers, which are "
            "expected after the coordinates"
        ) from None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
