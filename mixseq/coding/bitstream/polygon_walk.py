"""Order polygons by a walk over the mesh from edge to edge, in which connectivity takes few bits.

From every polygon the walk crosses its edges, first the one after the edge by which it entered, and so turns around the
vertex between both; it returns later to polygons not entered at once, the newest first. This is the order of
Edgebreaker (Rossignac 1999, *Edgebreaker: connectivity compression for triangle meshes*). A polygon that begins where
it was entered is predicted by the first guesses of `mixseq.coding.bitstream.corner_guesses`.

Start and direction of the walk depend on vertex numbers and on the set of polygons, neither on their order nor on their
first corners.

Frozen: files with vertices numbered by the walk are compared with their originals by walking over these again
(golden: the digest in ``tests/coding/bitstream/test_polygon_walk.py``).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Index
from mixseq.coding.bitstream.growing import Corners, before, corners_of
from mixseq.compiled import compiled
from mixseq.polygon_matching import in_canonical_order
from mixseq.polygons import Polygons


def walk_polygons(polygons: Polygons, vertex_count: int) -> tuple[Index, Index]:
    """Return the polygons ``(P,)`` in walk order, and their entry corners ``(P,)``; components by lowest vertex."""
    canonical = in_canonical_order(polygons)
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
