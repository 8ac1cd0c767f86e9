"""Light on a mesh: smooth normals, a key light and a soft fill."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, IntArray

KEY_LIGHT = np.array([-0.45, 0.62, 0.64])
COOL = np.array([1.0, 0.6, 0.0])
"""How much red, green and blue fade in the shade."""


def area_normals(points: Float, faces: IntArray) -> Float:
    """Return normals ``(F, 3)`` whose lengths are twice the faces' areas."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.cross(b - a, c - a)


def smooth_normals(normals: Float, faces: IntArray, vertex_count: int) -> Float:
    """Return unit normals ``(F, 3)``: the mean of the vertex normals, which hides the facets."""
    return _unit(vertex_normals(normals, faces, vertex_count)[faces].mean(axis=1))


def vertex_normals(normals: Float, faces: IntArray, vertex_count: int) -> Float:
    """Return unit normals ``(V, 3)`` of the vertices: the mean of the faces around them, by area."""
    sums = [np.bincount(faces.ravel(), np.repeat(column, 3), vertex_count) for column in normals.T]
    return _unit(np.stack(sums, axis=1, dtype=np.float64))


def shade(rgb: Float, normals: Float, contrast: float) -> Float:
    """Light colours ``(F, 3)`` from the upper left, with a soft fill from above.

    Parameters
    ----------
    rgb : (F, 3) float
        Colours in 0..1.
    normals : (F, 3) float
        Unit normals on the screen: right, up, towards the camera.
    contrast : float
        From 0 (colours as given) to 1.
    """
    light = 0.50 + 0.14 * normals[:, 1] + 0.52 * np.maximum(normals @ KEY_LIGHT, 0) + 0.06 * normals[:, 2]
    light = 1 + contrast * (light[:, None] - 1)
    tint = 1 - 0.10 * contrast * np.clip(1 - light, 0, 1) * COOL  # as under an open sky
    return np.asarray(np.clip(rgb * light * tint, 0, 1))


def _unit(vectors: Float) -> Float:
    """Scale vectors ``(N, 3)`` to length one; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))
