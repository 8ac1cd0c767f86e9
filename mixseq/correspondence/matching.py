"""Match a target to a registered source by closest points, and measure the quality.

A closest point counts if it is near enough and the surfaces face the same way there: where two legs touch, the facing
sides have opposite normals, and each finds its own. Vertices without one take that of the nearest neighbour along the
surface. Components of the target without a marker follow the nearest matched vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index, Mask
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.markers import Markers, Pairing
from mixseq.correspondence.triangle_mesh import ClosestPoints, TriangleMesh
from mixseq.errors import SettingsError


@dataclass(frozen=True)
class MatchingSettings:
    """Limits of closest points."""

    largest_angle: float = 75.0  # largest angle between the normals, in degrees
    largest_distance: float = 0.05  # largest distance, in diagonals of the target

    def __post_init__(self) -> None:
        if not 0 < self.largest_angle <= 180:
            raise SettingsError(f"the largest angle is {self.largest_angle}; give degrees from 0 to 180")
        if not self.largest_distance > 0:
            raise SettingsError(f"the largest distance is {self.largest_distance}; it must be positive")


@dataclass(frozen=True, eq=False)
class Matches:
    """A correspondence, and its matches before filling in."""

    correspondence: Correspondence  # the map
    found_vertices: Mask  # (V',) target vertices with a closest point of their own, not filled in
    found_faces: Mask  # (F',) target triangles with a closest point of their own, not filled in
    # (V',) distances of vertices from their matches, in the unit of the points; infinite without a match.
    distances: Float


@dataclass(frozen=True, eq=False)
class Quality:
    """Quality of a correspondence; distances are in diagonals of the target."""

    # Share of the source's area that, registered, lies on the target: within the distance and the angle of matches.
    source_coverage: float
    target_coverage: float  # share of the target's area whose triangles found a match themselves
    mean: float  # mean distance of the target's vertices from the registered source
    p99: float  # 99th percentile of these distances
    largest: float  # largest of these distances
    flipped: (
        int  # triangles of the target whose normal is against that of their triangle of the registered source
    )
    filled_vertices: int  # number of target vertices with the match of a neighbour
    filled_faces: int  # number of target triangles with the match of a neighbour
    followers: int  # number of components that follow a vertex, without unused vertices
    # (n,) distances of marked vertices of the registered source from the vertices of the target that they should be at.
    marker_distances: Float
    markers: Markers  # the markers

    def worst_markers(self, count: int = 5) -> list[tuple[str, float]]:
        """Return names and distances of the markers with the largest distances, the worst first."""
        order = np.argsort(-self.marker_distances, kind="stable")[:count]
        return [(self.markers.name(int(k)), float(self.marker_distances[k])) for k in order]


def match(
    registered: TriangleMesh,
    target: TriangleMesh,
    pairings: tuple[Pairing, ...],
    settings: MatchingSettings | None = None,
) -> Matches:
    """Find the source point of every target vertex, and the source triangle of every target triangle."""
    settings = MatchingSettings() if settings is None else settings
    vertex_count, face_count = len(target.points), len(target.faces)
    # Vertices and, after them, triangles, by their centroids: both are nodes of the graph along the mesh.
    queries = np.concatenate([target.points, target.centroids])
    normals = np.concatenate([target.vertex_normals, target.face_normals])
    faces, weights = np.full(len(queries), -1), np.zeros((len(queries), 3))
    distances = np.full(len(queries), np.inf)
    searches = [
        (
            ClosestPoints(registered, pairing.source_faces),
            np.concatenate([pairing.target_vertices, vertex_count + pairing.target_faces]),
        )
        for pairing in pairings
    ]
    for search, own in searches:
        found = search.query(queries[own], normals[own], settings.largest_angle)
        near = found.distances <= settings.largest_distance * target.diagonal
        close = own[near]
        faces[close], weights[close] = found.faces[near], found.weights[near]
        distances[close] = found.distances[near]
    found_themselves = faces >= 0
    graph, is_vertex = _surface_graph(target), np.arange(len(queries)) < vertex_count
    for kind in (is_vertex, ~is_vertex):
        nearest = _nearest_along(graph, np.flatnonzero(kind & found_themselves))
        filled = np.flatnonzero(kind & (nearest >= 0))
        faces[filled], weights[filled] = faces[nearest[filled]], weights[nearest[filled]]
    for search, own in searches:  # components without a near match take any
        left = own[faces[own] < 0]
        found = search.query(queries[left])
        faces[left], weights[left] = found.faces, found.weights
    on = faces[:vertex_count]
    corners = np.where(on[:, None] >= 0, registered.faces[on], -1)
    correspondence = Correspondence(
        (len(registered.points), len(registered.faces)),
        (vertex_count, face_count),
        corners,
        weights[:vertex_count],
        faces[vertex_count:],
        target.leaders(on >= 0),
    )
    return Matches(
        correspondence,
        found_themselves[:vertex_count],
        found_themselves[vertex_count:],
        distances[:vertex_count],
    )


def assess(
    registered: TriangleMesh,
    target: TriangleMesh,
    pairings: tuple[Pairing, ...],
    markers: Markers,
    matches: Matches,
    settings: MatchingSettings,
) -> Quality:
    """Measure a correspondence of `match` with these settings."""
    size = target.diagonal
    correspondence = matches.correspondence
    covered = 0.0
    for pairing in pairings:
        own = pairing.source_faces
        goal = ClosestPoints(target, pairing.target_faces)
        found = goal.query(registered.centroids[own], registered.face_normals[own], settings.largest_angle)
        near = found.distances <= settings.largest_distance * size
        covered += float(registered.face_areas[own[near]].sum())
    # One zero without matches, which the coverage reports.
    distances = (
        matches.distances[matches.found_vertices] / size if matches.found_vertices.any() else np.zeros(1)
    )
    mapped = correspondence.faces >= 0
    cosines = np.einsum(
        "fc,fc->f", target.face_normals[mapped], registered.face_normals[correspondence.faces[mapped]]
    )
    first = target.faces[:, 0]
    following = target.topology.component_of_vertex[first[~correspondence.matched[first]]]
    gaps = registered.points[markers.source] - target.points[markers.target]
    return Quality(
        covered / max(float(registered.face_areas.sum()), 1e-300),
        float(target.face_areas[matches.found_faces].sum() / max(float(target.face_areas.sum()), 1e-300)),
        float(distances.mean()),
        float(np.percentile(distances, 99)),
        float(distances.max()),
        int((cosines < 0).sum()),
        int((correspondence.matched & ~matches.found_vertices).sum()),
        int((mapped & ~matches.found_faces).sum()),
        len(np.unique(following)),
        np.linalg.norm(gaps, axis=1) / size,
        markers,
    )


def _surface_graph(mesh: TriangleMesh) -> sparse.csr_array:
    """Return a graph of distances along a surface: its vertices and, after them, its triangles."""
    count = len(mesh.points)
    i, j = mesh.topology.edges.T
    corner, face = mesh.faces.reshape(-1), np.repeat(np.arange(len(mesh.faces)), 3)
    to_centre = np.linalg.norm(mesh.points[corner] - mesh.centroids[face], axis=1)
    lengths = np.concatenate([np.sqrt(mesh.squared_lengths), to_centre])
    # Stored zeros are no edges to csgraph: vertices in one place are a hair apart.
    lengths = np.maximum(lengths, 1e-12 * mesh.diagonal)
    size = count + len(mesh.faces)
    ends = np.concatenate([i, corner]), np.concatenate([j, count + face])
    half = sparse.coo_array((lengths, ends), shape=(size, size))
    return half.tocsr()


def _nearest_along(graph: sparse.csr_array, sources: Index) -> Index:
    """Return the nearest source of every node along a graph, -1 if none is connected."""
    if not len(sources):
        return np.full(graph.shape[0], -1)
    nearest = csgraph.dijkstra(
        graph, directed=False, indices=sources, return_predecessors=True, min_only=True
    )[2]
    return np.maximum(nearest, -1).astype(np.int64)
