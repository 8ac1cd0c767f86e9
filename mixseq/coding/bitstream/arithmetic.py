"""Binary arithmetic coding: predicted bits to bytes, and back.

Encoder and decoder share a probability for each bit. An interval of 32-bit numbers is split in that proportion, and the
bit's half is kept; bytes on which both ends agree are output. The loss against the ideal is below a thousandth.

The probability of a bit depends on the bits before it, so the split is made inside compiled loops.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``). All values are integers below 2^49.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.compiled import joined

ONE = 1 << 16
"""Unit of probabilities, which are integers from 1 to 65535 times 2^-16. Frozen: breaks old files."""

_TOP = (1 << 32) - 1
"""Largest end of an interval. Frozen: breaks old files."""

BYTES_BEYOND = 4
"""Zero bytes that may be read beyond the end of the stream. Frozen: breaks old files."""


class Coded(NamedTuple):
    """A byte buffer with the state of writing or reading."""

    decoding: bool  # whether bits are read
    data: NDArray[np.uint8]  # (n,) the bytes, or room for them
    place: Index  # (1,) position of the next byte
    interval: Index  # (3,) both ends of the interval, and if decoding the number in it


def to_write(room: int) -> Coded:
    """Return an empty buffer for writing `room` bytes."""
    return Coded(
        False,
        np.zeros(room, dtype=np.uint8),
        np.zeros(1, dtype=np.int64),
        np.array([0, _TOP, 0], dtype=np.int64),
    )


def with_room(coded: Coded, room: int) -> Coded:
    """Return the buffer with room for at least `room` more bytes."""
    done = int(coded.place[0])
    if len(coded.data) - done >= room:
        return coded
    data = np.zeros(2 * done + room, dtype=np.uint8)
    data[:done] = coded.data[:done]
    return coded._replace(data=data)


def to_read(data: bytes) -> Coded:
    """Return the state for reading the first bit of the output of `written`."""
    padded = np.frombuffer(data + bytes(BYTES_BEYOND), dtype=np.uint8).copy()
    first = int.from_bytes(padded[:4].tobytes(), "big")
    return Coded(True, padded, np.array([4], dtype=np.int64), np.array([0, _TOP, first], dtype=np.int64))


def written(coded: Coded) -> bytes:
    """Return the bytes of all bits, ended by the number of the interval that takes the fewest bytes."""
    low, high = int(coded.interval[0]), int(coded.interval[1])
    last = b""
    for size in range(5):
        unit = 1 << 8 * (4 - size)
        number = -(-low // unit) * unit
        if number <= high:
            last = number.to_bytes(4, "big")[:size]
            break
    return coded.data[: coded.place[0]].tobytes() + last


def is_beyond(coded: Coded) -> bool:
    """Return whether more bits were read than there are."""
    return int(coded.place[0]) > len(coded.data) + BYTES_BEYOND


@joined
def code_bit(coded: Coded, chance: int, bit: int) -> int:
    """Write or read a bit whose probability of being 1 is `chance` / 65536; return it."""
    low, high = coded.interval[0], coded.interval[1]
    middle = low + (((high - low) * chance) >> 16)
    if coded.decoding:
        bit = 1 if coded.interval[2] <= middle else 0
    if bit:
        high = middle
    else:
        low = middle + 1
    while (low ^ high) >> 24 == 0:
        if coded.decoding:
            place = coded.place[0]
            byte = coded.data[place] if place < len(coded.data) else 0
            coded.interval[2] = ((coded.interval[2] & 0xFFFFFF) << 8) | byte
        else:
            coded.data[coded.place[0]] = high >> 24
        coded.place[0] += 1
        low, high = (low & 0xFFFFFF) << 8, ((high & 0xFFFFFF) << 8) | 0xFF
    coded.interval[0], coded.interval[1] = low, high
    return bit


@joined
def code_number(coded: Coded, size: int, number: int) -> int:
    """Write or read the last `size` bits of a number without a model, and return them."""
    found = 0
    for place in range(size - 1, -1, -1):
        found = (found << 1) | code_bit(coded, 32768, (number >> place) & 1)
    return found
