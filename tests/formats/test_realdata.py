"""Animations made by others (see the README of the data folder)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixseq_io import open_sequence, read, write

pytestmark = pytest.mark.realdata


def test_every_npz_reads(data: Path) -> None:
    files = sorted((data / "npz").glob("*.npz"))
    assert files
    for file in files:
        with open_sequence(file) as reader, np.load(file) as arrays:
            np.testing.assert_array_equal(np.concatenate(list(reader.blocks(5))), arrays["points"])
            np.testing.assert_array_equal(reader.header.faces, arrays["faces"])


def test_blenders_usd_is_the_npz(data: Path) -> None:
    sequence = read(data / "usd/q_man_run_blender50.usdc")
    expected = read(data / "npz/q_man_run.npz")
    assert (sequence.up_axis, sequence.fps, sequence.frame_count) == ("Z", 24, 22)
    assert not sequence.polygons.only_triangles
    np.testing.assert_array_equal(sequence.faces, expected.faces)
    np.testing.assert_allclose(sequence.points, expected.points, atol=3e-7)


@pytest.mark.parametrize("extension", ["usdc", "usda", "usd", "npz", "h5"])
def test_blenders_usd_survives(data: Path, tmp_path: Path, extension: str) -> None:
    original = read(data / "usd/q_man_run_blender50.usdc")
    write(tmp_path / f"copy.{extension}", original)
    copy = read(tmp_path / f"copy.{extension}")
    assert copy.polygons.same_as(original.polygons)
    np.testing.assert_array_equal(copy.times, original.times)
    np.testing.assert_array_equal(copy.points.view(np.uint32), original.points.view(np.uint32))
    for what in ("fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(copy, what) == getattr(original, what)
