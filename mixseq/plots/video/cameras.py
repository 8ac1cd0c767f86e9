"""Cameras of films: in front of a body or at a given angle, optionally turning or following a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mixseq.arrays import Float
from mixseq.scene.camera import Camera, seen_from, shared_limits, y_up
from mixseq.scene.items import DecodedItem
from mixseq.threads import one_blas_thread

SMOOTHED = 0.25
"""Time constant in seconds over which a following camera smooths the swing of a body."""


@dataclass(frozen=True)
class Aim:
    """The view of a film."""

    # Degrees from the body's front, to its left, and above the horizon; by default its front and a side.
    camera: tuple[float, float] | None = None
    turn: float = 0.0  # degrees by which the camera goes around during the film
    follow: bool = False  # whether it goes with the body


def cameras_of(items: Sequence[DecodedItem], aim: Aim, fps: float) -> list[Camera]:
    """Return the cameras: a common one for meshes with the triangles of the first, one for each other."""
    groups: dict[int, list[DecodedItem]] = {}
    group_of = []
    for number, item in enumerate(items):
        same = number > 0 and np.array_equal(item.header.faces, items[0].header.faces)
        group_of.append(0 if same else number)
        groups.setdefault(group_of[-1], []).append(item)
    with one_blas_thread():
        placed = {number: _camera(group, aim, fps) for number, group in groups.items()}
    return [placed[number] for number in group_of]


def _camera(items: Sequence[DecodedItem], aim: Aim, fps: float) -> Camera:
    first, frames = items[0], len(items[0].pose_of_frame)
    path = travel_path(first, fps) if aim.follow else np.zeros((frames, 3))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for item in items:
        for frame in range(frames) if aim.follow else item.shown_first.tolist():
            world = y_up(item.pose(frame), item.header.up_axis) - path[frame]
            low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    ground = float(low[1])
    ends = np.stack([first.pose(0), first.pose(frames - 1)])
    view = seen_from(ends, first.header.up_axis, aim.camera)
    camera = Camera(view, aim.turn, path + (low + high) / 2, ground, (0.0, 1.0, 0.0, 1.0))
    limits = []
    for item in items:
        # while the camera turns or follows, every frame is another picture
        for frame in range(frames) if aim.turn or aim.follow else item.shown_first.tolist():
            centre = camera.centres[frame]
            world = y_up(item.pose(frame), item.header.up_axis) - centre
            below = np.array([[0, ground - centre[1], 0]])
            limits.append(shared_limits(np.concatenate([world, below]), "Y", camera.at(frame)))
    left, right, bottom, top = zip(*limits, strict=True)
    return replace(camera, limits=(min(left), max(right), min(bottom), max(top)))


def travel_path(item: DecodedItem, fps: float) -> Float:
    """Return the smoothed path ``(N, 3)`` of a mesh over the ground in a film, Y up, from its first place."""
    middles = np.stack(
        [y_up(item.pose(frame), item.header.up_axis).mean(axis=0) for frame in range(len(item.pose_of_frame))]
    )
    middles = (middles - middles[0]) * [1, 0, 1]
    straight = np.linspace(0, 1, len(middles))[:, None] * middles[-1]
    return np.asarray(straight + gaussian_filter1d(middles - straight, SMOOTHED * fps, axis=0))
