r"""Code signals over a graph: basis vectors over a mesh, and their coefficients over time.

Node by node, coarse to fine, a value is predicted from known values (`predictor`), the difference is rounded to a whole
number of steps, and the number is written bit by bit: its length, its bits, its sign. The probability of a bit is mixed
(`arithmetic`) from five contexts: the mean size of this signal's numbers at neighbours, with the *activity* of the
node, the size of its numbers in earlier signals, weighted towards newer ones; the activity with its mean around the
node; a sum of all three,

.. math:: 0.80\, s + 0.40\, a + 0.15\, \bar a,

with the level of the node in the graph, and with the number of signals before; and the size at neighbours with the
number that the node had in the signal before.

A stream ends with the CRC-32 of all its values: different rounding, an error in a port and a damaged file raise one
error, and never decode to other points.

Numbers are written and read by the same compiled loop. Numbers and values have separate loops that can run at the same
time: a number is coded in contexts of other numbers, without values.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/*.npz``); how encoders round is free. All
decisions use integers, except the sums of `predictor_kernels.predict`, which are rounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream import arithmetic
from mixseq.compression.bitstream.arithmetic import (
    BitModels,
    Coded,
    bit_length,
    bit_models,
    check_of,
    code,
    code_number,
    with_check,
    without_check,
)
from mixseq.compression.bitstream.predictor import Predictor
from mixseq.compression.bitstream.predictor_kernels import UNIT, Small, predict
from mixseq.compression.bitstream.signal_graph import SignalGraph
from mixseq.errors import FormatError
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.runtime.parallel import WorkQueue
from mixseq.types import Float, Index, IntArray

LEVELS = 32
"""Number of levels of expected sizes, two in an octave. Frozen: breaks old files."""

DEPTHS = 18
"""Number of node classes, by bit length of the node number: about its level in the graph. Frozen: breaks old files."""

AGES = 8
"""Number of classes of signals by the count of those before. Frozen: breaks old files."""

INPUTS = 5
"""Contexts of a number. Frozen: breaks old files."""

CONTEXTS = LEVELS * LEVELS
"""Number of contexts per input. Frozen: breaks old files."""

_LONGEST = 24
"""Largest bit length with models for all questions. Frozen: breaks old files."""

_MOST = 55
"""Largest bit length of a number. Frozen: breaks old files."""

POSITIONS = 2 * _LONGEST
"""Number of modelled questions about a number. Frozen: breaks old files."""

_FARTHEST = 2.0**54
"""Largest magnitude of numbers: trial steps may be too fine for doubles. Free: only encoders round."""

_LARGEST = 1 << 40
"""Upper bound to which sizes are clamped. Frozen: breaks old files."""


@compiled
def code_numbers(
    coded: Coded,
    models: BitModels,
    age: int,
    neighbours: Small,
    counts: Small,
    activity: Index,
    around: Index,
    before: Index,
    numbers: Index,
) -> None:
    """Write or read the `numbers` ``(N,)`` int64 of a signal; `age` is the count of signals before.

    `activity` and `around` ``(N,)`` int64 are sizes of numbers in earlier signals, weighted towards newer ones, at a
    node and adjacent to it, in 1 / `UNIT` steps; `before` ``(N,)`` int64 are the numbers of the signal before.
    """
    contexts = models.contexts
    age = min(level(age), AGES - 1)
    bits = 0
    for node in range(len(numbers)):
        while node >> bits:
            bits += 1
        size = size_beside(node, neighbours, counts, activity, numbers)
        expected = expected_size(size, activity[node], around[node])
        here, beside, ring = level(size), level(activity[node]), level(around[node])
        depth = min(bits, DEPTHS - 1)
        contexts[0] = here * LEVELS + beside
        contexts[1] = beside * LEVELS + ring
        contexts[2] = min(fine_level(expected), CONTEXTS // DEPTHS - 1) * DEPTHS + depth
        contexts[3] = here * LEVELS + level(UNIT * min(abs(before[node]), _LARGEST))
        contexts[4] = level(expected) * AGES + age
        numbers[node] = code_signed(coded, models, numbers[node])


@compiled
def round_off(
    targets: Float,
    margins: Float,
    neighbours: Small,
    counts: Small,
    weights: Float,
    steps: Index,
    activity: Index,
    around: Index,
    numbers: Index,
    values: Index,
) -> None:
    """Predict `targets` ``(N,)`` node by node; write rounded differences `numbers`, decoded `values`, ``(N,)`` int64.

    Targets, `values`, `steps` ``(N,)`` are in 1 / `UNIT` steps; `activity` and `around` as in `code_numbers`. Numbers
    are rounded up from 1 - `margins` ``(LEVELS,)``, by the level of their expected size. Free: only encoders round.
    """
    for node in range(len(values)):
        size = size_beside(node, neighbours, counts, activity, numbers)
        margin = margins[level(expected_size(size, activity[node], around[node]))]
        predicted = predict(node, neighbours, counts, weights, values)
        off = targets[node] - predicted
        number = math.floor(min(abs(off) / steps[node] + margin, _FARTHEST))
        numbers[node] = -number if off < 0.0 else number
        values[node] = predicted + steps[node] * numbers[node]


@compiled
def add_predictions(
    numbers: Index, neighbours: Small, counts: Small, weights: Float, steps: Index, values: Index
) -> None:
    """Write the values ``(N,)`` decoded from numbers ``(N,)``."""
    for node in range(len(values)):
        values[node] = predict(node, neighbours, counts, weights, values) + steps[node] * numbers[node]


@force_inlined
def size_beside(node: int, neighbours: Small, counts: Small, activity: Index, numbers: Index) -> int:
    """Return the mean size of the numbers at a node's neighbours, in 1 / `UNIT` steps; its activity if it has none."""
    if not counts[node]:
        return activity[node]  # type: ignore[no-any-return]
    total = 0
    for i in range(counts[node]):
        total += min(abs(numbers[neighbours[node, i]]), _LARGEST)
    return UNIT * total // counts[node]  # type: ignore[no-any-return]


