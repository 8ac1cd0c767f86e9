r"""Suggest markers of two meshes in the same pose: sure pairs of extremities; and examine markers while they are set.

Limbs, tail, head and ears are found; joints and flanks are for the person to set.

*Distances* along a surface are those of a coarse copy: the decimated largest component, centred, with unit area, so
that lengths on two meshes are comparable in any units. They are along edges, and across hinges: from the vertex
opposite in one face straight to that of the other, both unfolded into a plane. Edges alone overestimate by up to an
eighth more.

*Extremities* (tips of limbs, tail, nose and ears) are the maxima of the area-weighted mean distance along the surface
to all of it (Hilaga et al. 2001), which is least in the trunk, in any pose. The *prominence* of a tip, as of a summit,
is the least descent on the way to a higher one (0-dimensional persistence; Edelsbrunner, Letscher and Zomorodian 2002).
Its surroundings have a heat kernel signature (Sun, Ovsjanikov and Guibas 2009),

.. math:: h_t(v) = \sum_{i \ge 1} e^{-2 t \lambda_i} \phi_i(v)^2 .

*Matching.* First the prominent extremities: limbs, tail, head. Any three of one body may be any three of the other.
Each guess gives a proper similarity from one body to the other, and the cost of every pair,

.. math:: c_{ij} = \|S x_i - y_j\| + \tfrac13 \sum_{k=1}^3 |d_{i\,i_k} - d_{j\,j_k}| ,

the distance of the points, and the differences of their distances along the surface to the three, in roots of the area.
The best assignment follows (Kuhn 1955), and is measured with the similarity of all its pairs and all their distances.
A left-right exchange keeps distances, but needs a mirroring, which a proper similarity excludes. A pair is *sure* by
the additional cost of the best matching without it. Then less prominent extremities, such as ears, are matched alike to
the remaining ones, guided by the pairs found.

*Examining* markers: their consistency, and a map that is found in a second. The map is that of `correspond`, between
decimated meshes and stopped while still stiff: then it cannot reach inconsistent markers, and its distance from them is
their residual. The full map reaches all.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, permutations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.decimation import decimate
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import Suspicion, check_rest, suspicions
from mixseq.retargeting.correspond import CorrespondenceSettings, correspond_and_assess
from mixseq.retargeting.markers import Markers, Similarity, fit_similarity
from mixseq.retargeting.registration import RegistrationSettings
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.public import public
from mixseq.segmentation.silhouettes import Diffusion
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, IntArray

COARSE_VERTICES = 2500
"""Number of vertices of coarse surfaces; of a horse's ears some 20 remain."""


