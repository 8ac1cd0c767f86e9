"""The loops of `mixseq_io.meshopt.attributes`: bytes of vertices, as differences, in groups of sixteen.

A block is up to 256 vertices. Of these, all first bytes come first, then all second bytes, and so on, each as the
difference from the vertex before. Sixteen differences are a group, written with 0, 1, 2, 4 or 8 bits each; what does
not fit into 1, 2 or 4 bits has all of them set, and follows as a byte.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.compiled import compiled, inlined

Bytes = NDArray[np.uint8]

GROUP = 16
LONGEST_BLOCK = 256
_BLOCK_BYTES = 8192


@inlined
def _block_size(stride: int) -> int:
    """Return how many vertices a block has."""
    return min(_BLOCK_BYTES // stride // GROUP * GROUP, LONGEST_BLOCK)


@inlined
def _bits_of(control: int, mode: int) -> int:
    """Return the bits of a number in a group: of the modes 0 to 3, as version 0 (-1) or a control byte has them."""
    if control == -1:
        return (0, 2, 4, 8)[mode]
    return (0, 1, 2, 4)[mode] if control == 0 else (1, 2, 4, 8)[mode]


@compiled
def unpack(data: Bytes, version: int, rows: Bytes) -> bool:
    """Decode vertices into `rows` ``(n, stride)``; whether the data were sound.

    `data` end with at least 24 bytes that no group begins in, so that no group is read beyond them.
    """
    count, stride = rows.shape
    tail = stride + version * (stride // 4)
    end = len(data) - max(tail, 24 if version else 32)
    last = data[len(data) - tail :][:stride].copy()
    channels = data[len(data) - tail + stride :]
    deltas = np.zeros((stride, LONGEST_BLOCK), np.uint8)
    size = _block_size(stride)
    at = 1
    for first in range(0, count, size):
        here = min(count - first, size)
        groups = -(-here // GROUP)
        controls = at
        at += version * (stride // 4)
        if at > end:
            return False
        for byte in range(stride):
            control = (data[controls + byte // 4] >> (byte % 4 * 2)) & 3 if version else -1
            if control == 2:
                deltas[byte] = 0
                continue
            if control == 3:
                if at + here > end:
                    return False
                deltas[byte, :here] = data[at : at + here]
                at += here
                continue
            modes = at
            at += -(-groups // 4)
            for group in range(groups):
                if at > end:
                    return False
                bits = _bits_of(control, (data[modes + group // 4] >> (group % 4 * 2)) & 3)
                at = _unpack_group(data, at, bits, deltas[byte, group * GROUP : (group + 1) * GROUP])
        for number in range(first, first + here):
            _add(rows[number], last, deltas[:, number - first], channels, version)
    return bool(at == end)


@inlined
def _unpack_group(data: Bytes, at: int, bits: int, group: Bytes) -> int:
    """Decode the sixteen numbers of a group; return where the next one begins."""
    if bits == 0:
        group[:] = 0
        return at
    if bits == 8:
        group[:] = data[at : at + GROUP]
        return at + GROUP
    escape, each = (1 << bits) - 1, 8 // bits
    more = at + 2 * bits
    for place in range(GROUP):
        within = place % each
        shift = within if bits == 1 else (each - 1 - within) * bits
        number = (data[at + place // each] >> shift) & escape
        if number == escape:
            number = data[more]
            more += 1
        group[place] = number
    return more


@inlined
def _add(row: Bytes, last: Bytes, deltas: Bytes, channels: Bytes, version: int) -> None:
    """Make a vertex of the one before and the differences, by the channel of every four bytes."""
    for word in range(0, len(row), 4):
        channel = int(channels[word // 4]) if version else 0
        if channel & 3 == 0:
            for byte in range(word, word + 4):
                delta = int(deltas[byte])
                row[byte] = (int(last[byte]) + ((delta >> 1) ^ -(delta & 1))) & 255
        elif channel & 3 == 1:
            for byte in range(word, word + 4, 2):
                delta = int(deltas[byte]) | int(deltas[byte + 1]) << 8
                value = int(last[byte]) | int(last[byte + 1]) << 8
                value = value + ((delta >> 1) ^ -(delta & 1))
                row[byte] = value & 255
                row[byte + 1] = (value >> 8) & 255
        else:
            delta = 0
            for byte in range(4):
                delta |= int(deltas[word + byte]) << (8 * byte)
            turn = channel >> 4
            delta = (delta >> turn) | (delta << (32 - turn))
            for byte in range(4):
                row[word + byte] = int(last[word + byte]) ^ ((delta >> (8 * byte)) & 255)
        last[word : word + 4] = row[word : word + 4]


@compiled
def pack(rows: Bytes, data: Bytes) -> int:
    """Encode vertices ``(n, stride)`` in version 0 without their tail into `data`; return how many bytes that are."""
    count, stride = rows.shape
    size = _block_size(stride)
    deltas = np.zeros(LONGEST_BLOCK, np.uint8)
    at = 1
    for first in range(0, count, size):
        here = min(count - first, size)
        groups = -(-here // GROUP)
        for byte in range(stride):
            last = int(rows[max(first - 1, 0), byte])
            for number in range(here):
                value = int(rows[first + number, byte])
                delta = (value - last) & 255
                deltas[number] = (delta << 1 & 255) ^ (255 if delta > 127 else 0)
                last = value
            deltas[here:] = 0
            modes = at
            at += -(-groups // 4)
            data[modes:at] = 0
            for group in range(groups):
                numbers = deltas[group * GROUP : (group + 1) * GROUP]
                mode = _shortest(numbers)
                data[modes + group // 4] |= mode << (group % 4 * 2)
                at = _pack_group(numbers, _bits_of(-1, mode), data, at)
    return at


@inlined
def _shortest(numbers: Bytes) -> int:
    """Return the mode of version 0 that takes the fewest bytes."""
    large = two = four = 0
    for number in numbers:
        large += number > 0
        two += number >= 3
        four += number >= 15
    if large == 0:
        return 0
    if 4 + two <= 8 + four:
        return 1 if 4 + two < GROUP else 3
    return 2 if 8 + four < GROUP else 3


@inlined
def _pack_group(numbers: Bytes, bits: int, data: Bytes, at: int) -> int:
    """Encode the sixteen numbers of a group; return where the next one begins."""
    if bits == 0:
        return at
    if bits == 8:
        data[at : at + GROUP] = numbers
        return at + GROUP
    escape, each = (1 << bits) - 1, 8 // bits
    more = at + 2 * bits
    data[at:more] = 0
    for place in range(GROUP):
        number = min(int(numbers[place]), escape)
        data[at + place // each] |= number << ((each - 1 - place % each) * bits)
        if number == escape:
            data[more] = numbers[place]
            more += 1
    return more
