r"""Code signals over a graph: basis vectors over a mesh, and their coefficients over time.

Nodes are coded from coarse to fine levels. Each value is predicted from known values (`predictor`), the residual is
rounded to a whole number of steps, and this number is written bit by bit: its length, its bits, its sign. The
probability of a bit is mixed (`arithmetic`) from five contexts, which combine the mean size :math:`s` of this signal's
numbers at the neighbours, the *activity* :math:`a` of the node, an average of the sizes of its numbers in earlier
signals, weighted towards newer signals, and its mean :math:`\bar a` over adjacent nodes; the expected size
:math:`0.80\, s + 0.40\, a + 0.15\, \bar a`; the level of the node; and its number in the previous signal. A stream ends
with the CRC-32 of all its values.

The same compiled loop writes and reads numbers. A second loop reconstructs values from numbers, as the contexts of a
number depend on numbers only.

Frozen: changing this breaks old files (specified in ``docs/file-format.md``; golden:
``tests/compression/golden/*.npz``); how encoders round is free. All decisions use integers, except the sums of
`predictor.predict`, which are rounded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream import arithmetic
from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    EVEN_PROBABILITY,
    BitModels,
    BitStream,
    CoderState,
    append_checksum,
    bit_length,
    checksum_of,
    code_bit,
    code_modelled_bit,
    code_raw_bits,
    load_state,
    new_bit_models,
    split_checksum,
    store_state,
)
from mixseq.compression.bitstream.predictor import UNITS_PER_STEP, Predictor, predict
from mixseq.compression.bitstream.signal_graph import SignalGraph
from mixseq.errors import FormatError
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index, Int32, IntArray

SIZE_LEVELS = 32  # number of levels of expected sizes, two per octave; frozen
DEPTH_CLASSES = 18  # number of node classes by bit length of the node number, roughly the level in the graph; frozen
AGE_CLASSES = 8  # number of signal classes by number of earlier signals; frozen
CONTEXTS_PER_BIT, CONTEXT_VALUES = 5, SIZE_LEVELS * SIZE_LEVELS  # of a bit, and values of each; frozen
_MAX_MODELLED_BITS, _MAX_NUMBER_BITS = 24, 55  # largest bit lengths, coded with models only and of a number; frozen
POSITION_COUNT = 2 * _MAX_MODELLED_BITS  # number of modelled questions about a number; frozen

_MAX_ROUNDED_NUMBER = 2.0**54
"""Largest magnitude of numbers, as trial steps may be too fine for doubles. Free: only encoders round."""

_MAX_SIZE = 1 << 40  # upper bound to which sizes are clamped; frozen


@compiled
def code_numbers(
    stream: BitStream,
    models: BitModels,
    age: int,
    neighbours: Int32,
    counts: Int32,
    activity: Index,
    ring_activity: Index,
    previous: Index,
    numbers: Index,
) -> None:
    """Write or read the `numbers` ``(N,)`` of a signal; `age` is the number of earlier signals.

    `activity` and `ring_activity` ``(N,)`` are in units of 1 / `UNITS_PER_STEP`; `previous` ``(N,)`` are the numbers
    of the previous signal.
    """
    state = load_state(stream)
    age = min(size_level(age), AGE_CLASSES - 1)
    depth = 0
    for node in range(len(numbers)):
        while node >> depth:
            depth += 1
        size = mean_neighbour_size(node, neighbours, counts, activity, numbers)
        expected = expected_size(size, activity[node], ring_activity[node])
        here, own, ring = size_level(size), size_level(activity[node]), size_level(ring_activity[node])
        fine = min(fine_size_level(expected), CONTEXT_VALUES // DEPTH_CLASSES - 1)
        contexts = (
            here * SIZE_LEVELS + own,
            own * SIZE_LEVELS + ring,
            fine * DEPTH_CLASSES + min(depth, DEPTH_CLASSES - 1),
            here * SIZE_LEVELS + size_level(UNITS_PER_STEP * min(abs(previous[node]), _MAX_SIZE)),
            size_level(expected) * AGE_CLASSES + age,
        )
        numbers[node], state = code_signed_number(stream, state, models, contexts, numbers[node])
    store_state(stream, state)


@compiled
def round_signal(
    targets: Float,
    margins: Float,
    neighbours: Int32,
    counts: Int32,
    weights: Float,
    steps: Index,
    activity: Index,
    ring_activity: Index,
    numbers: Index,
    values: Index,
) -> None:
    """Round the residuals of `targets` ``(N,)`` to `numbers` ``(N,)``, and write the decoded `values` ``(N,)``.

    Targets, values and `steps` ``(N,)`` are in units of 1 / `UNITS_PER_STEP`. Residuals are rounded up if their
    fraction is at least 1 - `margins` ``(SIZE_LEVELS,)``, by level of expected size. Free: only encoders round.
    """
    for node in range(len(values)):
        size = mean_neighbour_size(node, neighbours, counts, activity, numbers)
        margin = margins[size_level(expected_size(size, activity[node], ring_activity[node]))]
        prediction = predict(node, neighbours, counts, weights, values)
        residual = targets[node] - prediction
        number = math.floor(min(abs(residual) / steps[node] + margin, _MAX_ROUNDED_NUMBER))
        numbers[node] = -number if residual < 0.0 else number
        values[node] = prediction + steps[node] * numbers[node]


@compiled
def reconstruct_values(
    numbers: Index, neighbours: Int32, counts: Int32, weights: Float, steps: Index, values: Index
) -> None:
    """Write the `values` ``(N,)`` decoded from `numbers` ``(N,)``."""
    for node in range(len(values)):
        values[node] = predict(node, neighbours, counts, weights, values) + steps[node] * numbers[node]


@force_inlined
def mean_neighbour_size(node: int, neighbours: Int32, counts: Int32, activity: Index, numbers: Index) -> int:
    """Return the mean size of the numbers at a node's neighbours, or the node's activity if it has no neighbours."""
    if not counts[node]:
        return activity[node]  # type: ignore[no-any-return]
    total = 0
    for i in range(counts[node]):
        total += min(abs(numbers[neighbours[node, i]]), _MAX_SIZE)
    return UNITS_PER_STEP * total // counts[node]  # type: ignore[no-any-return]


@force_inlined
def expected_size(size: int, activity: int, ring_activity: int) -> int:
    """Return the expected size of a number: .80 size (mean at neighbours) + .40 activity + .15 ring activity."""
    return (205 * size + 102 * activity + 38 * ring_activity) >> 8


@force_inlined
def code_signed_number(
    stream: BitStream, state: CoderState, models: BitModels, contexts: tuple[int, ...], number: int
) -> tuple[int, CoderState]:
    """Write or read a number: its bit length, the bit after the highest bit, the remaining bits, and the sign."""
    magnitude = abs(number)
    bits = bit_length(magnitude)
    size, bit = 0, 1
    while size < _MAX_MODELLED_BITS and bit:
        bit, state = code_modelled_bit(stream, state, models, contexts, size, 1 if bits > size else 0)
        size += bit
    while bit and size < _MAX_NUMBER_BITS:
        bit, state = code_bit(stream, state, EVEN_PROBABILITY, 1 if bits > size else 0)
        size += bit
    if size == 0:
        return 0, state
    value = 1
    if size > 1:
        rest = size - 2  # bits without a model
        position = _MAX_MODELLED_BITS + min(size, _MAX_MODELLED_BITS) - 2
        top, state = code_modelled_bit(stream, state, models, contexts, position, (magnitude >> rest) & 1)
        low_bits, state = code_raw_bits(stream, state, rest, magnitude)
        value = ((2 + top) << rest) | low_bits
    is_negative, state = code_bit(stream, state, EVEN_PROBABILITY, 1 if number < 0 else 0)
    return -value if is_negative else value, state


@force_inlined
def size_level(size: int) -> int:
    """Return the level of a size in units of 1 / `UNITS_PER_STEP`, two per octave."""
    bits = bit_length(size)
    return min(size if bits < 2 else 2 * (bits - 1) + ((size >> (bits - 2)) & 1), SIZE_LEVELS - 1)


@force_inlined
def fine_size_level(size: int) -> int:
    """Return the level of a size in units of 1 / `UNITS_PER_STEP`, four per octave."""
    bits = bit_length(size)
    return size if bits < 3 else 4 * (bits - 2) + ((size >> (bits - 3)) & 3)


@compiled
def update_activity(numbers: Index, ring: Int32, starts: Index, activity: Index) -> tuple[Index, Index]:
    """Return the activity ``(N,)`` updated by a signal's numbers ``(N,)``, and its means over rings ``(N,)``."""
    updated, ring_activity = np.empty_like(activity), np.empty_like(activity)
    for node in range(len(numbers)):
        size = UNITS_PER_STEP * min(abs(numbers[node]), _MAX_SIZE)
        updated[node] = (102 * activity[node] + 154 * size) >> 8
    for node in range(len(numbers)):
        total, first, last = 0, starts[node], starts[node + 1]
        for place in range(first, last):
            total += updated[ring[place]]
        ring_activity[node] = total // (last - first) if last > first else 0
    return updated, ring_activity


