"""What the live page does to models and colours by itself."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mixseq.operations import sketch, speed
from mixseq.signals.model import Model
from mixseq.viewer.live.controls import MIN_DURATION, duration, reach_of
from mixseq.viewer.live.stage import srgb_to_linear
from mixseq.viewer.page import script_json


@pytest.mark.parametrize(("end", "shown"), [(7 / 6, 1.167), (0.625, 0.625), (1.9583333, 1.959), (1.0, 1.0)])
def test_a_slider_does_not_end_before_the_model(bar_model: Model, end: float, shown: float) -> None:
    longer = speed(bar_model, bar_model.end / end)
    assert duration(longer) == pytest.approx(shown)
    assert longer.end <= duration(longer) < longer.end + MIN_DURATION


def test_a_single_frame_has_lengths_that_controls_take(bar_model: Model) -> None:
    still = sketch(bar_model, [[0.0, 0.0]], 1e-4)
    assert duration(still) >= MIN_DURATION
    assert reach_of(still) >= MIN_DURATION


def test_light_in_closed_form() -> None:
    # IEC 61966-2-1: straight up to 0.04045, then a power of 2.4
    shades = np.array([0, 1, 10, 11, 128, 188, 254, 255], dtype=np.uint8)
    light = [0, 0, 1, 1, 55, 128, 253, 255]
    assert srgb_to_linear(shades).dtype == np.uint8
    np.testing.assert_array_equal(srgb_to_linear(shades), light)
    np.testing.assert_array_equal(srgb_to_linear(shades.reshape(-1, 2)), np.reshape(light, (-1, 2)))


def test_light_grows_with_the_colour() -> None:
    assert (np.diff(srgb_to_linear(np.arange(256, dtype=np.uint8)).astype(int)) >= 0).all()


@pytest.mark.parametrize("value", ["</script><script>alert(1)</script>", "<!--", {"a": [1, 2.5, None, "<"]}])
def test_nothing_ends_the_script_that_it_is_in(value: object) -> None:
    assert "<" not in script_json(value)
    assert json.loads(script_json(value)) == value


def test_no_numbers_that_json_does_not_know() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        script_json([float("nan")])
