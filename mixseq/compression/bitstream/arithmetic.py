r"""Binary arithmetic coding: predicted bits to bytes, and back; models that predict them; checks of decoded numbers.

*Coding.* Encoder and decoder share a probability for each bit. An interval of 32-bit numbers is split in that
proportion, and the bit's half is kept; bytes on which both ends agree are output. The loss against the ideal is below a
thousandth. The probability of a bit depends on the bits before it, so the split is made inside compiled loops.

*Models.* The probability is mixed from several contexts. A bit has a *position* (first question about a number, second,
...) and a *context* in every input, a small integer. In context :math:`c` of input :math:`i` bits at that position were
1 with the relative frequency :math:`p_{ic}`, counted :math:`n_{ic}` times. Inputs are mixed in the logistic domain
(Mahoney 2005, *Adaptive weighing of context models for lossless data compression*),

.. math:: x_i = \frac{n_{ic}}{n_{ic} + 1} \ln \frac{p_{ic}}{1 - p_{ic}}, \qquad x = \sum_i w_i x_i,
          \qquad p = \frac{1}{1 + e^{-x}}

so that a new context contributes nothing. After the bit :math:`b`, frequencies move towards it, and weights of the
position by :math:`w_i \leftarrow w_i + \eta (b - p) x_i`. Values are integers: :math:`p` in units of :math:`2^{-16}`,
:math:`x` of :math:`2^{-8}`, :math:`w` of :math:`2^{-16}`, all below :math:`2^{49}`.

*Hashed contexts* are too numerous for tables. A bit has a kind and, in every input, a context, any 64-bit number.
Contexts share frequencies if the highest 16 bits of their product with a constant are the same.

*Checks.* Streams end with the CRC-32 of the numbers that they decode to. Decoding repeats every prediction of the
encoder. Different rounding, an error in a library or port, and a damaged file would lead to other numbers; the check
turns all of these into one error.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/*.npz`` and
``tests/formats/golden/compressed-v1.h5``). numba caches compiled loops by the text of their own file: edit those that
inline these functions (`connectivity_kernels`, `uv_seams`, `uv_values`) whenever this module changes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from mixseq.runtime.jit import force_inlined
from mixseq.types import Index, IntArray

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
    """Return whether more bits were read than there are; not compiled, as `has_failed` is."""
    return int(coded.place[0]) > len(coded.data) + BYTES_BEYOND


@force_inlined
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


@force_inlined
def code_number(coded: Coded, size: int, number: int) -> int:
    """Write or read the last `size` bits of a number without a model, and return them."""
    found = 0
    for place in range(size - 1, -1, -1):
        found = (found << 1) | code_bit(coded, 32768, (number >> place) & 1)
    return found


@force_inlined
def bit_length(number: int) -> int:
    """Return the bit length of a number's magnitude."""
    size, bits = abs(number), 0
    while size >= 1 << 16:
        size, bits = size >> 16, bits + 16
    if size >= 1 << 8:
        size, bits = size >> 8, bits + 8
    if size >= 1 << 4:
        size, bits = size >> 4, bits + 4
    if size >= 1 << 2:
        size, bits = size >> 2, bits + 2
    if size >= 1 << 1:
        size, bits = size >> 1, bits + 1
    return bits + size


_FAR = 2047
"""Largest magnitude of x, in units of 2^-8: about 8, a probability of 1 in 3000. Frozen: breaks old files."""

_PATIENCE = 255
"""Largest count in the running mean of a frequency. Frozen: breaks old files."""

_RATE = 48
"""Learning rate of weights, in 1 / 4096 of x's and p's units. Frozen: breaks old files."""

_LEAST = 16
"""Smallest probability of either bit, in units of 2^-16. Frozen: breaks old files."""


class BitModels(NamedTuple):
    """Frequencies and mixing weights of bits, by position and context."""

    # (inputs, contexts, positions) frequencies of 1, and the numbers of bits counted: 256 p + n.
    shares: NDArray[np.int32]
    weights: Index  # (kinds, inputs) weights. Kinds are the positions, unless contexts tell these apart
    contexts: Index  # (inputs,) current contexts, set before every bit
    inputs: Index  # (inputs,) the inputs x of the current bit
    stretch: Index  # (4096,) table of x by p, with p in units of 2^-12
    squash: Index  # (2 _FAR + 1,) table of p by x, from x = -_FAR on
    steps: Index  # (_PATIENCE + 1,) table of the rates of frequencies by n, in units of 2^-16
    trust: Index  # (_PATIENCE + 1,) table of n / (n + 1) by n, in units of 2^-8


