r"""Suggest markers of two meshes in the same pose by their extremities, mirror and examine markers while they are set.

*Distances* along a surface are measured on a coarse copy: the decimated largest component, centred, with unit area, so
that lengths on two meshes are comparable. Paths follow edges, or cross a hinge between its opposite vertices on a
straight line in the unfolded faces. With edges alone, distances would be up to an eighth longer.

*Extremities* (tips of limbs, tail, nose and ears) are maxima of the mean distance along the surface to all vertices
(Hilaga et al. 2001), which is smallest in the trunk, in any pose. The *prominence* of a maximum is the least descent on
a path to a higher maximum (0-dimensional persistence; Edelsbrunner, Letscher and Zomorodian 2002). The surroundings
of an extremity are described by the heat kernel signature (Sun, Ovsjanikov and Guibas 2009),

.. math:: h_t(v) = \sum_{i \ge 1} e^{-2 t \lambda_i} \phi_i(v)^2 .

*Matching* starts with the prominent extremities: limbs, tail, head. All pairs of triples of both bodies are tried. Each
pair of triples determines a proper similarity S between the bodies, and the cost of matching i with j,

.. math:: c_{ij} = \|S x_i - y_j\| + \tfrac13 \sum_{k=1}^3 |d_{i\,i_k} - d_{j\,j_k}| ,

the distance of the points plus the mean difference of their surface distances to the triples, in roots of the area. The
best assignment (Kuhn 1955) of all extremities of the body that has fewer gets a new cost, from the similarity and the
surface distances of all its pairs. A left-right exchange preserves distances but needs a reflection, which a proper
similarity excludes. The *margin* of a pair is the additional cost of the best matching without this pair. Then less
prominent extremities, such as ears, are matched with similar costs, guided by the matched pairs.

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
from itertools import combinations, permutations
from typing import cast

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.decimation import decimate
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import Suspicion, check_rest_frame, find_suspicious_markers
from mixseq.retargeting.correspond import correspond_and_assess
from mixseq.retargeting.markers import Markers, Similarity, fit_similarity
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import FileOr, HasFrames, public
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
    return topology.faces[is_largest].astype(np.int64)


DISTANCE_SAMPLES = 100  # number of sample vertices for the mean distance
MIN_PROMINENCE = 0.004  # smallest prominence of an extremity, in roots of the area; ears have 0.006 to 0.05
HEAT_TIMES = np.geomspace(0.002, 0.1, 6)  # times of signatures, in units of the area; for sizes from ears to limbs
EXTREMITY_FALL = 0.01  # largest decrease of the mean distance within an extremity, in roots of the area
MAX_EXTREMITY_RADIUS = 0.25  # largest radius of an extremity, in roots of the area
SIGNATURE_EIGENVECTORS = 80  # number of eigenvectors; higher ones have decayed at the first time


@dataclass(frozen=True, eq=False)
class Extremities:
    """Extremities of a surface, the most prominent first; lengths are in roots of the area."""

    vertices: Index  # (e,) vertices of the mesh at the extremities
    points: Float  # (e, 3) positions on the coarse surface
    prominences: Float  # (e,) prominences of the extremities
    radii: Float  # (e,) radii of regions of nearly equal mean distance: 0.02 to 0.07 for hooves, more for round heads
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
        distances = surface.distances(peak_ids)
        is_tip = mean_distances >= mean_distances[peak_ids, None] - EXTREMITY_FALL
        radii = np.where(is_tip & (distances < MAX_EXTREMITY_RADIUS), distances, 0.0).max(axis=1)
        vertices, points = surface.vertices[peak_ids], surface.points[peak_ids]
        return cls(vertices, points, prominences, radii, distances[:, peak_ids], signatures)


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
MAX_MATCHED_EXTREMITIES = 8  # largest number of prominent extremities; all of their triples are tried
MAX_TRIPLE_DISTANCE_DIFFERENCE = 0.5  # largest difference of distances between two matched triples
MIN_SURE_MARGIN = 0.1  # smallest margin of a suggested pair
MAX_MEAN_PAIR_COST = 0.4  # largest mean cost of the pairs of two similar bodies; horse and camel have 0.26
MAX_MINOR_PAIR_COST = 0.18  # largest cost of a less prominent pair
MIN_NEXT_COST_RATIO = 1.25  # smallest ratio of the next best cost to the cost of a less prominent pair
MAX_SHARP_RADIUS = 0.08  # largest radius of a suggested extremity; blunter ones have no well-defined tip
GUIDANCE_RADIUS = 0.3  # distance over which prominent extremities guide less prominent ones
SIGNATURE_WEIGHT = 0.2  # weight of signature differences in costs


Matching = tuple[tuple[int, int], ...]
"""Matched extremities of two bodies, as ids of each body."""


@dataclass(frozen=True)
class ExtremityPair:
    """A matched pair of extremities."""

    first: int  # id of an extremity of the first body
    second: int  # id of an extremity of the second body
    margin: float  # additional cost of the best matching without this pair


def match_extremities(first: Extremities, second: Extremities) -> list[ExtremityPair]:
    """Match the extremities of two bodies."""
    pairs = _match_prominent(first, second)
    if len(pairs) < 4:  # too few to determine an orientation
        return []
    sharp = [pair for pair in pairs if max(first.radii[pair.first], second.radii[pair.second]) <= MAX_SHARP_RADIUS]
    return sharp + _match_minor(first, second, pairs)


def _match_prominent(first: Extremities, second: Extremities) -> list[ExtremityPair]:
    """Match prominent extremities, and return the pairs by decreasing margin."""
    first_ids, second_ids = (
        np.flatnonzero(body.prominences >= MIN_LIMB_PROMINENCE)[:MAX_MATCHED_EXTREMITIES] for body in (first, second)
    )
    matchings: dict[Matching, float] = {}
    for first_triple in combinations(first_ids.tolist(), 3):
        for second_triple in permutations(second_ids.tolist(), 3):
            triples = np.array(first_triple), np.array(second_triple)
            pairs = _match_from_triples(first, second, (first_ids, second_ids), triples)
            if pairs is not None and pairs not in matchings:
                matchings[pairs] = _matching_cost(first, second, pairs)
    if not matchings:
        return []
    best = min(matchings, key=lambda pairs: (matchings[pairs], pairs))
    if matchings[best] > MAX_MEAN_PAIR_COST * len(best):
        return []
    sure_pairs = []
    for pair in best:
        other_costs = [cost for pairs, cost in matchings.items() if pair not in pairs]
        margin = min(other_costs, default=np.inf) - matchings[best]
        if margin >= MIN_SURE_MARGIN:
            sure_pairs.append(ExtremityPair(*pair, float(margin)))
    return sorted(sure_pairs, key=lambda pair: -pair.margin)


def _match_from_triples(
    first: Extremities, second: Extremities, ids: tuple[Index, Index], triples: tuple[Index, Index]
) -> Matching | None:
    """Return the matching of extremities guided by a triple of each body, or None if the triples are not similar."""
    from scipy.optimize import linear_sum_assignment

    (first_ids, second_ids), (a, b) = ids, triples
    differences = first.distances[np.ix_(a, a)] - second.distances[np.ix_(b, b)]
    if np.abs(differences).max() > MAX_TRIPLE_DISTANCE_DIFFERENCE:
        return None
    try:
        mapped = fit_similarity(first.points[a], second.points[b])(first.points[first_ids])
    except SettingsError:  # the triples have opposite orientations
        return None
    point_distances = np.linalg.norm(mapped[:, None] - second.points[second_ids], axis=2)
    costs = point_distances + _distance_differences(first, second, ids, triples)
    rows, columns = linear_sum_assignment(costs)
    return tuple(zip(first_ids[rows].tolist(), second_ids[columns].tolist(), strict=True))


def _distance_differences(
    first: Extremities, second: Extremities, ids: tuple[Index, Index], references: tuple[Index, Index]
) -> Float:
    """Return the mean difference ``(n, m)`` of distances to matched references for every pair of extremities."""
    to_references = first.distances[np.ix_(ids[0], references[0])]
    differences = to_references[:, None] - second.distances[np.ix_(ids[1], references[1])]
    return np.asarray(np.abs(differences).mean(axis=2))


def _matching_cost(first: Extremities, second: Extremities, pairs: Matching) -> float:
    """Return the total cost of matched pairs; infinite if the pairs need a reflection."""
    a, b = np.array(pairs).T
    try:
        mapped = fit_similarity(first.points[a], second.points[b])(first.points[a])
    except SettingsError:
        return np.inf
    differences = np.abs(first.distances[np.ix_(a, a)] - second.distances[np.ix_(b, b)]).mean(axis=1)
    return float((np.linalg.norm(mapped - second.points[b], axis=1) + differences).sum())


def _match_minor(first: Extremities, second: Extremities, pairs: list[ExtremityPair]) -> list[ExtremityPair]:
    """Match the remaining extremities that are each other's best partners by a clear margin."""
    a, b = np.array([(pair.first, pair.second) for pair in pairs]).T
    first_rest = np.setdiff1d(np.arange(len(first.points)), a)
    second_rest = np.setdiff1d(np.arange(len(second.points)), b)
    if not (len(first_rest) and len(second_rest)):
        return []
    similarity = fit_similarity(first.points[a], second.points[b])
    mapped = _guided_positions(first, similarity, a, second.points[b])
    signature_differences = np.abs(first.signatures[first_rest][:, None] - second.signatures[second_rest])
    costs = (
        np.linalg.norm(mapped[first_rest][:, None] - second.points[second_rest], axis=2)
        + _distance_differences(first, second, (first_rest, second_rest), (a, b))
        + SIGNATURE_WEIGHT * signature_differences.mean(axis=2)
    )
    minor_pairs = []
    for row, column in enumerate(costs.argmin(axis=1)):
        cost = costs[row, column]
        other_costs = np.concatenate([np.delete(costs[row], column), np.delete(costs[:, column], row)])
        next_best = other_costs.min(initial=np.inf)
        if cost <= MAX_MINOR_PAIR_COST and next_best >= MIN_NEXT_COST_RATIO * cost:
            margin = float(next_best - cost)
            minor_pairs.append(ExtremityPair(int(first_rest[row]), int(second_rest[column]), margin))
    return sorted(minor_pairs, key=lambda pair: -pair.margin)


