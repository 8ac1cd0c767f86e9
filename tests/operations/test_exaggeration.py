"""More or less of a motion, of all of it and of single modes; of whole characters see `test_whole_character`."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations import exaggerate
from mixseq.operations.filters import check_gain
from tests.operations.motions import bar_motion


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
    with pytest.raises(SettingsError, match="gain is inf; a number is expected"):
        exaggerate(bar_motion(), np.inf)
    for mode in (-1, 99):
        with pytest.raises(SettingsError, match=f"there is no mode {mode}; the model has 8, from 0 on"):
            exaggerate(bar_motion(), 2.0, modes=[0, mode])


@pytest.mark.parametrize("gain", [1001.0, -1e200, np.inf, np.nan])
def test_gains_that_no_motion_survives_are_refused(gain: float) -> None:
    with pytest.raises(SettingsError, match="a number is expected, at most 1000 in size"):
        check_gain(gain)
