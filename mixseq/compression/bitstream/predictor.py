r"""Predict signals over a graph from earlier ones: basis vectors over a mesh, coefficients over time.

Signals over one graph are similar: in a rigid part, every basis vector of trajectories is an affine function of the
vertex's position, in a joint a smooth one. So weights fitted to earlier signals predict the next one. Node v has the
weights of its neighbours that minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the known signals j. The trust :math:`\tau_j`, about :math:`1 / (1 + m_j / 10)`, where m_j is the roughness of the
signal (mean square difference of neighbours, in squared steps), balances large and small signals; the second term
stands for rounding errors of the signals, and :math:`w^0` are weights from the graph alone. Where the known signals are
affine functions, so is the prediction: the parallelogram rule is a case of it.

*Initial weights.* The first signals over a mesh are most of its bytes: these are predicted from many nodes around a
vertex, with :math:`w^0` of least bending. A removed vertex :math:`v` (`mixseq.compression.bitstream.signal_graph`) lies
between its neighbours, but on a curved surface away from their mean. The predicted value minimises the squares of mean
slopes, at the vertex and at its neighbours,

.. math:: \sum_{i \in \{v\} \cup N(v)} \Bigl( \frac{1}{|N(i)|} \sum_{j \in N(i)} \frac{x_j - x_i}{l_{ij}} \Bigr)^2 ,

with v and the neighbours :math:`N(i)` that are left when v is gone, without those across v. Lengths :math:`l_{ij}` are
numbers of edges: one in the mesh, and the sum of both sides where an edge closes the hole of a removed vertex. So a
vertex is predicted from its neighbours, and from theirs; on a line of equal lengths with weights of -1/12, 7/12, 7/12,
-1/12.

*Similar nodes.* Later, every node is also joined to the most similar nodes before it, anywhere in the graph. So distant
vertices of one rigid part, or of several components, predict each other, and so do frames of one pose in a repeating
motion.

*Steps.* Later signals are small, and most of their numbers zero, so that errors of nodes on coarse levels are inherited
by all nodes between them: their steps are smaller.

*The same everywhere.* Values are whole 64ths of a step, trust is a power of two, and weights are whole multiples of
2^-24, so that predictions are exact in float64, in any order of summation, for values below 2^29 (8 million steps); so
are roughness, distances and sums of products in nearly all files, and where these are rounded, it is in a fixed order.
Weights are solved for with rounded operations, + - * / and roots, in a fixed order:
`mixseq.compression.bitstream.predictor_kernels`.

The constants were chosen empirically. Frozen: changing them breaks files.
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream import predictor_kernels as kernels
from mixseq.compression.bitstream.predictor_kernels import UNIT
from mixseq.compression.bitstream.signal_graph import MOST, SignalGraph, coarser_levels, renumbered
from mixseq.mesh.polygons import read_only
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index

WIDEST = 16
"""Largest number of nodes in a stencil: the neighbours, and those of largest weight. Frozen: breaks files."""

HUB = 32
"""Number of neighbours above which slopes at a node are ignored, to save time. Frozen: breaks files."""


class Stencils(NamedTuple):
    """Neighbours and weights of every node, before any signal is known."""

    neighbours: Index  # (N, WIDEST) nodes before every node; the first counts[node] of a row count
    counts: Index  # (N,) number of neighbours of every node
    weights: Float  # (N, WIDEST) rows add up to one


_known: WeakKeyDictionary[SignalGraph, Stencils] = WeakKeyDictionary()


def stencils(graph: SignalGraph) -> Stencils:
    """Return the stencils of a mesh's graph; for a graph over time, or nodes without edges, its own weights."""
    if graph not in _known:
        _known[graph] = _stencils(graph)
    return _known[graph]


def _stencils(graph: SignalGraph) -> Stencils:
    own = graph.neighbours.shape[1]
    found = Stencils(
        np.zeros((graph.size, WIDEST), dtype=np.int64), graph.counts.copy(), np.zeros((graph.size, WIDEST))
    )
    found.neighbours[:, :own] = graph.neighbours
    found.weights[:, :own] = graph.weights
    if graph.over_time:
        return found
    # Levels are those of vertices' numbers.
    place = np.empty(graph.size, dtype=np.int64)
    place[graph.order] = np.arange(graph.size)
    starts, beside = renumbered(graph.ring_starts, graph.ring, place, graph.order)
    lengths = np.ones(len(beside))
    nodes = np.zeros((graph.size, MOST), dtype=np.int64), np.zeros(graph.size, dtype=np.int64)
    for level in coarser_levels(starts, beside, *nodes):
        left = _lengths(*level, lengths)
        before = level.starts, level.beside, lengths
        _bend(level.gone, *before, level.new_starts, level.new_beside, left, place, *found)
        lengths = left
    return found


