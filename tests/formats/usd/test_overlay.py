"""USD, writing: layers over other files."""

from __future__ import annotations

import shutil
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, UsdUtils, Vt

from mixseq.errors import MixseqWarning, OutputError
from mixseq.mesh.measures import corner_normals
from mixseq.sequence.sequence import MeshSequence
from tests.formats.usd_maker import (
    CORNERS,
    FACES,
    TOKENS,
    Asset,
    author_normals,
    character,
    lift,
    load,
    mesh_at,
    paint,
    points_at,
    problems,
    save,
    world_points,
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "out.usda"


def test_what_usd_takes_from_the_root_layer_only(asset: Asset, path: Path) -> None:
    asset.stage.Save()
    shot = Usd.Stage.CreateNew(str(path.with_name("shot.usda")))
    UsdGeom.SetStageUpAxis(shot, "Z")
    shot.SetTimeCodesPerSecond(1000)
    shot.SetFramesPerSecond(25)
    shot.SetStartTimeCode(-40)
    shot.SetEndTimeCode(4000)
    shot.SetMetadata("expressionVariables", {"ASSET": "asset"})
    shot.DefinePrim("/hero").GetReferences().AddReference('`"./${ASSET}.usda"`')
    shot.Save()
    before = load(path.with_name("shot.usda"))
    stage = save(path, before.with_points(before.points + 1))
    np.testing.assert_array_equal(points_at(stage, "/hero/walker", 2), lift()[2] + 1)
    assert not Sdf.Layer.FindOrOpen(str(path)).HasDefaultPrim()
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (25, 25)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-1, 100)
    later = MeshSequence.from_header(before.header.with_times([0, 2, 5], 50), before.points)
    stage = save(path, later)
    assert (stage.GetFramesPerSecond(), stage.GetTimeCodesPerSecond()) == (50, 50)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (-2, 250)


def test_everything_else_of_the_file_stays(asset: Asset, path: Path) -> None:
    paint(asset)
    asset.path.with_name("wool.png").touch()
    UsdGeom.Camera.Define(asset.stage, "/set/camera").AddTranslateOp().Set(Gf.Vec3d(0, 0, 0), 0)
    slide = UsdGeom.Camera(asset.stage.GetPrimAtPath("/set/camera")).GetOrderedXformOps()[0]
    slide.Set(Gf.Vec3d(50, 0, 0), 50)
    before = asset.read()
    header = before.header.with_times(np.array([0, 0.5, 1.0]), 60)
    stage = save(path, MeshSequence.from_header(header, 2 * before.points))
    assert problems(stage) == set()
    (over,) = Sdf.Layer.FindOrOpen(str(path)).GetPrimAtPath("/set").nameChildren
    assert (over.specifier, sorted(over.properties.keys())) == (Sdf.SpecifierOver, ["extent", "points"])
    assert stage.GetRootLayer().subLayerPaths == ["./asset.usda"]
    assert stage.GetDefaultPrim().GetPath() == "/set"
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (60, 0, 60)
    mesh = mesh_at(stage, "/set/walker")
    assert mesh.GetPointsAttr().GetTimeSamples() == mesh.GetExtentAttr().GetTimeSamples() == [0, 30, 60]
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 30), 2 * lift()[1])
    material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
    assert str(material.GetPath()) == "/set/looks/wool"
    # The camera is at its time code 25, of 50, after one second of either file.
    camera = UsdGeom.Xformable(stage.GetPrimAtPath("/set/camera"))
    assert camera.ComputeLocalToWorldTransform(60).ExtractTranslation()[0] == pytest.approx(25)
    got = load(path)
    np.testing.assert_array_equal(got.points, 2 * before.points)
    np.testing.assert_allclose(got.times, header.times)


