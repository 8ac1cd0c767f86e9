"""Weights of frames at any time: splines in the limit, exact for lines, chosen by leaving frames out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from mixseq.mesh.rotations import matrix_to_quat, normalise_quat, quat_multiply, quat_to_matrix
from mixseq.spaces import temporal as module
from mixseq.spaces.temporal import (
    CANDIDATE_LENGTH_SCALES,
    MAX_LEFT_OUT_FRAMES,
    WINDOW_FRAMES,
    EndCondition,
    FrameWeights,
    Poses,
    TemporalOperator,
    chain_rotations,
    insert_midpoints,
    interpolate_poses,
    select_operator,
    spline_weights,
)
from mixseq.types import Float
from tests.meshes import rigid_motions, rotation, seeds
from tests.spaces.moving import AXIS, turns_of, wandering

UNEVEN = np.array([0.0, 0.3, 0.4, 1.1, 1.5, 1.6, 2.4, 3.0])
NATURAL = (0.0, 0.0)
OPERATORS = [
    TemporalOperator(UNEVEN, length, cubic)
    for length in (np.inf, 4.0, 1.0)
    for cubic in (NATURAL, (0.5, 0.5), (1.0, 0.2))
]


def full(rows: FrameWeights) -> Float:
    """The weights of all frames, ``(N, T)``."""
    return rows.interpolate(np.eye(rows.frame_count))


@pytest.mark.parametrize("operator", OPERATORS)
def test_weights_add_up_to_one(operator: TemporalOperator) -> None:
    rows = operator.weights_at(np.linspace(0, 3, 41))
    np.testing.assert_allclose(rows.weights.sum(axis=1), 1.0, atol=1e-12)
    assert (np.diff(rows.frame_ids, axis=1) == 1).all()


@pytest.mark.parametrize("operator", OPERATORS)
def test_at_a_frame_it_has_the_weight_one(operator: TemporalOperator) -> None:
    np.testing.assert_array_equal(full(operator.weights_at(UNEVEN)), np.eye(len(UNEVEN)))
    both = full(operator.weights_at(insert_midpoints(UNEVEN)))
    np.testing.assert_array_equal(both[::2], np.eye(len(UNEVEN)))
    np.testing.assert_array_equal(both[1::2], full(operator.weights_at((UNEVEN[:-1] + UNEVEN[1:]) / 2)))


@settings(max_examples=20, deadline=None)
@given(seed=seeds, length=st.sampled_from(CANDIDATE_LENGTH_SCALES), share=st.floats(0, 1), frames=st.integers(1, 60))
def test_lines_stay_lines_and_frames_are_passed(seed: int, length: float, share: float, frames: int) -> None:
    rng = np.random.default_rng(seed)
    times = rng.normal() + np.cumsum(rng.uniform(0.2, 1.8, frames)) * 10.0 ** rng.integers(-3, 3)
    operator = TemporalOperator(times, length, (share, 1 - share))
    span = np.ptp(times) or 1.0
    between = np.sort(rng.uniform(times[0], times[-1], 30))
    line, expected = (np.stack([np.ones(len(t)), (t - times[0]) / span], axis=1) for t in (times, between))
    np.testing.assert_allclose(operator.weights_at(between).interpolate(line), expected, atol=1e-10)
    values = rng.normal(size=(frames, 2, 3))
    np.testing.assert_array_equal(operator.weights_at(times).interpolate(values), values)


def test_infinite_lengths_are_natural_splines() -> None:
    values = np.random.default_rng(0).normal(size=(len(UNEVEN), 2))
    times = np.linspace(0, 3, 50)
    expected = CubicSpline(UNEVEN, values, bc_type="natural")(times)
    found = TemporalOperator(UNEVEN, np.inf, NATURAL).weights_at(times).interpolate(values)
    np.testing.assert_allclose(found, expected, atol=1e-11)


@pytest.mark.parametrize("length", [np.inf, 2.0])
def test_at_the_ends_the_usual_spline_has_a_share(length: float) -> None:
    values = np.random.default_rng(0).normal(size=(len(UNEVEN), 2))
    times = np.linspace(0, 3, 101)
    own = TemporalOperator(UNEVEN, length, NATURAL).weights_at(times).interpolate(values)
    usual = CubicSpline(UNEVEN, values)(times)
    shares = np.where(times < UNEVEN[1], 0.3, np.where(times > UNEVEN[-2], 1.0, 0.0))[:, None]
    found = TemporalOperator(UNEVEN, length, (0.3, 1.0)).weights_at(times).interpolate(values)
    np.testing.assert_allclose(found, (1 - shares) * own + shares * usual, atol=1e-11)


def test_long_lengths_come_near_the_natural_spline() -> None:
    times = np.linspace(0, 3, 50)
    spline = full(TemporalOperator(UNEVEN, np.inf, NATURAL).weights_at(times))
    away = [
        np.abs(full(TemporalOperator(UNEVEN, length, NATURAL).weights_at(times)) - spline).max()
        for length in (4, 40, 400)
    ]
    assert away[0] < 0.1
    assert away[1] < 0.2 * away[0]
    assert away[2] < 0.2 * away[1]


def test_shorter_lengths_overshoot_less() -> None:
    times = np.arange(10.0)
    step = (times > 4).astype(np.float64)
    between = np.linspace(0, 9, 181)
    over = [
        TemporalOperator(times, length, NATURAL).weights_at(between).interpolate(step).max() - 1
        for length in CANDIDATE_LENGTH_SCALES
    ]
    assert over[0] > 0.1
    assert (np.diff(over) < 0).all()
    assert over[-1] < 0.8 * over[0]


@pytest.mark.parametrize("length", [np.inf, 2.0])
def test_frames_that_are_evenly_spaced_share_a_system(length: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """However many there are, and wherever they begin: what is solved is the same but for rounding."""
    sizes = []
    name = "spline_weights" if np.isinf(length) else "_kriging_weights"
    solve = getattr(module, name)

    def counted(knots: Float, times: Float, *given: object) -> object:
        sizes.append(len(times))
        return solve(knots, times, *given)

    monkeypatch.setattr(module, name, counted)
    frames, between = np.arange(200.0), np.linspace(0, 199, 301)
    whole = TemporalOperator(frames, length, NATURAL).weights_at(between)
    moved = TemporalOperator(7.3 + frames / 24, length, NATURAL).weights_at(7.3 + between / 24)
    assert sizes == [301, 301]
    np.testing.assert_allclose(moved.weights, whole.weights, atol=1e-9)


def test_frames_that_are_nearly_at_one_time_stay_two() -> None:
    times = np.array([0.0, 2.0**-40, 2.0, 3.0])
    found = TemporalOperator(times, np.inf, NATURAL).weights_at(np.array([0.5, 2.5])).interpolate(times[:, None])
    np.testing.assert_allclose(found[:, 0], [0.5, 2.5], atol=1e-6)


@settings(max_examples=10, deadline=None)
@given(shift=st.floats(-1e3, 1e3), scale=st.floats(1e-3, 1e3), length=st.sampled_from(CANDIDATE_LENGTH_SCALES))
def test_units_of_time_do_not_matter(shift: float, scale: float, length: float) -> None:
    times = np.linspace(0.1, 2.9, 20)
    here = full(TemporalOperator(UNEVEN, length).weights_at(times))
    there = full(TemporalOperator(shift + scale * UNEVEN, length).weights_at(shift + scale * times))
    np.testing.assert_allclose(there, here, atol=1e-5)


def test_backwards_is_the_mirror_image() -> None:
    times = np.linspace(0.05, 2.95, 20)
    for operator in OPERATORS:
        mirrored = replace(operator, times=3.0 - UNEVEN[::-1], cubic_shares=operator.cubic_shares[::-1])
        np.testing.assert_allclose(
            full(mirrored.weights_at(3.0 - times)), full(operator.weights_at(times))[:, ::-1], atol=1e-10
        )


@pytest.mark.parametrize("length", [np.inf, 2.0])
def test_few_frames(length: float) -> None:
    """One frame is everywhere, two are joined by a line; three and more by curves."""
    one = TemporalOperator(np.array([0.5]), length)
    np.testing.assert_array_equal(full(one.weights_at(np.array([0.0, 0.5, 2.0]))), np.ones((3, 1)))
    two, line = (TemporalOperator(np.array([1.0, 3.0]), length), np.array([[1.0, 0.0], [0.75, 0.25], [0.5, 0.5]]))
    np.testing.assert_allclose(full(two.weights_at(np.array([1.0, 1.5, 2.0]))), line, atol=1e-14)
    three = TemporalOperator(np.array([0.0, 1.0, 2.0]), length, (1.0, 1.0))
    parabola = np.array([[0.375, 0.75, -0.125], [-0.125, 0.75, 0.375]])
    np.testing.assert_allclose(full(three.weights_at(np.array([0.5, 1.5]))), parabola, atol=1e-14)


def test_no_times_have_no_rows() -> None:
    assert TemporalOperator(UNEVEN).weights_at(np.zeros(0)).interpolate(np.ones((len(UNEVEN), 2))).shape == (0, 2)


@pytest.mark.parametrize(
    ("length", "inner", "everywhere"), [(np.inf, 1e-12, 1e-12), (4.0, 1e-3, 5e-3), (1.0, 6e-3, 8e-3)]
)
def test_windows_are_nearly_as_good_as_all_frames(
    length: float, inner: float, everywhere: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With short lengths, and near the ends, all frames together tell where the trend is."""
    times = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, 4 * WINDOW_FRAMES))
    operator = TemporalOperator(times, length)
    between = np.linspace(times[0], times[-1], 500)
    near = operator.weights_at(between)
    assert near.frame_ids.shape == (500, WINDOW_FRAMES)
    monkeypatch.setattr(module, "WINDOW_FRAMES", len(times))
    far = operator.weights_at(between)
    assert far.frame_ids.shape == (500, len(times))
    away = np.abs(full(near) - full(far)).max(axis=1)
    assert away.max() < everywhere
    assert away[20:-20].max() < inner


