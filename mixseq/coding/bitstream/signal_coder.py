r"""Code signals over a graph: basis vectors over a mesh, and their coefficients over time.

Node by node, coarse to fine, a value is predicted from values that are known (`predictor`), what is left is rounded to
a whole number of steps, and the number is written bit by bit: how long it is, the bits of it, its sign. How likely a
bit is follows from what is known around the node (`bit_models`), five views of it: the mean size of this signal's
numbers at neighbours, with the *activity* of the node, the size of its numbers in earlier signals, newer ones counting
more; the activity with its mean around the node; a sum of all three,

.. math:: 0.80\, s + 0.40\, a + 0.15\, \bar a,

with the level of the node in the graph, and with the number of signals before; and the size at neighbours with the
number that the node had in the signal before.

A stream ends with the CRC-32 of all values that were written to it, so that a decoder knows that it has the same: a
machine that adds otherwise, a port with an error and a damaged file all end in one error, and never in other points.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``); what `write` rounds is free.
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
"""Numbers are rounded up from 1 - margin, by the level of their expected size: towards zero, which costs fewer bits
than accuracy, most of all where zeros are expected. Chosen on seven sequences. Free: only encoders round."""

_ROOM = 16
"""Bytes that a number takes at most. Free: memory is taken ahead."""


_MANY = 512
"""Fewer numbers are coded at once: to hand them over takes as long. Free: a matter of time."""

Contexts = tuple[int, Small, Small, Index, Index, Index]
"""What `signal_kernels.code_numbers` needs besides models and numbers: signals before, neighbours, counts, sizes."""


class Signal(NamedTuple):
    """A signal that is rounded, and not yet coded. Nothing of it is changed later."""

    known: int  # number of signals before
    neighbours: Small  # (N, n) nodes before, from which every node is predicted
    counts: Small  # (N,) number of neighbours of every node
    # Activity, its mean around, and numbers of the signal before: what else signal_kernels.code_numbers needs.
    sizes: tuple[IntArray, IntArray, IntArray]
    numbers: IntArray  # (N,) its numbers in nodes' order
    values: IntArray  # (N,) the values that it has for a decoder, in steps / UNIT

    @classmethod
    def of(cls, contexts: Contexts, numbers: Index, values: Index) -> Signal:
        """Make one of 20 bytes a node, if its numbers are not too large for that."""
        known, neighbours, counts, activity, around, before = contexts
        sizes = _small(activity), _small(around), _small(before)
        return cls(known, neighbours, counts, sizes, _small(numbers), _small(values))


def _small(numbers: Index) -> IntArray:
    """Return a copy of whole numbers, in 4 bytes each if they are small enough."""
    return numbers.astype(np.int32 if np.abs(numbers).max(initial=0) < 2**31 else np.int64)


class NumberModels:
    """What is known of the bits of numbers; signals of several graphs can share it."""

    def __init__(self) -> None:
        self.bits: BitModels = bit_models(kernels.INPUTS, kernels.CONTEXTS, kernels.POSITIONS)


class Writer:
    """Collects bits; `finish` makes bytes of them."""

    def __init__(self) -> None:
        self._coded = arithmetic.to_write(1 << 12)
        self._check = 0

    def room(self, numbers: int) -> arithmetic.Coded:
        """Return where to write so many numbers."""
        self._coded = arithmetic.with_room(self._coded, _ROOM * (numbers + 1))
        return self._coded

    def write(self, signal: Signal, models: NumberModels) -> None:
        """Write a signal; models learn from it."""
        activity, around, before, numbers = (
            each.astype(np.int64) for each in (*signal.sizes, signal.numbers)
        )
        contexts = signal.known, signal.neighbours, signal.counts, activity, around, before
        kernels.code_numbers(self.room(len(numbers)), models.bits, *contexts, numbers)
        self._check = check_of(signal.values, self._check)

    def checked(self, values: Index) -> None:
        """Add values to what a decoder has to find."""
        self._check = check_of(values, self._check)

    def finish(self) -> bytes:
        """Return everything that was written."""
        return with_check(arithmetic.written(self._coded), self._check)


class Reader:
    """Reads what a `Writer` wrote, in the same order, with models that learned the same.

    What follows from numbers is worked out on a thread of its own, while the next ones are read.
    """

    def __init__(self, data: bytes) -> None:
        data, self._expected = without_check(data)
        self._coded = arithmetic.to_read(data)
        self._check = 0
        self._turns = InTurn()

    def bits(self) -> arithmetic.Coded:
        """Return where to read."""
        if arithmetic.is_beyond(self._coded):
            raise FormatError("coded numbers end early; the file is damaged")
        return self._coded

    def checked(self, values: Index) -> None:
        """Add values to what was found."""
        self._check = check_of(values, self._check)

    def take(self, work: Callable[[], None], numbers: int) -> None:
        """Work with so many numbers that were read, after what was given before."""
        self._turns.take(work, numbers >= _MANY)

    def wait(self) -> None:
        """Return when all of that is done."""
        self._turns.wait()

    def finish(self) -> None:
        """Make sure that what was read is what was written."""
        self.wait()
        refuse_others(self._check, self._expected)


class SignalCoder:
    """Round signals over one graph, one after another, to be coded; or read them."""

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
        """Return the values ``(N,)`` in steps of the next signal.

        Raises
        ------
        FormatError
            If the stream ends early.
        """
        values = self.read_ahead(reader)
        reader.wait()
        return values

    def read_ahead(self, reader: Reader) -> Float:
        """Return an array ``(N,)`` in which the values in steps of the next signal are when the reader is finished."""
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
        if self._known == predictor.searched:  # numbers to come have other neighbours
            reader.wait()
        return values

    def _contexts(self) -> Contexts:
        """What is known before the next signal. Others take the place of these arrays later; none is changed."""
        predictor = self._predictor
        sizes = self._activity, self._around, self._numbers
        return self._known, predictor.neighbours, predictor.counts, *sizes

    def _count(self, numbers: Index) -> None:
        """Note which numbers the newest signal has."""
        graph = self._graph
        self._numbers = numbers
        self._activity, self._around = kernels.sizes_after(
            numbers, graph.ring, graph.ring_starts, self._activity
        )
        self._known += 1

    def _learn(self, values: Float) -> None:
        """Write the values ``(N,)`` of the newest signal in steps, and learn from them."""
        values[self._graph.order] = self._predictor.values / UNIT
        self._predictor.finish()
