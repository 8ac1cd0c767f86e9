"""What the live page does to models and colours by itself."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mixseq.operations import shift, sketch, speed
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.viewer.live.controls import MIN_DURATION, TimeBase, duration, reach_of, span
from mixseq.viewer.live.stage import srgb_to_linear
from mixseq.viewer.page import script_json
from tests.meshes import bar


@pytest.mark.parametrize(("end", "shown"), [(7 / 6, 1.167), (0.625, 0.625), (1.9583333, 1.959), (1.0, 1.0)])
def test_a_slider_does_not_end_before_the_model(bar_model: Model, end: float, shown: float) -> None:
    longer = speed(bar_model, bar_model.end / end)
    assert duration(longer) == pytest.approx(shown)
    assert longer.end <= duration(longer) < longer.end + MIN_DURATION


def test_sections_are_in_the_times_of_the_model(bar_model: Model) -> None:
    first, last = 1001 / 24, 1001 / 24 + bar_model.end
    begin, end = span(shift(bar_model, first))
    assert begin <= first < begin + MIN_DURATION
    assert last <= end < last + MIN_DURATION
    assert [begin, end] == pytest.approx([41.708, 42.009])


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


# The times that the panel shows: those of one mesh, by its seconds and its frame numbers


def shot(first: float, fps: float = 24.0) -> MeshSequence:
    bending = bar(frames=5)
    header = bending.header.with_times([number / fps for number in range(5)], fps).numbered_from(first)
    return MeshSequence.from_header(header, bending.points)


def base(sequence: MeshSequence, rate: float | None = None) -> TimeBase:
    return TimeBase.from_scene(Scene((SceneItem("", sequence),), rate), 0)


@pytest.mark.parametrize("fps", [24.0, 24000 / 1001, 29.97])
def test_a_shot_is_shown_by_its_numbers(fps: float) -> None:
    shown = base(shot(1001, fps))
    assert shown.slider == (1001.0, 1005.0, 1.0, 0)
    assert shown.number(2 / fps) == 1003
    assert shown.elapsed(1003) == pytest.approx(2 / fps)
    assert shown.text(2 / fps) == f"frame 1003 of 1005, {1003 / fps:.3f} of {1005 / fps:.3f} s"


def test_at_another_rate_frames_are_between_numbers() -> None:
    shown = base(shot(1001), rate=48.0)
    low, high, step, digits = shown.slider
    assert (low, step, digits) == (1001.0, 0.5, 3)
    assert high >= 1001 + shown.last * 24
    assert shown.text(1 / 48).startswith("frame 1001.5 of ")


def test_the_slider_holds_numbers_that_are_not_whole() -> None:
    shown = base(shot(10.00049))
    low, high, _, digits = shown.slider
    assert (low, high, digits) == (10, 14, 0)  # a matter of rounding
    shown = base(shot(10.3333))
    low, high, _, digits = shown.slider
    assert low <= 10.3333 < low + 1e-3
    assert high - 1e-3 < 14.3333 <= high
    assert digits == 3
