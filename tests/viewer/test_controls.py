"""The times that the panel shows: those of one mesh, by its seconds and its frame numbers."""

from __future__ import annotations

import pytest

from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.viewer.live.controls import TimeBase
from tests.meshes import bar


def shot(first: float, fps: float = 24.0) -> MeshSequence:
    bending = bar(frames=5)
    header = bending.header.with_times([number / fps for number in range(5)], fps).numbered_from(first)
    return MeshSequence.from_header(header, bending.points)


def base(sequence: MeshSequence, rate: float | None = None) -> TimeBase:
    return TimeBase.of(Scene((SceneItem("", sequence),), rate), 0)


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