@pytest.mark.parametrize("count", [3, 4, 9, WINDOW_FRAMES + 1, 3 * WINDOW_FRAMES])
@pytest.mark.parametrize(("length", "cubic"), [(np.inf, False), (2.0, False), (2.0, True)])
def test_frames_that_are_left_out_have_no_weight(count: int, length: float, cubic: bool) -> None:
    times = np.cumsum(np.random.default_rng(count).uniform(0.5, 1.5, count))
    left, rows = TemporalOperator(times, length).leave_one_out(cubic)
    assert len(left) == len(np.unique(left)) == min(count - 2, MAX_LEFT_OUT_FRAMES)
    assert left[0] == 1
    assert left[-1] == count - 2
    assert (np.diff(rows.frame_ids, axis=1) > 0).all()
    assert (rows.frame_ids != left[:, None]).all()
    assert (full(rows)[np.arange(len(left)), left] == 0).all()
    line = np.stack([np.ones(count), times / times[-1]], axis=1)
    np.testing.assert_allclose(rows.interpolate(line), line[left], atol=1e-12)


def test_a_frame_left_out_is_predicted_as_if_it_were_not_there() -> None:
    operator, number = TemporalOperator(UNEVEN, 2.8), 3
    others = np.delete(UNEVEN, number)
    step = (len(others) - 1) / (len(UNEVEN) - 1)  # without it frames are farther apart on average
    alone = TemporalOperator(others, 2.8 * step, NATURAL).weights_at(UNEVEN[[number]])
    usual = CubicSpline(others, np.eye(len(others)))(UNEVEN[[number]])
    for cubic, expected in ((False, full(alone)), (True, usual)):
        left, rows = operator.leave_one_out(cubic)
        found = np.delete(full(rows)[list(left).index(number)], number)
        np.testing.assert_allclose(found, expected[0], atol=1e-12)


