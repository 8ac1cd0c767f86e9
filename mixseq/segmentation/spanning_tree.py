"""Segmentation by a spanning tree, after Wuhrer and Brunton (2010): cut where hinges bend most.

1. Every hinge has the largest variation of its dihedral angle between any two frames.
2. A minimum spanning tree of the dual graph (nodes are faces, edges are hinges) connects the faces across the hinges
   that bend least.
3. The tree is cut at hinges of large variation, which leaves near-rigid parts.

That is the method of the paper (Section 1.3). On noisy meshes it leaves one large part and crumbs: the largest
variations are those of single bad triangles, and the tree passes joints along sides of limbs that are only sheared.
Two additions:

- *Smoothing.* Variations are averaged at vertices and smoothed over a small radius on the surface; a hinge has the
  mean of its two ends. That closes the rings about joints.
- *Where to cut.* A hinge is cut if it bends by enough more than the insides of both its sides (its depth as a
  `mixseq.segmentation.growing` pass, instead of its height), and if both sides are large enough.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import FloatArray, Index
from mixseq.errors import SettingsError
from mixseq.segmentation.deformation import some_frames, vertex_bending
from mixseq.segmentation.diffusion import Diffusion
from mixseq.segmentation.elements import face_areas
from mixseq.segmentation.growing import check_parts, flood
from mixseq.topology import Topology


@dataclass(frozen=True)
class SpanningTreeSettings:
    """Settings of `segment_by_spanning_tree`. The values are ours; the paper gives none.

    Attributes
    ----------
    frames : int
        Number of frames, evenly spread over the sequence.
    radius : float
        Smoothing radius of variations, in diagonals; 0 for none.
    contrast : float
        Without a number of parts, cuts are where the variation is larger than inside the parts by this fraction of
        the mesh's mean variation ...
    still : float
        ... and by more than this angle, in degrees; smaller variations are noise.
    small_region : float
        Least fraction of the area of a part, unless more parts are requested than that allows.
    """

    frames: int = 24
    radius: float = 0.015
    contrast: float = 0.25
    still: float = 0.1
    small_region: float = 0.005

    def __post_init__(self) -> None:
        sizes = (self.radius, self.contrast, self.still)
        if self.frames < 1 or not (
            np.isfinite(sizes).all() and min(sizes) >= 0 and 0 <= self.small_region < 1
        ):
            raise SettingsError(
                f"{self}: frames of at least 1, radius, contrast and still of at least 0, and a small_region from 0 to "
                f"below 1 are expected"
            )


def segment_by_spanning_tree(
    points: FloatArray,
    topology: Topology,
    parts: int | None = None,
    settings: SpanningTreeSettings | None = None,
) -> Index:
    """Cut a moving mesh ``(T, V, 3)`` where its dihedral angles vary most; returns parts ``(F,)``."""
    settings = settings or SpanningTreeSettings()
    check_parts(parts, topology)
    x = some_frames(points, settings.frames)
    surface = Diffusion(x[0], topology)
    bending = surface.smoothed(vertex_bending(x, topology), settings.radius)
    heights = bending[topology.edges[topology.hinge_edges]].mean(axis=1)
    bottoms = np.full(len(topology.faces), np.inf)
    np.minimum.at(bottoms, topology.hinge_faces.reshape(-1), np.repeat(heights, 2))
    passes = flood(topology, heights, bottoms, face_areas(x[0], topology))
    least_area = settings.small_region * float(passes.face_areas.sum())
    if parts is not None:
        return passes.cut(passes.deepest(parts, least_area))
    deep = settings.contrast * float(np.average(bending, weights=surface.areas))
    return passes.cut(passes.deeper(max(deep, np.radians(settings.still)), least_area))
