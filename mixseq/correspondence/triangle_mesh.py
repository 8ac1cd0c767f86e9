"""A triangle mesh in one pose: areas, normals, and closest points on some of its triangles."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.geometry.nearest import Found, Nearest
from mixseq.spaces.robust_triangles import unit
from mixseq.topology import Topology


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
        return unit(self.vectors)

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
        corners = self.faces.reshape(-1)
        sums = [
            np.bincount(corners, weights=np.repeat(self.vectors[:, d], 3), minlength=len(self.points))
            for d in range(3)
        ]
        return unit(np.stack(sums, axis=1))

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


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Closest-point queries on some triangles of a mesh."""

    mesh: TriangleMesh  # the mesh
    triangles: Index  # (n,) searched triangles of it

    @cached_property
    def _nearest(self) -> Nearest:
        return Nearest.of(self.mesh.points, self.mesh.faces[self.triangles])

    def query(self, points: Float, normals: Float | None = None, largest_angle: float = 90.0) -> Found:
        """Find closest points to ``(n, 3)``, facing as normals ``(n, 3)``; triangles are numbered as in the mesh."""
        found = self._nearest.query(points, normals, largest_angle)
        return Found(
            np.where(found.faces >= 0, self.triangles[found.faces], -1), found.weights, found.distances
        )
