"""USD, reading: skeletons and blend shapes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, UsdUtils, Vt

from mixseq.errors import InvalidSequenceError, MixseqWarning
from mixseq_io.usd.motion import Weld
from tests.formats.usd.stage_maker import CORNERS, INDICES, Make, baked, lower, paths, read, saved


class TestCharacters:
    def test_linear_blend_skinning(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        sequence = saved(stage)
        assert paths(sequence) == ["/arm/skin"]
        assert (sequence.times * 24).tolist() == [0, 1, 2, 3, 4]
        second = np.array([0, 0, 0.5, 0.5, 1])[:, None]
        for code in range(5):
            skinned = (1 - second) * CORNERS + second * lower(CORNERS, code)
            np.testing.assert_allclose(sequence.points[code], 2 * skinned + [5, 0, 0], atol=2e-6)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_dual_quaternions(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        linear = saved(stage).points
        UsdSkel.BindingAPI(arm).CreateSkinningMethodAttr("dualQuaternion")
        sequence = saved(stage)
        assert np.abs(sequence.points - linear).max() > 0.1
        # Between two joints of equal weight, rotated by 0 and 120 degrees, a rigid motion by 60 degrees.
        edge = sequence.points[4, 3] - sequence.points[4, 2]
        np.testing.assert_allclose(edge, 2 * np.array([-np.cos(np.pi / 3), -np.sin(np.pi / 3), 0]), atol=2e-6)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_inherited_rigid_bindings(self, stage: Usd.Stage, arm: UsdGeom.Mesh, make: Make) -> None:
        group = UsdGeom.Xform.Define(stage, "/arm/props").GetPrim()
        binding = UsdSkel.BindingAPI.Apply(group)
        binding.CreateSkeletonRel().SetTargets(["/arm/bones"])
        binding.CreateJointIndicesPrimvar(True, 1).Set([0])
        binding.CreateJointWeightsPrimvar(True, 1).Set([1])
        binding.CreateJointsAttr(["upper/lower"])  # the only joint of its own order
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetTranslate((0, 0, 3)))
        make("/arm/props/glove")
        sequence = saved(stage, "glove")
        for code in range(5):
            expected = 2 * lower(np.add(CORNERS, [0, 0, 3]), code) + [5, 0, 0]
            np.testing.assert_allclose(sequence.points[code], expected, atol=2e-6)
        assert paths(saved(stage)) == ["/arm/skin", "/arm/props/glove"]

    def test_blend_shapes_with_inbetweens(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        smile = UsdSkel.BlendShape.Define(stage, "/arm/skin/smile")
        smile.CreateOffsetsAttr([Gf.Vec3f(0, 0, 4)])
        smile.CreatePointIndicesAttr([1])
        smile.CreateInbetween("half").SetOffsets([Gf.Vec3f(0, 0, 10)])
        smile.GetInbetween("half").SetWeight(0.5)
        blink = UsdSkel.BlendShape.Define(stage, "/arm/skin/blink")
        blink.CreateOffsetsAttr([Gf.Vec3f(1, 0, 0)] * 5)
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["blink", "smile"])
        binding.CreateBlendShapeTargetsRel().SetTargets([blink.GetPath(), smile.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["smile"])  # nobody blinks
        for code, weight in ((0, 0.0), (1, 0.25), (2, 0.5), (3, 0.75), (4.5, 1.0)):
            animation.CreateBlendShapeWeightsAttr().Set([weight], code)
        sequence = saved(stage)
        assert (sequence.times * 24).tolist() == [0, 1, 2, 3, 4, 4.5]
        # Vertex 1 follows the first joint alone; its height is piecewise linear in the weight.
        weights = np.interp([0, 1, 2, 3, 4, 4.5], [0, 1, 2, 3, 4.5], [0, 0.25, 0.5, 0.75, 1])
        heights = 2 * np.interp(weights, [0, 0.5, 1], [0, 10, 4])
        np.testing.assert_allclose(sequence.points[:, 1, 2], heights, atol=1e-5)
        np.testing.assert_allclose(baked(stage, "/arm/skin", sequence.times), sequence.points, atol=1e-5)

    def test_blend_shapes_alone_leave_the_mesh_where_it_is(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        for name in ("skel:jointIndices", "skel:jointWeights"):
            UsdGeom.PrimvarsAPI(arm).RemovePrimvar(name)
        shape = UsdSkel.BlendShape.Define(stage, "/arm/skin/up")
        shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1)] * 5)
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["up"])
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["up"])
        for code in (0, 10):
            animation.CreateBlendShapeWeightsAttr().Set([float(code)], code)
        sequence = saved(stage)
        assert (sequence.times * 24).tolist() == [0, 10]
        np.testing.assert_allclose(sequence.points[1], np.add(CORNERS, [105, 0, 10]))

    def test_a_mirrored_skeleton(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        assert saved(stage).polygons.indices.tolist() == INDICES
        UsdGeom.Xformable(stage.GetPrimAtPath("/arm")).AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
        assert saved(stage).polygons.indices.tolist() == [0, 3, 2, 1, 1, 2, 4]

    def test_the_root_moves_too(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        move = UsdGeom.Xformable(stage.GetPrimAtPath("/arm")).GetOrderedXformOps()[0]
        for code in (0, 4.5):
            move.Set(Gf.Vec3d(5, 0, code), code)
        sequence = saved(stage)
        np.testing.assert_allclose(sequence.times * 24, [0, 1, 2, 3, 4, 4.5])
        np.testing.assert_allclose(sequence.points[:, 0, 2], [0, 1, 2, 3, 4, 4.5], atol=1e-6)

    def test_a_pose_at_rest_is_one_frame(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        UsdSkel.BindingAPI(stage.GetPrimAtPath("/arm/bones")).GetAnimationSourceRel().ClearTargets(True)
        sequence = saved(stage)
        np.testing.assert_allclose(sequence.points, [2 * CORNERS + [5, 0, 0]], atol=1e-6)

    def test_a_binding_without_skeleton(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        UsdSkel.BindingAPI(arm).GetSkeletonRel().ClearTargets(True)
        with pytest.warns(MixseqWarning, match=r"bound to no skeleton with a pose .*: /arm/skin"):
            np.testing.assert_allclose(saved(stage).points, [np.add(CORNERS, [105, 0, 0])])

    @pytest.mark.parametrize("indices", [[0, 1] * 4, [0, 9] * 5, [0, -1] * 5])
    def test_joints_that_do_not_fit(self, stage: Usd.Stage, arm: UsdGeom.Mesh, indices: list[int]) -> None:
        binding = UsdSkel.BindingAPI(arm)
        binding.GetJointIndicesPrimvar().Set(Vt.IntArray(indices))
        binding.GetJointWeightsPrimvar().Set(Vt.FloatArray([0.5] * len(indices)))
        with pytest.raises(InvalidSequenceError, match=r"frame 0 .* joint indices and weights of /arm/skin do"):
            saved(stage)

    def test_shapes_that_do_not_fit(self, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        shape = UsdSkel.BlendShape.Define(stage, "/arm/skin/up")
        shape.CreateOffsetsAttr([Gf.Vec3f(0, 0, 1)])
        shape.CreatePointIndicesAttr([77])
        binding = UsdSkel.BindingAPI(arm)
        binding.CreateBlendShapesAttr(["up"])
        binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
        animation = UsdSkel.Animation(stage.GetPrimAtPath("/arm/motion"))
        animation.CreateBlendShapesAttr(["up"])
        animation.CreateBlendShapeWeightsAttr().Set([1.0])
        with pytest.raises(InvalidSequenceError, match=r"frame 0 .* blend shapes of /arm/skin do not fit"):
            saved(stage)

    def test_a_crowd_of_instances(self, path: Path, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        stage.SetDefaultPrim(stage.GetPrimAtPath("/arm"))
        stage.Save()
        crowd = Usd.Stage.CreateNew(str(path.with_name("crowd.usda")))
        for number in range(2):
            prim = UsdGeom.Xform.Define(crowd, f"/crowd/arm{number}").GetPrim()
            body = crowd.DefinePrim(f"/crowd/arm{number}/body")
            body.GetReferences().AddReference(f"./{path.name}")
            body.SetInstanceable(True)
            UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(0, 0, number))
        joined = saved(crowd)
        assert paths(joined) == ["/crowd/arm0/body/skin", "/crowd/arm1/body/skin"]
        np.testing.assert_allclose(joined.points[:, 5:] - joined.points[:, :5], np.full((5, 5, 3), [0, 0, 1]))
        np.testing.assert_allclose(joined.points[:, :5], read(path).points)

    def test_in_a_package(self, path: Path, stage: Usd.Stage, arm: UsdGeom.Mesh) -> None:
        stage.Save()
        assert UsdUtils.CreateNewUsdzPackage(str(path), str(path.with_suffix(".usdz")))
        np.testing.assert_array_equal(read(path.with_suffix(".usdz")).points, read(path).points)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["CesiumMan", "RiggedFigure", "RiggedSimple"])
def test_real_characters_are_as_usd_bakes_them(data: Path, name: str) -> None:
    file = data / "usd" / f"{name}.usdz"
    sequence = read(file)
    stage = Usd.Stage.Open(str(file))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(sequence.objects[0].path))
    seams = Weld.from_mesh(mesh, np.array(mesh.GetPointsAttr().Get()))
    assert sequence.vertex_count == seams.vertex_count < len(seams.vertex_of_point)
    expected = baked(stage, sequence.objects[0].path, sequence.times)
    split = sequence.points[:, seams.vertex_of_point]
    assert np.abs(split - expected).max() <= 1e-6 * sequence.diagonal
    assert sequence.surface.face_sets[0].material.startswith(f"/{name}/Materials/")