def test_dense_frames_of_something_smooth_take_the_usual_spline_at_the_ends() -> None:
    times = np.linspace(0, 2, 60)
    samples = np.stack([np.cos(3 * times), np.cos(2 * times)], axis=1)
    operator = select_operator(times, samples)
    assert operator.length_scale >= 5.6
    assert min(operator.cubic_shares) > 0.9
    between = np.linspace(0, 2, 500)
    truth = np.stack([np.cos(3 * between), np.cos(2 * between)], axis=1)
    away = np.abs(operator.weights_at(between).interpolate(samples) - truth).max()
    assert (
        away
        < 0.5 * np.abs(TemporalOperator(times, np.inf, NATURAL).weights_at(between).interpolate(samples) - truth).max()
    )


def test_each_end_has_its_own_share() -> None:
    """A motion that starts from rest, and goes straight on in the end, but for some noise."""
    times = np.linspace(0, 3, 25)
    noise = 1e-4 * np.random.default_rng(0).normal(size=(25, 30))
    samples = np.where(times < 1, times**2, 2 * times - 1)[:, None] * np.ones(30) + noise
    first, last = select_operator(times, samples).cubic_shares
    assert first > 0.8
    assert last < 0.5


def test_sparse_frames_that_are_overshot_take_a_short_length() -> None:
    times = np.arange(30.0)
    jumps = np.random.default_rng(0).integers(0, 2, (30, 40)).astype(np.float64)
    operator = select_operator(times, jumps)
    assert operator.length_scale <= 2.0
    assert max(operator.cubic_shares) < 0.5
    between = np.arange(29.0) + 0.5
    predicted, spline = operator.weights_at(between).interpolate(jumps), CubicSpline(times, jumps)(between)
    assert np.abs(predicted - 0.5).max() < np.abs(spline - 0.5).max()


