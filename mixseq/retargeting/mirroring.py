r"""Mirror points of a body with two similar sides to the opposite side, in any pose.

The mirror map is found from distances along the surface, which hardly depend on the pose. The extremities are paired
first, by the exchange :math:`\pi` that changes their distances d and heat kernel signatures h least. A bonus p per
exchanged pair tolerates small differences, such as a bent leg, and favours the exchange of all limbs. The cost is

.. math::
    \operatorname{mean}_{ij} |d_{ij} - d_{\pi(i)\pi(j)}| + w \operatorname{mean}_i |h_i - h_{\pi(i)}| - p\, |\pi| .

Then vertices are paired. A vertex v has distances to the extremities; its partner has the most similar distances to the
partners of the extremities. In further rounds sample points far apart, with their current partners, replace the
extremities; their weights decrease with distance. Quality is the distance of a point from its double mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.suggestions import (
    DISTANCE_SAMPLES,
    MAX_MATCHED_EXTREMITIES,
    MIN_LIMB_PROMINENCE,
    SIGNATURE_WEIGHT,
    CoarseSurface,
    Extremities,
    sample_far_apart,
)
from mixseq.runtime.parallel import one_blas_thread
from mixseq.types import Float, FloatArray, Index

PAIR_BONUS = 0.04  # the bonus p of an exchanged pair, in roots of the area
MIN_EXTREMITIES = 4  # smallest number of prominent extremities of a body with two sides
MAX_EXCHANGE_COST = 0.15  # largest cost, without bonus, of similar sides; tested bodies have 0.03 to 0.09
REFINEMENT_ROUNDS = 3  # number of rounds in which far-apart points replace the extremities
WEIGHT_RADIUS = 0.4  # radius of the weights of far-apart points, in roots of the area
MAX_ROUND_TRIP_DISTANCE = 0.06  # largest distance of a point from its double mirror image, in roots of the area
MIN_PARTNER_DISTANCE = 0.08  # smallest distance of partners off the middle of the body, in roots of the area
NEIGHBOURHOOD_RINGS = 2  # number of rings of vertices around a point to which a reflection is fitted
MIN_NORMAL_COSINE = 0.5  # smallest cosine between the normal of a partner and the mirrored normal


@dataclass(frozen=True, eq=False)
class Mirror:
    """Mirror map of a body: the partner of every coarse vertex on the opposite side."""

    mesh: TriangleMesh  # mesh of the body
    surface: CoarseSurface  # coarse surface of the body
    partners: Index  # (n,) partner of every vertex of the coarse surface

    @classmethod
    def from_mesh(cls, points: FloatArray, topology: Topology) -> Mirror | None:
        """Find the mirror map of a mesh with points ``(V, 3)``; return None if it has no two similar sides."""
        with one_blas_thread():
            surface = CoarseSurface.from_mesh(points, topology)
            partners = _find_partners(surface)
        mesh = TriangleMesh(np.asarray(points, np.float64), topology)
        return None if partners is None else cls(mesh, surface, partners)

    def find_partner(self, vertex: int) -> int | None:
        """Return the mirrored vertex, or None if uncertain, in the middle, or outside the largest component."""
        surface, partners = self.surface, self.partners
        if self.mesh.topology.component_of_vertex[vertex] != self._component:
            return None
        point = (self.mesh.points[vertex] - surface.centre) / surface.size
        coarse_vertex = int(self._point_tree.query(point)[1])
        partner = partners[coarse_vertex]
        round_trip = np.linalg.norm(surface.points[partners[partner]] - surface.points[coarse_vertex])
        partner_distance = np.linalg.norm(surface.points[partner] - surface.points[coarse_vertex])
        if round_trip > MAX_ROUND_TRIP_DISTANCE or partner_distance < MIN_PARTNER_DISTANCE:
            return None
        mirrored, mirrored_normal = self._mirror_point(coarse_vertex, point, self.mesh.vertex_normals[vertex])
        candidates = np.flatnonzero(self.mesh.topology.component_of_vertex == self._component)
        is_facing = self.mesh.vertex_normals[candidates] @ mirrored_normal >= MIN_NORMAL_COSINE
        candidates = candidates[is_facing] if is_facing.any() else candidates
        offsets = self.mesh.points[candidates] - (surface.centre + surface.size * mirrored)
        return int(candidates[np.einsum("vi,vi->v", offsets, offsets).argmin()])

    def _mirror_point(self, coarse_vertex: int, point: Float, normal: Float) -> tuple[Float, Float]:
        """Mirror a point near a coarse vertex, and its normal, by a reflection fitted to the neighbourhood."""
        ring = np.array([coarse_vertex])
        for _ in range(NEIGHBOURHOOD_RINGS):
            ring = np.unique(np.concatenate([ring, self._adjacency[ring].indices]))
        ring_points, partner_points = self.surface.points[ring], self.surface.points[self.partners[ring]]
        rotation, shift = kabsch(-ring_points, partner_points)
        return rotation @ -point + shift, rotation @ -normal

    @cached_property
    def _component(self) -> int:
        return int(self.mesh.topology.component_of_vertex[self.surface.vertices[0]])

    @cached_property
    def _point_tree(self) -> cKDTree:
        return cKDTree(self.surface.points)

    @cached_property
    def _adjacency(self) -> sparse.csr_array:
        return self.surface.mesh.topology.vertex_adjacency.tocsr()


def _find_partners(surface: CoarseSurface) -> Index | None:
    """Return the partner ``(n,)`` of every vertex of a coarse surface, or None without two similar sides."""
    extremities = Extremities.from_surface(surface)
    exchange = _find_exchange(extremities)
    if exchange is None:
        return None
    count = len(exchange)
    extremity_ids = np.searchsorted(surface.vertices, extremities.vertices[:count])
    distances = surface.distances(extremity_ids).T
    partners = _most_similar_rows(distances, distances[:, exchange], np.ones_like(distances))
    samples = sample_far_apart(surface, DISTANCE_SAMPLES)[0]
    distances = surface.distances(samples).T
    weights = np.exp(-((distances / WEIGHT_RADIUS) ** 2))
    for _ in range(REFINEMENT_ROUNDS):
        partners = _most_similar_rows(distances, surface.distances(partners[samples]).T, weights)
    return partners


def _find_exchange(extremities: Extremities) -> Index | None:
    """Return the partner of every prominent extremity (itself in the middle), or None without two similar sides."""
    count = min(int((extremities.prominences >= MIN_LIMB_PROMINENCE).sum()), MAX_MATCHED_EXTREMITIES)
    distances, signatures = extremities.distances[:count, :count], extremities.signatures[:count]
    if count < MIN_EXTREMITIES:
        return None
    best, min_cost = None, np.inf
    for exchange in permutations(range(count)):
        if any(exchange[partner] != number for number, partner in enumerate(exchange)):
            continue  # not all are the partners of their partners
        partners = np.array(exchange, dtype=np.int64)
        pair_count = int((partners != np.arange(count)).sum()) // 2
        if not pair_count:
            continue
        cost = np.abs(distances - distances[np.ix_(partners, partners)]).mean()
        cost += SIGNATURE_WEIGHT * np.abs(signatures - signatures[partners]).mean()
        if cost <= MAX_EXCHANGE_COST and cost - PAIR_BONUS * pair_count < min_cost:
            best, min_cost = partners, float(cost) - PAIR_BONUS * pair_count
    return best if min_cost < 0 else None


def _most_similar_rows(rows: Float, candidates: Float, weights: Float) -> Index:
    """Return the id ``(n,)`` of the candidate ``(m, k)`` most similar to each row ``(n, k)``: weights ``(n, k)``."""
    distances = weights @ (candidates**2).T - 2 * (weights * rows) @ candidates.T
    return np.asarray(distances.argmin(axis=1), dtype=np.int64)
