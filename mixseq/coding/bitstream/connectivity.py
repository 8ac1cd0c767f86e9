r"""Code polygons without loss: the order of vertices and faces, and first corners, stay as they are.

Users number vertices and faces, so a coder may not renumber them, as Edgebreaker and its like do. Corners are coded one
after the other, in their order, and predicted from the mesh so far, from the polygons before, and from the numbers of
their neighbours (in the spirit of the index codec of *meshoptimizer*, which knows recent edges only). What the
predictions are worth is learned bit by bit, by `mixseq.coding.bitstream.bit_mixing`. Meshes whose order is coherent
take 2 to 10 bits for a triangle; what has no order takes what the order itself is worth, about half a logarithm of V!
F!.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/model-v4-coded.h5``).

**The bytes.** Nothing if there are no polygons. Else the number of bits in each of the 16 queues, each number as 7 bits
a byte, the lowest first, with the highest bit set in all bytes but the last (LEB128); then numbers, in rounds, by
`mixseq.coding.bitstream.entropy`. A round takes the next 64 bits of every queue, as far as there are any, queue 0
first; every round is twice as long as the one before it, up to 65536. A bit is a number 0 or 1 in the context of its
queue, largest number 1, of mean magnitude :math:`r_q / (1 - r_q)`, where :math:`r_0 = 3/4` and :math:`r_{q+1} =
0.6041\overline{6} r_q`.

**The bits.** For every polygon, its number of corners less that of the polygon before (3 for the first), then its
corners, as `mixseq.coding.bitstream.connectivity_kernels` says.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.bit_mixing import QUEUES, bits_to_code, bits_to_decode, queues_of
from mixseq.coding.bitstream.connectivity_kernels import KINDS, LONGEST, walk
from mixseq.coding.bitstream.corner_guesses import GUESSES, INPUTS, no_past
from mixseq.coding.bitstream.entropy import Reader, Tables, Writer, pack_leb128, unpack_leb128
from mixseq.coding.bitstream.half_edges import no_half_edges
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.polygons import Polygons

_FIRST_ROUND, _LONGEST_ROUND = 1 << 6, 1 << 16
"""Bits of a queue in a round. Frozen: breaks old files."""


def encode_polygons(polygons: Polygons, vertex_count: int) -> bytes:
    """Code polygons so that `decode_polygons` returns the same.

    Parameters
    ----------
    polygons : Polygons
        Any polygons: also such that share edges or corners, have a vertex twice, or none at all.
    vertex_count : int
        Number V of vertices, used or not.

    Raises
    ------
    InvalidSequenceError
        If a corner has no such vertex.
    """
    if not len(polygons.counts):
        return b""
    lowest, highest = int(polygons.indices.min()), int(polygons.indices.max())
    if lowest < 0 or highest >= vertex_count:
        raise InvalidSequenceError(
            f"corners have vertices {lowest} to {highest}; with {vertex_count} vertices, 0 to {vertex_count - 1} exist"
        )
    counts, indices = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    bits = bits_to_code(_most_bits(len(counts), len(indices)), INPUTS, KINDS)
    walk(bits, no_half_edges(len(indices), vertex_count), no_past(vertex_count), counts, indices)

    queues = queues_of(bits)
    lengths = np.array([len(queue) for queue in queues])
    writer, tables = Writer(), _tables()
    for first, sizes in _rounds(lengths):
        part = [queue[first : first + size] for queue, size in zip(queues, sizes, strict=True)]
        writer.put(np.concatenate(part).astype(np.int64), np.repeat(np.arange(QUEUES), sizes), tables)
    return pack_leb128(lengths.tolist()) + writer.finish()


def decode_polygons(data: bytes, polygon_count: int, corner_count: int, vertex_count: int) -> Polygons:
    """Return the polygons that `encode_polygons` coded.

    Parameters
    ----------
    data : bytes
        What `encode_polygons` returned.
    polygon_count, corner_count, vertex_count : int
        Numbers P of polygons, C of all their corners, and V of vertices. Memory grows with these, so they should have
        been checked.

    Raises
    ------
    FormatError
        If the data are damaged, or have other numbers of polygons, corners, or vertices (not all damage is noticed:
        files have checksums).
    """
    mesh = f"{polygon_count} polygons with {corner_count} corners and {vertex_count} vertices"
    if (
        polygon_count < 0
        or not 0 <= vertex_count < 1 << 31
        or not 3 * polygon_count <= corner_count < 1 << 31
    ):
        raise FormatError(f"a mesh cannot have {mesh}; the file is damaged")
    if not polygon_count or not vertex_count:
        if data or corner_count:
            raise FormatError(f"a mesh with {mesh} has no coded corners; the file is damaged")
        return Polygons(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    lengths, start = _lengths(data)
    if sum(lengths) > _most_bits(polygon_count, corner_count):
        raise FormatError(f"{sum(lengths)} bits are too many for {mesh}; the file is damaged")
    reader, tables = Reader(data[start:]), _tables()
    queues: list[list[Index]] = [[np.zeros(0, dtype=np.int64)] for _ in range(QUEUES)]
    for _, sizes in _rounds(np.array(lengths)):
        part = reader.get(np.repeat(np.arange(QUEUES), sizes), tables)
        for queue, numbers in zip(queues, np.split(part, np.cumsum(sizes)[:-1]), strict=True):
            queue.append(numbers)
    bits = bits_to_decode([np.concatenate(queue) & 1 for queue in queues], INPUTS, KINDS)

    counts, indices = np.zeros(polygon_count, dtype=np.int64), np.zeros(corner_count, dtype=np.int64)
    walk(bits, no_half_edges(corner_count, vertex_count), no_past(vertex_count), counts, indices)
    if bits.failed[0] or not np.array_equal(bits.heads, bits.ends):
        raise FormatError(f"coded polygons are damaged, or those of another mesh than one of {mesh}")
    return Polygons(counts, indices)


def _most_bits(polygon_count: int, corner_count: int) -> int:
    """Return how many bits a mesh can take: guesses, and numbers of 66 bits for states, distances, and counts."""
    number = 2 + 2 * LONGEST
    return polygon_count * number + corner_count * (GUESSES + 2 * number)


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


def _lengths(data: bytes) -> tuple[list[int], int]:
    """Return the numbers of bits in the queues; also return where the next byte is."""
    ends = [place + 1 for place, byte in enumerate(data[: 10 * QUEUES]) if byte < 128][:QUEUES]
    if len(ends) < QUEUES:
        raise FormatError("coded polygons end early; the file is damaged")
    return list(unpack_leb128(data[: ends[-1]])), ends[-1]
