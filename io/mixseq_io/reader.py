"""What every format's reader has in common: the header at once, the points in blocks, checked on the way."""

from __future__ import annotations

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


class SequenceReader(ABC):
    """An open file of a mesh sequence; use it in a ``with`` statement.

    A format's reader opens its file, finds the header, and implements `_read_blocks`, and `_read_velocities` if the
    format can hold them.

    Parameters
    ----------
    path : Path
        The file, for messages.
    header : SequenceHeader
        Everything but the points.
    resources : ExitStack, optional
        What `close` closes.
    has_velocities : bool
        Whether the file has velocities.
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

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the points, from the first frame each time it is called.

        Parameters
        ----------
        size : int
            Largest number of frames B per block.

        Returns
        -------
        iterator of (B, V, 3) float32 or float64
            The frames in order, in the file's units.

        Raises
        ------
        SettingsError
            If `size` is not positive.
        FormatError
            If the file is damaged, or the reader closed.
        InvalidSequenceError
            If a frame has another number of vertices, or coordinates that are not finite.
        """
        _check_size(size)

        def check(block: FloatArray, frame: int) -> None:
            check_block(self.header, block, frame)

        return self._checked(self._read_blocks(size), check, "points")

    def velocity_blocks(self, size: int = 16) -> Iterator[FloatArray] | None:
        """Iterate over the velocities, in the file's units per second, in step with `blocks` of the same size.

        Returns
        -------
        iterator of (B, V, 3) float32 or float64, or None
            None if the file has no velocities.

        Raises
        ------
        SettingsError, FormatError, InvalidSequenceError
            As `blocks`.
        """
        _check_size(size)
        if not self.has_velocities:
            return None
        return self._checked(self._read_velocities(size), check_velocities, "velocities")

    def markings(self) -> Markings:
        """Return what tells parts of the mesh apart: sets of polygons, and colours and joints where they are read."""
        return Markings(sets=sets_of(self.header))

    def close(self) -> None:
        """Close the file. Blocks that were read stay valid."""
        self._closed = True
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def _read_blocks(self, size: int) -> Iterator[FloatArray]:
        """Yield the points in blocks of at most `size` frames."""

    def _read_velocities(self, size: int) -> Iterator[FloatArray]:
        """Yield the velocities, in blocks as `_read_blocks`; called if the file has any."""
        raise NotImplementedError

    def _checked(
        self, blocks: Iterator[FloatArray], check: Callable[[FloatArray, int], None], what: str
    ) -> Iterator[FloatArray]:
        frame = 0
        while True:
            if self._closed:
                raise FormatError(f"{self.path} is closed; read its blocks inside the with statement")
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


def _check_size(size: int) -> None:
    if size < 1:
        raise SettingsError(f"block size is {size}; a positive number of frames is expected")


@contextmanager
def naming(path: Path | str) -> Iterator[None]:
    """Put the file's name before the messages of errors about the sequence in it."""
    try:
        yield
    except InvalidSequenceError as error:
        raise InvalidSequenceError(f"{path}: {error}") from None


@contextmanager
def reading(path: Path | str, what: str, *errors: type[Exception]) -> Iterator[None]:
    """Translate what a library raises about a bad file into a `FormatError`.

    Parameters
    ----------
    path : Path or str
        The file.
    what : str
        What it should have been, for the message: "an npz file".
    *errors : exception types
        What the library raises; `OSError` and `MemoryError` are always translated.
    """
    damage: tuple[type[Exception], ...] = (OSError, MemoryError, *errors)
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
    except damage as error:
        raise FormatError(
            f"{path} cannot be read as {what}; it is damaged, truncated or of another type ({brief(error)})"
        ) from error


def brief(error: BaseException) -> str:
    """Return an error's first line, or its type if it says nothing."""
    lines = str(error).strip().splitlines()
    return lines[0].strip() if lines else type(error).__name__
