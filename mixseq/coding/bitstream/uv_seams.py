"""Code seams: which corners at a vertex have the same texture coordinates.

Polygons are visited in the order of `growing`, corners in that of the polygon. A corner takes the node (the pair of
coordinates) of the polygon across the edge into it, or of that across the edge out of it, or another one of its vertex,
the newest first; each of these is a bit, unless it was excluded already. If it takes none, it has a new node. Nodes are
numbered in order of first use.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/uvs.npz``). numba caches compiled loops by the
text of their own file, and this one inlines `hashed_contexts`, `bit_models`, `arithmetic` and `growing`: edit this file
whenever these change. Format 3.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.growing import Corners, after, before
from mixseq.coding.bitstream.hashed_contexts import Bits, code, has_failed
from mixseq.compiled import compiled

SEAM_KINDS = 4
"""Kinds of bits with mixing weights of their own. Frozen: breaks old files."""

_INTO, _OUT, _OTHER, _BOTH = range(SEAM_KINDS)
"""Node across the edge into the corner, across that out of it, another one, that of both. Frozen: breaks old files."""

MOST_NODES = 32
"""Nodes of a vertex that are searched, which bounds the time. Frozen: breaks old files."""

MOST_SEAM_BITS = 2 + MOST_NODES
"""Bits of a corner at most. Free: memory is allocated ahead."""


@compiled
def walk_seams(bits: Bits, corners: Corners, order: Index, labels: Index, nodes: Index) -> int:
    """Code which corners have the same label ``(C,)``, or decode it; return the number of nodes: order ``(P,)``."""
    vertex, twin = corners.node, corners.twin
    vertex_count = len(corners.around_starts) - 1
    newest = np.full(vertex_count, -1, dtype=np.int64)
    older, label = np.empty(len(vertex), dtype=np.int64), np.empty(len(vertex), dtype=np.int64)
    several = np.zeros(vertex_count, dtype=np.int64)  # nodes of a vertex
    done = np.zeros(vertex_count, dtype=np.int64)  # corners of a vertex that have a node
    count = history = 0
    for polygon in order:
        for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
            at, last, following = vertex[corner], before(corners, corner), after(corners, corner)
            into, out, along_into, along_out = -1, -1, 2, 2
            if twin[last] >= 0:
                into = nodes[twin[last]]
                along_into = _along(nodes[last], nodes[after(corners, twin[last])])
            if twin[corner] >= 0:
                out = nodes[after(corners, twin[corner])]
                along_out = _along(nodes[following], nodes[twin[corner]])
            left = corners.around_starts[at + 1] - corners.around_starts[at] - done[at]
            edges = (along_out * 3 + along_into) * 4 + (1 if out >= 0 else 0) + (2 if into >= 0 else 0)
            own = min(several[at], 3) * 8 + min(left, 7)
            around = (own * 4 + min(several[vertex[last]], 3)) * 4 + min(several[vertex[following]], 3)
            chosen = -1
            if into >= 0:
                kind = _BOTH if into == out else _INTO
                _set_contexts(bits, kind, edges, around, history, min(several[at], 7), own)
                bit = code(bits, kind, 1 if labels[corner] == label[into] else 0)
                history = (history << 1 | bit) & 255
                chosen = into if bit else -1
            if chosen < 0 and out >= 0 and out != into:
                _set_contexts(bits, _OUT, edges, around, history, min(several[at], 7), own)
                bit = code(bits, _OUT, 1 if labels[corner] == label[out] else 0)
                history = (history << 1 | bit) & 255
                chosen = out if bit else -1
            node, looked_at = newest[at], 0
            while chosen < 0 and node >= 0 and looked_at < MOST_NODES:
                if node not in (into, out):
                    _set_contexts(bits, _OTHER, edges, around, history, min(several[at], 7), own)
                    if code(bits, _OTHER, 1 if labels[corner] == label[node] else 0):
                        chosen = node
                looked_at += 1
                node = older[node]
            if chosen < 0:
                chosen = count
                label[count] = labels[corner]
                older[count] = newest[at]
                newest[at] = count
                several[at] += 1
                count += 1
            nodes[corner] = chosen
            done[at] += 1
        if has_failed(bits):
            return count
    return count


@compiled
def _along(one: int, other: int) -> int:
    """Return whether the other end of an edge has one node on both sides; 2 if unknown."""
    return 2 if one < 0 or other < 0 else (1 if one == other else 0)


@compiled
def _set_contexts(
    bits: Bits, kind: int, edges: int, around: int, history: int, several: int, own: int
) -> None:
    contexts = bits.contexts
    contexts[0] = edges << 4 | kind
    contexts[1] = (around << 8 | edges) << 4 | kind
    contexts[2] = ((history & 15) << 8 | edges) << 4 | kind
    contexts[3] = (several << 8 | edges) << 4 | kind
    contexts[4] = (own << 8 | edges) << 4 | kind
    contexts[5] = around << 4 | kind
    contexts[6] = history << 4 | kind
    contexts[7] = ((around >> 4) << 12 | edges << 4 | (history & 15)) << 4 | kind
