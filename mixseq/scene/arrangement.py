"""Places of meshes, side by side or overlaid, and the camera in front of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.scene.camera import View, seen_from, y_up
from mixseq.scene.items import Scene

SAMPLES = 8
"""Number of frames from which the space of a mesh is measured."""

GAP = 0.15
"""Space between meshes, as a fraction of the widest."""

HEIGHT = 2.0
"""Longest side of the whole arrangement, in units of the scene."""

FIELD = 35.0
"""Vertical field of view of the camera, in degrees."""

NEAR = 0.7
"""Fraction of the camera distance that shows all meshes, below which the camera looks at a single one."""

MARGIN = 1.15
"""Width and height of the picture, relative to the projected meshes."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Places of meshes in the scene, Y up, ground at zero."""

    up_axes: tuple[str, ...]  # axis of each mesh that points up
    scale: float  # units of the scene per unit of the meshes
    boxes: Float  # (n, 2, 3) bounding boxes over time, relative to the origins, in units of the scene
    offsets: Float  # (n, 3) origins of the meshes, in units of the scene
    view: View  # the view of the camera

    @property
    def low(self) -> Float:
        """Minimum corner ``(3,)`` of the box around all meshes."""
        return np.asarray((self.boxes[:, 0] + self.offsets).min(axis=0))

    @property
    def high(self) -> Float:
        """Maximum corner ``(3,)`` of the box around all meshes."""
        return np.asarray((self.boxes[:, 1] + self.offsets).max(axis=0))

    @property
    def middles(self) -> Float:
        """Centres ``(n, 3)`` of the meshes."""
        return np.asarray(self.boxes.mean(axis=1) + self.offsets)

    @property
    def labels(self) -> Float:
        """Label places ``(n, 3)`` above the meshes."""
        tops = np.where([True, False, True], self.middles, self.boxes[:, 1] + self.offsets)
        return np.asarray(tops + np.array([0, 0.04 * HEIGHT, 0]))

    def placed(self, index: int, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return points ``(V, 3)`` of a mesh in scene coordinates."""
        placed = self.scale * y_up(points, self.up_axes[index]) + self.offsets[index]
        return np.asarray(placed, dtype=np.float32)

    def camera(self, aspect: float) -> tuple[Float, Float]:
        """Return the camera position and its target, ``(3,)`` each, for a picture of the given width per height."""
        centre = (self.low + self.high) / 2
        rows = self.view.rows
        corners = np.array(list(product(*np.stack([self.low, self.high], axis=1)))) - centre
        right, up, near = rows @ corners.T
        tangent = np.tan(np.radians(FIELD) / 2)
        # what is at most so far to the side, or above, as the picture reaches where it is
        distance = (near + MARGIN * np.maximum(np.abs(up), np.abs(right) / aspect) / tangent).max()
        return centre + distance * rows[2], centre

    def turned(self, azimuth: float, looked_at: Float, distance: float) -> Arrangement:
        """Return the meshes in a row across another view, so that none hides another.

        The nearest mesh to the target `looked_at` ``(3,)`` stays in place if the camera is near, else the middle of the
        row.
        """
        offsets = _row(self.boxes, azimuth)
        moved = (self.offsets - offsets) * [1, 0, 1]
        place, centre = self.camera(aspect=1.0)
        if distance < NEAR * np.linalg.norm(place - centre):
            shift = moved[np.linalg.norm(self.middles - looked_at, axis=1).argmin()]
        else:
            shift = moved.mean(axis=0)
        return replace(self, offsets=offsets + shift, view=View(azimuth, self.view.elevation))


def arranged(scene: Scene, side_by_side: bool, camera: tuple[float, float] | None = None) -> Arrangement:
    """Place the meshes of a scene, without overlap if side by side; `camera` as in `mixseq.scene.camera.seen_from`."""
    up_axes = tuple(item.header.up_axis for item in scene.items)
    boxes = []
    for item, up in zip(scene.items, up_axes, strict=True):
        poses = [y_up(item.pose(scene.elapsed(frame)), up) for frame in scene.samples(SAMPLES)]
        boxes.append(
            (np.min([pose.min(axis=0) for pose in poses], 0), np.max([pose.max(axis=0) for pose in poses], 0))
        )
    spans = np.array(boxes)
    view = seen_from(scene.items[0].ends, up_axes[0], camera)
    offsets = _row(spans, view.azimuth) if side_by_side else _together(spans)
    low, high = (spans[:, 0] + offsets).min(axis=0), (spans[:, 1] + offsets).max(axis=0)
    scale = HEIGHT / (float((high - low).max()) or 1.0)
    centre = (low + high) / 2 * [1, 0, 1]
    return Arrangement(up_axes, scale, scale * spans, scale * (offsets - centre), view)


def _together(boxes: Float) -> Float:
    """Return offsets ``(n, 3)`` that keep meshes in place, on the ground of the lowest."""
    ground = float(boxes[:, 0, 1].min())
    return np.tile([0.0, -ground, 0.0], (len(boxes), 1))


def _row(boxes: Float, azimuth: float) -> Float:
    """Return offsets ``(n, 3)`` of a row across the view, on the ground."""
    a = np.radians(azimuth)
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    sizes = [np.abs(right) @ (high - low) for low, high in boxes]
    gap = GAP * max(sizes)
    offsets, place = [], 0.0
    for (low, high), size in zip(boxes, sizes, strict=True):
        centre = (low + high) / 2
        offsets.append((place + size / 2) * right - [centre[0], low[1], centre[2]])
        place += size + gap
    return np.array(offsets)
