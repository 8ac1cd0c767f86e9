"""USD, writing: layers over files in which parents of the meshes move."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from mixseq.errors import MixseqWarning, OutputError
from mixseq.sequence.sequence import MeshSequence, join_blocks
from mixseq.types import FloatArray
from mixseq_io.usd.reader import open_usd
from tests.formats.usd_maker import Asset, character, load, problems, save, world_points

Ts: Any = import_module("pxr.Ts")  # not in the type stubs yet


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


@pytest.fixture
def rig(asset: Asset) -> UsdGeom.Xform:
    """What carries the mesh and a lamp, and turns, slides and rolls about a pivot, at times of its own."""
    for name in ("rig", "rig/body"):
        UsdGeom.Xform.Define(asset.stage, f"/set/{name}")
    layer = asset.stage.GetRootLayer()
    asset.stage.Save()
    Sdf.CopySpec(layer, "/set/walker", layer, "/set/rig/body/walker")
    asset.stage.RemovePrim("/set/walker")
    asset.mesh = UsdGeom.Mesh(asset.stage.GetPrimAtPath("/set/rig/body/walker"))
    UsdGeom.Sphere.Define(asset.stage, "/set/rig/lamp")
    rig = UsdGeom.Xform(asset.stage.GetPrimAtPath("/set/rig"))
    slide, pivot = rig.AddTranslateOp(), rig.AddTranslateOp(opSuffix="pivot")
    turn, size = rig.AddRotateXYZOp(), rig.AddScaleOp()
    rig.AddTranslateOp(opSuffix="pivot", isInverseOp=True)
    pivot.Set(Gf.Vec3d(1, 2, 3))
    size.Set(Gf.Vec3f(2, 2, 2), 0)
    for code in (-0.5, 0.25, 1.5, 4):
        slide.Set(Gf.Vec3d(code**2, 0, 1), code)
        turn.Set(Gf.Vec3f(20 * code, 0, 90 * code), code)
    UsdGeom.Xform(asset.stage.GetPrimAtPath("/set")).AddTranslateOp().Set(Gf.Vec3d(0, 0, 50))
    body = UsdGeom.Xform(asset.stage.GetPrimAtPath("/set/rig/body")).AddRotateYOp()
    body.Set(0, 0)
    body.Set(40, 3)
    return rig


def moving(frames: int = 5, fps: float = 60) -> MeshSequence:
    """Return frames of their own, at another rate than the file's."""
    points = np.random.default_rng(5).normal(size=(frames, 5, 3)).astype(np.float32)
    header = MeshSequence.from_arrays(points, np.array([[0, 1, 2]])).header
    return MeshSequence.from_header(header.with_times((3 + np.arange(frames)) / fps, fps), points)


def frames_over(asset: Asset, fps: float = 60) -> MeshSequence:
    own = moving(fps=fps)
    header = asset.read("/set/rig/body/walker").header.with_times(own.times, fps)
    return MeshSequence.from_header(header, own.points, -own.points)


def with_velocities(path: Path, prim: str | None = None) -> tuple[MeshSequence, FloatArray]:
    with open_usd(path, prim) as reader:
        speeds = reader.velocity_blocks(2)
        assert speeds is not None
        return join_blocks(reader.header, reader.blocks(2)), np.concatenate(list(speeds))


@pytest.mark.parametrize("fps", [25, 60, 24000 / 1001])
@pytest.mark.parametrize("options", [{}, {"clips": 2}])
def test_what_is_written_is_read(
    asset: Asset, rig: UsdGeom.Xform, path: Path, fps: float, options: dict[str, Any]
) -> None:
    written = frames_over(asset, fps)
    stage = save(path, written, **options)
    assert problems(stage) - problems(asset.stage) == set()
    got, velocities = with_velocities(path)
    np.testing.assert_allclose(got.times, written.times, rtol=1e-12)
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    np.testing.assert_allclose(velocities, -written.points, atol=1e-5)


