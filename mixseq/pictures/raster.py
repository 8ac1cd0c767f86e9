"""Rasterize a mesh in software, with a key light, a soft fill light and a shadow on the ground.

Triangles are drawn with a depth buffer [1]_. Corners are rounded to 1/256 of a sample and coverage is computed in
integers [2]_, so adjacent triangles leave no gaps and all machines draw the same samples. A pixel is the mean of 2 x 2
samples. Compiled loops release the interpreter's lock and draw faces in order, so pixels do not depend on the number of
threads. Graphics cards would draw different pixels on each machine.

References
----------
.. [1] E. Catmull: A subdivision algorithm for computer display of curved surfaces. PhD thesis, Utah, 1974.
.. [2] J. Pineda: A parallel algorithm for polygon rasterization. SIGGRAPH 1988.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from mixseq.mesh.measures import scatter_add
from mixseq.mesh.triangle_mesh import area_normals, normalise
from mixseq.pictures.scene import CLAY_COLOUR, Limits, View, aspect_ratio, shared_limits, three_quarter_view, to_y_up
from mixseq.runtime.jit import compiled
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.types import ByteArray, Float, FloatArray, Index, IntArray, Single

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Picture = ByteArray

DOTS_PER_INCH = 150
"""Resolution of pictures."""

SUBPIXEL_STEPS = 256
"""Resolution of corner positions, in steps per sample."""


@compiled
def fill_triangles(
    positions: Index, heights: Single, faces: Index, colours: Single, depth: Single, samples: ByteArray
) -> None:
    """Draw triangles into samples with a depth buffer.

    `positions` (V, 2) are columns and rows in `SUBPIXEL_STEPS`; `heights` (V,) increase towards the camera; `colours`
    (F, 3, 3) are corner colours in 0..255. `depth` (H, W) and `samples` (H, W, 3) are modified in place.
    """
    height, width = depth.shape
    half = SUBPIXEL_STEPS // 2
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = positions[a, 0], positions[a, 1]
        bx, by = positions[b, 0], positions[b, 1]
        cx, cy = positions[c, 0], positions[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:
            continue
        sign = 1 if area > 0 else -1
        first, last = max(min(ax, bx, cx), 0), min(max(ax, bx, cx), width * SUBPIXEL_STEPS - 1)
        top, bottom = max(min(ay, by, cy), 0), min(max(ay, by, cy), height * SUBPIXEL_STEPS - 1)
        left, right = (first + half - 1) // SUBPIXEL_STEPS, (last - half) // SUBPIXEL_STEPS
        upper, lower = (top + half - 1) // SUBPIXEL_STEPS, (bottom - half) // SUBPIXEL_STEPS
        # Barycentric weights times the area are integers, so adjacent triangles leave no gaps.
        step_a, step_b, step_c = sign * (by - cy), sign * (cy - ay), sign * (ay - by)
        scale = 1.0 / (sign * area)
        for j in range(upper, lower + 1):
            y, x = j * SUBPIXEL_STEPS + half, left * SUBPIXEL_STEPS + half
            wa = sign * ((bx - x) * (cy - y) - (cx - x) * (by - y))
            wb = sign * ((cx - x) * (ay - y) - (ax - x) * (cy - y))
            wc = sign * ((ax - x) * (by - y) - (bx - x) * (ay - y))
            for i in range(left, right + 1):
                if wa >= 0 and wb >= 0 and wc >= 0:
                    u, v, w = wa * scale, wb * scale, wc * scale
                    z = np.float32(u * heights[a] + v * heights[b] + w * heights[c])
                    if z > depth[j, i]:
                        depth[j, i] = z
                        for k in range(3):
                            value = u * colours[f, 0, k] + v * colours[f, 1, k] + w * colours[f, 2, k]
                            samples[j, i, k] = np.uint8(value + 0.5)
                wa += step_a * SUBPIXEL_STEPS
                wb += step_b * SUBPIXEL_STEPS
                wc += step_c * SUBPIXEL_STEPS


@compiled
def downsample(depth: Single, samples: ByteArray, side: int, picture: ByteArray) -> None:
    """Average blocks of `side` x `side` samples and blend the means over a picture (H, W, 3)."""
    height, width = picture.shape[:2]
    count = side * side
    for j in range(height):
        for i in range(width):
            covered = red = green = blue = 0
            for q in range(side * j, side * j + side):
                for p in range(side * i, side * i + side):
                    if depth[q, p] > -np.inf:
                        covered += 1
                        red += samples[q, p, 0]
                        green += samples[q, p, 1]
                        blue += samples[q, p, 2]
            if covered > 0:
                uncovered = count - covered
                picture[j, i, 0] = (red + uncovered * picture[j, i, 0] + count // 2) // count
                picture[j, i, 1] = (green + uncovered * picture[j, i, 1] + count // 2) // count
                picture[j, i, 2] = (blue + uncovered * picture[j, i, 2] + count // 2) // count


@compiled
def blend_shadow(alpha: Float, colour: Float, picture: ByteArray) -> None:
    """Enlarge a shadow (h, w), lowest row first, bilinearly and blend it over a picture (H, W, 3)."""
    height, width = picture.shape[:2]
    rows, columns = alpha.shape
    for j in range(height):
        y = min(max((height - j - 0.5) / height * rows - 0.5, 0.0), rows - 1.0)
        below = min(int(y), rows - 2)
        up = y - below
        for i in range(width):
            x = min(max((i + 0.5) / width * columns - 0.5, 0.0), columns - 1.0)
            left = min(int(x), columns - 2)
            over = x - left
            low = (1.0 - over) * alpha[below, left] + over * alpha[below, left + 1]
            high = (1.0 - over) * alpha[below + 1, left] + over * alpha[below + 1, left + 1]
            opacity = (1.0 - up) * low + up * high
            if opacity > 0.0:
                for k in range(3):
                    blended = (1.0 - opacity) * picture[j, i, k] + opacity * colour[k]
                    picture[j, i, k] = np.uint8(blended + 0.5)


KEY_LIGHT = np.array([-0.45, 0.62, 0.64])


def vertex_normals(normals: Float, faces: IntArray, vertex_count: int) -> Float:
    """Return unit vertex normals ``(V, 3)``, the normalized area-weighted means of face normals ``(F, 3)``."""
    return normalise(scatter_add(np.repeat(normals, 3, axis=0), faces.ravel(), vertex_count))


def shade(rgb: Float, normals: Float, contrast: float) -> Float:
    """Shade face colours ``(F, 3)`` with a key light from the upper left and a soft fill light from above."""
    light = 0.50 + 0.14 * normals[:, 1] + 0.52 * np.maximum(normals @ KEY_LIGHT, 0) + 0.06 * normals[:, 2]
    light = 1 + contrast * (light[:, None] - 1)
    # less red and green in the shade, as under an open sky
    tint = 1 - 0.10 * contrast * np.clip(1 - light, 0, 1) * np.array([1.0, 0.6, 0.0])
    return np.asarray(np.clip(rgb * light * tint, 0, 1))


SHADOW_COLOUR = 255 * np.array([0.25, 0.24, 0.28])


def ground_shadow(world: Float, faces: IntArray, floor: float, view: View, limits: Limits) -> Float:
    """Return the opacity ``(rows, columns)`` of a mesh's shadow on the ground, lowest row first, darker close to it."""
    left, right, bottom, top = limits
    extent = np.array([top - bottom, right - left])
    shape = np.ceil(240 * extent / extent.max()).astype(int)  # pixels
    pixel = extent / shape

    size = bounding_diagonal(world) or 1.0
    centre = world[faces].mean(axis=1)
    darkness = 0.25 + np.exp((floor - centre[:, 1]) / (0.05 * size))
    # a quarter of the normals is half of the projected area, as upper and lower faces both count
    area = np.abs(area_normals(world, np.asarray(faces, dtype=np.int64))[:, 1]) / 4
    x, y, _ = ((centre * [1, 0, 1] + [0, floor, 0]) @ view.rotation.T).T
    bounds = [[bottom, top], [left, right]]
    cover = np.histogram2d(y, x, bins=shape, range=bounds, weights=area * darkness)[0]

    foreshortening = max(np.sin(np.radians(view.elevation)), 0.05)  # foreshortening of the ground on the screen
    blur = 0.019 * size / pixel * [foreshortening, 1]
    cover = gaussian_filter(cover / (pixel.prod() * foreshortening), np.maximum(blur, 1))
    return np.asarray(0.42 * (1 - np.exp(-0.9 * cover)) * np.outer(*map(_feather, shape)))


