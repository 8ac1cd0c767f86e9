r"""Code bits by binary arithmetic coding, predict bits with adaptive models, and check decoded numbers.

*Coding.* Encoder and decoder compute the same probability for each bit, from earlier bits. An interval of 32-bit
numbers is split in the ratio of the probabilities of 1 and 0, and the part of the actual bit is kept.

*Models.* A bit has a *position* (first question on a number, second, ...) and, in every input, a *context*, which is a
small integer. In context :math:`c` of input :math:`i`, :math:`n_{ic}` bits at this position were 1 with the relative
frequency :math:`p_{ic}`. Inputs are mixed in the logistic domain (Mahoney 2005, *Adaptive weighing of context models
for lossless data compression*),

.. math:: x_i = \frac{n_{ic}}{n_{ic} + 1} \ln \frac{p_{ic}}{1 - p_{ic}}, \qquad x = \sum_i w_i x_i,
          \qquad p = \frac{1}{1 + e^{-x}}

After the bit :math:`b`, frequencies move towards :math:`b`, and weights of the position become
:math:`w_i \leftarrow w_i + \eta (b - p) x_i`. All values are integers below :math:`2^{49}`: :math:`p` and :math:`w` in
units of :math:`2^{-16}`, :math:`x` in units of :math:`2^{-8}`.

*Hashed contexts* replace tables that would be too large. A bit has a kind and, in every input, a context, which is any
64-bit number. Contexts share frequencies if the highest 16 bits of their product with a constant are the same.

*Checks.* A stream ends with the CRC-32 of its decoded numbers. Different rounding, an error in a library or port, or a
damaged file changes these, and raises an error.

Frozen: changing this breaks old files (specified in ``docs/file-format.md``; golden:
``tests/compression/golden/*.npz``).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numba.cpython.unsafe.numbers import leading_zeros
from numba.extending import overload
from numpy.typing import NDArray

from mixseq.runtime.jit import force_inlined
from mixseq.types import Index, IntArray

CHECKSUM_SIZE = 4  # bytes of the CRC-32 at the end of a stream, lowest byte first; frozen


def checksum_of(numbers: IntArray, initial: int = 0) -> int:
    """Return the CRC-32 of integers of any shape, 8 bytes each, continued from the CRC-32 `initial`."""
    return crc32(numbers.astype("<i8").tobytes(), initial)


def append_checksum(data: bytes, checksum: int) -> bytes:
    """Append the CRC-32 of the decoded numbers to a stream."""
    return data + checksum.to_bytes(CHECKSUM_SIZE, "little")


DAMAGE_CURE = "restore the file, or compress the original again"  # cure of damaged streams; free: wording


def split_checksum(data: bytes) -> tuple[bytes, int]:
    """Split a stream into its data and the CRC-32 of the decoded numbers."""
    return data[:-CHECKSUM_SIZE], int.from_bytes(data[-CHECKSUM_SIZE:], "little")


PROBABILITY_SCALE = 1 << 16  # integer that represents the probability 1; frozen
EVEN_PROBABILITY = PROBABILITY_SCALE // 2  # probability of bits without a model; frozen
_MAX_INTERVAL_END = (1 << 32) - 1  # largest end of an interval; frozen
PADDING_BYTES = 4  # zero bytes that may be read beyond the end of the stream; frozen


class BitStream(NamedTuple):
    """A byte buffer, and the state of writing or reading between two calls of compiled loops."""

    is_input: bool  # whether bits are read
    data: NDArray[np.uint8]  # (n,) bytes to read, or buffer for written bytes
    state: Index  # (4,) values of a `CoderState`


class CoderState(NamedTuple):
    """The state of writing or reading between two bits; loops hold it in local variables, which stay in registers."""

    low: int  # ends of the interval
    high: int
    number: int  # coded number in the interval when reading
    place: int  # index of the next byte


def new_output_stream(capacity: int) -> BitStream:
    """Return an empty stream with room for `capacity` bytes."""
    return BitStream(False, np.zeros(capacity, dtype=np.uint8), np.array([0, _MAX_INTERVAL_END, 0, 0], dtype=np.int64))


def reserve(stream: BitStream, capacity: int) -> BitStream:
    """Return the stream with room for at least `capacity` more bytes."""
    written = int(stream.state[3])
    if len(stream.data) - written >= capacity:
        return stream
    data = np.zeros(2 * written + capacity, dtype=np.uint8)
    data[:written] = stream.data[:written]
    return stream._replace(data=data)


def new_input_stream(data: bytes) -> BitStream:
    """Return a stream for reading the output of `finish_stream`."""
    padded = np.frombuffer(data + bytes(PADDING_BYTES), dtype=np.uint8).copy()
    first = int.from_bytes(padded[:4].tobytes(), "big")
    return BitStream(True, padded, np.array([0, _MAX_INTERVAL_END, first, 4], dtype=np.int64))


def finish_stream(stream: BitStream) -> bytes:
    """Return the bytes of a stream; the last bytes are the shortest number in the interval."""
    low, high, _, place = map(int, stream.state)
    tail = b""
    for size in range(5):
        unit = 1 << 8 * (4 - size)
        number = -(-low // unit) * unit
        if number <= high:
            tail = number.to_bytes(4, "big")[:size]
            break
    return stream.data[:place].tobytes() + tail


def is_past_end(stream: BitStream) -> bool:
    """Return whether bits were read beyond the end of a stream; compiled loops use `has_failed`."""
    return bool(stream.state[3] > len(stream.data) + PADDING_BYTES)


@force_inlined
def load_state(stream: BitStream) -> CoderState:
    """Return the state of a stream."""
    return CoderState(stream.state[0], stream.state[1], stream.state[2], stream.state[3])


@force_inlined
def store_state(stream: BitStream, state: CoderState) -> None:
    """Set the state of a stream."""
    for i in range(4):
        stream.state[i] = state[i]


@force_inlined
def code_bit(stream: BitStream, state: CoderState, probability: int, bit: int) -> tuple[int, CoderState]:
    """Write or read a bit that is 1 with probability `probability` / 65536; return the bit and the new state."""
    low, high, number, place = state
    middle = low + (((high - low) * probability) >> 16)
    if stream.is_input:
        bit = 1 if number <= middle else 0
    if bit:
        high = middle
    else:
        low = middle + 1
    while (low ^ high) >> 24 == 0:
        if stream.is_input:
            byte = stream.data[place] if place < len(stream.data) else 0
            number = ((number & 0xFFFFFF) << 8) | byte
        else:
            stream.data[place] = high >> 24
        place += 1
        low, high = (low & 0xFFFFFF) << 8, ((high & 0xFFFFFF) << 8) | 0xFF
    return bit, CoderState(low, high, number, place)


@force_inlined
def code_raw_bits(stream: BitStream, state: CoderState, size: int, number: int) -> tuple[int, CoderState]:
    """Write or read the last `size` bits of a number without a model; return them and the new state."""
    value = 0
    for shift in range(size - 1, -1, -1):
        bit, state = code_bit(stream, state, EVEN_PROBABILITY, (number >> shift) & 1)
        value = (value << 1) | bit
    return value, state


def bit_length(number: int) -> int:
    """Return the bit length of a number's magnitude; in compiled loops, from one instruction of the processor."""
    return int(abs(number)).bit_length()


