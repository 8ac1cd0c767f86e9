"""USD, writing: skins and morphs (UsdSkel), against what USD's own skinning makes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel

import mixseq
from mixseq.errors import InvalidSequenceError, OutputError
from mixseq.rigging.rigs import Morph, Skin
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq_io.rig_files import measure_rig_file
from tests.formats.conftest import dressed, lossy
from tests.formats.rig_maker import QUARTER, carried, hinge, random_skin, swelling
from tests.formats.usd_maker import problems
from tests.meshes import bar, bent

SUFFIXES = pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc", ".usdz"])


def written(path: Path, rig: Skin | Morph) -> Usd.Stage:
    with lossy():
        mixseq.write_rig(path, rig)
    return Usd.Stage.Open(str(path))


def animation_of(stage: Usd.Stage) -> UsdSkel.Animation:
    (found,) = filter(None, map(UsdSkel.Animation, stage.Traverse()))
    return found


def skinned_by_usd(stage: Usd.Stage, mesh: str) -> Float:
    """Points ``(T, V, 3)`` in the world, from USD's own baking, which knows nothing of our reader."""
    root = UsdSkel.Root(stage.GetDefaultPrim())
    codes = animation_of(stage).GetRotationsAttr().GetTimeSamples()
    assert UsdSkel.BakeSkinning(root, Gf.Interval(codes[0], codes[-1]))
    points = UsdGeom.Mesh(stage.GetPrimAtPath(mesh)).GetPointsAttr()
    return np.array([np.asarray(points.Get(code)) for code in codes], dtype=np.float64)


@SUFFIXES
def test_a_hinge_comes_back_as_it_bends(tmp_path: Path, suffix: str) -> None:
    skin = hinge()
    stage = written(tmp_path / f"a{suffix}", skin)
    assert problems(stage) == set()
    back = mixseq.read(tmp_path / f"a{suffix}")
    expected = [bent(skin.rest, angle) for angle in np.linspace(0, QUARTER, 4)]
    np.testing.assert_allclose(back.points, expected, atol=1e-6)
    np.testing.assert_allclose(back.times, skin.header.times, atol=1e-12)
    np.testing.assert_array_equal(back.faces, skin.header.faces)
    assert (back.name, back.fps) == ("bar", 10)


def test_usd_itself_skins_it_the_same(tmp_path: Path) -> None:
    for number, skin in enumerate([hinge(), hinge(targets=3), carried(hinge())]):
        stage = written(tmp_path / f"{number}.usda", skin)
        np.testing.assert_allclose(skinned_by_usd(stage, "/bar/bar"), skin.points(), atol=2e-6)


def test_between_keys_bones_turn_on_arcs(tmp_path: Path) -> None:
    skin = hinge(frames=2)
    stage = written(tmp_path / "a.usda", skin)
    query = UsdSkel.Cache().GetAnimQuery(animation_of(stage))
    _, rotations, _ = query.ComputeJointLocalTransformComponents(Usd.TimeCode(0.5))
    between = skin.resampled([0.05]).local_motion()[0][0]
    np.testing.assert_allclose([[*each.imaginary, each.real] for each in rotations], between, atol=1e-6)


def test_joints_are_a_tree_with_their_names(tmp_path: Path) -> None:
    skin = hinge()
    named = replace(skin, skeleton=replace(skin.skeleton, names=("mixamorig:Hips", "leg.L")))
    stage = written(tmp_path / "a.usda", named)
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/bar/skeleton"))
    assert list(skeleton.GetJointsAttr().Get()) == ["mixamorig_Hips", "mixamorig_Hips/leg_L"]
    assert list(skeleton.GetJointNamesAttr().Get()) == ["mixamorig:Hips", "leg.L"]
    bind, rest = skeleton.GetBindTransformsAttr().Get(), skeleton.GetRestTransformsAttr().Get()
    assert Gf.IsClose(bind[1], rest[1] * rest[0], 1e-12)
    assert tuple(bind[1].ExtractTranslation()) == (0, 0, 2)
    assert tuple(bind[1].TransformDir((1, 0, 0))) == pytest.approx((0, 1, 0))


def test_siblings_whose_names_become_the_same(tmp_path: Path) -> None:
    skin = random_skin(bar(frames=2), 3)
    twins = replace(skin, skeleton=replace(skin.skeleton, names=("a b", "a.b", "a_b")))
    stage = written(tmp_path / "a.usda", twins)
    joints = list(UsdSkel.Skeleton(stage.GetPrimAtPath("/bar/skeleton")).GetJointsAttr().Get())
    assert len(set(joints)) == 3
    np.testing.assert_allclose(mixseq.read(tmp_path / "a.usda").points, twins.points(), atol=1e-5)


def test_of_a_hinge_only_rotations_are_animated(tmp_path: Path) -> None:
    stage = written(tmp_path / "a.usda", hinge())
    animation = animation_of(stage)
    assert animation.GetRotationsAttr().GetTimeSamples() == [0, 1, 2, 3]
    assert animation.GetTranslationsAttr().GetTimeSamples() == []
    assert animation.GetScalesAttr().GetTimeSamples() == []
    stage = written(tmp_path / "b.usda", carried(hinge()))
    animation = animation_of(stage)
    assert animation.GetTranslationsAttr().GetTimeSamples() == [0, 1, 2, 3]


