"""USD: stages as other tools make them, and assets that other tools accept."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils, Vt

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read

# Not in the type stubs yet.
Ts: Any = import_module("pxr.Ts")

CORNERS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)]


def make_stage(path: Path, up: str = "Z", rate: float = 25.0) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    stage.SetTimeCodesPerSecond(rate)
    return stage


def add_mesh(stage: Usd.Stage, path: str, codes: tuple[float, ...] = (1, 2, 3)) -> UsdGeom.Mesh:
    """Add a quad and a triangle whose points move by one unit along z per time code."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 1, 4, 2])
    if not codes:
        mesh.CreatePointsAttr([Gf.Vec3f(*corner) for corner in CORNERS])
    for code in codes:
        points = [Gf.Vec3f(*corner) + Gf.Vec3f(0, 0, code) for corner in CORNERS]
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray(points), code)
    return mesh


def normals(sequence: MeshSequence, frame: int = 0) -> Any:
    a, b, c = (sequence.points[frame][sequence.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "stage.usda"


def test_a_plain_mesh(path: Path) -> None:
    stage = make_stage(path)
    add_mesh(stage, "/root/walker")
    stage.Save()
    sequence = read(path)
    assert sequence.polygons.counts.tolist() == [4, 3]
    assert sequence.polygons.indices.tolist() == [0, 1, 2, 3, 1, 4, 2]
    np.testing.assert_array_equal(sequence.times, np.array([1, 2, 3]) / 25)
    assert (sequence.fps, sequence.up_axis, sequence.metres_per_unit) == (25, "Z", 0.01)
    assert sequence.name == "walker"
    assert sequence.points.dtype == np.float32
    np.testing.assert_array_equal(sequence.points[:, :, 2], [[1] * 5, [2] * 5, [3] * 5])


def test_an_animated_parent_is_baked(path: Path) -> None:
    stage = make_stage(path)
    parent = UsdGeom.Xform.Define(stage, "/rig")
    parent.AddTranslateOp().Set(Gf.Vec3d(0, 10, 0))
    turn = parent.AddRotateZOp()
    for code, degrees in ((2, 0.0), (2.5, 45.0), (4, 90.0)):
        turn.Set(degrees, code)
    UsdGeom.Scope.Define(stage, "/rig/geometry")
    mesh = add_mesh(stage, "/rig/geometry/mesh", (1, 3))
    mesh.AddScaleOp().Set(Gf.Vec3f(2, 2, 2))
    stage.Save()
    sequence = read(path)
    np.testing.assert_allclose(sequence.times * 25, [1, 2, 2.5, 3, 4])  # the samples of both
    heights = np.interp([1, 2, 2.5, 3, 4], [1, 3], [1, 3])  # points are interpolated, then held
    angles = np.radians(np.interp([1, 2, 2.5, 3, 4], [2, 2.5, 4], [0, 45, 90]))
    for frame, (height, angle) in enumerate(zip(heights, angles, strict=True)):
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        expected = 2 * np.add(CORNERS, (0, 0, height))
        expected[:, :2] = expected[:, :2] @ turned.T
        np.testing.assert_allclose(sequence.points[frame], np.add(expected, (0, 10, 0)), atol=1e-5)


def test_only_the_transform_moves(path: Path) -> None:
    stage = make_stage(path)
    mesh = add_mesh(stage, "/mesh", ())
    slide = mesh.AddTranslateOp()
    for code in (0, 5):
        slide.Set(Gf.Vec3d(code, 0, 0), code)
    stage.Save()
    sequence = read(path)
    np.testing.assert_array_equal(sequence.times, [0, 0.2])
    np.testing.assert_array_equal(sequence.points[1] - sequence.points[0], [[5, 0, 0]] * 5)


def test_reset_transform_stack_ends_the_chain(path: Path) -> None:
    stage = make_stage(path)
    slide = UsdGeom.Xform.Define(stage, "/rig").AddTranslateOp()
    for code in (0, 5):
        slide.Set(Gf.Vec3d(code, 0, 0), code)
    add_mesh(stage, "/rig/mesh", (1, 2)).SetResetXformStack(True)
    stage.Save()
    sequence = read(path)
    np.testing.assert_allclose(sequence.times * 25, [1, 2])
    np.testing.assert_array_equal(sequence.points[0], np.add(CORNERS, (0, 0, 1)))


@pytest.mark.parametrize(("codes", "time"), [((), 0.0), ((50,), 2.0)])
def test_without_animation_there_is_one_frame(path: Path, codes: tuple[float, ...], time: float) -> None:
    stage = make_stage(path)
    add_mesh(stage, "/mesh", codes)
    stage.Save()
    assert read(path).times.tolist() == [time]


def test_a_single_sample_of_a_transform_is_not_a_frame(path: Path) -> None:
    stage = make_stage(path)
    add_mesh(stage, "/mesh", (1, 2)).AddTranslateOp().Set(Gf.Vec3d(1, 0, 0), 100.0)
    stage.Save()
    sequence = read(path)
    np.testing.assert_allclose(sequence.times * 25, [1, 2])
    assert sequence.points[0, 0].tolist() == [1, 0, 1]


@pytest.mark.parametrize("left_handed", [False, True], ids=["right-handed", "left-handed"])
@pytest.mark.parametrize("mirrored", [False, True], ids=["unmirrored", "mirrored"])
def test_faces_are_counter_clockwise_whatever_the_handedness(path: Path, left_handed: bool, mirrored: bool) -> None:
    stage = make_stage(path)
    mesh = add_mesh(stage, "/mesh")
    if left_handed:
        mesh.CreateOrientationAttr(UsdGeom.Tokens.leftHanded)
    if mirrored:
        mesh.AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
    stage.Save()
    # Mirroring along x keeps what faces up facing up; listing the corners clockwise turns it down.
    up = normals(read(path))[:, 2]
    assert (up < 0).all() if left_handed else (up > 0).all()
    assert read(path).polygons.indices[[0, 4]].tolist() == [0, 1]  # first corners stay first


def test_a_transform_that_starts_to_mirror(path: Path) -> None:
    stage = make_stage(path)
    scale = add_mesh(stage, "/mesh").AddScaleOp()
    scale.Set(Gf.Vec3f(1, 1, 1), 1)
    scale.Set(Gf.Vec3f(-1, 1, 1), 3)
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"frame 3 \(time code 3\): the transform of /mesh mirrors"):
        read(path)


def test_a_mirrored_mesh_that_pops_up(path: Path) -> None:
    stage = make_stage(path)
    scale = add_mesh(stage, "/mesh").AddScaleOp()
    for code, value in ((1, 0.0), (2, -1.0), (3, -1.0)):
        scale.Set(Gf.Vec3f(value, abs(value), abs(value)), code)
    stage.Save()
    # In its first frame, a single point, there is no telling.
    assert (normals(read(path), 1)[:, 2] > 0).all()


def test_no_mesh(path: Path) -> None:
    stage = make_stage(path)
    UsdGeom.Camera.Define(stage, "/cameras/left")
    UsdGeom.Camera.Define(stage, "/cameras/right")
    UsdGeom.BasisCurves.Define(stage, "/hair")
    stage.Save()
    with pytest.raises(FormatError, match="no mesh; it has 2 Camera, 1 untyped, 1 BasisCurves"):
        read(path)


def test_changing_faces(path: Path) -> None:
    stage = make_stage(path)
    indices = add_mesh(stage, "/mesh").GetFaceVertexIndicesAttr()
    for code in (1, 2, 3):  # repeated, as Houdini does
        indices.Set([0, 1, 2, 3, 1, 4, 2], code)
    stage.Save()
    assert read(path).frame_count == 3
    indices.Set([0, 1, 2, 3, 4, 2, 1], 3)
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"/mesh: faceVertexIndices changes at time code 3;"):
        read(path)


