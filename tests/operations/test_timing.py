"""Affine maps of time."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations import cut, reverse, shift, speed
from tests.operations.motions import bar_motion

KNOTS = [None, 2]


@pytest.mark.parametrize("knots", KNOTS)
def test_shift(knots: int | None) -> None:
    model = bar_motion(knots=knots)
    later = shift(model, 2.5)
    np.testing.assert_allclose(later.times, model.times + 2.5)
    np.testing.assert_allclose(later.sample().points, model.sample().points, atol=1e-9)
    np.testing.assert_allclose(later(2.77), model(0.27), atol=1e-9)


@pytest.mark.parametrize("knots", KNOTS)
@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_speed(knots: int | None, factor: float) -> None:
    model = cut(bar_motion(knots=knots), 0.2, 0.7)
    faster = speed(model, factor)
    assert (faster.start, faster.end) == pytest.approx((0.2, 0.2 + 0.5 / factor))
    np.testing.assert_allclose(faster.times, 0.2 + (model.times - 0.2) / factor)
    np.testing.assert_allclose(faster(0.2 + 0.33 / factor), model(0.53), atol=1e-9)
    np.testing.assert_allclose(faster.velocity(0.2 + 0.33 / factor), factor * model.velocity(0.53), atol=1e-8)


@pytest.mark.parametrize("knots", KNOTS)
def test_reverse(knots: int | None) -> None:
    model = cut(bar_motion(knots=knots), 0.2, 0.7)
    back = reverse(model)
    assert (back.start, back.end) == pytest.approx((0.2, 0.7))
    np.testing.assert_allclose(back.sample().points, model.sample().points[::-1], atol=1e-9)
    np.testing.assert_allclose(back(0.33), model(0.57), atol=1e-9)
    np.testing.assert_allclose(back.velocity(0.33), -model.velocity(0.57), atol=1e-8)
    np.testing.assert_allclose(reverse(back).curve([0.33, 0.7]), model.curve([0.33, 0.7]), atol=1e-10)


def test_one_frame() -> None:
    model = bar_motion(frames=1)
    for edited in (shift(model, 1.0), speed(model, 2.0), reverse(model)):
        np.testing.assert_allclose(edited.sample().points, model.sample().points, atol=1e-12)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_speeds_are_positive(factor: float) -> None:
    with pytest.raises(SettingsError, match=r"factor is .*; a positive number is expected"):
        speed(bar_motion(), factor)


@pytest.mark.parametrize("seconds", [np.nan, np.inf])
def test_shifts_are_finite(seconds: float) -> None:
    with pytest.raises(SettingsError, match=r"seconds is .*; a number is expected"):
        shift(bar_motion(), seconds)
