r"""Mirror points of a body with two similar sides to its other side, in any pose.

Mirroring is along the surface, where distances hardly depend on the pose. First the extremities: of all exchanges
:math:`\pi` of pairs of them, the one that changes their distances d and heat kernel signatures h least is taken. A
bonus p per pair lets a bent leg differ a little from the other, and favours exchanging all limbs:

.. math::
    \operatorname{mean}_{ij} |d_{ij} - d_{\pi(i)\pi(j)}| + w \operatorname{mean}_i |h_i - h_{\pi(i)}| - p\, |\pi| .

Then all vertices: v is mirrored to the vertex u whose distances to the partners of the extremities are those of v to
the extremities. In a few more rounds far-apart points, with their partners so far, replace the extremities, and near
ones count most. The distance of a point from its double mirror image measures the quality of its partner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.suggestions import (
    HEAT,
    MOST,
    PROMINENT,
    SAMPLES,
    CoarseSurface,
    Extremities,
    far_apart,
)
from mixseq.runtime.parallel import one_blas_thread
from mixseq.types import Float, FloatArray, Index

PAIRED = 0.04
"""Largest cost of an exchanged pair, the bonus p, in roots of the area."""

FEWEST = 4
"""Least number of prominent extremities of a body with sides."""

UNLIKE = 0.15
"""Cost of exchanging above which sides are not similar; tried bodies have 0.03 to 0.09."""

ROUNDS = 3
"""Number of rounds in which far-apart points replace the extremities."""

NEAR = 0.4
"""Distance below which points count most, in roots of the area."""

TRUSTED = 0.06
"""Largest distance of a point from its double mirror image, in roots of the area."""

MIDDLE = 0.08
"""Distance to the partner below which a point is in the middle, without a partner."""

RINGS = 2
"""Rings of vertices around a point that determine the rotation of its neighbourhood."""

FACING = 0.5
"""Least cosine between the normal of a partner and the mirrored one."""


@dataclass(frozen=True, eq=False)
class Mirror:
    """Partners of the points of a body on its other side."""

    mesh: TriangleMesh  # the body
    surface: CoarseSurface  # the same, thinned out
    partners: Index  # (n,) the partner of every vertex of the coarse surface

    @classmethod
    def from_mesh(cls, points: FloatArray, topology: Topology) -> Mirror | None:
        """Find the partners of points ``(V, 3)``; None if no two sides are similar."""
        with one_blas_thread():
            surface = CoarseSurface.from_mesh(points, topology)
            partners = _partners(surface)
        mesh = TriangleMesh(np.asarray(points, np.float64), topology)
        return None if partners is None else cls(mesh, surface, partners)

    def find_partner(self, vertex: int) -> int | None:
        """Return the vertex on the other side; None in the middle, outside the largest component, or if not sure."""
        surface = self.surface
        if self.mesh.topology.component_of_vertex[vertex] != self._component:
            return None
        place = (self.mesh.points[vertex] - surface.centre) / surface.size
        own = int(self._search.query(place)[1])
        twice = surface.points[self.partners[self.partners[own]]] - surface.points[own]
        apart = surface.points[self.partners[own]] - surface.points[own]
        if np.linalg.norm(twice) > TRUSTED or np.linalg.norm(apart) < MIDDLE:
            return None
        mirrored, turned = self._mirrored(own, place, self.mesh.vertex_normals[vertex])
        candidates = np.flatnonzero(self.mesh.topology.component_of_vertex == self._component)
        facing = self.mesh.vertex_normals[candidates] @ turned >= FACING
        candidates = candidates[facing] if facing.any() else candidates
        away = self.mesh.points[candidates] - (surface.centre + surface.size * mirrored)
        return int(candidates[np.einsum("vi,vi->v", away, away).argmin()])

    def _mirrored(self, own: int, place: Float, normal: Float) -> tuple[Float, Float]:
        """Mirror a point near a coarse vertex, and its normal, by the rotation of the neighbourhood."""
        around = np.array([own])
        for _ in range(RINGS):
            around = np.unique(np.concatenate([around, self._adjacency[around].indices]))
        before, after = self.surface.points[around], self.surface.points[self.partners[around]]
        rotation, shift = kabsch(-before, after)
        return rotation @ -place + shift, rotation @ -normal

    @cached_property
    def _component(self) -> int:
        return int(self.mesh.topology.component_of_vertex[self.surface.vertices[0]])

    @cached_property
    def _search(self) -> cKDTree:
        return cKDTree(self.surface.points)

    @cached_property
    def _adjacency(self) -> sparse.csr_array:
        return self.surface.mesh.topology.vertex_adjacency.tocsr()


def _partners(surface: CoarseSurface) -> Index | None:
    """Return the partner ``(n,)`` of every vertex of a coarse surface."""
    extremities = Extremities.from_surface(surface)
    exchanged = _exchanged(extremities)
    if exchanged is None:
        return None
    count = len(exchanged)
    rows = np.searchsorted(surface.vertices, extremities.vertices[:count])
    table = surface.distances(rows).T
    partners = _alike(table, table[:, exchanged], np.ones_like(table))
    samples = far_apart(surface, SAMPLES)[0]
    table = surface.distances(samples).T
    weights = np.exp(-((table / NEAR) ** 2))
    for _ in range(ROUNDS):
        partners = _alike(table, surface.distances(partners[samples]).T, weights)
    return partners


def _exchanged(extremities: Extremities) -> Index | None:
    """Return the partner of every prominent extremity, itself in the middle; None if no two sides are similar."""
    count = min(int((extremities.prominences >= PROMINENT).sum()), MOST)
    distances, signatures = extremities.distances[:count, :count], extremities.signatures[:count]
    if count < FEWEST:
        return None
    best, least = None, np.inf
    for exchange in _exchanges(range(count)):
        partners = np.array(exchange, dtype=np.int64)
        pairs = int((partners != np.arange(count)).sum()) // 2
        if not pairs:
            continue
        cost = np.abs(distances - distances[np.ix_(partners, partners)]).mean()
        cost += HEAT * np.abs(signatures - signatures[partners]).mean()
        if cost <= UNLIKE and cost - PAIRED * pairs < least:
            best, least = partners, float(cost) - PAIRED * pairs
    return best if least < 0 else None


def _exchanges(numbers: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Yield all exchanges of numbers 0 to n in pairs, as the target of each.

    >>> list(_exchanges(range(3)))
    [(0, 1, 2), (0, 2, 1), (1, 0, 2), (2, 1, 0)]
    """

    def assigned(left: list[int], done: dict[int, int]) -> Iterator[tuple[int, ...]]:
        if not left:
            yield tuple(done[number] for number in numbers)
            return
        first, rest = left[0], left[1:]
        yield from assigned(rest, done | {first: first})
        for other in rest:
            without = [each for each in rest if each != other]
            yield from assigned(without, done | {first: other, other: first})

    yield from assigned(list(numbers), {})


def _alike(own: Float, other: Float, weights: Float) -> Index:
    """Return the row ``(n,)`` of a table ``(n, k)`` most similar to every row of another, by weights of the latter."""
    distances = weights @ (other**2).T - 2 * (weights * own) @ other.T
    return np.asarray(distances.argmin(axis=1), dtype=np.int64)