ROUNDING_MARGINS: Float = np.interp(np.arange(SIZE_LEVELS), [2, 6, 10, 14], [0.15, 0.25, 0.38, 0.45])
"""Margins by level of expected size: a residual is rounded up if its fraction is at least 1 - margin. Where
zeros are expected, margins are smallest, as zeros save most bits. Chosen on seven sequences. Free: only encoders round.
"""

_MAX_BYTES_PER_NUMBER = 16  # bytes reserved in the stream per number; free: memory is allocated ahead


class Signal(NamedTuple):
    """A rounded signal before coding; immutable, with 5 to 20 bytes per node unless its numbers exceed 32 bits."""

    age: int  # number of earlier signals
    neighbours: Int32  # (N, n) earlier nodes that predict every node
    counts: Int32  # (N,) number of neighbours of every node
    # Activity, ring activity and numbers of the previous signal, for code_numbers.
    sizes: tuple[IntArray, IntArray, IntArray]
    numbers: IntArray  # (N,) numbers of the signal, in coding order of nodes
    values: IntArray  # (N,) decoded values, in units of 1 / UNITS_PER_STEP


def _compact(numbers: Index) -> IntArray:
    """Return a copy of integers in the smallest type."""
    return numbers.astype(np.min_scalar_type(-int(np.abs(numbers).max(initial=0)) - 1))


