r"""The bytes of bits that were sorted into queues by how surprising they are.

First the number of bits in each of the 16 queues, each number as 7 bits a byte, the lowest first, with the highest bit
set in all bytes but the last (LEB128); then numbers, in rounds, by `mixseq.coding.bitstream.entropy`. A round takes the
next 64 bits of every queue, as far as there are any, queue 0 first; every round is twice as long as the one before it,
up to 65536. A bit is a number 0 or 1 in the context of its queue, largest number 1, of mean magnitude :math:`r_q / (1 -
r_q)`, where :math:`r_0 = 3/4` and :math:`r_{q+1} = 0.6041\overline{6} r_q`.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.bit_mixing import QUEUES, Bits, Byte, bits_to_decode, queues_of
from mixseq.coding.bitstream.entropy import Reader, Tables, Writer, pack_leb128, unpack_leb128
from mixseq.errors import FormatError

_FIRST_ROUND, _LONGEST_ROUND = 1 << 6, 1 << 16
"""Bits of a queue in a round. Frozen: breaks old files."""


def pack_queues(bits: Bits) -> bytes:
    """Return the bytes of bits that were coded."""
    queues = queues_of(bits)
    lengths = np.array([len(queue) for queue in queues])
    writer, tables = Writer(), _tables()
    for first, sizes in _rounds(lengths):
        part = [queue[first : first + size] for queue, size in zip(queues, sizes, strict=True)]
        writer.put(np.concatenate(part).astype(np.int64), np.repeat(np.arange(QUEUES), sizes), tables)
    return pack_leb128(lengths.tolist()) + writer.finish()


def unpack_queues(data: bytes, most: int, sets: int, what: str) -> Bits:
    """Return the state from which the bits are decoded that `pack_queues` was given.

    Parameters
    ----------
    data : bytes
        What `pack_queues` returned.
    most : int
        How many bits there can be. Memory grows with the bits.
    sets : int
        Sets of weights, as in `bits_to_code`.
    what : str
        What the bits are of, for messages.

    Raises
    ------
    FormatError
        If there are more bits, or the data are damaged.
    """
    lengths, start = _lengths(data, what)
    if sum(lengths) > most:
        raise FormatError(f"{sum(lengths)} bits are too many for {what}; the file is damaged")
    reader, tables = Reader(data[start:]), _tables()
    queues: list[list[Byte]] = [[np.zeros(0, dtype=np.uint8)] for _ in range(QUEUES)]
    for _, sizes in _rounds(np.array(lengths)):
        part = (reader.get(np.repeat(np.arange(QUEUES), sizes), tables) & 1).astype(np.uint8)
        for queue, numbers in zip(queues, np.split(part, np.cumsum(sizes)[:-1]), strict=True):
            queue.append(numbers)
    return bits_to_decode([np.concatenate(queue) for queue in queues], sets)


def all_decoded(bits: Bits) -> bool:
    """Whether every bit that was asked for was there, and all that are there were asked for."""
    return not bits.failed[0] and np.array_equal(bits.heads, bits.ends)


def _tables() -> Tables:
    """Return the model of the bits of queues: a 1 is less likely than a 0 by about exp(-8 (q + 1/2) / QUEUES)."""
    rate = 8 / QUEUES
    fall = 1 - rate + rate**2 / 2 - rate**3 / 6  # the series of exp: the same everywhere
    ratios = [1 - 4 / QUEUES]
    for _ in range(QUEUES - 1):
        ratios.append(ratios[-1] * fall)
    return Tables([ratio / (1 - ratio) for ratio in ratios], largest=1)


def _rounds(lengths: Index) -> Iterator[tuple[int, Index]]:
    """Yield where a round starts in every queue, and how many bits of every queue it has."""
    first, size = 0, _FIRST_ROUND
    while first < lengths.max():
        yield first, np.clip(lengths - first, 0, size)
        first += size
        size = min(2 * size, _LONGEST_ROUND)


def _lengths(data: bytes, what: str) -> tuple[list[int], int]:
    """Return the numbers of bits in the queues; also return where the next byte is."""
    ends = [place + 1 for place, byte in enumerate(data[: 10 * QUEUES]) if byte < 128][:QUEUES]
    if len(ends) < QUEUES:
        raise FormatError(f"the bits of {what} end early; the file is damaged")
    return list(unpack_leb128(data[: ends[-1]])), ends[-1]
