r"""A triangle mesh in one pose: areas, normals, closest points, and triangles as matrices, also without area.

All follow a rigid motion of the vertices, except normals of vertices on one line, whose rotation about it is undefined.
As matrices triangles are two sides, and a fourth vertex along the normal (Sumner and Popović 2004),

.. math:: D = [e_1, e_2, n / \sqrt{|n|}], \qquad n = e_1 \times e_2 .

The root scales the fourth vertex with the triangle. Triangles without area get a fourth vertex too, and are replaced
by triangles with area where an inverse is needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.topology import Topology
from mixseq.types import Float, Index, Mask

DEGENERATE_HEIGHT_RATIO = 1e-4
"""Ratio of height to longest side below which a triangle has no area: in single precision its normal is random."""

CANCELLED_NORMAL_RATIO = 1e-6
"""Ratio of the sum of face normals to the sum of their lengths below which a vertex has no normal."""


def normalise(vectors: Float) -> Float:
    """Return vectors ``(..., 3)`` scaled to length 1; zero vectors stay zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))


def perpendicular(directions: Float) -> Float:
    """Return a unit vector perpendicular to each direction ``(n, 3)``, the same one for its opposite."""
    least = np.abs(directions).argmin(axis=1)
    axis = np.eye(3)[least]
    return normalise(
        axis - normalise(directions) * np.sum(axis * normalise(directions), axis=1, keepdims=True)
    )


def area_normals(x: Float, faces: Index) -> Float:
    """Return normals ``(F, 3)`` of faces, twice their areas long; zero below `DEGENERATE_HEIGHT_RATIO`."""
    corners = x[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.square(np.roll(corners, -1, axis=1) - corners).sum(axis=2).max(axis=1)
    normals[np.linalg.norm(normals, axis=1) <= DEGENERATE_HEIGHT_RATIO * longest] = 0.0
    return np.asarray(normals)


def vertex_normals(x: Float, faces: Index, edges: Index) -> Float:
    """Return unit normals ``(n, 3)`` of vertices: area-weighted sums over faces ``(F, 3)``.

    Without one, the mean of neighbours along edges ``(E, 2)``; zero if no connected vertex has a normal.
    """
    of_faces = area_normals(x, faces)
    sums = scatter_add(np.repeat(of_faces, 3, axis=0), faces.reshape(-1), len(x))
    sizes = np.repeat(np.linalg.norm(of_faces, axis=1), 3)
    whole = np.bincount(faces.reshape(-1), sizes, minlength=len(x))
    normals = np.where(
        (np.linalg.norm(sums, axis=1) > CANCELLED_NORMAL_RATIO * whole)[:, None], normalise(sums), 0.0
    )
    starts, ends = np.concatenate([edges, edges[:, ::-1]]).T
    missing = np.flatnonzero(~normals.any(axis=1))
    while missing.size:
        into = np.isin(starts, missing)
        found = normalise(scatter_add(normals[ends[into]], starts[into], len(x)))
        normals[missing] = found[missing]
        still = missing[~found[missing].any(axis=1)]
        if still.size == missing.size:
            break
        missing = still
    return normals


def triangle_matrices(rows: Float, faces: Index, edges: Index) -> Float:
    """Return matrices D ``(F, 3, 3)`` of faces of rows ``(n, 3)``: sides 01, 02 and fourth vertices, in columns.

    The fourth vertex of a face without area is across its longest side, by the normals of its vertices.
    """
    corners = rows[faces]
    normals = area_normals(rows, faces)
    areas = np.linalg.norm(normals, axis=1)
    flat = np.flatnonzero(areas == 0)
    if flat.size:
        _, longest, length = _longest(corners[flat])
        around = vertex_normals(rows, faces, edges)[faces[flat]].sum(axis=1)
        upright = around - longest * np.sum(around * longest, axis=1, keepdims=True)
        has = np.linalg.norm(upright, axis=1) > DEGENERATE_HEIGHT_RATIO * np.linalg.norm(around, axis=1)
        normals[flat] = np.where(has[:, None], normalise(upright), perpendicular(longest))
        areas[flat] = DEGENERATE_HEIGHT_RATIO * length**2
    fourth = normalise(normals) * np.sqrt(areas)[:, None]
    return np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], fourth], axis=2)


