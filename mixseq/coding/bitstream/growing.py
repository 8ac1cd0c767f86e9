"""Corners of polygons, and an order of polygons in which each is adjacent to earlier ones.

Polygons are visited breadth first, those with the fewest unknown nodes first, so that values at a node are predicted
from complete polygons around it.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/uvs.npz``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.arrays import Index
from mixseq.compiled import compiled
from mixseq.polygons import Polygons

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
