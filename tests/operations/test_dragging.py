"""Drags: the place that is pulled arrives, with a pose of the motion, and what is far away stays."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.errors import SettingsError
from mixseq.operations import drag, exaggerate, sculpt, transition
from mixseq.operations.sections import snap_time
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float
from tests.meshes import rotation, seeds, tube
from tests.operations.motions import bar_motion, first_frames, fox, jumps

CIRCLE = 2 * np.pi * np.arange(17) / 17


@cache
def circling(noise: float = 0.0, along: float = 1.0) -> Model:
    """A tube that gets wider and longer in turn: a circle in the embedding, or with `along` 0 a line."""
    points, faces = tube(6, 5)
    wide, long = (points - points.mean(axis=0)) * [1, 1, 0], (points - points.mean(axis=0)) * [0, 0, 1]
    wide, long = wide / np.linalg.norm(wide), long / np.linalg.norm(long)
    cosines, sines = np.cos(CIRCLE)[:, None, None], along * np.sin(CIRCLE)[:, None, None]
    frames = points + 0.5 * cosines * wide + 0.5 * sines * long
    frames += noise * np.random.default_rng(0).normal(size=frames.shape)
    return fit(MeshSequence.from_arrays(frames, faces, fps=16), exact=True, space="vertex")


def place_of(model: Model, time: float, plane: Plane | None = None) -> Float:
    return np.asarray(model.embedding([time], plane)[0])


@given(seed=seeds, time=st.floats(0, 0.8), reach=st.one_of(st.none(), st.floats(0.01, 3)))
@settings(max_examples=40, deadline=None)
def test_drag_reaches_its_target_within_its_radius(seed: int, time: float, reach: float | None) -> None:
    for model in (bar_motion(), bar_motion(knots=2), bar_motion("vertex")):
        to = np.random.default_rng(seed).normal(size=2)
        time = snap_time(model, time)
        pulled = drag(model, time, to, reach)
        np.testing.assert_allclose(place_of(pulled, time, model.plane), to, atol=1e-9)
        dense = np.linspace(0, 0.8, 101)
        away = np.abs(dense - time) > (0.201 if reach is None else reach + 1e-3)
        size = np.abs(model.time.values).max()
        np.testing.assert_allclose(pulled.time(dense[away]), model.time(dense[away]), atol=1e-9 * size)
        assert pulled.placement is model.placement
        assert len(pulled.time.times) <= len(model.time.times) + 9


@pytest.mark.parametrize("rank", [None, 6])
def test_drag_to_the_position_of_a_frame_gives_that_frame(rank: int | None) -> None:
    """Its shape and its correction; the body stays where it is."""
    model = fox(rank)
    far = farthest(model, 3)
    pulled = drag(model, float(model.times[3]), place_of(model, float(model.times[far])))
    shape, placement = model.space.shape_dim, model.space.placement_dim
    there = model.vectors[far].copy()
    there[shape : shape + placement] = model.vectors[3, shape : shape + placement]
    np.testing.assert_allclose(pulled.vectors[3], there, atol=1e-9)


def farthest(model: Model, frame: int) -> int:
    """The frame that is farthest from another one in the plane."""
    places = model.embedding(model.times)
    return int(np.linalg.norm(places - places[frame], axis=1).argmax())


@pytest.mark.parametrize("rank", [None, 6])
def test_small_steps_move_the_pose_by_small_steps(rank: int | None) -> None:
    model = fox(rank)
    time, way = float(model.times[3]), np.linspace(0.0, 1.0, 17)[:, None]
    here, there = place_of(model, time), place_of(model, float(model.times[farthest(model, 3)]))
    poses = np.stack([drag(model, time, place)(time) for place in here + way * (there - here)])
    steps = np.linalg.norm(np.diff(poses, axis=0), axis=(1, 2))
    assert steps.max() < 1.5 * steps.mean()


def test_frames_near_each_other_in_the_plane_make_no_leaps() -> None:
    """Two rounds of a circle, a little apart in the plane, and far apart across it."""
    points, faces = tube(6, 5)
    round_and_round = 2 * np.pi * np.arange(32) / 16.01
    shifts = np.stack([3 * np.cos(round_and_round), 3 * np.sin(round_and_round), np.repeat([0, 1], 16)], axis=1)
    sequence = MeshSequence.from_arrays(points + shifts[:, None], faces, fps=16)
    model = fit(sequence, exact=True, space="vertex")
    time, end = 0.0, place_of(model, 0.5)
    ways = np.linspace(0.0, 1.0, 65)[:, None]
    poses = np.stack([drag(model, time, place)(time)[0] for place in (1 - ways) * place_of(model, time) + ways * end])
    steps = np.linalg.norm(np.diff(poses, axis=0), axis=1)
    assert steps.max() < 2 * steps.mean()


def test_a_circle_is_pulled_out_by_hand() -> None:
    """In closed form: a fifth more of the width that it has there, and nothing else."""
    model = circling()
    pulled = drag(model, 0.0, 1.2 * place_of(model, 0.0))
    points = tube(6, 5)[0]
    wide = (points - points.mean(axis=0)) * [1, 1, 0]
    np.testing.assert_allclose(model(0.0), points + 0.5 * wide / np.linalg.norm(wide), atol=1e-12)
    np.testing.assert_allclose(pulled(0.0), points + 0.6 * wide / np.linalg.norm(wide), atol=1e-9)


def test_the_change_is_smooth_and_fades_by_the_weight() -> None:
    model = bar_motion()
    to = place_of(model, 0.4) + np.array([0.1, 0.2])
    pulled = drag(model, 0.4, to, reach=0.3)
    assert (jumps(pulled.time) < 1e-9).all()
    moved = pulled.embedding([0.1, 0.2, 0.25, 0.3, 0.55, 0.7], model.plane) - model.embedding(
        [0.1, 0.2, 0.25, 0.3, 0.55, 0.7]
    )
    # Three cubics: 1/6 of the way after a third, 1/2 after a half, 5/6 after two thirds.
    np.testing.assert_allclose(moved, np.outer([0, 1 / 6, 1 / 2, 5 / 6, 1 / 2, 0], [0.1, 0.2]), atol=1e-10)


def test_default_radius_is_an_eighth_of_the_motion_or_two_frames() -> None:
    for model, reach in ((bar_motion(), 0.2), (circling(), 0.125)):
        time = model.end / 2
        pulled = drag(model, time, place_of(model, time) + 0.1)
        moved = pulled.embedding([time - 0.9 * reach, time - reach], model.plane) - model.embedding(
            [time - 0.9 * reach, time - reach]
        )
        assert np.abs(moved[0]).min() > 1e-5
        np.testing.assert_allclose(moved[1], 0.0, atol=1e-10)


@pytest.mark.parametrize("time", [0.0, 0.8])
def test_ends_can_be_pulled(time: float) -> None:
    model = bar_motion()
    pulled = drag(model, time, [0.3, 0.1])
    np.testing.assert_allclose(place_of(pulled, time, model.plane), [0.3, 0.1], atol=1e-10)
    assert (pulled.start, pulled.end) == (model.start, model.end)


def test_nothing_happens_where_nothing_is_pulled() -> None:
    for model in (bar_motion(), fox(6)):
        same = drag(model, 0.33, place_of(model, 0.33))
        times = np.linspace(0, 0.8, 33)
        np.testing.assert_allclose(same.curve(times), model.curve(times), atol=1e-12)


def test_many_drags_in_one_picture() -> None:
    """In the plane of the first model; knots do not pile up."""
    model = shown = bar_motion()
    for step in range(20):
        shown = drag(shown, 0.33, [0.01 * step, 0.1], plane=model.plane)
        np.testing.assert_allclose(place_of(shown, 0.33, model.plane), [0.01 * step, 0.1], atol=1e-9)
    assert len(shown.time.times) <= len(model.time.times) + 8


def test_a_line_is_followed_as_far_as_it_goes() -> None:
    for noise in (0.0, 1e-9):
        model = circling(noise, along=0.0)
        here = place_of(model, 0.25)
        pulled = drag(model, 0.25, here + np.array([0.05, 0.07]))
        moved = place_of(pulled, 0.25, model.plane) - here
        np.testing.assert_allclose(moved, [0.05, 0.0], atol=1e-6)
        assert np.abs(pulled(0.25) - model(0.25)).max() < 0.2  # noise is not blown up


def test_models_with_many_kinds_of_coordinates() -> None:
    """Weights of key shapes, a coordinate that a sculpt added."""
    bent = bar_motion("vertex")
    points = bent(0.4).copy()
    points[:5] += 0.1
    for model in (transition(bent, bent, 0.2, 0.3), sculpt(bent, 0.4, points, "window", start=0.1)):
        to = place_of(model, 0.31) + np.array([0.03, -0.02])
        pulled = drag(model, 0.31, to)
        np.testing.assert_allclose(place_of(pulled, 0.31, model.plane), to, atol=1e-9)
        assert np.abs(pulled(0.31) - model(0.31)).max() < 0.3 * np.ptp(points)


@pytest.mark.parametrize(
    ("time", "to", "reach", "message"),
    [
        (0.9, [0.0, 0.0], None, "time is 0.9 s; the model is from 0 to 0.8 s"),
        (0.4, [0.0], None, r"to has shape \(1,\); a point of the embedding, \(2,\), is expected"),
        (0.4, [0.0, np.nan], None, r"to is \(0.0, nan\); two finite numbers are expected"),
        (0.4, [0.0, 0.0], 0.0, r"reach is 0 s; a number of seconds is expected, at least 0.0001"),
        (0.4, [0.0, 0.0], -1.0, r"reach is -1 s"),
        (0.4, [0.0, 0.0], np.inf, r"reach is inf s"),
        (0.4, [0.0, 0.0], np.nan, r"reach is nan s"),
    ],
)
def test_invalid_drags_are_refused(time: float, to: list[float], reach: float | None, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        drag(bar_motion(), time, to, reach)


def test_a_plane_of_another_model() -> None:
    with pytest.raises(SettingsError, match="the plane is of 9 key shapes and 8 coordinates of pose space, the"):
        drag(circling(), 0.5, [0.0, 0.0], plane=bar_motion().plane)
    with pytest.raises(SettingsError, match="give the plane of a model with the same pose and shape signals"):
        circling().embedding([0.5], bar_motion().plane)


def test_motions_that_do_not_change_shape() -> None:
    points, faces = tube(5, 4)
    turned = np.stack([points @ rotation((0.0, angle, 0.0)).T for angle in (0.0, 0.1, 0.2)])
    rigid = fit(MeshSequence.from_arrays(turned, faces, fps=10), exact=True)
    frozen = exaggerate(bar_motion(), 0.0)
    for model in (rigid, frozen, bar_motion(frames=1)):
        with pytest.raises(SettingsError, match="the embedding of the model is one point"):
            drag(model, 0.0, [0.1, 0.0])


def test_knots_need_not_be_frames() -> None:
    """A signal that goes on beyond the frames, and one of two knots."""
    model = bar_motion()
    values = model.time([0.0, 0.8])
    straight = replace(model, time=Curve(np.array([-1.0, 2.0]), values))
    pulled = drag(straight, 0.2, [0.05, 0.0], reach=0.1)
    np.testing.assert_allclose(place_of(pulled, 0.2, straight.plane)[0], 0.05, atol=1e-10)
    assert (pulled.time.start, pulled.time.end) == (-1.0, 2.0)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["fox_run", "q_wolf_gallop"])
def test_real_motions_are_pulled(data: Path, name: str) -> None:
    sequence = first_frames(mixseq.read(data / "npz" / f"{name}.npz"), 27)
    for model in (fit(sequence, exact=True), fit(sequence)):
        size = np.ptp(model.embedding(model.times), axis=0).max()
        time = float(model.times[9]) + 0.01
        to = place_of(model, time) + 0.2 * size * np.array([0.6, 0.8])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pulled = drag(model, time, to)
        np.testing.assert_allclose(place_of(pulled, time, model.plane), to, atol=1e-9)
        apart = np.linalg.norm(pulled(time) - model(time), axis=1) / sequence.diagonal
        assert 1e-4 < apart.max() < 0.2
        far = float(model.times[-1])
        np.testing.assert_allclose(pulled(far), model(far), atol=1e-6 * sequence.diagonal)