def test_in_the_world_nothing_is_rounded(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    asset.rig.ClearXformOpOrder()
    UsdGeom.Xform(asset.stage.GetPrimAtPath("/set/rig/body")).ClearXformOpOrder()
    written = frames_over(asset)
    save(path, written)
    got, velocities = with_velocities(path)
    np.testing.assert_array_equal(got.points, written.points)
    np.testing.assert_array_equal(velocities, -written.points)


def test_parents_move_it_neither_between_frames_nor_beyond(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    written = frames_over(asset)
    stage, before = save(path, written), Usd.Stage.Open(str(asset.path))
    codes = written.times * 60
    for code in np.linspace(codes[0] - 5, codes[-1] + 5, 41).tolist():
        expected = [np.interp(code, codes, track) for track in written.points.reshape(5, -1).T]
        got = world_points(stage, "/set/rig/body/walker", code)
        np.testing.assert_allclose(got, np.reshape(expected, (5, 3)), atol=1e-5)
        lamp, known = (
            np.array(UsdGeom.Xformable(each.GetPrimAtPath("/set/rig/lamp")).ComputeLocalToWorldTransform(time))
            for each, time in ((stage, code), (before, code / 60 * 25))
        )
        np.testing.assert_allclose(lamp, known, atol=1e-12)


def test_a_layer_can_be_referenced_anywhere(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    written = frames_over(asset)
    save(path, written)
    shot = Usd.Stage.CreateInMemory()
    shot.SetTimeCodesPerSecond(60)
    hero = UsdGeom.Xform.Define(shot, "/hero")
    hero.GetPrim().GetReferences().AddReference(str(path))
    hero.ClearXformOpOrder()
    hero.AddTranslateOp(opSuffix="there").Set(Gf.Vec3d(7, 0, -50))
    hero.AddTranslateOp().Set(Gf.Vec3d(0, 0, 50))
    got = world_points(shot, "/hero/rig/body/walker", 5)
    np.testing.assert_allclose(got, written.points[2] + [7, 0, -50], atol=1e-5)


def test_what_carries_only_the_mesh_is_held(asset: Asset, path: Path) -> None:
    slide = asset.rig.AddTranslateOp()
    for code in range(3):
        slide.Set(Gf.Vec3d(code, 0, 0), code)
    before = asset.read()
    stage = save(path, before)
    (over,) = Sdf.Layer.FindOrOpen(str(path)).rootPrims
    assert list(over.properties.keys()) == ["xformOp:translate"]
    assert asset.rig.GetPrim().GetAttribute("xformOp:translate").Get(0) == Gf.Vec3d(0)
    np.testing.assert_allclose(world_points(stage, "/set/walker", 1.5), before.points[1:].mean(axis=0))
    assert load(path).frame_count == 3


def test_a_layer_over_a_layer(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    between = path.with_name("between.usdc")
    save(between, frames_over(asset, 30))
    own = moving()
    header = load(between).header.with_times(own.times, 60)
    save(path, MeshSequence.from_header(header, own.points))
    layer = Sdf.Layer.FindOrOpen(str(path))
    assert not layer.GetAttributeAtPath("/set/rig/body.xformOpOrder")  # the one below does it
    got = load(path)
    np.testing.assert_allclose(got.points, own.points, atol=1e-5)
    np.testing.assert_allclose(got.times, own.times)


def test_a_parent_that_moves_again_is_undone_again(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    between = path.with_name("between.usda")
    stage = save(between, frames_over(asset).with_points(moving().points + 1))
    over = UsdGeom.Xform(stage.GetPrimAtPath("/set/rig")).GetOrderedXformOps()[0]
    over.Set(Gf.Vec3d(0, 9, 0), 100)  # now it is another motion than was undone
    stage.Save()
    own = moving()
    header = load(between).header.with_times(own.times, 60)
    save(path, MeshSequence.from_header(header, own.points))
    got = load(path)
    np.testing.assert_allclose(got.points, own.points, atol=1e-5)
    assert got.frame_count == len(own.points)


def test_several_meshes_below_a_parent(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    layer = asset.stage.GetRootLayer()
    asset.stage.Save()
    Sdf.CopySpec(layer, "/set/rig/body", layer, "/set/rig/body2")
    before = asset.read("/")
    assert before.vertex_count == 10
    written = MeshSequence.from_header(before.header.with_times([0, 0.5, 2], 24), before.points[[3, 1, 2]])
    save(path, written)
    got = load(path)
    np.testing.assert_allclose(got.times, [0, 0.5, 2])
    np.testing.assert_allclose(got.points, written.points, atol=1e-4)


def test_a_character_below_a_root_that_moves(asset: Asset, path: Path) -> None:
    character(asset)
    UsdGeom.Camera.Define(asset.stage, "/set/rig/eye")
    slide = UsdGeom.Xformable(asset.stage.GetPrimAtPath("/set/rig")).AddTranslateOp()
    for code in range(4):
        slide.Set(Gf.Vec3d(0, code**2, 0), code)
    before = asset.read("/set/rig/body")
    stage = save(path, before.with_points(before.points + 1))
    assert problems(stage) - problems(asset.stage) == set()
    np.testing.assert_array_equal(load(path, "/set/rig/body").points, before.points + 1)
    box = UsdGeom.BBoxCache(2, ["default"]).ComputeWorldBound(stage.GetPrimAtPath("/set/rig"))
    np.testing.assert_allclose(
        np.array(box.ComputeAlignedRange().GetMax()), before.points[2].max(axis=0) + 1, atol=1e-4
    )


def test_instances_of_a_rig(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    asset.stage.Save()
    crowd = Usd.Stage.CreateNew(str(path.with_name("crowd.usda")))
    UsdGeom.SetStageUpAxis(crowd, "Z")
    UsdGeom.SetStageMetersPerUnit(crowd, 0.01)
    crowd.SetTimeCodesPerSecond(25)
    for name in ("one", "two"):
        prim = crowd.DefinePrim(f"/crowd/{name}")
        prim.GetReferences().AddReference("./asset.usda")
        prim.SetInstanceable(True)
    crowd.Save()
    before = load(path.with_name("crowd.usda"), "/crowd/two")
    with pytest.warns(MixseqWarning, match="instances no longer: /crowd/two$"):
        save(path, before.with_points(before.points + 1))
    got = load(path, "/crowd/two")
    np.testing.assert_allclose(got.points, before.points + 1, atol=1e-4)
    assert got.frame_count == before.frame_count
    np.testing.assert_array_equal(load(path, "/crowd/one").points, before.points)


def test_a_mesh_with_others_below_it_moves_on(asset: Asset, rig: UsdGeom.Xform, path: Path) -> None:
    UsdGeom.Sphere.Define(asset.stage, "/set/rig/body/walker/hat")
    written = frames_over(asset)
    with pytest.warns(MixseqWarning, match=r"have no velocities: /set/rig/body/walker; flatten keeps"):
        stage = save(path, written)
    for frame, time in enumerate(written.times):
        got = world_points(stage, "/set/rig/body/walker", time * 60)
        np.testing.assert_allclose(got, written.points[frame], atol=1e-5)


def test_a_parent_that_moves_by_a_spline(asset: Asset, path: Path) -> None:
    UsdGeom.Camera.Define(asset.stage, "/set/eye")
    before = asset.read()
    curve = Ts.Spline()
    for code in (1, 11):
        curve.SetKnot(Ts.Knot(time=code, value=float(code)))
    rig: Any = asset.rig  # splines are newer than the type stubs
    rig.AddTranslateXOp().GetAttr().SetSpline(curve)
    asset.stage.Save()
    with pytest.raises(OutputError, match=r"/set\.xformOp:translateX is a spline; bake it"):
        save(path, before)
