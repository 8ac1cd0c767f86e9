r"""Predict signals over a graph from earlier ones: basis vectors over a mesh, coefficients over time.

Signals over one graph are similar: in a rigid part, every basis vector of trajectories is an affine function of the
vertex's position; near a joint, a smooth function. So weights fitted to earlier signals predict the next signal. At
node v, the weights :math:`w_n` of its neighbours n minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the known signals j. The trust :math:`\tau_j` balances large and small signals. It is about
:math:`1 / (1 + m_j / 10)`, where m_j is the roughness of the signal (mean square difference of neighbours, in squared
steps). The second term models rounding errors of the signals; :math:`w^0` are weights from the graph alone. Where known
signals are affine functions, so is the prediction, as by the parallelogram rule.

*Initial weights.* The first signals over a mesh take most of the bytes. They are predicted from many nodes around a
vertex, with :math:`w^0` of least bending. A removed vertex :math:`v` (`mixseq.compression.bitstream.signal_graph`) lies
between its neighbours, but not at their mean if the surface is curved. The predicted value minimises the sum of squared
mean slopes at the vertex and at its neighbours,

.. math:: \sum_{i \in \{v\} \cup N(v)} \Bigl( \frac{1}{|N(i)|} \sum_{j \in N(i)} \frac{x_j - x_i}{l_{ij}} \Bigr)^2 ,

where :math:`N(i)` are v and the neighbours that i has after the removal of v, except for neighbours across v. A length
:math:`l_{ij}` counts edges: one for an edge of the mesh, and the sum of the two replaced edges for an edge that closes
the hole of a removed vertex. So a vertex is predicted from its neighbours and their neighbours; on a line of equal
lengths, the weights are -1/12, 7/12, 7/12, -1/12.

*Similar nodes.* After some signals, every node is also joined to the most similar earlier nodes, anywhere in the graph.
Distant vertices of one rigid part, or of several components, predict each other. Frames with equal poses in a repeating
motion do so, too.

*Steps.* Later signals are small, and most of their numbers are zero, so the errors of coarse levels spread to all nodes
between their nodes. Therefore coarse levels have smaller steps.

*Reproducibility.* Values are whole 64ths of a step, trust is a power of two, and weights are whole multiples of 2^-24.
So predictions are exact in float64, in any order of summation, for values below 2^29 (8 million steps). Roughness,
distances and sums of products are exact in nearly all files; otherwise they are rounded in a fixed order. Weights are
solved for with rounded + - * / and roots in a fixed order (`mixseq.compression.bitstream.predictor_kernels`).

The constants were chosen empirically. Frozen: changing them breaks files.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream import predictor_kernels as kernels
from mixseq.compression.bitstream.predictor_kernels import UNITS_PER_STEP
from mixseq.compression.bitstream.signal_graph import (
    MAX_NEIGHBOURS,
    Level,
    SignalGraph,
    coarser_levels,
    new_neighbours,
    renumber_adjacency,
)
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Int32

MAX_STENCIL_NODES = 16
"""Largest number of nodes in a stencil: neighbours, then nodes with the largest weights. Frozen: breaks files."""

MAX_SLOPE_NEIGHBOURS = 32
"""Number of neighbours above which slopes at a node are ignored, to save time. Frozen: breaks files."""


class Stencils(NamedTuple):
    """Neighbours and weights of every node, before any signal is known."""

    neighbours: Int32  # (N, MAX_STENCIL_NODES) earlier nodes of every node; only counts[node] entries of a row are used
    counts: Int32  # (N,) number of neighbours of every node
    weights: Float  # (N, MAX_STENCIL_NODES) multiples of 2^-24; rows add up to one


def graph_stencils(graph: SignalGraph) -> Stencils:
    """Return the stencils of a graph; graphs over time, and nodes without edges, keep the weights of the graph."""
    stencils = _compute_stencils(graph)
    kernels.round_weights(stencils.weights)
    return stencils


def _compute_stencils(graph: SignalGraph) -> Stencils:
    width, shape = graph.neighbours.shape[1], (graph.size, MAX_STENCIL_NODES)
    stencils = Stencils(np.zeros(shape, dtype=np.int32), graph.counts.copy(), np.zeros(shape))
    stencils.neighbours[:, :width] = graph.neighbours
    stencils.weights[:, :width] = graph.weights
    if graph.is_over_time:
        return stencils
    node_of_vertex = np.argsort(graph.order)  # levels have the numbers of vertices
    starts, adjacent = renumber_adjacency(graph.ring_starts, graph.ring, node_of_vertex, graph.order)
    lengths = np.ones(len(adjacent))
    for level in coarser_levels(starts, adjacent, *new_neighbours(graph.size)):
        new_lengths = _update_lengths(level, lengths)
        _fit_stencils(level, lengths, new_lengths, node_of_vertex, stencils)
        lengths = new_lengths
    return stencils


@compiled
def _fit_stencils(level: Level, lengths: Float, new_lengths: Float, node_of_vertex: Index, stencils: Stencils) -> None:
    """Write the stencils of removed vertices, from edge lengths ``(2 E,)`` before and ``(2 E',)`` after."""
    starts, adjacent, new_starts = level.starts, level.adjacent, level.new_starts
    slot = np.full(len(node_of_vertex), -1, dtype=np.int64)  # index of a vertex in `listed` and `weights`
    listed = np.empty(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1), dtype=np.int64)
    weights = np.empty(MAX_NEIGHBOURS * (MAX_SLOPE_NEIGHBOURS + 1))  # not yet divided by their sum
    for vertex in level.removed:
        first = starts[vertex]
        degree = min(starts[vertex + 1] - first, MAX_NEIGHBOURS)
        slope = 0.0  # derivative of the slope at the vertex by its value
        for place in range(first, first + degree):
            slope += 1.0 / lengths[place]
        slope /= degree
        for i in range(degree):
            listed[i], weights[i] = adjacent[first + i], slope / (degree * lengths[first + i])
            slot[listed[i]] = i
        size, total = degree, slope * slope
        for i in range(degree):
            neighbour, length = adjacent[first + i], lengths[first + i]
            if new_starts[neighbour + 1] - new_starts[neighbour] > MAX_SLOPE_NEIGHBOURS:
                continue
            count = 1
            # First pass: count remaining neighbours, except across the vertex. Second pass: add their weights.
            for turn in range(2):
                slope = 1.0 / (count * length)
                for place in range(new_starts[neighbour], new_starts[neighbour + 1]):
                    other = level.new_adjacent[place]
                    other_slot = slot[other]
                    if 0 <= other_slot < degree and new_lengths[place] >= length + lengths[first + other_slot]:
                        continue
                    if turn == 0:
                        count += 1
                        continue
                    if other_slot < 0:
                        slot[other], listed[size], weights[size] = size, other, 0.0
                        size += 1
                    weight = slope / (count * new_lengths[place])
                    weights[i] += weight
                    weights[slot[other]] -= weight
            total += slope * slope
            weights[i] += slope * slope
        for i in range(size):
            slot[listed[i]] = -1
        # Neighbours first, then those with the largest weights.
        kept = min(size, stencils.weights.shape[1])
        remainder = 1.0
        for i in range(kept):
            best = i
            if i >= degree:
                for j in range(i + 1, size):
                    if abs(weights[j]) > abs(weights[best]):
                        best = j
            listed[i], listed[best] = listed[best], listed[i]
            weights[i], weights[best] = weights[best], weights[i]
            remainder -= weights[i] / total
        node = node_of_vertex[vertex]
        stencils.counts[node] = kept
        for i in range(kept):
            stencils.neighbours[node, i] = node_of_vertex[listed[i]]
            stencils.weights[node, i] = weights[i] / total + remainder / kept