@compiled
def _bend(
    gone: Index,
    starts: Index,
    beside: Index,
    lengths: Float,
    new_starts: Index,
    new_beside: Index,
    new_lengths: Float,
    place: Index,
    neighbours: Index,
    counts: Index,
    weights: Float,
) -> None:
    """Write the stencils of removed vertices ``(n,)``, from edge lengths ``(2 E,)`` before and ``(2 E',)`` after.

    Stencils have nodes' numbers: ``place`` (N,) of vertices.
    """
    slot = np.full(len(place), -1, dtype=np.int64)  # where a vertex is in the two lists
    listed = np.empty(MOST * (HUB + 1), dtype=np.int64)
    shares = np.empty(MOST * (HUB + 1))
    for vertex in gone:
        first = starts[vertex]
        degree = min(starts[vertex + 1] - first, MOST)
        slope = 0.0  # of the vertex, by its own value
        for at in range(first, first + degree):
            slope += 1.0 / lengths[at]
        slope /= degree
        for i in range(degree):
            listed[i], shares[i] = beside[first + i], slope / (degree * lengths[first + i])
            slot[listed[i]] = i
        size, total = degree, slope * slope
        for i in range(degree):
            around, side = beside[first + i], lengths[first + i]
            if new_starts[around + 1] - new_starts[around] > HUB:
                continue
            number = 1
            # Number of remaining neighbours, without those across the vertex; then their shares.
            for turn in range(2):
                own = 1.0 / (number * side)
                for at in range(new_starts[around], new_starts[around + 1]):
                    other = new_beside[at]
                    if 0 <= slot[other] < degree and new_lengths[at] >= side + lengths[first + slot[other]]:
                        continue
                    if turn == 0:
                        number += 1
                        continue
                    if slot[other] < 0:
                        slot[other], listed[size], shares[size] = size, other, 0.0
                        size += 1
                    one = own / (number * new_lengths[at])
                    shares[i] += one
                    shares[slot[other]] -= one
            total += own * own
            shares[i] += own * own
        for i in range(size):
            slot[listed[i]] = -1
        # Neighbours first, then those with the largest shares.
        kept = min(size, weights.shape[1])
        left = 1.0
        for i in range(kept):
            best = i
            if i >= degree:
                for j in range(i + 1, size):
                    if abs(shares[j]) > abs(shares[best]):
                        best = j
            listed[i], listed[best] = listed[best], listed[i]
            shares[i], shares[best] = shares[best], shares[i]
            left -= shares[i] / total
        node = place[vertex]
        counts[node] = kept
        for i in range(kept):
            neighbours[node, i] = place[listed[i]]
            weights[node, i] = shares[i] / total + left / kept


@compiled
def _lengths(
    gone: Index,
    starts: Index,
    beside: Index,
    new: Index,
    new_starts: Index,
    new_beside: Index,
    lengths: Float,
) -> Float:
    """Return the lengths ``(2 E',)`` of edges after vertices were removed, always the shortest, from those before."""
    found = np.full(len(new_beside), np.inf)
    for vertex in range(len(starts) - 1):
        if new_starts[vertex] == new_starts[vertex + 1]:
            continue
        row = new_beside[new_starts[vertex] : new_starts[vertex + 1]]
        for at in range(starts[vertex], starts[vertex + 1]):
            where = np.searchsorted(row, beside[at])
            if where < len(row) and row[where] == beside[at]:
                found[new_starts[vertex] + where] = lengths[at]
    count = 0
    for vertex in gone:
        first, last = starts[vertex], starts[vertex + 1]
        if last - first < 2:
            continue
        best = new[count, 0]
        side = lengths[first + np.searchsorted(beside[first:last], best)]
        for at in range(first, last):
            if beside[at] != best:
                for one, other in ((best, beside[at]), (beside[at], best)):
                    row = new_beside[new_starts[one] : new_starts[one + 1]]
                    where = new_starts[one] + np.searchsorted(row, other)
                    found[where] = min(found[where], side + lengths[at])
                count += 1
    return found


