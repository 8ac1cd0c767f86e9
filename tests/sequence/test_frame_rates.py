"""NTSC's frame rates, wherever they are typed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.operations import resample
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.frame_rates import exact_rate, rate_text
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import bar

TYPED = [(23.976, 24000), (23.98, 24000), (29.97, 30000), (47.952, 48000), (59.94, 60000), (119.88, 120000)]


@pytest.mark.parametrize(("typed", "thousands"), TYPED)
def test_typed_rates_are_exact(typed: float, thousands: int) -> None:
    assert exact_rate(typed) == exact_rate(thousands / 1001) == thousands / 1001


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 30.03, 59.9, 0.0, -23.976, np.inf])
def test_other_rates_stay(rate: float) -> None:
    assert exact_rate(rate) == exact_rate(rate, own=24.0) == rate


@pytest.mark.parametrize(("typed", "own"), [(23.976, 23.976), (47.952, 23.976), (29.97, 59.94)])
def test_rates_that_fall_on_the_frames_of_a_motion_stay(typed: float, own: float) -> None:
    assert exact_rate(typed, own=own) == typed


def test_words() -> None:
    assert rate_text(24 / 1.001) == "24000/1001 (23.976)"
    assert [rate_text(rate) for rate in (24, 23.976, 12.5)] == ["24", "23.976", "12.5"]


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
