r"""Bodies with tips (of limbs, tail and head), for maps between bodies in any poses.

*Distances* along a surface are measured on a coarse copy: the decimated largest component, centred, with unit area, so
that lengths on two meshes are comparable. Paths follow edges, or cross a hinge between its opposite vertices on a
straight line in the unfolded faces. With edges alone, distances would be up to an eighth longer.

*Tips* are maxima of the mean distance along the surface to all vertices (Hilaga et al. 2001), which is smallest in the
trunk, in any pose. The *prominence* of a maximum is the least descent on a path to a higher maximum (0-dimensional
persistence; Edelsbrunner, Letscher and Zomorodian 2002). Tips have a large one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import SettingsError
from mixseq.mesh.decimation import decimate
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.segmentation.silhouettes import Diffusion
from mixseq.types import Float, FloatArray, Index, Mask


@dataclass(frozen=True, eq=False)
class CoarseSurface:
    """The decimated largest component of a mesh, with unit area."""

    vertices: Index  # (n,) ids of the surface's vertices in the mesh
    mesh: TriangleMesh  # surface, centred, with unit area
    centre: Float  # (3,) origin of the surface, in coordinates of the mesh
    size: float  # unit of the surface, in units of the mesh

    @classmethod
    def from_mesh(cls, points: FloatArray, topology: Topology, count: int, keep: Index | None = None) -> CoarseSurface:
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
SAME_TIP_DISTANCE = 0.15  # largest distance of two vertices that are the same tip
MAX_DISTANCE = 9.0  # replaces infinite distances
MAX_TIPS = 8  # largest number of tips of a body; all of their injective maps are ranked
MAX_EIGENFUNCTIONS = 60  # number of eigenfunctions of the finest map
HANDEDNESS_EIGENFUNCTIONS = 40  # number of eigenfunctions to which handedness is smoothed


@dataclass(frozen=True, eq=False)
class CoarseBody:
    """Coarse surface of a body with some of its poses; lengths are in roots of the area."""

    surface: CoarseSurface  # surface in the first pose
    poses: Float  # (T, n, 3) centred poses
    distances: Float  # (n, n) distances along the surface
    is_own: Mask  # (n,) vertices of the mesh itself, not of its subdivision
    known: Index  # (h,) vertices of the surface with a known partner
    tips: Index  # (k,) vertices of the surface at other tips, the most prominent first

    @classmethod
    def from_poses(cls, poses: FloatArray, topology: Topology, count: int, known: Index) -> CoarseBody:
        """Decimate the largest component of a mesh in poses ``(T, V, 3)``, with known vertices ``(h,)``."""
        vertex_count = topology.vertex_count
        while topology.vertex_count < count / 2:
            poses, topology = subdivide(poses, topology)
        surface = CoarseSurface.from_mesh(poses[0], topology, count, keep=known)
        coarse = np.asarray(poses[:, surface.vertices], np.float64)
        coarse = (coarse - coarse.mean(axis=1, keepdims=True)) / surface.size
        distances = np.minimum(surface.distances(np.arange(len(surface.vertices))), MAX_DISTANCE)
        distances = (distances + distances.T) / 2
        is_own, known = surface.vertices < vertex_count, np.searchsorted(surface.vertices, known)
        peaks, prominences = find_maxima(distances @ surface.mesh.vertex_areas, surface)
        is_tip = prominences >= MIN_LIMB_PROMINENCE
        if len(known):
            is_tip &= distances[np.ix_(peaks, known)].min(axis=1) > SAME_TIP_DISTANCE
        tips = np.flatnonzero(is_own)[distances[np.ix_(peaks[is_tip], is_own)].argmin(axis=1)]
        return cls(surface, coarse, distances, is_own, known, tips[:MAX_TIPS])

    def mirrored(self) -> CoarseBody:
        """Return the mirror image of the body, with the same vertices."""
        mesh = self.surface.mesh
        faces = np.ascontiguousarray(mesh.topology.faces[:, ::-1])
        image = TriangleMesh(-mesh.points, Topology(faces, len(mesh.points)))
        return replace(self, surface=replace(self.surface, mesh=image, centre=-self.surface.centre), poses=-self.poses)

    @cached_property
    def mean_distances(self) -> Float:
        """Mean distances ``(n,)`` along the surface from every vertex to the surface."""
        return np.asarray(self.distances @ self.areas)

    @cached_property
    def areas(self) -> Float:
        """Areas ``(n,)`` of vertices, which add to one."""
        areas = np.maximum(self.surface.mesh.vertex_areas, 1e-8)
        return np.asarray(areas / areas.sum())

    @cached_property
    def eigenfunctions(self) -> Float:
        """Lowest eigenfunctions ``(n, k)`` of the Laplacian, the constant one first, orthonormal by area."""
        diffusion = Diffusion(self.surface.points, self.surface.mesh.topology)
        functions = diffusion.embedding(0.0, min(MAX_EIGENFUNCTIONS - 1, len(self.areas) // 3))
        return np.concatenate([np.ones((len(functions), 1)), functions], axis=1)

    def project(self, values: Float, count: int) -> Float:
        """Return coefficients ``(count, c)`` of values ``(n, c)`` in the lowest eigenfunctions."""
        return np.asarray(self.eigenfunctions[:, :count].T @ (self.areas[:, None] * values))

    def sample(self, count: int, mask: Mask | None = None) -> Index:
        """Sample vertices ``(count,)`` far from each other, in a mask ``(n,)``, the innermost first (Gonzalez 1985)."""
        mask = np.ones(len(self.areas), dtype=bool) if mask is None else mask
        samples = [int(np.where(mask, self.mean_distances, np.inf).argmin())]
        nearest = np.where(mask, self.distances[samples[0]], -1.0)
        for _ in range(min(count, int(mask.sum())) - 1):
            samples.append(int(nearest.argmax()))
            nearest = np.minimum(nearest, self.distances[samples[-1]])
        return np.array(samples)

    def handedness(self, vertices: Index) -> Float:
        """Return the smoothed handedness ``(n, k (k - 1) / 2)`` of all pairs of vertices ``(k,)``."""
        mesh, values = self.surface.mesh, self.distances[vertices]
        faces = mesh.topology.faces
        corners = mesh.points[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
        gradients = np.zeros((len(vertices), len(faces), 3))
        for corner in range(3):
            opposite = corners[:, corner - 1] - corners[:, corner - 2]
            gradients += values[:, faces[:, corner], None] * np.cross(normals, opposite)
        gradients /= np.maximum(np.linalg.norm(gradients, axis=2, keepdims=True), 1e-9)
        pairs = np.array(list(combinations(range(len(vertices)), 2)))
        triple_products = np.einsum("fi,pfi->fp", normals, np.cross(gradients[pairs[:, 0]], gradients[pairs[:, 1]]))
        at_vertices = np.zeros((len(self.areas), len(pairs)))
        for corner in range(3):
            np.add.at(at_vertices, faces[:, corner], triple_products * mesh.face_areas[:, None] / 3)
        count = HANDEDNESS_EIGENFUNCTIONS
        coefficients = self.eigenfunctions[:, :count].T @ at_vertices  # vertex values are already weighted by areas
        return np.asarray(self.eigenfunctions[:, :count] @ coefficients)


def subdivide(poses: FloatArray, topology: Topology) -> tuple[FloatArray, Topology]:
    """Cut every triangle into four: the vertices of poses ``(T, V, 3)``, then the midpoints of edges."""
    a, b, c = topology.faces.T
    ab, bc, ca = len(poses[0]) + topology.face_edges.T
    faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    points = np.concatenate([poses, poses[:, topology.edges].mean(axis=2)], axis=1)
    return points, Topology(faces, points.shape[1])
