r"""Predict signals over a graph from earlier ones: basis vectors over a mesh, coefficients over time.

Signals over one graph are similar: in a rigid part, every basis vector of trajectories is an affine function of the
vertex's position; near a joint, a smooth function. So weights fitted to earlier signals predict the next signal. At
node v, the weights :math:`w_n` of its neighbours n minimise

.. math:: \sum_j \tau_j \Bigl( \sum_n w_n b_j(n) - b_j(v) \Bigr)^2
          + \rho \sum_j \tau_j \sum_n (w_n - w^0_n)^2, \qquad \sum_n w_n = 1

over the known signals j. The trust :math:`\tau_j` balances large and small signals: about :math:`1 / (1 + m_j / 10)`,
where m_j is the mean square difference of neighbours, in squared steps. The second term models rounding errors of the
signals. Where known signals are affine functions, so is the prediction, as by the parallelogram rule.

*Initial weights* :math:`w^0` have least bending. The value of a removed vertex :math:`v`
(`mixseq.compression.bitstream.signal_graph`) minimises the sum of squared mean slopes at the vertex and its neighbours,

.. math:: \sum_{i \in \{v\} \cup N(v)} \Bigl( \frac{1}{|N(i)|} \sum_{j \in N(i)} \frac{x_j - x_i}{l_{ij}} \Bigr)^2 ,

where :math:`N(i)` are v and the neighbours that i has after the removal of v, except for neighbours across v, and the
length :math:`l_{ij}` counts edges of the mesh: on a line, the weights are -1/12, 7/12, 7/12, -1/12.

*Similar nodes.* After some signals, every node is also joined to the most similar earlier nodes, anywhere in the graph:
vertices of one rigid part, or frames with equal poses in a repeating motion.

*Steps.* Coarse levels have smaller steps, as their errors spread to all nodes between their nodes.

Of N nodes, `neighbours` ``(N, n)`` are earlier nodes, of which the first `counts` ``(N,)`` of a row are used, with
`weights` ``(N, n)`` that add up to one. Values are int64 while a signal is coded, in 64ths of a step. Known signals are
float64 and whole numbers, and weights multiples of 2^-24, so sums are exact for values up to 2^29. Only `solve_weights`
and the stencils round: they require float64 + - * / and roots in the order written here, without contraction to fused
operations. Larger values, in damaged files, give arbitrary results without an error.

The constants were chosen empirically. Frozen: changing results breaks files (specified in ``docs/file-format.md``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.signal_graph import (
    MAX_NEIGHBOURS,
    Level,
    SignalGraph,
    coarser_levels,
    new_neighbours,
    renumber_adjacency,
)
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index, Int32

UNITS_PER_STEP = 64  # number of units per step; frozen

LANES_PER_BLOCK, LANES_PER_SMALL_BLOCK = 64, 8
"""Number of nodes in a block, for large and for small graphs. Free: affects time only."""

_MAX_PREDICTION = 2.0**50  # largest magnitude of predictions; larger ones, in damaged files, are clamped; frozen
_ROUNDING_OFFSET = 1.5 * 2.0**28  # number whose addition and subtraction rounds to a multiple of 2^-24; frozen
_RELATIVE_RIDGE = 1e-12  # share of a matrix's trace added to the ridge, for nearly singular matrices; frozen


class Blocks(NamedTuple):
    """Nodes with equal numbers of neighbours, processed together so that one instruction serves several.

    Their Gram matrices ``(entries, lanes)``, in squared units, are of differences from the first neighbour, whose
    weight is one minus the other weights: lower triangles row by row, and the right sides below them.
    """

    nodes: Int32  # (B, lanes) nodes of every block
    counts: Int32  # (B,) number of neighbours of the nodes of every block
    places: Index  # (B,) row at which a block begins in Gram matrices


@force_inlined
def predict(node: int, neighbours: Int32, counts: Int32, weights: Float, values: Index) -> int:
    """Return the value of a node predicted from the values ``(N,)`` before it, in units."""
    total = 0.5
    for i in range(counts[node]):
        total += weights[node, i] * values[neighbours[node, i]]
    if total > _MAX_PREDICTION:
        total = _MAX_PREDICTION
    elif not total > -_MAX_PREDICTION:
        total = -_MAX_PREDICTION
    return math.floor(total)


def round_weights(weights: Float) -> None:
    """Round weights ``(N, n)`` to multiples of 2^-24, in place."""
    weights += _ROUNDING_OFFSET
    weights -= _ROUNDING_OFFSET


@compiled
def compute_trust(values: Float, scale: float, neighbours: Int32, counts: Int32) -> float:
    """Return a power of two, 2/3 to 4/3 of ``1 / (1 + m / scale)``; m is the mean square of first differences."""
    total, pairs = 0.0, 0
    for node in range(len(values)):
        if counts[node]:
            difference = values[node] - values[neighbours[node, 0]]
            total += difference * difference
            pairs += 1
    trust, target = 1.0, scale * pairs
    total += target
    while trust * total > 1.5 * target:
        trust *= 0.5
    return trust


@compiled
def accumulate_gram(signals: Float, trusts: Float, blocks: Blocks, neighbours: Int32, gram: Float) -> None:
    """Add products of the differences of signals ``(m, N)``, times their trusts ``(m,)``, to the Gram matrices."""
    lanes = blocks.nodes.shape[1]
    differences = np.zeros((neighbours.shape[1], lanes))
    for block in range(len(blocks.nodes)):
        last = blocks.counts[block] - 1  # the row of the node itself
        for number in range(len(signals)):
            values, trust = signals[number], trusts[number]
            for lane in range(lanes):
                node = blocks.nodes[block, lane]
                first = values[neighbours[node, 0]]
                for i in range(last):
                    differences[i, lane] = values[neighbours[node, i + 1]] - first
                differences[last, lane] = values[node] - first
            place = blocks.places[block]
            for i in range(last + 1):
                for j in range(min(i + 1, last)):
                    for lane in range(lanes):
                        gram[place, lane] += (trust * differences[i, lane]) * differences[j, lane]
                    place += 1


@compiled
def solve_weights(ridge: float, blocks: Blocks, gram: Float, initial: Float, weights: Float) -> None:
    """Write the weights of sum one that minimise w G w + ridge |w - w^0|^2, by Cholesky: `initial` w^0 ``(N, n)``."""
    max_count, lanes = initial.shape[1], blocks.nodes.shape[1]
    # The last row of the factor is the right side, after forward substitution.
    factor = np.zeros((max_count * (max_count + 1) // 2, lanes))
    inverse = np.zeros((max_count, lanes))  # inverse of the diagonal, as divisions are slow
    solution = np.zeros((max_count, lanes))
    damping, entry, first_weight = np.zeros(lanes), np.zeros(lanes), np.zeros(lanes)
    for block in range(len(blocks.nodes)):
        nodes, last, place = blocks.nodes[block], blocks.counts[block] - 1, blocks.places[block]
        damping[:] = ridge
        for i in range(last):
            for lane in range(lanes):
                damping[lane] += _RELATIVE_RIDGE * gram[place + i * (i + 3) // 2, lane]
        for i in range(last + 1):
            row = i * (i + 1) // 2
            for j in range(min(i + 1, last)):
                column = j * (j + 1) // 2
                # The first weight, one minus the other weights, is damped as well.
                for lane in range(lanes):
                    entry[lane] = gram[place, lane] + damping[lane]
                if i == last:
                    for lane in range(lanes):
                        node = nodes[lane]
                        entry[lane] += damping[lane] * (initial[node, j + 1] - initial[node, 0])
                elif i == j:
                    for lane in range(lanes):
                        entry[lane] += damping[lane]
                for k in range(j):
                    for lane in range(lanes):
                        entry[lane] -= factor[row + k, lane] * factor[column + k, lane]
                if i == j:
                    for lane in range(lanes):
                        inverse[i, lane] = 1.0 / math.sqrt(max(entry[lane], damping[lane]))
                else:
                    for lane in range(lanes):
                        factor[row + j, lane] = entry[lane] * inverse[j, lane]
                place += 1
        row = last * (last + 1) // 2
        first_weight[:] = 1.0
        for i in range(last - 1, -1, -1):
            for lane in range(lanes):
                entry[lane] = factor[row + i, lane]
            for k in range(i + 1, last):
                for lane in range(lanes):
                    entry[lane] -= factor[k * (k + 1) // 2 + i, lane] * solution[k, lane]
            for lane in range(lanes):
                solution[i, lane] = (entry[lane] * inverse[i, lane] + _ROUNDING_OFFSET) - _ROUNDING_OFFSET
                first_weight[lane] -= solution[i, lane]
        for lane in range(lanes):
            weights[nodes[lane], 0] = first_weight[lane]
            for i in range(last):
                weights[nodes[lane], i + 1] = solution[i, lane]


@compiled
def find_similar_nodes(
    signals: Float, neighbours: Int32, counts: Int32, exhaustive: int, similar: Int32, similar_counts: Int32
) -> None:
    """Find the earlier nodes nearest to every node in signals ``(D, N)``, except for its neighbours.

    The first `exhaustive` nodes search all earlier nodes. Later nodes search the neighbours and similar nodes of their
    neighbours. Up to k nodes are written to `similar` ``(N, k)``, nearest first, ties in search order, and their number
    to `similar_counts` ``(N,)``.
    """
    size, most = signals.shape[1], similar.shape[1]
    first_count = min(size, exhaustive)
    nearest = np.empty(most)  # squared distances of the similar nodes of a node
    distances = np.empty(first_count)
    for node in range(first_count):
        # Dimensions are the outer loop, so that one instruction serves several nodes.
        distances[:node] = 0.0
        for dimension in range(len(signals)):
            value = signals[dimension, node]
            for other in range(node):
                difference = signals[dimension, other] - value
                distances[other] += difference * difference
        for i in range(counts[node]):
            distances[neighbours[node, i]] = np.inf
        similar_counts[node] = 0
        nearest[:] = np.inf
        for other in range(node):
            if distances[other] < nearest[most - 1]:
                _insert(node, other, distances[other], similar, similar_counts, nearest)
    points = np.ascontiguousarray(signals.T)
    visitor = np.full(size, -1, dtype=np.int32)  # the last node that visited a node
    for node in range(first_count, size):
        similar_counts[node] = 0
        nearest[:] = np.inf
        for i in range(counts[node]):
            visitor[neighbours[node, i]] = node
        for i in range(counts[node]):
            neighbour = neighbours[node, i]
            count = counts[neighbour]
            for j in range(count + similar_counts[neighbour]):
                other = neighbours[neighbour, j] if j < count else similar[neighbour, j - count]
                if visitor[other] == node:
                    continue
                visitor[other] = node
                distance = 0.0
                for dimension in range(points.shape[1]):
                    difference = points[node, dimension] - points[other, dimension]
                    distance += difference * difference
                    if distance >= nearest[most - 1]:
                        break
                if distance < nearest[most - 1]:
                    _insert(node, int(other), distance, similar, similar_counts, nearest)


@force_inlined
def _insert(node: int, other: int, distance: float, similar: Int32, similar_counts: Int32, nearest: Float) -> None:
    """Insert another node into the similar nodes of a node by squared distance, replacing the farthest."""
    place = len(nearest) - 1
    while place > 0 and nearest[place - 1] > distance:
        nearest[place] = nearest[place - 1]
        similar[node, place] = similar[node, place - 1]
        place -= 1
    nearest[place] = distance
    similar[node, place] = other
    similar_counts[node] = min(similar_counts[node] + 1, len(nearest))


MAX_STENCIL_NODES = 16  # largest number of nodes in a stencil: neighbours, then nodes with the largest weights; frozen
MAX_SLOPE_NEIGHBOURS = 32  # number of neighbours above which slopes at a node are ignored, to save time; frozen


class Stencils(NamedTuple):
    """Neighbours and weights of every node, before any signal is known."""

    neighbours: Int32  # (N, MAX_STENCIL_NODES) earlier nodes of every node; only counts[node] entries of a row are used
    counts: Int32  # (N,) number of neighbours of every node
    weights: Float  # (N, MAX_STENCIL_NODES) multiples of 2^-24; rows add up to one


def graph_stencils(graph: SignalGraph) -> Stencils:
    """Return the stencils of a graph; graphs over time, and nodes without edges, keep the weights of the graph."""
    stencils = _compute_stencils(graph)
    round_weights(stencils.weights)
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


SIMILAR_VERTICES, SIMILAR_FRAMES = 8, 16  # number of most similar nodes joined to a node: vertices, or frames; frozen
SIMILARITY_SEARCH_SIGNALS = 5  # number of known signals per coordinate at which similar nodes are searched for; frozen
EXHAUSTIVE_SEARCH_NODES = 2048  # number of first nodes that search all earlier nodes, not only near neighbours; frozen
RIDGE_PER_SIGNAL = 0.5  # squared rounding error of a known signal, in steps: rho, the ridge of the weights; frozen
ROUGHNESS_SCALE = 10.0  # mean squared difference of neighbours, in squared steps, above which trust falls; frozen

TRUST_DOUBLING_SIGNALS, _MAX_TRUST_DOUBLINGS = 16, 512
"""Number of signals after which trust is doubled, as newer signals resemble the next signal most, and largest number of
doublings, which only damaged files reach. Frozen: breaks files.
"""

RENEWAL_SHIFT = 2
"""Weights are updated after every signal, after 8 signals after every other, after 12 after every third, and so on.
Frozen: breaks files.
"""

STEP_RATIO_TENTHS, MIN_STEP_UNITS = 9, 38  # ratio of steps of successive coarser levels, smallest step in units; frozen
UNIFORM_STEP_SIGNALS = 3  # number of signals per coordinate with the same step at all nodes; frozen
_LARGE_GRAPH_NODES = 1024  # number of nodes above which graphs are processed in larger blocks; free, affects time

MIN_REPLAYED_NODES, MAX_REPLAYED_SIGNALS = 1 << 15, 24
"""Number of nodes above which Gram matrices are computed again from up to this number of signals, instead of kept.
Free: affects memory and time only.
"""

BLOCKS_PER_REPLAY = 64  # number of blocks whose Gram matrices are computed together; free: affects time


class Predictor:
    """Weights fitted to signals over a graph, coded or decoded one after another.

    Fill `values` node by node, each after `predict`; call `finish` after the last node.
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
        trusts *= [compute_trust(signal, roughness, *graph) for signal in signals]
        self._ridge += RIDGE_PER_SIGNAL * UNITS_PER_STEP**2 * float(trusts.sum())
        self._learned.append((signals, trusts))
        self._pending = []
        if self._graph.size > MIN_REPLAYED_NODES and self._signal_count <= MAX_REPLAYED_SIGNALS:
            nodes, counts, places = self._blocks
            for start in range(0, len(nodes), BLOCKS_PER_REPLAY):
                ids = slice(start, start + BLOCKS_PER_REPLAY)
                blocks = Blocks(nodes[ids], counts[ids], places[ids] - places[start])
                self._learn(blocks, new_gram(blocks))
            return
        self._gram = new_gram(self._blocks) if self._gram is None else self._gram
        self._learn(self._blocks, self._gram)
        self._learned = []

    def _learn(self, blocks: Blocks, gram: Float) -> None:
        """Add the learned signals to the Gram matrices of blocks, and solve for the weights of their nodes."""
        for signals, trusts in self._learned:
            accumulate_gram(signals, trusts, blocks, self.neighbours, gram)
        solve_weights(self._ridge, blocks, gram, self._initial_weights, self.weights)

    def _add_similar_nodes(self) -> None:
        """Join every node to the earlier nodes that are most similar in all known signals."""
        graph = self._graph
        most = SIMILAR_FRAMES if graph.is_over_time else SIMILAR_VERTICES
        similar, counts = np.zeros((graph.size, most), dtype=np.int32), np.zeros(graph.size, dtype=np.int32)
        sources = graph.neighbours, graph.counts
        find_similar_nodes(np.array(self._signals), *sources, EXHAUSTIVE_SEARCH_NODES, similar, counts)
        neighbours, counts, weights = graph.with_extra_neighbours(similar, counts)
        round_weights(weights)
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


