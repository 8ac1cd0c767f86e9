r"""Initial weights of signals over a mesh, from its connectivity, by least bending.

A removed vertex :math:`v` (`mixseq.coding.bitstream.signal_graph`) lies between its neighbours, but on a curved surface
away from their mean. The predicted value minimises the squares of mean slopes, at the vertex and at its neighbours,

.. math:: \sum_{i \in \{v\} \cup N(v)} \Bigl( \frac{1}{|N(i)|} \sum_{j \in N(i)} \frac{x_j - x_i}{l_{ij}} \Bigr)^2 ,

with v and the neighbours :math:`N(i)` that are left when v is gone, without those across v. Lengths :math:`l_{ij}` are
numbers of edges: one in the mesh, and the sum of both sides where an edge closes the hole of a removed vertex. So a
vertex is predicted from its neighbours, and from theirs; on a line of equal lengths with weights of -1/12, 7/12, 7/12,
-1/12.

Frozen: changing this breaks files.
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.coding.bitstream.signal_graph import MOST, SignalGraph, coarser_levels
from mixseq.coding.bitstream.signal_graph_kernels import renumbered
from mixseq.compiled import compiled

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
            for turn in range(
                2
            ):  # number of remaining neighbours, without those across the vertex; then their shares
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
