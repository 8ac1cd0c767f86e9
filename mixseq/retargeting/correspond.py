"""Dense correspondences of two meshes: from markers, by registration and matching, or completed from a given map.

*Matching.* Closest points are limited in distance and in the angle between normals. The inner sides of two touching
legs have opposite normals, so each side is matched to the correct leg. Vertices without a match copy the match of the
nearest matched vertex along the surface. Target components without a marker follow the nearest matched vertex.

*Completing* a map of vertices, of triangles, or of points on triangles:

- *Vertices* in a map of triangles have the source vertex shared by the source triangles of all triangles around them.
  Without such a vertex they have the source point closest to the area-weighted mean of the mapped centroids.
- *Triangles* in a map of vertices have the source triangle with the same three vertices. Without such a triangle they
  have the triangle of equal orientation that is closest to the mean of their mapped corners.
- *Unmapped vertices* follow the nearest mapped vertex of their component. Unmapped components rigidly follow a vertex.

*Examining* markers while they are set checks their consistency, and finds a correspondence of decimated meshes within a
second. Its registration is stiff and does not reach inconsistent markers; the distances that remain are the residuals.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.decimation import decimate
from mixseq.mesh.nearest import ClosestPointQuery
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import Suspicion, check_facing, check_markers, check_orientation, find_suspicious_markers
from mixseq.retargeting.markers import Correspondence, Markers, Pairing, pair_components
from mixseq.retargeting.registration import LAST_STIFFNESS, STIFFNESS_STEPS, register
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, IntArray, Mask

MAX_NORMAL_ANGLE_DEGREES = 75.0  # largest angle between the normals of a point and its match
MAX_MATCH_DISTANCE_DIAGONALS = 0.05  # largest distance of a match, in diagonals of the target


@dataclass(frozen=True, eq=False)
class Matches:
    """A complete correspondence, and masks of its direct matches by closest points."""

    correspondence: Correspondence  # complete correspondence
    has_vertex_match: Mask  # (V',) target vertices with a match
    has_face_match: Mask  # (F',) target triangles with a match
    distances: Float  # (V',) distances of target vertices from their matches; infinite without a match


@dataclass(frozen=True, eq=False)
class CorrespondenceQuality:
    """Quality of a correspondence; distances are in diagonals of the target, and infinite if no vertex has a match."""

    source_coverage: float  # share of the registered source's area with a match on the target
    target_coverage: float  # share of the target's area with a match on the source
    mean_distance: float  # mean distance of the matched target vertices from the registered source
    p99_distance: float  # 99th percentile of these distances
    largest_distance: float  # largest of these distances
    flipped_count: int  # number of target triangles that face away from their registered source triangle
    filled_vertex_count: int  # number of target vertices with the match of a neighbour
    filled_face_count: int  # number of target triangles with the match of a neighbour
    follower_count: int  # number of target components that follow a vertex; unused vertices do not count
    marker_distances: Float  # (n,) distances of registered source markers from target markers
    markers: Markers  # markers of the registration

    @property
    def worst_marker(self) -> int:
        """Marker with the largest distance."""
        return int(self.marker_distances.argmax())


def match(registered: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...]) -> Matches:
    """Match the vertices and triangles of a target to a registered source by closest points."""
    vertex_count = len(target.points)
    # Query points are vertices, then centroids of triangles, in the order of the surface graph's nodes.
    queries = np.concatenate([target.points, target.centroids])
    normals = np.concatenate([target.vertex_normals, target.face_normals])
    faces, weights = np.full(len(queries), -1), np.zeros((len(queries), 3))
    distances, max_distance = np.full(len(queries), np.inf), MAX_MATCH_DISTANCE_DIAGONALS * target.diagonal
    searches = [
        (
            ClosestPointQuery.from_mesh(registered.points, registered.faces, pairing.source_faces),
            np.concatenate([pairing.target_vertices, vertex_count + pairing.target_faces]),
        )
        for pairing in pairings
    ]
    for search, query_ids in searches:
        closest = search.query(queries[query_ids], normals[query_ids], MAX_NORMAL_ANGLE_DEGREES, max_distance)
        is_near = closest.faces >= 0
        matched_ids = query_ids[is_near]
        faces[matched_ids], weights[matched_ids] = closest.faces[is_near], closest.weights[is_near]
        distances[matched_ids] = closest.distances[is_near]
    is_matched = faces >= 0
    graph, is_vertex = _surface_graph(target), np.arange(len(queries)) < vertex_count
    for is_kind in (is_vertex, ~is_vertex):
        nearest = _nearest_sources(graph, np.flatnonzero(is_kind & is_matched))
        filled_ids = np.flatnonzero(is_kind & (nearest >= 0))
        faces[filled_ids], weights[filled_ids] = faces[nearest[filled_ids]], weights[nearest[filled_ids]]
    for search, query_ids in searches:  # components without a match within the limits: search at any distance
        unmatched_ids = query_ids[faces[query_ids] < 0]
        closest = search.query(queries[unmatched_ids])
        faces[unmatched_ids], weights[unmatched_ids] = closest.faces, closest.weights
    vertex_faces = faces[:vertex_count]
    corners = np.where(vertex_faces[:, None] >= 0, registered.faces[vertex_faces], -1)
    correspondence = _with_leaders(registered, target, corners, weights[:vertex_count], faces[vertex_count:])
    has_vertex_match, has_face_match = is_matched[:vertex_count], is_matched[vertex_count:]
    return Matches(correspondence, has_vertex_match, has_face_match, distances[:vertex_count])


def assess(
    registered: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...], markers: Markers, matches: Matches
) -> CorrespondenceQuality:
    """Measure the quality of a correspondence of `match`."""
    diagonal = target.diagonal
    correspondence = matches.correspondence
    covered_area = 0.0
    for pairing in pairings:
        face_ids = pairing.source_faces
        search = ClosestPointQuery.from_mesh(target.points, target.faces, pairing.target_faces)
        centroids, normals = registered.centroids[face_ids], registered.face_normals[face_ids]
        max_distance = MAX_MATCH_DISTANCE_DIAGONALS * diagonal
        closest = search.query(centroids, normals, MAX_NORMAL_ANGLE_DEGREES, max_distance)
        covered_area += float(registered.face_areas[face_ids[closest.faces >= 0]].sum())
    distances = matches.distances[matches.has_vertex_match] / diagonal
    mean, p99, largest = (
        (float(distances.mean()), float(np.percentile(distances, 99)), float(distances.max()))
        if distances.size
        else (np.inf, np.inf, np.inf)
    )
    is_mapped = correspondence.faces >= 0
    source_normals = registered.face_normals[correspondence.faces[is_mapped]]
    cosines = np.einsum("fc,fc->f", target.face_normals[is_mapped], source_normals)
    first_corners = target.faces[:, 0]
    followers = first_corners[~correspondence.matched[first_corners]]
    marker_offsets = registered.points[markers.source] - target.points[markers.target]
    return CorrespondenceQuality(
        covered_area / max(float(registered.face_areas.sum()), 1e-300),
        float(target.face_areas[matches.has_face_match].sum() / max(float(target.face_areas.sum()), 1e-300)),
        mean,
        p99,
        largest,
        int((cosines < 0).sum()),
        int((correspondence.matched & ~matches.has_vertex_match).sum()),
        int((is_mapped & ~matches.has_face_match).sum()),
        len(np.unique(target.topology.component_of_vertex[followers])),
        np.linalg.norm(marker_offsets, axis=1) / diagonal,
        markers,
    )


def _with_leaders(
    source: TriangleMesh, target: TriangleMesh, corners: Index, weights: Float, faces: Index
) -> Correspondence:
    """Return a correspondence in which vertices without corners follow leaders."""
    source_size, target_size = ((len(mesh.points), len(mesh.faces)) for mesh in (source, target))
    leaders = target.leaders(np.asarray((corners >= 0).all(axis=1)))
    return Correspondence(source_size, target_size, corners, weights, faces, leaders)


def _surface_graph(mesh: TriangleMesh) -> sparse.csr_array:
    """Return the graph of edge lengths between the vertices and centroids of a surface."""
    vertex_count = len(mesh.points)
    i, j = mesh.topology.edges.T
    corner_vertices, corner_faces = mesh.faces.reshape(-1), np.repeat(np.arange(len(mesh.faces)), 3)
    centroid_distances = np.linalg.norm(mesh.points[corner_vertices] - mesh.centroids[corner_faces], axis=1)
    lengths = np.concatenate([np.sqrt(mesh.squared_lengths), centroid_distances])
    # Lengths are positive, since csgraph ignores stored zeros.
    lengths = np.maximum(lengths, 1e-12 * mesh.diagonal)
    node_count = vertex_count + len(mesh.faces)
    edges = np.concatenate([i, corner_vertices]), np.concatenate([j, vertex_count + corner_faces])
    graph = sparse.coo_array((lengths, edges), shape=(node_count, node_count))
    return graph.tocsr()


def _nearest_sources(graph: sparse.csr_array, sources: Index) -> Index:
    """Return the nearest source of every graph node; -1 if no source is connected to the node."""
    if not len(sources):
        return np.full(graph.shape[0], -1)
    nearest = csgraph.dijkstra(graph, directed=False, indices=sources, return_predecessors=True, min_only=True)[2]
    return np.maximum(nearest, -1).astype(np.int64)


MIN_MARKED_AREA_SHARE = 0.5  # share of a mesh's area in components with markers, below which a warning is issued
MAX_FILLED_FACE_SHARE = 0.05  # largest share of target triangles without a match; tested pairs have less than 0.01
MAX_FLIPPED_FACE_SHARE = 0.01  # largest share of flipped target triangles; tested pairs have none


@public
def correspond(
    source: FileOr[MeshSequence | HasFrames],
    target: FileOr[MeshSequence | HasFrames],
    markers: FileOr[Markers],
    rest: int = 0,
    progress: Progress = log_progress,
) -> Correspondence:
    """Find a dense correspondence of two meshes from a few markers.

    Parameters
    ----------
    source : MeshSequence
        Mesh whose motion is transferred.
    target : MeshSequence
        Mesh that receives the motion; its first frame is used.
    markers : Markers
        At least four pairs of vertices, spread over the meshes.
    rest : int
        Frame of the source with a pose like the target's.
    progress : callable
        Called with the progress.

    Returns
    -------
    Correspondence
        Source points of the target's vertices. Target components without markers follow other components.

    Raises
    ------
    SettingsError
        If there are fewer than four markers, markers are invalid (see `check_markers`), the frame does not exist, a
        mesh has no faces, the marked components of a mesh have no area, a mesh is inside out, or markers were set on
        another mesh.

    Warns
    -----
    MixseqWarning
        If markers seem exchanged or wrong, components are inside out, or most of a mesh's area has no markers.

    Examples
    --------
    >>> import mixseq
    >>> markers = mixseq.Markers.from_pairs([(0, 0), (2, 2), (38, 38), (72, 72), (74, 74)])
    >>> correspondence = mixseq.correspond("arm.usdc", "long.obj", markers)
    >>> correspondence.interpolate(mixseq.read("arm.usdc")[0]).shape
    (77, 3)
    """
    source = cast("MeshSequence", source)
    target = cast("MeshSequence", target)
    markers = cast("Markers", markers)
    return correspond_and_assess(source, target, markers, rest, progress)[0]


@one_blas_thread()
def correspond_and_assess(
    source: MeshSequence,
    target: MeshSequence,
    markers: Markers,
    rest: int = 0,
    progress: Progress = log_progress,
    last_stiffness: float = LAST_STIFFNESS,
    steps: int = STIFFNESS_STEPS,
) -> tuple[Correspondence, CorrespondenceQuality]:
    """Find a correspondence like `correspond`, and return it with its quality."""
    if not -source.frame_count <= rest < source.frame_count:
        raise SettingsError(f"the source has no frame {rest}; the rest pose is one of 0 ... {source.frame_count - 1}")
    markers = markers.renumbered(source, target)
    for side, sequence in (("source", source), ("target", target)):
        if not len(sequence.faces):
            raise SettingsError(f"the {side} has no faces; a correspondence is between surfaces")
    source_mesh = _triangle_mesh(source.points[rest], source.faces)
    target_mesh = _triangle_mesh(target.points[0], target.faces)
    check_markers(markers, source_mesh, target_mesh)
    pairings = pair_components(source_mesh.topology, target_mesh.topology, markers)
    _check_areas(source_mesh, target_mesh, pairings)
    are_closed = check_orientation(source_mesh, target_mesh)
    points = register(source_mesh, target_mesh, pairings, markers, progress, last_stiffness, steps)
    registered = TriangleMesh(points, source_mesh.topology)
    if not are_closed:  # the volumes of closed meshes are checked
        check_facing(registered, target_mesh)
    matches = match(registered, target_mesh, pairings)
    quality = assess(registered, target_mesh, pairings, markers, matches)
    _warn_of_poor_matches(quality, matches.correspondence)
    return matches.correspondence, quality


def _warn_of_poor_matches(quality: CorrespondenceQuality, correspondence: Correspondence) -> None:
    """Warn if many triangles of the target have no match or are flipped."""
    mapped_count = max(int(np.count_nonzero(correspondence.faces >= 0)), 1)
    unmatched = "have no source triangle nearby that faces the same way, and follow their neighbours"
    for count, max_share, problem in (
        (quality.filled_face_count, MAX_FILLED_FACE_SHARE, unmatched),
        (quality.flipped_count, MAX_FLIPPED_FACE_SHARE, "face away from their source triangles"),
    ):
        if count > max_share * mapped_count:
            warnings.warn(
                f"{count} of {mapped_count} mapped triangles of the target {problem}; give both meshes in the same "
                "pose, and check that all markers are on the right component. The picture shows where limbs went",
                MixseqWarning,
                stacklevel=5,
            )


def _check_areas(source: TriangleMesh, target: TriangleMesh, pairings: tuple[Pairing, ...]) -> None:
    """Raise if the marked components of a mesh have no area, and warn if their share of its area is small."""
    for side, mesh, component_faces in (
        ("source", source, [pairing.source_faces for pairing in pairings]),
        ("target", target, [pairing.target_faces for pairing in pairings]),
    ):
        marked_area = float(mesh.face_areas[np.concatenate(component_faces)].sum())
        if not marked_area > 0:
            raise SettingsError(
                f"all markers of the {side} are on components without area; mark vertices of other components"
            )
        share = marked_area / float(mesh.face_areas.sum())
        if share < MIN_MARKED_AREA_SHARE:
            warnings.warn(
                f"components with markers are only {100 * share:.0f} % of the {side}'s area, and all others follow "
                "them as if stuck; mark them too, or weld vertices that are in one place",
                MixseqWarning,
                stacklevel=5,
            )


RestMesh = tuple[FloatArray, IntArray]
"""Points ``(V, 3)`` and triangles ``(F, 3)`` of a mesh at rest."""

WEIGHT_SUM_TOLERANCE = 1e-3  # tolerated deviation of a sum of barycentric weights from one, before normalisation


def from_vertices(vertices: ArrayLike, source: RestMesh, target: RestMesh) -> Correspondence:
    """Complete a map ``(V',)`` from target vertices to source vertices; -1 for unmapped vertices."""
    source_mesh, target_mesh = _triangle_mesh(*source), _triangle_mesh(*target)
    source_vertices = _check_map(vertices, len(target_mesh.points), len(source_mesh.points), "vertices")
    weights = np.where(source_vertices[:, None] >= 0, [1.0, 0.0, 0.0], 0.0)
    corners, faces = np.repeat(source_vertices[:, None], 3, axis=1), np.full(len(target_mesh.faces), -1)
    return _complete_map(source_mesh, target_mesh, corners, weights, faces)


def from_triangles(triangles: ArrayLike, source: RestMesh, target: RestMesh) -> Correspondence:
    """Complete a map ``(F',)`` from target triangles to source triangles."""
    source_mesh, target_mesh = _triangle_mesh(*source), _triangle_mesh(*target)
    source_faces = _check_map(triangles, len(target_mesh.faces), len(source_mesh.faces), "triangles")
    corners, weights = _locate_vertices(source_faces, source_mesh, target_mesh)
    return _complete_map(source_mesh, target_mesh, corners, weights, source_faces)


def from_barycentric(corners: ArrayLike, weights: ArrayLike, source: RestMesh, target: RestMesh) -> Correspondence:
    """Complete a map from target vertices to points of the source: corners, weights ``(V', 3)``."""
    source_mesh, target_mesh = _triangle_mesh(*source), _triangle_mesh(*target)
    flat_corners = np.asarray(corners).reshape(-1)
    entry_count, vertex_count = 3 * len(target_mesh.points), len(source_mesh.points)
    ids = _check_map(flat_corners, entry_count, vertex_count, "corners, three for each of its vertices")
    ids = ids.reshape(-1, 3)
    ids = np.where((ids >= 0).all(axis=1, keepdims=True), ids, -1)
    values = np.asarray(weights)
    if values.shape != ids.shape or values.dtype.kind not in "fiu" or not np.isfinite(values).all():
        raise SettingsError(
            f"weights have shape {values.shape} and type {values.dtype}; finite numbers {ids.shape} are expected"
        )
    sums, is_matched = values.sum(axis=1), ids[:, 0] >= 0
    wrong_vertices = np.flatnonzero(is_matched & (np.abs(sums - 1) > WEIGHT_SUM_TOLERANCE))
    if wrong_vertices.size:
        raise SettingsError(
            f"the weights of target vertex {wrong_vertices[0]} add to {sums[wrong_vertices[0]]:.4g}; 1 is expected"
            + (f" ({len(wrong_vertices)} vertices)" if len(wrong_vertices) > 1 else "")
        )
    values = np.where(is_matched[:, None], values / np.where(is_matched, sums, 1.0)[:, None], 0.0)
    return _complete_map(source_mesh, target_mesh, ids, values, np.full(len(target_mesh.faces), -1))


def _triangle_mesh(points: FloatArray, faces: IntArray) -> TriangleMesh:
    return TriangleMesh(np.asarray(points, np.float64), Topology(np.asarray(faces), len(points)))


def _check_map(entries: ArrayLike, target_count: int, source_count: int, element_names: str) -> Index:
    """Return a map as ids ``(n,)``; raise if the map is invalid."""
    ids = np.asarray(entries)
    if ids.shape != (target_count,) or not np.issubdtype(ids.dtype, np.integer):
        raise SettingsError(
            f"the map has shape {ids.shape} and type {ids.dtype}; the target has {target_count} {element_names}: one "
            "whole number for each is expected"
        )
    outside = np.flatnonzero((ids < -1) | (ids >= source_count))
    if outside.size:
        advice = ", or subtract 1 from all: the map may count from 1" if ids.max() == source_count else ""
        raise SettingsError(
            f"entry {outside[0]} of the map is {ids[outside[0]]}, but the source has {source_count} ({element_names}), "
            f"0 to {source_count - 1}, and -1 stands for none; check that source and target are not exchanged{advice}"
        )
    if not (ids >= 0).any():
        raise SettingsError(f"the map leaves out all {element_names} of the target; at least one must be on the source")
    return ids.astype(np.int64)


def _locate_vertices(triangles: Index, source: TriangleMesh, target: TriangleMesh) -> tuple[Index, Float]:
    """Return corners and weights ``(V', 3)`` of target vertices, from a map of triangles ``(F',)``."""
    vertex_count = len(target.points)
    mapped_faces = np.flatnonzero(triangles >= 0)
    vertices = target.faces[mapped_faces].reshape(-1)
    face_of_corner, source_faces = np.repeat(mapped_faces, 3), np.repeat(triangles[mapped_faces], 3)
    corner_counts = np.bincount(vertices, minlength=vertex_count)
    weights = np.zeros((vertex_count, 3))
    areas = target.face_areas[face_of_corner] + 1e-12 * target.diagonal**2  # means need a positive total area
    total_areas = np.bincount(vertices, areas, vertex_count)
    sums = np.zeros((2, vertex_count, 3))
    for k in range(3):
        sums[0, :, k] = np.bincount(vertices, areas * source.centroids[source_faces, k], vertex_count)
        sums[1, :, k] = np.bincount(vertices, areas * source.face_normals[source_faces, k], vertex_count)
    matched_vertices = np.flatnonzero(corner_counts > 0)
    mean_points, normals = sums[:, matched_vertices] / total_areas[matched_vertices, None]
    search = ClosestPointQuery.from_mesh(source.points, source.faces)
    closest, barycentric = search.query_facing(mean_points, normals)
    corners = np.full((vertex_count, 3), -1)
    corners[matched_vertices], weights[matched_vertices] = source.faces[closest], barycentric
    source_corners, corner_index = source.faces[source_faces], np.tile(np.arange(3), len(mapped_faces))
    equal_corners = source.faces[source_faces, corner_index]
    shared_vertices = _shared_vertices(vertices, source_corners, equal_corners, corner_counts)
    has_shared = shared_vertices >= 0
    corners[has_shared], weights[has_shared] = shared_vertices[has_shared, None], [1.0, 0.0, 0.0]
    return corners, weights


def _shared_vertices(
    vertex_of_corner: Index, source_corners: Index, equal_corners: Index, corner_counts: Index
) -> Index:
    """Return the source vertex ``(V',)`` shared by all mapped triangles at each target vertex, or -1."""
    shared = np.full(len(corner_counts), -1)
    for votes in (source_corners, equal_corners[:, None]):
        pairs = np.stack([np.repeat(vertex_of_corner, votes.shape[1]), votes.reshape(-1)], axis=1)
        pairs, counts = np.unique(pairs, axis=0, return_counts=True)
        pairs = pairs[counts == corner_counts[pairs[:, 0]]]
        is_unique = np.bincount(pairs[:, 0], minlength=len(corner_counts))[pairs[:, 0]] == 1
        shared[pairs[is_unique, 0]] = pairs[is_unique, 1]
    return shared


def _complete_map(
    source: TriangleMesh, target: TriangleMesh, corners: Index, weights: Float, faces: Index
) -> Correspondence:
    """Add missing triangles and leaders to a map: corners, weights ``(V', 3)``; faces ``(F',)``."""
    is_matched = np.asarray((corners >= 0).all(axis=1))
    is_whole = np.asarray(is_matched[target.faces].all(axis=1))
    open_faces = np.flatnonzero(is_whole & (faces < 0))
    faces = np.where(is_whole, faces, -1)
    faces[open_faces] = _locate_faces(source, target, corners, weights, open_faces)
    return _with_leaders(source, target, corners, weights, faces)


def _locate_faces(source: TriangleMesh, target: TriangleMesh, corners: Index, weights: Float, face_ids: Index) -> Index:
    """Return the source triangles ``(n,)`` of target triangles ``(n,)``, from the source points of their corners."""
    triangles = target.faces[face_ids]
    # If all three corners are on source vertices, these may form a source triangle.
    main_vertices = np.take_along_axis(corners, np.argmax(weights, axis=1)[:, None], axis=1)[:, 0]
    source_faces = _find_equal_triangles(source.faces, main_vertices[triangles])
    source_faces[~(weights.max(axis=1) == 1)[triangles].all(axis=1)] = -1
    remaining = np.flatnonzero(source_faces < 0)
    if remaining.size and len(source.faces):
        mapped_points = np.einsum("vk,vkc->vc", weights, source.points[corners])
        normals = np.einsum("vk,vkc->vc", weights, source.vertex_normals[corners])
        corners = triangles[remaining]
        search = ClosestPointQuery.from_mesh(source.points, source.faces)
        source_faces[remaining] = search.query_facing(
            mapped_points[corners].mean(axis=1), normals[corners].sum(axis=1)
        )[0]
    return source_faces


def _find_equal_triangles(source: Index, queries: Index) -> Index:
    """Return the first of source triangles ``(F, 3)`` with equal vertices, or -1; prefer equal orientation."""
    triangles = np.concatenate([source, queries])
    lowest_corner = np.argmin(triangles, axis=1)
    rotated = np.take_along_axis(triangles, (lowest_corner[:, None] + np.arange(3)) % 3, axis=1)
    matches = np.full(len(queries), -1)
    for keys in (np.sort(triangles, axis=1), rotated):
        key_ids = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
        face_of_key = np.full(key_ids.max(initial=-1) + 1, -1)
        face_of_key[key_ids[: len(source)][::-1]] = np.arange(len(source))[::-1]
        key_matches = face_of_key[key_ids[len(source) :]]
        matches = np.where(key_matches >= 0, key_matches, matches)
    return matches


MIN_EXAMINED_MARKERS = 10  # smallest number of markers for a registration with meaningful residuals
TRIAL_VERTEX_COUNT = 1200  # number of vertices of the decimated meshes in an examination
TRIAL_STIFFNESS, TRIAL_STEPS = 1e-2, 5  # last stiffness, and number of stiffnesses, of the stiff registration


@dataclass(frozen=True, eq=False)
class Examination:
    """Results of `examine_markers`."""

    suspicions: tuple[Suspicion, ...] = ()  # markers inconsistent with the remaining markers
    residuals: Float | None = None  # (n,) distances of a stiff registration from the markers, in diagonals
    coverage: float = 0.0  # share of the target's area that is covered by the registration
    refusal: str = ""  # error message of the registration; empty without an error

    @property
    def suspects(self) -> frozenset[int]:
        """Ids of all suspicious markers."""
        return frozenset(int(marker) for suspicion in self.suspicions for marker in suspicion.marker_ids)


def examine_markers(source: MeshSequence, target: MeshSequence, markers: Markers) -> Examination:
    """Examine the markers of two meshes in their first frames; problems are returned, not raised as errors."""
    x, y = (np.asarray(sequence.points[0], np.float64) for sequence in (source, target))
    suspicions = tuple(find_suspicious_markers(markers, x[markers.source], y[markers.target]))
    if len(markers) < MIN_EXAMINED_MARKERS:
        return Examination(suspicions)
    source_ids, coarse_source = _decimate_mesh(x, source.faces, np.unique(markers.source))
    target_ids, coarse_target = _decimate_mesh(y, target.faces, np.unique(markers.target))
    coarse = Markers(np.searchsorted(source_ids, markers.source), np.searchsorted(target_ids, markers.target))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)  # stiff registrations have poor matches
        try:
            _, quality = correspond_and_assess(
                coarse_source, coarse_target, coarse, last_stiffness=TRIAL_STIFFNESS, steps=TRIAL_STEPS
            )
        except SettingsError as error:
            return Examination(suspicions, refusal=str(error))
    return Examination(suspicions, quality.marker_distances, quality.target_coverage)


def _decimate_mesh(points: Float, faces: IntArray, keep: Index) -> tuple[Index, MeshSequence]:
    """Decimate a mesh without removing the vertices `keep`; return the remaining vertices ``(n,)`` and the mesh."""
    vertex_ids, coarse_faces = decimate(points, faces.astype(np.int64), TRIAL_VERTEX_COUNT, keep)
    return vertex_ids, MeshSequence.from_arrays(points[None, vertex_ids], coarse_faces)
