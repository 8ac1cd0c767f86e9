"""Where meshes stand: side by side or in one place, and the camera in front of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
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

NEAR = 0.7
"""Of the distance from which all meshes are seen: from nearer the camera looks at one of them."""

MARGIN = 1.15
"""So many times as far to the sides as everything is, where it is."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Where meshes stand in the scene, with Y up and the ground at zero."""

    up_axes: tuple[str, ...]  # axis of each mesh that points up
    scale: float  # units of the scene per unit of the meshes
    boxes: Float  # (n, 2, 3) lowest and highest places of every mesh, seen from its origin, in units of the scene
    offsets: Float  # (n, 3) where the origins of the meshes are, in units of the scene
    view: View  # from where they are seen

    @property
    def low(self) -> Float:
        """The lowest corner ``(3,)`` of the box around everything."""
        return np.asarray((self.boxes[:, 0] + self.offsets).min(axis=0))

    @property
    def high(self) -> Float:
        """The highest corner ``(3,)`` of it."""
        return np.asarray((self.boxes[:, 1] + self.offsets).max(axis=0))

    @property
    def middles(self) -> Float:
        """The middles ``(n, 3)`` of the meshes."""
        return np.asarray(self.boxes.mean(axis=1) + self.offsets)

    @property
    def labels(self) -> Float:
        """Places ``(n, 3)`` above the meshes."""
        tops = np.where([True, False, True], self.middles, self.boxes[:, 1] + self.offsets)
        return np.asarray(tops + np.array([0, 0.04 * HEIGHT, 0]))

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

    def turned(self, azimuth: float, looked_at: Float, distance: float) -> Arrangement:
        """Return meshes in a row across the view from elsewhere, so that none hides another.

        What the camera looks at stays where it is: from near the nearest mesh, otherwise the middle of the row.

        Shapes: looked_at ``(3,)``.
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
    spans = np.array(boxes)
    view = seen_from(scene.items[0].ends, up_axes[0], camera)
    offsets = _row(spans, view.azimuth) if side_by_side else _together(spans)
    low, high = (spans[:, 0] + offsets).min(axis=0), (spans[:, 1] + offsets).max(axis=0)
    scale = HEIGHT / (float((high - low).max()) or 1.0)
    centre = (low + high) / 2 * [1, 0, 1]
    return Arrangement(up_axes, scale, scale * spans, scale * (offsets - centre), view)


def _together(boxes: Float) -> Float:
    """Meshes stay where they are, on the ground of the lowest."""
    ground = float(boxes[:, 0, 1].min())
    return np.tile([0.0, -ground, 0.0], (len(boxes), 1))


def _row(boxes: Float, azimuth: float) -> Float:
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
