r"""Segmentation along regions of large deformation, by augmented silhouettes or by a spanning tree.

*Augmented silhouettes* (Marras, Bronstein, Hormann, Scateni and Scopigno 2012; paper, Section 2.1, Figure 3):

1. *Views.* N poses are viewed from K viewpoints. The augmented silhouette of a view is the set of edges between a front
   and a back face, ignoring occlusion. Only K' of all K N silhouettes, chosen at random, are used.
2. *Marks.* On every silhouette, the vertices of largest deformation are marked: the variation over the poses of the
   angles and lengths of edges at a vertex. Vertices with many marks are *significant*.
3. *Seeds.* The height of a vertex is its diffusion distance from the nearest significant vertex. Maxima are seeds.
4. *Regions.* Regions grow from the seeds downwards, until they meet where the mesh deforms.

Details and values that the paper does not give are described in docs/segmentation.md.

*Spanning tree* (Wuhrer and Brunton 2010; paper, Section 1.3): a minimum spanning tree of the dual graph connects the
faces across the hinges whose dihedral angle varies least, and is cut at hinges of large variation. To reduce noise,
variations are averaged at vertices and smoothed. A hinge is cut if its depth as a pass is large: it varies more than
the insides of both regions. Both regions must have enough area.

*Variations* are the largest changes between any two frames. Vertices have means over incident hinges or edges, weighted
by length in the first frame:

.. math:: \Delta\theta_h = \max_{s,t} \lvert \mathrm{wrap}(\theta_{h,s} - \theta_{h,t}) \rvert, \quad
          \Delta l_e = \max_{s,t} \lvert l_{e,s} - l_{e,t} \rvert, \quad
          \Delta\theta_v = \frac{\sum_h l_h \Delta\theta_h}{\sum_h l_h}, \quad
          \epsilon_v = \frac{\sum_e \Delta l_e}{\sum_e l_e} .

*Diffusion.* With the cotangent Laplacian L and the vertex areas M of a mesh, heat spreads as :math:`M \dot u = -L u`.
One implicit step of time :math:`r^2`, :math:`(M + r^2 L)\, u = M u_0`, smooths values over a distance of about r. The
eigenvectors :math:`L \phi_i = \lambda_i M \phi_i`, :math:`\phi_i^T M \phi_j = \delta_{ij}`, embed the surface so that
Euclidean distances are *diffusion distances* (Coifman et al. 2005; Bronstein and Bronstein 2011), which measure how
well two vertices are connected, independent of the signs of eigenvectors and of their basis where eigenvalues coincide:

.. math:: d_t(v, w)^2 = \sum_{i \ge 1} e^{-2 t \lambda_i} \bigl(\phi_i(v) - \phi_i(w)\bigr)^2 .
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from mixseq.errors import SettingsError
from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.segmentation.elements import check_part_count, face_areas, find_passes, sample_frames
from mixseq.types import Float, FloatArray, Index, IntArray, Mask, index_mask

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU


_SMALLEST_FLOAT = np.finfo(np.float64).tiny


def angle_variation(points: FloatArray, topology: Topology) -> Float:
    """Return the largest change ``(H,)`` of dihedral angles between frames ``(T, V, 3)``, wrapped, in radians."""
    angles = np.stack([dihedral_angles(frame, topology.hinges) for frame in points])
    largest = np.zeros(angles.shape[1])
    for frame in range(1, len(angles)):
        largest = np.maximum(largest, np.abs(wrap_angles(angles[frame] - angles[:frame])).max(axis=0))
    return largest


def length_variation(points: FloatArray, topology: Topology) -> Float:
    """Return the largest change ``(E,)`` of edge lengths between frames ``(T, V, 3)``."""
    lengths = np.stack([edge_lengths(frame, topology.edges) for frame in points])
    return np.asarray(np.ptp(lengths, axis=0), dtype=np.float64)


def vertex_bending(points: FloatArray, topology: Topology) -> Float:
    """Return the mean change ``(V,)`` of the dihedral angles at every vertex, in radians."""
    edges, count = topology.edges[topology.hinge_edges], topology.vertex_count
    lengths = edge_lengths(points[0], edges)
    change = _sum_at_vertices(edges, lengths * angle_variation(points, topology), count)
    return change / np.maximum(_sum_at_vertices(edges, lengths, count), _SMALLEST_FLOAT)


def vertex_strain(points: FloatArray, topology: Topology) -> Float:
    """Return the mean relative change ``(V,)`` of edge lengths at every vertex."""
    count = topology.vertex_count
    lengths = _sum_at_vertices(topology.edges, edge_lengths(points[0], topology.edges), count)
    change = _sum_at_vertices(topology.edges, length_variation(points, topology), count)
    return np.where(lengths > 0.0, change / np.maximum(lengths, _SMALLEST_FLOAT), 0.0)


def _sum_at_vertices(edges: IntArray, values: Float, count: int) -> Float:
    """Sum the values ``(n,)`` of edges ``(n, 2)`` at their vertices ``(count,)``."""
    return np.asarray(np.bincount(edges.reshape(-1), np.repeat(values, 2), count), dtype=np.float64)


_MIN_COTANGENT_WEIGHT, _MAX_COTANGENT_WEIGHT = 1e-2, 1e2  # limit the effect of slivers and obtuse triangles
_MIN_SPARSE_VERTICES = 400  # smaller components use a dense eigensolver


@dataclass(frozen=True, eq=False)
class Diffusion:
    """Diffusion on one frame of a mesh."""

    points: Float  # (V, 3)
    topology: Topology

    @cached_property
    def areas(self) -> Float:
        """Areas ``(V,)`` of vertices: a third of face areas, at least 1e-6 of the mean; equal if all are zero."""
        areas = TriangleMesh(self.points, self.topology).vertex_areas
        return np.asarray(np.maximum(areas, 1e-6 * (float(areas.mean()) or 1.0)))

    @cached_property
    def laplacian(self) -> sparse.csc_array:
        """Positive semidefinite cotangent Laplacian ``(V, V)``."""
        start, end, opposite = (np.roll(self.topology.faces, -i, axis=1).T.reshape(-1) for i in range(3))
        u, v = self.points[start] - self.points[opposite], self.points[end] - self.points[opposite]
        height = np.linalg.norm(np.cross(u, v), axis=1)
        cotangents = np.einsum("ci,ci->c", u, v) / np.maximum(height, 1e-12)
        weights = np.zeros(len(self.topology.edges))
        np.add.at(weights, self.topology.face_edges.T.reshape(-1), 0.5 * cotangents)
        weights = np.clip(weights, _MIN_COTANGENT_WEIGHT, _MAX_COTANGENT_WEIGHT)
        i, j = self.topology.edges.T
        count = self.topology.vertex_count
        half = sparse.coo_array((weights, (i, j)), shape=(count, count))
        adjacency = half + half.T
        return sparse.csc_array(sparse.diags_array(adjacency.sum(axis=0)) - adjacency)

    def smooth(self, values: Float, radius: float) -> Float:
        """Smooth values ``(V,)`` over about a radius, preserving their mean over the surface."""
        if radius == 0.0:
            return values.copy()
        system = sparse.diags_array(self.areas) + radius**2 * self.laplacian
        return np.asarray(_factor(system).solve(self.areas * values), dtype=np.float64)

    def embedding(self, time: float, count: int) -> Float:
        """Return coordinates ``(V, count)`` whose distances in a component are diffusion distances; padded with 0."""
        result = np.zeros((self.topology.vertex_count, count))
        roots = 1.0 / np.sqrt(self.areas)
        scaled = sparse.csr_array(self.laplacian.multiply(roots[:, None]).multiply(roots[None, :]))
        labels = self.topology.component_of_vertex
        order, ends = np.argsort(labels, kind="stable"), np.cumsum(np.bincount(labels))
        blocks = scaled[order][:, order]  # block diagonal, with a block for every component
        for start, end in zip(np.append(0, ends[:-1]), ends, strict=True):
            component = order[start:end]
            values, vectors = _lowest_eigenpairs(blocks[start:end, start:end], min(count, len(component) - 1))
            result[component, : len(values)] = roots[component, None] * vectors * np.exp(-time * values)
        return result


def _lowest_eigenpairs(matrix: sparse.csr_array, count: int) -> tuple[Float, Float]:
    """Return the lowest eigenvalues ``(count,)`` except the first, which is zero, and their eigenvectors."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    size = matrix.shape[0]
    if size < _MIN_SPARSE_VERTICES or count >= size // 4:
        values, vectors = np.linalg.eigh(matrix.toarray())
        return values[1 : count + 1], vectors[:, 1 : count + 1]
    # The shift makes the matrix definite. It is small compared to the lowest eigenvalues, which are about the mean of
    # all eigenvalues divided by the number of vertices.
    shift = 1e-3 * float(matrix.diagonal().mean()) / size
    factor = _factor(matrix + shift * sparse.eye_array(size))
    inverse = LinearOperator((size, size), matvec=factor.solve, dtype=np.float64)
    start = np.cos(np.arange(size, dtype=np.float64))  # arbitrary, but reproducible
    values, vectors = eigsh(matrix, count + 1, sigma=-shift, OPinv=inverse, v0=start, tol=1e-8)
    order = np.argsort(values, kind="stable")[1:]
    return values[order], vectors[:, order]