@dataclass(frozen=True, eq=False)
class CoarseSurface:
    """The decimated largest component of a mesh, with unit area."""

    vertices: Index  # (n,) its vertices, as numbered in the mesh
    mesh: TriangleMesh  # the surface
    centre: Float  # (3,) where its origin is, in the mesh's unit
    size: float  # the mesh's units to one of its own

    @classmethod
    def from_mesh(cls, points: FloatArray, topology: Topology, count: int = COARSE_VERTICES) -> CoarseSurface:
        """Decimate the component of points ``(V, 3)`` with the largest area."""
        x = np.asarray(points, np.float64)
        areas = TriangleMesh(x, topology).face_areas
        if not areas.sum() > 0:
            raise SettingsError("no triangle of the mesh has an area; tips and limbs are those of surfaces")
        component = topology.component_of_face
        largest = component == np.bincount(component, areas).argmax()
        own, faces = np.unique(topology.faces[largest].astype(np.int64), return_inverse=True)
        faces = faces.reshape(-1, 3)
        if len(own) > count:
            kept, faces = decimate(x[own], faces, count)
            own = own[kept]
        mesh = TriangleMesh(x[own], Topology(faces, len(own)))
        centre = mesh.face_areas @ mesh.centroids / mesh.face_areas.sum()
        size = float(np.sqrt(mesh.face_areas.sum()))
        return cls(own, TriangleMesh((x[own] - centre) / size, mesh.topology), centre, size)

    @property
    def points(self) -> Float:
        """Points ``(n, 3)`` of the surface, centred, with unit area."""
        return self.mesh.points

    def distances(self, vertices: Index) -> Float:
        """Return distances ``(k, n)`` along the surface from vertices ``(k,)`` to all."""
        return np.asarray(csgraph.dijkstra(self._graph, directed=False, indices=vertices))

    @cached_property
    def _graph(self) -> sparse.csr_array:
        x, topology = self.points, self.mesh.topology
        a, b, c, d = topology.hinges.T
        along = x[b] - x[a]
        length = np.linalg.norm(along, axis=1)
        along = along / np.maximum(length, np.finfo(float).tiny)[:, None]
        # Both opposite vertices in the plane of the unfolded hinge: along its edge, and away from it.
        at_c, at_d = (np.einsum("hi,hi->h", x[e] - x[a], along) for e in (c, d))
        off_c, off_d = (
            np.linalg.norm(x[e] - x[a] - at[:, None] * along, axis=1) for e, at in ((c, at_c), (d, at_d))
        )
        crossing = at_c + (at_d - at_c) * off_c / np.maximum(off_c + off_d, np.finfo(float).tiny)
        inside = (crossing >= 0) & (crossing <= length)
        across = np.hypot(at_d - at_c, off_c + off_d)[inside]
        ends = np.concatenate([topology.edges, np.stack([c, d], axis=1)[inside]])
        lengths = np.concatenate([np.sqrt(self.mesh.squared_lengths), across])
        # Stored zeros are no edges to csgraph, and of two ways between the same vertices the shorter counts.
        lengths = np.maximum(lengths, 1e-12)
        ends.sort(axis=1)
        order = np.lexsort((lengths, ends[:, 1], ends[:, 0]))
        ends, first = np.unique(ends[order], axis=0, return_index=True)
        return sparse.csr_array((lengths[order][first], (ends[:, 0], ends[:, 1])), shape=2 * (len(x),))


SAMPLES = 100
"""Number of far-apart points for the mean distance."""

LEAST = 0.004
"""Prominence, in roots of the area, below which a maximum may be noise; ears have 0.006 to 0.05."""

HEAT_TIMES = np.geomspace(0.002, 0.1, 6)
"""Times of heat kernel signatures, in units of the area: from ears to limbs."""

FALL, FLAT = 0.01, 0.25
"""Fall of the mean distance at which an extremity ends, and the search radius for it."""

EIGENVECTORS = 80
"""Number of eigenvectors of signatures; later ones have decayed at the first of the times."""


@dataclass(frozen=True, eq=False)
class Extremities:
    """Extremities of a surface, the most prominent first."""

    vertices: Index  # (e,) where they are, as numbered in the mesh
    points: Float  # (e, 3) the same, in the unit of the coarse surface
    prominences: Float  # (e,) their prominences; all lengths are in roots of the area
    # (e,) how far from it the mean distance is as large but for 0.01: 0.02 to 0.07 of a hoof; a round head has more, so
    # that where its tip is remains open.
    radii: Float
    distances: Float  # (e, e) distances along the surface between them
    signatures: Float  # (e, 6) logarithms of their heat kernel signatures

    @classmethod
    def from_surface(cls, surface: CoarseSurface) -> Extremities:
        """Find the extremities of a surface."""
        values = mean_distance(surface)
        peaks, prominences = maxima(values, surface)
        peaks, prominences = peaks[prominences >= LEAST], prominences[prominences >= LEAST]
        diffusion = Diffusion(surface.points, surface.mesh.topology)
        signatures = np.log(diffusion.heat_kernel(HEAT_TIMES, EIGENVECTORS)[peaks])
        distances = surface.distances(peaks)
        flat = (values >= values[peaks, None] - FALL) & (distances < FLAT)
        radii = np.where(flat, distances, 0.0).max(axis=1)
        places = surface.vertices[peaks], surface.points[peaks]
        return cls(*places, prominences, radii, distances[:, peaks], signatures)