def _guided_positions(first: Extremities, similarity: Similarity, paired_ids: Index, goals: Float) -> Float:
    """Map all extremities ``(e, 3)`` by a similarity, and add its weighted mean residual at nearby pairs."""
    mapped = similarity(first.points)
    weights = np.exp(-((first.distances[:, paired_ids] / GUIDANCE_RADIUS) ** 2)) + 1e-6
    return np.asarray(mapped + weights @ (goals - mapped[paired_ids]) / weights.sum(axis=1, keepdims=True))


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
    diagonal = float(np.linalg.norm(np.ptp(y, axis=0)))
    suspicions = tuple(find_suspicious_markers(markers, x[markers.source], y[markers.target], diagonal))
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


@public
def suggest_markers(
    source: FileOr[MeshSequence | HasFrames], target: FileOr[MeshSequence | HasFrames], rest: int = 0
) -> Markers:
    """Suggest markers at corresponding tips of limbs, tails, noses and ears.

    Both meshes are in about the same pose, in any orientation and size.

    Parameters
    ----------
    source : MeshSequence
        Mesh whose motion is transferred.
    target : MeshSequence
        Mesh that receives the motion; its first frame is used.
    rest : int
        Frame of the source with a pose like the target's.

    Returns
    -------
    Markers
        Pairs of vertices: first limbs, tail and head, then smaller extremities, each by decreasing certainty. The
        result is empty for bodies without limbs, and for very different bodies.

    Raises
    ------
    SettingsError
        If the frame does not exist, or a mesh has no area.

    Examples
    --------
    >>> import mixseq
    >>> markers = mixseq.suggest_markers("arm.usdc", "long.obj")
    >>> len(markers.source) == len(markers.target)
    True
    """
    source = cast("MeshSequence", source)
    target = cast("MeshSequence", target)
    check_rest_frame(source, rest)
    with one_blas_thread():
        first, second = _find_extremities(source, rest), _find_extremities(target, 0)
    pairs = match_extremities(first, second)
    vertices = [(first.vertices[pair.first], second.vertices[pair.second]) for pair in pairs]
    return Markers.from_pairs(np.array(vertices, np.int64))


def _find_extremities(sequence: MeshSequence, frame: int) -> Extremities:
    topology = Topology(sequence.faces, sequence.vertex_count)
    return Extremities.from_surface(CoarseSurface.from_mesh(sequence.points[frame], topology))
