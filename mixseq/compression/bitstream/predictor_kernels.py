"""Compiled loops of `mixseq.compression.bitstream.predictor`: predictions, their weights, and similar nodes.

Shared arguments, of a graph with N nodes of up to n neighbours each, all of them before the node:

============  ====================================================================================================
values        (N,) int64, in work, or float64, whole numbers: a signal, in units of 1/64 step
neighbours    (N, n) int32: nodes that each is predicted from; the first ``counts[node]`` of a row count
counts        (N,) int32
weights       (N, n) float64: of the neighbours, rows add up to one; multiples of 2^-24
blocks        (B, lanes) int32: nodes with equally many neighbours, ``sizes[block]`` of them, processed together
              so that one instruction serves several
sizes         (B,) int32
places        (B,) int64: where a block begins in `gram`
gram          (entries, lanes) float64, in squared units: of every block's matrices, and of the right sides below
              them, the lower triangles row by row
============  ====================================================================================================

The weight of a node's first neighbour is one minus the others, so matrices are those of differences to it.

Sums of values, trust and weights are exact up to values of 2^29; larger values, of damaged files, give arbitrary
results without an error. Only `solve` rounds: it needs + - * / and roots of float64 in the order written here, without
contraction to fused operations, and then rounds its results.

Frozen: changing results breaks files.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index

UNIT = 64
"""Values are whole numbers of steps / UNIT. Frozen: breaks files."""

LANES, FEW_LANES = 64, 8
"""Nodes in a block, for graphs with many, or few nodes. Free: affects time only."""

_FARTHEST = 2.0**50
"""Largest magnitude of predictions; bounds those of damaged files. Frozen: breaks files."""

_ROUNDING = 1.5 * 2.0**28
"""Number whose addition and subtraction rounds to a multiple of 2^-24. Frozen: breaks files."""

_LEAST = 1e-12
"""Share of a matrix's trace added to the ridge, for nearly singular ones of large signals. Frozen: breaks files."""

Small = NDArray[np.int32]


@force_inlined
def predict(node: int, neighbours: Small, counts: Small, weights: Float, values: Index) -> int:
    """Return the value of a node predicted from the values ``(N,)`` before it, in units."""
    total = 0.5
    for i in range(counts[node]):
        total += weights[node, i] * values[neighbours[node, i]]
    if total > _FARTHEST:
        total = _FARTHEST
    elif not total > -_FARTHEST:
        total = -_FARTHEST
    return math.floor(total)


@compiled
def rounded(weights: Float) -> Float:
    """Return weights ``(N, n)``, rounded to multiples of 2^-24."""
    return (weights + _ROUNDING) - _ROUNDING


@compiled
def trust(values: Float, rough: float, neighbours: Small, counts: Small) -> float:
    """Return the power of two from 2/3 to 4/3 of ``1 / (1 + m / rough)``, m the mean square of first differences."""
    total, pairs = 0.0, 0
    for node in range(len(values)):
        if counts[node]:
            apart = values[node] - values[neighbours[node, 0]]
            total += apart * apart
            pairs += 1
    share, whole = 1.0, rough * pairs
    total += whole
    while share * total > 1.5 * whole:
        share *= 0.5
    return share


@compiled
def learn(
    signals: Float,
    trusts: Float,
    blocks: Small,
    sizes: Small,
    places: Index,
    neighbours: Small,
    gram: Float,
) -> None:
    """Add the products of the differences of signals ``(m, N)``, times trusts ``(m,)``, to the Gram matrices."""
    lanes = blocks.shape[1]
    apart = np.zeros((neighbours.shape[1], lanes))
    for block in range(len(blocks)):
        last = sizes[block] - 1  # the row of the node itself
        for number in range(len(signals)):
            values, weight = signals[number], trusts[number]
            for lane in range(lanes):
                node = blocks[block, lane]
                first = values[neighbours[node, 0]]
                for i in range(last):
                    apart[i, lane] = values[neighbours[node, i + 1]] - first
                apart[last, lane] = values[node] - first
            place = places[block]
            for i in range(last + 1):
                for j in range(min(i + 1, last)):
                    for lane in range(lanes):
                        gram[place, lane] += (weight * apart[i, lane]) * apart[j, lane]
                    place += 1


