"""Animations made by others (see the README of the data folder)."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from mixseq.sequence.frame_rates import FRAME_TOLERANCE
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import open_sequence, read, write
from tests.formats.conftest import TARGETS, lossy
from tests.formats.kept import assert_close, assert_points, corner_order, in_metres

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


DATA = Path(os.environ.get("MIXSEQ_DATA") or "missing")
FILES = sorted(
    str(file.relative_to(DATA)) for kind in ("npz", "usd", "alembic", "gltf") for file in (DATA / kind).glob("*")
)
QUICK_FILES = ("usd/RiggedFigure.usdz", "gltf/RiggedSimple.glb", "npz/fox_run.npz")  # others with MIXSEQ_EXHAUSTIVE
WHOLE_FILES = ("npz/fox_survey.npz", "npz/robotexpressive_dance.npz", "gltf/CesiumMan.glb", "alembic/Bone_Anim.abc")
CONVERTED_FRAMES = 10  # of all other files


def exhaustive(name: str) -> Any:
    return pytest.param(name, marks=() if name in QUICK_FILES else pytest.mark.exhaustive)


@cache
def beginning(name: str) -> MeshSequence:
    """Return the first frames of a file."""
    with lossy():
        whole = read(DATA / name)
    count = whole.frame_count if name in WHOLE_FILES else min(CONVERTED_FRAMES, whole.frame_count)
    return MeshSequence.from_header(whole.header.with_times(whole.times[:count]), whole.points[:count])


@pytest.mark.parametrize(
    "target", [each for each in TARGETS if "start" not in each.options], ids=lambda each: each.file_name
)
@pytest.mark.parametrize("name", [exhaustive(each) for each in FILES])
def test_every_file_survives_every_format(name: str, target: Any, tmp_path: Path) -> None:
    """Points, times, rate and order come back, to the digits of the format; numbered files are read with their rate."""
    sequence = beginning(name)
    path = tmp_path / target.file_name
    with lossy():
        write(path, sequence, **target.options)
        has_times = not target.format.capabilities.times.startswith(("no", "even"))
        got = read(path, **({} if has_times else {"fps": sequence.fps}))
    expected = in_metres(sequence) if target.format.name == "glTF" else sequence
    assert_points(target, expected, got, *corner_order(target, expected, got))
    if target.keeps_unused:  # STL numbers vertices anew
        np.testing.assert_array_equal(got.polygons.triangles, sequence.polygons.triangles)
        assert_close(target, got.points, expected.points.astype(got.points.dtype))
    error = max(target.time_error, 1e-12) if has_times else FRAME_TOLERANCE / sequence.fps
    np.testing.assert_allclose(got.times, sequence.times, rtol=1e-14, atol=error)
    assert got.fps == sequence.fps


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
