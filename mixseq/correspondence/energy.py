r"""Smooth deformation of a mesh under soft constraints: the energy of a non-rigid registration.

Every vertex i has a new position p_i and an affine map A_i of its neighbourhood, both unknown (Amberg, Romdhani and
Vetter 2007, in the form of embedded deformation, Sumner, Schmid and Pauly 2007, which does not depend on the origin).
With edges :math:`e_{ij} = x_j - x_i`,

.. math::
    E = \alpha \Bigl[ \sum_{ij} \frac{w_{ij}}{2} \bigl( \|p_j - p_i - A_i e_{ij}\|^2 + \|p_i - p_j - A_j e_{ji}\|^2
        \bigr) + \ell^2 \sum_{ij} w_{ij} \|A_i - A_j\|^2 + \mu \sum_i a_i \|A_i - S_i\|^2 \Bigr]
        + \sum_t b_t \Bigl\| \sum_k \beta_{tk} p_{tk} - y_t \Bigr\|^2 .

In brackets: neighbours move together, maps vary slowly, near given similarities :math:`S_i`. The last sum is soft
constraints: points on triangles are drawn to goals y, with weights b. Areas a add to one and :math:`w_{ij}` is the area
about an edge by half its squared length, so that E hardly depends on the sampling.

E is quadratic, with one matrix for the three coordinates. Constraints couple corners of one triangle, as edges do, so
the pattern is constant, and analysed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, Index
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.geometry.rigid import nearest_rotations
from mixseq.shells.solvers import Analysis, analyse

_EDGE_WEIGHTS = 0.05, 20.0
"""Range of an edge's area by half its squared length, 0.6 in a regular mesh: slivers neither cut nor weld."""

_LEAST_AREA = 1e-6
"""Least area about a vertex, relative to the mean, so that maps of components without area are determined."""


@dataclass(frozen=True, eq=False)
class SoftConstraints:
    """Soft position constraints: points of a mesh that are drawn to goals."""

    corners: Index  # (n, k) vertices of each point: one, or the corners of a triangle
    barycentric: Float  # (n, k) their weights in the point, which add to one
    goals: Float  # (n, 3) where the points should be
    weights: Float  # (n,) weights of the squared distances from there


@dataclass(frozen=True, eq=False)
class Energy:
    """The energy of a mesh; each vertex is in a triangle, and some triangle has an area."""

    mesh: TriangleMesh  # the mesh before its deformation, in a unit of about its size
    bending: float  # the length over which maps are alike
    shear: float  # the weight of similarities against affine maps

    @cached_property
    def areas(self) -> Float:
        """Areas ``(V,)`` about the vertices; they add to one, except for the least ones."""
        areas = self.mesh.vertex_areas
        return np.asarray(np.maximum(areas / areas.sum(), _LEAST_AREA / len(areas)))

    @cached_property
    def _matrix(self) -> sparse.csc_array:
        """Lower triangle ``(4 V, 4 V)`` of the matrix that stiffness scales; vertex i has p_i and a row of A_i."""
        x = self.mesh.points
        i, j = self.mesh.topology.edges.T
        # Twice a third of the areas at an edge, by its squared length.
        weights = 2 * self.mesh.edge_areas / np.maximum(self.mesh.squared_lengths, 1e-20)
        weights = np.clip(weights, *_EDGE_WEIGHTS) / self.mesh.vertex_areas.sum()
        together = [
            [(4 * b, 1.0), (4 * a, -1.0), *((4 * a + 1 + d, x[a, d] - x[b, d]) for d in range(3))]
            for a, b in ((i, j), (j, i))
        ]
        alike = [[(4 * i + 1 + d, self.bending), (4 * j + 1 + d, -self.bending)] for d in range(3)]
        near = np.outer(self.areas, [0.0, self.shear, self.shear, self.shear]).reshape(-1)
        total = sparse.diags_array(near).tocsr()
        for terms, scale in ((together, 0.5), (alike, 1.0)):
            for row in terms:
                difference = _rows(row, np.sqrt(scale * weights), 4 * len(x))
                total = total + difference.T @ difference
        lower = sparse.csc_array(sparse.tril(total))
        lower.sort_indices()
        return lower

    @cached_property
    def _analysis(self) -> Analysis:
        return analyse(self._matrix.indptr.astype(np.int64), self._matrix.indices.astype(np.int64))

    @cached_property
    def _keys(self) -> Index:
        """Column and row of every stored number as one ascending number."""
        size = self._matrix.shape[0]
        columns = np.repeat(np.arange(size), np.diff(self._matrix.indptr))
        return np.asarray(columns * size + self._matrix.indices)

    def minimise(
        self, stiffness: float, maps: Float, constraints: list[SoftConstraints]
    ) -> tuple[Float, Float]:
        """Find the positions ``(V, 3)`` and maps ``(V, 3, 3)`` of least energy."""
        count, size = len(maps), 4 * len(maps)
        values = stiffness * self._matrix.data
        right = np.zeros((count, 4, 3))
        wanted = nearest_similarities(maps).transpose(0, 2, 1)
        right[:, 1:] = stiffness * self.shear * self.areas[:, None, None] * wanted
        for each in constraints:
            weighted = each.barycentric * each.weights[:, None]
            for k in range(each.corners.shape[1]):
                at = each.corners[:, k]
                for c in range(3):
                    right[:, 0, c] += np.bincount(at, weighted[:, k] * each.goals[:, c], minlength=count)
                for other in range(each.corners.shape[1]):
                    lower = np.flatnonzero(at >= each.corners[:, other])
                    places = np.searchsorted(
                        self._keys, 4 * each.corners[lower, other] * size + 4 * at[lower]
                    )
                    products = weighted[lower, k] * each.barycentric[lower, other]
                    values += np.bincount(places, products, minlength=len(values))
        solution = self._analysis.factor(values).solve(right.reshape(size, 3)).reshape(count, 4, 3)
        return solution[:, 0].copy(), solution[:, 1:].transpose(0, 2, 1).copy()


def nearest_similarities(maps: Float) -> Float:
    """Return the proper similarities ``(n, 3, 3)`` nearest to maps in the Frobenius norm."""
    rotations = nearest_rotations(maps)
    scales = np.einsum("nij,nij->n", rotations, maps) / 3
    return np.asarray(rotations * np.maximum(scales, 0.0)[:, None, None])


def _rows(terms: Sequence[tuple[Index, Float | float]], scales: Float, size: int) -> sparse.csr_array:
    """Return sparse rows of scaled sums of a few unknowns: columns ``(n,)`` and coefficients."""
    count = len(scales)
    columns = np.concatenate([column for column, _ in terms])
    values = np.concatenate([np.broadcast_to(value, count) * scales for _, value in terms])
    return sparse.coo_array((values, (np.tile(np.arange(count), len(terms)), columns)), (count, size)).tocsr()
