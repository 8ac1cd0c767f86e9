"""Sequences that try to break a bound: extreme lengths, places and motions, and meshes that hardly are any."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.types import Float, FloatArray, Index

FRAMES = 8
SIDE = 7

Made = tuple[FloatArray, Index]
"""Points ``(T, V, 3)`` and triangles ``(F, 3)``."""


# Meshes and motions ---------------------------------------------------------------------------------------


def sheet() -> tuple[Float, Index]:
    """A flat square of side one."""
    x, y = np.meshgrid(*2 * [np.linspace(0, 1, SIDE)], indexing="ij")
    number = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    a, b, c, d = (part.reshape(-1) for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([x, y, 0 * x], axis=2).reshape(-1, 3), faces


def waving(frames: int = FRAMES, points: Float | None = None) -> Float:
    """Frames of a flag in the wind."""
    rest = sheet()[0] if points is None else points
    time = np.linspace(0, 1, frames)[:, None]
    moved = np.repeat(rest[None], frames, axis=0)
    moved[:, :, 2] += 0.2 * np.sin(6 * rest[:, 0] + 6 * time)
    return moved


def _scaled(factor: float, dtype: type = np.float64) -> Callable[[], Made]:
    return lambda: ((waving() * factor).astype(dtype), sheet()[1])


def _moved(offset: float, dtype: type = np.float64, factor: float = 1.0) -> Callable[[], Made]:
    return lambda: ((waving() * factor + offset).astype(dtype), sheet()[1])


def _changed(change: Callable[[Float, Float], FloatArray]) -> Callable[[], Made]:
    """Make a sequence of the flag's frames ``(T, V, 3)`` and their times ``(T, 1, 1)`` from 0 to 1."""
    return lambda: (change(waving(), np.linspace(0, 1, FRAMES)[:, None, None]), sheet()[1])


def _with_faces(faces: Callable[[Index], Index]) -> Callable[[], Made]:
    return lambda: (waving(), faces(sheet()[1]))


def _random() -> np.random.Generator:
    return np.random.default_rng(5)


def _at(points: Float, frame: int | slice, vertex: int, value: ArrayLike) -> Float:
    points = points.copy()
    points[frame, vertex] = value
    return points


def _spinning(points: Float, time: Float) -> Float:
    turns = rotvec_to_matrix(np.array([0.3, 0.5, 3.1]) * np.arange(len(points))[:, None])
    return np.asarray(points @ turns.transpose(0, 2, 1))


def _needles(points: Float, time: Float) -> Float:
    return np.asarray(points * [1.0, 1e-9, 1e-9])


def _collapsed_part(points: Float, time: Float) -> Float:
    """Half of the flag shrinks to a point in the middle, and comes back."""
    points = points.copy()
    half = points[0, :, 0] > 0.5
    middle = points[:, half].mean(axis=1, keepdims=True)
    points[:, half] = middle + (points[:, half] - middle) * np.abs(2 * time - 1)
    return points


def _soup(move: Callable[[Float, Float], Float]) -> Callable[[], Made]:
    """Triangles that share no vertices."""

    def make() -> Made:
        rest, faces = sheet()
        corners = np.repeat(rest[faces].reshape(1, -1, 3), FRAMES, axis=0)
        moved = move(corners, np.linspace(0, 1, FRAMES)[:, None, None])
        return moved, np.arange(corners.shape[1]).reshape(-1, 3)

    return make


