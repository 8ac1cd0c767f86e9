"""An order of polygons in which connectivity takes few bits: a walk over the mesh, from edge to edge.

From every polygon the walk goes on across its edges, first across the one after the edge that it came in by, and so
turns around the vertex between both; what it could not enter at once it comes back to, the newest first. This is the
order of Edgebreaker (Rossignac 1999, *Edgebreaker: connectivity compression for triangle meshes*). A polygon that
begins where it was entered has corners that `mixseq.coding.bitstream.corner_guesses` finds at its first guesses.

Where the walk begins, and which way it goes, depends on the numbers of vertices and on which polygons there are, not on
how these are listed, nor where each begins.

Frozen: decoders do not need it, but meshes whose vertices were numbered by it are compared with their originals by
walking over these again (golden: the digest in ``tests/coding/bitstream/test_polygon_walk.py``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.growing import Corners, before, corners_of
from mixseq.compiled import compiled
from mixseq.polygon_matching import in_canonical_order
from mixseq.polygons import Polygons


def walk_polygons(polygons: Polygons, vertex_count: int) -> tuple[Index, Index]:
    """Return the polygons ``(P,)`` in the order of the walk, and the corner ``(P,)`` at which each is entered.

    Components follow each other by their lowest vertices, where they begin.

    Examples
    --------
    >>> strip = Polygons.from_triangles([[2, 1, 3], [4, 2, 3], [1, 2, 0]])
    >>> order, corners = walk_polygons(strip, 5)
    >>> order.tolist(), strip.indices[corners].tolist()
    ([2, 0, 1], [0, 2, 2])
    """
    canonical = in_canonical_order(polygons)
    listed = Polygons(polygons.counts[canonical.polygons], polygons.indices[canonical.corners])
    corners = corners_of(listed, vertex_count)
    entered = _walk(corners)
    return canonical.polygons[corners.polygon[entered]], canonical.corners[entered]


@compiled
def _walk(corners: Corners) -> Index:
    """Return the corners at which polygons are entered, in their order."""
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