def test_a_layer_and_its_origin_can_move_together(asset: Asset, tmp_path: Path) -> None:
    written = asset.read()
    (tmp_path / "Läufe [1]").mkdir()
    save(tmp_path / "Läufe [1]" / "größer@.usda", written)
    shutil.copytree(tmp_path, tmp_path.parent / "elsewhere" / "deeper")
    shutil.rmtree(tmp_path)
    moved = load(tmp_path.parent / "elsewhere" / "deeper" / "Läufe [1]" / "größer@.usda")
    np.testing.assert_array_equal(moved.points, written.points)


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_points_are_in_the_space_of_their_prim(asset: Asset, path: Path, left_handed: bool, mirrored: bool) -> None:
    turn = asset.rig.AddRotateZOp()
    for code, degrees in ((0, 0.0), (2, 90.0)):
        turn.Set(degrees, code)
    asset.mesh.AddTranslateOp().Set(Gf.Vec3d(0, 0, 10))
    asset.mesh.AddScaleOp().Set(Gf.Vec3f(-2 if mirrored else 2, 1, 1))
    asset.mesh.CreateOrientationAttr(TOKENS.leftHanded if left_handed else TOKENS.rightHanded)
    before = asset.read()
    written = before.with_points(before.points[::-1].copy())
    stage = save(path, written)
    assert problems(stage) == set()
    for frame, code in enumerate((before.times * 25).tolist()):
        np.testing.assert_allclose(world_points(stage, "/set/walker", code), written.points[frame], atol=1e-5)
    got = load(path)
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    assert got.polygons.same_as(before.polygons)
    mesh = mesh_at(stage, "/set/walker")
    extent, own = np.array(mesh.GetExtentAttr().Get(1)), points_at(stage, "/set/walker", 1)
    np.testing.assert_array_equal(extent, [own.min(axis=0), own.max(axis=0)])


def test_a_transform_without_inverse(asset: Asset, path: Path) -> None:
    UsdGeom.Xform.Define(asset.stage, "/set/other")
    before = asset.read()
    scale = asset.rig.AddScaleOp()
    scale.Set(Gf.Vec3f(1, 1, 1), 0)
    scale.Set(Gf.Vec3f(1, 1, 0), 2)
    asset.stage.Save()
    with pytest.raises(OutputError, match=r"transform of /set/walker is singular at 0\.08 s.*flatten=True"):
        save(path, before)
    assert not path.exists()
    save(path, before, flatten=True)
    np.testing.assert_array_equal(load(path).points, before.points)


def test_a_transform_without_inverse_before_the_first_frame(asset: Asset, path: Path) -> None:
    scale = asset.mesh.AddScaleOp()
    for code, value in ((0, 0.0), (1, -2.0), (2, -2.0)):
        scale.Set(Gf.Vec3f(value, 2, 2), code)
    before = asset.read()
    cut = MeshSequence.from_header(before.header.with_times(before.times[1:]), before.points[1:] + 1)
    stage = save(path, cut)
    np.testing.assert_allclose(world_points(stage, "/set/walker", 2), cut.points[-1])


def test_meshes_without_points_or_faces(asset: Asset, path: Path) -> None:
    for name, points in (("nothing", 0), ("dots", 5)):
        mesh = UsdGeom.Mesh.Define(asset.stage, f"/set/rig/{name}")
        mesh.CreateSubdivisionSchemeAttr("none")
        mesh.CreatePointsAttr([(1, 1, 1)] * points)
        mesh.CreateFaceVertexCountsAttr([])
        mesh.CreateFaceVertexIndicesAttr([])
    UsdSkel.Root.Define(asset.stage, "/set/rig")
    with pytest.warns(MixseqWarning, match="are left out: /set/rig/nothing has no points$"):
        before = asset.read("/")
    assert [each.vertex_count for each in before.objects] == [5, 5]
    for options in ({}, {"flatten": True}):
        save(path, before.with_points(before.points + 1), **options)
        with nullcontext() if options else pytest.warns(MixseqWarning, match="nothing has no points"):
            got = load(path, "/")
        np.testing.assert_array_equal(got.points, before.points + 1)
        assert [each.vertex_count for each in got.objects] == [5, 5]


def test_several_meshes_go_back_to_their_prims(asset: Asset, path: Path) -> None:
    hat = UsdGeom.Mesh.Define(asset.stage, "/set/hat")
    hat.AddTranslateOp().Set(Gf.Vec3d(0, 0, 3))
    hat.CreateSubdivisionSchemeAttr("none")
    hat.CreateFaceVertexCountsAttr([3])
    hat.CreateFaceVertexIndicesAttr([0, 1, 2])
    for frame, points in enumerate(lift()):
        hat.CreatePointsAttr().Set(Vt.Vec3fArrayFromBuffer(points[:3]), frame)
    before = asset.read("/")
    assert before.vertex_count == 8
    stage = save(path, before.with_points(before.points + 1))
    np.testing.assert_allclose(world_points(stage, "/set/walker", 2), 1 + lift()[2])
    np.testing.assert_allclose(world_points(stage, "/set/hat", 2), 1 + lift()[2, :3] + [0, 0, 3])


