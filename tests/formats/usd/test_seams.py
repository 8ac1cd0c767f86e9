"""Points of a skinned mesh that are one vertex: read as one, and written to all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import OutputError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write
from mixseq_io.usd.motion import VERTICES_ATTRIBUTE
from tests.formats.conftest import lossy

# Two triangles of a square, with points of their own along the diagonal from (0, 0) to (1, 1).
POINTS = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 0)]
WELDED = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def save(path: Path, change: Callable[[UsdGeom.Mesh], object] = lambda mesh: None) -> Path:
    """Save the square on a skeleton of two joints, of which the second rises by one."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    stage.SetTimeCodesPerSecond(24)
    UsdSkel.Root.Define(stage, "/root")
    skeleton = UsdSkel.Skeleton.Define(stage, "/root/skeleton")
    skeleton.CreateJointsAttr(["still", "rising"])
    for attribute in (skeleton.CreateBindTransformsAttr(), skeleton.CreateRestTransformsAttr()):
        attribute.Set(Vt.Matrix4dArray([Gf.Matrix4d(1.0)] * 2))
    animation = UsdSkel.Animation.Define(stage, "/root/animation")
    animation.CreateJointsAttr(["still", "rising"])
    animation.CreateBlendShapesAttr(["bulge"])
    animation.CreateRotationsAttr([Gf.Quatf(1.0)] * 2)
    animation.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * 2)
    for code in (0, 1):
        animation.CreateTranslationsAttr().Set([(0, 0, 0), (0, code, 0)], code)
        animation.CreateBlendShapeWeightsAttr().Set([float(code)], code)
    mesh = UsdGeom.Mesh.Define(stage, "/root/mesh")
    mesh.CreateSubdivisionSchemeAttr("none")
    mesh.CreatePointsAttr(POINTS)
    mesh.CreateFaceVertexCountsAttr([3, 3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 4, 5])
    mesh.SetNormalsInterpolation("vertex")
    mesh.CreateNormalsAttr([(0, 0, 1)] * 6)
    uvs = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    uvs.Set([(number / 8, 0) for number in range(6)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/root/skeleton"])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/root/animation"])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 6)
    binding.CreateJointWeightsPrimvar(False, 2).Set([0.5, 0.5] * 6)
    change(mesh)
    stage.Save()
    return path


