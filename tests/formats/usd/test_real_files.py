"""USD of other programs."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import MixseqError
from tests.formats.usd.stage_maker import read


@pytest.mark.realdata
def test_a_real_cache_is_as_its_npz(data: Path) -> None:
    sequence = read(data / "usd" / "q_man_run_blender50.usdc")
    archive = np.load(data / "npz" / "q_man_run.npz")
    np.testing.assert_array_equal(sequence.faces, archive["faces"])
    np.testing.assert_allclose(sequence.points, archive["points"], rtol=0, atol=2.4e-7)
    assert len(sequence.polygons.counts) == 3966


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["CesiumMan.usdz", "RiggedSimple.usdz", "q_man_run_blender50.usdc"])
def test_truncated_files(data: Path, tmp_path: Path, name: str) -> None:
    whole = (data / "usd" / name).read_bytes()
    expected = read(data / "usd" / name).points
    for part in range(1, 10):
        (tmp_path / name).write_bytes(whole[: len(whole) * part // 10])
        with contextlib.suppress(MixseqError):  # packages end with textures, which are not needed
            np.testing.assert_array_equal(read(tmp_path / name).points, expected)
