"""Verify decoded numbers: streams end with the CRC-32 of the numbers that they decode to.

Decoding repeats every prediction of the encoder. Different rounding, an error in a library or port, and a damaged file
would lead to other numbers; the check turns all of these into one error.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

from zlib import crc32

from mixseq.arrays import IntArray
from mixseq.errors import FormatError

SIZE = 4
"""Bytes of the CRC-32 at the end of a stream, lowest first. Frozen: breaks old files."""


def check_of(numbers: IntArray, before: int = 0) -> int:
    """Return the CRC-32 of integers of any shape, 8 bytes each, continuing from the CRC-32 `before`."""
    return crc32(numbers.astype("<i8").tobytes(), before)


def with_check(data: bytes, check: int) -> bytes:
    """Append the CRC-32 of the decoded numbers to a stream."""
    return data + check.to_bytes(SIZE, "little")


def without_check(data: bytes) -> tuple[bytes, int]:
    """Split a stream into its data and the CRC-32 of the decoded numbers."""
    return data[:-SIZE], int.from_bytes(data[-SIZE:], "little")


def refuse_others(found: int, expected: int) -> None:
    """Verify that the decoded numbers have the CRC-32 of the coded ones."""
    if found != expected:
        raise FormatError(
            "coded numbers come out otherwise than they went in: the file is damaged, or this machine, or a library "
            "on it, does not calculate as IEEE 754 says"
        )
