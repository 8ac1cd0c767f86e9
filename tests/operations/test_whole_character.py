"""A point of pose space is a pose of the whole character, wherever it stands: time and shape signals are the motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.mesh.rigid import kabsch
from mixseq.operations import drag, exaggerate, exaggerate_part, hold, sculpt
from mixseq.operations.limbs import find_limb
from mixseq.operations.sections import map_curve_times
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, Index
from tests.operations.motions import first_frames, fox

Made = tuple[Model, int | None]
"""A model, and how many modes it has, if not all."""


@pytest.fixture(
    scope="module",
    params=[
        ("fox", None),
        ("fox", 20),
        *(
            pytest.param((name, rank), marks=pytest.mark.realdata)
            for name, rank in (("q_man_run", None), ("robotexpressive_dance", 12))
        ),
    ],
    ids=lambda param: f"{param[0]}-{param[1]}",
)
def made(request: pytest.FixtureRequest) -> Made:
    name, rank = request.param
    if name == "fox":
        return fox(rank), rank
    folder: Path = request.getfixturevalue("data")
    sequence = first_frames(mixseq.read(folder / "npz" / f"{name}.npz"), 24)
    return fit(sequence, exact=rank is None, rank=rank), rank


def aligned(points: FloatArray) -> Float:
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


def test_a_drag_reaches_the_farthest_frame(made: Made) -> None:
    """The whole character, but for where it stands."""
    model, _ = made
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


def test_the_time_signal_backwards_shows_the_frames_backwards(made: Made) -> None:
    model, rank = made
    backwards = replace(model, time=map_curve_times(model.time, model.start + model.end, -1.0))
    if rank is not None:  # the correction is of the pose that was there
        model, backwards = uncorrected(model), uncorrected(backwards)
    forth, back = (standing(each).sample().points for each in (model, backwards))
    np.testing.assert_allclose(back, forth[::-1], atol=1e-6 * model.space.scale)


def test_a_body_that_stands_still_keeps_its_deformation(made: Made) -> None:
    model, rank = made
    whole = aligned(np.asarray(model.sample().points, dtype=np.float64))
    least = 0.95 if rank is None else 0.9
    for still in (standing(model), standing(uncorrected(model))):
        kept = still.sample().points
        assert np.linalg.norm(kept - kept.mean(axis=0)) > least * np.linalg.norm(whole - whole.mean(axis=0))


def test_no_gain_freezes_the_pose_and_the_body_goes_on(made: Made) -> None:
    model, _ = made
    frozen = exaggerate(model, 0.0)
    assert frozen.placement is model.placement
    between = np.linspace(model.start, model.end, 2 * len(model.times) - 1)
    poses = standing(frozen).sample(between).points
    np.testing.assert_allclose(poses, np.repeat(poses[:1], len(poses), axis=0), atol=1e-9 * model.space.scale)
    mean = model.vectors[:, : model.space.shape_dim].mean(axis=0)
    np.testing.assert_allclose(frozen.vectors[0, : model.space.shape_dim], mean, atol=1e-9)


def test_gain_one_changes_nothing(made: Made) -> None:
    model, _ = made
    same = exaggerate(model, 1.0)
    for before, after in zip(model.curves, same.curves, strict=True):
        np.testing.assert_array_equal(after.values, before.values)


def test_more_gain_moves_all_parts_more() -> None:
    """And every part about as much more."""
    before, after = (
        aligned(np.asarray(each.sample().points, dtype=np.float64)) for each in (fox(), exaggerate(fox(), 1.2))
    )
    swings = [np.linalg.norm(points - points.mean(axis=0), axis=2).max(axis=0) for points in (before, after)]
    large = swings[0] > 0.25 * swings[0].max()
    assert np.median(swings[1][large] / swings[0][large]) == pytest.approx(1.2, abs=0.05)


@pytest.mark.parametrize("kind", ["exaggerated", "held"])
def test_a_limb_moves_in_its_joint_and_all_else_stays(made: Made, kind: str) -> None:
    model, _ = made
    space, times = model.mixed, model.times
    hanging = np.flatnonzero(space.articulation.parents >= 0)
    part = int(hanging[space.articulation.masses[hanging].argmax()])
    if kind == "held":
        time, start, end = (float(times[int(share * (len(times) - 1))]) for share in (0.3, 0.4, 0.7))
        edited = hold(model, part, time, start, end, fade=(model.end - model.start) / 8)
    else:
        edited = exaggerate_part(model, part, 1.3)
    between = np.linspace(model.start, model.end, 2 * len(times) - 1)
    before, after = (each.sample(between).points / space.scale for each in (model, edited))
    away = np.linalg.norm(after - before, axis=2).max(axis=0)
    limb = find_limb(model, part).part_mask
    follows = space.skinning_weights @ limb.astype(np.float64)
    at_joints = np.isin(np.arange(space.vertex_count), space.joint_projection.moving_vertex_ids) & (
        space.projection.share > 0
    )
    assert away[(follows == 0) & ~at_joints].max() < 1e-9
    assert away[(follows == 1) & ~at_joints].max() > 0.01
    ends = space.topology.edges[follows[space.topology.edges].max(axis=1) > 0]
    lengths = [np.linalg.norm(points[:, ends[:, 0]] - points[:, ends[:, 1]], axis=2) for points in (before, after)]
    assert (lengths[1] - lengths[0]).max() < 0.05


def dented(points: Float, scale: float) -> tuple[Float, Index]:
    """A frame with some vertices moved, and all the others."""
    away = np.linalg.norm(points - points[len(points) // 2], axis=1)
    some = np.argsort(away)[:40]
    edited = points.copy()
    edited[some] += 0.02 * scale * np.array([0.6, -0.5, 0.7])
    return edited, np.setdiff1d(np.arange(len(points)), some)


@pytest.mark.parametrize("between", [0.0, 0.5])
def test_vertices_that_were_not_sculpted_stay(made: Made, between: float) -> None:
    """In the frame that was made, at frames or between them, and in others but for joints where lengths count."""
    model, _ = made
    space, times = model.mixed, model.times
    time = float(times[5] + between * (times[6] - times[5]))
    edited, others = dented(model(time), space.scale)
    sculpted = sculpt(model, time, edited)
    np.testing.assert_allclose(sculpted(time), edited, atol=1e-9 * space.scale)
    if space.projection.share > 0:
        others = np.setdiff1d(others, space.joint_projection.moving_vertex_ids)
    frames = times[[0, 9, 15]]
    before, after = (each.sample(frames).points[:, others] for each in (model, sculpted))
    np.testing.assert_allclose(after, before, atol=1e-9 * space.scale)
