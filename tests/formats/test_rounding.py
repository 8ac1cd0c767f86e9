"""Files of single precision tell when vertices are visibly off in them, and by how much."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write, write_blocks
from mixseq_io.surfaces import VISIBLE, Rounding
from tests.formats.conftest import fan, wave

CLOUD = MeshSequence.from_arrays(wave(dtype=np.float64), fan(), name="cloud")


def error_told(path: Path, sequence: MeshSequence) -> float:
    """Write frame by frame; return the error that a warning tells, 0 if there is none."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_blocks(path, sequence.header, list(sequence.blocks(1)))
    told = [re.search(r"off by up to (\S+) of the diagonal", str(each.message)) for each in caught]
    return max((float(found[1]) for found in told if found), default=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.usdc", "a.abc", "a.glb", "a.pc2", "a.mdd"])
def test_the_error_that_is_told_is_that_of_the_file(name: str, tmp_path: Path) -> None:
    for offset in (0.0, 100.0, 1e5, 1e8):
        far = CLOUD.with_points(CLOUD.points + offset)
        told = error_told(tmp_path / name, far)
        apart = np.linalg.norm(read(tmp_path / name).points.astype(np.float64) - far.points, axis=2)
        error = apart.max() / far.diagonal
        assert told == pytest.approx(error if error > VISIBLE else 0.0, rel=0.06)
        assert (told > 0) is (offset >= 1e5)


@pytest.mark.parametrize("name", ["a.npz", "a_####.ply", "a_####.obj", "a_####.off"])
def test_doubles_are_not_off(name: str, tmp_path: Path) -> None:
    assert error_told(tmp_path / name, CLOUD.with_points(CLOUD.points + 1e8)) == 0


def test_a_warning_says_what_would_help(tmp_path: Path) -> None:
    far = CLOUD.with_points(CLOUD.points + np.array([0, 0, 0, 1e6, 1e4])[:, None, None])
    message = r"a\.pc2: PC2 holds points in single precision, .* most in frame 3; write \.npz, \.h5 or \.ply"
    with pytest.warns(MixseqWarning, match=message):
        write(tmp_path / "a.pc2", far)


def test_single_precision_stays_what_it_is(tmp_path: Path) -> None:
    assert error_told(tmp_path / "a.pc2", CLOUD.with_points((CLOUD.points + 1e8).astype(np.float32))) == 0


def test_what_is_hardly_larger_than_zero_is_off() -> None:
    rounding = Rounding()
    for points in (CLOUD.points, CLOUD.points * 1e-30, CLOUD.points * 1e-36):
        list(rounding.watched([points]))
        assert rounding.error == 0
    list(rounding.watched([CLOUD.points * 1e-310]))
    largest = np.linalg.norm(CLOUD.points, axis=2).max() / CLOUD.diagonal
    assert rounding.error == pytest.approx(largest)


def test_a_first_frame_that_is_one_point_has_the_diagonal_one() -> None:
    rounding = Rounding()
    list(rounding.watched([np.full((1, 4, 3), 1.0), np.full((1, 4, 3), 2.0**24 + 1)]))
    assert rounding.error == pytest.approx(3**0.5)
    assert rounding.frame == 1