def test_velocities(asset: Asset, path: Path) -> None:
    turn = asset.rig.AddRotateZOp()
    turn.Set(90.0)
    before = asset.read()
    speeds = np.zeros_like(before.points)
    speeds[..., 1] = 7
    header = before.header
    stage = save(path, MeshSequence.from_header(header, before.points, speeds))
    got = mesh_at(stage, "/set/walker").GetVelocitiesAttr()
    np.testing.assert_allclose(got.Get(1), [[7, 0, 0]] * 5, atol=1e-6)
    turn.Set(0.0, 0)
    turn.Set(90.0, 2)
    asset.mesh.SetResetXformStack(True)
    asset.stage.Save()
    stage = save(path, MeshSequence.from_header(header, before.points, speeds))
    np.testing.assert_array_equal(mesh_at(stage, "/set/walker").GetVelocitiesAttr().Get(1), [[0, 7, 0]] * 5)


def test_what_belongs_to_the_old_points_is_blocked(asset: Asset, path: Path) -> None:
    for code in range(3):
        asset.mesh.CreateVelocitiesAttr().Set([(1, 0, 0)] * 5, code)
    asset.mesh.CreateAccelerationsAttr([(1, 0, 0)] * 5)
    UsdGeom.ModelAPI.Apply(asset.rig.GetPrim()).SetExtentsHint([(0, 0, 0), (1, 1, 1)])
    stage = save(path, asset.read())
    mesh = mesh_at(stage, "/set/walker")
    assert mesh.GetVelocitiesAttr().Get(1) is None and mesh.GetAccelerationsAttr().Get(1) is None
    assert UsdGeom.ModelAPI(stage.GetDefaultPrim()).GetExtentsHint() in (None, Vt.Vec3fArray())
    box = UsdGeom.BBoxCache(2, ["default"], useExtentsHint=True).ComputeWorldBound(stage.GetDefaultPrim())
    assert box.ComputeAlignedRange().GetMax() == Gf.Vec3d(2, 1, 4)


@pytest.mark.parametrize("where", ["normals", "primvars:normals"])
@pytest.mark.parametrize("interpolation", ["uniform", "vertex", "faceVarying", "constant"])
@pytest.mark.parametrize("left_handed", [False, True])
def test_normals_are_made_anew(asset: Asset, path: Path, where: str, interpolation: str, left_handed: bool) -> None:
    asset.rig.AddRotateYOp().Set(90.0)
    asset.mesh.AddScaleOp().Set(Gf.Vec3f(1, 1, 2))
    if left_handed:
        asset.mesh.CreateOrientationAttr(TOKENS.leftHanded)
    author_normals(asset.mesh, where, interpolation)
    stage = save(path, asset.read())
    assert problems(stage) == set()
    mesh = mesh_at(stage, "/set/walker")
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if where == "normals":
        got, kind = np.array(mesh.GetNormalsAttr().Get(2)), mesh.GetNormalsInterpolation()
        assert not primvar.HasAuthoredValue()
    else:
        got, kind = np.array(primvar.ComputeFlattened(2)), primvar.GetInterpolation()
        assert not primvar.IsIndexed()
    kept = "vertex" if interpolation == "constant" else interpolation
    assert kind == kept
    groups = {
        "uniform": np.repeat([0, 1], FACES.counts),
        "vertex": FACES.indices,
        # Normals that are the same on all faces of a vertex share one.
        "faceVarying": FACES.indices if where == "normals" else np.arange(7),
    }[kept]
    scaled = np.array([points_at(stage, "/set/walker", 2)])
    expected = corner_normals(scaled, FACES, groups)[0] * (-1 if left_handed else 1)
    # Averages of normals are not those of the scaled mesh, but of the mesh in the world.
    world = corner_normals(scaled * [1, 1, 2], FACES, groups)[0] * [1, 1, 2] * (-1 if left_handed else 1)
    expected = world / np.linalg.norm(world, axis=1, keepdims=True)
    if kept == "faceVarying":
        expected = expected[groups]
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_normals_of_subdivided_meshes_do_not_count(asset: Asset, path: Path) -> None:
    author_normals(asset.mesh, "normals", "vertex")
    asset.mesh.CreateSubdivisionSchemeAttr("catmullClark")
    save(path, asset.read())
    assert not Sdf.Layer.FindOrOpen(str(path)).GetAttributeAtPath("/set/walker.normals")