def _feather(count: int) -> Float:
    """Return a ramp ``(count,)`` from 0 to 1 over 10 pixels, and back to 0 at the end."""
    index = np.arange(count)
    return np.clip(np.minimum(index, index[::-1]) / 10, 0, 1)


SAMPLES_PER_SIDE = 2
"""Number of samples per pixel in each direction."""

BACKGROUND_GREY = 255
"""Grey value of an empty picture."""


def blank_picture(width: int, height: int) -> Picture:
    """Return an empty picture ``(height, width, 3)``."""
    return np.full((height, width, 3), BACKGROUND_GREY, dtype=np.uint8)


def render_mesh(
    picture: Picture,
    world: Float,
    faces: IntArray,
    view: View,
    limits: Limits,
    colours: ArrayLike = CLAY_COLOUR,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a mesh and its shadow on a picture ``(rows, columns, 3)`` uint8, like `draw_mesh`.

    `world` ``(V, 3)`` are points, Y up; faces ``(F, 3)`` are two-sided. `limits` is the screen rectangle of the
    picture, with the same aspect ratio. `colours` are RGB in 0..1 of the mesh ``(3,)``, faces ``(F, 3)`` or corners
    ``(F, 3, 3)``. The ground is by default at the lowest vertex.
    """
    rows, columns = picture.shape[:2]
    floor = float(world[:, 1].min()) if ground is None else ground
    shadow = ground_shadow(world, faces, floor, view, limits)
    blend_shadow(shadow, SHADOW_COLOUR, picture)

    x, y, z = world.T
    # sum in a fixed order to get the same result on every machine
    screen = np.stack([x * row[0] + y * row[1] + z * row[2] for row in view.rotation], axis=1)
    triangles = np.ascontiguousarray(faces, dtype=np.int64)
    lit = _corner_colours(screen, triangles, colours, contrast)
    depth = np.full((SAMPLES_PER_SIDE * rows, SAMPLES_PER_SIDE * columns), -np.inf, dtype=np.float32)
    samples = np.empty((*depth.shape, 3), dtype=np.uint8)
    _fill(screen, triangles, lit, limits, depth, samples)
    downsample(depth, samples, SAMPLES_PER_SIDE, picture)


def draw_mesh(
    ax: Axes,
    points: FloatArray,
    faces: IntArray,
    colours: ArrayLike = CLAY_COLOUR,
    up_axis: str = "Y",
    view: View | None = None,
    limits: Limits | None = None,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a shaded mesh.

    Parameters
    ----------
    ax : matplotlib Axes
        Axes to draw on, at the resolution of the figure or 150 dots per inch. The aspect is set to equal and the
        frame is removed.
    points : (V, 3) float
        Vertex positions.
    faces : (F, 3) int
        Triangles, visible from both sides.
    colours : (3,) or (F, 3) float
        RGB in 0..1 of the mesh or of each face.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    view : View, optional
        The camera, by default `three_quarter_view`.
    limits : (4,) float, optional
        Screen rectangle from `shared_limits`, by default the rectangle around this pose.
    ground : float, optional
        Height of the ground, on which the shadow falls; by default the height of the lowest vertex.
    contrast : float
        Strength of the shading, from 0 (flat colours) to 1.
    """
    view = view or three_quarter_view(points, up_axis)
    limits = limits or shared_limits(points, up_axis, view)
    panel, aspect = ax.get_window_extent(), aspect_ratio(limits)
    scale = max(1.0, DOTS_PER_INCH / ax.figure.dpi)
    width = scale * min(panel.width, panel.height / aspect)
    picture = blank_picture(max(1, round(width)), max(1, round(width * aspect)))
    render_mesh(picture, to_y_up(points, up_axis), faces, view, limits, colours, ground, contrast)
    ax.imshow(picture, extent=limits, zorder=2)
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
    ax.set_axis_off()


def visible_labels(screen: Float, faces: IntArray, label_of_face: IntArray, limits: Limits, width: int) -> Index:
    """Return an image of the labels ``(F,)`` of visible faces, lowest row first, with -1 in the background."""
    shape = max(1, round(width * aspect_ratio(limits))), width
    depth, samples = np.full(shape, -np.inf, dtype=np.float32), np.zeros((*shape, 3), dtype=np.uint8)
    digits = (label_of_face[:, None] + 1) >> np.array([16, 8, 0]) & 255
    colours = np.repeat(digits[:, None], 3, axis=1).astype(np.float32)
    _fill(screen, np.ascontiguousarray(faces, dtype=np.int64), colours, limits, depth, samples)
    return np.asarray(samples[::-1] @ np.array([1 << 16, 1 << 8, 1]) - 1)


def _fill(screen: Float, faces: Index, colours: Single, limits: Limits, depth: Single, samples: ByteArray) -> None:
    """Draw triangles at screen points ``(V, 3)`` into samples of a screen rectangle, with a depth buffer."""
    (rows, columns), (left, right, bottom, top) = depth.shape, limits
    scale = SUBPIXEL_STEPS * np.array([columns / (right - left), -rows / (top - bottom)])
    positions = np.rint((screen[:, :2] - [left, top]) * scale).astype(np.int64)
    fill_triangles(positions, screen[:, 2].astype(np.float32), faces, colours, depth, samples)


def _corner_colours(
    screen: Float, faces: NDArray[np.int64], colours: ArrayLike, contrast: float
) -> NDArray[np.float32]:
    """Return shaded corner colours ``(F, 3, 3)`` in 0..255 for screen points ``(V, 3)`` and faces ``(F, 3)``."""
    flat = area_normals(screen, faces)
    to_camera = np.where(flat[:, 2:] < 0, -1.0, 1.0)
    normals = vertex_normals(flat, faces, len(screen))[faces] * to_camera[:, None]
    rgb = np.asarray(colours, dtype=np.float64)
    rgb = np.broadcast_to(rgb[:, None] if rgb.ndim == 2 else rgb, (len(faces), 3, 3))
    lit = shade(rgb.reshape(-1, 3), normals.reshape(-1, 3), contrast)
    return np.asarray(255 * lit, dtype=np.float32).reshape(-1, 3, 3)
