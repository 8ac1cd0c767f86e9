r"""A triangle mesh in one pose: areas, normals, and matrices of triangles, including triangles without area.

All results are equivariant under rigid motions, except normals of collinear vertices, which have no unique direction.
The columns of a triangle's matrix are two sides and a fourth vertex along the normal (Sumner and Popović 2004),

.. math:: D = [e_1, e_2, n / \sqrt{|n|}], \qquad n = e_1 \times e_2 .

Division by the square root makes the fourth vertex scale with the triangle. Triangles without area also get a fourth
vertex, and are replaced by triangles with area where an inverse is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.topology import Topology
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Mask

DEGENERATE_HEIGHT_RATIO = 1e-4  # height to longest side without area, as normals in single precision are random

CANCELLED_NORMAL_RATIO = 1e-6
"""Up to this ratio of |sum of face normals| to sum of |face normals|, the normals cancel and a vertex has no normal."""


def normalise(vectors: Float) -> Float:
    """Normalise vectors ``(..., 3)``; zero vectors stay zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))


def perpendicular(directions: Float) -> Float:
    """Return a unit vector perpendicular to each direction ``(n, 3)``, the same for opposite directions."""
    axis = np.eye(3)[np.abs(directions).argmin(axis=1)]
    return normalise(axis - normalise(directions) * np.sum(axis * normalise(directions), axis=1, keepdims=True))