def far_apart(surface: CoarseSurface, count: int) -> tuple[Index, Float]:
    """Choose vertices ``(k,)`` far from each other (Gonzalez 1985), with their distances ``(k, n)``."""
    sample = int(surface.distances(np.array([0]))[0].argmax())
    samples: list[int] = []
    rows: list[Float] = []
    nearest = np.full(len(surface.vertices), np.inf)
    for _ in range(min(count, len(surface.vertices))):
        samples.append(sample)
        rows.append(surface.distances(np.array([sample]))[0])
        nearest = np.minimum(nearest, rows[-1])
        sample = int(nearest.argmax())
    return np.array(samples), np.array(rows)


def mean_distance(surface: CoarseSurface) -> Float:
    """Return the mean distance ``(n,)`` of every vertex along a surface to all of it."""
    distances = far_apart(surface, SAMPLES)[1]
    areas = np.bincount(distances.argmin(axis=0), surface.mesh.vertex_areas, len(distances))
    return np.asarray(areas @ distances / areas.sum())


def maxima(values: Float, surface: CoarseSurface) -> tuple[Index, Float]:
    """Find the maxima ``(m,)`` of values ``(n,)`` on a surface, with their prominences ``(m,)``."""
    adjacency = surface.mesh.topology.vertex_adjacency.tocsr()
    peak = np.full(len(values), -1)  # of the island that a vertex is on, while the sea falls
    islands: dict[int, list[int]] = {}
    found: list[tuple[int, float]] = []
    for vertex in np.argsort(-values, kind="stable").tolist():
        around = adjacency.indices[adjacency.indptr[vertex] : adjacency.indptr[vertex + 1]]
        joined = sorted({int(each) for each in peak[around] if each >= 0}, key=lambda each: -values[each])
        highest = joined[0] if joined else vertex
        islands.setdefault(highest, []).append(vertex)
        peak[vertex] = highest
        for lower in joined[1:]:
            found.append((lower, float(values[lower] - values[vertex])))
            members = islands.pop(lower)
            peak[members] = highest
            islands[highest] += members
    found += [(highest, float(values[highest] - values.min())) for highest in islands]
    found.sort(key=lambda each: (-each[1], each[0]))
    return np.array([vertex for vertex, _ in found]), np.array([prominence for _, prominence in found])


PROMINENT = 0.1
"""Prominence of limbs, tail and head, in roots of the area; tried bodies have 0.15 and more, ears less than 0.06."""

MOST = 8
"""Largest number of prominent extremities that are matched, as all triples are tried."""

LEFT_OUT = 0.5
"""Cost of an extremity without a partner."""

UNLIKE = 0.5
"""Largest difference of mutual distances between the triples of a guess."""

SURE = 0.1
"""Additional cost of the best matching without a sure pair."""

LARGEST_COST = 0.4
"""Largest mean cost of the pairs of two similar bodies; horse and camel have 0.26."""

SMALL_COST, CLEARER = 0.18, 1.25
"""Largest cost of a less prominent pair, and least ratio of the next best partner's cost to it."""

BLUNT = 0.08
"""Radius above which an extremity is on the right limb, but perhaps at another place of it."""

NEAR = 0.3
"""Distance below which prominent extremities guide less prominent ones."""

HEAT = 0.2
"""Weight of differences of signatures."""


@dataclass(frozen=True)
class Matched:
    """A pair of extremities, and its certainty."""

    first: int  # number of the extremity of the first body
    second: int  # number of the extremity of the second body
    margin: float  # additional cost of the best other matching


def match_extremities(first: Extremities, second: Extremities) -> list[Matched]:
    """Match the extremities of two bodies."""
    prominent = _prominent_pairs(first, second)
    if len(prominent) < 4:  # which could be turned at will
        return []
    sharp = [each for each in prominent if max(first.radii[each.first], second.radii[each.second]) <= BLUNT]
    return sharp + _other_pairs(first, second, prominent)


