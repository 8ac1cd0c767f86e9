"""The coding order of a signal over a mesh, or over time, and the neighbours that predict each value.

A signal has a value at every node of a graph: the vertices of a mesh and its edges, or frames and the steps between
them. Nodes are removed level by level: each node of an independent set with few neighbours is collapsed onto one of
them, which gives the graph of the next level. Coding runs coarse to fine, so that nearly all values are interpolated
*between* known ones: this averages rounding errors, where an extrapolation such as the parallelogram rule enlarges
them. The levels depend on connectivity only, so they are not stored.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/*.npz``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.polygons import read_only
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Mask

MOST = 12
"""Largest number of neighbours that predict a node. Frozen: breaks old files."""

NEIGHBOUR_COUNTS = MOST + 1
"""Number of possible counts of these neighbours, from none on. Frozen: breaks old files."""

WIDEST = 6
"""Largest number of neighbours of a removed node, if there are any such nodes. Frozen: breaks old files."""

ROOTS = 6
"""Number of earlier roots that predict a node without neighbours. Frozen: breaks old files."""

_HUB = 32
"""Ratio of neighbour counts above which shared ones are found by binary search. Free: affects time only."""


@compiled
def adjacency(starts: Index, beside: Index, left: Mask, edges: Index) -> tuple[Index, Index]:
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
                    # The first that is not less; NumPy's search would import SciPy when it is loaded.
                    while low < high:
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


@dataclass(frozen=True, eq=False)
class SignalGraph:
    """Nodes in coding order, and the earlier nodes that predict each; all node numbers refer to this order."""

    order: Index  # (N,) vertices, or frames, of the nodes: coarse to fine
    neighbours: Index  # (N, n) for every node, nodes before it
    counts: Index  # (N,) their number
    weights: Float  # (N, n) their initial weights; rows add up to one
    ring: Index  # (R,) all nodes beside every node, before or after it, node by node
    ring_starts: Index  # (N + 1,) row offsets of ring: ring[ring_starts[i] : ring_starts[i + 1]] of node i
    over_time: bool = False  # whether nodes are frames, not vertices

    def __post_init__(self) -> None:
        for name in ("order", "neighbours", "counts", "weights", "ring", "ring_starts"):
            # Always: numba would compile again for writable arrays, which have another type.
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def size(self) -> int:
        """Number N of nodes."""
        return len(self.order)

    def with_more(self, nodes: NDArray[np.integer], sizes: NDArray[np.integer]) -> SignalGraph:
        """Return the graph with further neighbours ``(N, k)``: node i has ``sizes[i]``, with initial weight zero."""
        neighbours = np.concatenate([self.neighbours, np.zeros_like(nodes)], axis=1)
        rows = np.arange(self.size)
        for place in range(nodes.shape[1]):
            some = sizes > place
            neighbours[rows[some], self.counts[some] + place] = nodes[some, place]
        weights = np.concatenate([self.weights, np.zeros((self.size, nodes.shape[1]))], axis=1)
        return replace(self, neighbours=neighbours, counts=self.counts + sizes, weights=weights)


def mesh_graph(faces: NDArray[np.integer], vertex_count: int) -> SignalGraph:
    """Return the graph of a mesh: vertices and edges; faces ``(F, 3)``."""
    ring_starts, ring = mesh_neighbours(faces, vertex_count)
    neighbours = np.zeros((vertex_count, MOST), dtype=np.int64)
    counts = np.zeros(vertex_count, dtype=np.int64)
    left = np.ones(vertex_count, dtype=bool)
    levels: list[Index] = []
    for level in coarser_levels(ring_starts, ring, neighbours, counts):
        left[level.gone] = False
        levels.append(level.gone)
    roots = np.flatnonzero(left)
    for place in range(1, len(roots)):
        before = roots[max(0, place - ROOTS) : place]
        neighbours[roots[place], : len(before)] = before
        counts[roots[place]] = len(before)
    known = np.arange(MOST) < counts[:, None]
    weights = known / np.maximum(counts, 1)[:, None]
    # Every root needs those before it, and is a level of its own.
    return _graph([roots, *levels[::-1]], neighbours, counts, weights, ring, ring_starts)


class Level(NamedTuple):
    """Nodes removed together, and the graphs before and after, both of N nodes; removed nodes have no edges."""

    gone: Index  # (n,) removed nodes
    starts: Index  # (N + 1,) row offsets of the graph before, see adjacency
    beside: Index  # (2 E,) neighbours in the graph before, row by row
    new: Index  # (n', 2) edges that close the holes; some twice, or there already
    new_starts: Index  # (N + 1,) row offsets of the graph after
    new_beside: Index  # (2 E',) neighbours in the graph after, row by row


def mesh_neighbours(faces: NDArray[np.integer], vertex_count: int) -> tuple[Index, Index]:
    """Return the neighbours of all vertices of triangles ``(F, 3)``, as `adjacency` lists them."""
    sides = np.empty((3, len(faces), 2), dtype=np.int64)
    for corner, side in enumerate(sides):
        side[:, 0], side[:, 1] = faces[:, corner], faces[:, (corner + 1) % 3]
    return neighbours_of(sides.reshape(-1, 2), vertex_count)


def neighbours_of(edges: Index, count: int) -> tuple[Index, Index]:
    """Return the neighbours of `count` nodes, as `adjacency` lists them, of edges ``(E, 2)``."""
    none = np.zeros(count + 1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return adjacency(*none, np.ones(count, dtype=bool), edges)


def coarser_levels(starts: Index, beside: Index, neighbours: Index, counts: Index) -> Iterator[Level]:
    """Remove nodes until no edge is left, and yield the levels, fine to coarse.

    Starts ``(N + 1,)`` and beside ``(2 E,)`` are the neighbours of all nodes, as `adjacency` lists
    them. Neighbours ``(N, MOST)`` and counts ``(N,)`` of removed nodes are written.
    """
    left = np.ones(len(counts), dtype=bool)
    while len(beside):
        degrees = np.diff(starts)
        nodes = np.flatnonzero(degrees)
        fewest = int(degrees[nodes].min())
        gone = independent(nodes, starts, beside, fewest, max(WIDEST, fewest))
        new = collapse(gone, starts, beside, neighbours, counts)
        left[gone] = False
        before = starts, beside
        starts, beside = adjacency(*before, left, new)
        yield Level(gone, *before, new, starts, beside)


@lru_cache(maxsize=64)
def path_graph(count: int) -> SignalGraph:
    """Return the graph of consecutive frames: first and last, those in the middle, and so on by halves.

    A frame is predicted from two known frames on either side, at first by the polynomial through them (Lagrange), and
    from the two nearest further known ones.
    """
    neighbours = np.zeros((count, 6), dtype=np.int64)
    counts = np.zeros(count, dtype=np.int64)
    weights = np.zeros((count, 6))
    known = np.unique([0, count - 1])
    levels = [known]
    if count > 1:
        counts[count - 1], weights[count - 1, 0] = 1, 1.0
    step = 1 << max(count - 1, 1).bit_length()
    while step > 1:
        step //= 2
        new = np.setdiff1d(np.arange(step, count - 1, 2 * step), known)
        for node in new:
            place = int(np.searchsorted(known, node))
            beside = known[max(place - 2, 0) : place + 2]
            weights[node, : len(beside)] = _lagrange(beside, int(node))
            others = np.setdiff1d(np.append(known, new[new < node]), beside)
            others = others[np.argsort(np.abs(others - node), kind="stable")][: 6 - len(beside)]
            counts[node] = len(beside) + len(others)
            neighbours[node, : counts[node]] = np.append(beside, others)
        known = np.union1d(known, new)
        levels.append(new)
    frames = np.arange(count)
    pairs = np.stack([frames[:-1], frames[1:]], axis=1)
    ring_starts, ring = neighbours_of(pairs, count)
    return replace(_graph(levels, neighbours, counts, weights, ring, ring_starts), over_time=True)


def _lagrange(nodes: Index, at: int) -> Float:
    """Return the weights of the polynomial through values at nodes: quotients of integers, the same on all machines."""
    weights = np.ones(len(nodes))
    for one, node in enumerate(nodes.tolist()):
        over = under = 1
        for other in nodes.tolist():
            if other != node:
                over, under = over * (at - other), under * (node - other)
        weights[one] = over / under
    return weights


def _graph(
    levels: list[Index],
    neighbours: Index,
    counts: Index,
    weights: Float,
    ring: Index,
    ring_starts: Index,
) -> SignalGraph:
    order = np.concatenate(levels)
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    # Frozen as those of stencils are: one type to numba.
    starts, ring = renumbered(read_only(ring_starts), read_only(ring), order, read_only(place))
    counts = counts[order]
    known = np.arange(neighbours.shape[1]) < counts[:, None]
    neighbours = np.where(known, place[neighbours[order]], 0)
    return SignalGraph(order, neighbours, counts, weights[order], ring, starts)
