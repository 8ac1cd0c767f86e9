"""Growing regions over a landscape, and the passes between them.

Every hinge has a height. Rising water connects faces across hinges in the order of height, which is Kruskal's
algorithm for the minimum spanning tree of the dual graph: its nodes are faces, its edges hinges. A hinge that joins two
lakes is the *pass* between them, with

- an *area*: that of the smaller lake when they meet,
- a *depth*: its height above the bottom of the shallower lake (the persistence of that lake).

Cutting the tree at passes leaves regions, connected across hinges, in every component one more than passes. If all cut
passes have at least some area, so have all regions. If they have at least some depth, every region has one bottom, its
*seed*, as deep below the surrounding passes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index
from mixseq.errors import SettingsError
from mixseq.topology import Topology


@dataclass(frozen=True, eq=False)
class Passes:
    """The minimum spanning tree of the dual graph, from its lowest hinge to its highest."""

    topology: Topology  # connectivity of the mesh
    face_areas: Float  # (F,) areas of the faces
    hinges: Index  # (n,) hinges of the tree; n is the number of faces less that of components
    areas: Float  # (n,) areas of the passes
    depths: Float  # (n,) depths of the passes

    def cut(self, where: Index) -> Index:
        """Cut the tree at n hinges; number the regions ``(F,)`` by decreasing area."""
        count = len(self.face_areas)
        i, j = self.topology.hinge_faces[np.delete(self.hinges, where)].T
        graph = sparse.coo_array((np.ones(len(i), dtype=bool), (i, j)), shape=(count, count))
        region = csgraph.connected_components(graph, directed=False)[1]
        return by_area(region, self.face_areas)

    def deepest(self, parts: int, least_area: float) -> Index:
        """Choose the deepest passes that leave `parts` regions; the least area is halved until there are enough."""
        components = len(self.face_areas) - len(self.hinges)
        count = min(max(parts - components, 0), len(self.hinges))
        while np.count_nonzero(self.areas >= least_area) < count:
            least_area /= 2.0
        large = np.flatnonzero(self.areas >= least_area)
        return np.asarray(large[np.argsort(-self.depths[large], kind="stable")[:count]], dtype=np.int64)

    def deeper(self, than: float, least_area: float) -> Index:
        """Choose all passes above a depth and an area."""
        return np.flatnonzero((self.depths > than) & (self.areas >= least_area))


def flood(topology: Topology, heights: Float, bottoms: Float, areas: Float) -> Passes:
    """Find the passes of a landscape: heights ``(H,)``; bottoms ``(F,)``; areas ``(F,)``."""
    from mixseq.segmentation.segmentation_kernels import kruskal

    order = np.argsort(heights, kind="stable")
    tree, area, depth = kruskal(topology.hinge_faces[order], heights[order], bottoms.copy(), areas.copy())
    return Passes(topology, areas, order[tree], area, depth)


def by_area(labels: NDArray[np.integer], areas: Float) -> Index:
    """Renumber the labels ``(F,)`` of faces by decreasing area, equal ones in the order of first faces."""
    _, first, dense = np.unique(labels, return_index=True, return_inverse=True)
    order = np.lexsort((first, -np.bincount(dense, areas)))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return np.asarray(rank[dense], dtype=np.int64)


def check_parts(parts: int | None, topology: Topology) -> None:
    """Raise `SettingsError` for a number of parts that no segmentation has."""
    if parts is None:
        return
    whole = isinstance(parts, int | np.integer)
    if not (whole and 1 <= parts <= len(topology.faces)):
        given = parts if np.ndim(parts) == 0 else f"of type {type(parts).__name__}"
        raise SettingsError(
            f"parts is {given}; a whole number from 1 to {len(topology.faces)} (the faces) is expected"
        )
