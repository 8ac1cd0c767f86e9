"""Code polygons without loss: the order of vertices and faces, and first corners, are kept.

Users number vertices and faces, so they cannot be renumbered as Edgebreaker does. Corners are coded in their order, and
predicted from the mesh so far, from the polygons before, and from the numbers of their neighbours (in the spirit of the
index codec of *meshoptimizer*). Probabilities of the predictions are learned bit by bit
(`mixseq.compression.bitstream.arithmetic`). Meshes in coherent order take 2 to 10 bits per triangle; random order takes
about half a logarithm of V! F!.

*The bits.* For every polygon, its number of corners minus that of the polygon before (3 for the first), then its
corners, as specified in `mixseq.compression.bitstream.connectivity_kernels`. Then the check of both.

*The growing order* of polygons, in which texture coordinates are coded, is breadth first, those with the fewest unknown
nodes first, so that values at a node are predicted from complete polygons around it.

*The walk* over the mesh from edge to edge is an order in which connectivity takes few bits. From every polygon it
crosses its edges, first the one after the edge by which it entered, and so turns around the vertex between both; it
returns later to polygons not entered at once, the newest first. This is the order of Edgebreaker (Rossignac 1999,
*Edgebreaker: connectivity compression for triangle meshes*). A polygon that begins where it was entered is predicted by
the first guesses of a corner. Start and direction of the walk depend on vertex numbers and on the set of polygons,
neither on their order nor on their first corners.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``,
``tests/compression/golden/uvs.npz``); files with vertices numbered by the walk are compared with their originals by
walking over these again (golden: the digest in ``tests/compression/bitstream/test_polygon_walk.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    bits_to_read,
    bits_to_write,
    check_of,
    with_check,
    without_check,
    written,
)
from mixseq.compression.bitstream.connectivity_kernels import GUESSES, KINDS, no_half_edges, no_past, walk
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.polygons import Polygons, canonical_order
from mixseq.runtime.jit import compiled
from mixseq.types import Index

_BUCKETS = 4
"""Number of queues, by unknown nodes per polygon; the last takes all larger counts. Frozen: breaks old files."""


class Corners(NamedTuple):
    """Corners of polygons on nodes: vertices, or texture coordinates."""

    starts: Index  # (P + 1,) the first corner of every polygon, and the number C of corners
    polygon: Index  # (C,) the polygon of every corner
    node: Index  # (C,) the node of every corner
    # (C,) a half-edge runs from a corner to the next one of its polygon. The corner from which one runs the other way,
    # -1 if there is none. Of several between the same nodes, the first is the twin of the first, and so on.
    twin: Index
    around_starts: Index  # (N + 1,) row offsets of around
    around: Index  # (C,) the corners at node n, ascending: around[around_starts[n] : around_starts[n + 1]]


def corners_of(polygons: Polygons, node_count: int) -> Corners:
    """Return the corners of polygons on nodes."""
    counts, node = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)])
    following = np.arange(1, len(node) + 1)
    following[starts[1:] - 1] = starts[:-1]
    return Corners(
        starts=starts,
        polygon=np.repeat(np.arange(len(counts)), counts),
        node=node,
        twin=_twins(node, node[following], node_count),
        around_starts=np.concatenate([[0], np.cumsum(np.bincount(node, minlength=node_count))]),
        around=np.argsort(node, kind="stable"),
    )


def _twins(tails: Index, heads: Index, node_count: int) -> Index:
    """Return the twins of half-edges from `tails` to `heads`."""
    forth, back = tails * node_count + heads, heads * node_count + tails
    order, others = np.argsort(forth, kind="stable"), np.argsort(back, kind="stable")
    there, wanted = forth[order], back[others]
    first = np.searchsorted(there, wanted)
    place = first + np.arange(len(wanted)) - np.searchsorted(wanted, wanted)
    found = (place < np.searchsorted(there, wanted, side="right")) & (tails != heads)[others]
    twins = np.full(len(tails), -1, dtype=np.int64)
    twins[others[found]] = order[place[found]]
    return twins


@compiled
def after(corners: Corners, corner: int) -> int:
    """Return the next corner of the polygon."""
    starts, polygon = corners.starts, corners.polygon[corner]
    following: int = corner + 1 if corner + 1 < starts[polygon + 1] else starts[polygon]
    return following


@compiled
def before(corners: Corners, corner: int) -> int:
    """Return the previous corner of the polygon."""
    starts, polygon = corners.starts, corners.polygon[corner]
    previous: int = corner - 1 if corner > starts[polygon] else starts[polygon + 1] - 1
    return previous


@compiled
def growing_order(corners: Corners) -> Index:
    """Return the polygons ``(P,)`` in the order in which they are visited.

    Unvisited polygons of each newly known node queue up, ascending, by their corners with unknown nodes: 0, 1, 2, more.
    Next is the first of the first queue whose count still holds; with none, the lowest unvisited polygon.
    """
    starts, node = corners.starts, corners.node
    count = len(starts) - 1
    unknown = starts[1:] - starts[:-1]
    known = np.zeros(len(corners.around_starts) - 1, dtype=np.bool_)
    visited = np.zeros(count, dtype=np.bool_)
    heads, tails = np.full(_BUCKETS, -1, dtype=np.int64), np.full(_BUCKETS, -1, dtype=np.int64)
    queued, following = np.empty(len(node), dtype=np.int64), np.full(len(node), -1, dtype=np.int64)
    order = np.empty(count, dtype=np.int64)
    lowest = entries = 0
    for place in range(count):
        chosen = -1
        for bucket in range(_BUCKETS):
            while chosen < 0 and heads[bucket] >= 0:
                polygon = queued[heads[bucket]]
                heads[bucket] = following[heads[bucket]]
                if not visited[polygon] and min(unknown[polygon], _BUCKETS - 1) == bucket:
                    chosen = polygon
        if chosen < 0:
            while visited[lowest]:
                lowest += 1
            chosen = lowest
        visited[chosen] = True
        order[place] = chosen
        for corner in range(starts[chosen], starts[chosen + 1]):
            at = node[corner]
            if known[at]:
                continue
            known[at] = True
            for other in range(corners.around_starts[at], corners.around_starts[at + 1]):
                polygon = corners.polygon[corners.around[other]]
                if visited[polygon]:
                    continue
                unknown[polygon] -= 1
                bucket = min(unknown[polygon], _BUCKETS - 1)
                queued[entries] = polygon
                if heads[bucket] < 0:
                    heads[bucket] = entries
                else:
                    following[tails[bucket]] = entries
                tails[bucket] = entries
                entries += 1
    return order


def walk_polygons(polygons: Polygons, vertex_count: int) -> tuple[Index, Index]:
    """Return the polygons ``(P,)`` in walk order, and their entry corners ``(P,)``; components by lowest vertex."""
    canonical = canonical_order(polygons)
    listed = Polygons(polygons.counts[canonical.polygons], polygons.indices[canonical.corners])
    corners = corners_of(listed, vertex_count)
    entered = _walk(corners)
    return canonical.polygons[corners.polygon[entered]], canonical.corners[entered]


@compiled
def _walk(corners: Corners) -> Index:
    """Return the corners at which polygons are entered, in the order of the walk."""
    count = len(corners.starts) - 1
    seen = np.zeros(count, dtype=np.bool_)
    entered = np.empty(count, dtype=np.int64)
    waiting = np.empty(
        len(corners.node) + 1, dtype=np.int64
    )  # where polygons may be entered, the newest last
    place = 0
    for seed in corners.around:
        waiting[0] = seed
        ready = 1
        while ready:
            ready -= 1
            corner = waiting[ready]
            polygon = corners.polygon[corner]
            if seen[polygon]:
                continue
            seen[polygon] = True
            entered[place] = corner
            place += 1
            edge = corner
            for _ in range(corners.starts[polygon + 1] - corners.starts[polygon]):
                edge = before(corners, edge)
                twin = corners.twin[edge]
                if twin >= 0 and not seen[corners.polygon[twin]]:
                    waiting[ready] = twin
                    ready += 1
    return entered


def encode_polygons(polygons: Polygons, vertex_count: int) -> bytes:
    """Code polygons for `decode_polygons`."""
    if not len(polygons.counts):
        return b""
    lowest, highest = int(polygons.indices.min()), int(polygons.indices.max())
    if lowest < 0 or highest >= vertex_count:
        raise InvalidSequenceError(
            f"corners have vertices {lowest} to {highest}; with {vertex_count} vertices, 0 to {vertex_count - 1} exist"
        )
    counts, indices = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    # Bits at most: guesses, and numbers for counts, states (up to 1) and distances.
    count, state, distance = (2 + 2 * most.bit_length() for most in (len(indices), 1, vertex_count))
    room = len(counts) * count + len(indices) * (GUESSES + state + distance)
    bits = bits_to_write(room, KINDS)
    walk(bits, no_half_edges(len(indices), vertex_count), no_past(vertex_count), counts, indices)
    return with_check(written(bits.coded), check_of(indices, check_of(counts)))


def decode_polygons(data: bytes, polygon_count: int, corner_count: int, vertex_count: int) -> Polygons:
    """Decode the polygons written by `encode_polygons`."""
    mesh = f"{polygon_count} polygons with {corner_count} corners and {vertex_count} vertices"
    if (
        polygon_count < 0
        or not 0 <= vertex_count < 1 << 31
        or not 3 * polygon_count <= corner_count < 1 << 31
    ):
        raise FormatError(f"a mesh cannot have {mesh}; the file is damaged")
    if not polygon_count or not vertex_count:
        if data or corner_count:
            raise FormatError(f"a mesh with {mesh} has no coded corners; the file is damaged")
        return Polygons(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    stream, expected = without_check(data)
    bits = bits_to_read(stream, KINDS)
    counts, indices = np.zeros(polygon_count, dtype=np.int64), np.zeros(corner_count, dtype=np.int64)
    walk(bits, no_half_edges(corner_count, vertex_count), no_past(vertex_count), counts, indices)
    if bits.failed[0] or check_of(indices, check_of(counts)) != expected:
        raise FormatError(f"coded polygons are damaged, or those of another mesh than one of {mesh}")
    return Polygons(counts, indices)
