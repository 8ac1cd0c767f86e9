"""Compute the coding order of a signal over a mesh, or over time, and the neighbours that predict each value.

A signal has a value at every node of a graph: vertices joined by the edges of a mesh, or consecutive frames. Nodes are
removed in levels. A level is an independent set of nodes with few neighbours; each of them is collapsed onto a
neighbour, which gives the graph of the next level. Coding runs from coarse to fine levels, so nearly all values are
interpolated *between* known values. Interpolation averages rounding errors, whereas extrapolation (such as the
parallelogram rule) enlarges them. The levels depend on connectivity only, so they are not stored.

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
from mixseq.types import Float, Index, Int32, Mask

MAX_NEIGHBOURS = 12  # largest number of neighbours that predict a node; frozen
NEIGHBOUR_COUNTS = MAX_NEIGHBOURS + 1  # number of possible neighbour counts of a node: 0 to `MAX_NEIGHBOURS`; frozen
MAX_REMOVED_DEGREE = 6  # largest number of neighbours of a removed node, unless all nodes have more; frozen
MAX_ROOT_NEIGHBOURS = 6  # number of earlier roots that predict a node without neighbours; frozen
_HUB_DEGREE_RATIO = 32  # degree ratio, neighbour to removed node, from which bisection finds shared ones; free: time


@compiled
def update_adjacency(starts: Index, adjacent: Int32, remaining_mask: Mask, new_edges: Int32) -> tuple[Index, Int32]:
    """Return the adjacency of the remaining nodes ``(N,)`` of a graph, with new edges ``(E, 2)``.

    The neighbours of a node are ``adjacent[starts[node] : starts[node + 1]]``, ascending and unique, with starts
    ``(N + 1,)``. New edges join remaining nodes; they may repeat, exist already, or join a node to itself.
    """
    count = len(remaining_mask)
    rows = np.zeros(count + 1, dtype=np.int64)
    for node in range(count):
        if remaining_mask[node]:
            for place in range(starts[node], starts[node + 1]):
                rows[node + 1] += remaining_mask[adjacent[place]]
    for edge in range(len(new_edges)):
        if new_edges[edge, 0] != new_edges[edge, 1]:
            rows[new_edges[edge, 0] + 1] += 1
            rows[new_edges[edge, 1] + 1] += 1
    for node in range(count):
        rows[node + 1] += rows[node]
    unsorted = np.empty(rows[count], dtype=np.int32)
    ends = rows[:-1].copy()
    for node in range(count):
        if remaining_mask[node]:
            for place in range(starts[node], starts[node + 1]):
                if remaining_mask[adjacent[place]]:
                    unsorted[ends[node]] = adjacent[place]
                    ends[node] += 1
    for edge in range(len(new_edges)):
        tail, head = new_edges[edge]
        if tail != head:
            unsorted[ends[tail]], unsorted[ends[head]] = head, tail
            ends[tail] += 1
            ends[head] += 1
    # Nodes are added to the rows of their neighbours in ascending order, so rows are ascending.
    ascending = np.empty(len(unsorted), dtype=np.int32)
    ends[:] = rows[:-1]
    for node in range(count):
        for place in range(rows[node], rows[node + 1]):
            other = unsorted[place]
            if ends[other] == rows[other] or ascending[ends[other] - 1] != node:
                ascending[ends[other]] = node
                ends[other] += 1
    new_starts = np.zeros(count + 1, dtype=np.int64)
    for node in range(count):
        new_starts[node + 1] = new_starts[node] + ends[node] - rows[node]
    new_adjacent = np.empty(new_starts[count], dtype=np.int32)
    for node in range(count):
        for i in range(new_starts[node + 1] - new_starts[node]):
            new_adjacent[new_starts[node] + i] = ascending[rows[node] + i]
    return new_starts, new_adjacent


@compiled
def renumber_adjacency(starts: Index, adjacent: Int32, order: Index, inverse: Index) -> tuple[Index, Int32]:
    """Return the adjacency of nodes renumbered by `order` ``(N,)``: node i becomes ``inverse[i]``."""
    new_starts = np.empty(len(order) + 1, dtype=np.int64)
    new_adjacent = np.empty(len(adjacent), dtype=np.int32)
    count = 0
    for new, node in enumerate(order):
        new_starts[new] = count
        for place in range(starts[node], starts[node + 1]):
            new_adjacent[count] = inverse[adjacent[place]]
            count += 1
    new_starts[len(order)] = count
    return new_starts, new_adjacent


@compiled
def find_independent_nodes(nodes: Index, starts: Index, adjacent: Int32, min_degree: int, max_degree: int) -> Index:
    """Return nodes with at most `max_degree` neighbours, of which no two are adjacent, by increasing degree.

    `nodes` ``(n,)`` int64 have `min_degree` or more neighbours; nodes of equal degree keep their order.
    """
    blocked_mask = np.zeros(len(starts) - 1, dtype=np.bool_)
    independent = np.empty(len(nodes), dtype=np.int64)
    count = 0
    for degree in range(min_degree, max_degree + 1):
        for node in nodes:
            if blocked_mask[node] or starts[node + 1] - starts[node] != degree:
                continue
            independent[count] = node
            count += 1
            for place in range(starts[node], starts[node + 1]):
                blocked_mask[adjacent[place]] = True
    return independent[:count].copy()


@compiled
def collapse_nodes(removed: Index, starts: Index, adjacent: Int32, neighbours: Int32, counts: Int32) -> Int32:
    """Write neighbours ``(N, n)`` and counts ``(N,)`` of removed nodes; return edges ``(E, 2)`` that close the holes.

    A node is collapsed onto the neighbour that is adjacent to most of its neighbours; ties go to the lowest degree.
    """
    size = 0
    for node in removed:
        size += starts[node + 1] - starts[node]
    edges = np.empty((size, 2), dtype=np.int32)
    mark = np.full(len(starts) - 1, -1, dtype=np.int32)
    count = 0
    for node in removed:
        first, last = starts[node], starts[node + 1]
        counts[node] = min(last - first, neighbours.shape[1])
        for i in range(counts[node]):
            neighbours[node, i] = adjacent[first + i]
        for place in range(first, last):
            mark[adjacent[place]] = node
        best, best_shared, best_degree = adjacent[first], -1, 0
        for place in range(first, last):
            other = adjacent[place]
            shared = 0
            degree = starts[other + 1] - starts[other]
            if degree > _HUB_DEGREE_RATIO * (last - first):
                for wanted in adjacent[first:last]:
                    # Binary search; np.searchsorted would import SciPy when the compiled loop is loaded.
                    low, high = starts[other], starts[other + 1]
                    while low < high:
                        middle = (low + high) // 2
                        if adjacent[middle] < wanted:
                            low = middle + 1
                        else:
                            high = middle
                    if low < starts[other + 1] and adjacent[low] == wanted:
                        shared += 1
            else:
                for neighbour in adjacent[starts[other] : starts[other + 1]]:
                    if mark[neighbour] == node:
                        shared += 1
            if shared > best_shared or (shared == best_shared and degree < best_degree):
                best, best_shared, best_degree = other, shared, degree
        for other in adjacent[first:last]:
            if other != best:
                edges[count, 0] = best
                edges[count, 1] = other
                count += 1
    return edges[:count].copy()


@dataclass(frozen=True, eq=False)
class SignalGraph:
    """Nodes in coding order, and the earlier nodes that predict each node; node numbers refer to this order."""

    order: Index  # (N,) vertex, or frame, of every node, coarse to fine
    neighbours: Int32  # (N, n) earlier nodes that predict every node
    counts: Int32  # (N,) number of neighbours of every node
    ring: Int32  # (R,) all nodes adjacent to every node, earlier and later, row by row
    ring_starts: Index  # (N + 1,) row offsets of ring: ring[ring_starts[i] : ring_starts[i + 1]] of node i
    time_weights: Float | None = None  # (N, n) initial weights of the neighbours of frames; rows add up to one

    def __post_init__(self) -> None:
        for name in ("order", "neighbours", "counts", "ring", "ring_starts"):
            # numba would compile again for writable arrays, which have another type.
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def size(self) -> int:
        """Number N of nodes."""
        return len(self.order)

    @property
    def is_over_time(self) -> bool:
        """Whether nodes are frames, not vertices."""
        return self.time_weights is not None

    @property
    def weights(self) -> Float:
        """Initial weights ``(N, n)`` of the neighbours; those of a vertex have the same weight."""
        if self.time_weights is not None:
            return self.time_weights
        is_neighbour = np.arange(self.neighbours.shape[1]) < self.counts[:, None]
        return read_only(is_neighbour / np.maximum(self.counts, 1)[:, None])

    def with_extra_neighbours(self, nodes: Int32, sizes: Int32) -> tuple[Int32, Int32, Float]:
        """Return neighbours, counts and weights with extra neighbours ``(N, k)`` of weight zero: ``sizes[i]`` of i."""
        neighbours = np.concatenate([self.neighbours, np.zeros_like(nodes)], axis=1)
        for i in range(nodes.shape[1]):
            node_ids = np.flatnonzero(sizes > i)
            neighbours[node_ids, self.counts[node_ids] + i] = nodes[node_ids, i]
        weights = np.zeros(neighbours.shape)
        weights[:, : self.neighbours.shape[1]] = self.weights
        return neighbours, self.counts + sizes, weights


def mesh_graph(faces: NDArray[np.integer], vertex_count: int) -> SignalGraph:
    """Return the graph of the vertices and edges of a mesh with faces ``(F, 3)``."""
    return ring_graph(*mesh_neighbours(faces, vertex_count))


def ring_graph(ring_starts: Index, ring: Int32) -> SignalGraph:
    """Return the graph of an adjacency in the format of `update_adjacency`."""
    vertex_count = len(ring_starts) - 1
    neighbours, counts = new_neighbours(vertex_count)
    levels = [level.removed for level in coarser_levels(ring_starts, ring, neighbours, counts)]
    root_mask = np.ones(vertex_count, dtype=bool)
    for removed in levels:
        root_mask[removed] = False
    roots = np.flatnonzero(root_mask)
    for number, root in enumerate(roots):
        earlier = roots[max(0, number - MAX_ROOT_NEIGHBOURS) : number]
        neighbours[root, : len(earlier)] = earlier
        counts[root] = len(earlier)
    # Roots come first, as coarser levels are coded before finer ones.
    return _order_graph([roots, *levels[::-1]], neighbours, counts, ring, ring_starts)


def new_neighbours(node_count: int) -> tuple[Int32, Int32]:
    """Return zeros for the neighbours ``(N, MAX_NEIGHBOURS)`` and counts ``(N,)`` that `coarser_levels` writes."""
    return np.zeros((node_count, MAX_NEIGHBOURS), dtype=np.int32), np.zeros(node_count, dtype=np.int32)


class Level(NamedTuple):
    """Nodes removed together, and the graphs of N nodes before and after; after removal, nodes have no edges."""

    removed: Index  # (n,) removed nodes
    starts: Index  # (N + 1,) row offsets of the graph before, see update_adjacency
    adjacent: Int32  # (2 E,) neighbours in the graph before, row by row
    new_edges: Int32  # (n', 2) edges that close the holes; some are repeated, or exist already
    new_starts: Index  # (N + 1,) row offsets of the graph after
    new_adjacent: Int32  # (2 E',) neighbours in the graph after, row by row


def mesh_neighbours(faces: NDArray[np.integer], vertex_count: int) -> tuple[Index, Int32]:
    """Return the adjacency of the vertices of triangles ``(F, 3)``, in the format of `update_adjacency`."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)
    return edge_neighbours(edges.reshape(-1, 2).astype(np.int32, copy=False), vertex_count)