SIMILAR, SIMILAR_FRAMES = 8, 16
"""Number of most similar nodes joined to a node: vertices, or frames. Frozen: breaks files."""

SEARCHED = 5
"""Number of known signals, times their coordinates, at which similar nodes are searched for. Frozen: breaks files."""

EXHAUSTIVE = 2048
"""Number of first nodes that search all nodes before them; later ones search near neighbours. Frozen: breaks files."""

RIDGE = 0.5
"""Squared rounding error of a known signal, in steps: rho, the ridge of the weights. Frozen: breaks files."""

ROUGH = 10.0
"""Mean squared difference of neighbours, in squared steps, above which trust falls. Frozen: breaks files."""

DOUBLED = 16
"""Signals after which trust is doubled, as newer signals resemble the next one most. Frozen: breaks files."""

_AGES = 512
"""Largest number of doublings of trust; reached by damaged files only. Frozen: breaks files."""

SELDOM = 2
"""Weights are renewed after every signal, after 8 signals after every other, after 12 after every third, and so on.
Frozen: breaks files.
"""

FINER, FINEST = 9, 38
"""Ratio of the steps of successive coarser levels, in tenths, and smallest step in units. Frozen: breaks files."""

EQUAL = 3
"""Number of signals, times their coordinates, with the same step at all nodes. Frozen: breaks files."""

_MANY = 1024
"""Number of nodes above which graphs are processed in larger blocks. Free: affects time only."""


class Predictor:
    """Weights learned from signals over a graph, coded or decoded one after another.

    Fill `values` node by node, each after `predictor_kernels.predict`; call `finish` after the last node.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1) -> None:
        self._plain = graph
        self._coordinates, self.searched = coordinates, SEARCHED * coordinates
        self._known, self._due = 0, 1
        self._signals: list[Float] = []  # all, until similar nodes are searched for
        self._pending: list[Float] = []  # those not learned yet
        self.values = np.zeros(graph.size, dtype=np.int64)
        self.steps = np.full(graph.size, UNIT)
        self._join(*stencils(graph))

    def _join(self, neighbours: Index, counts: Index, weights: Float) -> None:
        """Set the neighbours of nodes, and their initial weights."""
        self.neighbours = neighbours.astype(np.int32)
        self.counts = counts.astype(np.int32)
        self._start = kernels.rounded(read_only(weights))  # as those of stencils are: one type to numba
        self.weights = self._start.copy()
        self._blocks, self._sizes = blocks(self.counts)
        entries = self._sizes.astype(np.int64) * (self._sizes + 1) // 2 - 1
        self._places = np.cumsum(entries) - entries
        self._gram = np.zeros((int(entries.sum()), self._blocks.shape[1]))
        self._ridge = 0.0

    def finish(self) -> None:
        """Learn from the finished signal, and prepare for the next one."""
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
        """Learn from the pending signals, and solve for weights."""
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
        """Join every node to the most similar nodes before it in all known signals."""
        plain = self._plain
        similar = np.zeros((plain.size, SIMILAR_FRAMES if plain.over_time else SIMILAR), dtype=np.int32)
        found = np.zeros(plain.size, dtype=np.int32)
        beside = plain.neighbours.astype(np.int32), plain.counts.astype(np.int32)
        kernels.nearest(np.array(self._signals), *beside, EXHAUSTIVE, similar, found)
        joined = plain.with_more(similar, found)
        self._join(joined.neighbours, joined.counts, joined.weights)
        self._pending, self._signals = self._signals, []


def finer_steps(size: int) -> Index:
    """Return the steps ``(N,)`` of `size` nodes in units, smaller on coarse levels; each level doubles the nodes."""
    steps = np.full(size, UNIT)
    first, step = size // 2, UNIT
    while first:
        step = max(step * FINER // 10, FINEST)
        steps[:first] = step
        first //= 2
    return steps


def blocks(counts: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return blocks ``(B, lanes)`` of nodes with equal numbers of neighbours, and the number of nodes ``(B,)`` in each.

    Nodes with fewer than two neighbours are left out, having fixed weights. Partial blocks repeat their last node.
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
