r"""Code signals over a graph: basis vectors over a mesh, and their coefficients over time.

A signal is coded batch by batch from coarse to fine: every value is predicted, what is left is rounded to a whole
number of steps, and the number is coded in the context of its expected size, which follows from what is known around it
(numbers of the same signal at neighbours, and of earlier signals here and there).

**Prediction.** Signals over one graph resemble each other: in a rigid part, every vector of a basis of trajectories is
an affine function of the vertex's place, in a joint a smooth one. So weights that would have predicted earlier signals
well predict the next one. Node v has the weights of its neighbours that minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the signals j that are known. :math:`\tau_j = 1 / (1 + m_j / 10)`, where m_j is how rough the signal is (mean
square difference of neighbours), lets large signals teach as much as small ones; the second term stands for rounding
errors of the signals, in units of the quantisation step, and :math:`w^0` are weights from the graph alone. Where
the signals that are known are affine functions, so is the prediction: the parallelogram rule is a case of it.

Nodes resemble each other, too: after the first signals every node is joined to the nodes before it that have been most
like it, wherever they are. So vertices of one rigid part that are far apart, or of several components, predict each
other, and so do frames of one pose in a motion that comes back to it.

The constants are ours, chosen on seven sequences of the test data. Frozen: all but `MARGIN` break old files when they
change (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream import signal_kernels as kernels
from mixseq.coding.bitstream.entropy import Reader, Tables, Writer
from mixseq.coding.bitstream.signal_graph import SignalGraph

MARGIN = 0.45
"""Numbers are rounded up from 1 - margin, towards zero, which costs fewer bits than accuracy. Free: only encoders
round."""

RIDGE = 0.5
"""Squared rounding error of a known signal, in steps, that weights have to live with (rho). Frozen: breaks old
files."""

ROUGH = 10.0
"""Signals whose squared differences are above this teach less, in proportion. Frozen: breaks old files."""

MEMORY = 0.4
"""Share of the past in the activity of a node. Frozen: breaks old files."""

SIMILAR = 4
"""So many nodes that are most like a node are joined to it. Frozen: breaks old files."""

SEARCHES = (4, 8, 16)
"""When so many signals are known, times their coordinates, these nodes are looked for. Frozen: breaks old files."""

EXHAUSTIVE = 1024
"""The first nodes look at all nodes before them, later ones only near those of their neighbours. Frozen: breaks old
files."""

SELDOM = 3
"""Weights are new after every signal, after 16 signals after every other, after 24 after every third, and so on.
Frozen: breaks old files."""

SHARES = np.array([0.8, 0.4, 0.15])
"""Shares of the sizes at neighbours, of a node's activity, and of that of its ring in the expected size. Frozen: breaks
old files."""

FIRST, GROWTH, CONTEXTS = 0.01, 1.7, 28
"""Contexts are intervals of the expected size: from the first bound on, each 1.7 times the one before. Frozen: breaks
old files."""

_SMALL = 0.6
"""In contexts of expected sizes up to this, few numbers have symbols of their own, which is quicker. Frozen: breaks old
files."""

_FINEST = 8.0
"""Expected sizes up to this have numbers of their own; above, numbers are halved until they are below. Frozen: breaks
old files."""

_LEAST = 0.15
"""Expected size in the first context, to begin with. Frozen: breaks old files."""


def bounds() -> Float:
    """Return the bounds ``(CONTEXTS - 1,)`` between contexts, by multiplication: the same on all machines."""
    values = [FIRST]
    while len(values) < CONTEXTS - 1:
        values.append(values[-1] * GROWTH)
    return np.array(values)


class PredictedSignal(NamedTuple):
    """What is coded of a signal, in the order of its graph: numbers ``(N,)``, and the context ``(N,)`` of each.

    Both in the fewest bytes that hold them: all signals of a basis wait together for what is coded before them.
    """

    numbers: NDArray[np.signedinteger]
    contexts: NDArray[np.uint8]


class NumberModels:
    """Adaptive models of numbers in all contexts; coders of several graphs can share them."""

    def __init__(self) -> None:
        sizes = np.append(bounds(), bounds()[-1] * GROWTH)
        self.small = int(np.count_nonzero(sizes <= _SMALL))
        self.small_tables = Tables(np.maximum(sizes[: self.small], _LEAST), 3)
        self.shifts = np.zeros(CONTEXTS, dtype=np.int64)
        while (sizes > _FINEST).any():
            self.shifts += sizes > _FINEST
            sizes = np.where(sizes > _FINEST, sizes / 2, sizes)
        self.tables = Tables(sizes, 15)

    def write(self, writer: Writer, signal: PredictedSignal, batches: Sequence[slice]) -> None:
        """Code a signal batch by batch; the models learn it."""
        for batch in batches:
            numbers, contexts = (
                signal.numbers[batch].astype(np.int64),
                signal.contexts[batch].astype(np.int64),
            )
            small = contexts < self.small
            writer.put(numbers[small], contexts[small], self.small_tables)
            self._write_large(writer, numbers[~small], contexts[~small])

    def _write_large(self, writer: Writer, numbers: Index, contexts: Index) -> None:
        shifts = self.shifts[contexts]
        writer.put(numbers >> shifts, contexts, self.tables)
        for shift, some in _shifted(shifts):
            writer.put_flat(numbers[some] & ((1 << shift) - 1), 1 << shift)


class SignalCoder:
    """Code signals over one graph, one after another, to one or more streams.

    Large numbers are cut in two: few bits at their end, which are as good as random, and what is left, which the models
    of the contexts know.

    Parameters
    ----------
    graph : SignalGraph
        The graph.
    coordinates : int
        Number of signals that belong together: coordinates of a basis vector, or of a coefficient.
    models : NumberModels, optional
        Models that are shared with other coders, which write to the same streams.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1, models: NumberModels | None = None) -> None:
        self._predictor = Predictor(graph, coordinates)
        self._models = models or NumberModels()

    def write(self, writer: Writer, targets: Float) -> Float:
        """Code a signal ``(N,)`` in steps; return the values ``(N,)`` in steps that a decoder will have."""
        values, signal = self.predict(targets)
        self._models.write(writer, signal, self._predictor.graph.batches)
        return values

    def predict(self, targets: Float) -> tuple[Float, PredictedSignal]:
        """Return what `write` returns, and what it codes, which may be coded later: `NumberModels.write`."""
        self._predictor.begin()
        graph = self._predictor.graph
        nodes, contexts = targets[graph.order], np.empty(graph.size, dtype=np.uint8)
        numbers = np.empty(graph.size, dtype=np.int64)
        for batch in graph.batches:
            contexts[batch] = self._predictor.contexts(batch)
            numbers[batch] = self._predictor.quantise(batch, nodes)
        largest = int(np.abs(numbers).max(initial=0))
        return self._finished(), PredictedSignal(numbers.astype(np.min_scalar_type(-largest - 1)), contexts)

    def quantise(self, targets: Float) -> Float:
        """Return what `write` returns, without coding anything."""
        self._predictor.begin()
        graph = self._predictor.graph
        self._predictor.quantise(slice(0, graph.size), targets[graph.order])
        return self._finished()

    def read(self, reader: Reader) -> Float:
        """Return the values ``(N,)`` in steps of the next signal."""
        self._predictor.begin()
        for batch in self._predictor.graph.batches:
            contexts = self._predictor.contexts(batch)
            small = contexts < self._models.small
            numbers = np.empty(len(contexts), dtype=np.int64)
            numbers[small] = reader.get(contexts[small], self._models.small_tables)
            numbers[~small] = self._read_large(reader, contexts[~small])
            self._predictor.restore(batch, numbers)
        return self._finished()

    def _read_large(self, reader: Reader, contexts: Index) -> Index:
        shifts = self._models.shifts[contexts]
        numbers = reader.get(contexts, self._models.tables) << shifts
        for shift, some in _shifted(shifts):
            numbers[some] |= reader.get_flat(int(some.sum()), 1 << shift)
        return numbers

    def _finished(self) -> Float:
        values = np.empty(self._predictor.graph.size)
        values[self._predictor.graph.order] = self._predictor.finish()
        return values


