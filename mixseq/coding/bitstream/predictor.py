r"""Predict the values of signals over a graph, from those before it: basis vectors over a mesh, coefficients over time.

Signals over one graph resemble each other: in a rigid part, every vector of a basis of trajectories is an affine
function of the vertex's place, in a joint a smooth one. So weights that would have predicted earlier signals well
predict the next one. Node v has the weights of its neighbours that minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the signals j that are known. The trust :math:`\tau_j`, about :math:`1 / (1 + m_j / 10)`, where m_j is how rough
the signal is (mean square difference of neighbours, in squared steps), lets large signals teach as much as small ones;
the second term stands for rounding errors of the signals, and :math:`w^0` are weights from the graph alone. Where the
signals that are known are affine functions, so is the prediction: the parallelogram rule is a case of it.

The first signals over a mesh are most of its bytes: these are predicted from many nodes around a vertex, and
:math:`w^0` bends the mesh least (`mixseq.coding.bitstream.stencils`). Then there is something better to go by, as nodes
resemble each other, too: besides its neighbours every node is joined to the nodes before it that have been most like
it, wherever they are. So vertices of one rigid part that are far apart, or of several components, predict each
other, and so do frames of one pose in a motion that comes back to it.

Later signals are small, and most of their numbers zero, so that errors of nodes on coarse levels are those of all that
lie between them: their steps are smaller.

**The same everywhere.** Values are whole 64ths of a step, trust is a power of two, and weights are whole multiples of
2^-24, so that predictions are exact in float64, in whatever order they are added, as long as values are below 2^29 (8
million steps); so are roughness, distances and sums of products in nearly all files, and where these are rounded, it is
in a fixed order. Weights are solved for with rounded operations, + - * / and roots, in a fixed order:
`mixseq.coding.bitstream.predictor_kernels`.

The constants are ours. Frozen: they break files when they change.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream import predictor_kernels as kernels
from mixseq.coding.bitstream.predictor_kernels import UNIT
from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.bitstream.stencils import stencils
from mixseq.polygons import frozen

SIMILAR, SIMILAR_FRAMES = 8, 16
"""So many nodes that are most like a node are joined to it: vertices, or frames. Frozen: breaks files."""

SEARCHED = 5
"""When so many signals are known, times their coordinates, these nodes are looked for. Frozen: breaks files."""

EXHAUSTIVE = 2048
"""The first nodes look at all nodes before them, later ones only near those of their neighbours. Frozen: breaks
files."""

RIDGE = 0.5
"""Squared rounding error of a known signal, in steps, that weights have to live with (rho). Frozen: breaks files."""

ROUGH = 10.0
"""Signals whose squared differences are above this teach less, in proportion. Frozen: breaks files."""

DOUBLED = 16
"""Every so many signals trust is doubled, as newer signals resemble the next one most. Frozen: breaks files."""

_AGES = 512
"""Trust is doubled so many times at most: no file has more signals, but damaged ones might. Frozen: breaks files."""

SELDOM = 2
"""Weights are new after every signal, after 8 signals after every other, after 12 after every third, and so on.
Frozen: breaks files."""

FINER, FINEST = 9, 38
"""From level to coarser level steps are smaller, by so many tenths, but not below so many units. Frozen: breaks
files."""

EQUAL = 3
"""Of so many signals, times their coordinates, all nodes have the same step. Frozen: breaks files."""

_MANY = 1024
"""Graphs with more nodes are worked at in larger blocks. Free: a matter of time."""


class Predictor:
    """What is known about signals over a graph, while they are coded or decoded one after another.

    Whoever codes fills `values` node by node, each after `predictor_kernels.predict` has told what it may be, and calls
    `finish` after the last one.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1) -> None:
        self._plain = graph
        self._coordinates, self.searched = coordinates, SEARCHED * coordinates
        self._known, self._due = 0, 1
        self._signals: list[Float] = []  # all, until similar nodes are looked for
        self._pending: list[Float] = []  # those that the weights do not know yet
        self.values = np.zeros(graph.size, dtype=np.int64)
        self.steps = np.full(graph.size, UNIT)
        self._join(*stencils(graph))

    def _join(self, neighbours: Index, counts: Index, weights: Float) -> None:
        """Predict nodes from these, with these weights as long as nothing is known about them."""
        self.neighbours = neighbours.astype(np.int32)
        self.counts = counts.astype(np.int32)
        self._start = kernels.rounded(frozen(weights))  # as those of stencils are: one type to numba
        self.weights = self._start.copy()
        self._blocks, self._sizes = blocks(self.counts)
        entries = self._sizes.astype(np.int64) * (self._sizes + 1) // 2 - 1
        self._places = np.cumsum(entries) - entries
        self._gram = np.zeros((int(entries.sum()), self._blocks.shape[1]))
        self._ridge = 0.0

    def finish(self) -> None:
        """Learn from the signal whose values are all known, and be ready for the next one."""
        signal = self.values.astype(np.float64)
        self._known += 1
        known = self._known
        self._pending.append(signal)
        if known == EQUAL * self._coordinates and not self._plain.over_time:
            self.steps = finer_steps(len(self.steps))
        if known <= self.searched:
            self._signals.append(signal)
        if known == self.searched:
            self._join_similar()
        # Weights are renewed ever more rarely, as they change less.
        if known == self.searched or known >= self._due:
            self._renew()
            self._due = known + max(1, known >> SELDOM)

    def _renew(self) -> None:
        """Learn from the signals that are waiting, and find weights."""
        signals = np.array(self._pending)
        ages = np.arange(self._known - len(signals), self._known) // DOUBLED
        trusts = np.ldexp(1.0, np.minimum(ages, _AGES))
        trusts *= [kernels.trust(one, ROUGH * UNIT**2, self.neighbours, self.counts) for one in signals]
        self._ridge += RIDGE * UNIT**2 * float(trusts.sum())
        of_blocks = self._blocks, self._sizes, self._places
        kernels.learn(signals, trusts, *of_blocks, self.neighbours, self._gram)
        kernels.solve(self._ridge, *of_blocks, self._gram, self._start, self.weights)
        self._pending = []

    def _join_similar(self) -> None:
        """Join every node to those before it that are most like it in all signals that are known."""
        plain = self._plain
        similar = np.zeros((plain.size, SIMILAR_FRAMES if plain.over_time else SIMILAR), dtype=np.int32)
        found = np.zeros(plain.size, dtype=np.int32)
        beside = plain.neighbours.astype(np.int32), plain.counts.astype(np.int32)
        kernels.nearest(np.array(self._signals), *beside, EXHAUSTIVE, similar, found)
        joined = plain.with_more(similar, found)
        self._join(joined.neighbours, joined.counts, joined.weights)
        self._pending, self._signals = self._signals, []


def finer_steps(size: int) -> Index:
    """Return the steps ``(N,)`` of so many nodes, in units: smaller on coarse levels, whose errors finer ones inherit.

    A level has as many nodes as there are before it.
    """
    steps = np.full(size, UNIT)
    first, step = size // 2, UNIT
    while first:
        step = max(step * FINER // 10, FINEST)
        steps[:first] = step
        first //= 2
    return steps


def blocks(counts: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return blocks ``(B, lanes)`` of nodes with equally many neighbours, and how many ``(B,)`` these are.

    Nodes with one neighbour or none are left out: there is nothing to learn of them. Blocks that are not full repeat
    their last node.
    """
    lanes = kernels.LANES if len(counts) > _MANY else kernels.FEW_LANES
    found, sizes = [np.zeros((0, lanes), dtype=np.int32)], []
    for count in np.unique(counts[counts > 1]):
        nodes: Index = np.flatnonzero(counts == count)
        rows = -(-len(nodes) // lanes)
        filled = np.minimum(np.arange(rows * lanes), len(nodes) - 1)
        found.append(nodes[filled].reshape(rows, lanes).astype(np.int32))
        sizes += rows * [count]
    return np.concatenate(found), np.array(sizes, dtype=np.int32)
