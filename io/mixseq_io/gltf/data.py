"""Runs of bytes, in memory or in an open file; those of files are read where they are asked for.

A morph target per frame makes files large, and one block of frames needs few of them.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path

from mixseq.errors import FormatError


class _File(io.FileIO):
    """A file that is closed with its last reader; it stays the one that was opened if another takes its name."""

    def __del__(self) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class Data:
    """A run of bytes.

    Parameters
    ----------
    source : file or bytes
        What it is a part of.
    start, size : int
        Where it begins there, and how long it is.
    """

    source: _File | bytes
    start: int
    size: int

    def part(self, start: int, size: int) -> Data:
        """Return a run within this one."""
        return Data(self.source, self.start + start, size)

    def read(self, start: int, size: int) -> bytes:
        """Return bytes of it; fewer only where it ends.

        Raises
        ------
        FormatError
            If the file has been cut since it was opened.
        """
        size = max(0, min(size, self.size - start))
        at = self.start + start
        if isinstance(self.source, bytes):
            return self.source[at : at + size]
        self.source.seek(at)
        parts = []
        while size:
            part = self.source.read(size)
            if not part:
                raise FormatError(
                    f"{self.source.name} ends in the middle; was it written anew while it was read?"
                )
            parts.append(part)
            size -= len(part)
        return b"".join(parts)


def data_of_file(path: Path) -> Data:
    """Return the bytes of a file."""
    file = _File(path)
    return Data(file, 0, os.fstat(file.fileno()).st_size)


def data_in_memory(content: bytes) -> Data:
    """Return bytes that are in memory already."""
    return Data(content, 0, len(content))
