"""Cameras: the direction of view, and the rectangle of the screen that a mesh fills."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import remainder

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.sequence import UP_AXES

Limits = tuple[float, float, float, float]
"""Left, right, bottom and top of a screen rectangle, in units of the points."""

TRAVELS = 0.5
"""Displacement from the first to the last pose above which a body travels, in its diagonals."""


@dataclass(frozen=True)
class View:
    """An orthographic camera around the mesh."""

    azimuth: float = 30.0
    elevation: float = 14.0

    @property
    def rows(self) -> Float:
        """Rotation ``(3, 3)`` from a Y-up world to the screen: right, up, towards the camera."""
        # without full turns, which are not exact in radians
        a, e = np.radians([remainder(self.azimuth, 360), self.elevation])
        around = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        above = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return np.asarray(above @ around)


@dataclass(frozen=True, eq=False)
class Camera:
    """The view of a mesh during a film of N frames."""

    view: View  # the view of the first frame
    turn: float  # degrees by which it turns until the first frame comes again, after N
    centres: Float  # (N, 3) what it looks at, and turns about, in each frame, Y up
    ground: float  # height of the ground
    limits: Limits  # (4,) screen rectangle that holds all frames

    def at(self, frame: int) -> View:
        """Return the view in a frame."""
        return View(self.view.azimuth + frame / len(self.centres) * self.turn, self.view.elevation)

    @property
    def aspect(self) -> float:
        """Height per width of the view."""
        left, right, bottom, top = self.limits
        return (top - bottom) / (right - left)

    def fitted(self, aspect: float) -> Camera:
        """Return a camera that is widened to an aspect."""
        return replace(self, limits=of_aspect(self.limits, aspect))


def facing(poses: FloatArray, up_axis: str = "Y") -> float:
    """Return the azimuth in degrees from which a body in poses ``(n, V, 3)`` is seen from the front.

    It faces its travel direction, or else the front of modellers and formats: +z with Y up (glTF 2.0, section 3.4), -y
    with Z up (Blender, Maya), where +x is to its left in both.
    """
    ends = y_up(poses[[0, -1]], up_axis)
    x, _, z = ends[1].mean(axis=0) - ends[0].mean(axis=0)
    if np.hypot(x, z) < TRAVELS * np.linalg.norm(np.ptp(ends[0], axis=0)) or x == z == 0:
        return -90.0 if up_axis == "Z" else 0.0
    return float(np.round(np.degrees(np.arctan2(x, z))))  # whole degrees are the same on every machine


def three_quarter_view(
    poses: FloatArray, up_axis: str = "Y", turn: float = 30.0, elevation: float = 14.0
) -> View:
    """Return a view of the front and a side of poses ``(V, 3)``, `turn` degrees from a full view of the longer one.

    Of the left and the right view, it is the one with +x more to the right, and +z more to the camera, with Y up.
    """
    poses = poses.reshape(-1, *poses.shape[-2:])
    front = facing(poses, up_axis)
    first = y_up(poses[0], up_axis)
    forwards = np.array([np.sin(np.radians(front)), np.cos(np.radians(front))])
    along, across = np.ptp(first[:, [0, 2]] @ np.stack([forwards, forwards[::-1] * [1, -1]], axis=1), axis=0)
    away = turn if across >= along else 90.0 - turn
    sides = [(front + side + 180) % 360 - 180 for side in (away, -away)]
    return View(min(sides, key=lambda azimuth: abs((azimuth - 45 + 180) % 360 - 180)), elevation)


def seen_from(ends: FloatArray, up_axis: str, camera: tuple[float, float] | None) -> View:
    """Return the view at `camera` (two angles in degrees), by default a `three_quarter_view` of ends ``(2, V, 3)``."""
    if camera is None:
        return three_quarter_view(ends, up_axis)
    return View(facing(ends, up_axis) + camera[0], camera[1])


def shared_limits(
    points: FloatArray, up_axis: str = "Y", view: View | None = None, margin: float = 0.04
) -> Limits:
    """Return the screen rectangle of all poses and their shadows: points ``(..., V, 3)``."""
    world = y_up(points, up_axis).reshape(-1, 3)
    shadow = world * [1, 0, 1] + [0, world[:, 1].min(), 0]
    screen = np.concatenate([world, shadow]) @ (view or three_quarter_view(points, up_axis)).rows.T
    low, high = screen[:, :2].min(axis=0), screen[:, :2].max(axis=0)
    space = margin * (float((high - low).max()) or 1.0)  # a single point still gets a rectangle
    return low[0] - space, high[0] + space, low[1] - space, high[1] + space


def of_aspect(limits: Limits, aspect: float) -> Limits:
    """Widen a rectangle about its middle to a height per width."""
    left, right, bottom, top = limits
    width, height = max(right - left, (top - bottom) / aspect), max(top - bottom, (right - left) * aspect)
    x, y = (left + right) / 2, (bottom + top) / 2
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def y_up(points: FloatArray, up_axis: str) -> Float:
    """Permute the axes so that Y is up, keeping right-handedness."""
    up = UP_AXES.index(up_axis)
    return np.asarray(points[..., [(up - 1) % 3, up, (up + 1) % 3]], dtype=np.float64)
