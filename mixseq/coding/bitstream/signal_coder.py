r"""Code signals over a graph: basis vectors over a mesh, and their coefficients over time.

Node by node, coarse to fine, a value is predicted from known values (`predictor`), the difference is rounded to a whole
number of steps, and the number is written bit by bit: its length, its bits, its sign. The probability of a bit is mixed
(`bit_models`) from five contexts: the mean size of this signal's numbers at neighbours, with the *activity* of the
node, the size of its numbers in earlier signals, weighted towards newer ones; the activity with its mean around the
node; a sum of all three,

.. math:: 0.80\, s + 0.40\, a + 0.15\, \bar a,

with the level of the node in the graph, and with the number of signals before; and the size at neighbours with the
number that the node had in the signal before.

A stream ends with the CRC-32 of all its values: different rounding, an error in a port and a damaged file raise one
error, and never decode to other points.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``); rounding in `write` is free.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index, IntArray
from mixseq.coding.bitstream import arithmetic
from mixseq.coding.bitstream import signal_kernels as kernels
from mixseq.coding.bitstream.bit_models import BitModels, bit_models
from mixseq.coding.bitstream.decoded_check import check_of, refuse_others, with_check, without_check
from mixseq.coding.bitstream.predictor import Predictor
from mixseq.coding.bitstream.predictor_kernels import UNIT, Small
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.errors import FormatError
from mixseq.mapping import InTurn

MARGINS: Float = np.interp(np.arange(kernels.LEVELS), [2, 6, 10, 14], [0.15, 0.25, 0.38, 0.45])
"""Numbers are rounded up from 1 - margin, by the level of their expected size: towards zero, most where zeros are
expected, as zeros save more bits than accuracy is worth. Chosen on seven sequences. Free: only encoders round.
"""

_ROOM = 16
"""Bytes of a number at most. Free: memory is allocated ahead."""


_MANY = 512
"""Count of numbers below which they are processed on the same thread: handing over takes as long. Free: time only."""

Contexts = tuple[int, Small, Small, Index, Index, Index]
"""Arguments of `signal_kernels.code_numbers` besides models and numbers: signals before, neighbours, counts, sizes."""


class Signal(NamedTuple):
    """A rounded signal that is not yet coded; immutable."""

    known: int  # number of signals before
    neighbours: Small  # (N, n) nodes before, from which every node is predicted
    counts: Small  # (N,) number of neighbours of every node
    # Activity, its mean around, and numbers of the signal before, for signal_kernels.code_numbers.
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
        self.bits: BitModels = bit_models(kernels.INPUTS, kernels.CONTEXTS, kernels.POSITIONS)


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
        kernels.code_numbers(self.room(len(numbers)), models.bits, *contexts, numbers)
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
        self._turns = InTurn()

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
        self._turns.take(work, numbers >= _MANY)

    def wait(self) -> None:
        """Wait until all queued work is done."""
        self._turns.wait()

    def finish(self) -> None:
        """Verify that the values read are those written."""
        self.wait()
        refuse_others(self._check, self._expected)


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
        kernels.round_off(
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
        kernels.code_numbers(reader.bits(), self._models.bits, *self._contexts(), numbers)
        self._count(numbers)

        def learn() -> None:
            kernels.add_predictions(
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
        self._activity, self._around = kernels.sizes_after(
            numbers, graph.ring, graph.ring_starts, self._activity
        )
        self._known += 1

    def _learn(self, values: Float) -> None:
        """Record the values ``(N,)`` of the newest signal in steps, and learn from them."""
        values[self._graph.order] = self._predictor.values / UNIT
        self._predictor.finish()
