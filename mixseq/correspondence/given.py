r"""Correspondence from maps that somebody else made: of vertices, of triangles, or of points on triangles.

Each is completed (`mixseq.correspondence.completing`). Of a map of triangles, *vertices* are on the source vertex that
all triangles around them share, or else at the point that is closest to the mean, by area, of the mapped triangles'
centroids.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.correspondence.completing import closest_facing, complete
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.surfaces import Surface
from mixseq.errors import SettingsError
from mixseq.topology import Topology

Mesh = tuple[FloatArray, IntArray]
"""Points ``(V, 3)`` and triangles ``(F, 3)`` of a mesh at rest."""

ADDS_TO_ONE = 1e-3
"""How far weights may be from adding to one, rounded as files have them; they are then divided by their sum. Ours."""


def from_vertices(vertices: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
    """Complete a map of vertices.

    Parameters
    ----------
    vertices : (V',) int
        The source vertex that every target vertex is, -1 for none.
    source, target : (V, 3) float and (F, 3) int
        Points and triangles of the meshes at rest.

    Raises
    ------
    SettingsError
        If there are not as many as target vertices, one does not exist in the source, or all are -1.

    Examples
    --------
    >>> mesh = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), np.array([[0, 1, 2], [1, 3, 2]])
    >>> from_vertices([3, 2, 1, -1], mesh, mesh).faces.tolist()
    [1, -1]
    """
    a, b = _surface(source), _surface(target)
    numbers = _numbers(vertices, len(b.points), len(a.points), "vertices")
    weights = np.where(numbers[:, None] >= 0, [1.0, 0.0, 0.0], 0.0)
    return complete(a, b, np.repeat(numbers[:, None], 3, axis=1), weights, np.full(len(b.faces), -1))


def from_triangles(triangles: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
    """Complete a map of triangles.

    Parameters
    ----------
    triangles : (F',) int
        The source triangle that every target triangle is, -1 for none.
    source, target : (V, 3) float and (F, 3) int
        Points and triangles of the meshes at rest.

    Raises
    ------
    SettingsError
        If there are not as many as target triangles, one does not exist in the source, or all are -1.
    """
    a, b = _surface(source), _surface(target)
    numbers = _numbers(triangles, len(b.faces), len(a.faces), "triangles")
    corners, weights = _vertices_of(numbers, a, b)
    return complete(a, b, corners, weights, numbers)


def from_barycentric(corners: ArrayLike, weights: ArrayLike, source: Mesh, target: Mesh) -> Correspondence:
    """Complete a map of target vertices to points of the source.

    Parameters
    ----------
    corners : (V', 3) int
        Source vertices that every target vertex is between, all -1 for none.
    weights : (V', 3) float
        Their weights, which add to one.
    source, target : (V, 3) float and (F, 3) int
        Points and triangles of the meshes at rest.

    Raises
    ------
    SettingsError
        If shapes do not fit, a corner does not exist, weights do not add to one, or all corners are -1.
    """
    a, b = _surface(source), _surface(target)
    flat = np.asarray(corners).reshape(-1)
    numbers = _numbers(flat, 3 * len(b.points), len(a.points), "corners, three for each of its vertices")
    on = numbers.reshape(-1, 3)
    on = np.where((on >= 0).all(axis=1, keepdims=True), on, -1)
    parts = np.asarray(weights)
    if parts.shape != on.shape or parts.dtype.kind not in "fiu" or not np.isfinite(parts).all():
        raise SettingsError(
            f"weights have shape {parts.shape} and type {parts.dtype}; finite numbers {on.shape} are expected"
        )
    sums, matched = parts.sum(axis=1), on[:, 0] >= 0
    wrong = np.flatnonzero(matched & (np.abs(sums - 1) > ADDS_TO_ONE))
    if wrong.size:
        raise SettingsError(
            f"the weights of target vertex {wrong[0]} add to {sums[wrong[0]]:.4g}; 1 is expected"
            + (f" ({len(wrong)} vertices)" if len(wrong) > 1 else "")
        )
    parts = np.where(matched[:, None], parts / np.where(matched, sums, 1.0)[:, None], 0.0)
    return complete(a, b, on, parts, np.full(len(b.faces), -1))


def _surface(mesh: Mesh) -> Surface:
    points = np.asarray(mesh[0], np.float64)
    return Surface(points, Topology(np.asarray(mesh[1]), len(points)))


def _numbers(given: ArrayLike, target_count: int, source_count: int, what: str) -> Index:
    """Check a map of whole numbers."""
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


def _vertices_of(triangles: Index, source: Surface, target: Surface) -> tuple[Index, Float]:
    """Corners and weights of target vertices, from the source triangles of the triangles around them."""
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
    closest, parts = closest_facing(source, means, normals)
    corners = np.full((count, 3), -1)
    corners[matched], weights[matched] = source.faces[closest], parts
    shared = _shared(vertex, source.faces[on], source.faces[on, corner], around)
    exact = shared >= 0
    corners[exact], weights[exact] = shared[exact, None], [1.0, 0.0, 0.0]
    return corners, weights


def _shared(vertex: Index, candidates: Index, same_corner: Index, around: Index) -> Index:
    """The one source vertex that all mapped triangles around a target vertex have, or -1.

    Parameters
    ----------
    vertex : (n,) int64
        Target vertices, one for every corner of a mapped triangle.
    candidates : (n, 3) int64
        The vertices of its source triangle.
    same_corner : (n,) int64
        That at the same place as the target vertex in its triangle; it decides where several are shared.
    around : (V',) int64
        Mapped triangles around every target vertex.
    """
    result = np.full(len(around), -1)
    for votes in (candidates, same_corner[:, None]):
        pairs = np.stack([np.repeat(vertex, votes.shape[1]), votes.reshape(-1)], axis=1)
        pairs, counts = np.unique(pairs, axis=0, return_counts=True)
        pairs = pairs[counts == around[pairs[:, 0]]]
        alone = np.bincount(pairs[:, 0], minlength=len(around))[pairs[:, 0]] == 1
        result[pairs[alone, 0]] = pairs[alone, 1]
    return result