def test_correctives_are_blend_shapes_of_the_points_they_move(tmp_path: Path) -> None:
    skin = hinge(targets=2)
    few = np.array(skin.targets)
    few[1, 3:] = 0
    stage = written(tmp_path / "a.usda", replace(skin, targets=few))
    assert problems(stage) == set()
    shape = UsdSkel.BlendShape(stage.GetPrimAtPath("/bar/bar/mode_01"))
    assert list(shape.GetPointIndicesAttr().Get()) == [0, 1, 2]
    weights = animation_of(stage).GetBlendShapeWeightsAttr()
    scaled = np.array([list(weights.Get(code)) for code in weights.GetTimeSamples()])
    np.testing.assert_array_equal([scaled.min(axis=0), scaled.max(axis=0)], [[0, 0], [1, 1]])  # as sliders have
    back = mixseq.read(tmp_path / "a.usda")
    np.testing.assert_allclose(back.points, replace(skin, targets=few).points(), atol=1e-6)


@SUFFIXES
def test_a_morph_comes_back(tmp_path: Path, suffix: str) -> None:
    morph = swelling()
    stage = written(tmp_path / f"a{suffix}", morph)
    assert problems(stage) == set()
    np.testing.assert_allclose(mixseq.read(tmp_path / f"a{suffix}").points, morph.points(), atol=1e-6)


def test_a_skin_of_many_objects_and_materials(tmp_path: Path) -> None:
    sequence = dressed()
    skin = random_skin(sequence)
    stage = written(tmp_path / "a.usdc", skin)
    back = mixseq.read(tmp_path / "a.usdc", prim="/")
    np.testing.assert_allclose(back.points, skin.points(), atol=1e-5)
    assert [each.name for each in back.surface.objects] == [each.name for each in sequence.surface.objects]
    assert len(list(filter(None, map(UsdSkel.Skeleton, stage.Traverse())))) == 1


def test_units_and_the_up_axis_are_told(tmp_path: Path) -> None:
    skin = hinge(up_axis="Z", metres_per_unit=0.01)
    stage = written(tmp_path / "a.usdc", skin)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.01)
    back = mixseq.read(tmp_path / "a.usdc")
    assert (back.up_axis, back.metres_per_unit) == ("Z", 0.01)
    np.testing.assert_allclose(back.points, skin.points(), atol=1e-6)
    sequence = MeshSequence.from_header(skin.header, skin.points())
    assert measure_rig_file(tmp_path / "a.usdc", sequence).max_error < 1e-6


def test_boxes_are_those_of_the_frames(tmp_path: Path) -> None:
    skin = hinge()
    stage = written(tmp_path / "a.usda", skin)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    for frame, points in enumerate(skin.points()):
        box = [points.min(axis=0), points.max(axis=0)]
        np.testing.assert_allclose(root.GetExtentAttr().Get(frame), box, atol=1e-6)


def test_what_stands_still_has_no_samples(tmp_path: Path) -> None:
    skin = hinge(frames=2)
    still = replace(skin, rotations=skin.rotations[[1, 1]])
    stage = written(tmp_path / "a.usda", still)
    assert animation_of(stage).GetRotationsAttr().GetTimeSamples() == []
    np.testing.assert_allclose(mixseq.read(tmp_path / "a.usda").points[0], bent(skin.rest, QUARTER), atol=1e-6)


def test_errors_are_those_of_the_file(tmp_path: Path) -> None:
    skin = hinge()
    written(tmp_path / "a.usdz", skin)
    moved = skin.points()
    moved[2, 7] += [0, 0.3, 0.4]
    found = measure_rig_file(tmp_path / "a.usdz", MeshSequence.from_header(skin.header, moved))
    assert found.max_error == pytest.approx(0.5 / np.linalg.norm(np.ptp(skin.rest, axis=0)), rel=1e-5)


def test_a_rig_of_a_usd_file_stands_alone(tmp_path: Path, arm: UsdGeom.Mesh) -> None:

    stage = arm.GetPrim().GetStage()
    stage.GetRootLayer().Save()
    sequence = mixseq.read(Path(stage.GetRootLayer().realPath))
    rig = random_skin(sequence, 3, targets=0)
    with lossy():
        mixseq.write_rig(tmp_path / "rig.usdc", rig)
    np.testing.assert_allclose(mixseq.read(tmp_path / "rig.usdc").points, rig.points(), atol=1e-5)
    with pytest.raises(OutputError, match="is the original, or a layer that it uses"):
        mixseq.write_rig(stage.GetRootLayer().realPath, rig)


def test_x_up_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="USD stages have Y or Z up, this mesh has X"):
        mixseq.write_rig(tmp_path / "a.usda", hinge(up_axis="X"))
    assert list(tmp_path.iterdir()) == []


def test_what_is_too_large_for_float32_is_refused_and_an_old_file_stays(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_bytes(b"somebody's work")
    skin = hinge(targets=1)
    from_zero = skin.target_weights - skin.target_weights.min()
    refused = [
        (replace(skin, rest=skin.rest * 1e39), "vertex 0"),
        (replace(skin, translations=skin.translations * 1e39), "bone 1"),
        (replace(skin, targets=skin.targets * 1e39, target_weights=from_zero), "a target of vertex 8"),
    ]
    for rig, words in refused:
        with pytest.raises(InvalidSequenceError, match=words):
            mixseq.write_rig(tmp_path / "a.usda", rig)
        assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"somebody's work"]