def test_what_is_chosen_predicts_frames_left_out_best() -> None:
    times = np.cumsum(np.random.default_rng(5).uniform(0.5, 1.5, 40))
    samples = np.cumsum(np.random.default_rng(6).normal(size=(40, 8)), axis=0)

    def error(length: float) -> float:
        left, rows = TemporalOperator(times, length).leave_one_out()
        return float(np.square(rows.interpolate(samples) - samples[left]).sum())

    assert error(select_operator(times, samples).length_scale) == min(map(error, CANDIDATE_LENGTH_SCALES))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_frames_choose_nothing(count: int) -> None:
    operator = select_operator(0.1 * np.arange(float(count)), np.random.default_rng(0).normal(size=(count, 3)))
    assert operator.length_scale == np.inf
    assert operator.cubic_shares == (0.5, 0.5)


@pytest.mark.parametrize("samples", [np.zeros((9, 3)), np.full((9, 3), 0.1), np.arange(27.0).reshape(9, 3)])
def test_what_is_still_or_even_is_predicted_exactly(samples: Float) -> None:
    times = np.arange(9.0) / 24
    operator = select_operator(times, samples)
    assert all(0 <= share <= 1 for share in operator.cubic_shares)
    middles = operator.weights_at((times[:-1] + times[1:]) / 2).interpolate(samples)
    np.testing.assert_allclose(middles, (samples[:-1] + samples[1:]) / 2, atol=1e-12)


def test_units_of_samples_do_not_matter() -> None:
    times, samples = np.arange(20.0), np.random.default_rng(1).normal(size=(20, 5))
    one, other = select_operator(times, samples), select_operator(100 + 0.01 * times, 1e4 * samples)
    assert one.length_scale == other.length_scale
    assert one.cubic_shares == pytest.approx(other.cubic_shares, rel=1e-6)


def test_middles_are_between_frames() -> None:
    np.testing.assert_array_equal(insert_midpoints(np.array([0.0, 1.0, 4.0])), [0, 0.5, 1, 2.5, 4])
    np.testing.assert_array_equal(insert_midpoints(np.array([2.0])), [2.0])


# Poses between frames: closed forms for even turns, and frames that are passed


def powers(quaternions: Float, exponents: Float) -> Float:
    """Matrices ``(n, 3, 3)`` of powers of quaternions ``(n, 4)``, which are chains of two frames."""
    frames = np.stack([np.broadcast_to([1.0, 0, 0, 0], quaternions.shape), quaternions])
    weights = FrameWeights(np.tile([0, 1], (len(exponents), 1)), np.stack([1 - exponents, exponents], axis=1), 2)
    chained = chain_rotations(weights, frames)
    return quat_to_matrix(chained[np.arange(len(exponents)), np.arange(len(quaternions))])


@pytest.mark.parametrize("exponent", [0.0, 0.25, 1.0, -1.5, 2.0])
def test_powers_multiply_angles(exponent: float) -> None:
    angles = np.array([0.0, 1e-14, 1e-9, 0.7, 3.0, -2.5])
    found = powers(turns_of(angles)[:, 0], np.full(len(angles), exponent))
    np.testing.assert_allclose(found, quat_to_matrix(turns_of(exponent * angles)[:, 0]), atol=1e-14)