@overload(bit_length, jit_options={"forceinline": True, "nogil": True})
def _compiled_bit_length(number: int) -> Callable[[int], int]:
    def bit_length(number: int) -> int:
        return 64 - leading_zeros(abs(np.int64(number)))  # type: ignore[call-arg]

    return bit_length


_MAX_LOGIT = 2047  # largest magnitude of x, in units of 2^-8: about 8, a probability of 1 in 3000; frozen
_MAX_FREQUENCY_COUNT = 255  # largest count in the running mean of a frequency; frozen
_LEARNING_RATE = 48  # learning rate of weights, in 1 / 4096 of x's and p's units; frozen
_MIN_PROBABILITY = 16  # smallest probability of either bit, in units of 2^-16; frozen


MAX_BITS_PER_BYTE = 17_000  # upper bound: by `_MAX_LOGIT`, a bit takes 4.8e-4 bits or more; free: a check


class BitModels(NamedTuple):
    """Frequencies and mixing weights of bits, by position and context."""

    # (inputs, contexts, positions) frequencies of 1, and the numbers of bits counted: 256 p + n.
    frequencies: NDArray[np.int32]
    weights: Index  # (kinds, inputs) mixing weights; kinds are positions, except for hashed contexts
    inputs: Index  # (inputs,) the inputs x of the current bit
    stretch: Index  # (4096,) table of x by p, with p in units of 2^-12
    squash: Index  # (2 _MAX_LOGIT + 1,) table of p by x, from x = -_MAX_LOGIT on
    rates: Index  # (_MAX_FREQUENCY_COUNT + 1,) table of the rates of frequencies by n, in units of 2^-16
    confidences: Index  # (_MAX_FREQUENCY_COUNT + 1,) table of n / (n + 1) by n, in units of 2^-8


