"""Compiled loops of `mixseq.coding.bitstream.signal_graph`: adjacency, independent sets, edge collapses.

Frozen: changing their results breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.compiled import compiled

_HUB = 32
"""Ratio of neighbour counts above which shared ones are found by binary search. Free: affects time only."""

Bools = NDArray[np.bool_]


@compiled
def adjacency(starts: Index, beside: Index, left: Bools, edges: Index) -> tuple[Index, Index]:
    """Return the neighbours of all nodes of a graph with further edges ``(E, 2)``, of nodes that are `left` ``(N,)``.

    Neighbours are starts ``(N + 1,)`` and ``beside[starts[node] : starts[node + 1]]``, ascending and unique. Edges may
    repeat, exist already, or join a node to itself; both of their ends are left.
    """
    count = len(left)
    rows = np.zeros(count + 1, dtype=np.int64)
    for node in range(count):
        if left[node]:
            for place in range(starts[node], starts[node + 1]):
                rows[node + 1] += left[beside[place]]
    for edge in range(len(edges)):
        if edges[edge, 0] != edges[edge, 1]:
            rows[edges[edge, 0] + 1] += 1
            rows[edges[edge, 1] + 1] += 1
    for node in range(count):
        rows[node + 1] += rows[node]
    mixed = np.empty(rows[count], dtype=np.int32)
    places = rows[:-1].copy()
    for node in range(count):
        if left[node]:
            for place in range(starts[node], starts[node + 1]):
                if left[beside[place]]:
                    mixed[places[node]] = beside[place]
                    places[node] += 1
    for edge in range(len(edges)):
        one, other = edges[edge]
        if one != other:
            mixed[places[one]], mixed[places[other]] = other, one
            places[one] += 1
            places[other] += 1
    # Nodes enter the rows of their neighbours in their order, so that rows are ascending.
    ascending = np.empty(len(mixed), dtype=np.int32)
    places[:] = rows[:-1]
    for node in range(count):
        for place in range(rows[node], rows[node + 1]):
            other = mixed[place]
            if places[other] == rows[other] or ascending[places[other] - 1] != node:
                ascending[places[other]] = node
                places[other] += 1
    new_starts = np.zeros(count + 1, dtype=np.int64)
    for node in range(count):
        new_starts[node + 1] = new_starts[node] + places[node] - rows[node]
    new_beside = np.empty(new_starts[count], dtype=np.int64)
    for node in range(count):
        for place in range(new_starts[node + 1] - new_starts[node]):
            new_beside[new_starts[node] + place] = ascending[rows[node] + place]
    return new_starts, new_beside


@compiled
def renumbered(starts: Index, beside: Index, order: Index, place: Index) -> tuple[Index, Index]:
    """Return the neighbours of nodes in the order ``(N,)``: node i becomes ``place[i]``, the inverse of it."""
    new_starts = np.empty(len(order) + 1, dtype=np.int64)
    new_beside = np.empty(len(beside), dtype=np.int64)
    count = 0
    for new, node in enumerate(order):
        new_starts[new] = count
        for at in range(starts[node], starts[node + 1]):
            new_beside[count] = place[beside[at]]
            count += 1
    new_starts[len(order)] = count
    return new_starts, new_beside


@compiled
def independent(nodes: Index, starts: Index, beside: Index, fewest: int, most: int) -> Index:
    """Return nodes of which no two are neighbours, with at most `most` neighbours, by increasing number of neighbours.

    Ties among nodes ``(n,)`` int64, with `fewest` or more neighbours, keep their order; the neighbours of a node are
    ``beside[starts[node] : starts[node + 1]]``, with starts ``(N + 1,)``.
    """
    blocked = np.zeros(len(starts) - 1, dtype=np.bool_)
    chosen = np.empty(len(nodes), dtype=np.int64)
    count = 0
    for degree in range(fewest, most + 1):
        for node in nodes:
            if blocked[node] or starts[node + 1] - starts[node] != degree:
                continue
            chosen[count] = node
            count += 1
            for place in range(starts[node], starts[node + 1]):
                blocked[beside[place]] = True
    return chosen[:count].copy()


@compiled
def collapse(gone: Index, starts: Index, beside: Index, neighbours: Index, counts: Index) -> Index:
    """Write neighbours ``(N, n)`` and counts ``(N,)`` of removed nodes; return edges ``(E, 2)`` that close the holes.

    All neighbours of a node are joined to the one adjacent to most of the others, ties to the one of fewest neighbours.
    """
    most = neighbours.shape[1]
    size = 0
    for node in gone:
        size += starts[node + 1] - starts[node]
    new = np.empty((size, 2), dtype=np.int64)
    mark = np.full(len(starts) - 1, -1, dtype=np.int64)
    count = 0
    for node in gone:
        first, last = starts[node], starts[node + 1]
        counts[node] = min(last - first, most)
        for place in range(counts[node]):
            neighbours[node, place] = beside[first + place]
        for place in range(first, last):
            mark[beside[place]] = node
        best, shared_best, degree_best = beside[first], -1, 0
        for place in range(first, last):
            other = beside[place]
            shared = 0
            degree = starts[other + 1] - starts[other]
            if degree > _HUB * (last - first):
                for at in range(first, last):
                    low, high = starts[other], starts[other + 1]
                    while (
                        low < high
                    ):  # the first that is not less; NumPy's search would import SciPy when it is loaded
                        middle = (low + high) // 2
                        if beside[middle] < beside[at]:
                            low = middle + 1
                        else:
                            high = middle
                    if low < starts[other + 1] and beside[low] == beside[at]:
                        shared += 1
            else:
                for at in range(starts[other], starts[other + 1]):
                    if mark[beside[at]] == node:
                        shared += 1
            if shared > shared_best or (shared == shared_best and degree < degree_best):
                best, shared_best, degree_best = other, shared, degree
        for place in range(first, last):
            if beside[place] != best:
                new[count, 0] = best
                new[count, 1] = beside[place]
                count += 1
    return new[:count].copy()
