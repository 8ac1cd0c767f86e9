"""Curves that stay near values with few knots."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.signals.detail import fit_curve, least_squares_curve
from mixseq.types import Float


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
