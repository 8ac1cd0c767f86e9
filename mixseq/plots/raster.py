"""Rasterization of one mesh: triangles in a depth buffer, lit as on the sheets, above their shadow.

Triangles are drawn with a depth test [1]_. Corners are rounded to 1/256 of a sample and coverage is decided in integers
[2]_: adjacent triangles leave no gaps, and all machines draw the same samples. A pixel is the mean of 2 x 2 samples.

Renderers of libraries need a graphics card or OpenGL, and draw other pixels on each; matplotlib takes 2.6 times as long
(0.13 s for the fox of 5,600 vertices in 1280 x 720, instead of 0.05 s) and sorts faces instead of pixels.

References
----------
.. [1] E. Catmull: A subdivision algorithm for computer display of curved surfaces. PhD thesis, Utah, 1974.
.. [2] J. Pineda: A parallel algorithm for polygon rasterization. SIGGRAPH 1988.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import Float, IntArray
from mixseq.plots.shading import area_normals, ground_shadow, shade, vertex_normals
from mixseq.scene.camera import Limits, View
from mixseq.scene.palettes import CLAY

Picture = NDArray[np.uint8]

SIDE = 2
"""Samples per pixel, in each direction."""

PAPER = 255
"""Grey of an empty picture."""


def blank(width: int, height: int) -> Picture:
    """Return an empty picture ``(height, width, 3)``."""
    return np.full((height, width, 3), PAPER, dtype=np.uint8)


def render_mesh(
    picture: Picture,
    world: Float,
    faces: IntArray,
    view: View,
    limits: Limits,
    colours: ArrayLike = CLAY,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a mesh and its shadow on a picture ``(rows, columns, 3)`` uint8, as `mixseq.plots.draw_mesh` does on paper.

    `world` ``(V, 3)`` are points, Y up; faces ``(F, 3)`` are seen from both sides; `limits` ``(4,)`` is the screen
    rectangle of the picture, of its proportions; `colours` ``(3,)``, ``(F, 3)`` or ``(F, 3, 3)`` are RGB in 0..1 of
    mesh, faces or corners; `ground` is by default the lowest vertex.
    """
    from mixseq.plots.raster_kernels import SUBPIXELS, average, fill_triangles, lay_shadow

    rows, columns = picture.shape[:2]
    floor = float(world[:, 1].min()) if ground is None else ground
    shadow = ground_shadow(world, faces, floor, view, limits)
    lay_shadow(np.ascontiguousarray(shadow[..., 3]), 255 * shadow[0, 0, :3], picture)

    screen = _turned(world, view)
    left, right, bottom, top = limits
    scale = SIDE * SUBPIXELS * np.array([columns / (right - left), -rows / (top - bottom)])
    places = np.rint((screen[:, :2] - [left, top]) * scale).astype(np.int64)
    corners = np.ascontiguousarray(faces, dtype=np.int64)
    lit = _corner_colours(screen, corners, colours, contrast)

    nearest = np.full((SIDE * rows, SIDE * columns), -np.inf, dtype=np.float32)
    samples = np.empty((*nearest.shape, 3), dtype=np.uint8)
    fill_triangles(places, screen[:, 2].astype(np.float32), corners, lit, nearest, samples)
    average(nearest, samples, SIDE, picture)


def _turned(world: Float, view: View) -> Float:
    """Return points in camera coordinates, summed in a fixed order."""
    x, y, z = world.T
    return np.stack([x * row[0] + y * row[1] + z * row[2] for row in view.rows], axis=1)


def _corner_colours(
    screen: Float, faces: NDArray[np.int64], colours: ArrayLike, contrast: float
) -> NDArray[np.float32]:
    """Return lit colours of corners ``(F, 3, 3)`` in 0..255."""
    flat = area_normals(screen, faces)
    to_camera = np.where(flat[:, 2:] < 0, -1.0, 1.0)
    normals = vertex_normals(flat, faces, len(screen))[faces] * to_camera[:, None]
    rgb = np.asarray(colours, dtype=np.float64)
    rgb = np.broadcast_to(rgb[:, None] if rgb.ndim == 2 else rgb, (len(faces), 3, 3))
    lit = shade(rgb.reshape(-1, 3), normals.reshape(-1, 3), contrast)
    return np.asarray(255 * lit, dtype=np.float32).reshape(-1, 3, 3)