@force_inlined
def expected_size(size: int, activity: int, around: int) -> int:
    """Return the expected size of a number: .80 of `size` at neighbours, .40 of `activity`, .15 of that around."""
    return (205 * size + 102 * activity + 38 * around) >> 8


@force_inlined
def code_signed(coded: Coded, models: BitModels, number: int) -> int:
    """Write or read a number: its bit length, the highest of the bits after the first, the others, and the sign."""
    magnitude = abs(number)
    size = bit_length(magnitude)
    found = 0
    while found < _LONGEST and code(coded, models, found, 1 if size > found else 0):
        found += 1
    if found == _LONGEST:
        while found < _MOST and code_number(coded, 1, 1 if size > found else 0):
            found += 1
    if found == 0:
        return 0
    value = 1
    if found > 1:
        top = code(coded, models, _LONGEST + min(found, _LONGEST) - 2, (magnitude >> (found - 2)) & 1)
        value = ((2 + top) << (found - 2)) | code_number(
            coded, found - 2, magnitude & ((1 << (found - 2)) - 1)
        )
    return -value if code_number(coded, 1, 1 if number < 0 else 0) else value


@force_inlined
def level(size: int) -> int:
    """Return the level of a size in 1 / `UNIT` steps, two in an octave."""
    bits = bit_length(size)
    return min(size if bits < 2 else 2 * (bits - 1) + ((size >> (bits - 2)) & 1), LEVELS - 1)


@force_inlined
def fine_level(size: int) -> int:
    """Return the level of a size in 1 / `UNIT` steps, four in an octave."""
    bits = bit_length(size)
    return size if bits < 3 else 4 * (bits - 2) + ((size >> (bits - 3)) & 3)


