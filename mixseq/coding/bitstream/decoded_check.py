"""Make sure that a decoder has what an encoder had: streams end with the CRC-32 of the numbers that they decode to.

Decoding repeats every prediction of the encoder. A machine that adds otherwise, a library with an error, a port that is
nearly right, or damage on the way from the file, would end in other numbers; with this they end in one error.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

from zlib import crc32

from mixseq.arrays import IntArray
from mixseq.errors import FormatError

SIZE = 4
"""Bytes of the CRC-32 at the end of a stream, the lowest first. Frozen: breaks old files."""


def check_of(numbers: IntArray, before: int = 0) -> int:
    """Return the CRC-32 of whole numbers of any shape, 8 bytes each, after others with the CRC-32 `before`."""
    return crc32(numbers.astype("<i8").tobytes(), before)


def with_check(data: bytes, check: int) -> bytes:
    """Return a stream, and behind it what it decodes to."""
    return data + check.to_bytes(SIZE, "little")


def without_check(data: bytes) -> tuple[bytes, int]:
    """Return a stream, and what it has to decode to."""
    return data[:-SIZE], int.from_bytes(data[-SIZE:], "little")


def refuse_others(found: int, expected: int) -> None:
    """Make sure that numbers are those that were coded."""
    if found != expected:
        raise FormatError(
            "coded numbers come out otherwise than they went in: the file is damaged, or this machine, or a library "
            "on it, does not calculate as IEEE 754 says"
        )