@compiled
def _update_lengths(level: Level, lengths: Float) -> Float:
    """Return shortest edge lengths ``(2 E',)`` after the removal of vertices, from the `lengths` before."""
    starts, adjacent, new_starts = level.starts, level.adjacent, level.new_starts
    new_lengths = np.full(len(level.new_adjacent), np.inf)
    for vertex in range(len(starts) - 1):
        if new_starts[vertex] == new_starts[vertex + 1]:
            continue
        row = level.new_adjacent[new_starts[vertex] : new_starts[vertex + 1]]
        for place in range(starts[vertex], starts[vertex + 1]):
            column = np.searchsorted(row, adjacent[place])
            if column < len(row) and row[column] == adjacent[place]:
                new_lengths[new_starts[vertex] + column] = lengths[place]
    count = 0
    for vertex in level.removed:
        first, last = starts[vertex], starts[vertex + 1]
        if last - first < 2:
            continue
        hub = level.new_edges[count, 0]
        hub_length = lengths[first + np.searchsorted(adjacent[first:last], hub)]
        for place in range(first, last):
            if adjacent[place] != hub:
                for tail, head in ((hub, adjacent[place]), (adjacent[place], hub)):
                    row = level.new_adjacent[new_starts[tail] : new_starts[tail + 1]]
                    edge = new_starts[tail] + np.searchsorted(row, head)
                    new_lengths[edge] = min(new_lengths[edge], hub_length + lengths[place])
                count += 1
    return new_lengths