@compiled
def sizes_after(numbers: Index, ring: Index, starts: Index, activity: Index) -> tuple[Index, Index]:
    """Return the activity ``(N,)`` after a signal's numbers ``(N,)``, and its means over rings ``(N,)``."""
    after, around = np.empty_like(activity), np.empty_like(activity)
    for node in range(len(numbers)):
        size = UNIT * min(abs(numbers[node]), _LARGEST)
        after[node] = (102 * activity[node] + 154 * size) >> 8
    for node in range(len(numbers)):
        total, first, last = 0, starts[node], starts[node + 1]
        for place in range(first, last):
            total += after[ring[place]]
        around[node] = total // (last - first) if last > first else 0
    return after, around


MARGINS: Float = np.interp(np.arange(LEVELS), [2, 6, 10, 14], [0.15, 0.25, 0.38, 0.45])
"""Numbers are rounded up from 1 - margin, by the level of their expected size: towards zero, most where zeros are
expected, as zeros save more bits than accuracy is worth. Chosen on seven sequences. Free: only encoders round.
"""

_ROOM = 16
"""Bytes of a number at most. Free: memory is allocated ahead."""

_MANY = 512
"""Count of numbers below which they are processed on the same thread: handing over takes as long. Free: time only."""

Contexts = tuple[int, Small, Small, Index, Index, Index]
"""Arguments of `code_numbers` besides models and numbers: signals before, neighbours, counts, sizes."""


class Signal(NamedTuple):
    """A rounded signal that is not yet coded; immutable."""

    known: int  # number of signals before
    neighbours: Small  # (N, n) nodes before, from which every node is predicted
    counts: Small  # (N,) number of neighbours of every node
    # Activity, its mean around, and numbers of the signal before, for code_numbers.
    sizes: tuple[IntArray, IntArray, IntArray]
    numbers: IntArray  # (N,) its numbers in nodes' order
    values: IntArray  # (N,) its decoded values, in steps / UNIT

    @classmethod
    def of(cls, contexts: Contexts, numbers: Index, values: Index) -> Signal:
        """Return a signal of 20 bytes a node, if its numbers are small enough for that."""
        known, neighbours, counts, activity, around, before = contexts
        sizes = _small(activity), _small(around), _small(before)
        return cls(known, neighbours, counts, sizes, _small(numbers), _small(values))


def _small(numbers: Index) -> IntArray:
    """Return a copy of integers, in 4 bytes each if they are small enough."""
    return numbers.astype(np.int32 if np.abs(numbers).max(initial=0) < 2**31 else np.int64)


class NumberModels:
    """Models of the bits of numbers; signals of several graphs can share them."""

    def __init__(self) -> None:
        self.bits: BitModels = bit_models(INPUTS, CONTEXTS, POSITIONS)


class Writer:
    """Collect bits; `finish` returns their bytes."""

    def __init__(self) -> None:
        self._coded = arithmetic.to_write(1 << 12)
        self._check = 0

    def room(self, numbers: int) -> arithmetic.Coded:
        """Return a buffer with room for `numbers` numbers."""
        self._coded = arithmetic.with_room(self._coded, _ROOM * (numbers + 1))
        return self._coded

    def write(self, signal: Signal, models: NumberModels) -> None:
        """Write a signal, and update the models."""
        activity, around, before, numbers = (
            each.astype(np.int64) for each in (*signal.sizes, signal.numbers)
        )
        contexts = signal.known, signal.neighbours, signal.counts, activity, around, before
        code_numbers(self.room(len(numbers)), models.bits, *contexts, numbers)
        self._check = check_of(signal.values, self._check)

    def checked(self, values: Index) -> None:
        """Add values to the check of the stream."""
        self._check = check_of(values, self._check)

    def finish(self) -> bytes:
        """Return the bytes of everything written."""
        return with_check(arithmetic.written(self._coded), self._check)