def bake(stage: Usd.Stage) -> None:
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/set/rig")), Gf.Interval(0, 2))


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_characters_are_not_moved_twice(asset: Asset, path: Path, scale: float) -> None:
    character(asset, scale)
    asset.rig.AddTranslateOp().Set(Gf.Vec3d(100, 0, 0))
    before = asset.read("/set/rig/body")
    # The blend shape comes before the bind transform, which may mirror.
    wide = [CORNERS[:3] + np.array([2.5 * code, 0, 0]) for code in range(3)]
    expected = [wide[code] * np.array([scale, 1, 1]) + np.array([100, 0, code]) for code in range(3)]
    np.testing.assert_allclose(before.points, expected, atol=1e-5)
    written = before.with_points(before.points + 1)
    stage = save(path, written)
    assert problems(stage) - problems(asset.stage) == set()
    prim = stage.GetPrimAtPath("/set/rig/body")
    cache, root = UsdSkel.Cache(), UsdSkel.Root(stage.GetPrimAtPath("/set/rig"))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    query = cache.GetSkinningQuery(prim)
    assert not (query and (query.HasJointInfluences() or query.HasBlendShapes()))
    assert cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate) == []
    np.testing.assert_allclose(world_points(stage, "/set/rig/body", 2), written.points[2], atol=1e-5)
    got = load(path, "/set/rig/body")  # without a warning
    np.testing.assert_allclose(got.points, written.points, atol=1e-5)
    assert got.polygons.same_as(before.polygons)  # faces point outwards, also if the bind transform mirrors
    # USD takes the bounds of what is below a skeleton's root from the root.
    box = UsdGeom.BBoxCache(2, ["default"]).ComputeWorldBound(root.GetPrim()).ComputeAlignedRange()
    np.testing.assert_allclose(np.array(box.GetMin()), written.points[2].min(axis=0), atol=1e-4)
    np.testing.assert_allclose(np.array(box.GetMax()), written.points[2].max(axis=0), atol=1e-4)
    bake(stage)
    np.testing.assert_allclose(world_points(stage, "/set/rig/body", 2), written.points[2], atol=1e-5)


@pytest.mark.parametrize("applied", [False, True])
@pytest.mark.parametrize("options", [{}, {"clips": 2}])
def test_a_binding_above_the_mesh_is_undone(asset: Asset, path: Path, applied: bool, options: dict[str, Any]) -> None:
    character(asset)
    group = UsdGeom.Xform.Define(asset.stage, "/set/rig/props").GetPrim()
    binding = UsdSkel.BindingAPI.Apply(group)
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    asset.stage.Save()
    Sdf.CopySpec(asset.stage.GetRootLayer(), "/set/walker", asset.stage.GetRootLayer(), "/set/rig/props/glove")
    glove = asset.stage.GetPrimAtPath("/set/rig/props/glove")
    if applied:
        UsdSkel.BindingAPI.Apply(glove)
    before = asset.read("/set/rig/props/glove")
    np.testing.assert_allclose(before.points, lift() + np.arange(3)[:, None, None] * [0, 0, 1])
    save(path, before, **options)
    np.testing.assert_allclose(load(path, "/set/rig/props/glove").points, before.points)


def test_the_bounds_of_a_skeleton_contain_its_other_meshes(asset: Asset, path: Path) -> None:
    body = character(asset)
    hat = UsdGeom.Mesh.Define(asset.stage, "/set/rig/hat")
    hat.CreatePointsAttr(body.GetPointsAttr().Get())
    UsdGeom.Boundable(asset.stage.GetPrimAtPath("/set/rig")).CreateExtentAttr([(-9, -9, -9), (0, 0, 0)])
    before = asset.read("/set/rig/body")
    stage = save(path, before.with_points(before.points + 50))
    extent = UsdGeom.Boundable(stage.GetPrimAtPath("/set/rig")).GetExtentAttr().Get(0)
    np.testing.assert_allclose(extent, [(-9, -9, -9), (51, 51, 50)])