def _prominent_pairs(first: Extremities, second: Extremities) -> list[Matched]:
    one, two = (np.flatnonzero(each.prominences >= PROMINENT)[:MOST] for each in (first, second))
    matchings: dict[tuple[tuple[int, int], ...], float] = {}
    for guess in combinations(one.tolist(), 3):
        for other in permutations(two.tolist(), 3):
            pairs = _guessed(first, second, one, two, np.array(guess), np.array(other))
            if pairs is not None and pairs not in matchings:
                matchings[pairs] = _cost(first, second, pairs) + LEFT_OUT * (len(one) - len(pairs))
    if not matchings:
        return []
    best = min(matchings, key=lambda pairs: (matchings[pairs], pairs))
    if _cost(first, second, best) > LARGEST_COST * len(best):
        return []
    sure = []
    for pair in best:
        others = [cost for pairs, cost in matchings.items() if pair not in pairs]
        margin = min(others, default=np.inf) - matchings[best]
        if margin >= SURE:
            sure.append(Matched(*pair, float(margin)))
    return sorted(sure, key=lambda each: -each.margin)


def _guessed(
    first: Extremities, second: Extremities, one: Index, two: Index, guess: Index, other: Index
) -> tuple[tuple[int, int], ...] | None:
    """Return the matching that follows from three pairs, if these are similar."""
    from scipy.optimize import linear_sum_assignment

    apart = first.distances[np.ix_(guess, guess)] - second.distances[np.ix_(other, other)]
    if np.abs(apart).max() > UNLIKE:
        return None
    try:
        moved = fit_similarity(first.points[guess], second.points[other])(first.points[one])
    except SettingsError:  # one is upside down against the other
        return None
    away = np.linalg.norm(moved[:, None] - second.points[two], axis=2)
    along = np.abs(first.distances[np.ix_(one, guess)][:, None] - second.distances[np.ix_(two, other)]).mean(
        axis=2
    )
    rows, columns = linear_sum_assignment(away + along)
    return tuple(zip(one[rows].tolist(), two[columns].tolist(), strict=True))


def _cost(first: Extremities, second: Extremities, pairs: tuple[tuple[int, int], ...]) -> float:
    one, two = np.array(pairs).T
    try:
        moved = fit_similarity(first.points[one], second.points[two])(first.points[one])
    except SettingsError:
        return np.inf
    along = np.abs(first.distances[np.ix_(one, one)] - second.distances[np.ix_(two, two)]).mean(axis=1)
    return float((np.linalg.norm(moved - second.points[two], axis=1) + along).sum())


def _other_pairs(first: Extremities, second: Extremities, pairs: list[Matched]) -> list[Matched]:
    """Match less prominent extremities: both are each other's best by far."""
    one, two = np.array([(pair.first, pair.second) for pair in pairs]).T
    rest, left = (
        np.setdiff1d(np.arange(len(each.points)), done) for each, done in ((first, one), (second, two))
    )
    if not (len(rest) and len(left)):
        return []
    moved = _led(first, fit_similarity(first.points[one], second.points[two]), one, second.points[two])
    costs = (
        np.linalg.norm(moved[rest][:, None] - second.points[left], axis=2)
        + np.abs(first.distances[np.ix_(rest, one)][:, None] - second.distances[np.ix_(left, two)]).mean(
            axis=2
        )
        + HEAT * np.abs(first.signatures[rest][:, None] - second.signatures[left]).mean(axis=2)
    )
    found = []
    for row, column in enumerate(costs.argmin(axis=1)):
        cost = costs[row, column]
        others = np.concatenate([np.delete(costs[row], column), np.delete(costs[:, column], row)])
        next_best = others.min(initial=np.inf)
        if cost <= SMALL_COST and next_best >= CLEARER * cost:
            found.append(Matched(int(rest[row]), int(left[column]), float(next_best - cost)))
    return sorted(found, key=lambda each: -each.margin)


