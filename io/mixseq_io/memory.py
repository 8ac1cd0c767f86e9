"""One memory limit for all readers of files.

A file of a few bytes can announce, or unpack to, any size, so sizes are compared with the limit before allocation; C++
parsers are also stopped by the system, see `mixseq_io.isolation`. The limit is `max_memory` of the call that opens a
file (``--max-memory``), else ``MIXSEQ_READER_MEMORY`` in GiB, else 8 GB or half of the machine's memory if less.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from mixseq.errors import FormatError, SettingsError

VARIABLE = "MIXSEQ_READER_MEMORY"
"""Environment variable of the limit, in GiB."""

_MOST = 8_000_000_000
_given: ContextVar[int | None] = ContextVar("max_memory", default=None)


def max_memory() -> int:
    """Return the limit in bytes."""
    given = _given.get()
    if given is not None:
        return given
    told = os.environ.get(VARIABLE)
    if told is None:
        return min(_MOST, _memory_of_machine() // 2)
    try:
        return _bytes(float(told) * (1 << 30))
    except ValueError:
        raise SettingsError(f"{VARIABLE} is {told!r}; a number of GiB is expected") from None


@contextmanager
def memory_limit(size: float | None) -> Iterator[None]:
    """Set the limit in bytes for files read in this thread; None leaves it unchanged."""
    if size is None:
        yield
        return
    before = _given.set(_bytes(size))
    try:
        yield
    finally:
        _given.reset(before)


def check_memory(file: object, needed: float, what: str = "what is in it") -> None:
    """Raise an error if reading needs more memory, in bytes, than the limit."""
    limit = max_memory()
    if needed > limit:
        raise FormatError(
            f"{file}: {what} would take {gigabytes(needed)} of memory, the limit is {gigabytes(limit)}; if you trust "
            f"it, allow more: --max-memory {gigabytes(1.5 * needed, 'GB')} (max_memory=... in Python)"
        )


def out_of_memory(file: object) -> FormatError:
    """Return the error of a file that exceeded the memory or a worker's limit."""
    return FormatError(
        f"{file}: reading needs more than {gigabytes(max_memory())} of memory, the limit, or than there is; it is "
        "damaged, or more must be allowed: --max-memory (max_memory=... in Python)"
    )


def gigabytes(size: float, unit: str = " GB") -> str:
    """Return a number of bytes in gigabytes for a message, such as "0.123 GB"."""
    return f"{size / 1e9:.3g}{unit}"


def _bytes(size: float) -> int:
    if not 0 < size < 1 << 62:
        raise SettingsError(f"the limit of memory is {size:g} bytes; a positive number is expected")
    return int(size)


def _memory_of_machine() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return 2 * _MOST