def new_number_models() -> BitModels:
    """Return untrained models of the bits of numbers, which signals over several graphs can share."""
    return new_bit_models(CONTEXTS_PER_BIT, CONTEXT_VALUES, POSITION_COUNT)


class Writer:
    """Write signals to a stream; `finish` returns its bytes."""

    def __init__(self) -> None:
        self._stream = arithmetic.new_output_stream(1 << 12)
        self._checksum = 0

    def reserve(self, count: int) -> BitStream:
        """Return the stream with room for `count` numbers."""
        self._stream = arithmetic.reserve(self._stream, _MAX_BYTES_PER_NUMBER * (count + 1))
        return self._stream

    def write(self, signal: Signal, models: BitModels) -> None:
        """Write a signal, and update the models."""
        stream, graph = self.reserve(len(signal.numbers)), (signal.neighbours, signal.counts)
        arrays = [array.astype(np.int64) for array in (*signal.sizes, signal.numbers)]
        code_numbers(stream, models, signal.age, *graph, *arrays)
        self.add_to_checksum(signal.values)

    def add_to_checksum(self, values: IntArray) -> None:
        """Add values to the checksum of the stream."""
        self._checksum = checksum_of(values, self._checksum)

    def finish(self) -> bytes:
        """Return the bytes of the stream with its checksum."""
        return append_checksum(arithmetic.finish_stream(self._stream), self._checksum)


