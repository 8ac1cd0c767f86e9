"""Compute predictions, their weights and similar nodes in compiled loops for `mixseq.compression.bitstream.predictor`.

Shared arguments, for a graph of N nodes with up to n neighbours each, which are earlier nodes:

============  ====================================================================================================
values        (N,) a signal, in units of 1/64 step: int64 while it is coded, then float64, whole numbers
neighbours    (N, n) int32: nodes that predict every node; the first ``counts[node]`` of a row are used
counts        (N,) int32: number of neighbours of every node
weights       (N, n) float64: weights of the neighbours, multiples of 2^-24; rows add up to one
gram          (entries, lanes) float64, in squared units: the matrices of every block, and the right sides below
              them, the lower triangles row by row
============  ====================================================================================================

The weight of the first neighbour is one minus the other weights, so matrices are of differences from this neighbour.

Sums of values, trust and weights are exact for values up to 2^29. Larger values, in damaged files, give arbitrary
results without an error. Only `solve_weights` rounds: it requires float64 + - * / and roots in the order written here,
without contraction to fused operations. It then rounds its results to multiples of 2^-24.

Frozen: changing results breaks files.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index, Int32

UNITS_PER_STEP = 64
"""Number of units per step. Frozen: breaks files."""

LANES_PER_BLOCK, LANES_PER_SMALL_BLOCK = 64, 8
"""Number of nodes in a block, for large and for small graphs. Free: affects time only."""

_MAX_PREDICTION = 2.0**50
"""Largest magnitude of predictions; larger ones, in damaged files, are clamped. Frozen: breaks files."""

_ROUNDING_OFFSET = 1.5 * 2.0**28
"""Number whose addition and subtraction rounds to a multiple of 2^-24. Frozen: breaks files."""

_RELATIVE_RIDGE = 1e-12
"""Share of a matrix's trace added to the ridge, for nearly singular matrices. Frozen: breaks files."""


class Blocks(NamedTuple):
    """Nodes with equal numbers of neighbours, processed together so that one instruction serves several."""

    nodes: Int32  # (B, lanes) nodes of every block
    counts: Int32  # (B,) number of neighbours of the nodes of every block
    places: Index  # (B,) row at which a block begins in `gram`


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
