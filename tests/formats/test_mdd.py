"""MDD files: times in single precision, and the frame rate that they tell."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError, MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write


def moving(times: np.ndarray, fps: float = 24) -> MeshSequence:
    points = np.eye(3, dtype=np.float32) + np.arange(len(times), dtype=np.float32)[:, None, None]
    return MeshSequence.from_arrays(points, [[0, 1, 2]], times=times, fps=fps)


@pytest.mark.parametrize("fps", [12, 23.976, 24, 24000 / 1001, 25, 29.97, 30, 59.94, 120, 14.7])
@pytest.mark.parametrize("start", [0, 40])
def test_times_and_rate(tmp_path: Path, fps: float, start: float) -> None:
    written = moving(start + np.arange(50) / fps, fps)
    write(tmp_path / "a.mdd", written)
    got = read(tmp_path / "a.mdd")
    np.testing.assert_allclose(got.times, written.times, rtol=4e-7, atol=6e-7)
    assert got.fps == pytest.approx(fps, rel=2e-4)
    if fps == int(fps):
        assert got.fps == fps
        np.testing.assert_array_equal(got.times, np.rint(written.times * fps) / fps)


def test_uneven_times_are_kept_in_single_precision_and_others_exactly(tmp_path: Path) -> None:
    times = np.array([-1.0, 0.1, 0.1 + 1 / 24, 0.1 + 2 / 24, 7 / 3])
    write(tmp_path / "a.mdd", moving(times))
    got = read(tmp_path / "a.mdd")
    assert got.fps == 24
    assert got.times.tolist() == [*times[:-1].astype(np.float32), 56 / 24]


def test_rates_that_times_do_not_tell(tmp_path: Path) -> None:
    with pytest.warns(MixseqWarning, match="MDD files cannot hold 24 frames per second"):
        write(tmp_path / "a.mdd", moving(np.arange(4) / 12))
    assert read(tmp_path / "a.mdd").fps == 12


def test_one_frame(tmp_path: Path) -> None:
    write(tmp_path / "a.mdd", moving(np.array([0.5])))
    got = read(tmp_path / "a.mdd")
    assert (got.times.tolist(), got.fps) == ([0.5], 24)


@pytest.mark.parametrize("last", [0.0, -1.0, float("inf"), float("nan")])
def test_a_last_time_that_is_not_after_the_first(tmp_path: Path, last: float) -> None:
    """Between them times increase, so that there is a rate to be looked for."""
    write(tmp_path / "a.mdd", moving(np.arange(5) / 24))
    content = bytearray((tmp_path / "a.mdd").read_bytes())
    content[8 + 4 * 4 : 8 + 5 * 4] = struct.pack(">f", last)
    (tmp_path / "a.mdd").write_bytes(content)
    with pytest.raises(
        InvalidSequenceError, match=r"a.mdd: frame 4(: its time is not finite| is at .* s, not after)"
    ):
        read(tmp_path / "a.mdd")


def test_times_too_close_for_single_precision(tmp_path: Path) -> None:
    with pytest.raises(
        InvalidSequenceError, match=r"frames 1 and 2 are both at 1000 s in float32, which MDD stores"
    ):
        write(tmp_path / "a.mdd", moving(np.array([999.0, 1000.0, 1000.00001])))


@pytest.mark.parametrize("last", [0.0, -1.0, float("nan"), float("inf")])
def test_times_that_do_not_increase(tmp_path: Path, last: float) -> None:
    write(tmp_path / "a.mdd", moving(np.arange(2) / 24))
    content = bytearray((tmp_path / "a.mdd").read_bytes())
    struct.pack_into(">f", content, 12, last)
    (tmp_path / "a.mdd").write_bytes(content)
    with pytest.raises(InvalidSequenceError, match=r"a\.mdd: frame 1.* time"):
        read(tmp_path / "a.mdd")
