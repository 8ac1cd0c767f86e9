"""Skins and morphs to write: a hinge of two bones, and what has no structure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mixseq.rigging.rigs import Morph, Skeleton, Skin
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import rotation, tube

QUARTER = np.pi / 2

AXES = np.array([0.5, 0.5, 0.5, 0.5])
"""Of the upper bone at rest: its x is the world's y, its y the world's z."""


def hinge(frames: int = 4, targets: int = 0, **header: Any) -> Skin:
    """Return a bar along z whose upper half turns about x by a quarter: what `tests.meshes.bent` does."""
    points, faces = tube(5, 15)
    mesh = MeshSequence.from_arrays(np.tile(points, (frames, 1, 1)), faces, fps=10, name="bar").header
    upper = np.clip((points[:, 2] - 2.0) / 0.8 + 0.5, 0.0, 1.0)
    angles = np.linspace(0, QUARTER, frames)
    still = np.tile([0.0, 0, 0, 1], (frames, 1))
    turning = np.stack([np.sin(angles / 2), 0 * angles, 0 * angles, np.cos(angles / 2)], axis=1)
    count = len(points)
    rng = np.random.default_rng(targets)
    return Skin(
        header=replace(mesh, **header),
        rest=points,
        skeleton=Skeleton(
            ("lower", "upper"),
            parents=np.array([-1, 0]),
            pivots=np.array([[0.0, 0, 0], [0, 0, 2]]),
            axes=np.array([[0, 0, 0, 1.0], AXES]),
        ),
        rotations=np.stack([still, turning], axis=1),
        translations=np.tile([[0.0, 0, 0], [0, 0, 2]], (frames, 1, 1)),
        influences=np.tile([0, 1, 0, 0], (count, 1)),
        weights=np.stack([1 - upper, upper, 0 * upper, 0 * upper], axis=1),
        targets=0.1 * rng.normal(size=(targets, count, 3)),
        target_weights=rng.normal(size=(frames, targets)),
    )


def carried(skin: Skin) -> Skin:
    """Return a hinge that does not bend, but turns about y and moves as a whole."""
    frames = len(skin.rotations)
    angles = np.linspace(0.1, 2.0, frames)
    turn = np.stack([0 * angles, np.sin(angles / 2), 0 * angles, np.cos(angles / 2)], axis=1)
    places = np.linspace([0.0, 0, 0], [1, 2, 3], frames)
    above = np.array([rotation((0, angle, 0)) @ [0, 0, 2.0] for angle in angles])
    return replace(
        skin, rotations=np.stack([turn, turn], axis=1), translations=np.stack([places, places + above], axis=1)
    )


def random_skin(sequence: MeshSequence, bones: int = 7, targets: int = 2) -> Skin:
    """Return a skin without any structure over the mesh of a sequence."""
    rng = np.random.default_rng(bones)
    header = sequence.header
    t, v = header.frame_count, header.vertex_count
    turns = rng.normal(size=(t, bones, 4))
    weights = rng.random((v, 4))
    return Skin(
        header=header,
        rest=np.asarray(sequence.points[0], dtype=np.float64),
        skeleton=Skeleton.from_pivots(rng.normal(size=(bones, 3))),
        rotations=turns / np.linalg.norm(turns, axis=2, keepdims=True),
        translations=rng.normal(size=(t, bones, 3)),
        influences=rng.integers(0, bones, (v, 4)),
        weights=weights / weights.sum(axis=1, keepdims=True),
        targets=rng.normal(size=(targets, v, 3)),
        target_weights=rng.normal(size=(t, targets)),
    )


def swelling(frames: int = 4) -> Morph:
    """Return a bar that grows in x by 0, 3, 0, -3 ... halves of its width."""
    points, faces = tube(5, 15)
    mesh = MeshSequence.from_arrays(np.tile(points, (frames, 1, 1)), faces, fps=10, name="bar")
    weights = 3 * np.sin(QUARTER * np.arange(frames)).round()[:, None]
    return Morph(mesh.header, points, points[None] * [0.5, 0, 0], weights)
