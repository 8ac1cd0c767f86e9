"""What the live page does to models and colours by itself."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.operations import shift, sketch, speed
from mixseq.signals import Model
from mixseq.viewing.live.editing import SHORTEST, duration, pause, reach_of, span
from mixseq.viewing.live.stage import linear
from mixseq.viewing.template import script_json

NEAR = 4e-4
"""A ten thousandth of the bar's length: curves that were retimed are no nearer, see `mixseq.operations.retiming`."""


@pytest.mark.parametrize("time", [0.0, 0.1, 0.17, 0.3])
def test_a_pause_holds_still_and_goes_on(bar_model: Model, time: float) -> None:
    paused = pause(bar_model, time, 0.5)
    assert (paused.start, paused.end) == pytest.approx((bar_model.start, bar_model.end + 0.5))
    assert len(paused.times) == len(bar_model.times) + 5  # at 10 frames per second
    still = bar_model(time)
    for share in (0.0, 0.1, 0.5, 0.99, 1.0):
        np.testing.assert_allclose(paused(time + 0.5 * share), still, atol=NEAR)
    np.testing.assert_allclose(paused(paused.start), bar_model(bar_model.start), atol=NEAR)
    np.testing.assert_allclose(paused(paused.end), bar_model(bar_model.end), atol=NEAR)


def test_before_and_after_a_pause_everything_is_shown_once(bar_model: Model) -> None:
    paused = pause(bar_model, 0.15, 0.4)
    rests = [np.abs(paused(time) - bar_model(0.15)).max() for time in (0.0, 0.05, 0.1, 0.15)]
    goes = [np.abs(paused(time) - bar_model(0.15)).max() for time in (0.55, 0.6, 0.65, 0.7)]
    assert rests == sorted(rests, reverse=True)
    assert goes == sorted(goes)
    assert min(rests[0], goes[-1]) > 0.1


def test_a_pause_changes_no_other_speed(bar_model: Model) -> None:
    paused = pause(bar_model, 0.15, 0.4)
    for time in (0.05, 0.1):
        np.testing.assert_allclose(paused(time), bar_model(time), atol=NEAR)
        np.testing.assert_allclose(paused(0.7 - time), bar_model(0.3 - time), atol=NEAR)


@pytest.mark.parametrize(("end", "shown"), [(7 / 6, 1.167), (0.625, 0.625), (1.9583333, 1.959), (1.0, 1.0)])
def test_a_slider_does_not_end_before_the_model(bar_model: Model, end: float, shown: float) -> None:
    longer = speed(bar_model, bar_model.end / end)
    assert duration(longer) == pytest.approx(shown)
    assert longer.end <= duration(longer) < longer.end + SHORTEST


def test_sections_are_in_the_times_of_the_model(bar_model: Model) -> None:
    first, last = 1001 / 24, 1001 / 24 + bar_model.end
    begin, end = span(shift(bar_model, first))
    assert begin <= first < begin + SHORTEST
    assert last <= end < last + SHORTEST
    assert [begin, end] == pytest.approx([41.708, 42.009])


def test_a_single_frame_has_lengths_that_controls_take(bar_model: Model) -> None:
    still = sketch(bar_model, [[0.0, 0.0]], 1e-4)
    assert duration(still) >= SHORTEST
    assert reach_of(still) >= SHORTEST


@pytest.mark.parametrize("time", [-0.1, 0.4])
def test_a_pause_is_inside(bar_model: Model, time: float) -> None:
    with pytest.raises(SettingsError):
        pause(bar_model, time, 0.5)


@pytest.mark.parametrize("seconds", [0.0, -0.5, np.nan])
def test_a_pause_lasts(bar_model: Model, seconds: float) -> None:
    with pytest.raises(SettingsError):
        pause(bar_model, 0.1, seconds)


def test_light_in_closed_form() -> None:
    # IEC 61966-2-1: straight up to 0.04045, then a power of 2.4
    shades = np.array([0, 1, 10, 11, 128, 188, 254, 255], dtype=np.uint8)
    light = [0, 0, 1, 1, 55, 128, 253, 255]
    assert linear(shades).dtype == np.uint8
    np.testing.assert_array_equal(linear(shades), light)
    np.testing.assert_array_equal(linear(shades.reshape(-1, 2)), np.reshape(light, (-1, 2)))


def test_light_grows_with_the_colour() -> None:
    assert (np.diff(linear(np.arange(256, dtype=np.uint8)).astype(int)) >= 0).all()


@pytest.mark.parametrize("value", ["</script><script>alert(1)</script>", "<!--", {"a": [1, 2.5, None, "<"]}])
def test_nothing_ends_the_script_that_it_is_in(value: object) -> None:
    assert "<" not in script_json(value)
    assert json.loads(script_json(value)) == value


def test_no_numbers_that_json_does_not_know() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        script_json([float("nan")])
