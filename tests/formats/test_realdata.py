"""Animations made by others (see the README of the data folder)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from mixseq_io import open_sequence, read, write
from tests.formats.conftest import lossy

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


@pytest.mark.parametrize("extension", ["usdc", "usda", "usd", "npz", "h5", "abc"])
def test_blenders_usd_survives(data: Path, tmp_path: Path, extension: str) -> None:
    original = read(data / "usd/q_man_run_blender50.usdc")
    alone = {"flatten": True} if extension.startswith("usd") else {}
    with lossy():  # Alembic has no up axis
        write(tmp_path / f"copy.{extension}", original, **alone)
    copy = read(tmp_path / f"copy.{extension}")
    assert copy.polygons.same_as(original.polygons)
    np.testing.assert_allclose(copy.times, original.times, rtol=1e-14)
    np.testing.assert_array_equal(copy.points.view(np.uint32), original.points.view(np.uint32))
    for what in ("fps", "name") if extension == "abc" else ("fps", "up_axis", "metres_per_unit", "name"):
        assert getattr(copy, what) == getattr(original, what)


def test_cesium_man_walks_alike_in_gltf_and_usd(data: Path) -> None:
    """The glTF file is welded, starts one frame earlier, and looks along another axis."""
    gltf, usd = read(data / "gltf/CesiumMan.glb"), read(data / "usd/CesiumMan.usdz")
    np.testing.assert_allclose(gltf.times[1:], usd.times, atol=1e-5)
    assert len(gltf.faces) == len(usd.faces)
    welded = gltf.points[1:].astype(np.float64)
    x, y, z = np.moveaxis(usd.points.astype(np.float64), 2, 0)
    assert usd.up_axis == "Y"
    turned = np.stack([z, y, -x], axis=2)
    distance, vertex = KDTree(np.hstack([welded[0], welded[20]])).query(np.hstack([turned[0], turned[20]]))
    assert np.unique(vertex).size == gltf.vertex_count
    assert np.max(distance) < 1e-5 * gltf.diagonal
    assert np.abs(welded[:, vertex] - turned).max() < 1e-6 * gltf.diagonal
