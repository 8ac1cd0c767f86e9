r"""Find extremities of bodies, mirror markers, and examine markers while they are set.

*Distances* along a surface are measured on a coarse copy: the decimated largest component, centred, with unit area, so
that lengths on two meshes are comparable. Paths follow edges, or cross a hinge between its opposite vertices on a
straight line in the unfolded faces. With edges alone, distances would be up to an eighth longer.

*Extremities* (tips of limbs, tail, nose and ears) are maxima of the mean distance along the surface to all vertices
(Hilaga et al. 2001), which is smallest in the trunk, in any pose. The *prominence* of a maximum is the least descent on
a path to a higher maximum (0-dimensional persistence; Edelsbrunner, Letscher and Zomorodian 2002). The surroundings
of an extremity are described by the heat kernel signature (Sun, Ovsjanikov and Guibas 2009),

.. math:: h_t(v) = \sum_{i \ge 1} e^{-2 t \lambda_i} \phi_i(v)^2 .

*Mirroring* finds the partner of every point of a body with two similar sides, in any pose. The extremities are paired
by the exchange :math:`\pi` that changes their distances d and signatures h least. A bonus p per exchanged pair
tolerates small differences, such as a bent leg, and favours the exchange of all limbs. The cost is

.. math::
    \operatorname{mean}_{ij} |d_{ij} - d_{\pi(i)\pi(j)}| + w \operatorname{mean}_i |h_i - h_{\pi(i)}| - p\, |\pi| .

Then vertices are paired. A vertex v has distances to the extremities; its partner has the most similar distances to the
partners of the extremities. In further rounds sample points far apart, with their current partners, replace the
extremities; their weights decrease with distance. Quality is the distance of a point from its double mirror image.

*Examination* checks the consistency of markers, and finds a correspondence of decimated meshes within a second. Its
registration is stiff and does not reach inconsistent markers; the distances that remain are the residuals.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from itertools import permutations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.decimation import decimate
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import Suspicion, find_suspicious_markers
from mixseq.retargeting.correspond import correspond_and_assess
from mixseq.retargeting.markers import Markers
from mixseq.runtime.parallel import one_blas_thread
from mixseq.segmentation.silhouettes import Diffusion
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, IntArray

COARSE_VERTEX_COUNT = 2500  # number of vertices of coarse surfaces; the ears of a horse have about 20


@dataclass(frozen=True, eq=False)
class CoarseSurface:
    """The decimated largest component of a mesh, with unit area."""

    vertices: Index  # (n,) ids of the surface's vertices in the mesh
    mesh: TriangleMesh  # surface, centred, with unit area
    centre: Float  # (3,) origin of the surface, in coordinates of the mesh
    size: float  # unit of the surface, in units of the mesh

    @classmethod
    def from_mesh(
        cls, points: FloatArray, topology: Topology, count: int = COARSE_VERTEX_COUNT, keep: Index | None = None
    ) -> CoarseSurface:
        """Decimate the component of a mesh with the largest area to `count` vertices, with its vertices `keep`."""
        x = np.asarray(points, np.float64)
        vertex_ids, faces = np.unique(find_largest_component(x, topology), return_inverse=True)
        faces = faces.reshape(-1, 3)
        if len(vertex_ids) > count:
            keep = None if keep is None else np.searchsorted(vertex_ids, keep)
            kept, faces = decimate(x[vertex_ids], faces, count, keep)
            vertex_ids = vertex_ids[kept]
        mesh = TriangleMesh(x[vertex_ids], Topology(faces, len(vertex_ids)))
        centre = mesh.face_areas @ mesh.centroids / mesh.face_areas.sum()
        size = float(np.sqrt(mesh.face_areas.sum()))
        normalised = TriangleMesh((x[vertex_ids] - centre) / size, mesh.topology)
        return cls(vertex_ids, normalised, centre, size)

    @property
    def points(self) -> Float:
        """Points ``(n, 3)`` of the surface, centred, with unit area."""
        return self.mesh.points

    def distances(self, vertices: Index) -> Float:
        """Return distances ``(k, n)`` along the surface from vertices ``(k,)`` to all vertices."""
        return np.asarray(csgraph.dijkstra(self._graph, directed=False, indices=vertices))

    @cached_property
    def _graph(self) -> sparse.csr_array:
        x, topology = self.points, self.mesh.topology
        a, b, c, d = topology.hinges.T
        directions = x[b] - x[a]
        edge_lengths = np.linalg.norm(directions, axis=1)
        directions = directions / np.maximum(edge_lengths, np.finfo(float).tiny)[:, None]
        # Coordinates of both opposite vertices in the unfolded hinge, along and across its edge.
        at_c, at_d = (np.einsum("hi,hi->h", x[opposite] - x[a], directions) for opposite in (c, d))
        height_c, height_d = (
            np.linalg.norm(x[opposite] - x[a] - position[:, None] * directions, axis=1)
            for opposite, position in ((c, at_c), (d, at_d))
        )
        crossing = at_c + (at_d - at_c) * height_c / np.maximum(height_c + height_d, np.finfo(float).tiny)
        is_crossing = (crossing >= 0) & (crossing <= edge_lengths)
        hinge_lengths = np.hypot(at_d - at_c, height_c + height_d)[is_crossing]
        edges = np.concatenate([topology.edges, np.stack([c, d], axis=1)[is_crossing]])
        lengths = np.concatenate([np.sqrt(self.mesh.squared_lengths), hinge_lengths])
        lengths = np.maximum(lengths, 1e-12)  # csgraph ignores stored zeros
        edges.sort(axis=1)
        order = np.lexsort((lengths, edges[:, 1], edges[:, 0]))
        edges, first = np.unique(edges[order], axis=0, return_index=True)  # keep the shorter of two equal edges
        return sparse.csr_array((lengths[order][first], (edges[:, 0], edges[:, 1])), shape=2 * (len(x),))


def find_largest_component(points: Float, topology: Topology) -> Index:
    """Return the triangles ``(f, 3)`` of the component of a mesh with the largest area."""
    areas = TriangleMesh(points, topology).face_areas
    if not areas.sum() > 0:
        raise SettingsError("no triangle of the mesh has an area; give a surface")
    component_of_face = topology.component_of_face
    is_largest = component_of_face == np.bincount(component_of_face, areas).argmax()
    return np.asarray(topology.faces[is_largest], dtype=np.int64)


DISTANCE_SAMPLES = 100  # number of sample vertices for the mean distance
MIN_PROMINENCE = 0.004  # smallest prominence of an extremity, in roots of the area; ears have 0.006 to 0.05
HEAT_TIMES = np.geomspace(0.002, 0.1, 6)  # times of signatures, in units of the area; for sizes from ears to limbs
SIGNATURE_EIGENVECTORS = 80  # number of eigenvectors; higher ones have decayed at the first time


@dataclass(frozen=True, eq=False)
class Extremities:
    """Extremities of a surface, the most prominent first; lengths are in roots of the area."""

    vertices: Index  # (e,) vertices of the mesh at the extremities
    prominences: Float  # (e,) prominences of the extremities
    distances: Float  # (e, e) distances between extremities along the surface
    signatures: Float  # (e, 6) logarithms of heat kernel signatures

    @classmethod
    def from_surface(cls, surface: CoarseSurface) -> Extremities:
        """Find the extremities of a surface."""
        mean_distances = mean_surface_distances(surface)
        peak_ids, prominences = find_maxima(mean_distances, surface)
        is_prominent = prominences >= MIN_PROMINENCE
        peak_ids, prominences = peak_ids[is_prominent], prominences[is_prominent]
        diffusion = Diffusion(surface.points, surface.mesh.topology)
        signatures = np.log(diffusion.heat_kernel(HEAT_TIMES, SIGNATURE_EIGENVECTORS)[peak_ids])
        distances = surface.distances(peak_ids)[:, peak_ids]
        return cls(surface.vertices[peak_ids], prominences, distances, signatures)


def sample_far_apart(surface: CoarseSurface, count: int) -> tuple[Index, Float]:
    """Sample vertices ``(k,)`` far from each other (Gonzalez 1985), and return their distances ``(k, n)``."""
    sample = int(surface.distances(np.array([0]))[0].argmax())
    samples: list[int] = []
    distance_rows: list[Float] = []
    nearest = np.full(len(surface.vertices), np.inf)
    for _ in range(min(count, len(surface.vertices))):
        samples.append(sample)
        distance_rows.append(surface.distances(np.array([sample]))[0])
        nearest = np.minimum(nearest, distance_rows[-1])
        sample = int(nearest.argmax())
    return np.array(samples), np.array(distance_rows)


def mean_surface_distances(surface: CoarseSurface) -> Float:
    """Return the mean distance ``(n,)`` along a surface from every vertex to all vertices."""
    distances = sample_far_apart(surface, DISTANCE_SAMPLES)[1]
    areas = np.bincount(distances.argmin(axis=0), surface.mesh.vertex_areas, len(distances))
    return np.asarray(areas @ distances / areas.sum())


def find_maxima(values: Float, surface: CoarseSurface) -> tuple[Index, Float]:
    """Find the maxima ``(m,)`` of values ``(n,)`` on a surface, with their prominences ``(m,)``."""
    adjacency = surface.mesh.topology.vertex_adjacency.tocsr()
    peak_of_vertex = np.full(len(values), -1)  # highest vertex of the component above the current level
    members_of_peak: dict[int, list[int]] = {}
    maxima: list[tuple[int, float]] = []
    for vertex in np.argsort(-values, kind="stable").tolist():
        neighbours = adjacency.indices[adjacency.indptr[vertex] : adjacency.indptr[vertex + 1]]
        neighbour_peaks = {int(peak) for peak in peak_of_vertex[neighbours] if peak >= 0}
        peaks = sorted(neighbour_peaks, key=lambda peak: -values[peak])
        highest = peaks[0] if peaks else vertex
        members_of_peak.setdefault(highest, []).append(vertex)
        peak_of_vertex[vertex] = highest
        for lower_peak in peaks[1:]:
            maxima.append((lower_peak, float(values[lower_peak] - values[vertex])))
            members = members_of_peak.pop(lower_peak)
            peak_of_vertex[members] = highest
            members_of_peak[highest] += members
    maxima += [(highest, float(values[highest] - values.min())) for highest in members_of_peak]
    maxima.sort(key=lambda peak: (-peak[1], peak[0]))
    return np.array([vertex for vertex, _ in maxima]), np.array([prominence for _, prominence in maxima])


MIN_LIMB_PROMINENCE = 0.1  # smallest prominence of limbs, tail and head; tests have at least 0.15, and ears up to 0.06
MAX_EXCHANGED_EXTREMITIES = 8  # largest number of prominent extremities; all of their exchanges are tried
SIGNATURE_WEIGHT = 0.2  # weight of signature differences in costs


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
    count = min(int((extremities.prominences >= MIN_LIMB_PROMINENCE).sum()), MAX_EXCHANGED_EXTREMITIES)
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


MIN_EXAMINED_MARKERS = 10  # smallest number of markers for a registration with meaningful residuals
TRIAL_VERTEX_COUNT = 1200  # number of vertices of the decimated meshes in an examination
TRIAL_STIFFNESS, TRIAL_STEPS = 1e-2, 5  # last stiffness, and number of stiffnesses, of the stiff registration


@dataclass(frozen=True, eq=False)
class Examination:
    """Results of `examine_markers`."""

    suspicions: tuple[Suspicion, ...] = ()  # markers inconsistent with the remaining markers
    residuals: Float | None = None  # (n,) distances of a stiff registration from the markers, in diagonals
    coverage: float = 0.0  # share of the target's area that is covered by the registration
    refusal: str = ""  # error message of the registration; empty without an error

    @property
    def suspects(self) -> frozenset[int]:
        """Ids of all suspicious markers."""
        return frozenset(int(marker) for suspicion in self.suspicions for marker in suspicion.marker_ids)


def examine_markers(source: MeshSequence, target: MeshSequence, markers: Markers) -> Examination:
    """Examine the markers of two meshes in their first frames; problems are returned, not raised as errors."""
    x, y = (np.asarray(sequence.points[0], np.float64) for sequence in (source, target))
    suspicions = tuple(find_suspicious_markers(markers, x[markers.source], y[markers.target]))
    if len(markers) < MIN_EXAMINED_MARKERS:
        return Examination(suspicions)
    source_ids, coarse_source = _decimate_mesh(x, source.faces, np.unique(markers.source))
    target_ids, coarse_target = _decimate_mesh(y, target.faces, np.unique(markers.target))
    coarse = Markers(np.searchsorted(source_ids, markers.source), np.searchsorted(target_ids, markers.target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # stiff registrations have poor matches
        try:
            _, quality = correspond_and_assess(
                coarse_source, coarse_target, coarse, last_stiffness=TRIAL_STIFFNESS, steps=TRIAL_STEPS
            )
        except SettingsError as error:
            return Examination(suspicions, refusal=str(error))
    return Examination(suspicions, quality.marker_distances, quality.target_coverage)


def _decimate_mesh(points: Float, faces: IntArray, keep: Index) -> tuple[Index, MeshSequence]:
    """Decimate a mesh without removing the vertices `keep`; return the remaining vertices ``(n,)`` and the mesh."""
    vertex_ids, coarse_faces = decimate(points, faces.astype(np.int64), TRIAL_VERTEX_COUNT, keep)
    return vertex_ids, MeshSequence.from_arrays(points[None, vertex_ids], coarse_faces)