def test_powers_take_the_shorter_way() -> None:
    """A turn by 300 degrees is one by 60 the other way round, in either sign."""
    turns = turns_of(np.radians([300.0]))[:, 0] * [[1.0], [-1.0]]
    np.testing.assert_allclose(powers(turns, np.full(2, 0.5)), [rotation(AXIS * np.radians(-30))] * 2, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_powers_add_up(seed: int) -> None:
    random = np.random.default_rng(seed)
    q, (a, b) = normalise_quat(random.normal(size=(4, 4))), random.normal(size=(2, 4))
    np.testing.assert_allclose(powers(q, a) @ powers(q, b), powers(q, a + b), atol=1e-13)


@pytest.mark.parametrize("length", CANDIDATE_LENGTH_SCALES)
def test_even_turns_go_on_evenly_however_many(length: float) -> None:
    for step in [0.0, 20.0, 90.0, 179.0, -120.0]:
        frames = np.arange(20.0)
        operator = TemporalOperator(frames, length)
        times = np.linspace(0, 19, 77)
        found = chain_rotations(operator.weights_at(times), turns_of(np.radians(step) * frames))
        expected = np.stack([rotation(AXIS * np.radians(step) * time) for time in times])
        np.testing.assert_allclose(quat_to_matrix(found[:, 0]), expected, atol=1e-11)
        np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1.0, atol=1e-14)
        assert (np.einsum("tpi,tpi->tp", found[1:], found[:-1]) > 0).all()


def test_turns_about_one_axis_are_angles_that_are_predicted() -> None:
    times, angles = np.arange(9) / 24, np.cumsum(np.random.default_rng(0).uniform(-1.5, 1.5, 9))
    operator = TemporalOperator(times, 2.8)
    middles = (times[1:] + times[:-1]) / 2
    found = chain_rotations(operator.weights_at(middles), turns_of(angles))
    expected = turns_of(operator.weights_at(middles).interpolate(angles))
    np.testing.assert_allclose(quat_to_matrix(found), quat_to_matrix(expected), atol=1e-13)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, length=st.sampled_from(CANDIDATE_LENGTH_SCALES), frames=st.sampled_from([2, 3, 12, 60]))
def test_frames_are_passed(seed: int, length: float, frames: int) -> None:
    poses = wandering(seed, 3, frames)
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, frames))
    found = interpolate_poses(TemporalOperator(times, length).weights_at(insert_midpoints(times)), poses)
    np.testing.assert_allclose(found.rotations[::2], poses.rotations, atol=1e-15)
    np.testing.assert_array_equal(found.centres[::2], poses.centres)
    np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found.rotations[1:], found.rotations[:-1]) > 0).all()


@settings(max_examples=15, deadline=None)
@given(seed=seeds, motion=rigid_motions)
def test_rigid_motions_of_everything_go_through(seed: int, motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    poses, times = wandering(seed, 3), np.arange(12.0)
    moved = Poses(quat_multiply(matrix_to_quat(turn), poses.rotations), poses.centres @ turn.T + shift)
    rows = TemporalOperator(times, 4.0).weights_at(insert_midpoints(times))
    here, there = (interpolate_poses(rows, each) for each in (poses, moved))
    np.testing.assert_allclose(quat_to_matrix(there.rotations), turn @ quat_to_matrix(here.rotations), atol=1e-9)
    np.testing.assert_allclose(there.centres, here.centres @ turn.T + shift, atol=1e-9)


def test_one_frame_is_everywhere() -> None:
    poses = wandering(11, 3, 1)
    found = interpolate_poses(TemporalOperator(np.array([0.5])).weights_at(np.array([0.0, 0.5, 2.0])), poses)
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.repeat(own, 3, axis=0), atol=1e-15)


# Splines as weights of values at knots, against scipy's


@pytest.mark.parametrize("ends", ["natural", "not-a-knot"])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 48])
def test_as_in_scipy(ends: EndCondition, count: int) -> None:
    knots = np.cumsum(np.random.default_rng(count).uniform(0.1, 3.0, count))
    times = np.concatenate([knots, np.linspace(knots[0], knots[-1], 100)])
    expected = CubicSpline(knots, np.eye(count), bc_type=ends)(times)
    np.testing.assert_allclose(spline_weights(knots, times, ends), expected, atol=1e-12)


@pytest.mark.parametrize("ends", ["natural", "not-a-knot"])
def test_knots_of_very_different_distances(ends: EndCondition) -> None:
    knots = np.array([0.0, 1e-9, 1.0, 1.0 + 1e-6, 50.0, 51.0])
    times = np.linspace(0.0, 51.0, 40)
    expected = CubicSpline(knots, np.eye(6), bc_type=ends)(times)
    np.testing.assert_allclose(spline_weights(knots, times, ends), expected, rtol=1e-6)