def edge_neighbours(edges: Int32, count: int) -> tuple[Index, Int32]:
    """Return the adjacency of `count` nodes with edges ``(E, 2)``, in the format of `update_adjacency`."""
    empty = np.zeros(count + 1, dtype=np.int64), np.zeros(0, dtype=np.int32)
    return update_adjacency(*empty, np.ones(count, dtype=bool), edges)


def coarser_levels(starts: Index, adjacent: Int32, neighbours: Int32, counts: Int32) -> Iterator[Level]:
    """Remove nodes of a graph until no edge remains, and yield the levels, fine to coarse.

    `starts` ``(N + 1,)`` and `adjacent` ``(2 E,)`` have the format of `update_adjacency`. Rows of removed nodes are
    written to `neighbours` ``(N, MAX_NEIGHBOURS)`` and `counts` ``(N,)``.
    """
    remaining_mask = np.ones(len(counts), dtype=bool)
    while len(adjacent):
        degrees = np.diff(starts)
        nodes = np.flatnonzero(degrees)
        fewest = int(degrees[nodes].min())
        removed = find_independent_nodes(nodes, starts, adjacent, fewest, max(MAX_REMOVED_DEGREE, fewest))
        new_edges = collapse_nodes(removed, starts, adjacent, neighbours, counts)
        remaining_mask[removed] = False
        graph = starts, adjacent
        starts, adjacent = update_adjacency(*graph, remaining_mask, new_edges)
        yield Level(removed, *graph, new_edges, starts, adjacent)