def _led(first: Extremities, similarity: Similarity, pairs: Index, goals: Float) -> Float:
    """Move all extremities ``(e, 3)`` by a similarity, and by its residuals at nearby pairs."""
    moved = similarity(first.points)
    weights = np.exp(-((first.distances[:, pairs] / NEAR) ** 2)) + 1e-6
    return np.asarray(moved + weights @ (goals - moved[pairs]) / weights.sum(axis=1, keepdims=True))


MIN_EXAMINED_MARKERS = 10
"""Least number of markers for a map with meaningful residuals."""

TRIAL_VERTICES = 1200
"""Number of vertices of the decimated meshes."""

STIFF = CorrespondenceSettings(RegistrationSettings(softest=1e-2, steps=5))


@dataclass(frozen=True, eq=False)
class Examination:
    """Results of examining markers."""

    suspicions: tuple[Suspicion, ...] = ()  # markers inconsistent with the others
    # (n,) how far a stiff map stays from every marker, in diagonals of the target; none if there are fewer than ten, or
    # no map was found.
    residuals: Float | None = None
    coverage: float = 0.0  # share of the target's area covered by the map
    refusal: str = ""  # why there is no map; empty otherwise

    @property
    def suspects(self) -> frozenset[int]:
        """Numbers of the markers that do not fit the others."""
        return frozenset(int(marker) for suspicion in self.suspicions for marker in suspicion.marker_ids)


def examine_markers(source: MeshSequence, target: MeshSequence, markers: Markers) -> Examination:
    """Examine markers of two meshes, each in its first frame; problems are returned, not raised."""
    x, y = (np.asarray(each.points[0], np.float64) for each in (source, target))
    diagonal = float(np.linalg.norm(np.ptp(y, axis=0)))
    found = tuple(suspicions(markers, x[markers.source], y[markers.target], diagonal))
    if len(markers) < MIN_EXAMINED_MARKERS:
        return Examination(found)
    own, first = _thinned(x, source.faces, np.unique(markers.source))
    other, second = _thinned(y, target.faces, np.unique(markers.target))
    coarse = Markers(np.searchsorted(own, markers.source), np.searchsorted(other, markers.target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # suspicions are reported, and the map is a stiff one
        try:
            _, quality = correspond_and_assess(first, second, coarse, settings=STIFF)
        except SettingsError as error:
            return Examination(found, refusal=str(error))
    return Examination(found, quality.marker_distances, quality.target_coverage)


def _thinned(points: Float, faces: IntArray, keep: Index) -> tuple[Index, MeshSequence]:
    """Return the remaining vertices ``(n,)`` of a mesh, and a mesh of them."""
    kept, coarse = decimate(points, faces.astype(np.int64), TRIAL_VERTICES, keep)
    return kept, MeshSequence.from_arrays(points[None, kept], coarse)


@public
def suggest_markers(source: MeshSequence, target: MeshSequence, rest: int = 0) -> Markers:
    """Suggest markers: tips of limbs, tails, noses and ears, as far as it is sure which is which.

    Both meshes stand in about the same pose, in any orientation and size.

    Parameters
    ----------
    source : MeshSequence
        The mesh that moves.
    target : MeshSequence
        The mesh that shall move like it; its first frame is used.
    rest : int
        The frame of the source whose pose is most like the target's.

    Returns
    -------
    Markers
        Pairs of vertices, those of limbs, tail and head first, each the surest first; none if nothing is sure, as of
        bodies without limbs, or of two different bodies.

    Raises
    ------
    SettingsError
        If the frame does not exist, or a mesh has no area.
    """
    check_rest(source, rest)
    with one_blas_thread():
        own, other = _extremities(source, rest), _extremities(target, 0)
    pairs = match_extremities(own, other)
    return Markers.from_pairs(
        np.array([(own.vertices[each.first], other.vertices[each.second]) for each in pairs], np.int64)
    )


def _extremities(sequence: MeshSequence, frame: int) -> Extremities:
    topology = Topology(sequence.faces, sequence.vertex_count)
    return Extremities.from_surface(CoarseSurface.from_mesh(sequence.points[frame], topology))
