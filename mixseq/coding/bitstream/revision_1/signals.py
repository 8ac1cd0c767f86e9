r"""Read signals over a graph as model versions 4 and 7 have them: basis vectors, and coefficients over time.

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

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.coding.bitstream import entropy
from mixseq.coding.bitstream.entropy import Tables
from mixseq.coding.bitstream.revision_1 import signal_kernels as kernels
from mixseq.coding.bitstream.signal_graph import SignalGraph

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


class Reader(entropy.Reader):
    """Reads numbers of a stream."""

    def finish(self) -> None:
        """Do nothing: these streams do not say what was written to them."""


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


class SignalCoder:
    """Read signals over one graph, one after another, from one or more streams.

    Large numbers are cut in two: few bits at their end, which are as good as random, and what is left, which the models
    of the contexts know.

    Parameters
    ----------
    graph : SignalGraph
        The graph.
    coordinates : int
        Number of signals that belong together: coordinates of a basis vector, or of a coefficient.
    models : NumberModels, optional
        Models that are shared with other coders, which read from the same streams.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1, models: NumberModels | None = None) -> None:
        self._predictor = Predictor(graph, coordinates)
        self._models = models or NumberModels()

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


def _shifted(shifts: Index) -> list[tuple[int, Mask]]:
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