def test_changing_number_of_points(path: Path) -> None:
    stage = make_stage(path)
    points = add_mesh(stage, "/mesh").GetPointsAttr()
    points.Set(Vt.Vec3fArray(6), 3)
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"frame 3 \(time code 3\): /mesh has 6 points, the first fr"):
        read(path)


def test_blocked_points(path: Path) -> None:
    stage = make_stage(path)
    add_mesh(stage, "/mesh").GetPointsAttr().Set(Sdf.ValueBlock(), 2)
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"frame 2 \(time code 2\): /mesh has no points"):
        read(path)


def test_faces_out_of_range_and_too_small(path: Path) -> None:
    stage = make_stage(path)
    mesh = add_mesh(stage, "/mesh")
    mesh.GetFaceVertexIndicesAttr().Set([0, 1, 2, 3, 1, 5, 2])
    stage.Save()
    with pytest.raises(
        InvalidSequenceError, match=r"stage\.usda: /mesh: face 1 uses vertex 5, but vertices are 0 to 4"
    ):
        read(path)
    mesh.GetFaceVertexCountsAttr().Set([5, 2])
    stage.Save()
    with pytest.raises(InvalidSequenceError, match="polygon 1 has 2 corners"):
        read(path)


def test_nan(path: Path) -> None:
    stage = make_stage(path)
    add_mesh(stage, "/mesh").GetPointsAttr().Set([Gf.Vec3f(0, 0, float("nan"))] * 5, 2)
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"stage\.usda: frame 2 \(index 1\): vertex 0 is"):
        read(path)


