"""PC2 files: the header and the times that follow from it."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write

POINTS = np.eye(3, dtype=np.float32)[None] + np.arange(4, dtype=np.float32)[:, None, None]


def save(
    folder: Path, start: float = 0, rate: float = 1, version: int = 1, magic: bytes = b"POINTCACHE2\0"
) -> Path:
    write(folder / "a.obj", MeshSequence.from_arrays(POINTS[:1], [[0, 1, 2]]))
    header = struct.pack("<12siiffi", magic, version, 3, start, rate, 4)
    (folder / "a.pc2").write_bytes(header + POINTS.tobytes())
    return folder / "a.pc2"


def test_times_are_frames_over_the_rate(tmp_path: Path) -> None:
    path = save(tmp_path, start=10, rate=0.5)
    for fps in (24.0, 30.0):
        got = read(path, fps=fps)
        np.testing.assert_allclose(got.times, np.array([10, 10.5, 11, 11.5]) / fps, rtol=1e-15)
        assert got.fps == fps
    np.testing.assert_array_equal(read(path).points, POINTS)
    with pytest.raises(SettingsError, match="fps is 0"):
        read(path, fps=0)


@pytest.mark.parametrize(("start", "rate"), [(0, 0), (0, -1), (float("nan"), 1), (0, float("inf"))])
def test_times_that_do_not_increase(tmp_path: Path, start: float, rate: float) -> None:
    with pytest.raises(InvalidSequenceError, match=r"a\.pc2: frame \d.* time"):
        read(save(tmp_path, start, rate))


def test_other_versions_and_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"a\.pc2 cannot be read as a PC2 file.*its version is 2, not 1"):
        read(save(tmp_path, version=2))
    with pytest.raises(FormatError, match="does not begin with POINTCACHE2"):
        read(save(tmp_path, magic=b"POINTCACHE1\0"))


@pytest.mark.parametrize("times", [[0.0, 0.5, 1.0, 1.5], [-1.0, 0.0, 1.0, 2.0], [100.0, 101.0, 102.0, 103.0]])
def test_even_times_are_kept(tmp_path: Path, times: list[float]) -> None:
    write(tmp_path / "a.pc2", MeshSequence.from_arrays(POINTS, [[0, 1, 2]], times=times))
    np.testing.assert_allclose(read(tmp_path / "a.pc2").times, times, rtol=1e-12)


def test_one_frame(tmp_path: Path) -> None:
    write(tmp_path / "a.pc2", MeshSequence.from_arrays(POINTS[:1], [[0, 1, 2]], times=[2.5], fps=30))
    assert read(tmp_path / "a.pc2", fps=30).times.tolist() == [2.5]


def test_uneven_times_and_other_rates_are_lost(tmp_path: Path) -> None:
    uneven = MeshSequence.from_arrays(POINTS, [[0, 1, 2]], times=[0, 1, 2, 4])
    with pytest.warns(MixseqWarning, match="PC2 files cannot hold uneven times"):
        write(tmp_path / "a.pc2", uneven)
    np.testing.assert_allclose(read(tmp_path / "a.pc2").times, [0, 4 / 3, 8 / 3, 4], rtol=1e-6)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write(tmp_path / "b.pc2", MeshSequence.from_arrays(POINTS, [[0, 1, 2]], fps=29.97))
    (warning,) = caught
    assert "29.97 frames per second (read it with fps=29.97)" in str(warning.message)
    assert warning.filename == __file__
    np.testing.assert_allclose(
        read(tmp_path / "b.pc2", fps=29.97).times, np.arange(4) * 1001 / 30000, rtol=1e-7
    )
