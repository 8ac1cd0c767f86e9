"""Code polygons without loss: the order of vertices and faces, and first corners, are kept.

Users refer to vertices and faces by number, so the mesh cannot be renumbered as Edgebreaker does. Corners are coded in
the given order. They are predicted from the known mesh, from the last polygons, and from the numbers of their
neighbours (in the spirit of the index codec of *meshoptimizer*). Probabilities of the predictions are learned bit by
bit (`mixseq.compression.bitstream.arithmetic`). Meshes in coherent order take 2 to 10 bits per triangle; random order
takes about half a logarithm of V! F!.

*The bits.* For every polygon, its number of corners minus the number of the polygon before (3 for the first) is coded,
then its corners (see `mixseq.compression.bitstream.connectivity_kernels`). The checksum of counts and corners follows.

*The growing order* of polygons, in which texture coordinates are coded, is breadth first. Polygons with the fewest
unknown nodes come first, so that values at a node are predicted from complete polygons around it.

*The walk* over the mesh from edge to edge is an order in which connectivity takes few bits. In every polygon, the walk
first crosses the edge after the entry edge, and so turns around the vertex between both edges. It returns later to
polygons across other edges, the newest first. This is the order of Edgebreaker (Rossignac 1999, *Edgebreaker:
connectivity compression for triangle meshes*). A polygon whose first corner is its entry corner is predicted by the
first guesses. Start and direction of the walk depend on vertex numbers and on the set of polygons, but not on the order
or the first corners of polygons.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``,
``tests/compression/golden/uvs.npz``); files with vertices numbered by the walk are compared with their originals by
walking over the originals again (golden: the digest in ``tests/compression/bitstream/test_polygon_walk.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    HashedBits,
    append_checksum,
    checksum_of,
    finish_stream,
    new_hashed_bits,
    new_hashed_output,
    new_input_stream,
    split_checksum,
)
from mixseq.compression.bitstream.connectivity_kernels import (
    BIT_KINDS,
    GUESS_COUNT,
    code_polygons,
    new_half_edges,
    new_history,
)
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.polygons import Polygons, canonical_order
from mixseq.runtime.jit import compiled
from mixseq.types import Index

_QUEUE_COUNT = 4
"""Number of queues by unknown nodes per polygon; the last queue takes all larger counts. Frozen: breaks old files."""


class Corners(NamedTuple):
    """Corners of polygons on nodes, which are vertices or pairs of texture coordinates."""

    starts: Index  # (P + 1,) the first corner of every polygon, and the number C of corners
    polygon: Index  # (C,) the polygon of every corner
    node: Index  # (C,) the node of every corner
    # (C,) corner at the start of the opposite half-edge, -1 if there is none. A half-edge runs from a corner to the
    # next. Of several half-edges between two nodes, the first pair are twins, then the second pair, and so on.
    twin: Index
    around_starts: Index  # (N + 1,) row offsets of around
    around: Index  # (C,) the corners at node n, ascending: around[around_starts[n] : around_starts[n + 1]]


def corners_on_nodes(polygons: Polygons, node_count: int) -> Corners:
    """Return the corners of polygons whose indices are nodes."""
    counts, node = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)])
    following = np.arange(1, len(node) + 1)
    following[starts[1:] - 1] = starts[:-1]
    return Corners(
        starts=starts,
        polygon=np.repeat(np.arange(len(counts)), counts),
        node=node,
        twin=_find_twins(node, node[following], node_count),
        around_starts=np.concatenate([[0], np.cumsum(np.bincount(node, minlength=node_count))]),
        around=np.argsort(node, kind="stable"),
    )


def _find_twins(tails: Index, heads: Index, node_count: int) -> Index:
    """Return the twins ``(C,)`` of half-edges from `tails` to `heads` ``(C,)``."""
    keys, twin_keys = tails * node_count + heads, heads * node_count + tails
    order, edges = np.argsort(keys, kind="stable"), np.argsort(twin_keys, kind="stable")
    keys, twin_keys = keys[order], twin_keys[edges]
    first, end = np.searchsorted(keys, twin_keys), np.searchsorted(keys, twin_keys, side="right")
    places = first + np.arange(len(twin_keys)) - np.searchsorted(twin_keys, twin_keys)
    found_mask = (places < end) & (tails != heads)[edges]
    twins = np.full(len(tails), -1, dtype=np.int64)
    twins[edges[found_mask]] = order[places[found_mask]]
    return twins


@compiled
def next_corner(corners: Corners, corner: int) -> int:
    """Return the next corner of the polygon."""
    starts, polygon = corners.starts, corners.polygon[corner]
    following: int = corner + 1 if corner + 1 < starts[polygon + 1] else starts[polygon]
    return following


@compiled
def previous_corner(corners: Corners, corner: int) -> int:
    """Return the previous corner of the polygon."""
    starts, polygon = corners.starts, corners.polygon[corner]
    previous: int = corner - 1 if corner > starts[polygon] else starts[polygon + 1] - 1
    return previous


@compiled
def growing_order(corners: Corners) -> Index:
    """Return the polygons ``(P,)`` in the order in which they are visited.

    When a node becomes known, its unvisited polygons are queued, ascending, by count of unknown corners: 0, 1, 2, more.
    Next is the first polygon of the first queue whose count is still valid, or else the lowest unvisited polygon.
    """
    starts, node = corners.starts, corners.node
    polygon_count = len(starts) - 1
    unknown_counts = starts[1:] - starts[:-1]
    known_mask = np.zeros(len(corners.around_starts) - 1, dtype=np.bool_)
    visited_mask = np.zeros(polygon_count, dtype=np.bool_)
    heads, tails = np.full(_QUEUE_COUNT, -1, dtype=np.int64), np.full(_QUEUE_COUNT, -1, dtype=np.int64)
    # Queues are linked lists of entries, which have a polygon and the following entry.
    queued, following = np.empty(len(node), dtype=np.int64), np.full(len(node), -1, dtype=np.int64)
    order = np.empty(polygon_count, dtype=np.int64)
    lowest = entries = 0
    for place in range(polygon_count):
        chosen = -1
        for queue in range(_QUEUE_COUNT):
            while chosen < 0 and heads[queue] >= 0:
                polygon = queued[heads[queue]]
                heads[queue] = following[heads[queue]]
                if not visited_mask[polygon] and min(unknown_counts[polygon], _QUEUE_COUNT - 1) == queue:
                    chosen = polygon
        if chosen < 0:
            while visited_mask[lowest]:
                lowest += 1
            chosen = lowest
        visited_mask[chosen] = True
        order[place] = chosen
        for corner in range(starts[chosen], starts[chosen + 1]):
            new = node[corner]
            if known_mask[new]:
                continue
            known_mask[new] = True
            for around in range(corners.around_starts[new], corners.around_starts[new + 1]):
                polygon = corners.polygon[corners.around[around]]
                if visited_mask[polygon]:
                    continue
                unknown_counts[polygon] -= 1
                queue = min(unknown_counts[polygon], _QUEUE_COUNT - 1)
                queued[entries] = polygon
                if heads[queue] < 0:
                    heads[queue] = entries
                else:
                    following[tails[queue]] = entries
                tails[queue] = entries
                entries += 1
    return order


def walk_polygons(polygons: Polygons, vertex_count: int) -> tuple[Index, Index]:
    """Return the polygons ``(P,)`` in walk order, and their entry corners ``(P,)``; components go by lowest vertex."""
    canonical = canonical_order(polygons)
    sorted_polygons = Polygons(polygons.counts[canonical.polygons], polygons.indices[canonical.corners])
    corners = corners_on_nodes(sorted_polygons, vertex_count)
    entry_corners = _walk_corners(corners)
    return canonical.polygons[corners.polygon[entry_corners]], canonical.corners[entry_corners]


@compiled
def _walk_corners(corners: Corners) -> Index:
    """Return the corners at which polygons are entered, in the order of the walk."""
    polygon_count = len(corners.starts) - 1
    visited_mask = np.zeros(polygon_count, dtype=np.bool_)
    entry_corners = np.empty(polygon_count, dtype=np.int64)
    stack = np.empty(len(corners.node) + 1, dtype=np.int64)  # corners at which polygons may be entered, the newest last
    entered_count = 0
    for seed in corners.around:
        stack[0] = seed
        stack_size = 1
        while stack_size:
            stack_size -= 1
            corner = stack[stack_size]
            polygon = corners.polygon[corner]
            if visited_mask[polygon]:
                continue
            visited_mask[polygon] = True
            entry_corners[entered_count] = corner
            entered_count += 1
            edge = corner
            for _ in range(corners.starts[polygon + 1] - corners.starts[polygon]):
                edge = previous_corner(corners, edge)
                twin = corners.twin[edge]
                if twin >= 0 and not visited_mask[corners.polygon[twin]]:
                    stack[stack_size] = twin
                    stack_size += 1
    return entry_corners


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
    # Largest number of bits: for guesses, and for numbers (counts, states up to 1, distances).
    count, state, distance = (2 + 2 * largest.bit_length() for largest in (len(indices), 1, vertex_count))
    capacity = len(counts) * count + len(indices) * (GUESS_COUNT + state + distance)
    bits = new_hashed_output(capacity, BIT_KINDS)
    checksum = _code_polygons(bits, vertex_count, counts, indices)
    return append_checksum(finish_stream(bits.stream), checksum)


def _code_polygons(bits: HashedBits, vertex_count: int, counts: Index, indices: Index) -> int:
    """Code polygons, or decode them in place; return their checksum."""
    mesh, history = new_half_edges(len(indices), vertex_count), new_history(vertex_count)
    code_polygons(bits, mesh, history, counts, indices)
    return checksum_of(indices, checksum_of(counts))


def decode_polygons(data: bytes, polygon_count: int, corner_count: int, vertex_count: int) -> Polygons:
    """Decode the polygons written by `encode_polygons`."""
    described = f"{polygon_count} polygons with {corner_count} corners and {vertex_count} vertices"
    in_range = polygon_count >= 0 and corner_count < 1 << 31 and 0 <= vertex_count < 1 << 31
    if not in_range or corner_count < 3 * polygon_count:
        raise FormatError(f"the mesh is damaged, as it cannot have {described}; {DAMAGE_CURE}")
    if not polygon_count or not vertex_count:
        if data or corner_count:
            raise FormatError(f"the coded polygons are damaged, as a mesh with {described} has none; {DAMAGE_CURE}")
        return Polygons(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    stream, expected = split_checksum(data)
    bits = new_hashed_bits(new_input_stream(stream), BIT_KINDS)
    counts, indices = np.zeros(polygon_count, dtype=np.int64), np.zeros(corner_count, dtype=np.int64)
    checksum = _code_polygons(bits, vertex_count, counts, indices)
    if bits.failed[0] or checksum != expected:
        raise FormatError(f"the coded polygons ({described}) are damaged; {DAMAGE_CURE}")
    return Polygons(counts, indices)