def replace_degenerate(triangles: Float) -> Float:
    """Replace D ``(F, 3, 3)`` of triangles without area by equilateral ones on their longest sides.

    Fourth directions stay. Triangles that are points get the mean size of the others.
    """
    first, second, fourth = (triangles[:, :, column] for column in range(3))
    corners = np.stack([np.zeros_like(first), first, second], axis=1)
    normals = area_normals(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    flat = np.flatnonzero(~normals.any(axis=1))
    longest, along, length = _longest(corners)
    usual = length[length > 0].mean() if length.any() else 1.0
    side = np.where(length > 0, length, usual)[flat, None]
    along = np.where(along[flat].any(axis=1, keepdims=True), along[flat], [1.0, 0.0, 0.0])
    upright = np.where(fourth[flat].any(axis=1, keepdims=True), normalise(fourth[flat]), perpendicular(along))

    chosen = np.arange(len(flat))
    corners = np.zeros((len(flat), 3, 3))
    corners[chosen, (longest[flat] + 1) % 3] = side * along
    corners[chosen, (longest[flat] + 2) % 3] = side * (along / 2 + np.cross(upright, along) * np.sqrt(0.75))
    result = triangles.copy()
    result[flat, :, 0] = corners[:, 1] - corners[:, 0]
    result[flat, :, 1] = corners[:, 2] - corners[:, 0]
    result[flat, :, 2] = upright * side * np.sqrt(np.sqrt(0.75))
    return result


def _longest(corners: Float) -> tuple[Index, Float, Float]:
    """Return longest sides ``(F,)`` of triangles ``(F, 3, 3)``, their directions ``(F, 3)`` and lengths ``(F,)``."""
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.argmax(axis=1)
    chosen = np.arange(len(corners)), longest
    return longest, normalise(sides[chosen]), lengths[chosen]


@dataclass(frozen=True, eq=False)
class TriangleMesh:
    """A triangle mesh in one pose."""

    points: Float  # (V, 3) vertices
    topology: Topology  # its faces

    @cached_property
    def faces(self) -> Index:
        """Triangles ``(F, 3)``."""
        return self.topology.faces.astype(np.int64)

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the bounding box of the triangles, without unused vertices."""
        return float(np.linalg.norm(np.ptp(self.points[self.faces.reshape(-1)], axis=0)))

    @cached_property
    def vectors(self) -> Float:
        """Vector areas ``(F, 3)`` of the triangles."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a) / 2)

    @cached_property
    def face_areas(self) -> Float:
        """Areas ``(F,)`` of the triangles."""
        return np.asarray(np.linalg.norm(self.vectors, axis=1))

    @cached_property
    def face_normals(self) -> Float:
        """Unit normals ``(F, 3)``; zero where a triangle has no area."""
        return normalise(self.vectors)

    @cached_property
    def centroids(self) -> Float:
        """Centroids ``(F, 3)`` of the triangles."""
        return np.asarray(self.points[self.faces].mean(axis=1))

    @cached_property
    def vertex_areas(self) -> Float:
        """A third ``(V,)`` of the areas of the triangles at every vertex."""
        third = np.repeat(self.face_areas / 3, 3)
        return np.asarray(np.bincount(self.faces.reshape(-1), third, len(self.points)), dtype=np.float64)

    @cached_property
    def vertex_normals(self) -> Float:
        """Unit normals ``(V, 3)``, area-weighted means of the triangles'; zero where there is none."""
        return normalise(
            scatter_add(np.repeat(self.vectors, 3, axis=0), self.faces.reshape(-1), len(self.points))
        )

    @cached_property
    def squared_lengths(self) -> Float:
        """Squared lengths ``(E,)`` of the edges."""
        i, j = self.topology.edges.T
        return np.asarray(np.sum((self.points[j] - self.points[i]) ** 2, axis=1))

    @cached_property
    def edge_areas(self) -> Float:
        """A third ``(E,)`` of the areas of the triangles at every edge."""
        third = np.repeat(self.face_areas / 3, 3)
        edges = self.topology.face_edges.reshape(-1)
        return np.asarray(np.bincount(edges, third, len(self.topology.edges)), dtype=np.float64)

    def points_on(self, faces: Index, weights: Float) -> Float:
        """Return points ``(n, 3)`` of triangles ``(n,)`` with barycentric weights ``(n, 3)``."""
        return np.asarray(np.einsum("nk,nkc->nc", weights, self.points[self.faces[faces]]))

    def nearest_by_component(self, vertices: Index, among: Index) -> Index:
        """Return one of vertices `among` ``(m,)`` for each vertex ``(n,)``: the nearest to its whole component."""
        from scipy.spatial import cKDTree

        found = cKDTree(self.points[among]).query(self.points[vertices])
        distances, places = (np.asarray(each) for each in found)
        component = self.topology.component_of_vertex[vertices]
        order = np.lexsort((distances, component))
        components, nearest = np.unique(component[order], return_index=True)
        own = np.searchsorted(components, component)
        return np.asarray(among[places[order[nearest[own]]]])

    def leaders(self, matched: Mask) -> Index:
        """Return the leader of every vertex, where some ``(V,)`` are matched and lead themselves.

        Others follow the nearest matched vertex of their component; components without one follow a single vertex.
        """
        from scipy.spatial import cKDTree

        leaders = np.arange(len(self.points))
        component = self.topology.component_of_vertex
        partly = np.isin(component, component[matched])
        near, unmatched = np.flatnonzero(matched), np.flatnonzero(partly & ~matched)
        if unmatched.size:
            # A fourth coordinate keeps components apart: further than anything is in the other three.
            apart = component * (2 * float(np.linalg.norm(np.ptp(self.points, axis=0))) or 1.0)
            places = np.column_stack([self.points, apart])
            leaders[unmatched] = near[cKDTree(places[near]).query(places[unmatched])[1]]
        whole = np.flatnonzero(~partly)
        leaders[whole] = self.nearest_by_component(whole, near)
        return leaders
