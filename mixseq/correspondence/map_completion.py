"""Complete a given map to a correspondence: of vertices, of triangles, or of points on triangles.

- *Vertices*, where only triangles are mapped, are on the source vertex that all triangles around them share, or else at
  the point closest to the mean, by area, of the mapped triangles' centroids.
- *Triangles* of the target are moved by the source triangle of the same three vertices, or else by the closest to the
  mean of their mapped corners that faces the same way.
- *Unmapped vertices* follow the nearest mapped vertex of their component, and unmapped components rigidly follow one
  vertex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.errors import SettingsError
from mixseq.topology import Topology

Mesh = tuple[FloatArray, IntArray]
"""Points ``(V, 3)`` and triangles ``(F, 3)`` of a mesh at rest."""

ADDS_TO_ONE = 1e-3
"""Largest deviation of sums of weights from one, as of rounded files; weights are then normalised."""


def from_vertices(vertices: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
    """Complete a map of vertices ``(V',)``, -1 for none: source, target ``(V, 3)``."""
    a, b = _mesh(source), _mesh(target)
    numbers = _numbers(vertices, len(b.points), len(a.points), "vertices")
    weights = np.where(numbers[:, None] >= 0, [1.0, 0.0, 0.0], 0.0)
    return _complete(a, b, np.repeat(numbers[:, None], 3, axis=1), weights, np.full(len(b.faces), -1))


def from_triangles(triangles: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
    """Complete a map of triangles ``(F',)``: source, target ``(V, 3)``."""
    a, b = _mesh(source), _mesh(target)
    numbers = _numbers(triangles, len(b.faces), len(a.faces), "triangles")
    corners, weights = _vertices_of(numbers, a, b)
    return _complete(a, b, corners, weights, numbers)


def from_barycentric(corners: ArrayLike, weights: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
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


def _mesh(mesh: Mesh) -> TriangleMesh:
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
    from mixseq.geometry.nearest import Nearest

    nearest = Nearest.of(source.points, source.faces)
    found = nearest.query(points, normals)
    faces, weights = found.faces.copy(), found.weights.copy()
    facing_away = np.flatnonzero(faces < 0)
    if facing_away.size:
        again = nearest.query(points[facing_away])
        faces[facing_away], weights[facing_away] = again.faces, again.weights
    return faces, weights
