r"""Deform a source mesh onto a target, guided by markers: non-rigid registration.

The source is first aligned by the similarity between the markers (Umeyama 1991). Then the `Energy` of a deformation is
minimised for decreasing stiffness :math:`\alpha` (Amberg, Romdhani, Vetter 2007, *Optimal Step Nonrigid ICP Algorithms
for Surface Registration*). Its constraints are

- the markers, which are used alone in the first rounds;
- every source vertex, attracted to the closest point of the target that faces the same way;
- every target vertex, which attracts the closest point of the source that faces the same way, so that long features
  (humps, ears, hooves) are covered.

*The energy.* Unknowns are the new position p_i of every vertex i, and an affine map A_i of its neighbourhood. This form
(embedded deformation, Sumner, Schmid and Pauly 2007) does not depend on the origin. With edges
:math:`e_{ij} = x_j - x_i`,

.. math::
    E = \alpha \Bigl[ \sum_{ij} \frac{w_{ij}}{2} \bigl( \|p_j - p_i - A_i e_{ij}\|^2 + \|p_i - p_j - A_j e_{ji}\|^2
        \bigr) + \ell^2 \sum_{ij} w_{ij} \|A_i - A_j\|^2 + \mu \sum_i a_i \|A_i - S_i\|^2 \Bigr]
        + \sum_t b_t \Bigl\| \sum_k \beta_{tk} p_{tk} - y_t \Bigr\|^2 .

The terms in brackets let neighbours move together, and let maps vary slowly near given similarities :math:`S_i`. The
last sum has the soft constraints: points on triangles are attracted to goals y, with weights b. Areas a add to one, and
:math:`w_{ij}` is the area at an edge over half its squared length. So E hardly depends on the mesh density.

E is quadratic, with one matrix for all three coordinates. Constraints and edges only couple corners of the same
triangle, so the sparsity pattern of the matrix is constant and analysed once.

*Two levels.* While stiff, the source is decimated and the target sampled. All vertices then start from the deformation
of the decimated source at their closest points, :math:`\sum_k \beta_k (p_k + A_k (x - x_k))`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.mesh.box_tree import BoxTree, triangle_corners
from mixseq.mesh.decimation import decimate
from mixseq.mesh.nearest import ClosestPointQuery
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Markers, Pairing, align_similarly
from mixseq.runtime.progress import Progress, log_progress
from mixseq.shells.solvers import Analysis, Factor, analyse
from mixseq.types import Float, Index, IntArray

BENDING_LENGTH = 0.1  # l: length over which affine maps are similar, in diagonals of the target
SHEAR_WEIGHT = 0.1  # mu: weight that attracts affine maps to similarities
_EDGE_WEIGHT_BOUNDS = 0.05, 20.0  # bounds of w_ij, which limit the influence of slivers; regular meshes have 0.6
_MIN_VERTEX_AREA_RATIO = 1e-6  # lower bound of a_i, relative to the mean; determines maps of components without area


@dataclass(frozen=True, eq=False)
class SoftConstraints:
    """Soft position constraints of points on a mesh."""

    corners: IntArray  # (n, k) vertices of each point: one, or the corners of a triangle
    barycentric: Float  # (n, k) barycentric weights of the corners, which add to one
    goals: Float  # (n, 3) goal positions
    weights: Float  # (n,) weights of the squared distances from the goals


@dataclass(frozen=True, eq=False)
class Energy:
    """Deformation energy of a mesh, which has a positive area and no unused vertices."""

    mesh: TriangleMesh  # the undeformed mesh, in diagonals of the target

    @cached_property
    def areas(self) -> Float:
        """Areas ``(V,)`` around the vertices, relative to the area of the mesh."""
        areas = self.mesh.vertex_areas
        return np.asarray(np.maximum(areas / areas.sum(), _MIN_VERTEX_AREA_RATIO / len(areas)))

    @cached_property
    def _matrix(self) -> sparse.csc_array:
        """Lower triangle ``(4 V, 4 V)`` of the matrix of the bracket, for p_i and a row of A_i at each vertex."""
        x = self.mesh.points
        i, j = self.mesh.topology.edges.T
        # Twice a third of the triangle areas at an edge, divided by its squared length.
        weights = 2 * self.mesh.edge_areas / np.maximum(self.mesh.squared_lengths, 1e-20)
        weights = np.clip(weights, *_EDGE_WEIGHT_BOUNDS) / self.mesh.vertex_areas.sum()
        edge_terms = [
            [(4 * b, 1.0), (4 * a, -1.0), *((4 * a + 1 + d, x[a, d] - x[b, d]) for d in range(3))]
            for a, b in ((i, j), (j, i))
        ]
        map_terms = [[(4 * i + 1 + d, BENDING_LENGTH), (4 * j + 1 + d, -BENDING_LENGTH)] for d in range(3)]
        similarity_weights = np.outer(self.areas, [0.0, *3 * [SHEAR_WEIGHT]]).reshape(-1)
        total = sparse.diags_array(similarity_weights).tocsr()
        for terms, scale in ((edge_terms, 0.5), (map_terms, 1.0)):
            for row in terms:
                difference = _difference_rows(row, np.sqrt(scale * weights), 4 * len(x))
                total = total + difference.T @ difference
        lower = sparse.csc_array(sparse.tril(total))
        lower.sort_indices()
        return lower

    @cached_property
    def _analysis(self) -> Analysis:
        return analyse(self._matrix.indptr.astype(np.int64), self._matrix.indices.astype(np.int64))

    @cached_property
    def _keys(self) -> Index:
        """Column and row of every stored entry as one ascending key."""
        size = self._matrix.shape[0]
        columns = np.repeat(np.arange(size), np.diff(self._matrix.indptr))
        return np.asarray(columns * size + self._matrix.indices)

    def minimise(
        self, stiffness: float, maps: Float, constraints: list[SoftConstraints], before: Deformation | None = None
    ) -> Deformation:
        """Return the deformation of least energy near the similarities of `maps`.

        The factor of a deformation `before`, of the same stiffness, preconditions a few conjugate gradients from there.
        """
        vertex_count, unknown_count = len(maps), 4 * len(maps)
        values = stiffness * self._matrix.data
        right_side = np.zeros((vertex_count, 4, 3))
        for constraint in constraints:
            weighted = constraint.barycentric * constraint.weights[:, None]
            corners = constraint.corners.astype(np.int64)  # keys have more than 32 bits
            for k in range(corners.shape[1]):
                rows = corners[:, k]
                for c in range(3):
                    moments = weighted[:, k] * constraint.goals[:, c]
                    right_side[:, 0, c] += np.bincount(rows, moments, minlength=vertex_count)
                for other in range(corners.shape[1]):
                    columns = corners[:, other]
                    if other == k:  # on the diagonal, the first entry of a column
                        lower, places = np.arange(len(rows)), self._matrix.indptr[4 * rows].astype(np.int64)
                    else:
                        lower = np.flatnonzero(rows >= columns)
                        keys = 4 * columns[lower] * unknown_count + 4 * rows[lower]
                        places = np.searchsorted(self._keys, keys)
                    products = weighted[lower, k] * constraint.barycentric[lower, other]
                    values += np.bincount(places, products, minlength=len(values))
        similarities = nearest_similarities(maps).transpose(0, 2, 1)
        right_side[:, 1:] = stiffness * SHEAR_WEIGHT * self.areas[:, None, None] * similarities
        flat = right_side.reshape(unknown_count, 3)
        factor = self._analysis.factor(values) if before is None else before.factor
        unknowns = factor.solve(flat) if before is None else self._refine(before, values, flat)
        solution = unknowns.reshape(vertex_count, 4, 3)
        return Deformation(solution[:, 0].copy(), solution[:, 1:].transpose(0, 2, 1).copy(), factor)

    def _refine(self, before: Deformation, values: Float, right_side: Float) -> Float:
        """Return unknowns ``(4 V, 3)`` after `REFINEMENT_STEPS` preconditioned conjugate gradients per coordinate."""
        lower = sparse.csc_array((values, self._matrix.indices, self._matrix.indptr), self._matrix.shape)
        diagonal = values[self._matrix.indptr[:-1], None]
        unknowns = np.concatenate([before.points[:, None], before.maps.transpose(0, 2, 1)], axis=1).reshape(-1, 3)

        def multiply(x: Float) -> Float:
            return np.asarray(lower @ x + lower.T @ x - diagonal * x)

        residual, direction, previous = right_side - multiply(unknowns), np.zeros_like(unknowns), np.full(3, np.inf)
        tiny = np.finfo(float).tiny  # where a coordinate has no residual, as that across a flat mesh
        for _ in range(REFINEMENT_STEPS):
            correction = before.factor.solve(residual)
            current = (residual * correction).sum(axis=0)
            direction = correction + current / np.maximum(previous, tiny) * direction
            product = multiply(direction)
            step = current / np.maximum((direction * product).sum(axis=0), tiny)
            unknowns, residual, previous = unknowns + step * direction, residual - step * product, current
        return unknowns


class Deformation(NamedTuple):
    """A deformation of a mesh, and the factored matrix that it is from."""

    points: Float  # (V, 3) new positions
    maps: Float  # (V, 3, 3) affine maps of the neighbourhoods
    factor: Factor


def nearest_similarities(maps: Float) -> Float:
    """Return the proper similarities ``(n, 3, 3)`` nearest to maps ``(n, 3, 3)`` in the Frobenius norm."""
    rotations = nearest_rotations(maps)
    scales = np.einsum("nij,nij->n", rotations, maps) / 3
    return np.asarray(rotations * np.maximum(scales, 0.0)[:, None, None])


def _difference_rows(terms: Sequence[tuple[Index, Float | float]], scales: Float, size: int) -> sparse.csr_array:
    """Return sparse rows ``(n, size)`` of scaled sums; every term has columns ``(n,)`` and coefficients."""
    row_count = len(scales)
    columns = np.concatenate([column for column, _ in terms])
    values = np.concatenate([np.broadcast_to(value, row_count) * scales for _, value in terms])
    entries = np.tile(np.arange(row_count), len(terms)), columns
    return sparse.coo_array((values, entries), (row_count, size)).tocsr()


FIRST_STIFFNESS, LAST_STIFFNESS = 1.0, 1e-5  # results on horse to camel and cat to lion hardly depend on these values
STIFFNESS_STEPS = 10  # number of stiffnesses, evenly spaced in their logarithm
ROUNDS_PER_STEP = 2  # rounds of closest points per stiffness
FINE_STEPS = 3  # number of last stiffnesses with all vertices; before, the source is decimated and the target sampled
COARSE_VERTICES = 3000  # number of vertices of the decimated source, and about that of the sampled target
REFINEMENT_STEPS = 2  # conjugate gradients of a stiffness's second round; 1 is too few for 39 markers of cat and lion
MARKER_ONLY_ROUNDS = 3  # number of minimisations with markers alone, which update the similarities
MARKER_WEIGHT = 1.0  # total weight of markers; the vertices of each surface have a total weight of 1
MAX_NORMAL_ANGLE_DEGREES = 60.0  # largest angle between normals of closest points
FIRST_SEARCH_DIAGONALS, LAST_SEARCH_DIAGONALS = 0.1, 0.02  # search radii at the first and at the last stiffness


def register(
    source: TriangleMesh,
    target: TriangleMesh,
    pairings: tuple[Pairing, ...],
    markers: Markers,
    progress: Progress = log_progress,
    last_stiffness: float = LAST_STIFFNESS,
    steps: int = STIFFNESS_STEPS,
) -> Float:
    """Deform the paired components of a source onto a target in a similar pose; return the vertices ``(V, 3)``."""
    similar = align_similarly(source.points, source.points[markers.source], target.points[markers.target])
    # Centred coordinates in diagonals of the target avoid rounding errors far from the origin.
    diagonal, centre = target.diagonal, target.centroids.mean(axis=0)
    aligned = TriangleMesh((similar - centre) / diagonal, source.topology)
    normalised_target = TriangleMesh((target.points - centre) / diagonal, target.topology)
    fine = DataTerm.from_pairings(aligned, normalised_target, pairings, markers)
    term = fine.decimated()
    energy = Energy(term.mesh)
    stiffnesses = np.repeat(np.geomspace(FIRST_STIFFNESS, last_stiffness, steps), ROUNDS_PER_STEP).tolist()
    radii = np.repeat(np.linspace(FIRST_SEARCH_DIAGONALS, LAST_SEARCH_DIAGONALS, steps), ROUNDS_PER_STEP).tolist()
    first_fine_round = ROUNDS_PER_STEP * max(steps - FINE_STEPS, 0)
    maps = np.broadcast_to(np.eye(3), (len(term.vertices), 3, 3))
    current = energy.minimise(FIRST_STIFFNESS, maps, [term.markers])
    for _ in range(MARKER_ONLY_ROUNDS - 1):
        current = energy.minimise(FIRST_STIFFNESS, current.maps, [term.markers], current)
    for round_id, (stiffness, radius) in enumerate(zip(stiffnesses, radii, strict=True)):
        progress(round_id, len(radii), "registering")
        if round_id == first_fine_round and term is not fine:
            current, term, energy = fine.interpolate(term, current), fine, Energy(fine.mesh)
        before = current if round_id % ROUNDS_PER_STEP else None
        constraints = term.constraints(current.points, radius, sampled=round_id < first_fine_round)
        current = energy.minimise(stiffness, current.maps, constraints, before)
    progress(len(radii), len(radii), "registering")
    points = _move_unfitted_vertices(aligned, fine.vertices, current.points, current.maps)
    return np.asarray(points * diagonal + centre)


def _move_unfitted_vertices(source: TriangleMesh, vertices: Index, points: Float, maps: Float) -> Float:
    """Return all source vertices ``(V, 3)``; unpaired components follow the affine map of the nearest fitted vertex."""
    source_points = source.points
    result = source_points.copy()
    result[vertices] = points
    unfitted = np.setdiff1d(np.arange(len(source_points)), vertices)
    nearest = source.nearest_by_component(unfitted, vertices)
    rows = np.searchsorted(vertices, nearest)
    offsets = source_points[unfitted] - source_points[nearest]
    result[unfitted] = points[rows] + np.einsum("nij,nj->ni", maps[rows], offsets)
    return result


@dataclass(frozen=True, eq=False)
class DataTerm:
    """Soft constraints of the fitted mesh, which has vertices of the paired components of a source."""

    vertices: Index  # (n,) source vertices of the fitted mesh, ascending
    mesh: TriangleMesh  # undeformed fitted mesh
    target: TriangleMesh  # mesh to which constraints attract
    pairings: tuple[Pairing, ...]  # paired components; source ids are ids of the fitted mesh
    markers: SoftConstraints  # constraints of the markers
    target_searches: tuple[ClosestPointQuery, ...]  # closest-point query on the target for every pairing

    @classmethod
    def from_pairings(
        cls, source: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...], markers: Markers
    ) -> DataTerm:
        """Select the paired components of a source."""
        corners, goals = markers.source[:, None], target.points[markers.target]
        weights = np.full(len(markers), MARKER_WEIGHT / len(markers))
        constraints = SoftConstraints(corners, np.ones(corners.shape), goals, weights)
        query = ClosestPointQuery.from_mesh
        searches = tuple(query(target.points, target.faces, pairing.target_faces) for pairing in pairings)
        whole = cls(np.arange(len(source.points)), source, target, pairings, constraints, searches)
        face_ids = np.unique(np.concatenate([pairing.source_faces for pairing in pairings]))
        vertices = np.unique(np.concatenate([pairing.source_vertices for pairing in pairings]))
        return whole._restricted(vertices, source.faces[face_ids])

    def decimated(self) -> DataTerm:
        """Return the term of the mesh decimated to `COARSE_VERTICES`; the same term if it has fewer."""
        if len(self.vertices) <= COARSE_VERTICES:
            return self
        faces, keep = self.mesh.faces.astype(np.int64), np.unique(self.markers.corners).astype(np.int64)
        vertices, coarse_faces = decimate(self.mesh.points, faces, COARSE_VERTICES, keep)
        return self._restricted(vertices, vertices[coarse_faces])

    def _restricted(self, vertices: Index, faces: Index) -> DataTerm:
        """Return the term of triangles ``(m, 3)`` of some of the vertices ``(n,)``."""
        pairings = tuple(
            replace(
                pairing,
                source_faces=np.flatnonzero(np.isin(faces[:, 0], pairing.source_vertices)),
                source_vertices=np.flatnonzero(np.isin(vertices, pairing.source_vertices)),
            )
            for pairing in self.pairings
        )
        mesh = TriangleMesh(self.mesh.points[vertices], Topology(np.searchsorted(vertices, faces), len(vertices)))
        markers = replace(self.markers, corners=np.searchsorted(vertices, self.markers.corners))
        return replace(self, vertices=self.vertices[vertices], mesh=mesh, pairings=pairings, markers=markers)

    def interpolate(self, coarse: DataTerm, deformation: Deformation) -> Deformation:
        """Interpolate a deformation of a decimated mesh: the maps at the closest points that face the same way."""
        points, maps = np.empty_like(self.mesh.points), np.empty((len(self.vertices), 3, 3))
        x, faces = coarse.mesh.points, coarse.mesh.faces
        for pairing, coarse_pairing in zip(self.pairings, coarse.pairings, strict=True):
            rows = pairing.source_vertices
            search = ClosestPointQuery.from_mesh(x, faces, coarse_pairing.source_faces)
            closest, weights = search.query_facing(self.mesh.points[rows], self.mesh.vertex_normals[rows])
            corners = faces[closest]
            offsets = self.mesh.points[rows, None] - x[corners]
            moved = deformation.points[corners] + np.einsum("nkij,nkj->nki", deformation.maps[corners], offsets)
            points[rows] = np.einsum("nk,nki->ni", weights, moved)
            maps[rows] = np.einsum("nk,nkij->nij", weights, deformation.maps[corners])
        return deformation._replace(points=points, maps=maps)

    @cached_property
    def _source_orders(self) -> list[Index]:
        """Order of the tree of the undeformed triangles for every pairing."""
        corners = triangle_corners(self.mesh.points, self.mesh.faces)
        return [BoxTree.from_triangles(corners[pairing.source_faces]).order for pairing in self.pairings]

    @cached_property
    def _areas(self) -> tuple[Float, Float]:
        """Areas around the vertices of the fitted mesh and of the target; each array adds to one."""
        source_areas, target_areas = self.mesh.vertex_areas, self.target.vertex_areas
        return source_areas / source_areas.sum(), target_areas / target_areas.sum()

    def constraints(self, points: Float, radius: float, sampled: bool = False) -> list[SoftConstraints]:
        """Return the constraints of fitted points ``(n, 3)``: markers, and closest points on both surfaces.

        If `sampled`, every k-th vertex of the target attracts, with the weight of k vertices.
        """
        deformed, target = TriangleMesh(points, self.mesh.topology), self.target
        source_areas, target_areas = self._areas
        constraints = [self.markers]
        searches = zip(self.pairings, self.target_searches, self._source_orders, strict=True)
        for pairing, target_search, order in searches:
            vertices = pairing.source_vertices
            closest = target_search.query(
                points[vertices], deformed.vertex_normals[vertices], MAX_NORMAL_ANGLE_DEGREES, radius
            )
            near = np.flatnonzero(closest.faces >= 0)
            goals = target.points_on(closest.faces[near], closest.weights[near])
            corners, weights = vertices[near][:, None], source_areas[vertices[near]]
            constraints.append(SoftConstraints(corners, np.ones((len(near), 1)), goals, weights))

            stride = max(len(pairing.target_vertices) // COARSE_VERTICES, 1) if sampled else 1
            vertices = pairing.target_vertices[::stride]
            source_search = ClosestPointQuery.from_mesh(deformed.points, deformed.faces, pairing.source_faces, order)
            normals = target.vertex_normals[vertices]
            closest = source_search.query(target.points[vertices], normals, MAX_NORMAL_ANGLE_DEGREES, radius)
            near = np.flatnonzero(closest.faces >= 0)
            corners, goals = deformed.faces[closest.faces[near]], target.points[vertices[near]]
            weights = stride * target_areas[vertices[near]]
            constraints.append(SoftConstraints(corners, closest.weights[near], goals, weights))
        return constraints