def group_nodes(counts: Int32) -> Blocks:
    """Return blocks of nodes with equal neighbour counts ``(N,)``.

    Nodes with fewer than two neighbours have fixed weights, and no block. Partial blocks repeat their last node.
    """
    lanes = LANES_PER_BLOCK if len(counts) > _LARGE_GRAPH_NODES else LANES_PER_SMALL_BLOCK
    blocks, block_counts = [np.zeros((0, lanes), dtype=np.int32)], []
    for count in np.unique(counts[counts > 1]):
        nodes: Index = np.flatnonzero(counts == count)
        rows = -(-len(nodes) // lanes)
        filled = np.minimum(np.arange(rows * lanes), len(nodes) - 1)
        blocks.append(nodes[filled].reshape(rows, lanes).astype(np.int32))
        block_counts += rows * [count]
    sizes = np.array(block_counts, dtype=np.int32)
    entries = _gram_entries(sizes)
    return Blocks(np.concatenate(blocks), sizes, np.cumsum(entries) - entries)


def new_gram(blocks: Blocks) -> Float:
    """Return the Gram matrices of blocks, filled with zeros."""
    return np.zeros((int(_gram_entries(blocks.counts).sum()), blocks.nodes.shape[1]))


def _gram_entries(counts: Int32) -> Index:
    """Return the numbers of entries of Gram matrices and right sides of blocks, by numbers of neighbours ``(B,)``."""
    sizes = counts.astype(np.int64)
    return sizes * (sizes + 1) // 2 - 1
