"""Curves: cubic splines that are what their values say, whatever their knots."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline

from mixseq.errors import SettingsError
from mixseq.signals.curve import Curve
from mixseq.types import Float

TIMES = np.array([0.0, 0.1, 0.5, 0.6, 1.1, 1.5, 2.0])


def wave(times: Float) -> Float:
    return np.stack([np.sin(2 * times), np.cos(3 * times), times**2], axis=1)


def test_a_curve_is_the_not_a_knot_spline() -> None:
    curve, expected = Curve(TIMES, wave(TIMES)), CubicSpline(TIMES, wave(TIMES))
    t = np.linspace(0, 2, 57)
    np.testing.assert_allclose(curve(t), expected(t), atol=1e-13)
    for order in (1, 2, 3):
        np.testing.assert_allclose(curve.derivative(t[1:-1], order), expected(t[1:-1], order), atol=1e-9)
    assert not curve.derivative([1.0], 4).any()
    np.testing.assert_array_equal(curve(TIMES), wave(TIMES))
    assert (curve.start, curve.end, curve.dim) == (0.0, 2.0, 3)


@pytest.mark.parametrize(("count", "degree"), [(1, 0), (2, 1), (3, 2), (4, 3)])
def test_few_knots_make_polynomials(count: int, degree: int) -> None:
    times = TIMES[:count]
    curve = Curve(times, (times**degree)[:, None])
    t = np.linspace(times[0], times[-1], 7)
    np.testing.assert_allclose(curve(t)[:, 0], t**degree, atol=1e-12)
    slope = degree * t ** max(degree - 1, 0)
    np.testing.assert_allclose(curve.derivative(t)[:, 0], slope, atol=1e-11)


def test_no_coordinates_are_fine() -> None:
    curve = Curve(TIMES, np.zeros((7, 0)))
    assert curve([0.3, 0.4]).shape == curve.derivative([0.3, 0.4]).shape == (2, 0)


@given(st.lists(st.floats(0.01, 1.99), min_size=1, max_size=4, unique=True))
def test_more_knots_on_a_curve_do_not_change_it(extra: list[float]) -> None:
    curve = Curve(TIMES, wave(TIMES))
    more = np.array([x for x in extra if np.abs(TIMES - x).min() > 1e-3 and 0.1 < x < 1.5])
    sites = np.union1d(TIMES, more)
    finer = Curve(sites, curve(sites))
    t = np.linspace(0, 2, 41)
    np.testing.assert_allclose(finer(t), curve(t), atol=1e-9)


@pytest.mark.parametrize(
    ("times", "values", "message"),
    [
        ([0.0, 1.0], np.zeros((3, 1)), "2 knots has values of shape"),
        ([], np.zeros((0, 1)), "0 knots"),
        ([0.0, 1.0], np.zeros(2), "values of shape"),
        ([0.0, 0.0], np.zeros((2, 1)), "must be finite and increase"),
        ([0.0, np.inf], np.zeros((2, 1)), "must be finite and increase"),
        ([0.0, 1.0], np.full((2, 1), np.nan), "must be finite and increase"),
        ([-1.0, 0.0, 1e-320], np.zeros((3, 1)), "knots 1 and 2 of a curve are 9.99989e-321 s apart"),
    ],
)
def test_unsound_curves_are_refused(times: list[float], values: Float, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Curve(np.array(times), values)


BROKEN = Curve(np.array([0.0, 1, 2, 3, 3, 4, 5, 6, 6, 7]), np.array([[0.0, 1, 4, 9, 2, 1, 0, -1, -1, 5]]).T)
"""A parabola, a jump to a line, and a corner to another line."""


def test_times_given_twice_break_a_curve() -> None:
    t = np.array([0.5, 2.5, 3.0, 3.5, 5.75, 6.0, 6.5])
    np.testing.assert_allclose(BROKEN(t)[:, 0], [0.25, 6.25, 2, 1.5, -0.75, -1, 2], atol=1e-13)
    np.testing.assert_allclose(BROKEN.derivative(t)[:, 0], [1, 5, -1, -1, -1, 6, 6], atol=1e-12)
    assert BROKEN.breaks.tolist() == [3, 6]
    both = BROKEN.on_both_sides(np.array([0.5, 3.0, 3.0, 3.5, 6.0, 6.0]))
    np.testing.assert_allclose(both[:, 0], [0.25, 9, 2, 1.5, -1, -1], atol=1e-13)
    assert [piece(piece.end).item() for piece in BROKEN.pieces] == [9, -1, 5]
    again = Curve.from_pieces(BROKEN.pieces)
    np.testing.assert_array_equal(again.times, BROKEN.times)
    np.testing.assert_array_equal(again.values, BROKEN.values)


@pytest.mark.parametrize("times", [[0.0, 0, 1], [0.0, 1, 1], [0.0, 1, 1, 1, 2], [0.0, 1, 1, 0.5]])
def test_only_inner_knots_may_be_given_twice(times: list[float]) -> None:
    with pytest.raises(SettingsError, match="finite and increase"):
        Curve(np.array(times), np.zeros((len(times), 1)))
