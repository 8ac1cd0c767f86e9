"""Frames side by side: matched by time, spread as of a loop."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.plots.frames import common_frames, frames_between
from mixseq.sequence import MeshSequence


def halved(gem: MeshSequence, frames: int = 9) -> MeshSequence:
    """Put a frame between every two of the first few."""
    times = np.linspace(gem.times[0], gem.times[frames - 1], 2 * frames - 1)
    return MeshSequence.from_arrays(gem.points[np.arange(len(times)) // 2], gem.faces, times=times)


def test_frames_are_matched_by_time(gem: MeshSequence) -> None:
    assert common_frames(gem, halved(gem), 4) == ([0, 2, 4, 6], [0, 4, 8, 12])


def test_all_frames_if_there_are_few(gem: MeshSequence) -> None:
    assert common_frames(gem, halved(gem, frames=2), 6) == ([0, 1], [0, 2])


def test_times_must_meet(gem: MeshSequence) -> None:
    later = MeshSequence.from_arrays(gem.points, gem.faces, times=gem.times + 0.01)
    with pytest.raises(SettingsError, match="no frame at the same time"):
        common_frames(gem, later, 4)


def test_frames_between(gem: MeshSequence) -> None:
    assert frames_between(gem, gem, [0, 4, 8]) == {}
    assert frames_between(gem, halved(gem), [0, 4, 8]) == {0: 1, 1: 9}
    assert frames_between(gem, halved(gem, frames=3), [0, 4, 8]) == {0: 1}
