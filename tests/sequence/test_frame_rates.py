"""NTSC's frame rates, wherever they are typed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.operations import resample
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.frame_rates import (
    estimate_frame_rate,
    format_frame,
    format_rate,
    hint_frame_number,
    number_to_time,
    snap_rate,
    snap_to_ntsc,
    time_to_number,
)
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar

TYPED = [(23.976, 24000), (23.98, 24000), (29.97, 30000), (47.952, 48000), (59.94, 60000), (119.88, 120000)]


@pytest.mark.parametrize(("typed", "thousands"), TYPED)
def test_typed_rates_are_exact(typed: float, thousands: int) -> None:
    assert snap_to_ntsc(typed) == snap_to_ntsc(thousands / 1001) == thousands / 1001


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 30.03, 59.9, 0.0, -23.976, np.inf])
def test_other_rates_stay(rate: float) -> None:
    assert snap_to_ntsc(rate) == snap_to_ntsc(rate, base=24.0) == rate


@pytest.mark.parametrize(("typed", "own"), [(23.976, 23.976), (47.952, 23.976), (29.97, 59.94)])
def test_rates_that_fall_on_the_frames_of_a_motion_stay(typed: float, own: float) -> None:
    assert snap_to_ntsc(typed, base=own) == typed


EVERY_RATE = [8.0, 12.0, 24.0, 25.0, 30.0, 48.0, 60.0, 90.0, 120.0, *(1000 * whole / 1001 for whole in (24, 30, 60))]


@pytest.mark.parametrize("rate", EVERY_RATE)
@pytest.mark.parametrize("first", [0, 1001])
def test_rates_of_times_as_writers_round_them(rate: float, first: int) -> None:
    frames = np.arange(first, first + 60)
    period = np.float32(1) / np.float32(rate)
    single = (frames / rate).astype(np.float32).astype(np.float64)
    accumulated = first / rate + np.append(np.float32(0), np.cumsum(np.full(59, period))).astype(np.float64)
    for times in np.stack([frames / rate, frames * float(period), single, accumulated]):
        assert estimate_frame_rate(times) == rate
        assert estimate_frame_rate(times, declared=float(np.float32(rate))) == rate
        assert estimate_frame_rate(times[::2], declared=rate) == rate  # on twos
    assert snap_rate(float(np.float32(rate))) == snap_rate(1 / float(period)) == rate


def test_rates_that_are_no_usual_ones_stay() -> None:
    for rate in (14.7, 29.97, 12.3456789):
        assert estimate_frame_rate(np.arange(50) / rate) == pytest.approx(rate, rel=1e-12)
    assert snap_rate(29.97) == 29.97
    assert estimate_frame_rate(np.array([0.5])) is None
    assert estimate_frame_rate(np.array([0.5]), declared=25) == 25


def test_words() -> None:
    assert format_rate(24 / 1.001) == "24000/1001 (23.976)"
    assert [format_rate(rate) for rate in (24, 23.976, 12.5)] == ["24", "23.976", "12.5"]


def test_frames_of_arrays() -> None:
    made = MeshSequence.from_arrays(np.zeros((1097, 3, 3)), [[0, 1, 2]], fps=23.976)
    np.testing.assert_array_equal(made.times, np.arange(1097) / (24000 / 1001))


@pytest.mark.parametrize("rate", [23.976, 24000 / 1001])
def test_frames_of_arrays_at_known_times(rate: float) -> None:
    times = np.arange(1001, 1011) / rate
    made = MeshSequence.from_arrays(np.zeros((10, 3, 3)), [[0, 1, 2]], times, fps=23.976)
    assert made.fps == rate


@pytest.mark.parametrize("name", ["bar_#.obj", "bar.pc2"])
def test_files_that_do_not_tell_their_rate(name: str, tmp_path: Path) -> None:
    plain = bar(frames=3)
    mixseq.write(tmp_path / name, MeshSequence.from_arrays(plain.points, plain.polygons, fps=24))
    assert mixseq.read(tmp_path / name, fps=29.97).fps == 30000 / 1001


def test_sampled_motions() -> None:
    model = mixseq.fit(bar(frames=4), space="vertex", exact=True)
    for made in (model.sample(fps=59.94), resample(model, fps=59.94)):
        assert made.fps == 60000 / 1001
        np.testing.assert_allclose(np.diff(made.times), 1001 / 60000)
    assert Scene((SceneItem("bar", model),), 23.976).fps == 24000 / 1001


# Frame numbers and times: one rule, a number is a time by the rate

RATES = (24.0, 24000 / 1001, 25.0, 30000 / 1001, 120.0)


@pytest.mark.parametrize("fps", RATES)
def test_numbers_and_times_are_inverse(fps: float) -> None:
    for number in (-5, 0, 1, 1001, 9_999):
        assert time_to_number(number_to_time(number, fps), fps) == number
        assert format_frame(float(np.float32(number_to_time(number, fps))), fps) == f"{number}"  # as MDD holds times


def test_what_is_no_frame_keeps_its_fraction() -> None:
    assert time_to_number(10.5 / 24, 24) == 10.5
    assert format_frame(10.25 / 24, 24) == "10.25"


@pytest.mark.parametrize("fps", RATES)
def test_a_shot_begins_at_another_number(fps: float) -> None:
    header = bar().header.with_times(0.7 + np.arange(96) / fps, fps).numbered_from(1001)
    np.testing.assert_array_equal(header.times, np.arange(1001, 1097) / fps)
    assert header.index_of(1005) == 4


def test_uneven_times_keep_their_distances() -> None:
    times = np.array([0.0, 0.1, 0.35])
    moved = bar().header.with_times(times, 24).numbered_from(1001).times
    np.testing.assert_allclose(moved - 1001 / 24, times, atol=1e-12)


@pytest.mark.parametrize(("declared", "rate"), [(23.98, 24000 / 1001), (29.97, 30000 / 1001), (59.94, 60000 / 1001)])
def test_declared_rates_with_two_digits(declared: float, rate: float) -> None:
    """Frames at the exact rate, or on twos of it, have that rate; those at the rounded rate keep it."""
    numbers = np.arange(1001, 1201)
    assert estimate_frame_rate(numbers / rate, declared) == rate
    assert estimate_frame_rate(numbers[::2] / rate, declared) == rate
    assert estimate_frame_rate(numbers / declared, declared) == declared


def test_seconds_that_are_frames() -> None:
    shot = (1001 / 24, 1096 / 24, 24.0)
    assert hint_frame_number(1096, *shot) == "; frame 1096 is at 45.6667 s"
    assert hint_frame_number(1097, *shot) == hint_frame_number(50.0, *shot) == ""


def shot(first: int = 1001) -> MeshSequence:
    bending = bar(frames=5)
    return MeshSequence.from_header(bending.header.numbered_from(first), bending.points)


def test_headers_know_their_frames() -> None:
    header = shot().header
    assert (header.frame_numbers, header.index_of(1003)) == ("1001 to 1005", 2)
    assert header.with_times(header.times[:1]).frame_numbers == "1001"
    assert header.frame_name(2) == "frame 1003 (index 2)"
    assert shot(0).header.frame_name(2) == header.frame_name(99).replace("99", "2") == "frame 2"
    with pytest.raises(SettingsError, match="there is no frame 2; frames are 1001 to 1005"):
        header.index_of(2)
    with pytest.raises(SettingsError, match="start_frame is nan"):
        header.numbered_from(float("nan"))


def test_errors_name_the_number() -> None:
    points = shot().points.copy()
    points[3, 1] = np.nan
    with pytest.raises(InvalidSequenceError, match=r"frame 1004 \(index 3\): vertex 1 is"):
        MeshSequence.from_header(shot().header, points)
