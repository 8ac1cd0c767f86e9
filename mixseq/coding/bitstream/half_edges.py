"""Half-edges of a mesh that grows polygon by polygon, and vertex states: unused, open, or closed.

A half-edge runs from a corner's vertex to the next corner's. It is *open* until a half-edge runs the other way. A
vertex is *unused* until a polygon has it, then *open* while open half-edges end or start there, else *closed*; it may
open again. Vertices of a state have ranks, in the order of their numbers, by a tree of partial sums (Fenwick 1994,
*A new data structure for cumulative frequency tables*).

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.compiled import compiled, joined

Small = NDArray[np.int32]

UNUSED, OPEN, CLOSED = 0, 1, 2
"""States of vertices. Frozen: breaks old files."""

INTO, OUT_OF = 0, 1
"""Half-edges that end, or start, at a vertex. Free: rows of tables."""

_LOOKED_AT = 32
"""Open half-edges at a vertex, after the first, searched for the opposite one. Frozen: breaks old files."""


class HalfEdges(NamedTuple):
    """The mesh so far. A half-edge has the number of its first corner."""

    tails: Small  # (C,) start vertex of every half-edge that was opened
    heads: Small  # (C,) end vertex of every half-edge that was opened
    # (2, V) the newest open half-edge into (0) and out of (1) every vertex, -1 if there is none.
    newest: Small
    older: Small  # (2, C) next older open half-edge into the head (0) and out of the tail (1), -1 for none
    newer: Small  # (2, C) next newer open half-edge into the head (0) and out of the tail (1), -1 for none
    open_edges: Small  # (V,) number of open half-edges that end or start at a vertex
    degrees: Small  # (V,) number of corners at a vertex
    states: NDArray[np.uint8]  # (V,) UNUSED, OPEN, or CLOSED
    members: Index  # (3,) number of vertices in every state
    trees: Small  # (3, V + 1) partial sums over the vertices of every state
    # (2, V + 2) for vertex v at v + 1, the next unused vertex below (0) and above (1), also at v + 1; of used vertices,
    # as it was when they came into use. The ends are no vertices.
    unused: Small


def no_half_edges(corner_count: int, vertex_count: int) -> HalfEdges:
    """Return a mesh of unused vertices."""
    trees = np.zeros((3, vertex_count + 1), dtype=np.int32)
    numbers = np.arange(vertex_count + 1, dtype=np.int32)
    trees[UNUSED] = numbers & -numbers
    return HalfEdges(
        tails=np.zeros(corner_count, dtype=np.int32),
        heads=np.zeros(corner_count, dtype=np.int32),
        newest=np.full((2, vertex_count), -1, dtype=np.int32),
        older=np.full((2, corner_count), -1, dtype=np.int32),
        newer=np.full((2, corner_count), -1, dtype=np.int32),
        open_edges=np.zeros(vertex_count, dtype=np.int32),
        degrees=np.zeros(vertex_count, dtype=np.int32),
        states=np.zeros(vertex_count, dtype=np.uint8),
        members=np.array([vertex_count, 0, 0], dtype=np.int64),
        trees=trees,
        unused=np.stack([np.arange(-1, vertex_count + 1), np.arange(1, vertex_count + 3)]).astype(np.int32),
    )


@compiled
def rank_of(mesh: HalfEdges, state: int, vertex: int) -> int:
    """Return the number of vertices of a state before a vertex, from 0 to V."""
    rank = 0
    while vertex > 0:
        rank += mesh.trees[state, vertex]
        vertex &= vertex - 1
    return rank


@compiled
def vertex_of(mesh: HalfEdges, state: int, rank: int) -> int:
    """Return the vertex of a state and rank, which must be below the number of vertices of that state."""
    count = mesh.trees.shape[1]
    step = 1
    while 2 * step < count:
        step *= 2
    vertex = 0
    while step:
        if vertex + step < count and mesh.trees[state, vertex + step] <= rank:
            vertex += step
            rank -= mesh.trees[state, vertex]
        step >>= 1
    return vertex


@compiled
def move(mesh: HalfEdges, vertex: int, state: int) -> None:
    """Set the state of a vertex."""
    old = mesh.states[vertex]
    if old == state:
        return
    mesh.states[vertex] = state
    mesh.members[old] -= 1
    mesh.members[state] += 1
    if old == UNUSED:
        below, above = mesh.unused[0, vertex + 1], mesh.unused[1, vertex + 1]
        mesh.unused[1, below] = above
        mesh.unused[0, above] = below
    at = vertex + 1
    while at < mesh.trees.shape[1]:
        mesh.trees[old, at] -= 1
        mesh.trees[state, at] += 1
        at += at & -at


@compiled
def add_polygon(mesh: HalfEdges, indices: Index, start: int, stop: int) -> None:
    """Add the polygon with the corners from `start` to below `stop`."""
    for corner in range(start, stop):
        _add(mesh, corner, indices[corner], indices[corner + 1 if corner + 1 < stop else start])
    for corner in range(start, stop):
        vertex = indices[corner]
        mesh.degrees[vertex] += 1
        move(mesh, vertex, OPEN if mesh.open_edges[vertex] else CLOSED)


@joined
def _add(mesh: HalfEdges, edge: int, tail: int, head: int) -> None:
    """Close the opposite half-edge, or open this one."""
    other = mesh.newest[INTO, tail]
    for _ in range(_LOOKED_AT):
        if other < 0 or mesh.tails[other] == head:
            break
        other = mesh.older[INTO, other]
    change = 1
    if other >= 0 and mesh.tails[other] == head:
        _unlink(mesh, INTO, tail, other)
        _unlink(mesh, OUT_OF, head, other)
        change = -1
    else:
        mesh.tails[edge] = tail
        mesh.heads[edge] = head
        _link(mesh, INTO, head, edge)
        _link(mesh, OUT_OF, tail, edge)
    mesh.open_edges[tail] += change
    mesh.open_edges[head] += change


@joined
def _link(mesh: HalfEdges, way: int, vertex: int, edge: int) -> None:
    newest = mesh.newest[way, vertex]
    mesh.older[way, edge] = newest
    if newest >= 0:
        mesh.newer[way, newest] = edge
    mesh.newest[way, vertex] = edge


@joined
def _unlink(mesh: HalfEdges, way: int, vertex: int, edge: int) -> None:
    older, newer = mesh.older[way, edge], mesh.newer[way, edge]
    if older >= 0:
        mesh.newer[way, older] = newer
    if newer >= 0:
        mesh.older[way, newer] = older
    else:
        mesh.newest[way, vertex] = older
