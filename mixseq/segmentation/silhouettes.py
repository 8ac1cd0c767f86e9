r"""Segmentation by augmented silhouettes, after Marras, Bronstein, Hormann, Scateni and Scopigno (2012).

The method (paper, Section 2.1, Figure 3):

1. *Look.* The N poses are seen from K viewpoints. The augmented silhouette of a view are the edges between a visible
   and a hidden face, without occlusion. Only K' of all K N silhouettes, chosen at random, are used.
2. *Mark.* On every silhouette the vertices are marked whose surrounding triangles deform most, by the largest
   variation over the poses of the angles and lengths of their edges. Vertices marked often are *significant*.
3. *Seed.* The height of a vertex is its diffusion distance from the nearest significant one. Maxima are seeds.
4. *Grow.* Regions grow from the seeds downwards, until they meet where the mesh deforms.

Choices that the paper leaves open, like all numbers:

- Views are orthographic, with directions spread over a half sphere: silhouettes are the same from behind.
- A vertex deforms by :math:`\Delta\theta_v + \epsilon_v` (`mixseq.segmentation.deformation`), smoothed over a small
  radius; on every silhouette a fixed share of vertices is marked; those marked on at least half of their silhouettes
  are significant.
- The height of a significant vertex is minus its distance from the nearest other one, so that regions meet in the
  middle of what deforms.
- A seed makes a part if it is high enough above the pass to a higher one (its persistence, see
  `mixseq.segmentation.growing`), and its region is large enough. Every connected component is at least one part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, Mask
from mixseq.errors import SettingsError
from mixseq.segmentation.deformation import some_frames, vertex_bending, vertex_strain
from mixseq.segmentation.diffusion import Diffusion
from mixseq.segmentation.elements import face_areas
from mixseq.segmentation.growing import check_parts, flood
from mixseq.topology import Topology


@dataclass(frozen=True)
class SilhouetteSettings:
    """Settings of `segment_by_silhouettes`. The quantities N, K and K' are the paper's, all values are ours.

    Attributes
    ----------
    frames : int
        Number of poses (N), evenly spread over the sequence.
    viewpoints : int
        Number of viewing directions of every pose (K).
    silhouettes : int
        Number of sampled views (K').
    seed : int
        Seed of the random choice of views.
    radius : float
        Smoothing radius of deformations, in diagonals; 0 for none.
    share : float
        Fraction of the vertices on a silhouette that are marked, those that deform most.
    still : float
        Deformation below which vertices are never marked; radians of bending plus strain.
    eigenvectors : int
        Number of eigenvectors of the diffusion distance.
    time : float
        Time of diffusion, in squared diagonals; smaller details than its root have no influence.
    contrast : float
        Without a number of parts, least height of a seed above the pass to a higher seed, as a fraction of the mean
        distance.
    small_region : float
        Least fraction of the area of a part, unless more parts are requested than that allows.
    """

    frames: int = 24
    viewpoints: int = 20
    silhouettes: int = 100
    seed: int = 0
    radius: float = 0.015
    share: float = 0.3
    still: float = 0.005
    eigenvectors: int = 40
    time: float = 0.01
    contrast: float = 0.08
    small_region: float = 0.005

    def __post_init__(self) -> None:
        counts = min(self.frames, self.viewpoints, self.silhouettes, self.eigenvectors)
        sizes = min(self.seed, self.radius, self.still, self.time, self.contrast)
        finite = np.isfinite([self.radius, self.still, self.time, self.contrast]).all()
        if counts < 1 or sizes < 0 or not (finite and 0 < self.share <= 1 and 0 <= self.small_region < 1):
            raise SettingsError(
                f"{self}: frames, viewpoints, silhouettes and eigenvectors of at least 1, seed, radius, still, time "
                "and contrast of at least 0, a share from above 0 to 1 and a small_region from 0 to below 1 are "
                "expected"
            )


def segment_by_silhouettes(
    points: FloatArray,
    topology: Topology,
    parts: int | None = None,
    settings: SilhouetteSettings | None = None,
) -> Index:
    """Find the part ``(F,)`` of every face between deforming silhouettes of points ``(T, V, 3)``."""
    settings = settings or SilhouetteSettings()
    check_parts(parts, topology)
    x = some_frames(points, settings.frames)
    surface = Diffusion(x[0], topology)
    deformation = surface.smoothed(vertex_bending(x, topology) + vertex_strain(x, topology), settings.radius)
    significant = significant_vertices(x, topology, deformation, settings)
    distance = _signed_distance(surface, significant, settings)
    bottoms = -distance[topology.faces].mean(axis=1)  # water runs down: seeds, which are tops, turned over
    passes = flood(topology, bottoms[topology.hinge_faces].max(axis=1), bottoms, face_areas(x[0], topology))
    least_area = settings.small_region * float(passes.face_areas.sum())
    if parts is not None:
        return passes.cut(passes.deepest(parts, least_area))
    deep = settings.contrast * float(np.average(np.abs(distance), weights=surface.areas))
    return passes.cut(passes.deeper(deep, least_area))


def viewpoints(count: int) -> Float:
    """Return directions ``(count, 3)``, evenly spread over the upper half sphere: a Fibonacci spiral."""
    number = np.arange(count) + 0.5
    height = 1.0 - number / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * number
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def silhouette(points: FloatArray, topology: Topology, direction: Float) -> Mask:
    """Mark the hinges ``(H,)`` between a face towards a direction ``(3,)`` and one away from it."""
    corners = points[topology.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    visible = (normals @ direction > 0.0)[topology.hinge_faces]
    return np.asarray(visible[:, 0] != visible[:, 1])


def significant_vertices(
    points: FloatArray, topology: Topology, deformation: Float, settings: SilhouetteSettings
) -> Mask:
    """Mark the vertices ``(V,)`` that deform most on most of their silhouettes: points ``(N, V, 3)``."""
    directions = viewpoints(settings.viewpoints)
    views = len(points) * len(directions)
    chosen = np.random.default_rng(settings.seed).choice(
        views, min(settings.silhouettes, views), replace=False
    )
    seen, marked = np.zeros((2, topology.vertex_count), dtype=np.int64)
    for pose, direction in zip(*np.divmod(np.sort(chosen), len(directions)), strict=True):
        edges = topology.hinge_edges[silhouette(points[pose], topology, directions[direction])]
        vertices = np.unique(topology.edges[edges])
        if not vertices.size:
            continue
        least = np.quantile(deformation[vertices], 1.0 - settings.share)
        seen[vertices] += 1
        marked[vertices[deformation[vertices] >= max(least, settings.still)]] += 1
    return (marked > 0) & (2 * marked >= seen)


def _signed_distance(surface: Diffusion, significant: Mask, settings: SilhouetteSettings) -> Float:
    """Return the diffusion distance ``(V,)`` from the nearest significant vertex, negative inside; 0 without a rim.

    Only rim vertices, with a neighbour of the other kind, are compared: others are rarely nearer, and then hardly.
    """
    from scipy.spatial import cKDTree

    places = surface.embedding(settings.time, settings.eigenvectors)
    component = surface.topology.component_of_vertex
    edges = surface.topology.edges
    rim = np.zeros(len(places), dtype=bool)
    rim[edges[significant[edges[:, 0]] != significant[edges[:, 1]]]] = True
    result = np.zeros(len(places))
    for number in np.unique(component[rim]):
        here = component == number
        for side, sign in ((significant, -1.0), (~significant, 1.0)):
            across = cKDTree(places[here & rim & ~side])
            result[here & side] = sign * across.query(places[here & side])[0]
    return result
