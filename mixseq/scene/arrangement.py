"""Where meshes stand: side by side or in one place, and the camera in front of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.scene.camera import View, seen_from, y_up
from mixseq.scene.items import Scene

SAMPLES = 8
"""So many frames tell how much space a mesh takes."""

GAP = 0.15
"""Space between meshes, as a fraction of the widest."""

HEIGHT = 2.0
"""How large the longest side of everything is, in units of the scene."""

FIELD = 35.0
"""Degrees that the camera sees from top to bottom."""

MARGIN = 1.15
"""So many times as far to the sides as everything is, where it is."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where meshes stand in the scene, with Y up and the ground at zero.

    Attributes
    ----------
    up_axes : tuple of str
        Axis of each mesh that points up.
    scale : float
        Units of the scene per unit of the meshes.
    offsets : (n, 3) float64
        Where the origins of the meshes are, in units of the scene.
    low, high : (3,) float64
        The box around everything.
    labels : (n, 3) float64
        Places above the meshes.
    view : View
        From where they are seen.
    """

    up_axes: tuple[str, ...]
    scale: float
    offsets: Float
    low: Float
    high: Float
    labels: Float
    view: View

    def placed(self, index: int, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the points ``(V, 3)`` of a mesh in the scene."""
        placed = self.scale * y_up(points, self.up_axes[index]) + self.offsets[index]
        return np.asarray(placed, dtype=np.float32)

    def camera(self, aspect: float) -> tuple[Float, Float]:
        """Return where the camera is and what it looks at, for a picture ``aspect`` times as wide as high."""
        centre = (self.low + self.high) / 2
        rows = self.view.rows
        corners = np.array(list(product(*np.stack([self.low, self.high], axis=1)))) - centre
        right, up, near = rows @ corners.T
        tangent = np.tan(np.radians(FIELD) / 2)
        # what is at most so far to the side, or above, as the picture reaches where it is
        distance = (near + MARGIN * np.maximum(np.abs(up), np.abs(right) / aspect) / tangent).max()
        return centre + distance * rows[2], centre


def arranged(scene: Scene, side_by_side: bool, camera: tuple[float, float] | None = None) -> Arrangement:
    """Find places for meshes of a scene, such that they never meet if they stand side by side.

    They are seen from `camera`, see `mixseq.scene.camera.seen_from`.
    """
    up_axes = tuple(item.header.up_axis for item in scene.items)
    boxes = []
    for item, up in zip(scene.items, up_axes, strict=True):
        poses = [y_up(item.pose(scene.elapsed(frame)), up) for frame in scene.samples(SAMPLES)]
        boxes.append(
            (np.min([pose.min(axis=0) for pose in poses], 0), np.max([pose.max(axis=0) for pose in poses], 0))
        )
    first = scene.items[0]
    view = seen_from(first.ends, up_axes[0], camera)
    offsets = _row(boxes, view.azimuth) if side_by_side else _together(boxes)
    low = np.min([box[0] + offset for box, offset in zip(boxes, offsets, strict=True)], axis=0)
    high = np.max([box[1] + offset for box, offset in zip(boxes, offsets, strict=True)], axis=0)
    scale = HEIGHT / (float((high - low).max()) or 1.0)
    centre = (low + high) / 2 * [1, 0, 1]
    offsets = offsets - centre
    labels = [
        (np.where([True, False, True], (box[0] + box[1]) / 2, box[1]) + offset) * scale
        for box, offset in zip(boxes, offsets, strict=True)
    ]
    return Arrangement(
        up_axes,
        scale,
        scale * offsets,
        scale * (low - centre),
        scale * (high - centre),
        np.array(labels) + np.array([0, 0.04 * HEIGHT, 0]),
        view,
    )


def _together(boxes: Sequence[tuple[Float, Float]]) -> Float:
    """Meshes stay where they are, on the ground of the lowest."""
    ground = min(float(low[1]) for low, _ in boxes)
    return np.tile([0.0, -ground, 0.0], (len(boxes), 1))


def _row(boxes: Sequence[tuple[Float, Float]], azimuth: float) -> Float:
    """Put meshes in a row across the view, on the ground."""
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
