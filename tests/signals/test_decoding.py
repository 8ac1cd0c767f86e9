"""Distances between frames are those of the closed form, and more frames make them small."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.runtime.progress import Progress
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.decoding import Decodable, hold_between, largest_distance, played_blocks, quarter_times
from mixseq.types import Float
from tests.meshes import rotation

RATE = np.pi / 3
"""Radians per frame, one frame per second."""

SQUARE = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])


@dataclass(frozen=True, eq=False)
class Turning(Decodable):
    """A square of diagonal 2 sqrt(2) that turns about its middle."""

    header: SequenceHeader

    def decode_points(self, times: Float) -> Float:
        return np.stack([SQUARE @ rotation((0.0, 0.0, RATE * time)).T for time in times])

    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        raise NotImplementedError

    def prepare(self, times: Float, velocities: bool, progress: Progress) -> None:
        pass


@pytest.fixture
def turning() -> Turning:
    still = MeshSequence.from_arrays(np.stack([SQUARE] * 4), [[0, 1, 2], [0, 2, 3]], fps=1)
    return Turning(still.header)


def error_of_chords(motion: Decodable, frames: MeshSequence) -> float:
    times = quarter_times(frames.times)
    return largest_distance(motion.blocks(times), played_blocks(frames, times)) / frames.diagonal


def test_quarters() -> None:
    assert quarter_times(np.array([0.0, 4, 6])).tolist() == [1, 2, 3, 4.5, 5, 5.5]
    assert quarter_times(np.array([3.0])).size == 0


def test_points_move_on_chords(turning: Turning) -> None:
    sagitta = 1 - np.cos(RATE / 2)
    assert error_of_chords(turning, turning.sample()) == pytest.approx(sagitta / np.sqrt(8), rel=1e-12)


def test_a_single_frame_stands_still(turning: Turning) -> None:
    times = quarter_times(turning.times)
    played = played_blocks(turning.sample(times=[0.0]), times)
    assert largest_distance(turning.blocks(times), played) == pytest.approx(2, rel=1e-2)  # about half a turn


@pytest.mark.parametrize("factor", [1, 2, 4, 8])
def test_as_many_frames_as_the_bound_needs(turning: Turning, factor: int) -> None:
    bound = 1.001 * (1 - np.cos(RATE / factor / 2)) / np.sqrt(8)
    frames = hold_between(
        turning, turning.sample(), bound, lambda frames, _: (frames, error_of_chords(turning, frames))
    )
    assert (frames.frame_count - 1, frames.fps) == (3 * factor, factor)


def test_a_bound_that_cannot_be_kept(turning: Turning) -> None:
    reached = (1 - np.cos(RATE / 16)) / np.sqrt(8)
    with pytest.raises(SettingsError, match=f"{reached:.2g} diagonals can be reached"):
        hold_between(turning, turning.sample(), 1e-4, lambda frames, _: (frames, error_of_chords(turning, frames)))
