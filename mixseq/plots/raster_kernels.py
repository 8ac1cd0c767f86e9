"""Compiled inner loops of `mixseq.plots.raster`.

They release the interpreter's lock and draw faces in order, so that frames have the same pixels on any number of
threads.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, Index, Single
from mixseq.compiled import compiled

Bytes = NDArray[np.uint8]

SUBPIXELS = 256
"""Steps per pixel of corner positions."""


@compiled
def fill_triangles(
    places: Index, heights: Single, faces: Index, colours: Single, nearest: Single, samples: Bytes
) -> None:
    """Draw triangles into samples with a depth test.

    `places` (V, 2) are columns and rows in `SUBPIXELS`, `heights` (V,) grow towards the camera, `colours` (F, 3, 3) are
    those of the corners in 0..255; `nearest` (H, W) and `samples` (H, W, 3) are changed.
    """
    height, width = nearest.shape
    half = SUBPIXELS // 2
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay = places[a, 0], places[a, 1]
        bx, by = places[b, 0], places[b, 1]
        cx, cy = places[c, 0], places[c, 1]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0:
            continue
        sign = 1 if area > 0 else -1
        first, last = max(min(ax, bx, cx), 0), min(max(ax, bx, cx), width * SUBPIXELS - 1)
        top, bottom = max(min(ay, by, cy), 0), min(max(ay, by, cy), height * SUBPIXELS - 1)
        left, right = (first + half - 1) // SUBPIXELS, (last - half) // SUBPIXELS
        upper, lower = (top + half - 1) // SUBPIXELS, (bottom - half) // SUBPIXELS
        # Weights of the corners, times the area, are whole numbers: neighbours leave no gaps between them.
        step_a, step_b, step_c = sign * (by - cy), sign * (cy - ay), sign * (ay - by)
        scale = 1.0 / (sign * area)
        for j in range(upper, lower + 1):
            y, x = j * SUBPIXELS + half, left * SUBPIXELS + half
            wa = sign * ((bx - x) * (cy - y) - (cx - x) * (by - y))
            wb = sign * ((cx - x) * (ay - y) - (ax - x) * (cy - y))
            wc = sign * ((ax - x) * (by - y) - (bx - x) * (ay - y))
            for i in range(left, right + 1):
                if wa >= 0 and wb >= 0 and wc >= 0:
                    u, v, w = wa * scale, wb * scale, wc * scale
                    z = np.float32(u * heights[a] + v * heights[b] + w * heights[c])
                    if z > nearest[j, i]:
                        nearest[j, i] = z
                        for k in range(3):
                            value = u * colours[f, 0, k] + v * colours[f, 1, k] + w * colours[f, 2, k]
                            samples[j, i, k] = np.uint8(value + 0.5)
                wa += step_a * SUBPIXELS
                wb += step_b * SUBPIXELS
                wc += step_c * SUBPIXELS


@compiled
def average(nearest: Single, samples: Bytes, side: int, picture: Bytes) -> None:
    """Write means of `side` x `side` samples to a picture (H, W, 3), blended over its contents."""
    height, width = picture.shape[:2]
    count = side * side
    for j in range(height):
        for i in range(width):
            covered = red = green = blue = 0
            for q in range(side * j, side * j + side):
                for p in range(side * i, side * i + side):
                    if nearest[q, p] > -np.inf:
                        covered += 1
                        red += samples[q, p, 0]
                        green += samples[q, p, 1]
                        blue += samples[q, p, 2]
            if covered > 0:
                open_ = count - covered
                picture[j, i, 0] = (red + open_ * picture[j, i, 0] + count // 2) // count
                picture[j, i, 1] = (green + open_ * picture[j, i, 1] + count // 2) // count
                picture[j, i, 2] = (blue + open_ * picture[j, i, 2] + count // 2) // count


@compiled
def lay_shadow(alpha: Float, colour: Float, picture: Bytes) -> None:
    """Darken a picture (H, W, 3) by a shadow (h, w), the lowest row first, stretched over it (bilinear)."""
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
            share = (1.0 - up) * low + up * high
            if share > 0.0:
                for k in range(3):
                    mixed = (1.0 - share) * picture[j, i, k] + share * colour[k]
                    picture[j, i, k] = np.uint8(mixed + 0.5)
