"""Motions without fast changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations import exaggerate, repeat, smooth
from mixseq.operations.filters import check_gain, smooth_curve
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.curve import Curve
from mixseq.signals.fitting import fit
from mixseq.types import Float
from tests.meshes import tube
from tests.operations.motions import CIRCLE, bar_motion, jumps, spin, spinning

TIMES = np.linspace(0, 10, 401)
MIDDLE = (TIMES > 2) & (TIMES < 8)


def sine(period: float) -> Float:
    return np.sin(2 * np.pi * TIMES / period)[:, None]


@pytest.mark.parametrize("period", [0.5, 1.0, 2.0, 5.0])
def test_the_gain_of_a_sine(period: float) -> None:
    found = smooth_curve(Curve(TIMES, sine(period)), TIMES, seconds=1.0)(TIMES)
    gain = 1 / (1 + (np.sqrt(2) - 1) / period**4)
    np.testing.assert_allclose(found[MIDDLE], gain * sine(period)[MIDDLE], atol=1e-3)


def test_half_the_power_at_the_period() -> None:
    found = smooth_curve(Curve(TIMES, sine(1.0)), TIMES, seconds=1.0)(TIMES)[MIDDLE]
    assert np.square(found).mean() / np.square(sine(1.0)[MIDDLE]).mean() == pytest.approx(0.5, abs=2e-3)


def test_smoothing_removes_noise() -> None:
    noise = 0.2 * np.random.default_rng(0).normal(size=(401, 1))
    found = smooth_curve(Curve(TIMES, sine(5.0) + noise), TIMES, seconds=0.5)(TIMES)
    before, after = (np.sqrt(np.square(error[MIDDLE]).mean()) for error in (noise, found - sine(5.0)))
    assert after < 0.5 * before
    assert (jumps(Curve(TIMES, found)) < 1e-9).all()


@pytest.mark.parametrize("knots", [3, 30, 401])
def test_straight_lines_stay_whatever_the_knots(knots: int) -> None:
    times = np.linspace(0, 10, knots)
    line = np.stack([2 * times - 1, -times], axis=1)
    found = smooth_curve(Curve(times, line), TIMES, seconds=3.0)
    np.testing.assert_allclose(found(times), line, atol=1e-8)
    assert (found.start, found.end) == (0, 10)


def test_knots_that_lie_unevenly_stand_for_their_time() -> None:
    uneven = np.sort(np.concatenate([TIMES, TIMES[:200] + 0.011]))
    curve = Curve(TIMES, sine(1.0))
    even, found = smooth_curve(curve, TIMES, 1.0), smooth_curve(curve, uneven, 1.0)
    np.testing.assert_allclose(found(TIMES[MIDDLE]), even(TIMES[MIDDLE]), atol=2e-3)


def test_all_signals_of_a_model_are_smoothed() -> None:
    model = bar_motion()
    rng = np.random.default_rng(1)
    shaken = replace(
        model,
        time=Curve(model.time.times, model.time.values + 0.3 * rng.normal(size=model.time.values.shape)),
        placement=Curve(
            model.placement.times, model.placement.values + 0.1 * rng.normal(size=model.placement.values.shape)
        ),
    )
    calm = smooth(shaken, 0.8)
    np.testing.assert_array_equal(calm.times, model.times)
    for before, after in zip(shaken.curves, calm.curves, strict=True):
        times = np.linspace(0, 0.8, 50)
        assert np.abs(after.derivative(times, 2)).max() < 0.1 * np.abs(before.derivative(times, 2)).max()


def test_very_short_periods_change_nothing() -> None:
    model = bar_motion()
    np.testing.assert_allclose(smooth(model, 1e-4).vectors, model.vectors, atol=1e-9)


@pytest.mark.parametrize("seconds", [1e4, 1e6, 1e100])
def test_very_long_periods_leave_the_line_of_least_squares(seconds: float) -> None:
    rng = np.random.default_rng(2)
    times = np.linspace(3, 13, 501)
    values = 5 + 2 * times[:, None] + rng.normal(size=(501, 1))
    weights = np.where((times == 3) | (times == 13), 0.5, 1.0)  # what the values stand for
    line = np.polynomial.Polynomial.fit(times, values[:, 0], 1, w=np.sqrt(weights))
    found = smooth_curve(Curve(times, values), times, seconds)
    np.testing.assert_allclose(found(times)[:, 0], line(times), atol=1e-8)


def test_periods_are_positive() -> None:
    for seconds in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SettingsError, match=r"seconds is .*; a positive period is expected"):
            smooth(bar_motion(), seconds)
    with pytest.raises(SettingsError, match="3 frames and knots; smoothing needs 5 or more"):
        smooth(bar_motion(frames=2), 0.1)  # and the middle between them


@pytest.mark.parametrize("seconds", [0.1, 1.0, 10.0, 1e6])
def test_steady_rotations_are_unchanged_by_any_period(seconds: float) -> None:
    calm = smooth(repeat(spin(), 0, 1, 3), seconds)
    times = np.linspace(0, 3, 73)
    np.testing.assert_allclose(calm.sample(times).points, spinning(2 * np.pi * times), atol=CIRCLE)


def test_a_body_that_shakes_as_it_turns_turns_steadily() -> None:
    angles = np.radians(np.arange(0, 1081, 15.0))
    shaken = spinning(angles + 0.3 * (-1.0) ** np.arange(len(angles)))
    model = fit(MeshSequence.from_arrays(shaken, tube(5, 4)[1], fps=24), exact=True, parts=1)
    middle = slice(12, -12)  # half a second: near the ends less is certain
    found = smooth(model, 0.5).sample().points
    np.testing.assert_allclose(found[middle], spinning(angles)[middle], atol=0.01)


# More or less of a motion, of all of it and of single modes; of whole characters see `test_whole_character`


def test_once_is_the_motion() -> None:
    for modes in (None, [0], []):
        edited = exaggerate(bar_motion(), 1.0, modes)
        np.testing.assert_array_equal(edited.time.values, bar_motion().time.values)
        assert edited.placement is bar_motion().placement


@pytest.mark.parametrize("gain", [-1.0, 0.0, 0.5, 2.0])
def test_vertices_keep_their_mean_path(gain: float) -> None:
    """In the vertex space: x - mean is scaled, at frames and between them."""
    model = bar_motion("vertex")
    mean = model.sample().points.mean(axis=0)
    edited = exaggerate(model, gain)
    for time in (0.0, 0.13, 0.8):
        np.testing.assert_allclose(edited(time), mean + gain * (model(time) - mean), atol=1e-10)


def test_modes_are_scaled_one_by_one() -> None:
    model = bar_motion()
    edited = exaggerate(model, 3.0, modes=[1])
    times = np.linspace(0, 0.8, 30)
    expected = model.time(times)
    mean = model.time(model.times)[:, 1].mean()
    expected[:, 1] = mean + 3 * (expected[:, 1] - mean)
    np.testing.assert_allclose(edited.time(times), expected, atol=1e-12)
    np.testing.assert_array_equal(edited.placement.values, model.placement.values)


def test_frozen_modes_do_not_move() -> None:
    values = exaggerate(bar_motion(), 0.0, modes=[0, 2]).time.values
    np.testing.assert_allclose(np.ptp(values[:, [0, 2]], axis=0), 0, atol=1e-15)
    assert (np.ptp(values[:, [1, 3]], axis=0) > 1e-3).all()


def test_gains_are_finite_and_modes_there() -> None:
    with pytest.raises(SettingsError, match="gain is inf; a number from -1000 to 1000 is expected"):
        exaggerate(bar_motion(), np.inf)
    for mode in (-1, 99):
        with pytest.raises(SettingsError, match=f"there is no mode {mode}; the model has 8, from 0 on"):
            exaggerate(bar_motion(), 2.0, modes=[0, mode])


@pytest.mark.parametrize("gain", [1001.0, -1e200, np.inf, np.nan])
def test_gains_that_no_motion_survives_are_refused(gain: float) -> None:
    with pytest.raises(SettingsError, match="a number from -1000 to 1000 is expected"):
        check_gain(gain)
