"""Splines as weights of values at knots, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from mixseq.spaces.temporal import Ends, spline_weights


@pytest.mark.parametrize("ends", ["natural", "not-a-knot"])
@pytest.mark.parametrize("count", [2, 3, 4, 5, 48])
def test_as_in_scipy(ends: Ends, count: int) -> None:
    knots = np.cumsum(np.random.default_rng(count).uniform(0.1, 3.0, count))
    times = np.concatenate([knots, np.linspace(knots[0], knots[-1], 100)])
    expected = CubicSpline(knots, np.eye(count), bc_type=ends)(times)
    np.testing.assert_allclose(spline_weights(knots, times, ends), expected, atol=1e-12)


@pytest.mark.parametrize("ends", ["natural", "not-a-knot"])
def test_knots_of_very_different_distances(ends: Ends) -> None:
    knots = np.array([0.0, 1e-9, 1.0, 1.0 + 1e-6, 50.0, 51.0])
    times = np.linspace(0.0, 51.0, 40)
    expected = CubicSpline(knots, np.eye(6), bc_type=ends)(times)
    np.testing.assert_allclose(spline_weights(knots, times, ends), expected, rtol=1e-6)