class Reader:
    """Read the output of a `Writer` in order; a second thread computes values while the next numbers are read."""

    def __init__(self, data: bytes) -> None:
        data, self._expected = without_check(data)
        self._coded = arithmetic.to_read(data)
        self._check = 0
        self._turns = WorkQueue()

    def bits(self) -> arithmetic.Coded:
        """Return the buffer to read from."""
        if arithmetic.is_beyond(self._coded):
            raise FormatError("coded numbers end early; the file is damaged")
        return self._coded

    def checked(self, values: Index) -> None:
        """Add decoded values to the check."""
        self._check = check_of(values, self._check)

    def take(self, work: Callable[[], None], numbers: int) -> None:
        """Queue work on numbers that were read, after earlier work."""
        self._turns.submit(work, numbers >= _MANY)

    def wait(self) -> None:
        """Wait until all queued work is done."""
        self._turns.wait()

    def finish(self) -> None:
        """Verify that the values read are those written."""
        self.wait()
        if self._check != self._expected:
            raise FormatError(
                "coded numbers come out otherwise than they went in: the file is damaged, or this machine, or a "
                "library on it, does not calculate as IEEE 754 says"
            )


class SignalCoder:
    """Round signals over one graph for coding, one after another; or read them."""

    def __init__(self, graph: SignalGraph, coordinates: int = 1, models: NumberModels | None = None) -> None:
        self._graph = graph
        self._predictor = Predictor(graph, coordinates)
        self._models = models or NumberModels()
        self._numbers = np.zeros(graph.size, dtype=np.int64)
        self._activity, self._around = np.zeros_like(self._numbers), np.zeros_like(self._numbers)
        self._known = 0

    def round(self, targets: Float) -> tuple[Float, Signal]:
        """Round a signal ``(N,)`` in steps."""
        predictor, numbers = self._predictor, np.empty_like(self._numbers)
        round_off(
            UNIT * np.asarray(targets, dtype=np.float64)[self._graph.order],
            MARGINS,
            predictor.neighbours,
            predictor.counts,
            predictor.weights,
            predictor.steps,
            self._activity,
            self._around,
            numbers,
            predictor.values,
        )
        signal = Signal.of(self._contexts(), numbers, predictor.values)
        self._count(numbers)
        values = np.empty(self._graph.size)
        self._learn(values)
        return values, signal

    def read(self, reader: Reader) -> Float:
        """Return the values ``(N,)`` in steps of the next signal; raises `FormatError` if the stream ends early."""
        values = self.read_ahead(reader)
        reader.wait()
        return values

    def read_ahead(self, reader: Reader) -> Float:
        """Return an array ``(N,)`` for the values in steps of the next signal, filled when the reader is finished."""
        predictor, numbers, values = self._predictor, np.zeros_like(self._numbers), np.empty(self._graph.size)
        code_numbers(reader.bits(), self._models.bits, *self._contexts(), numbers)
        self._count(numbers)

        def learn() -> None:
            add_predictions(
                numbers,
                predictor.neighbours,
                predictor.counts,
                predictor.weights,
                predictor.steps,
                predictor.values,
            )
            reader.checked(predictor.values)
            self._learn(values)

        reader.take(learn, len(numbers))
        if self._known == predictor.searched:  # later numbers have other neighbours
            reader.wait()
        return values

    def _contexts(self) -> Contexts:
        """Return the contexts of the next signal. Later signals replace these arrays, and never change them."""
        predictor = self._predictor
        sizes = self._activity, self._around, self._numbers
        return self._known, predictor.neighbours, predictor.counts, *sizes

    def _count(self, numbers: Index) -> None:
        """Record the numbers of the newest signal."""
        graph = self._graph
        self._numbers = numbers
        self._activity, self._around = sizes_after(numbers, graph.ring, graph.ring_starts, self._activity)
        self._known += 1

    def _learn(self, values: Float) -> None:
        """Record the values ``(N,)`` of the newest signal in steps, and learn from them."""
        values[self._graph.order] = self._predictor.values / UNIT
        self._predictor.finish()
