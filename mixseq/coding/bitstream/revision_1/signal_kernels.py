"""Compiled loops of `revision_1.signals`: weights, prediction, contexts, and nodes that are alike.

Arguments that they share, of a graph with N nodes of up to n neighbours each, all of them before the node:

============  ====================================================================================================
values        (N,) float64: the signal, in steps
neighbours    (N, n) int64: nodes that each is predicted from; the first ``counts[node]`` of a row count
counts        (N,) int64
weights       (N, n) float64: of the neighbours, rows add up to one
gram          (sum of counts (counts + 1) / 2,) float64, in squared steps: of every node's matrix the lower triangle,
              row by row; one node's after the other's
first, last   int: nodes ``first`` to ``last - 1``, a batch of n nodes; those before it are known
sizes         (N,) float64: magnitudes of the numbers of this signal, in steps, as far as they are known
activity      (N,) float64: the same of earlier signals, newer ones counting more
============  ====================================================================================================

Frozen: changing this breaks old files (golden: ``tests/coding/golden/*.npz``). Sums are in a fixed order, of + - * /
and roots only: decoders get the same bits on every machine.
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined


@compiled
def roughness(values: Float, neighbours: Index, counts: Index) -> float:
    """Return the mean square of the differences of nodes and their first neighbours, in squared steps."""
    total, pairs = 0.0, 0
    for node in range(len(values)):
        if counts[node]:
            apart = values[node] - values[neighbours[node, 0]]
            total += apart * apart
            pairs += 1
    return total / max(pairs, 1)


@compiled
def learn(values: Float, weight: float, neighbours: Index, counts: Index, gram: Float) -> None:
    """Add weight times the products of the differences of nodes and neighbours to the Gram matrices."""
    apart = np.zeros(neighbours.shape[1])
    place = 0
    for node in range(len(values)):
        for i in range(counts[node]):
            apart[i] = values[neighbours[node, i]] - values[node]
            one = weight * apart[i]
            for j in range(i + 1):
                gram[place] += one * apart[j]
                place += 1


@compiled
def solve(gram: Float, ridge: float, start: Float, counts: Index, weights: Float) -> None:
    """Write the weights that minimise w G w + ridge |w - start|^2, with a sum of one; start is ``(N, n)``.

    1e-12 of the trace of G is added to the ridge: matrices of signals of very many steps are singular but for rounding.
    """
    most = start.shape[1]
    lower = np.zeros((most, most))
    inverse = np.zeros(most)  # of the diagonal: divisions are slow
    ones = np.zeros(most)
    free = np.zeros(most)
    place = 0
    for node in range(len(counts)):
        count = counts[node]
        if count == 0:
            continue
        pull = ridge
        for i in range(count):
            pull += 1e-12 * gram[place + i * (i + 3) // 2]
        # G + pull = L L^T with pivots that are not below pull, and L (ones, free) = (1, pull start)
        for i in range(count):
            one, other = 1.0, pull * start[node, i]
            for j in range(i):
                entry = gram[place]
                place += 1
                for k in range(j):
                    entry -= lower[i, k] * lower[j, k]
                entry *= inverse[j]
                lower[i, j] = entry
                one -= entry * ones[j]
                other -= entry * free[j]
            entry = gram[place] + pull
            place += 1
            for k in range(i):
                entry -= lower[i, k] * lower[i, k]
            inverse[i] = 1.0 / math.sqrt(max(entry, pull))
            ones[i], free[i] = one * inverse[i], other * inverse[i]
        sum_ones, sum_free = 0.0, 0.0
        for i in range(count - 1, -1, -1):
            one, other = ones[i], free[i]
            for k in range(i + 1, count):
                one -= lower[k, i] * ones[k]
                other -= lower[k, i] * free[k]
            ones[i], free[i] = one * inverse[i], other * inverse[i]
            sum_ones += ones[i]
            sum_free += free[i]
        multiplier = (1.0 - sum_free) / sum_ones
        for i in range(count):
            weights[node, i] = free[i] + multiplier * ones[i]


@compiled
def restore(
    first: int, last: int, numbers: Index, neighbours: Index, counts: Index, weights: Float, values: Float
) -> None:
    """Write the values of nodes from the numbers ``(last - first,)`` that were read."""
    for node in range(first, last):
        predicted = 0.0
        for i in range(counts[node]):
            predicted += weights[node, i] * values[neighbours[node, i]]
        values[node] = predicted + numbers[node - first]


@compiled
def smooth(activity: Float, ring: Index, starts: Index) -> Float:
    """Return the means ``(N,)`` of the activity beside nodes, at ``ring[starts[node] : starts[node + 1]]``."""
    means = np.zeros(len(activity))
    for node in range(len(activity)):
        total = 0.0
        for place in range(starts[node], starts[node + 1]):
            total += activity[ring[place]]
        if starts[node + 1] > starts[node]:
            means[node] = total / (starts[node + 1] - starts[node])
    return means


@compiled
def surroundings(
    first: int, last: int, sizes: Float, activity: Float, neighbours: Index, counts: Index
) -> Float:
    """Return the mean sizes ``(last - first,)`` at neighbours before `first`, or the activity if there are none."""
    means = np.empty(last - first)
    for node in range(first, last):
        total, known = 0.0, 0
        for i in range(counts[node]):
            if neighbours[node, i] < first:
                total += sizes[neighbours[node, i]]
                known += 1
        means[node - first] = total / known if known else activity[node]
    return means


@compiled
def contexts(
    first: int,
    last: int,
    sizes: Float,
    activity: Float,
    around: Float,
    shares: Float,
    bounds: Float,
    neighbours: Index,
    counts: Index,
) -> Index:
    """Return in which interval between bounds ``(C - 1,)`` the expected size of every node's number is.

    The expected size is the sum of ``shares`` (3,) times the mean size at neighbours, the activity, and that of the
    ring, ``around`` (N,).
    """
    means = surroundings(first, last, sizes, activity, neighbours, counts)
    places = np.empty(last - first, dtype=np.int64)
    for node in range(first, last):
        expected = shares[0] * means[node - first] + shares[1] * activity[node] + shares[2] * around[node]
        low, high = 0, len(bounds)
        while low < high:
            middle = (low + high) // 2
            if bounds[middle] < expected:
                low = middle + 1
            else:
                high = middle
        places[node - first] = low
    return places


@compiled
def nearest(
    values: Float, neighbours: Index, counts: Index, exhaustive: int, most: int, found: Index, sizes: Index
) -> None:
    """Write the nodes before every node that are nearest to it in values ``(N, D)``, but for its neighbours.

    The first `exhaustive` nodes look at all nodes before them; later ones at neighbours of their neighbours, and at
    what was found for these. Of every node up to `most` are found, ``found`` (N, most), nearest first: ``sizes`` (N,).
    """
    apart = np.empty(most)
    seen = np.full(len(values), -1, dtype=np.int64)  # the last node that looked at a node
    for node in range(len(values)):
        sizes[node] = 0
        for i in range(counts[node]):
            seen[neighbours[node, i]] = node
        if node < exhaustive:
            for other in range(node):
                _consider(node, other, values, seen, most, found, sizes, apart)
            continue
        for i in range(counts[node]):
            beside = neighbours[node, i]
            for j in range(counts[beside]):
                _consider(node, neighbours[beside, j], values, seen, most, found, sizes, apart)
            for j in range(sizes[beside]):
                _consider(node, found[beside, j], values, seen, most, found, sizes, apart)


@inlined
def _consider(
    node: int, other: int, values: Float, seen: Index, most: int, found: Index, sizes: Index, apart: Float
) -> None:
    """Insert a node into the nearest ones at squared distances `apart` (most,), if it is one, and not seen before."""
    if seen[other] != node:
        seen[other] = node
        distance = 0.0
        limit = apart[most - 1] if sizes[node] == most else np.inf
        for dimension in range(values.shape[1]):
            one = values[node, dimension] - values[other, dimension]
            distance += one * one
            if distance >= limit:
                break
        if distance < limit:
            place = sizes[node] if sizes[node] < most else most - 1
            while place > 0 and apart[place - 1] > distance:
                apart[place] = apart[place - 1]
                found[node, place] = found[node, place - 1]
                place -= 1
            apart[place] = distance
            found[node, place] = other
            if sizes[node] < most:
                sizes[node] += 1