def test_points_that_move_as_one_are_one(tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda"))
    assert square.polygons.indices.tolist() == [0, 1, 2, 0, 2, 3]
    assert square.points[0].tolist() == [list(map(float, point)) for point in WELDED]
    np.testing.assert_array_equal(square.points[1], square.points[0] + [0, 0.5, 0])
    assert square.surface.uvs is not None
    assert square.surface.uvs.at_corners[:, 0].tolist() == [0, 1 / 8, 2 / 8, 3 / 8, 4 / 8, 5 / 8]
    assert square.surface.hard_edges is None


def test_split_normals_are_hard_edges(tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda", folded))
    assert square.vertex_count == 4
    assert square.surface.hard_edges is not None
    assert len(set(square.surface.hard_edges.tolist())) == 6


def heavier(mesh: UsdGeom.Mesh) -> None:
    weights = UsdSkel.BindingAPI(mesh).GetJointWeightsPrimvar()
    weights.Set([0.5, 0.5] * 3 + [0.25, 0.75] * 3)


def bulging(mesh: UsdGeom.Mesh) -> None:
    shape = UsdSkel.BlendShape.Define(mesh.GetPrim().GetStage(), "/root/mesh/bulge")
    shape.CreateOffsetsAttr([(0, 0, 1), (0, 0, 1)])
    shape.CreatePointIndicesAttr([3, 5])
    binding = UsdSkel.BindingAPI(mesh)
    binding.CreateBlendShapesAttr(["bulge"])
    binding.CreateBlendShapeTargetsRel().SetTargets(["/root/mesh/bulge"])


def sampled(mesh: UsdGeom.Mesh) -> None:
    for code in (0, 1):
        mesh.GetPointsAttr().Set(POINTS, code)


def unbound(mesh: UsdGeom.Mesh) -> None:
    for attribute in mesh.GetPrim().GetAuthoredAttributes():
        if attribute.GetName().startswith("primvars:skel"):
            mesh.GetPrim().RemoveProperty(attribute.GetName())


@pytest.mark.parametrize(
    ("change", "count"),
    [(heavier, 6), (bulging, 5), (sampled, 6), (unbound, 6)],
    ids=["weights", "shapes", "samples", "no skeleton"],
)
def test_points_that_may_part_stay_apart(change: Callable[[UsdGeom.Mesh], None], count: int, tmp_path: Path) -> None:
    """The bulge moves points 3 and 5: only point 4 still moves as point 2 does."""
    with lossy():
        assert read(save(tmp_path / "square.usda", change)).vertex_count == count


def lifted(square: MeshSequence) -> MeshSequence:
    return square.with_points(square.points + np.arange(4, dtype=np.float32)[:, None])


@pytest.mark.parametrize("options", [{}, {"clips": 1}], ids=["layer", "clips"])
def test_a_layer_moves_all_points_of_a_vertex(options: dict[str, Any], tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda"))
    write(tmp_path / "new.usda", lifted(square), **options)
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/root/mesh"))
    assert mesh.GetPrim().GetAttribute(VERTICES_ATTRIBUTE).Get() == [0, 1, 2, 0, 2, 3]
    for code in (0, 1):
        points = np.array(mesh.GetPointsAttr().Get(code))
        np.testing.assert_array_equal(points, lifted(square).points[code][[0, 1, 2, 0, 2, 3]])
    assert len(mesh.GetNormalsAttr().Get(0)) == 6
    again = read(tmp_path / "new.usda")
    assert again.polygons.same_as(square.polygons)
    np.testing.assert_array_equal(again.points, lifted(square).points)


def folded(mesh: UsdGeom.Mesh) -> None:
    mesh.GetNormalsAttr().Set([(0, 0, 1)] * 3 + [(0, 1, 0)] * 3)


def test_normals_of_a_layer_keep_hard_edges(tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda", folded))
    bent = square.points.copy()
    bent[:, 3] = 0, 0, 1  # the second triangle now stands on the diagonal
    write(tmp_path / "new.usda", square.with_points(bent))
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/root/mesh"))
    normals = np.array(mesh.GetNormalsAttr().Get(1))
    np.testing.assert_allclose(normals[:3], [(0, 0, 1)] * 3, atol=1e-6)
    standing = np.cross(bent[1, 2] - bent[1, 0], bent[1, 3] - bent[1, 0])
    np.testing.assert_allclose(normals[3:], [standing / np.linalg.norm(standing)] * 3, atol=1e-6)


def test_a_layer_of_a_layer(tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda"))
    write(tmp_path / "one.usda", lifted(square))
    one = read(tmp_path / "one.usda")
    write(tmp_path / "two.usda", lifted(one))
    np.testing.assert_array_equal(read(tmp_path / "two.usda").points, lifted(lifted(square)).points)


def test_a_sequence_with_a_vertex_for_every_point_fits_too(tmp_path: Path) -> None:
    save(tmp_path / "square.usda")
    points = np.array([POINTS, POINTS], dtype=np.float32)
    points[1, 3:] += 1  # torn along the seam, as it likes
    torn = MeshSequence.from_arrays(points, Polygons(np.array([3, 3]), np.arange(6)))
    write(tmp_path / "torn.usda", torn, onto=tmp_path / "square.usda")
    np.testing.assert_array_equal(read(tmp_path / "torn.usda").points, points)


def test_what_a_layer_says_of_other_points_does_not_count(tmp_path: Path) -> None:
    square = read(save(tmp_path / "square.usda"))
    write(tmp_path / "new.usda", lifted(square))
    stage = Usd.Stage.Open(str(tmp_path / "new.usda"))
    stage.GetPrimAtPath("/root/mesh").GetAttribute(VERTICES_ATTRIBUTE).Set([0, 1])
    stage.Save()
    assert read(tmp_path / "new.usda").vertex_count == 6


def test_an_original_that_does_not_fit_is_not_replaced(tmp_path: Path) -> None:
    """Without its objects the sequence would be written alone, but not over the file that it came from."""
    path = save(tmp_path / "square.usda")
    square, before = read(path), path.read_bytes()
    other = replace(
        square, polygons=Polygons(np.array([4]), np.array([0, 1, 2, 3])), surface=Surface(origin=square.surface.origin)
    )
    with pytest.raises(OutputError, match="is the original, or a layer that it uses, and would be lost"):
        write(path, other)
    assert path.read_bytes() == before