@lru_cache(maxsize=64)
def path_graph(count: int) -> SignalGraph:
    """Return the graph of consecutive frames, coded in levels with half the step each: first and last frame first.

    A frame is predicted from up to two known frames before it and two after it, and from the nearest other known
    frames. Initial weights come from the polynomial through the former (Lagrange); the latter have weight zero.
    """
    neighbours = np.zeros((count, 6), dtype=np.int32)
    counts = np.zeros(count, dtype=np.int32)
    weights = np.zeros((count, 6))
    known = np.unique([0, count - 1])
    levels = [known]
    if count > 1:
        counts[count - 1], weights[count - 1, 0] = 1, 1.0
    step = 1 << max(count - 1, 1).bit_length()
    while step > 1:
        step //= 2
        new = np.setdiff1d(np.arange(step, count - 1, 2 * step), known)
        if not len(new):
            continue
        places = np.searchsorted(known, new)
        around, around_mask = _take(known, places[:, None] + np.arange(-2, 2))
        others, others_mask = _take(known, places[:, None] + np.r_[-8:-2, 2:8])
        same_level, same_mask = _take(new, np.arange(len(new))[:, None] + np.arange(-6, 0))
        others, others_mask = np.hstack([others, same_level]), np.hstack([others_mask, same_mask])
        distances = np.where(others_mask, np.abs(others - new[:, None]), count)
        nearest = np.lexsort([others, distances])
        all_nodes = np.hstack([around, np.take_along_axis(others, nearest, 1)])
        all_mask = np.hstack([around_mask, np.take_along_axis(others_mask, nearest, 1)])
        all_weights = np.zeros(all_nodes.shape)
        all_weights[:, :4] = _lagrange_weights(around, around_mask, new)
        kept = np.argsort(~all_mask, axis=1, kind="stable")[:, :6]
        counts[new] = np.minimum(all_mask.sum(axis=1), 6)
        neighbours[new] = np.where(np.arange(6) < counts[new, None], np.take_along_axis(all_nodes, kept, 1), 0)
        weights[new] = np.take_along_axis(all_weights, kept, 1)
        known = np.union1d(known, new)
        levels.append(new)
    frames = np.arange(count, dtype=np.int32)
    pairs = np.stack([frames[:-1], frames[1:]], axis=1)
    ring_starts, ring = edge_neighbours(pairs, count)
    graph = _order_graph(levels, neighbours, counts, ring, ring_starts)
    return replace(graph, time_weights=read_only(weights[graph.order]))


