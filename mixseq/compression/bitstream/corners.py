"""Corners of polygons on nodes, orders in which polygons are visited, seams between nodes, and hard edges.

*The growing order* of polygons, in which seams and texture coordinates are coded, is breadth first. Polygons with the
fewest unknown nodes come first, so that values at a node are predicted from complete polygons around it.

*The walk* over the mesh from edge to edge is an order in which connectivity takes few bits. In every polygon, the walk
first crosses the edge after the entry edge, and so turns around the vertex between both edges. It returns later to
polygons across other edges, the newest first. This is the order of Edgebreaker (Rossignac 1999, *Edgebreaker:
connectivity compression for triangle meshes*). Start and direction of the walk depend on vertex numbers and on the set
of polygons, but not on the order or the first corners of polygons.

*Seams* separate corners at a vertex that have different values. Candidates for the node (vertex and value) of a corner
are the node across the edge into the corner, the node across the edge out of it, then other nodes of its vertex, the
newest first. One bit per candidate codes whether it is the node, unless it was excluded already. If no candidate is the
node, the corner has a new node. Nodes are numbered in order of first use. Hard edges are seams between normals.

Frozen: changing this breaks old files (specified in ``docs/file-format.md``; golden:
``tests/compression/golden/uvs.npz``, and the digest in ``tests/compression/bitstream/test_hard_edges.py``). Files with
vertices numbered by the walk are compared with their originals by walking over these again (golden: the digest in
``tests/compression/bitstream/test_polygon_walk.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    HashedBits,
    checksum_of,
    code_hashed_bit,
    finish_hashed,
    has_failed,
    new_hashed_output,
    open_hashed_input,
)
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons, canonical_order
from mixseq.mesh.surface import renumber_by_first_use
from mixseq.runtime.jit import compiled
from mixseq.types import Index, IntArray

_QUEUE_COUNT = 4  # number of queues by unknown nodes per polygon; the last queue takes all larger counts; frozen


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


SEAM_KINDS = 4  # number of kinds of bits, which have separate mixing weights; frozen

_INTO, _OUT, _OTHER, _BOTH = range(SEAM_KINDS)
"""Node across the edge into a corner, across the edge out of it, another node, or one node across both edges.
Frozen: breaks old files.
"""

MAX_SEARCHED_NODES = 32  # largest number of searched nodes per vertex, to bound the time; frozen
MAX_SEAM_BITS = 2 + MAX_SEARCHED_NODES  # largest number of bits per corner; free: memory is allocated ahead


@compiled
def _code_seams(bits: HashedBits, corners: Corners, order: Index, labels: Index, nodes: Index) -> None:
    """Code seams between labels ``(C,)``, or decode them; write the nodes ``(C,)``, visiting polygons in an order."""
    vertices, twin = corners.node, corners.twin
    vertex_count = len(corners.around_starts) - 1
    newest = np.full(vertex_count, -1, dtype=np.int64)
    older, label_of = np.empty(len(vertices), dtype=np.int64), np.empty(len(vertices), dtype=np.int64)
    node_counts = np.zeros(vertex_count, dtype=np.int64)  # nodes of a vertex
    coded = np.zeros(vertex_count, dtype=np.int64)  # corners of a vertex that have a node already
    count = history = 0
    for polygon in order:
        for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
            vertex, label = vertices[corner], labels[corner]
            previous, following = previous_corner(corners, corner), next_corner(corners, corner)
            into, out, shared_into, shared_out = -1, -1, 2, 2
            if twin[previous] >= 0:
                into = nodes[twin[previous]]
                shared_into = _is_shared(nodes[previous], nodes[next_corner(corners, twin[previous])])
            if twin[corner] >= 0:
                out = nodes[next_corner(corners, twin[corner])]
                shared_out = _is_shared(nodes[following], nodes[twin[corner]])
            remaining = corners.around_starts[vertex + 1] - corners.around_starts[vertex] - coded[vertex]
            edges = (shared_out * 3 + shared_into) * 4 + (1 if out >= 0 else 0) + (2 if into >= 0 else 0)
            own = min(node_counts[vertex], 3) * 8 + min(remaining, 7)
            around = own * 4 + min(node_counts[vertices[previous]], 3)
            around = around * 4 + min(node_counts[vertices[following]], 3)
            own_count, chosen = min(node_counts[vertex], 7), -1
            if into >= 0:
                kind = _BOTH if into == out else _INTO
                _set_contexts(bits, kind, edges, around, history, own_count, own)
                bit = code_hashed_bit(bits, kind, 1 if label == label_of[into] else 0)
                history = (history << 1 | bit) & 255
                chosen = into if bit else -1
            if chosen < 0 and out >= 0 and out != into:
                _set_contexts(bits, _OUT, edges, around, history, own_count, own)
                bit = code_hashed_bit(bits, _OUT, 1 if label == label_of[out] else 0)
                history = (history << 1 | bit) & 255
                chosen = out if bit else -1
            node, searched = newest[vertex], 0
            while chosen < 0 and node >= 0 and searched < MAX_SEARCHED_NODES:
                if node not in (into, out):
                    _set_contexts(bits, _OTHER, edges, around, history, own_count, own)
                    if code_hashed_bit(bits, _OTHER, 1 if label == label_of[node] else 0):
                        chosen = node
                searched += 1
                node = older[node]
            if chosen < 0:
                chosen = count
                label_of[count] = label
                older[count] = newest[vertex]
                newest[vertex] = count
                node_counts[vertex] += 1
                count += 1
            nodes[corner] = chosen
            coded[vertex] += 1
        if has_failed(bits):
            return


@compiled
def _is_shared(node: int, other: int) -> int:
    """Return 1 if both sides of an edge have the same node at its other end, 0 if not, 2 if unknown."""
    return 2 if node < 0 or other < 0 else (1 if node == other else 0)


@compiled
def _set_contexts(bits: HashedBits, kind: int, edges: int, around: int, history: int, own_count: int, own: int) -> None:
    contexts = bits.contexts
    contexts[0] = edges << 4 | kind
    contexts[1] = (around << 8 | edges) << 4 | kind
    contexts[2] = ((history & 15) << 8 | edges) << 4 | kind
    contexts[3] = (own_count << 8 | edges) << 4 | kind
    contexts[4] = (own << 8 | edges) << 4 | kind
    contexts[5] = around << 4 | kind
    contexts[6] = history << 4 | kind
    contexts[7] = ((around >> 4) << 12 | edges << 4 | (history & 15)) << 4 | kind


def code_seams(bits: HashedBits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    """Code the seams between labels ``(C,)``, or decode seams; return the node ``(C,)`` of every corner."""
    corners = corners_on_nodes(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    _code_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal, by normal numbers ``(sum of counts,)``; return None if this is impossible."""
    bits = new_hashed_output(len(numbers) * MAX_SEAM_BITS, SEAM_KINDS)
    normal_ids = renumber_by_first_use(numbers)
    nodes = code_seams(bits, polygons, vertex_count, normal_ids)
    if not np.array_equal(renumber_by_first_use(nodes), normal_ids):
        return None
    return finish_hashed(bits, checksum_of(normal_ids))


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Decode the numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... in order of first use."""
    bits, expected = open_hashed_input(data, SEAM_KINDS)
    nodes = code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    numbers = renumber_by_first_use(nodes)
    if bits.failed[0] or checksum_of(numbers) != expected:
        raise FormatError(f"coded hard edges at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return numbers
