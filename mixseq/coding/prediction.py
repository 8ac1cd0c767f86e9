r"""Predicting a signal from its neighbours, with weights that signals before it have taught.

Signals over one graph resemble each other: in a rigid part, every field of a trajectory basis is an affine function of
the vertex's place, in a joint a smooth one. So weights that would have predicted earlier signals well predict the next
one. Node v has the weights of its neighbours that minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the signals j that are known. :math:`\tau_j = 1 / (1 + m_j / 10)`, where m_j is how rough the signal is (mean
square difference of neighbours), lets large signals teach as much as small ones; the second term stands for rounding
errors of the signals, in units of the quantisation step, and :math:`w^0` are weights from the graph alone. Where
the signals that are known are affine functions, so is the prediction: the parallelogram rule is a case of it.

Nodes resemble each other, too: after the first signals every node is joined to the nodes before it that have been most
like it, wherever they are. So vertices of one rigid part that are far apart, or of several components, predict each
other, and so do frames of one pose in a motion that comes back to it.

Numbers that are coded are what prediction leaves, in steps, rounded: the mean of the context they are coded in is told
by what is known around them (sizes of numbers of the same signal at neighbours, and of earlier signals here and there).
The constants are ours, chosen on seven sequences of the test data.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.coding.graph import SignalGraph

RIDGE = 0.5
"""Squared rounding error of a known signal, in steps, that weights have to live with (rho)."""

ROUGH = 10.0
"""Signals teach less in proportion if the squares of their differences are above this."""

MARGIN = 0.45
"""Numbers are rounded up from 1 - margin: a little towards zero, which costs fewer bits than accuracy."""

MEMORY = 0.4
"""Share of the past in the activity of a node."""

SIMILAR = 4
"""So many nodes that are most like a node are joined to it."""

LOOKS = (4, 8, 16)
"""When so many signals are known, times their coordinates, these nodes are looked for."""

THOROUGH = 1024
"""So many nodes, the first, look at all nodes before them, later ones only near those of their neighbours."""

SELDOM = 3
"""Weights are new after every signal, after 16 signals after every other, after 24 after every third, and so on."""

SHARES = np.array([0.8, 0.4, 0.15])
"""Shares of the sizes at neighbours, of a node's activity, and of that of its ring in a context."""

FIRST, GROWTH, CONTEXTS = 0.01, 1.7, 28
"""Contexts are intervals of the expected size: from the first bound on, each 1.7 times the one before."""


def bounds() -> Float:
    """Return the bounds ``(CONTEXTS - 1,)`` between contexts, by multiplication: the same on all machines."""
    values = [FIRST]
    while len(values) < CONTEXTS - 1:
        values.append(values[-1] * GROWTH)
    return np.array(values)


def _renews(known: int) -> bool:
    """Whether weights are computed anew when so many signals are known: ever more rarely, as they change less."""
    return known % max(1, known >> SELDOM) == 0


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
        self._looks = tuple(coordinates * known for known in LOOKS)
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
        from mixseq.coding.prediction_kernels import contexts

        graph = self.graph
        found: Index = contexts(
            batch.start,
            batch.stop,
            self._sizes,
            self._activity,
            self._around,
            SHARES,
            self._bounds,
            graph.neighbours,
            graph.counts,
        )
        return found

    def quantise(self, batch: slice, targets: Float) -> Index:
        """Return the numbers ``(n,)`` of a batch of a signal ``(N,)`` in steps, and note the values they stand for."""
        from mixseq.coding.prediction_kernels import quantise

        graph = self.graph
        numbers: Index = quantise(
            batch.start,
            batch.stop,
            targets,
            MARGIN,
            graph.neighbours,
            graph.counts,
            self._weights,
            self.values,
        )
        self._sizes[batch] = np.abs(numbers)
        return numbers

    def restore(self, batch: slice, numbers: Index) -> None:
        """Note the values that numbers ``(n,)`` of a batch stand for."""
        from mixseq.coding.prediction_kernels import restore

        graph = self.graph
        restore(batch.start, batch.stop, numbers, graph.neighbours, graph.counts, self._weights, self.values)
        self._sizes[batch] = np.abs(numbers)

    def _look(self) -> None:
        """Join every node to those before it that are most like it in all signals that are known."""
        from mixseq.coding.similar_kernels import nearest

        plain = self._plain
        found = np.zeros((plain.size, SIMILAR), dtype=np.int64)
        sizes = np.zeros(plain.size, dtype=np.int64)
        values = np.ascontiguousarray(np.array(self._signals).T)
        nearest(values, plain.neighbours, plain.counts, THOROUGH, SIMILAR, found, sizes)
        self.graph = plain.with_more(found, sizes)
        self._weights = self.graph.weights.copy()
        self._gram = _empty_gram(self.graph)
        self._ridge = 0.0
        for signal in self._signals:
            self._learn(signal)

    def _learn(self, signal: Float) -> None:
        from mixseq.coding.prediction_kernels import learn, roughness

        graph = self.graph
        trust = 1.0 / (1.0 + roughness(signal, graph.neighbours, graph.counts) / ROUGH)
        learn(signal, trust, graph.neighbours, graph.counts, self._gram)
        self._ridge += RIDGE * trust

    def finish(self) -> Float:
        """Learn from the signal whose last batch is done, and return its values ``(N,)`` in steps."""
        from mixseq.coding.prediction_kernels import smooth, solve

        graph = self.graph
        self._activity = MEMORY * self._activity + (1 - MEMORY) * self._sizes
        self._around = smooth(self._activity, graph.ring, graph.ring_starts)
        self._known += 1
        known = self._known
        if known <= self._looks[-1]:
            self._signals.append(self.values)
        self._learn(self.values)
        if known in self._looks:
            self._look()
        if known == self._looks[-1]:
            self._signals.clear()
        if known in self._looks or _renews(known):
            solve(self._gram, self._ridge, self.graph.weights, self.graph.counts, self._weights)
        return self.values


def _empty_gram(graph: SignalGraph) -> Float:
    """Room for the lower triangles of all nodes' Gram matrices."""
    return np.zeros(int((graph.counts * (graph.counts + 1) // 2).sum()))
