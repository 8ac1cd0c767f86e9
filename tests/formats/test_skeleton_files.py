"""Skeletons in files: glTF skins and UsdSkel."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

import mixseq
from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, NoMeshError
from mixseq.rigging.rigs import Skeleton, rotation_matrices
from tests.formats.conftest import lossy
from tests.formats.gltf_maker import JOINTS, Maker, skinned
from tests.formats.rig_maker import AXES, hinge

HALF = np.sqrt(0.5)
ENGINES = pytest.mark.parametrize("suffix", [".glb", ".gltf", ".usda", ".usdc", ".usdz"])


def same(found: Skeleton, expected: Skeleton, atol: float = 1e-6) -> None:
    assert found.names == expected.names
    np.testing.assert_array_equal(found.parents, expected.parents)
    np.testing.assert_allclose(found.pivots, expected.pivots, atol=atol)
    np.testing.assert_allclose(rotation_matrices(found.axes), rotation_matrices(expected.axes), atol=atol)


@ENGINES
def test_what_was_written_comes_back(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"hinge{suffix}"
    with lossy():
        mixseq.write_rig(file, hinge(up_axis="Y", metres_per_unit=1.0))
    same(mixseq.read_skeleton(file), hinge().skeleton)


def test_joints_stand_in_the_world(tmp_path: Path) -> None:
    with lossy():
        mixseq.write_rig(tmp_path / "hinge.glb", hinge(up_axis="Z", metres_per_unit=0.5))
    found = mixseq.read_skeleton(tmp_path / "hinge.glb")
    np.testing.assert_allclose(found.pivots, [[0, 0, 0], [0, 1, 0]], atol=1e-7)  # in metres, with Y up
    turned = rotation_matrices(np.array([-HALF, 0, 0, HALF])) @ rotation_matrices(AXES)
    np.testing.assert_allclose(rotation_matrices(found.axes[1]), turned, atol=1e-7)


def test_a_path_is_a_skeleton(tmp_path: Path) -> None:
    from mixseq_io.path_arguments import argument_reader

    mixseq.write_rig(tmp_path / "hinge.glb", hinge(up_axis="Y", metres_per_unit=1.0))
    read = argument_reader("skeleton", {"Skeleton", "NoneType"})
    assert read is not None
    same(read(str(tmp_path / "hinge.glb"), {}), hinge().skeleton)


# glTF -----------------------------------------------------------------------------------------------------


def arm(**skin: Any) -> Maker:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["skins"][0].update(skin)
    return maker


def test_joints_stand_where_they_were_bound(tmp_path: Path) -> None:
    maker = arm()
    maker.json["nodes"][0]["translation"] = [7, 0, 0]  # a pose, not the one at bind time
    maker.json["nodes"][1]["translation"] = [0, 5, 0]
    found = mixseq.read_skeleton(maker.glb(tmp_path / "arm.glb"))
    assert found.names == ("first", "second")
    np.testing.assert_array_equal(found.parents, [-1, 0])
    np.testing.assert_allclose(found.pivots, [[0, 5, 0], [1, 5, 0]], atol=1e-7)


def test_without_matrices_joints_are_bound_where_they_stand(tmp_path: Path) -> None:
    maker = arm()
    del maker.json["skins"][0]["inverseBindMatrices"]
    maker.json["nodes"][0].update(translation=[7, 0, 0], scale=[2, 2, 2], rotation=[0, 0, HALF, HALF])
    found = mixseq.read_skeleton(maker.glb(tmp_path / "arm.glb"))
    np.testing.assert_allclose(found.pivots, [[0, 0, 0], [7, 0, 0]], atol=1e-7)
    np.testing.assert_allclose(found.axes[1], [0, 0, HALF, HALF], atol=1e-7)


def test_parents_come_first_and_nodes_between_joints_are_none(tmp_path: Path) -> None:
    maker = arm()
    tip = maker.node("tip", translation=[1, 0, 0])
    between = maker.node("helper", children=[tip])
    maker.json["nodes"][0]["children"] = [between]
    maker.json["skins"] = [{"joints": [tip, 0, 1]}]
    found = mixseq.read_skeleton(maker.glb(tmp_path / "arm.glb"))
    assert found.names == ("first", "second", "tip")
    np.testing.assert_array_equal(found.parents, [-1, 0, 1])


def test_names_are_made_different(tmp_path: Path) -> None:
    maker = arm()
    maker.json["nodes"][0]["name"] = maker.json["nodes"][1]["name"] = "arm"
    assert mixseq.read_skeleton(maker.glb(tmp_path / "a.glb")).names == ("arm", "arm_2")
    maker.json["nodes"][0]["name"] = ""
    assert mixseq.read_skeleton(maker.glb(tmp_path / "b.glb")).names == ("arm", "joint_001")


def test_skins_of_the_same_joints_are_one_skeleton(tmp_path: Path) -> None:
    maker = arm(name="left")
    first = maker.json["skins"][0]
    maker.json["skins"] = [first, {**first, "name": "right", "joints": [0, 1]}]
    assert mixseq.read_skeleton(maker.glb(tmp_path / "a.glb")).names == ("first", "second")
    maker.json["skins"].append({**first, "name": "tail", "joints": [1]})
    maker.json["skins"].append({"joints": [0]})
    with pytest.raises(AmbiguousError, match=r"several skeletons, 'left', 'tail', 'skin 3'; choose one"):
        mixseq.read_skeleton(maker.glb(tmp_path / "b.glb"))
    assert mixseq.read_skeleton(tmp_path / "b.glb", "tail").names == ("first",)
    assert mixseq.read_skeleton(tmp_path / "b.glb", "skin 3").names == ("second",)
    with pytest.raises(FormatError, match=r"b\.glb has no skeleton 'hand'; there are 'left', 'tail', 'skin 3'"):
        mixseq.read_skeleton(tmp_path / "b.glb", "hand")
    maker.json["skins"][2]["name"] = "left"
    with pytest.raises(
        AmbiguousError, match=r"'skin 0', 'skin 2'; choose one by name \(in Python, as name= of mixseq\.read_sk"
    ):
        mixseq.read_skeleton(maker.glb(tmp_path / "c.glb"), "left")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda maker: maker.json.pop("skins"), r"arm\.glb has no skeleton; a file with a character"),
        (lambda maker: maker.json["skins"][0].update(joints=[]), r"skins\[0\] has no joints"),
        (lambda maker: maker.json["skins"][0].update(joints=[9]), r"nodes\[9\] is referenced"),
        (lambda maker: maker.json["skins"][0].update(joints=[0, 1, 2]), r"skins\[0\] has 3 joints, but inverse"),
        (
            lambda maker: maker.json["skins"][0].update(inverseBindMatrices=maker.add(np.zeros((2, 16)))),
            r"skins\[0\] has an inverse bind matrix that is not invertible",
        ),
    ],
)
def test_what_gltf_is_refused(tmp_path: Path, change: Callable[[Maker], Any], message: str) -> None:
    maker = arm()
    change(maker)
    with pytest.raises(FormatError, match=message):
        mixseq.read_skeleton(maker.glb(tmp_path / "arm.glb"))


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "arm.abc").write_bytes(b"")
    with pytest.raises(FormatError, match=r"arm\.abc: skeletons are read from glTF and USD; .* \.glb, .*\.usdz"):
        mixseq.read_skeleton(tmp_path / "arm.abc")
    for suffix in (".glb", ".usda"):
        with pytest.raises(FormatError, match=re.escape(f"none{suffix}")):
            mixseq.read_skeleton(tmp_path / f"none{suffix}")


# USD ------------------------------------------------------------------------------------------------------


def bones(path: Path) -> tuple[Usd.Stage, UsdSkel.Skeleton]:
    """Two joints along x, in a skeleton that stands at y = 5 and is half as large."""
    stage = Usd.Stage.CreateNew(str(path))
    above = UsdGeom.Xform.Define(stage, "/man")
    above.AddTranslateOp().Set(Gf.Vec3d(0, 5, 0))
    above.AddScaleOp().Set(Gf.Vec3f(0.5, 0.5, 0.5))
    skeleton = UsdSkel.Skeleton.Define(stage, "/man/bones")
    skeleton.CreateJointsAttr(["hip", "hip/knee"])
    turned = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), 90))
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1), turned.SetTranslateOnly(Gf.Vec3d(2, 0, 0))])
    return stage, skeleton


def test_joints_of_usd_stand_in_the_world(tmp_path: Path) -> None:
    stage, skeleton = bones(tmp_path / "man.usda")
    stage.Save()
    expected = Skeleton(
        ("hip", "knee"),
        np.array([-1, 0]),
        np.array([[0.0, 5, 0], [1, 5, 0]]),
        np.array([[0, 0, 0, 1.0], [0, 0, HALF, HALF]]),
    )
    same(mixseq.read_skeleton(tmp_path / "man.usda"), expected)
    skeleton.CreateJointNamesAttr(["pelvis", "shin"])
    stage.Save()
    same(mixseq.read_skeleton(tmp_path / "man.usda"), replace(expected, names=("pelvis", "shin")))


def test_skeletons_of_usd_are_chosen(tmp_path: Path) -> None:
    stage, _ = bones(tmp_path / "man.usda")
    other = UsdSkel.Skeleton.Define(stage, "/dog/bones")
    other.CreateJointsAttr(["tail"])
    other.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    stage.Save()
    with pytest.raises(AmbiguousError, match=r"several skeletons, '/man/bones', '/dog/bones'; choose"):
        mixseq.read_skeleton(tmp_path / "man.usda")
    with pytest.raises(AmbiguousError):
        mixseq.read_skeleton(tmp_path / "man.usda", "bones")
    assert mixseq.read_skeleton(tmp_path / "man.usda", "/dog/bones").names == ("tail",)


def test_what_usd_is_refused(tmp_path: Path) -> None:
    stage, skeleton = bones(tmp_path / "man.usda")
    skeleton.GetJointsAttr().Set(["hip/knee", "hip"])
    stage.Save()
    with pytest.raises(FormatError, match=r"the joints of /man/bones are not a tree: "):
        mixseq.read_skeleton(tmp_path / "man.usda")
    skeleton.GetJointsAttr().Set(["hip"])
    stage.Save()
    with pytest.raises(
        FormatError, match=r"/man/bones has 1 joints and 2 bind transforms; one bind transform per joint"
    ):
        mixseq.read_skeleton(tmp_path / "man.usda")
    skeleton.GetBindTransformsAttr().Set([Gf.Matrix4d(np.nan)])
    stage.Save()
    with pytest.raises(InvalidSequenceError, match=r"man\.usda: the bind pose of joint 0 \('hip'\) is not"):
        mixseq.read_skeleton(tmp_path / "man.usda")
    stage.RemovePrim("/man/bones")
    stage.Save()
    with pytest.raises(FormatError, match=r"man\.usda has no skeleton"):
        mixseq.read_skeleton(tmp_path / "man.usda")


# Meshes ---------------------------------------------------------------------------------------------------


@ENGINES
def test_meshes_are_read_as_they_were_bound(tmp_path: Path, suffix: str) -> None:
    skin = hinge(targets=1, up_axis="Y", metres_per_unit=1.0)
    skin = replace(skin, rotations=skin.rotations[::-1])  # it is bent in the first frame
    file = tmp_path / f"hinge{suffix}"
    with lossy():
        mixseq.write_rig(file, skin)
    found = mixseq.read_bind_pose(file)
    assert found.frame_count == 1
    np.testing.assert_array_equal(found.faces, mixseq.read(file).faces)
    # glTF has weights of targets in the first frame; USD none, where the least of each is in the rest shape.
    gltf = suffix.startswith(".gl")
    mixed = skin.target_weights[0] if gltf else skin.target_weights.min(axis=0)
    shape = skin.rest + np.einsum("m,mvi->vi", mixed, skin.targets)
    np.testing.assert_allclose(found.points[0], shape, atol=1e-6)


def test_meshes_of_gltf_stand_where_the_first_joint_does(tmp_path: Path) -> None:
    maker = arm()
    maker.json["nodes"][1]["translation"] = [0, 5, 0]
    found = mixseq.read_bind_pose(maker.glb(tmp_path / "arm.glb"))
    np.testing.assert_allclose(found.points[0], [[2, 5, 0], [2, 6, 0], [0, 6, 0]], atol=1e-7)
    assert (found.metres_per_unit, found.up_axis) == (1.0, "Y")


def test_what_hangs_on_a_joint_of_gltf_is_bound_there(tmp_path: Path) -> None:
    maker = arm()
    second = maker.json["nodes"][0]  # bound at x = 1; it stands elsewhere, turned
    second.update(translation=[9, 9, 9], rotation=[0, 0, HALF, HALF], scale=[2, 2, 2])
    second["children"] = [maker.node("ring", mesh=maker.mesh([[0, 0, 0], [0, 0, 1], [0, 1, 0]]), translation=[0, 0, 3])]
    maker.node("floor", mesh=maker.mesh([[0, 0, 0], [0, 0, 1], [0, 1, 0]]))
    found = mixseq.read_bind_pose(maker.glb(tmp_path / "arm.glb"))
    assert [each.name for each in found.objects] == ["ring", "body"]
    np.testing.assert_allclose(found.points[0, :3], [[1, 0, 3], [1, 0, 4], [1, 1, 3]], atol=1e-6)


def test_without_matrices_meshes_of_gltf_are_bound_where_joints_stand(tmp_path: Path) -> None:
    maker = arm()
    del maker.json["skins"][0]["inverseBindMatrices"]
    maker.json["animations"] = []
    path = maker.glb(tmp_path / "arm.glb")
    np.testing.assert_array_equal(mixseq.read_bind_pose(path).points, mixseq.read(path).points)


def test_skeletons_without_a_mesh_have_no_bind_pose(tmp_path: Path) -> None:
    maker = arm()
    del maker.json["nodes"][2]["skin"]
    with pytest.raises(NoMeshError, match=r"arm\.glb has no mesh on its skeleton; export the character with"):
        mixseq.read_bind_pose(maker.glb(tmp_path / "arm.glb"))
    stage, _ = bones(tmp_path / "man.usda")
    stage.Save()
    with pytest.raises(NoMeshError, match=r"man\.usda holds no mesh; it has 1 Xform, 1 Skeleton"):
        mixseq.read_bind_pose(tmp_path / "man.usda")
    UsdGeom.Mesh.Define(stage, "/man/floor").CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    stage.Save()
    with pytest.raises(NoMeshError, match=r"man\.usda has no mesh on /man/bones; export the character with"):
        mixseq.read_bind_pose(tmp_path / "man.usda")
    with pytest.raises(FormatError, match=r"arm\.abc: skeletons are read from glTF and USD"):
        (tmp_path / "arm.abc").write_bytes(b"")
        mixseq.read_bind_pose(tmp_path / "arm.abc")


# Files of others ------------------------------------------------------------------------------------------


@pytest.mark.realdata
def test_the_same_man_has_the_same_joints(data: Path) -> None:
    gltf = mixseq.read_skeleton(data / "gltf" / "CesiumMan.glb")
    usd = mixseq.read_skeleton(data / "usd" / "CesiumMan.usdz")
    # The files turn him differently about the vertical, and order his joints differently.
    pivots = gltf.pivots[:, [2, 1, 0]] * [-1, 1, 1]
    distances = np.linalg.norm(pivots[:, None] - usd.pivots, axis=2)
    match = distances.argmin(axis=1)
    assert sorted(match) == list(range(19))
    assert distances.min(axis=1).max() < 1e-6
    np.testing.assert_array_equal(usd.parents[match][1:], match[gltf.parents[1:]])


@pytest.mark.realdata
def test_the_same_man_was_bound_in_the_same_pose(data: Path) -> None:
    gltf = mixseq.read_bind_pose(data / "gltf" / "CesiumMan.glb")
    usd = mixseq.read_bind_pose(data / "usd" / "CesiumMan.usdz")
    np.testing.assert_array_equal(gltf.faces, usd.faces)
    np.testing.assert_allclose(gltf.points[..., [2, 1, 0]] * [-1, 1, 1], usd.points, atol=1e-6)


@pytest.mark.realdata
def test_joints_lie_in_the_body(data: Path) -> None:
    for name in ("KhronosFox", "CesiumMan", "RiggedFigure", "Trex"):
        skeleton = mixseq.read_skeleton(data / "gltf" / f"{name}.glb")
        points = mixseq.read(data / "gltf" / f"{name}.glb", animation="none").points[0]
        size = np.ptp(points, axis=0)
        assert (skeleton.pivots > points.min(axis=0) - 0.1 * size.max()).all(), name
        assert (skeleton.pivots < points.max(axis=0) + 0.1 * size.max()).all(), name