def test_instances_become_prims(tmp_path: Path, path: Path) -> None:
    Asset(tmp_path / "asset.usda").stage.Save()
    crowd = Usd.Stage.CreateNew(str(tmp_path / "crowd.usda"))
    UsdGeom.SetStageUpAxis(crowd, "Z")
    UsdGeom.SetStageMetersPerUnit(crowd, 0.01)
    crowd.SetTimeCodesPerSecond(25)
    for place, name in enumerate(("one", "two")):
        prim = UsdGeom.Xform.Define(crowd, f"/crowd/{name}")
        prim.GetPrim().GetReferences().AddReference("./asset.usda")
        prim.GetPrim().SetInstanceable(True)
        prim.AddTranslateOp().Set(Gf.Vec3d(0, 10 * place, 0))
    crowd.SetDefaultPrim(crowd.GetPrimAtPath("/crowd"))
    crowd.Save()
    before = load(tmp_path / "crowd.usda", "/crowd/two")
    with pytest.warns(MixseqWarning, match="instances with moving meshes are instances no longer: /crowd/two"):
        stage = save(path, before.with_points(before.points + 1))
    assert problems(stage) == set()
    np.testing.assert_array_equal(world_points(stage, "/crowd/two/walker", 2), lift()[2] + [1, 11, 1])
    np.testing.assert_array_equal(world_points(stage, "/crowd/one/walker", 2), lift()[2])


@pytest.mark.parametrize("options", [{}, {"clips": 2}])
@pytest.mark.parametrize("listed", [False, True])
def test_value_clips_of_the_origin_are_weaker(asset: Asset, path: Path, options: dict[str, Any], listed: bool) -> None:
    asset.stage.Save()
    clip = Usd.Stage.CreateNew(str(asset.path.with_name("clip.usda")))
    mesh = UsdGeom.Mesh(clip.OverridePrim("/set/walker"))
    for code in range(3):
        mesh.CreatePointsAttr().Set([(code, 0, 0)] * 5, code)
        mesh.CreateVelocitiesAttr().Set([(9, 0, 0)] * 5, code)
        mesh.CreateDisplayColorAttr().Set([(code, 0, 0)], code)
    clip.Save()
    asset.mesh.GetPointsAttr().Clear()
    clips = Usd.ClipsAPI(asset.mesh)
    clips.SetClipAssetPaths([Sdf.AssetPath("./clip.usda")])
    clips.SetClipPrimPath("/set/walker")
    clips.SetClipActive([(0, 0)])
    if listed:
        clips.SetClipSets(Sdf.StringListOp.CreateExplicit(["default"]))
    before = asset.read()
    assert before.points[2, 0].tolist() == [2, 0, 0]
    stage = save(path, before.with_points(before.points + 1), **options)
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 2), [[3, 1, 1]] * 5)
    walker = mesh_at(stage, "/set/walker")
    assert walker.GetVelocitiesAttr().Get(1) is None
    assert walker.GetDisplayColorAttr().Get(1)[0] == Gf.Vec3f(1, 0, 0)  # what else they have, stays


def test_a_usdz_file_can_be_below(asset: Asset, path: Path, tmp_path: Path) -> None:
    (tmp_path / "wool.png").write_bytes(b"a picture")
    paint(asset)
    before = asset.read()
    UsdUtils.CreateNewUsdzPackage(str(asset.path), str(tmp_path / "asset.usdz"))
    packed = load(tmp_path / "asset.usdz")
    stage = save(path, packed.with_points(before.points + 1))
    np.testing.assert_array_equal(points_at(stage, "/set/walker", 2), before.points[2] + 1)
    file = stage.GetPrimAtPath("/set/looks/wool/picture").GetAttribute("inputs:file").Get()
    assert file.resolvedPath.endswith("asset.usdz[wool.png]")


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name", ["CesiumMan.usdz", "RiggedFigure.usdz", "RiggedSimple.usdz", "q_man_run_blender50.usdc"]
)
@pytest.mark.parametrize("options", [{}, {"clips": 10}, {"flatten": True}])
def test_real_files(data: Path, tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    file = data / "usd" / name
    before = load(file)
    written = before.with_points(before.points * np.float32(1.5))
    stage, origin = save(tmp_path / "out.usdc", written, **options), Usd.Stage.Open(str(file))
    assert problems(stage) - problems(origin) == set()
    got = load(tmp_path / "out.usdc")
    np.testing.assert_allclose(got.points, written.points, atol=1e-6 * written.diagonal)
    np.testing.assert_array_equal(got.times, before.times)
    assert got.polygons.same_as(before.polygons)
    assert [each.polygons.tolist() for each in got.surface.face_sets] == [
        each.polygons.tolist() for each in before.surface.face_sets
    ]
    for prim in stage.Traverse():
        if mesh := UsdGeom.Mesh(prim):
            material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
            assert bool(material) == bool(before.surface.face_sets)
            if material:
                assert material.ComputeSurfaceSource()[0]
    assert {each.typeName for each in stage.GetRootLayer().rootPrims} <= {"", "Xform"}
