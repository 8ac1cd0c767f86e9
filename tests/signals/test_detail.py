"""Signals of a sequence: which of them knows what of the motion."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.choices import SPACES, SpaceName
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.rotations import quat_to_matrix
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.detail import (
    EXACT_ROUNDING_STEP,
    TOLERANCE_TO_STEP_RATIO,
    Detail,
    EncodedSequence,
    build_model,
    encode_sequence,
    fit_curve,
    least_squares_curve,
)
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.spaces.making import make_space
from mixseq.spaces.temporal import insert_midpoints
from mixseq.types import Float, FloatArray
from tests.meshes import bar, coarse_walk

LONG = bar(sides=5, rings=13, frames=12)


@cache
def walk() -> MeshSequence:
    return coarse_walk(frames=12)


@cache
def exact_model() -> Model:
    return fit(LONG, exact=True)


@cache
def encoded(name: SpaceName = "mixed") -> EncodedSequence:
    return encode_sequence(LONG, make_space(LONG, name))


def poses_of(model: Model, times: Float) -> tuple[Float, Float]:
    """How parts stand in their bodies: rotations and centres, with corrections."""
    vectors, space = model.curve(times), model.mixed
    size = space.shape_dim
    corrections = vectors[:, size + space.placement_dim :]
    found = space.correct_poses(vectors[:, size - space.pose_dim : size], corrections)
    return quat_to_matrix(found.rotations), found.centres


def without_correction(model: Model) -> Model:
    return Model(model.header, model.space, model.time, model.pose, model.shapes, model.placement)


def test_parts_go_where_they_are_predicted_to_be() -> None:
    """At frames and at quarters between them, whatever blends of key shapes say."""
    model, between = build_model(encoded(), Detail()), encoded().interpolated
    np.testing.assert_array_equal(between.times, insert_midpoints(LONG.times))
    np.testing.assert_array_equal(between.quarter_times, insert_midpoints(between.times))
    np.testing.assert_allclose(model.placement(between.quarter_times), between.placement, atol=1e-12)
    expected = quat_to_matrix(between.part_poses.rotations), between.part_poses.centres
    for found, wanted in zip(poses_of(model, between.quarter_times), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-9)


@pytest.mark.parametrize("detail", [Detail(), Detail(step=EXACT_ROUNDING_STEP)])
def test_at_frames_exact_models_need_no_correction(detail: Detail) -> None:
    model = build_model(encoded(), detail)
    assert np.abs(model.correction(model.times)).max() < 1e-9
    assert np.abs(model.correction(insert_midpoints(model.times))).max() > 1e-6


@pytest.mark.parametrize("settings", [{"rank": 0}, {"rank": 2}])
def test_with_few_modes_frames_have_the_poses_of_their_parts(settings: dict[str, int]) -> None:
    model = fit(LONG, **settings)  # type: ignore[arg-type]
    size, end = model.space.shape_dim, model.space.shape_dim + model.space.placement_dim
    vectors = model.mixed.encode(LONG.points)
    blocks = model.mixed.split(vectors)
    np.testing.assert_allclose(model.placement(LONG.times), vectors[:, size:end], atol=1e-9)
    turns, centres = poses_of(model, LONG.times)
    np.testing.assert_allclose(turns, quat_to_matrix(blocks.part_rotations), atol=1e-9)
    np.testing.assert_allclose(centres, blocks.part_centres, atol=1e-9)
    assert np.abs(model.correction(LONG.times)).max() > 1e-6


def test_with_few_knots_signals_have_these_knots() -> None:
    model = fit(LONG, knots=3)
    for curve in model.curves:
        np.testing.assert_array_equal(curve.times[2:-2], model.time.times[2:-2])
    full = fit(LONG, knots=8)
    assert mixseq.compare(LONG, full.sample()).max_error < 1e-10


@pytest.mark.parametrize("name", SPACES)
def test_other_spaces_have_no_correction(name: SpaceName) -> None:
    model = build_model(encoded(name=name), Detail())
    assert model.correction.dim == model.space.correction_dim
    assert bool(model.correction.dim) == (name == "mixed")
    np.testing.assert_array_equal(model.correction.times[[0, -1]], LONG.times[[0, -1]])


def test_a_model_without_correction_has_none() -> None:
    """It is what time, pose and shape say alone; in the frames that is everything."""
    exact = exact_model()
    plain = without_correction(exact)
    assert plain.correction.dim == exact.correction.dim
    assert not plain.correction.values.any()
    np.testing.assert_array_equal(plain.correction.times, exact.placement.times[[0, -1]])
    np.testing.assert_allclose(plain.sample().points, LONG.points, atol=1e-8)
    assert not plain.rates([0.1])[:, -exact.correction.dim :].any()


def test_another_motion_through_the_same_shapes() -> None:
    model = exact_model()
    time, placement, correction = (
        Curve(LONG.times[-1] - curve.times[::-1], curve.values[::-1]) for curve in model.curves
    )
    header = model.header.with_times(LONG.times)
    moved = model.edited(header=header, time=time, placement=placement, correction=correction)
    assert moved.space is model.space and moved.header.provenance is not None and moved.header.provenance.edited
    np.testing.assert_array_equal(moved.times, header.times)
    np.testing.assert_array_equal(moved.shapes, model.shapes)
    assert moved.curves == (time, placement, correction)
    np.testing.assert_allclose(moved.sample().points, LONG.points[::-1], atol=1e-8)
    np.testing.assert_array_equal(model.edited(time=model.time).times, model.times)


def test_key_shapes_of_exact_models_are_rounded() -> None:
    model = exact_model()
    np.testing.assert_array_equal(np.round(model.shapes / EXACT_ROUNDING_STEP) * EXACT_ROUNDING_STEP, model.shapes)
    assert mixseq.compare(LONG, model.sample()).max_error < 1e-9


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4])
def test_key_shapes_of_other_models_are_rounded_to_less_than_their_tolerance(tolerance: float) -> None:
    """So coarsely that single precision holds them."""
    model = fit(LONG, tolerance=tolerance)
    step = 2.0 ** np.floor(np.log2(tolerance / TOLERANCE_TO_STEP_RATIO))
    np.testing.assert_array_equal(np.round(model.shapes / step) * step, model.shapes)
    assert mixseq.compare(LONG, model.sample()).max_error <= tolerance
    np.testing.assert_array_equal(model.shapes.astype(np.float32), model.shapes)


def deformation(points: FloatArray) -> Float:
    """Displacements from the first frame, which frames are turned and shifted to."""
    points = points.astype(np.float64)
    turns, shifts = kabsch(points, np.broadcast_to(points[0], points.shape))
    return np.asarray(points @ np.swapaxes(turns, 1, 2) + shifts[:, None] - points[0])


def share_of_deformation(model: Model) -> float:
    """How much of the deformation is left if the placement stays what it is in the first frame, from 0 to 1."""
    ends = model.placement.times[[0, -1]]
    held = Curve(ends, np.repeat(model.placement(ends[:1]), 2, axis=0))
    frozen = model.edited(placement=held).sample().points
    whole, left = deformation(model.sample().points), deformation(frozen)
    return float(1.0 - np.linalg.norm(whole - left) / np.linalg.norm(whole))


@pytest.mark.slow
@pytest.mark.parametrize("settings", [{"exact": True}, {}])
def test_time_pose_and_shape_carry_the_walk(settings: dict[str, int]) -> None:
    """The placement says where the fox is, and nothing else."""
    assert share_of_deformation(fit(walk(), **settings)) > 0.95  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.parametrize("name", [pytest.param("horse_gallop", marks=pytest.mark.exhaustive), "fox_run"])
def test_time_pose_and_shape_carry_real_motions(data: Path, name: str) -> None:
    sequence = mixseq.read(data / "npz" / f"{name}.npz")
    assert share_of_deformation(fit(sequence, exact=True)) > 0.95


@pytest.mark.slow
def test_without_correction_few_modes_carry_most_of_the_walk() -> None:
    model = fit(walk(), rank=6)
    whole, plain = deformation(walk().points), deformation(without_correction(model).sample().points)
    assert np.linalg.norm(plain - whole) < 0.2 * np.linalg.norm(whole)


# Curves that stay near values with few knots


def wave(times: Float) -> Float:
    return np.stack([np.sin(2 * times), np.cos(3 * times), times**2], axis=1)


def largest(deviations: Float) -> Float:
    return np.asarray(np.abs(deviations).max(axis=1, initial=0.0))


def test_no_coordinates_are_fine() -> None:
    assert fit_curve(np.arange(7.0), np.zeros((7, 0)), 0.1, largest)([0.3]).shape == (1, 0)


def test_a_cubic_needs_no_inner_knots() -> None:
    t = np.linspace(0, 1, 30)
    values = np.stack([t**3 - t, 2 * t**2], axis=1)
    curve = fit_curve(t, values, 1e-9, largest)
    assert len(curve.times) == 4
    np.testing.assert_allclose(curve(t), values, atol=1e-12)


@pytest.mark.parametrize("tolerance", [0.1, 1e-2, 1e-3, 1e-5])
def test_the_tolerance_is_kept_with_few_knots(tolerance: float) -> None:
    t = np.linspace(0, 2, 120)
    curve = fit_curve(t, wave(t), tolerance, largest)
    assert largest(curve(t) - wave(t)).max() <= tolerance
    assert len(curve.times) < 60


def test_knots_go_where_they_are_needed() -> None:
    t = np.linspace(0, 1, 101)
    step = np.tanh(40 * (t - 0.7))[:, None]
    knots = fit_curve(t, step, 1e-3, largest).times
    assert np.count_nonzero(np.abs(knots - 0.7) < 0.2) > 0.6 * len(knots)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 9])
def test_without_tolerance_all_values_are_met(count: int) -> None:
    noise = np.random.default_rng(count).standard_normal((count, 2))
    times = np.cumsum(np.linspace(1, 2, count))
    curve = fit_curve(times, noise, 0.0, largest)
    np.testing.assert_array_equal(curve(times), noise)


def test_least_squares_lets_the_noise_go() -> None:
    t = np.linspace(0, 2, 200)
    noisy = wave(t) + 0.01 * np.random.default_rng(0).standard_normal((200, 3))
    curve = least_squares_curve(t, noisy, np.linspace(0, 2, 8)[1:-1])
    assert np.sqrt(np.square(curve(t) - wave(t)).mean()) < 0.004


# Frames that stand for all others
