"""The loops of `mixseq.coding.bitstream.signal_graph`, compiled: who is beside whom, who goes, who is joined.

Frozen: changing their results breaks old files (golden: ``tests/coding/golden/*.npz``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.compiled import compiled

_HUB = 32
"""Neighbours that are so many times more are searched for what is shared, not gone through. Free: a matter of time."""


@compiled
def adjacency(edges: Index, count: int) -> tuple[Index, Index]:
    """Return starts ``(N + 1,)`` and neighbours ``(2 E,)``, ascending, of all nodes.

    Edges ``(E, 2)`` int64 are sorted, each once, from the lower node to the higher.
    """
    starts = np.zeros(count + 1, dtype=np.int64)
    for edge in range(len(edges)):
        starts[edges[edge, 0] + 1] += 1
        starts[edges[edge, 1] + 1] += 1
    for node in range(count):
        starts[node + 1] += starts[node]
    places = starts.copy()
    beside = np.empty(2 * len(edges), dtype=np.int64)
    for one, other in ((1, 0), (0, 1)):  # lower neighbours of all nodes first
        for edge in range(len(edges)):
            node = edges[edge, one]
            beside[places[node]] = edges[edge, other]
            places[node] += 1
    return starts, beside


@compiled
def independent(nodes: Index, starts: Index, beside: Index, most: int) -> Index:
    """Return nodes, first come first served, no two of which are neighbours, with at most so many neighbours.

    Nodes ``(n,)`` int64 are looked at in their order; those beside a node are
    ``beside[starts[node] : starts[node + 1]]``, with starts ``(N + 1,)``.
    """
    blocked = np.zeros(len(starts) - 1, dtype=np.bool_)
    chosen = np.empty(len(nodes), dtype=np.int64)
    count = 0
    for node in nodes:
        if blocked[node] or starts[node + 1] - starts[node] > most:
            continue
        chosen[count] = node
        count += 1
        for place in range(starts[node], starts[node + 1]):
            blocked[beside[place]] = True
    return chosen[:count].copy()


@compiled
def collapse(gone: Index, starts: Index, beside: Index, neighbours: Index, counts: Index) -> Index:
    """Note neighbours ``(N, n)`` and counts ``(N,)`` of nodes that go; return edges ``(E, 2)`` that close the holes.

    All neighbours of a node are joined to the one of them that has most of the others as neighbours already, or to
    the one of fewest neighbours among those.
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