SIMILAR_VERTICES, SIMILAR_FRAMES = 8, 16
"""Number of most similar nodes joined to a node: vertices, or frames. Frozen: breaks files."""

SIMILARITY_SEARCH_SIGNALS = 5
"""Number of known signals per coordinate at which similar nodes are searched for. Frozen: breaks files."""

EXHAUSTIVE_SEARCH_NODES = 2048
"""Number of first nodes that search all earlier nodes; later nodes search near neighbours. Frozen: breaks files."""

RIDGE_PER_SIGNAL = 0.5
"""Squared rounding error of a known signal, in steps: rho, the ridge of the weights. Frozen: breaks files."""

ROUGHNESS_SCALE = 10.0
"""Mean squared difference of neighbours, in squared steps, above which trust falls. Frozen: breaks files."""

TRUST_DOUBLING_SIGNALS, _MAX_TRUST_DOUBLINGS = 16, 512
"""Number of signals after which trust is doubled, as newer signals resemble the next signal most, and largest number of
doublings, which only damaged files reach. Frozen: breaks files.
"""

RENEWAL_SHIFT = 2
"""Weights are updated after every signal, after 8 signals after every other, after 12 after every third, and so on.
Frozen: breaks files.
"""

STEP_RATIO_TENTHS, MIN_STEP_UNITS = 9, 38
"""Ratio of the steps of successive coarser levels, in tenths, and smallest step in units. Frozen: breaks files."""

UNIFORM_STEP_SIGNALS = 3
"""Number of signals per coordinate with the same step at all nodes. Frozen: breaks files."""

_LARGE_GRAPH_NODES = 1024
"""Number of nodes above which graphs are processed in larger blocks. Free: affects time only."""

MIN_REPLAYED_NODES, MAX_REPLAYED_SIGNALS = 1 << 15, 24
"""Number of nodes above which Gram matrices are computed again from up to this number of signals, instead of kept.
Free: affects memory and time only.
"""

BLOCKS_PER_REPLAY = 64
"""Number of blocks whose Gram matrices are computed together from known signals. Free: affects time only."""


