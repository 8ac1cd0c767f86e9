"""Small models to edit, and how to measure how smooth curves are."""

from __future__ import annotations

from functools import cache

import numpy as np

from mixseq.choices import SpaceName
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.meshes import bar, coarse_walk, joined, rotation, tube

AXIS = np.array([2.0, 1.0, -2.0]) / 3.0

CIRCLE = 2e-4
"""How far vertices of the spinning body, 2 from its axis, are off where splines meet.

These go through quaternions every 15 degrees, not along the circle: at their ends the curvature is off by 1 %. Taken up
over a quarter of a turn that makes some 3e-5 of the distance from the axis.
"""


@cache
def bar_motion(space: SpaceName = "mixed", knots: int | None = None, frames: int = 9) -> Model:
    """The bending bar at 10 frames per second: 0 to 0.8 s."""
    sequence = bar(sides=5, rings=15, frames=frames)
    return fit(sequence, exact=knots is None, knots=knots, space=space)


@cache
def fox(rank: int | None = None) -> Model:
    """The fox's walk of one second, exact or of few modes; with few, all of its signals say something."""
    return fit(coarse_walk(frames=24), exact=rank is None, rank=rank)


def spinning(angles: Float, step: float = 0.0) -> Float:
    """Points ``(T, V, 3)`` of a rigid body at angles ``(T,)`` about `AXIS`, which goes `step` to x per radian."""
    points = tube(5, 4)[0]
    centred = points - points.mean(axis=0)
    moved = np.array([1.0, 0.0, 0.0]) * step
    return np.stack([centred @ rotation(AXIS * angle).T + moved * angle for angle in angles])


@cache
def spin(step: float = 0.0) -> Model:
    """One turn in one second at 12 frames per second, evenly."""
    angles = np.radians(np.arange(0, 361, 30.0))
    return fit(MeshSequence.from_arrays(spinning(angles, step), tube(5, 4)[1], fps=12), exact=True)


HUB = np.array([0.4, 0.0, 4.5])
"""Where the wheel turns about the y axis."""


def wheeling(turns: Float) -> Float:
    """Points ``(T, V, 3)`` of a trunk, and of a wheel at it that is turned by angles ``(T,)``."""
    trunk, wheel = tube(6, 5)[0], tube(5, 4, length=1.5, radius=0.2)[0] + np.array([0.0, 0.0, 4.4])
    moved = np.stack([(wheel - HUB) @ rotation((0.0, turn, 0.0)).T + HUB for turn in turns])
    return np.concatenate([np.repeat(trunk[None], len(turns), axis=0), moved], axis=1)


@cache
def wheel(start: float = 0.0) -> Model:
    """One turn of a wheel in one second, at 12 frames per second, evenly, from an angle on."""
    faces = joined(tube(6, 5), tube(5, 4, length=1.5, radius=0.2))[1]
    points = wheeling(start + np.radians(np.arange(0, 361, 30.0)))
    return fit(MeshSequence.from_arrays(points, faces, fps=12), exact=True)


def jets(curve: Curve, times: Float) -> Float:
    """Values, slopes and curvatures ``(3, N, k)``."""
    return np.stack([curve(times), curve.derivative(times), curve.derivative(times, 2)])


def jumps(curve: Curve) -> Float:
    """How much value, slope and curvature ``(3,)`` jump between the cubics of a curve, relative to the largest."""
    if not curve.values.any():
        return np.zeros(3)
    knots = curve.times
    starts = np.stack([curve.derivative(knots[:-1], order) for order in range(4)])
    step = np.diff(knots)[:, None]
    value = starts[0] + step * (starts[1] + step * (starts[2] / 2 + step * starts[3] / 6))
    slope = starts[1] + step * (starts[2] + step * starts[3] / 2)
    ends = np.stack([value, slope, starts[2] + step * starts[3]])
    sizes = np.abs(starts[:3]).max(axis=(1, 2))
    return np.asarray(np.abs(ends[:, :-1] - starts[:3, 1:]).max(axis=(1, 2), initial=0.0) / sizes)


def first_frames(sequence: MeshSequence, count: int) -> MeshSequence:
    """The beginning of a sequence."""
    return MeshSequence.from_header(sequence.header.with_times(sequence.times[:count]), sequence.points[:count])
