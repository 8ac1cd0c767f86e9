"""USD, writing: what else moves in a file whose meshes are retimed."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol

import mixseq
from mixseq.errors import MixseqError, MixseqWarning, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from tests.formats.usd.stage_maker import read
from tests.formats.usd_maker import Asset, character, lift, load, paint, problems, save, shot, world_points

CODES = np.array([0.0, 1, 2, 3, 4])
RETIMINGS: Mapping[str, FloatArray] = {
    "slow": CODES / 2,
    "late": CODES / 4 + 1,
    "backwards": 2 - CODES / 2,
    "a pause": np.array([0, 1, 1, 1, 2.0]),
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


@pytest.fixture
def scene(asset: Asset) -> Asset:
    """A rig that carries a mesh, hair that grows, an eye that rolls, a material that changes, and a still."""
    stage = asset.stage
    paint(asset)
    asset.path.with_name("wool.png").touch()
    slide = asset.rig.AddTranslateOp()
    eye = UsdGeom.Camera.Define(stage, "/set/eye")
    roll, focus = eye.AddRotateZOp(), eye.CreateFocalLengthAttr()
    hair = UsdGeom.BasisCurves.Define(stage, "/set/hair")
    hair.CreateTypeAttr("linear")
    hair.CreateCurveVertexCountsAttr([2])
    hair.CreateExtentAttr([(0, 0, 0), (4, 4, 4)])
    rough = stage.GetPrimAtPath("/set/looks/wool/surface").CreateAttribute("inputs:roughness", Sdf.ValueTypeNames.Float)
    for code in range(3):
        slide.Set(Gf.Vec3d(code, code**2, 0), code)
        roll.Set(10.0 * code, code)
        focus.Set(50.0 + code, code)
        hair.CreatePointsAttr().Set([(0, 0, 0), (0, 0, code)], code)
        rough.Set(code / 2, code)
    UsdGeom.Sphere.Define(stage, "/set/still")
    return asset


def retimed(asset: Asset, shown: FloatArray, prim: str | None = None) -> MeshSequence:
    """Return what the mesh is at some time codes of the file, in as many frames at its rate."""
    before = asset.read(prim)
    points = np.array([_between(before.points, code) for code in shown], dtype=np.float32)
    return MeshSequence.from_header(before.header.with_times(CODES / 25), points)


def _between(points: FloatArray, code: float) -> FloatArray:
    low = min(int(code), len(points) - 2)
    return np.asarray((low + 1 - code) * points[low] + (code - low) * points[low + 1])


def world(stage: Usd.Stage, path: str, code: float) -> FloatArray:
    return np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(stage.GetPrimAtPath(path)))


@pytest.mark.parametrize("name", RETIMINGS)
@pytest.mark.parametrize("options", [{}, {"clips": 2}])
def test_everything_shows_the_same_time(scene: Asset, path: Path, name: str, options: dict[str, Any]) -> None:
    shown = RETIMINGS[name]
    written = retimed(scene, shown)
    stage = save(path, written, sources=shown / 25, whole_stage=True, **options)
    before = Usd.Stage.Open(str(scene.path))
    assert problems(stage) - problems(before) == set()
    for frame, (code, below) in enumerate(zip(CODES.tolist(), shown.tolist(), strict=True)):
        for prim in ("/set/eye", "/set/hair", "/set"):
            np.testing.assert_allclose(world(stage, prim, code), world(before, prim, below), atol=1e-6)
        for attribute in ("/set/eye.focalLength", "/set/hair.points", "/set/looks/wool/surface.inputs:roughness"):
            got, known = (
                each.GetAttributeAtPath(attribute).Get(time) for each, time in ((stage, code), (before, below))
            )
            np.testing.assert_allclose(got, known, atol=1e-6)
        np.testing.assert_allclose(world_points(stage, "/set/walker", code), written.points[frame], atol=1e-5)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 4)
    got = load(path)
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    np.testing.assert_array_equal(got.times, written.times)


def test_parents_are_undone_as_they_are_retimed(scene: Asset, path: Path) -> None:
    stage = save(path, retimed(scene, CODES / 2), sources=CODES / 50, whole_stage=True)
    still = world(stage, "/set/walker", 0)
    for code in np.linspace(-1, 6, 15):
        np.testing.assert_allclose(world(stage, "/set/walker", code), still, atol=1e-12)


def test_what_keeps_its_speed_is_told(scene: Asset, path: Path) -> None:
    written = retimed(scene, CODES / 2)
    told = r"out\.usda: other motion in .*asset\.usda is not retimed: /set/looks/wool/surface, /set/eye, /set/hair"
    with pytest.warns(MixseqWarning, match=told + r", /set/still; whole_stage=True \(--whole-stage\)"):
        save(path, written, sources=CODES / 50)
    with pytest.warns(MixseqWarning, match=told + ", /set/still$"):  # frames that show no single time
        save(path, written, sources=[0, 0, np.nan, 0, 0])


def test_nothing_is_told_where_nothing_is_retimed(scene: Asset, path: Path) -> None:
    written = retimed(scene, CODES / 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        save(path, written, sources=written.times + 1e-6)
        save(path, written)
        asset = Asset(path.with_name("alone.usda"))
        save(path, retimed(asset, CODES / 2), sources=CODES / 50)


def test_meshes_that_were_not_chosen_are_the_rest(asset: Asset, path: Path) -> None:
    character(asset)
    written = retimed(asset, CODES / 2, "/set/walker")
    with pytest.warns(MixseqWarning, match="is not retimed: /set/rig/body;"):
        save(path, written, sources=CODES / 50)
    before = load(asset.path, "/set/rig/body")
    save(path, written, sources=CODES / 50, whole_stage=True)
    got = load(path, "/set/rig/body")
    np.testing.assert_allclose(got.times, CODES / 25)
    np.testing.assert_allclose(got.points[::2], before.points, atol=1e-5)


def test_what_moves_in_instances(asset: Asset, path: Path) -> None:
    bell = UsdGeom.Sphere.Define(asset.stage, "/bell")
    ring = UsdGeom.Sphere.Define(asset.stage, "/bell/clapper").CreateRadiusAttr()
    for code in range(3):
        ring.Set(float(code), code)
    tower = UsdGeom.Xform.Define(asset.stage, "/set/tower").GetPrim()
    tower.GetReferences().AddInternalReference(bell.GetPath())
    tower.SetInstanceable(True)
    written = retimed(asset, CODES / 2)
    with pytest.warns(MixseqWarning, match="instances no longer: /set/tower$"):
        stage = save(path, written, sources=CODES / 50, whole_stage=True)
    assert stage.GetPrimAtPath("/set/tower/clapper").GetAttribute("radius").Get(3) == 1.5


def test_files_of_every_frame(asset: Asset, path: Path) -> None:
    smoke = UsdVol.OpenVDBAsset.Define(asset.stage, "/set/smoke").CreateFilePathAttr()
    for code in range(3):
        asset.path.with_name(f"smoke.{code}.vdb").touch()
        smoke.Set(f"./smoke.{code}.vdb", code)
    deeper = path.parent / "deeper" / path.name
    deeper.parent.mkdir()
    stage = save(deeper, retimed(asset, CODES / 2), sources=CODES / 50, whole_stage=True)
    files = [stage.GetPrimAtPath("/set/smoke").GetAttribute("filePath").Get(code) for code in CODES]
    assert [each.path for each in files] == [f"../smoke.{number}.vdb" for number in (0, 0, 1, 1, 2)]


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        ("out.usda", {}, SettingsError, r"give sources=\.\.\."),
        ("out.usda", {"sources": CODES / 50, "flatten": True}, SettingsError, "leave out flatten"),
        ("out.usdz", {"sources": CODES / 50}, SettingsError, r"write \.usdc"),
        ("out.usda", {"sources": CODES * np.nan}, SettingsError, "frame 0 shows no single time"),
    ],
)
def test_settings_that_do_not_fit(
    asset: Asset, tmp_path: Path, name: str, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        save(tmp_path / name, retimed(asset, CODES / 2), whole_stage=True, **options)


def test_as_many_sources_as_frames(asset: Asset, path: Path) -> None:
    with pytest.raises(SettingsError, match="sources are 2 times for 5 frames; give one for every frame"):
        mixseq.write(path, retimed(asset, CODES / 2), sources=[0, 1])
    assert not path.exists()


def test_nothing_to_retime(path: Path) -> None:
    with pytest.raises(OutputError, match="stands alone, without a stage"):
        save(path, shot(lift()), sources=[0, 0, 0], whole_stage=True)


# USD of other programs


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
