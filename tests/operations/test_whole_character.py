"""A point of pose space is a pose of the whole character, wherever it stands: time and shape signals are the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.arrays import Float
from mixseq.geometry.rigid import kabsch
from mixseq.operations import drag, exaggerate
from mixseq.operations.splines import moved
from mixseq.signals import Curve, Model, fit
from tests.operations.motions import fox

Made = Callable[[int | None], Model]
"""From a rank, or none for all modes, to a model."""


@pytest.fixture(
    scope="module",
    params=[
        "fox",
        *(
            pytest.param(name, marks=pytest.mark.realdata)
            for name in ("horse_gallop", "q_man_run", "robotexpressive_dance")
        ),
    ],
)
def made(request: pytest.FixtureRequest) -> Made:
    if request.param == "fox":
        return fox
    folder: Path = request.getfixturevalue("data")
    sequence = mixseq.read(folder / "npz" / f"{request.param}.npz")
    return cache(lambda rank: fit(sequence, exact=rank is None, rank=rank))


def aligned(points: Float) -> Float:
    """Frames ``(T, V, 3)``, each moved rigidly to where the first one is."""
    motions = [kabsch(frame, points[0]) for frame in points]
    return np.stack([frame @ turn.T + shift for frame, (turn, shift) in zip(points, motions, strict=True)])


def standing(model: Model) -> Model:
    """The model with its bodies where they are at the start."""
    ends = np.array([model.placement.start, model.placement.end])
    return replace(model, placement=Curve(ends, np.repeat(model.placement.values[:1], 2, axis=0)))


def uncorrected(model: Model) -> Model:
    ends = np.array([model.correction.start, model.correction.end])
    return replace(model, correction=Curve(ends, np.zeros((2, model.correction.dim))))


@pytest.mark.parametrize("rank", [None, 20])
def test_a_drag_reaches_the_farthest_frame(made: Made, rank: int | None) -> None:
    """The whole character, but for where it stands."""
    model = made(rank)
    places = model.embedding(model.times)
    far = int(np.linalg.norm(places - places[0], axis=1).argmax())
    pulled = drag(model, float(model.times[0]), places[far])
    assert pulled.placement is model.placement
    vectors = model.vectors
    wanted = vectors[far].copy()
    body = slice(model.space.shape_dim, model.space.shape_dim + model.space.placement_dim)
    wanted[body] = vectors[0, body]
    away = model.space.decode(np.stack([vectors[0], wanted])) - pulled(float(model.times[0]))
    before, after = np.sqrt(np.square(away).sum(axis=2).mean(axis=1)) / model.space.scale
    assert after < 0.01 < before
    assert after < 1e-6


@pytest.mark.parametrize("rank", [None, 20])
def test_the_time_signal_backwards_shows_the_frames_backwards(made: Made, rank: int | None) -> None:
    model = made(rank)
    backwards = replace(model, time=moved(model.time, -1.0, model.start + model.end))
    if rank is not None:  # the correction is of the pose that was there
        model, backwards = uncorrected(model), uncorrected(backwards)
    forth, back = (standing(each).sample().points for each in (model, backwards))
    np.testing.assert_allclose(back, forth[::-1], atol=1e-6 * model.space.scale)


@pytest.mark.parametrize(("rank", "least"), [(None, 0.95), (20, 0.9)])
def test_a_body_that_stands_still_keeps_its_deformation(made: Made, rank: int | None, least: float) -> None:
    model = made(rank)
    whole = aligned(model.sample().points)
    for still in (standing(model), standing(uncorrected(model))):
        kept = still.sample().points
        assert np.linalg.norm(kept - kept.mean(axis=0)) > least * np.linalg.norm(whole - whole.mean(axis=0))


@pytest.mark.parametrize("rank", [None, 20])
def test_no_gain_freezes_the_pose_and_the_body_goes_on(made: Made, rank: int | None) -> None:
    model = made(rank)
    frozen = exaggerate(model, 0.0)
    assert frozen.placement is model.placement
    between = np.linspace(model.start, model.end, 2 * len(model.times) - 1)
    poses = standing(frozen).sample(between).points
    np.testing.assert_allclose(poses, np.repeat(poses[:1], len(poses), axis=0), atol=1e-9 * model.space.scale)
    mean = model.vectors[:, : model.space.shape_dim].mean(axis=0)
    np.testing.assert_allclose(frozen.vectors[0, : model.space.shape_dim], mean, atol=1e-9)


@pytest.mark.parametrize("rank", [None, 20])
def test_gain_one_changes_nothing(made: Made, rank: int | None) -> None:
    model = made(rank)
    same = exaggerate(model, 1.0)
    for before, after in zip(model.curves, same.curves, strict=True):
        np.testing.assert_array_equal(after.values, before.values)


def test_more_gain_moves_all_parts_more() -> None:
    """And every part about as much more."""
    before, after = (aligned(each.sample().points) for each in (fox(), exaggerate(fox(), 1.2)))
    swings = [np.linalg.norm(points - points.mean(axis=0), axis=2).max(axis=0) for points in (before, after)]
    large = swings[0] > 0.25 * swings[0].max()
    assert np.median(swings[1][large] / swings[0][large]) == pytest.approx(1.2, abs=0.05)