def test_splines_are_to_be_baked(path: Path) -> None:
    stage = make_stage(path)
    mesh: Any = add_mesh(stage, "/mesh")  # splines are newer than the type stubs
    slide = mesh.AddTranslateXOp()
    curve = Ts.Spline()
    for code in (1, 11):
        curve.SetKnot(Ts.Knot(time=code, value=float(code)))
    slide.GetAttr().SetSpline(curve)
    stage.Save()
    with pytest.raises(FormatError, match=r"/mesh\.xformOp:translateX is a spline; bake it"):
        read(path)


def test_references_are_followed_and_their_absence_is_told(path: Path, capfd: Any) -> None:
    asset = make_stage(path.with_name("asset.usdc"), rate=25)
    add_mesh(asset, "/asset/mesh")
    asset.SetDefaultPrim(asset.GetPrimAtPath("/asset"))
    asset.Save()
    stage = make_stage(path)
    stage.DefinePrim("/here").GetReferences().AddReference("./asset.usdc", layerOffset=Sdf.LayerOffset(10))
    stage.Save()
    np.testing.assert_allclose(read(path).times * 25, [11, 12, 13])
    stage.DefinePrim("/there").GetReferences().AddReference("./missing.usdc")
    stage.Save()
    capfd.readouterr()
    with pytest.warns(MixseqWarning, match=r"files that it refers to are missing or cannot be read: missing\.usdc$"):
        read(path)
    assert capfd.readouterr().err == ""


def test_links_are_not_followed_to_where_data_is_stored(path: Path, tmp_path: Path) -> None:
    asset = make_stage(path.with_name("asset.usda"))
    add_mesh(asset, "/asset/mesh")
    asset.SetDefaultPrim(asset.GetPrimAtPath("/asset"))
    asset.Save()
    stage = make_stage(path)
    stage.DefinePrim("/here").GetReferences().AddReference("./asset.usda")
    stage.Save()
    (tmp_path / "store").mkdir()
    for number, file in enumerate((path, path.with_name("asset.usda"))):  # as git-annex and DVC do
        file.rename(tmp_path / "store" / f"a1b2c3{number}")
        file.symlink_to(tmp_path / "store" / f"a1b2c3{number}")
    sequence = read(path)
    assert sequence.objects[0].path == "/here/mesh"
    assert sequence.surface.origin is not None
    assert sequence.surface.origin.path == str(path)


def test_unsaved_edits_of_the_process_are_not_read(path: Path) -> None:
    stage = make_stage(path)
    mesh = add_mesh(stage, "/mesh")
    stage.Save()
    mesh.GetPointsAttr().Set(Vt.Vec3fArray(5), 2)
    np.testing.assert_array_equal(read(path).points[1, :, 2], 2)


def test_usdz(path: Path) -> None:
    stage = make_stage(path.with_suffix(".usdc"))
    add_mesh(stage, "/mesh")
    stage.Save()
    UsdUtils.CreateNewUsdzPackage(str(path.with_suffix(".usdc")), str(path.with_suffix(".usdz")))
    assert read(path.with_suffix(".usdz")).frame_count == 3