def _factor(matrix: sparse.sparray) -> SuperLU:
    """Factor a symmetric positive definite matrix."""
    from scipy.sparse.linalg import splu

    options = {"SymmetricMode": True}
    return splu(sparse.csc_matrix(matrix), "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


@dataclass(frozen=True)
class SilhouetteSettings:
    """Settings of `segment_by_silhouettes`. N, K and K' are defined in the paper; their values were chosen empirically.

    Attributes
    ----------
    frames : int
        Number of poses (N), evenly spread over the sequence.
    viewpoints : int
        Number of viewing directions of every pose (K).
    silhouettes : int
        Number of sampled views (K').
    seed : int
        Seed of the random choice of views.
    radius : float
        Smoothing radius of deformations, in diagonals; 0 for none.
    share : float
        Fraction of the vertices on a silhouette that are marked, by decreasing deformation.
    still : float
        Deformation below which vertices are never marked: bending in radians plus strain.
    eigenvectors : int
        Number of eigenvectors of the diffusion distance.
    time : float
        Time of diffusion, in squared diagonals; details smaller than its root have no influence.
    contrast : float
        Least height of a seed above the pass to a higher seed, as a fraction of the mean distance. Used only if the
        number of parts is not given.
    small_region : float
        Least fraction of the area of a part, unless more parts are requested than that allows.
    """

    frames: int = 24
    viewpoints: int = 20
    silhouettes: int = 100
    seed: int = 0
    radius: float = 0.015
    share: float = 0.3
    still: float = 0.005
    eigenvectors: int = 40
    time: float = 0.01
    contrast: float = 0.08
    small_region: float = 0.005

    def __post_init__(self) -> None:
        least_count = min(self.frames, self.viewpoints, self.silhouettes, self.eigenvectors)
        least_size = min(self.seed, self.radius, self.still, self.time, self.contrast)
        is_finite = np.isfinite([self.radius, self.still, self.time, self.contrast]).all()
        if least_count < 1 or least_size < 0 or not (is_finite and 0 < self.share <= 1 and 0 <= self.small_region < 1):
            raise SettingsError(
                f"{self}: frames, viewpoints, silhouettes and eigenvectors of at least 1, seed, radius, still, time "
                "and contrast of at least 0, a share from above 0 to 1 and a small_region from 0 to below 1 are "
                "expected"
            )


def segment_by_silhouettes(
    points: FloatArray, topology: Topology, parts: int | None = None, settings: SilhouetteSettings | None = None
) -> Index:
    """Find the part ``(F,)`` of every face between deforming silhouettes of points ``(T, V, 3)``."""
    settings = settings or SilhouetteSettings()
    check_part_count(parts, topology)
    x = sample_frames(points, settings.frames)
    surface = Diffusion(x[0], topology)
    deformation = surface.smooth(vertex_bending(x, topology) + vertex_strain(x, topology), settings.radius)
    significant = significant_vertices(x, topology, deformation, settings)
    distance = _signed_distance(surface, significant, settings)
    bottoms = -distance[topology.faces].mean(axis=1)  # negated distances, so that seeds are minima
    heights = bottoms[topology.hinge_faces].max(axis=1)
    min_depth = settings.contrast * float(np.average(np.abs(distance), weights=surface.areas))
    passes = find_passes(topology, heights, bottoms, face_areas(x[0], topology))
    return passes.segment(parts, min_depth, settings.small_region)


def viewpoints(count: int) -> Float:
    """Return directions ``(count, 3)``, evenly spread over the upper half sphere on a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    height = 1.0 - index / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


def silhouette(points: Float, topology: Topology, direction: Float) -> Mask:
    """Mark the hinges ``(H,)`` between a front and a back face, viewed from a direction ``(3,)``."""
    is_front = (TriangleMesh(points, topology).vector_areas @ direction > 0.0)[topology.hinge_faces]
    return np.asarray(is_front[:, 0] != is_front[:, 1])


def significant_vertices(points: Float, topology: Topology, deformation: Float, settings: SilhouetteSettings) -> Mask:
    """Mark the vertices ``(V,)`` that are marked on at least half of their silhouettes in poses ``(N, V, 3)``."""
    directions = viewpoints(settings.viewpoints)
    view_count = len(points) * len(directions)
    rng = np.random.default_rng(settings.seed)
    views = rng.choice(view_count, min(settings.silhouettes, view_count), replace=False)
    on_silhouette_count, mark_count = np.zeros((2, topology.vertex_count), dtype=np.int64)
    for pose, direction in zip(*np.divmod(np.sort(views), len(directions)), strict=True):
        edges = topology.hinge_edges[silhouette(points[pose], topology, directions[direction])]
        vertices = np.unique(topology.edges[edges])
        if not vertices.size:
            continue
        threshold = np.quantile(deformation[vertices], 1.0 - settings.share)
        on_silhouette_count[vertices] += 1
        mark_count[vertices[deformation[vertices] >= max(threshold, settings.still)]] += 1
    return (mark_count > 0) & (2 * mark_count >= on_silhouette_count)


def _signed_distance(surface: Diffusion, significant: Mask, settings: SilhouetteSettings) -> Float:
    """Return diffusion distances ``(V,)`` to the significant vertices; inside, minus the distances to other vertices.

    Only rim vertices, with a neighbour in the other region, are searched; others are rarely closer. 0 without a rim.
    """
    from scipy.spatial import cKDTree

    embedding = surface.embedding(settings.time, settings.eigenvectors)
    component = surface.topology.component_of_vertex
    edges = surface.topology.edges
    rim = index_mask(edges[significant[edges[:, 0]] != significant[edges[:, 1]]], len(embedding))
    result = np.zeros(len(embedding))
    for number in np.unique(component[rim]):
        in_component = component == number
        for side, sign in ((significant, -1.0), (~significant, 1.0)):
            tree = cKDTree(embedding[in_component & rim & ~side])
            result[in_component & side] = sign * tree.query(embedding[in_component & side])[0]
    return result


@dataclass(frozen=True)
class SpanningTreeSettings:
    """Settings of `segment_by_spanning_tree`. The values were chosen empirically; the paper gives no values.

    Attributes
    ----------
    frames : int
        Number of frames, evenly spread over the sequence.
    radius : float
        Smoothing radius of variations, in diagonals; 0 for none.
    contrast : float
        Fraction of the mesh's mean variation by which hinges must vary more than the insides of parts to be cut. Used
        only if the number of parts is not given.
    still : float
        Angle in degrees by which cut hinges must also vary more; smaller variations are noise.
    small_region : float
        Least fraction of the area of a part, unless more parts are requested than that allows.
    """

    frames: int = 24
    radius: float = 0.015
    contrast: float = 0.25
    still: float = 0.1
    small_region: float = 0.005

    def __post_init__(self) -> None:
        sizes = (self.radius, self.contrast, self.still)
        if self.frames < 1 or not (np.isfinite(sizes).all() and min(sizes) >= 0 and 0 <= self.small_region < 1):
            raise SettingsError(
                f"{self}: frames of at least 1, radius, contrast and still of at least 0, and a small_region from 0 to "
                f"below 1 are expected"
            )


def segment_by_spanning_tree(
    points: FloatArray, topology: Topology, parts: int | None = None, settings: SpanningTreeSettings | None = None
) -> Index:
    """Find the part ``(F,)`` of every face, bounded by hinges whose angles vary most in points ``(T, V, 3)``."""
    settings = settings or SpanningTreeSettings()
    check_part_count(parts, topology)
    x = sample_frames(points, settings.frames)
    surface = Diffusion(x[0], topology)
    bending = surface.smooth(vertex_bending(x, topology), settings.radius)
    heights = bending[topology.edges[topology.hinge_edges]].mean(axis=1)
    bottoms = np.full(len(topology.faces), np.inf)
    np.minimum.at(bottoms, topology.hinge_faces.reshape(-1), np.repeat(heights, 2))
    passes = find_passes(topology, heights, bottoms, face_areas(x[0], topology))
    min_depth = settings.contrast * float(np.average(bending, weights=surface.areas))
    return passes.segment(parts, max(min_depth, np.radians(settings.still)), settings.small_region)