def new_bit_models(inputs: int, contexts: int, positions: int, kinds: int | None = None) -> BitModels:
    """Return untrained models; by default every position is a kind."""
    return BitModels(
        np.full((inputs, contexts, positions), 1 << 23, dtype=np.int32),
        np.full((kinds or positions, inputs), ((1 << 16) + inputs // 2) // inputs, dtype=np.int64),
        np.zeros(inputs, dtype=np.int64),
        *_logistic_tables(),
    )


@lru_cache(maxsize=1)
def _logistic_tables() -> tuple[Index, Index, Index, Index]:
    """Return the last four arrays of `BitModels`."""
    squash = np.ones(2 * _MAX_LOGIT + 1)
    factor = 1.0039138893383475  # exp(1 / 256), and products of it: exp itself differs between machines
    for x in range(_MAX_LOGIT):
        squash[_MAX_LOGIT + x + 1] = squash[_MAX_LOGIT + x] * factor
    squash[:_MAX_LOGIT] = 1 / squash[:_MAX_LOGIT:-1]
    squash = np.floor(65536 * (squash / (1 + squash)))
    stretch = np.searchsorted(squash, np.arange(4096) * 16 + 8).clip(0, 2 * _MAX_LOGIT) - _MAX_LOGIT
    counts = np.arange(_MAX_FREQUENCY_COUNT + 1, dtype=np.int64)
    return (
        stretch.astype(np.int64),
        squash.astype(np.int64).clip(_MIN_PROBABILITY, 65536 - _MIN_PROBABILITY),
        (1 << 17) // (2 * counts + 3),
        256 * counts // (counts + 1),
    )


@force_inlined
def code_modelled_bit(
    stream: BitStream, state: CoderState, models: BitModels, contexts: tuple[int, ...], position: int, bit: int
) -> tuple[int, CoderState]:
    """Write or read a bit at a position in contexts, update the models, and return the bit and the new state."""
    return code_bit_of_kind(stream, state, models, contexts, position, position, bit)


@force_inlined
def code_bit_of_kind(
    stream: BitStream,
    state: CoderState,
    models: BitModels,
    contexts: tuple[int, ...],
    position: int,
    kind: int,
    bit: int,
) -> tuple[int, CoderState]:
    """Write or read a bit as `code_modelled_bit` does, with the mixing weights of a kind."""
    frequencies, weights, inputs = models.frequencies, models.weights, models.inputs
    x = 0
    for i in range(len(contexts)):
        frequency = frequencies[i, contexts[i], position]
        inputs[i] = (models.stretch[frequency >> 12] * models.confidences[frequency & 255]) >> 8
        x += weights[kind, i] * inputs[i]
    probability = models.squash[min(max(x >> 16, -_MAX_LOGIT), _MAX_LOGIT) + _MAX_LOGIT]
    bit, state = code_bit(stream, state, probability, bit)
    error = ((bit << 16) - probability) >> 4
    for i in range(len(contexts)):
        weights[kind, i] += (inputs[i] * error * _LEARNING_RATE + (1 << 15)) >> 16
        frequency = frequencies[i, contexts[i], position]
        p, count = frequency >> 8, frequency & 255
        p += (((bit << 16) - bit - p) * models.rates[count]) >> 16
        frequencies[i, contexts[i], position] = (p << 8) + min(count + 1, _MAX_FREQUENCY_COUNT)
    return bit, state


CONTEXTS_PER_BIT = 8  # number of contexts of a bit; frozen
CONTEXT_SLOTS = 1 << 16  # number of hashed contexts per input; frozen

HASH_MULTIPLIER = np.uint64(11400714819323198485)
"""Multiplier of the hash: 2^64 / golden ratio. Unsigned: LLVM assumes no signed overflow. Frozen: breaks old files."""

_HASH_SHIFT = np.uint64(48)  # right shift of a product to its highest 16 bits, the slot; frozen
_MAX_BYTES_PER_BIT = 2  # largest number of bytes per bit, as probabilities are at least 2^-12; free: allocated ahead


class HashedBits(NamedTuple):
    """Bits that are written or read, and their models."""

    stream: BitStream  # bytes that are written or read
    models: BitModels  # models of slots and kinds
    contexts: Index  # (CONTEXTS_PER_BIT,) current contexts, arbitrary integers, set before every bit
    failed: Index  # (1,) whether the input is damaged


def new_hashed_bits(stream: BitStream, kinds: int) -> HashedBits:
    """Return untrained models for the bits of a stream."""
    models = new_bit_models(CONTEXTS_PER_BIT, CONTEXT_SLOTS, 1, kinds)
    return HashedBits(stream, models, np.zeros(CONTEXTS_PER_BIT, dtype=np.int64), np.zeros(1, dtype=np.int64))


def new_hashed_output(count: int, kinds: int) -> HashedBits:
    """Return untrained models, and an empty stream with room for `count` bits."""
    return new_hashed_bits(new_output_stream(_MAX_BYTES_PER_BIT * count), kinds)


def open_hashed_input(data: bytes, kinds: int) -> tuple[HashedBits, int]:
    """Return untrained models for reading the output of `finish_hashed`, and its checksum."""
    stream, checksum = split_checksum(data)
    return new_hashed_bits(new_input_stream(stream), kinds), checksum


def finish_hashed(bits: HashedBits, checksum: int) -> bytes:
    """Return the bytes of written bits, with the checksum of the numbers that they code."""
    return append_checksum(finish_stream(bits.stream), checksum)


def reserve_bits(bits: HashedBits, count: int) -> HashedBits:
    """Return the models and the stream with room for `count` more bits."""
    return bits._replace(stream=reserve(bits.stream, _MAX_BYTES_PER_BIT * count))


@force_inlined
def code_hashed_bit(bits: HashedBits, kind: int, bit: int) -> int:
    """Write or read a bit of a kind in the current contexts, update the models, and return the bit."""
    c = bits.contexts
    slots = (_slot(c[0]), _slot(c[1]), _slot(c[2]), _slot(c[3]), _slot(c[4]), _slot(c[5]), _slot(c[6]), _slot(c[7]))
    bit, state = code_bit_of_kind(bits.stream, load_state(bits.stream), bits.models, slots, 0, kind, bit)
    store_state(bits.stream, state)
    return bit


@force_inlined
def _slot(context: int) -> int:
    """Return the slot of a hashed context."""
    return int(np.int64(np.uint64(context) * HASH_MULTIPLIER >> _HASH_SHIFT))


@force_inlined
def has_failed(bits: HashedBits) -> bool:
    """Return whether the stream is damaged or ends early; loops call it once per corner, to save time."""
    if bits.stream.state[3] > len(bits.stream.data) + PADDING_BYTES:
        bits.failed[0] = 1
    return bool(bits.failed[0])
