"""The soft shadow on the ground, by which the eye sees where a foot stands."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from mixseq.arrays import Float, IntArray
from mixseq.plots.shading import area_normals
from mixseq.scene.camera import Limits, View
from mixseq.sequence import bounding_diagonal

PIXELS = 240
"""Pixels along the longer side of the picture."""

FEATHER = 10
"""Pixels over which a shadow fades out at the frame; no more than the usual margin."""

SHADOW = (0.25, 0.24, 0.28)


def ground_shadow(world: Float, faces: IntArray, floor: float, view: View, limits: Limits) -> Float:
    """Paint the ground beneath a mesh: the darker, the closer the mesh is to it.

    Parameters
    ----------
    world : (V, 3) float
        The pose, Y up.
    faces : (F, 3) int
        Triangles.
    floor : float
        Height of the ground.
    view : View
        The camera.
    limits : (4,) float
        Screen rectangle that the picture covers.

    Returns
    -------
    (rows, columns, 4) float
        RGBA, the lowest row first.
    """
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
    """Rise from 0 to 1 and fall to 0 again, so that no shadow ends in a hard edge."""
    index = np.arange(count)
    return np.clip(np.minimum(index, index[::-1]) / FEATHER, 0, 1)
