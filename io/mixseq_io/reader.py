"""Base of all readers: the header at once, the points in blocks, checked as they are read."""

from __future__ import annotations

import os
import stat
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from mixseq.arrays import FloatArray
from mixseq.errors import FormatError, InvalidSequenceError, MixseqError, SettingsError
from mixseq.sequence import SequenceHeader, check_block
from mixseq_io.blocks import check_velocities
from mixseq_io.labels.markings import Markings, sets_of
from mixseq_io.memory import check_memory, max_memory, memory_limit, out_of_memory


class SequenceReader(ABC):
    """Open file of a mesh sequence, used in a ``with`` statement.

    Subclasses open their file, find the header, and implement `_read_blocks`, and `_read_velocities` if the format can
    hold them.
    """

    def __init__(
        self,
        path: Path,
        header: SequenceHeader,
        resources: ExitStack | None = None,
        has_velocities: bool = False,
    ) -> None:
        self.path = path
        self.header = header
        self.has_velocities = has_velocities
        self._resources = resources or ExitStack()
        self._closed = False
        self._limit = max_memory()
        self._process = os.getpid()

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over blocks ``(B, V, 3)`` of the points, from the first frame at each call."""

        def check(block: FloatArray, frame: int) -> None:
            check_block(self.header, block, frame)

        return self._checked(self._read_blocks(self._fitting(size)), check, "points")

    def velocity_blocks(self, size: int = 16) -> Iterator[FloatArray] | None:
        """Iterate over blocks ``(B, V, 3)`` of velocities, in units per second, in step with `blocks` of that size."""
        fitting = self._fitting(size)
        if not self.has_velocities:
            return None

        def check(block: FloatArray, frame: int) -> None:
            check_velocities(self.header, block, frame)

        return self._checked(self._read_velocities(fitting), check, "velocities")

    def check_whole(self) -> None:
        """Raise an error if all frames together take more than `max_memory`."""
        numbers = 3 * self.header.vertex_count * self.header.frame_count * (1 + self.has_velocities)
        with memory_limit(self._limit):
            check_memory(self.path, 4 * numbers, f"all its {self.header.frame_count} frames")

    def markings(self) -> Markings:
        """Return the sets of polygons, and joints where they are read."""
        return Markings(sets=sets_of(self.header))

    def close(self) -> None:
        """Close the file; blocks that were read stay valid."""
        self._closed = True
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _fitting(self, size: int) -> int:
        """Return the number of frames of a block that fits the memory limit."""
        if size < 1:
            raise SettingsError(f"block size is {size}; a positive number of frames is expected")
        frame = 3 * 8 * self.header.vertex_count
        with memory_limit(self._limit):
            check_memory(self.path, frame, "a frame")
        return min(size, self._limit // max(frame, 1))

    @abstractmethod
    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        """Yield the points in blocks of at most `size` frames."""

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        """Yield the velocities, in blocks as `_read_blocks`; called if the file has any."""
        raise NotImplementedError

    def _check_open(self) -> None:
        if self._closed:
            raise FormatError(f"{self.path} is closed; read its blocks inside the with statement")
        self._check_process()

    def _check_process(self) -> None:
        if self._process != os.getpid():  # both would move the place in the file
            raise FormatError(f"{self.path} was opened before this process was forked; open it again here")

    def _checked(
        self, blocks: Iterator[FloatArray], check: Callable[[FloatArray, int], None], what: str
    ) -> Iterator[FloatArray]:
        frame = 0
        while True:
            self._check_open()
            block = next(blocks, None)
            if block is None:
                break
            with naming(self.path):
                check(block, frame)
            yield block
            frame += len(block)
        if frame != self.header.frame_count:
            raise FormatError(
                f"{self.path}: {frame} frames of {what} for {self.header.frame_count} times; is it truncated?"
            )


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Put the file's name before error messages about its sequence."""
    try:
        yield
    except InvalidSequenceError as error:
        raise InvalidSequenceError(f"{path}: {error}") from None


@contextmanager
def reading(path: Path | str, what: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate a library's errors about a bad file into `FormatError`."""
    check_regular(path, what)
    damage: tuple[type[Exception], ...] = (OSError, *errors)
    try:
        yield
    except MixseqError:
        raise
    except FileNotFoundError:
        raise FormatError(f"{path} does not exist") from None
    except IsADirectoryError:
        raise FormatError(f"{path} is a folder, not {what}") from None
    except PermissionError:
        raise FormatError(f"{path}: no permission to read it") from None
    except MemoryError:
        raise out_of_memory(path) from None
    except damage as error:
        raise FormatError(
            f"{path} cannot be read as {what}; it is damaged, truncated or of another type ({brief(error)})"
        ) from error


_OF_TEXT = 6
"""Memory in bytes per byte of text that is parsed into words and numbers in Python."""


def read_whole(path: Path, text: bool = False) -> bytes:
    """Return all bytes of a file, if they fit the memory limit; for `text` including its parsed words."""
    size = path.stat().st_size
    check_memory(
        path, size * _OF_TEXT if text else size, "the file and what is made of it" if text else "the file"
    )
    return path.read_bytes()


def refuse_newer(path: Path, version: int, known: int) -> None:
    """Raise an error for a file version above the known one."""
    if version > known:
        raise FormatError(
            f"{path} has version {version}, this mixseq reads up to {known}; a newer mixseq wrote it: "
            "upgrade with pip install --upgrade mixseq"
        )


def check_regular(path: Path | str, what: str) -> None:
    """Raise an error for a pipe, a socket or a device, since reading it may never end."""
    try:
        mode = Path(path).stat().st_mode
    except (OSError, ValueError):  # not there, or no name that a file can have: its reader will tell
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise FormatError(f"{path} is a pipe, a socket or a device, not {what}; give the name of a file")


def brief(error: BaseException) -> str:
    """Return an error's first line, or its type if it has no text."""
    lines = str(error).strip().splitlines()
    return lines[0].strip() if lines else type(error).__name__
