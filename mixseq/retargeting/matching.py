"""Correspondences of a target: matched to a registered source by closest points, or completed from a given map.

*Matching.* A closest point counts if it is near enough and the surfaces face the same way there: where two legs touch,
the facing sides have opposite normals, and each finds its own. Vertices without one take that of the nearest neighbour
along the surface. Components of the target without a marker follow the nearest matched vertex.

*Completing* a map of vertices, of triangles, or of points on triangles:

- *Vertices*, where only triangles are mapped, are on the source vertex that all triangles around them share, or else at
  the point closest to the mean, by area, of the mapped triangles' centroids.
- *Triangles* of the target are moved by the source triangle of the same three vertices, or else by the closest to the
  mean of their mapped corners that faces the same way.
- *Unmapped vertices* follow the nearest mapped vertex of their component, and unmapped components rigidly follow one
  vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import ClosestPoints, TriangleMesh
from mixseq.retargeting.markers import Correspondence, Markers, Pairing
from mixseq.types import Float, FloatArray, Index, IntArray, Mask


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
class CorrespondenceQuality:
    """Quality of a correspondence; distances are in diagonals of the target."""

    # Share of the source's area that, registered, lies on the target: within the distance and the angle of matches.
    source_coverage: float
    target_coverage: float  # share of the target's area whose triangles found a match themselves
    mean_distance: float  # mean distance of the target's vertices from the registered source
    p99_distance: float  # 99th percentile of these distances
    largest_distance: float  # largest of these distances
    flipped_count: (
        int  # target triangles with a normal against that of their triangle of the registered source
    )
    filled_vertex_count: int  # number of target vertices with the match of a neighbour
    filled_face_count: int  # number of target triangles with the match of a neighbour
    follower_count: int  # number of components that follow a vertex, without unused vertices
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
) -> CorrespondenceQuality:
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
    return CorrespondenceQuality(
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


RestMesh = tuple[FloatArray, IntArray]
"""Points ``(V, 3)`` and triangles ``(F, 3)`` of a mesh at rest."""

ADDS_TO_ONE = 1e-3
"""Largest deviation of sums of weights from one, as of rounded files; weights are then normalised."""


def from_vertices(vertices: ArrayLike, source: RestMesh, target: RestMesh) -> Correspondence:
    """Complete a map of vertices ``(V',)``, -1 for none: source, target ``(V, 3)``."""
    a, b = _mesh(source), _mesh(target)
    numbers = _numbers(vertices, len(b.points), len(a.points), "vertices")
    weights = np.where(numbers[:, None] >= 0, [1.0, 0.0, 0.0], 0.0)
    return _complete(a, b, np.repeat(numbers[:, None], 3, axis=1), weights, np.full(len(b.faces), -1))


def from_triangles(triangles: ArrayLike, source: RestMesh, target: RestMesh) -> Correspondence:
    """Complete a map of triangles ``(F',)``: source, target ``(V, 3)``."""
    a, b = _mesh(source), _mesh(target)
    numbers = _numbers(triangles, len(b.faces), len(a.faces), "triangles")
    corners, weights = _vertices_of(numbers, a, b)
    return _complete(a, b, corners, weights, numbers)


def from_barycentric(
    corners: ArrayLike, weights: ArrayLike, source: RestMesh, target: RestMesh
) -> Correspondence:
    """Complete a map of target vertices to points of the source: corners, weights ``(V', 3)``."""
    a, b = _mesh(source), _mesh(target)
    flat = np.asarray(corners).reshape(-1)
    numbers = _numbers(flat, 3 * len(b.points), len(a.points), "corners, three for each of its vertices")
    on = numbers.reshape(-1, 3)
    on = np.where((on >= 0).all(axis=1, keepdims=True), on, -1)
    given = np.asarray(weights)
    if given.shape != on.shape or given.dtype.kind not in "fiu" or not np.isfinite(given).all():
        raise SettingsError(
            f"weights have shape {given.shape} and type {given.dtype}; finite numbers {on.shape} are expected"
        )
    sums, matched = given.sum(axis=1), on[:, 0] >= 0
    wrong = np.flatnonzero(matched & (np.abs(sums - 1) > ADDS_TO_ONE))
    if wrong.size:
        raise SettingsError(
            f"the weights of target vertex {wrong[0]} add to {sums[wrong[0]]:.4g}; 1 is expected"
            + (f" ({len(wrong)} vertices)" if len(wrong) > 1 else "")
        )
    scaled = np.where(matched[:, None], given / np.where(matched, sums, 1.0)[:, None], 0.0)
    return _complete(a, b, on, scaled, np.full(len(b.faces), -1))


def _mesh(mesh: RestMesh) -> TriangleMesh:
    points = np.asarray(mesh[0], np.float64)
    return TriangleMesh(points, Topology(np.asarray(mesh[1]), len(points)))


def _numbers(given: ArrayLike, target_count: int, source_count: int, what: str) -> Index:
    """Return a map of whole numbers, or raise."""
    numbers = np.asarray(given)
    if numbers.shape != (target_count,) or not np.issubdtype(numbers.dtype, np.integer):
        raise SettingsError(
            f"the map has shape {numbers.shape} and type {numbers.dtype}; the target has {target_count} {what}: as "
            "many whole numbers are expected"
        )
    outside = np.flatnonzero((numbers < -1) | (numbers >= source_count))
    if outside.size:
        counted = (
            ", or subtract 1 from all: the map may count from 1" if numbers.max() == source_count else ""
        )
        raise SettingsError(
            f"entry {outside[0]} of the map is {numbers[outside[0]]}, but the source has {source_count} ({what}), "
            f"0 to {source_count - 1}, and -1 stands for none; see that source and target are not exchanged{counted}"
        )
    if not (numbers >= 0).any():
        raise SettingsError(
            f"the map leaves out all {what} of the target; at least one must be on the source"
        )
    return numbers.astype(np.int64)


def _vertices_of(triangles: Index, source: TriangleMesh, target: TriangleMesh) -> tuple[Index, Float]:
    """Return corners and weights of target vertices, from the source triangles of the triangles around them."""
    count = len(target.points)
    used = np.flatnonzero(triangles >= 0)
    vertex, corner = target.faces[used].reshape(-1), np.tile(np.arange(3), len(used))
    face, on = np.repeat(used, 3), np.repeat(triangles[used], 3)
    around = np.bincount(vertex, minlength=count)
    weights = np.zeros((count, 3))
    # Areas of zero would leave vertices nowhere.
    areas = target.face_areas[face] + 1e-12 * target.diagonal**2
    total = np.bincount(vertex, areas, count)
    sums = np.zeros((2, count, 3))
    for k in range(3):
        sums[0, :, k] = np.bincount(vertex, areas * source.centroids[on, k], count)
        sums[1, :, k] = np.bincount(vertex, areas * source.face_normals[on, k], count)
    matched = np.flatnonzero(around > 0)
    means, normals = sums[:, matched] / total[matched, None]
    closest, barycentric = _closest_facing(source, means, normals)
    corners = np.full((count, 3), -1)
    corners[matched], weights[matched] = source.faces[closest], barycentric
    shared = _shared(vertex, source.faces[on], source.faces[on, corner], around)
    exact = shared >= 0
    corners[exact], weights[exact] = shared[exact, None], [1.0, 0.0, 0.0]
    return corners, weights


def _shared(vertex: Index, candidates: Index, same_corner: Index, around: Index) -> Index:
    """Return the common source vertex ``(n,)`` of mapped triangles at target vertices, or -1: candidates ``(n, 3)``."""
    result = np.full(len(around), -1)
    for votes in (candidates, same_corner[:, None]):
        pairs = np.stack([np.repeat(vertex, votes.shape[1]), votes.reshape(-1)], axis=1)
        pairs, counts = np.unique(pairs, axis=0, return_counts=True)
        pairs = pairs[counts == around[pairs[:, 0]]]
        alone = np.bincount(pairs[:, 0], minlength=len(around))[pairs[:, 0]] == 1
        result[pairs[alone, 0]] = pairs[alone, 1]
    return result


def _complete(
    source: TriangleMesh, target: TriangleMesh, corners: Index, weights: Float, faces: Index
) -> Correspondence:
    """Complete a map of vertices: corners, weights ``(V', 3)``; faces ``(F',)``."""
    matched = np.asarray((corners >= 0).all(axis=1))
    whole = np.asarray(matched[target.faces].all(axis=1))
    open_faces = np.flatnonzero(whole & (faces < 0))
    faces = np.where(whole, faces, -1)
    faces[open_faces] = _faces_of(source, target, corners, weights, open_faces)
    return Correspondence(
        (len(source.points), len(source.faces)),
        (len(target.points), len(target.faces)),
        corners,
        weights,
        faces,
        target.leaders(matched),
    )


def _faces_of(
    source: TriangleMesh, target: TriangleMesh, corners: Index, weights: Float, chosen: Index
) -> Index:
    """Return the source triangles that move chosen target triangles, by the points of their corners."""
    triangles = target.faces[chosen]
    # A corner with all its weight on one vertex is that vertex, which may be written in several ways.
    heaviest = np.take_along_axis(corners, np.argmax(weights, axis=1)[:, None], axis=1)[:, 0]
    exact = _same_triangles(source.faces, heaviest[triangles])
    exact[~(weights.max(axis=1) == 1)[triangles].all(axis=1)] = -1
    rest = np.flatnonzero(exact < 0)
    if rest.size and len(source.faces):
        mapped = np.einsum("vk,vkc->vc", weights, source.points[corners])
        normals = np.einsum("vk,vkc->vc", weights, source.vertex_normals[corners])
        exact[rest] = _closest_facing(
            source, mapped[triangles[rest]].mean(axis=1), normals[triangles[rest]].sum(axis=1)
        )[0]
    return exact


def _same_triangles(source: Index, wanted: Index) -> Index:
    """Return the first source triangle ``(F, 3)`` with each wanted one's vertices, same orientation first, or -1."""
    both = np.concatenate([source, wanted])
    first = np.argmin(both, axis=1)
    turned = np.take_along_axis(both, (first[:, None] + np.arange(3)) % 3, axis=1)
    result = np.full(len(wanted), -1)
    for keys in (np.sort(both, axis=1), turned):
        number = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        known = np.full(number.max(initial=-1) + 1, -1)
        known[number[: len(source)][::-1]] = np.arange(len(source))[::-1]
        found = known[number[len(source) :]]
        result = np.where(found >= 0, found, result)
    return result


def _closest_facing(source: TriangleMesh, points: Float, normals: Float) -> tuple[Index, Float]:
    """Return triangles and weights closest to points, of those that face the same way if there are any."""
    from mixseq.mesh.nearest import Nearest

    nearest = Nearest.of(source.points, source.faces)
    found = nearest.query(points, normals)
    faces, weights = found.faces.copy(), found.weights.copy()
    facing_away = np.flatnonzero(faces < 0)
    if facing_away.size:
        again = nearest.query(points[facing_away])
        faces[facing_away], weights[facing_away] = again.faces, again.weights
    return faces, weights