def _exploding(points: Float, time: Float) -> Float:
    ways = np.repeat(_random().normal(size=(points.shape[1] // 3, 3)), 3, axis=0)
    return points + 10 * time * ways


def _components() -> Made:
    """A hundred tetrahedra, each of which swings on its own."""
    tetrahedron = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    places = 10 * _random().normal(size=(100, 1, 3))
    swings = np.sin(6 * np.linspace(0, 1, FRAMES)[:, None] + np.arange(100))[..., None, None]
    points = (tetrahedron + places + swings).reshape(FRAMES, -1, 3)
    return points, (faces + 4 * np.arange(100)[:, None, None]).reshape(-1, 3)


def _isolated() -> Made:
    rest, faces = sheet()
    return waving(points=np.concatenate([rest, _random().normal(size=(20, 3))])), faces


def _non_manifold() -> Made:
    faces = _random().integers(0, SIDE * SIDE, size=(200, 3))
    return waving(), faces


def _triangle(frames: int) -> Callable[[], Made]:
    return lambda: (_random().normal(size=(frames, 3, 3)), np.array([[0, 1, 2]]))


def _noise(size: float) -> Callable[[Float, Float], Float]:
    return lambda points, time: points + size * _random().normal(size=points.shape)


def _last_digits(points: Float, time: Float) -> FloatArray:
    digits = _random().integers(-1, 2, size=points.shape) * 2.0**-23
    return np.asarray(points * (1 + digits), dtype=np.float32)


SEQUENCES: dict[str, Callable[[], Made]] = {
    # lengths
    "scale 1e-310": _scaled(1e-310),
    "scale 1e-300": _scaled(1e-300),
    "scale 1e-160": _scaled(1e-160),
    "scale 1e-42, single": _scaled(1e-42, np.float32),
    "scale 1e-30": _scaled(1e-30),
    "scale 1e30": _scaled(1e30),
    "scale 1e150": _scaled(1e150),
    "scale 1e200": _scaled(1e200),
    "scale 1e300": _scaled(1e300),
    # places
    "offset 1e4, single": _moved(1e4, np.float32),
    "offset 1e6": _moved(1e6),
    "offset 1e8": _moved(1e8),
    "offset 1e8, single": _moved(1e8, np.float32, 1e3),
    "offset 1e15": _moved(1e15),
    "offset 1e300": _moved(1e300),
    # growth
    "growth 1e-6 to 1e6": _changed(lambda points, time: points * 10 ** (12 * time - 6)),
    "growth 1e-3 to 1e3": _changed(lambda points, time: points * 10 ** (6 * time - 3)),
    "growth from a point": _changed(lambda points, time: points * time),
    "growth from a point, 1e-6": _changed(lambda points, time: 1e-6 * (points * time + 3)),
    "growth from a point, 1e6": _changed(lambda points, time: 1e6 * points * time),
    "shrinking to a point": _changed(lambda points, time: points * (1 - time)),
    # motions
    "single frame": lambda: (waving(1), sheet()[1]),
    "two frames": lambda: (waving(2), sheet()[1]),
    "static": _changed(lambda points, time: np.repeat(points[:1], FRAMES, axis=0)),
    "duplicated frames": _changed(lambda points, time: points[np.arange(FRAMES) // 3]),
    "mirrored frames": _changed(
        lambda points, time: points * np.where(np.arange(FRAMES) % 2, -1.0, 1.0)[:, None, None]
    ),
    "inside out": _changed(lambda points, time: points * (1 - 2 * time)),
    "spinning": _changed(_spinning),
    "noise": _changed(_noise(1.0)),
    "small noise": _changed(_noise(1e-5)),
    "last digits, single": _changed(_last_digits),
    "one vertex flies off": _changed(lambda points, time: _at(points, slice(None), 24, 1e4 * time[:, 0])),
    "one vertex jumps": _changed(lambda points, time: _at(points, 4, 24, 1e6)),
    "exploding triangles": _soup(_exploding),
    # meshes
    "one point": _changed(lambda points, time: 0 * points + time),
    "on a line": _changed(lambda points, time: points * [1.0, 0, 0] + time),
    "needles": _changed(_needles),
    "collapsed part": _changed(_collapsed_part),
    "degenerate faces": _with_faces(lambda faces: np.concatenate([faces, [[0, 0, 1], [5, 5, 5], [3, 3, 4]]])),
    "isolated vertices": _isolated,
    "many components": _components,
    "not a manifold": _non_manifold,
    "one triangle": _triangle(FRAMES),
    # not numbers
    "not a number": _changed(lambda points, time: _at(points, 3, 7, np.nan)),
    "infinite": _changed(lambda points, time: _at(points, 3, 7, np.inf)),
}
"""Name, and what makes points and faces, always the same ones."""