def _take(nodes: Index, ids: Index) -> tuple[Index, Mask]:
    """Return the nodes at `ids` ``(n, k)``, and the mask of ids that exist."""
    mask = (ids >= 0) & (ids < len(nodes))
    return nodes[np.where(mask, ids, 0)], mask


def _lagrange_weights(nodes: Index, mask: Mask, at: Index) -> Float:
    """Return the weights ``(n, k)`` of nodes in the interpolating polynomials: quotients of exact integers."""
    weights = np.zeros(nodes.shape)
    for i in range(nodes.shape[1]):
        other_mask = mask & (np.arange(nodes.shape[1]) != i)
        numerators = np.where(other_mask, at[:, None] - nodes, 1).prod(axis=1)
        denominators = np.where(other_mask, nodes[:, [i]] - nodes, 1).prod(axis=1)
        weights[:, i] = np.where(mask[:, i], numerators / np.where(mask[:, i], denominators, 1), 0.0)
    return weights


def _order_graph(levels: list[Index], neighbours: Int32, counts: Int32, ring: Int32, ring_starts: Index) -> SignalGraph:
    """Return a graph with nodes in coding order, from arrays with the numbers of vertices or frames."""
    order = np.concatenate(levels)
    inverse = np.argsort(order)
    # Read-only like the arrays of stencils, so that numba compiles only once.
    starts, ring = renumber_adjacency(read_only(ring_starts), read_only(ring), order, read_only(inverse))
    # In place, as neighbours are the largest array.
    np.take(inverse.astype(np.int32), neighbours, out=neighbours, mode="clip")
    neighbours[np.arange(neighbours.shape[1]) >= counts[:, None]] = 0
    return SignalGraph(order, neighbours[order], counts[order], ring, starts)