class Reader:
    """Read the output of a `Writer` in order."""

    def __init__(self, data: bytes) -> None:
        data, self._expected_checksum = split_checksum(data)
        self._stream = arithmetic.new_input_stream(data)
        self._checksum = 0

    def stream(self) -> BitStream:
        """Return the stream; raise `FormatError` if it ended early."""
        if arithmetic.is_past_end(self._stream):
            raise FormatError(f"the coded signals are damaged, they end early; {DAMAGE_CURE}")
        return self._stream

    def add_to_checksum(self, values: Index) -> None:
        """Add decoded values to the checksum."""
        self._checksum = checksum_of(values, self._checksum)

    def finish(self) -> None:
        """Verify the checksum of all values."""
        if self._checksum != self._expected_checksum:
            raise FormatError(
                f"the decoded signals differ from the coded ones: the file is damaged; {DAMAGE_CURE}. If intact files "
                "fail on this machine only, it or a library does not compute as IEEE 754 prescribes"
            )


class SignalCoder:
    """Round signals over one graph for coding, or read signals, one after another."""

    def __init__(self, graph: SignalGraph, coordinates: int = 1, models: BitModels | None = None) -> None:
        self._graph = graph
        self._predictor = Predictor(graph, coordinates)
        self._models = models or new_number_models()
        # Arrays of the newest signal, replaced but never changed in place, as signals share them.
        self._numbers = np.zeros(graph.size, dtype=np.int64)
        self._activity, self._ring_activity = np.zeros_like(self._numbers), np.zeros_like(self._numbers)
        self._signal_count = 0

    def round(self, targets: Float) -> tuple[Float, Signal]:
        """Round a signal ``(N,)``, in steps; return its decoded values ``(N,)`` and the rounded signal."""
        predictor, numbers = self._predictor, np.empty_like(self._numbers)
        graph, steps = (predictor.neighbours, predictor.counts), (predictor.weights, predictor.steps)
        units = UNITS_PER_STEP * np.asarray(targets, dtype=np.float64)[self._graph.order]
        activity = self._activity, self._ring_activity
        round_signal(units, ROUNDING_MARGINS, *graph, *steps, *activity, numbers, predictor.values)
        sizes = _compact(activity[0]), _compact(activity[1]), _compact(self._numbers)
        signal = Signal(self._signal_count, *graph, sizes, _compact(numbers), _compact(predictor.values))
        return self._finish(numbers), signal

    def read(self, reader: Reader) -> Float:
        """Return the values ``(N,)`` in steps of the next signal; raise `FormatError` if the stream ends early."""
        predictor, numbers = self._predictor, np.zeros_like(self._numbers)
        graph, sizes = (predictor.neighbours, predictor.counts), (self._activity, self._ring_activity, self._numbers)
        code_numbers(reader.stream(), self._models, self._signal_count, *graph, *sizes, numbers)
        reconstruct_values(numbers, *graph, predictor.weights, predictor.steps, predictor.values)
        reader.add_to_checksum(predictor.values)
        return self._finish(numbers)

    def _finish(self, numbers: Index) -> Float:
        """Learn from the newest signal, with the given numbers ``(N,)``; return its values ``(N,)`` in steps."""
        graph, values = self._graph, np.empty(self._graph.size)
        values[graph.order] = self._predictor.values / UNITS_PER_STEP
        self._predictor.finish()
        self._numbers, self._signal_count = numbers, self._signal_count + 1
        self._activity, self._ring_activity = update_activity(numbers, graph.ring, graph.ring_starts, self._activity)
        return values