def area_normals(x: Float, faces: Index) -> Float:
    """Return normals ``(F, 3)`` with lengths of twice the face areas; zero up to `DEGENERATE_HEIGHT_RATIO`."""
    corners = x[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.square(np.roll(corners, -1, axis=1) - corners).sum(axis=2).max(axis=1)
    normals[np.linalg.norm(normals, axis=1) <= DEGENERATE_HEIGHT_RATIO * longest] = 0.0
    return np.asarray(normals)


def vertex_normals(x: Float, faces: Index, edges: Index) -> Float:
    """Return unit normals ``(n, 3)`` of vertices: area-weighted sums over faces ``(F, 3)``.

    Vertices without a normal get the mean normal of neighbours by edges ``(E, 2)``, zero if their component has none.
    """
    normals_of_corners = np.repeat(area_normals(x, faces), 3, axis=0)
    sums = scatter_add(normals_of_corners, faces.reshape(-1), len(x))
    lengths = np.bincount(faces.reshape(-1), np.linalg.norm(normals_of_corners, axis=1), minlength=len(x))
    is_defined = np.linalg.norm(sums, axis=1) > CANCELLED_NORMAL_RATIO * lengths
    normals = np.where(is_defined[:, None], normalise(sums), 0.0)
    starts, ends = np.concatenate([edges, edges[:, ::-1]]).T
    missing = np.flatnonzero(~normals.any(axis=1))
    while missing.size:
        is_missing = np.isin(starts, missing)
        means = normalise(scatter_add(normals[ends[is_missing]], starts[is_missing], len(x)))
        normals[missing] = means[missing]
        remaining = missing[~means[missing].any(axis=1)]
        if remaining.size == missing.size:
            break
        missing = remaining
    return normals


def triangle_matrices(x: Float, faces: Index, edges: Index) -> Float:
    """Return matrices D ``(F, 3, 3)`` of faces of points ``(n, 3)``: columns are side 01, side 02 and fourth vertex.

    The fourth vertex of a face without area is perpendicular to its longest side, along the mean of its vertex normals.
    """
    triangles = np.empty((len(faces), 3, 3))
    if _write_triangles(x, faces, DEGENERATE_HEIGHT_RATIO, triangles):
        degenerate = np.flatnonzero(~triangles[:, :, 2].any(axis=1))
        _, longest, length = _longest_sides(x[faces[degenerate]])
        means = vertex_normals(x, faces, edges)[faces[degenerate]].sum(axis=1)
        upright = means - longest * np.sum(means * longest, axis=1, keepdims=True)
        has_normal = np.linalg.norm(upright, axis=1) > DEGENERATE_HEIGHT_RATIO * np.linalg.norm(means, axis=1)
        directions = np.where(has_normal[:, None], normalise(upright), perpendicular(longest))
        triangles[degenerate, :, 2] = normalise(directions) * np.sqrt(DEGENERATE_HEIGHT_RATIO * length**2)[:, None]
    return triangles


@compiled
def _write_triangles(x: Float, faces: Index, height_ratio: float, triangles: Float) -> int:
    """Write matrices D ``(F, 3, 3)`` of faces; return the number of those without area, whose fourth vertex is zero."""
    count = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        o0, o1, o2 = x[c, 0] - x[b, 0], x[c, 1] - x[b, 1], x[c, 2] - x[b, 2]
        longest = max(p0 * p0 + p1 * p1 + p2 * p2, q0 * q0 + q1 * q1 + q2 * q2, o0 * o0 + o1 * o1 + o2 * o2)
        n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
        size = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        is_degenerate = size <= height_ratio * longest
        count += is_degenerate
        root = 0.0 if is_degenerate else math.sqrt(size)
        size = 1.0 if is_degenerate else size
        triangles[f, 0, 0], triangles[f, 1, 0], triangles[f, 2, 0] = p0, p1, p2
        triangles[f, 0, 1], triangles[f, 1, 1], triangles[f, 2, 1] = q0, q1, q2
        triangles[f, 0, 2], triangles[f, 1, 2], triangles[f, 2, 2] = (
            n0 / size * root,
            n1 / size * root,
            n2 / size * root,
        )
    return count


def replace_degenerate(triangles: Float) -> Float:
    """Replace matrices D ``(F, 3, 3)`` of triangles without area by equilateral triangles on their longest sides.

    Directions of fourth vertices are kept. Triangles of coincident points get the mean size of the other triangles.
    """
    first, second, fourth = (triangles[:, :, column] for column in range(3))
    corners = np.stack([np.zeros_like(first), first, second], axis=1)
    normals = area_normals(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    degenerate = np.flatnonzero(~normals.any(axis=1))
    if not degenerate.size:
        return triangles
    longest, along, length = _longest_sides(corners)
    mean_length = length[length > 0].mean() if length.any() else 1.0
    side = np.where(length > 0, length, mean_length)[degenerate, None]
    along, fourth = along[degenerate], fourth[degenerate]
    along = np.where(along.any(axis=1, keepdims=True), along, [1.0, 0.0, 0.0])
    upright = np.where(fourth.any(axis=1, keepdims=True), normalise(fourth), perpendicular(along))

    rows, start = np.arange(len(degenerate)), longest[degenerate]
    corners = np.zeros((len(degenerate), 3, 3))
    corners[rows, (start + 1) % 3] = side * along
    corners[rows, (start + 2) % 3] = side * (along / 2 + np.cross(upright, along) * np.sqrt(0.75))
    result = triangles.copy()
    result[degenerate, :, 0] = corners[:, 1] - corners[:, 0]
    result[degenerate, :, 1] = corners[:, 2] - corners[:, 0]
    result[degenerate, :, 2] = upright * side * np.sqrt(np.sqrt(0.75))
    return result


def _longest_sides(corners: Float) -> tuple[Index, Float, Float]:
    """Return longest sides ``(F,)`` of triangles ``(F, 3, 3)``, their directions ``(F, 3)`` and lengths ``(F,)``."""
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.argmax(axis=1)
    indices = np.arange(len(corners)), longest
    return longest, normalise(sides[indices]), lengths[indices]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh in one pose."""

    points: Float  # (V, 3)
    topology: Topology

    @cached_property
    def faces(self) -> Index:
        """Triangles ``(F, 3)``."""
        return self.topology.faces.astype(np.int64)

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of the triangles, without unused vertices."""
        return float(np.linalg.norm(np.ptp(self.points[self.faces.reshape(-1)], axis=0)))

    @cached_property
    def vector_areas(self) -> Float:
        """Vector areas ``(F, 3)`` of the triangles."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a) / 2)

    @cached_property
    def face_areas(self) -> Float:
        """Areas ``(F,)`` of the triangles."""
        return np.asarray(np.linalg.norm(self.vector_areas, axis=1))

    @cached_property
    def face_normals(self) -> Float:
        """Unit normals ``(F, 3)``; zero where a triangle has no area."""
        return normalise(self.vector_areas)

    @cached_property
    def centroids(self) -> Float:
        """Centroids ``(F, 3)`` of the triangles."""
        return np.asarray(self.points[self.faces].mean(axis=1))

    @cached_property
    def vertex_areas(self) -> Float:
        """Area ``(V,)`` of every vertex: a third of the areas of its triangles."""
        third = np.repeat(self.face_areas / 3, 3)
        return np.asarray(np.bincount(self.faces.reshape(-1), third, len(self.points)), dtype=np.float64)

    @cached_property
    def vertex_normals(self) -> Float:
        """Unit normals ``(V, 3)``: area-weighted means of face normals; zero where the mean is zero."""
        return normalise(scatter_add(np.repeat(self.vector_areas, 3, axis=0), self.faces.reshape(-1), len(self.points)))

    @cached_property
    def squared_lengths(self) -> Float:
        """Squared lengths ``(E,)`` of the edges."""
        i, j = self.topology.edges.T
        return np.asarray(np.sum((self.points[j] - self.points[i]) ** 2, axis=1))

    @cached_property
    def edge_areas(self) -> Float:
        """Area ``(E,)`` of every edge: a third of the areas of its triangles."""
        third = np.repeat(self.face_areas / 3, 3)
        edges = self.topology.face_edges.reshape(-1)
        return np.asarray(np.bincount(edges, third, len(self.topology.edges)), dtype=np.float64)

    def points_on(self, faces: Index, weights: Float) -> Float:
        """Return points ``(n, 3)`` on triangles ``(n,)`` at barycentric weights ``(n, 3)``."""
        return np.asarray(np.einsum("nk,nkc->nc", weights, self.points[self.faces[faces]]))

    def nearest_by_component(self, vertices: Index, candidates: Index) -> Index:
        """Return, for each vertex ``(n,)``, the one candidate ``(m,)`` that is nearest to its connected component."""
        from scipy.spatial import cKDTree

        distances, nearest = map(np.asarray, cKDTree(self.points[candidates]).query(self.points[vertices]))
        component = self.topology.component_of_vertex[vertices]
        order = np.lexsort((distances, component))
        components, first = np.unique(component[order], return_index=True)
        closest = order[first[np.searchsorted(components, component)]]
        return np.asarray(candidates[nearest[closest]])

    def leaders(self, matched: Mask) -> Index:
        """Return the leader ``(V,)`` of every vertex: matched vertices ``(V,)`` lead themselves.

        Others follow the nearest matched vertex of their component. A component without matches follows one vertex.
        """
        from scipy.spatial import cKDTree

        leaders = np.arange(len(self.points))
        component = self.topology.component_of_vertex
        has_match = np.isin(component, component[matched])
        candidates, followers = np.flatnonzero(matched), np.flatnonzero(has_match & ~matched)
        if followers.size:
            # A fourth coordinate separates components by more than the diagonal.
            offset = component * (2 * float(np.linalg.norm(np.ptp(self.points, axis=0))) or 1.0)
            x = np.column_stack([self.points, offset])
            leaders[followers] = candidates[cKDTree(x[candidates]).query(x[followers])[1]]
        unmatched = np.flatnonzero(~has_match)
        leaders[unmatched] = self.nearest_by_component(unmatched, candidates)
        return leaders