def _shifted(shifts: Index) -> list[tuple[int, NDArray[np.bool_]]]:
    """Return which shifts ``(n,)`` there are, but zero, and where."""
    if not shifts.any():
        return []
    return [(int(shift), shifts == shift) for shift in np.flatnonzero(np.bincount(shifts)[1:]) + 1]


class Predictor:
    """What is known about signals over a graph, while they are coded or decoded one after another.

    Parameters
    ----------
    graph : SignalGraph
        The graph.
    coordinates : int
        Number of signals that belong together.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1) -> None:
        self._searches = tuple(coordinates * known for known in SEARCHES)
        self.graph = graph
        self._plain = graph
        self._weights = graph.weights.copy()
        self._gram = _empty_gram(graph)
        self._ridge = 0.0
        self._signals: list[Float] = []  # as long as nodes that are like each other are looked for
        self._known = 0
        self._activity = np.zeros(graph.size)
        self._around = np.zeros(graph.size)
        self._bounds = bounds()
        self.values = np.zeros(graph.size)
        self._sizes = np.zeros(graph.size)

    def begin(self) -> None:
        """Start a signal."""
        self.values = np.zeros(self.graph.size)

    def contexts(self, batch: slice) -> Index:
        """Return the contexts ``(n,)`` of the nodes of a batch, when all batches before are known."""
        first, last, neighbours, counts = batch.start, batch.stop, self.graph.neighbours, self.graph.counts
        around = self._activity, self._around
        return kernels.contexts(first, last, self._sizes, *around, SHARES, self._bounds, neighbours, counts)

    def quantise(self, batch: slice, targets: Float) -> Index:
        """Return the numbers ``(n,)`` of a batch of a signal ``(N,)`` in steps, and note the values they stand for."""
        first, last, neighbours, counts = batch.start, batch.stop, self.graph.neighbours, self.graph.counts
        known = self._weights, self.values
        numbers = kernels.quantise(first, last, targets, MARGIN, neighbours, counts, *known)
        self._sizes[batch] = np.abs(numbers)
        return numbers

    def restore(self, batch: slice, numbers: Index) -> None:
        """Note the values that numbers ``(n,)`` of a batch stand for."""
        first, last, neighbours, counts = batch.start, batch.stop, self.graph.neighbours, self.graph.counts
        kernels.restore(first, last, numbers, neighbours, counts, self._weights, self.values)
        self._sizes[batch] = np.abs(numbers)

    def finish(self) -> Float:
        """Learn from the signal whose last batch is done, and return its values ``(N,)`` in steps."""
        graph = self.graph
        self._activity = MEMORY * self._activity + (1 - MEMORY) * self._sizes
        self._around = kernels.smooth(self._activity, graph.ring, graph.ring_starts)
        self._known += 1
        known = self._known
        if known <= self._searches[-1]:
            self._signals.append(self.values)
        self._learn(self.values)
        if known in self._searches:
            self._join_similar()
        if known == self._searches[-1]:
            self._signals.clear()
        # Weights are renewed ever more rarely, as they change less.
        if known in self._searches or known % max(1, known >> SELDOM) == 0:
            kernels.solve(self._gram, self._ridge, self.graph.weights, self.graph.counts, self._weights)
        return self.values

    def _learn(self, signal: Float) -> None:
        neighbours, counts = self.graph.neighbours, self.graph.counts
        weight = 1.0 / (1.0 + kernels.roughness(signal, neighbours, counts) / ROUGH)
        kernels.learn(signal, weight, neighbours, counts, self._gram)
        self._ridge += RIDGE * weight

    def _join_similar(self) -> None:
        """Join every node to those before it that are most like it in all signals that are known."""
        plain = self._plain
        found = np.zeros((plain.size, SIMILAR), dtype=np.int64)
        sizes = np.zeros(plain.size, dtype=np.int64)
        values = np.ascontiguousarray(np.array(self._signals).T)
        kernels.nearest(values, plain.neighbours, plain.counts, EXHAUSTIVE, SIMILAR, found, sizes)
        self.graph = plain.with_more(found, sizes)
        self._weights = self.graph.weights.copy()
        self._gram = _empty_gram(self.graph)
        self._ridge = 0.0
        for signal in self._signals:
            self._learn(signal)


def _empty_gram(graph: SignalGraph) -> Float:
    """Room for the lower triangles of all nodes' Gram matrices."""
    return np.zeros(int((graph.counts * (graph.counts + 1) // 2).sum()))
