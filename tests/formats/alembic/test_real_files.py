"""Alembic of other programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

imath = pytest.importorskip("imath")

from mixseq_io import read  # noqa: E402
from tests.formats.alembic.alembic_maker import load, save  # noqa: E402


@pytest.mark.realdata
def test_a_cache_of_maya(data: Path) -> None:
    got = load(data / "alembic" / "Bone_Anim.abc")
    expected = np.load(data / "npz" / "abc_dembones_bone.npz")  # Z up
    assert (got.frame_count, got.fps, got.name) == (400, 24, "BoneShape")
    assert set(got.polygons.counts) == {4}
    np.testing.assert_array_equal(got.faces, expected["faces"])
    turned = np.stack([expected["points"][..., 0], expected["points"][..., 2], -expected["points"][..., 1]], -1)
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=1e-7)


@pytest.mark.realdata
def test_a_cache_of_blender(data: Path, path: Path) -> None:
    got = load(data / "alembic" / "q_man_run_blender50.abc")
    expected = np.load(data / "npz" / "q_man_run.npz")
    np.testing.assert_array_equal(got.faces, expected["faces"])
    turned = np.stack([expected["points"][..., 0], expected["points"][..., 2], -expected["points"][..., 1]], -1)
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=3e-7)
    assert got.surface.hard_edges is not None
    save(path, got)
    again = load(path)
    np.testing.assert_array_equal(again.points, got.points)
    np.testing.assert_allclose(again.times, got.times, rtol=1e-14)
    assert again.polygons.same_as(got.polygons)


@pytest.mark.realdata
def test_alembic_and_usd_of_one_scene(data: Path) -> None:
    got, other = (load(data / "alembic" / "q_man_run_blender50.abc"), read(data / "usd" / "q_man_run_blender50.usdc"))
    assert got.polygons.same_as(other.polygons)
    turned = np.stack([other.points[..., 0], other.points[..., 2], -other.points[..., 1]], -1)  # Z up
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=1e-6)
