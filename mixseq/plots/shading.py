"""Shading of a mesh: smooth normals under a key light and a soft fill; and its shadow on the ground."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from mixseq.arrays import Float, IntArray
from mixseq.scene.camera import Limits, View
from mixseq.sequence import bounding_diagonal

KEY_LIGHT = np.array([-0.45, 0.62, 0.64])
COOL = np.array([1.0, 0.6, 0.0])
"""Fading of red, green and blue in the shade."""


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
    """Light colours ``(F, 3)`` from the upper left, with a soft fill from above."""
    light = 0.50 + 0.14 * normals[:, 1] + 0.52 * np.maximum(normals @ KEY_LIGHT, 0) + 0.06 * normals[:, 2]
    light = 1 + contrast * (light[:, None] - 1)
    tint = 1 - 0.10 * contrast * np.clip(1 - light, 0, 1) * COOL  # as under an open sky
    return np.asarray(np.clip(rgb * light * tint, 0, 1))


def _unit(vectors: Float) -> Float:
    """Scale vectors ``(N, 3)`` to length one; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


PIXELS = 240
"""Pixels along the longer side of the picture."""

FEATHER = 10
"""Pixels over which a shadow fades out at the frame, within the usual margin."""

SHADOW = (0.25, 0.24, 0.28)


def ground_shadow(world: Float, faces: IntArray, floor: float, view: View, limits: Limits) -> Float:
    """Paint the shadow ``(rows, columns, 4)`` of a mesh on the ground, darker close to the mesh: world ``(V, 3)``."""
    left, right, bottom, top = limits
    sides = np.array([top - bottom, right - left])
    shape = np.ceil(PIXELS * sides / sides.max()).astype(int)
    pixel = sides / shape

    size = bounding_diagonal(world) or 1.0
    centre = world[faces].mean(axis=1)
    dark = 0.25 + np.exp((floor - centre[:, 1]) / (0.05 * size))
    area = np.abs(area_normals(world, faces)[:, 1]) / 4  # half of it faces down
    spot = (centre * [1, 0, 1] + [0, floor, 0]) @ view.rows.T
    cover = np.histogram2d(
        spot[:, 1], spot[:, 0], bins=shape, range=[[bottom, top], [left, right]], weights=area * dark
    )[0]

    squash = max(np.sin(np.radians(view.elevation)), 0.05)  # the ground is seen at a slant
    blur = 0.019 * size / pixel * [squash, 1]
    cover = gaussian_filter(cover / (pixel.prod() * squash), np.maximum(blur, 1))
    alpha = 0.42 * (1 - np.exp(-0.9 * cover)) * np.outer(*map(_feather, shape))
    return np.concatenate([np.broadcast_to(SHADOW, (*shape, 3)), alpha[..., None]], axis=2)


def _feather(count: int) -> Float:
    """Return a rise from 0 to 1 and a fall to 0, for soft edges of shadows."""
    index = np.arange(count)
    return np.clip(np.minimum(index, index[::-1]) / FEATHER, 0, 1)