@compiled
def solve(
    ridge: float, blocks: Small, sizes: Small, places: Index, gram: Float, start: Float, weights: Float
) -> None:
    """Write the weights of sum one that minimise w G w + ridge |w - start|^2, by Cholesky: start ``(N, n)``."""
    most, lanes = start.shape[1], blocks.shape[1]
    lower = np.zeros((most * (most + 1) // 2, lanes))  # and the right side, divided by it, as its last row
    inverse = np.zeros((most, lanes))  # of the diagonal: divisions are slow
    found = np.zeros((most, lanes))
    pull, entry = np.zeros(lanes), np.zeros(lanes)
    for block in range(len(blocks)):
        nodes, last, place = blocks[block], sizes[block] - 1, places[block]
        pull[:] = ridge
        for i in range(last):
            for lane in range(lanes):
                pull[lane] += _LEAST * gram[place + i * (i + 3) // 2, lane]
        for i in range(last + 1):
            row = i * (i + 1) // 2
            for j in range(min(i + 1, last)):
                column = j * (j + 1) // 2
                # The ridge of the first weight, too, which is one minus the others.
                for lane in range(lanes):
                    entry[lane] = gram[place, lane] + pull[lane]
                if i == last:
                    for lane in range(lanes):
                        entry[lane] += pull[lane] * (start[nodes[lane], j + 1] - start[nodes[lane], 0])
                elif i == j:
                    for lane in range(lanes):
                        entry[lane] += pull[lane]
                for k in range(j):
                    for lane in range(lanes):
                        entry[lane] -= lower[row + k, lane] * lower[column + k, lane]
                if i == j:
                    for lane in range(lanes):
                        inverse[i, lane] = 1.0 / math.sqrt(max(entry[lane], pull[lane]))
                else:
                    for lane in range(lanes):
                        lower[row + j, lane] = entry[lane] * inverse[j, lane]
                place += 1
        row = last * (last + 1) // 2
        pull[:] = 1.0  # what is left for the first
        for i in range(last - 1, -1, -1):
            for lane in range(lanes):
                entry[lane] = lower[row + i, lane]
            for k in range(i + 1, last):
                for lane in range(lanes):
                    entry[lane] -= lower[k * (k + 1) // 2 + i, lane] * found[k, lane]
            for lane in range(lanes):
                found[i, lane] = (entry[lane] * inverse[i, lane] + _ROUNDING) - _ROUNDING
                pull[lane] -= found[i, lane]
        for lane in range(lanes):
            weights[nodes[lane], 0] = pull[lane]
            for i in range(last):
                weights[nodes[lane], i + 1] = found[i, lane]


@compiled
def nearest(
    signals: Float, neighbours: Small, counts: Small, exhaustive: int, similar: Small, found: Small
) -> None:
    """Write the nodes before every node that are nearest to it in signals ``(D, N)``, without its neighbours.

    The first `exhaustive` nodes search all nodes before them; later ones the neighbours of their neighbours, and the
    results for these. Up to ``similar`` (N, most), nearest first, ties in search order; counts ``found`` (N,).
    """
    size, most = signals.shape[1], similar.shape[1]
    first = min(size, exhaustive)
    apart = np.empty(most)
    distances = np.empty(first)
    for node in range(first):
        # Dimension by dimension: one instruction serves several nodes.
        distances[:node] = 0.0
        for dimension in range(len(signals)):
            here = signals[dimension, node]
            for other in range(node):
                one = signals[dimension, other] - here
                distances[other] += one * one
        for i in range(counts[node]):
            distances[neighbours[node, i]] = np.inf
        found[node] = 0
        apart[:] = np.inf
        for other in range(node):
            if distances[other] < apart[most - 1]:
                _insert(node, other, distances[other], similar, found, apart)
    points = np.ascontiguousarray(signals.T)
    seen = np.full(size, -1, dtype=np.int32)  # the last node that searched a node
    for node in range(first, size):
        found[node] = 0
        apart[:] = np.inf
        for i in range(counts[node]):
            seen[neighbours[node, i]] = node
        for i in range(counts[node]):
            beside = neighbours[node, i]
            for j in range(counts[beside] + found[beside]):
                own = j < counts[beside]
                other = neighbours[beside, j] if own else similar[beside, j - counts[beside]]
                if seen[other] == node:
                    continue
                seen[other] = node
                distance = 0.0
                for dimension in range(points.shape[1]):
                    one = points[node, dimension] - points[other, dimension]
                    distance += one * one
                    if distance >= apart[most - 1]:
                        break
                if distance < apart[most - 1]:
                    _insert(node, np.int64(other), distance, similar, found, apart)


@force_inlined
def _insert(
    node: int, other: int | np.int64, distance: float, similar: Small, found: Small, apart: Float
) -> None:
    """Insert a node into the nearest ones at squared distances `apart` (most,), replacing the farthest."""
    place = len(apart) - 1
    while place > 0 and apart[place - 1] > distance:
        apart[place] = apart[place - 1]
        similar[node, place] = similar[node, place - 1]
        place -= 1
    apart[place] = distance
    similar[node, place] = other
    found[node] = min(found[node] + 1, len(apart))