def bit_models(inputs: int, contexts: int, positions: int, kinds: int | None = None) -> BitModels:
    """Return untrained models; by default every position is a kind."""
    return BitModels(
        np.full((inputs, contexts, positions), 1 << 23, dtype=np.int32),
        np.full((kinds or positions, inputs), ((1 << 16) + inputs // 2) // inputs, dtype=np.int64),
        np.zeros(inputs, dtype=np.int64),
        np.zeros(inputs, dtype=np.int64),
        *_tables(),
    )


@lru_cache(maxsize=1)
def _tables() -> tuple[Index, Index, Index, Index]:
    """Return the last four arrays of `BitModels`."""
    squash = np.ones(2 * _FAR + 1)
    factor = 1.0039138893383475  # exp(1 / 256), and products of it: exp itself differs between machines
    for x in range(_FAR):
        squash[_FAR + x + 1] = squash[_FAR + x] * factor
    squash[:_FAR] = 1 / squash[:_FAR:-1]
    squash = np.floor(65536 * (squash / (1 + squash)))
    stretch = np.searchsorted(squash, np.arange(4096) * 16 + 8).clip(0, 2 * _FAR) - _FAR
    counts = np.arange(_PATIENCE + 1, dtype=np.int64)
    return (
        stretch.astype(np.int64),
        squash.astype(np.int64).clip(_LEAST, 65536 - _LEAST),
        (1 << 17) // (2 * counts + 3),
        256 * counts // (counts + 1),
    )


@force_inlined
def code(coded: Coded, models: BitModels, position: int, bit: int) -> int:
    """Write or read a bit at a position in the current contexts, update the models, and return it."""
    return code_of_kind(coded, models, position, position, bit)


@force_inlined
def code_of_kind(coded: Coded, models: BitModels, position: int, kind: int, bit: int) -> int:
    """Write or read a bit as `code` does, with the mixing weights of a kind."""
    shares, weights, inputs, contexts = models.shares, models.weights, models.inputs, models.contexts
    x = 0
    for i in range(len(inputs)):
        share = shares[i, contexts[i], position]
        inputs[i] = (models.stretch[share >> 12] * models.trust[share & 255]) >> 8
        x += weights[kind, i] * inputs[i]
    chance = models.squash[min(max(x >> 16, -_FAR), _FAR) + _FAR]
    bit = code_bit(coded, chance, bit)
    error = ((bit << 16) - chance) >> 4
    for i in range(len(inputs)):
        weights[kind, i] += (inputs[i] * error * _RATE + (1 << 15)) >> 16
        share = shares[i, contexts[i], position]
        p, seen = share >> 8, share & 255
        p += (((bit << 16) - bit - p) * models.steps[seen]) >> 16
        shares[i, contexts[i], position] = (p << 8) + min(seen + 1, _PATIENCE)
    return bit


INPUTS = 8
"""Number of contexts of a bit. Frozen: breaks old files."""

SLOTS = 1 << 16
"""Number of hashed contexts per input. Frozen: breaks old files."""

SPREAD = np.uint64(11400714819323198485)
"""Multiplier of the hash: 2^64 / golden ratio. Unsigned: LLVM assumes no signed overflow. Frozen: breaks old files."""

_HIGHEST = np.uint64(48)
"""Right shift of a product to its highest 16 bits, the slot. Frozen: breaks old files."""

_BYTES_OF_BIT = 2
"""Bytes of a bit at most, as probabilities are above 2^-12. Free: memory is allocated ahead."""


class Bits(NamedTuple):
    """Bits that are written or read, and their models."""

    coded: Coded  # bytes that are written or read
    models: BitModels  # models of slots and kinds
    contexts: Index  # (INPUTS,) current contexts, any numbers, set before every bit
    failed: Index  # (1,) whether what is read is damaged


def bits_to_write(count: int, kinds: int) -> Bits:
    """Return untrained models, and room for `count` bits."""
    return _bits(to_write(_BYTES_OF_BIT * count), kinds)


def bits_to_read(data: bytes, kinds: int) -> Bits:
    """Return untrained models for reading the output of `arithmetic.written`."""
    return _bits(to_read(data), kinds)


def with_room_for_bits(bits: Bits, count: int) -> Bits:
    """Return the same with room for `count` further bits."""
    return bits._replace(coded=with_room(bits.coded, _BYTES_OF_BIT * count))


def _bits(coded: Coded, kinds: int) -> Bits:
    models = bit_models(INPUTS, SLOTS, 1, kinds)
    return Bits(coded, models, np.zeros(INPUTS, dtype=np.int64), np.zeros(1, dtype=np.int64))


@force_inlined
def code_hashed(bits: Bits, kind: int, bit: int) -> int:
    """Write or read a bit of a kind in the current contexts, update the models, and return it."""
    slots, contexts = bits.models.contexts, bits.contexts
    for i in range(INPUTS):
        slots[i] = np.int64(np.uint64(contexts[i]) * SPREAD >> _HIGHEST)
    return code_of_kind(bits.coded, bits.models, 0, kind, bit)


@force_inlined
def has_failed(bits: Bits) -> bool:
    """Return whether the stream is damaged or ends early; loops check once a corner, to save time."""
    if bits.coded.place[0] > len(bits.coded.data) + BYTES_BEYOND:
        bits.failed[0] = 1
    return bool(bits.failed[0])