class Predictor:
    """Weights fitted to signals over a graph, coded or decoded one after another.

    Fill `values` node by node, each after `predictor_kernels.predict`; call `finish` after the last node.
    """

    def __init__(self, graph: SignalGraph, coordinates: int = 1) -> None:
        self._graph = graph
        self._coordinates, self.similarity_search_at = coordinates, SIMILARITY_SEARCH_SIGNALS * coordinates
        self._signal_count, self._next_update = 0, 1
        self._signals: list[Float] = []  # all signals, until similar nodes are searched for
        self._pending: list[Float] = []  # signals that are not yet in the Gram matrices
        self.values = np.zeros(graph.size, dtype=np.int64)
        self.steps = np.full(graph.size, UNITS_PER_STEP)
        self._set_neighbours(*graph_stencils(graph))

    def _set_neighbours(self, neighbours: Int32, counts: Int32, weights: Float) -> None:
        """Set the neighbours of nodes, and their initial weights, multiples of 2^-24, which are not changed."""
        self.neighbours, self.counts, self._initial_weights = neighbours, counts, weights
        self.weights = weights.copy()
        self._blocks = group_nodes(counts)
        self._gram: Float | None = None
        self._learned: list[tuple[Float, Float]] = []  # signals and their trusts that are not yet in the Gram matrices
        self._ridge = 0.0

    def finish(self) -> None:
        """Learn from the finished signal, and prepare for the next one."""
        signal = self.values.astype(np.float64)
        self._signal_count += 1
        count = self._signal_count
        self._pending.append(signal)
        if count == UNIFORM_STEP_SIGNALS * self._coordinates and not self._graph.is_over_time:
            self.steps = level_steps(len(self.steps))
        if count <= self.similarity_search_at:
            self._signals.append(signal)
        if count == self.similarity_search_at:
            self._add_similar_nodes()
        # Weights are updated at increasing intervals, as they change less and less.
        if count == self.similarity_search_at or count >= self._next_update:
            self._update_weights()
            self._next_update = count + max(1, count >> RENEWAL_SHIFT)

    def _update_weights(self) -> None:
        """Add the pending signals to the Gram matrices, and solve for weights.

        Matrices of large graphs take over a kilobyte per node, more than a few signals. So they are computed again from
        these signals, some blocks at a time, with the same bits.
        """
        signals = np.array(self._pending) if len(self._pending) > 1 else self._pending[0][None]
        graph = self.neighbours, self.counts
        ages = np.arange(self._signal_count - len(signals), self._signal_count) // TRUST_DOUBLING_SIGNALS
        trusts = np.ldexp(1.0, np.minimum(ages, _MAX_TRUST_DOUBLINGS))
        roughness = ROUGHNESS_SCALE * UNITS_PER_STEP**2
        trusts *= [kernels.compute_trust(signal, roughness, *graph) for signal in signals]
        self._ridge += RIDGE_PER_SIGNAL * UNITS_PER_STEP**2 * float(trusts.sum())
        self._learned.append((signals, trusts))
        self._pending = []
        if self._graph.size > MIN_REPLAYED_NODES and self._signal_count <= MAX_REPLAYED_SIGNALS:
            nodes, counts, places = self._blocks
            for start in range(0, len(nodes), BLOCKS_PER_REPLAY):
                ids = slice(start, start + BLOCKS_PER_REPLAY)
                blocks = kernels.Blocks(nodes[ids], counts[ids], places[ids] - places[start])
                self._learn(blocks, new_gram(blocks))
            return
        self._gram = new_gram(self._blocks) if self._gram is None else self._gram
        self._learn(self._blocks, self._gram)
        self._learned = []

    def _learn(self, blocks: kernels.Blocks, gram: Float) -> None:
        """Add the learned signals to the Gram matrices of blocks, and solve for the weights of their nodes."""
        for signals, trusts in self._learned:
            kernels.accumulate_gram(signals, trusts, blocks, self.neighbours, gram)
        kernels.solve_weights(self._ridge, blocks, gram, self._initial_weights, self.weights)

    def _add_similar_nodes(self) -> None:
        """Join every node to the earlier nodes that are most similar in all known signals."""
        graph = self._graph
        most = SIMILAR_FRAMES if graph.is_over_time else SIMILAR_VERTICES
        similar, counts = np.zeros((graph.size, most), dtype=np.int32), np.zeros(graph.size, dtype=np.int32)
        sources = graph.neighbours, graph.counts
        kernels.find_similar_nodes(np.array(self._signals), *sources, EXHAUSTIVE_SEARCH_NODES, similar, counts)
        neighbours, counts, weights = graph.with_extra_neighbours(similar, counts)
        kernels.round_weights(weights)
        self._set_neighbours(neighbours, counts, weights)
        self._pending, self._signals = self._signals, []


def level_steps(size: int) -> Index:
    """Return the steps ``(N,)`` of `size` nodes in units, smaller on coarse levels; node numbers double per level."""
    steps = np.full(size, UNITS_PER_STEP)
    first, step = size // 2, UNITS_PER_STEP
    while first:
        step = max(step * STEP_RATIO_TENTHS // 10, MIN_STEP_UNITS)
        steps[:first] = step
        first //= 2
    return steps


def group_nodes(counts: Int32) -> kernels.Blocks:
    """Return blocks of nodes with equal neighbour counts ``(N,)``.

    Nodes with fewer than two neighbours have fixed weights, and no block. Partial blocks repeat their last node.
    """
    lanes = kernels.LANES_PER_BLOCK if len(counts) > _LARGE_GRAPH_NODES else kernels.LANES_PER_SMALL_BLOCK
    blocks, block_counts = [np.zeros((0, lanes), dtype=np.int32)], []
    for count in np.unique(counts[counts > 1]):
        nodes: Index = np.flatnonzero(counts == count)
        rows = -(-len(nodes) // lanes)
        filled = np.minimum(np.arange(rows * lanes), len(nodes) - 1)
        blocks.append(nodes[filled].reshape(rows, lanes).astype(np.int32))
        block_counts += rows * [count]
    sizes = np.array(block_counts, dtype=np.int32)
    entries = _gram_entries(sizes)
    return kernels.Blocks(np.concatenate(blocks), sizes, np.cumsum(entries) - entries)


def new_gram(blocks: kernels.Blocks) -> Float:
    """Return the Gram matrices of blocks, filled with zeros."""
    return np.zeros((int(_gram_entries(blocks.counts).sum()), blocks.nodes.shape[1]))


def _gram_entries(counts: Int32) -> Index:
    """Return the numbers of entries of Gram matrices and right sides of blocks, by numbers of neighbours ``(B,)``."""
    sizes = counts.astype(np.int64)
    return sizes * (sizes + 1) // 2 - 1
