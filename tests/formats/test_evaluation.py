"""Rigs at any time: between keys as glTF and USD define it, also in a worker, and what has no rig."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

import mixseq
from mixseq.errors import FormatError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io.gltf.reader import open_gltf
from mixseq_io.isolation import open_isolated
from mixseq_io.reader import SequenceReader
from mixseq_io.usd.motion import Weld
from mixseq_io.usd.reader import open_usd
from tests.formats.conftest import lossy
from tests.formats.gltf_maker import JOINTS, TRIANGLE, Maker, morphing, moving, skinned
from tests.formats.usd.stage_maker import CORNERS, INDICES, lower

QUARTER = np.pi / 2
WEIGHTS = [[1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0]]


def joined(blocks: Iterator[FloatArray]) -> FloatArray:
    return np.concatenate(list(blocks))


def opened(maker: Maker, folder: Path) -> SequenceReader:
    return open_gltf(maker.glb(folder / "rig.glb"))


def points_and_velocities(maker: Maker, folder: Path, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
    with opened(maker, folder) as reader:
        assert reader.can_evaluate
        return joined(reader.blocks_at(times, 2)), joined(reader.velocity_blocks_at(times, 2))


# glTF -----------------------------------------------------------------------------------------------------


def test_a_joint_turns_along_an_arc(tmp_path: Path) -> None:
    times = np.array([0.25, 0.01, 0.777])
    points, velocities = points_and_velocities(skinned(WEIGHTS, JOINTS), tmp_path, times)
    angle = QUARTER * times
    arm = np.stack([1 + np.cos(angle), np.sin(angle)], axis=1)  # of (2, 0) about (1, 0)
    np.testing.assert_allclose(points[:, 0, :2], arm, atol=2e-7)
    turned = arm + np.stack([-np.sin(angle), np.cos(angle)], axis=1)  # of (2, 1)
    np.testing.assert_allclose(points[:, 1, :2], (turned + np.array([2, 1])) / 2, atol=2e-7)
    speed = QUARTER * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    np.testing.assert_allclose(velocities[:, 0, :2], speed, atol=1e-6)
    assert not velocities[:, :, 2].any()


def test_steps_jump_without_velocity(tmp_path: Path) -> None:
    times = [0.0, 0.4, 0.99, 1.0, 1.7, 2.0]
    maker = moving([0, 1, 2], [[0, 0, 0], [2, 0, 0], [5, 0, 0]], "STEP")
    points, velocities = points_and_velocities(maker, tmp_path, times)
    assert points[:, 0, 0].tolist() == [0, 0, 0, 2, 2, 5]
    assert not velocities.any()


def test_cubic_splines_and_their_slopes(tmp_path: Path) -> None:
    keys, own = np.zeros((3, 3, 3)), np.array([0, 0.5, 2.0])
    keys[:, 1, 1], keys[:, 0, 1], keys[:, 2, 1] = own**3, 3 * own**2, 3 * own**2
    times = np.array([0.123, 1.234, 0.5])
    points, velocities = points_and_velocities(moving(own, keys.reshape(-1, 3), "CUBICSPLINE"), tmp_path, times)
    np.testing.assert_allclose(points[:, 0, 1], times**3, rtol=1e-6)
    np.testing.assert_allclose(velocities[:, 0, 1], 3 * times**2, atol=1e-5)


def test_morph_weights_are_linear(tmp_path: Path) -> None:
    maker = morphing()
    maker.animate(0, "weights", [0, 1], [[0, 1], [0.5, 0]])
    points, velocities = points_and_velocities(maker, tmp_path, [0.25])
    np.testing.assert_allclose(points[0], np.add(TRIANGLE, [[0, 0, 0.125], [3, 0, 0.125], [0, 0, 0.125]]))
    np.testing.assert_allclose(velocities[0], [[0, 0, 0.5], [-4, 0, 0.5], [0, 0, 0.5]], atol=1e-6)


def test_frames_are_those_that_are_read_and_times_those_of_the_header(tmp_path: Path) -> None:
    path = skinned(WEIGHTS, JOINTS).glb(tmp_path / "rig.glb")
    with mixseq.open_sequence(path, start_frame=1001) as reader, open_gltf(path) as plain:
        assert reader.header.times[0] == pytest.approx(1001 / 24)
        np.testing.assert_array_equal(joined(reader.blocks_at(reader.header.times)), joined(reader.blocks()))
        later = joined(reader.blocks_at(reader.header.times[0] + np.array([0.3, -1, 9])))
        np.testing.assert_allclose(later, joined(plain.blocks_at([0.3, 0, 1])), atol=1e-6)


def test_a_static_mesh_and_a_shape_per_frame_have_no_rig(tmp_path: Path) -> None:
    still = Maker()
    still.node(mesh=still.mesh(TRIANGLE))
    walk = MeshSequence.from_arrays(np.random.default_rng(0).normal(size=(5, 3, 3)), [[0, 1, 2]])
    with lossy():
        mixseq.write(tmp_path / "cache.glb", walk)
    with opened(still, tmp_path) as reader, open_gltf(tmp_path / "cache.glb") as cache:
        assert not reader.can_evaluate
        with pytest.raises(SettingsError, match=r"cache\.glb has no rig to evaluate, only points .* mixseq\.fit makes"):
            cache.blocks_at([0.1])


def test_a_mirroring_moment_is_refused(tmp_path: Path) -> None:
    maker = Maker()
    node = maker.node("body", mesh=maker.mesh(TRIANGLE))
    keys = [[0, 0, 0], [1, 1, 1], [-200, 0, 0], [200, 0, 0], [1, 1, 1], [0, 0, 0]]
    maker.animate(node, "scale", [0, 1 / 24], keys, "CUBICSPLINE")  # unmirrored at both frames
    with opened(maker, tmp_path) as reader:
        assert reader.header.frame_count == 2
        joined(reader.blocks())
        with pytest.raises(mixseq.errors.InvalidSequenceError, match="frame 1: 'body' is mirrored"):
            joined(reader.blocks_at([0.5 / 24]))


# USD ------------------------------------------------------------------------------------------------------


@pytest.fixture
def turning(tmp_path: Path) -> Path:
    """A mesh of two joints, keyed at the time codes 0 and 3; the second joint turns by a quarter and slides."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "arm.usda"))
    UsdSkel.Root.Define(stage, "/arm")
    skeleton = UsdSkel.Skeleton.Define(stage, "/arm/bones")
    joints, rest = Vt.TokenArray(["upper", "upper/lower"]), [Gf.Matrix4d(1), Gf.Matrix4d().SetTranslate((1, 0, 0))]
    skeleton.CreateJointsAttr(joints)
    skeleton.CreateBindTransformsAttr(rest)
    skeleton.CreateRestTransformsAttr(rest)
    animation = UsdSkel.Animation.Define(stage, "/arm/motion")
    animation.CreateJointsAttr(joints)
    animation.CreateScalesAttr([Gf.Vec3h(1)] * 2)
    for code in (0, 3):
        half = np.radians(30 * code) / 2
        turn = Gf.Quatf(float(np.cos(half)), 0, 0, float(np.sin(half)))
        animation.CreateTranslationsAttr().Set([Gf.Vec3f(0), Gf.Vec3f(1, code, 0)], code)
        animation.CreateRotationsAttr().Set([Gf.Quatf(1), turn], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/arm/motion"])
    mesh = UsdGeom.Mesh.Define(stage, "/arm/skin")
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    mesh.CreatePointsAttr(Vt.Vec3fArrayFromBuffer(CORNERS))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/arm/bones"])
    binding.CreateJointIndicesPrimvar(False, 1).Set([1] * 5)
    binding.CreateJointWeightsPrimvar(False, 1).Set([1] * 5)
    stage.Save()
    return tmp_path / "arm.usda"


def test_a_skeleton_turns_between_samples(turning: Path) -> None:
    codes = np.array([0.75, 2.9, 1.5])
    with open_usd(turning) as reader:
        assert reader.can_evaluate
        points, velocities = joined(reader.blocks_at(codes / 24, 2)), joined(reader.velocity_blocks_at(codes / 24, 2))
    np.testing.assert_allclose(points, [lower(CORNERS, code) for code in codes], atol=1e-6)
    steps = [(lower(CORNERS, code + 1e-4) - lower(CORNERS, code - 1e-4)) / 2e-4 for code in codes]
    np.testing.assert_allclose(velocities, 24 * np.array(steps), atol=2e-3)  # of up to 24 units per second


def test_transforms_turn_and_points_are_samples(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "spin.usda"))
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    mesh.CreatePointsAttr(Vt.Vec3fArrayFromBuffer(CORNERS))
    turn = mesh.AddRotateZOp()
    turn.Set(0.0, 0)
    turn.Set(90.0, 1)
    stage.Save()
    with open_usd(tmp_path / "spin.usda") as reader:
        points = joined(reader.blocks_at([0.25 / 24]))
    angle = QUARTER / 4
    np.testing.assert_allclose(points[0, 1], [np.cos(angle), np.sin(angle), 0], atol=1e-6)
    mesh.GetPointsAttr().Set(Vt.Vec3fArrayFromBuffer(2 * CORNERS), 1)
    mesh.GetPointsAttr().Set(Vt.Vec3fArrayFromBuffer(CORNERS), 0)
    stage.Save()
    with open_usd(tmp_path / "spin.usda") as reader:
        assert not reader.can_evaluate


# In a worker ----------------------------------------------------------------------------------------------


def test_workers_evaluate(turning: Path) -> None:
    times = [0.01, 0.1, 0.03, 0.125]
    with mixseq.open_sequence(turning, start_frame=24) as reader, open_usd(turning) as here:
        assert reader.can_evaluate
        later = np.add(times, 1.0)
        np.testing.assert_allclose(joined(reader.blocks_at(later, 3)), joined(here.blocks_at(times)), atol=1e-6)
        expected = joined(here.velocity_blocks_at(times))
        np.testing.assert_allclose(joined(reader.velocity_blocks_at(later, 3)), expected, atol=1e-2)
        blocks = reader.blocks_at(later, 1)
        next(blocks)
    with pytest.raises(FormatError, match="is closed"):
        next(blocks)


def test_evaluation_in_a_worker() -> None:
    path = Path("walk.abc")
    with open_isolated("tests.formats.readers:open_file", path, {"how": "well", "when": "evaluating"}) as reader:
        assert [block[0, 0, 0] for block in reader.blocks_at([0.5, 2.25, 1.0], 1)] == [0.5, 2.25, 1.0]


# Real data ------------------------------------------------------------------------------------------------


@pytest.mark.realdata
def test_cesium_man_is_what_usd_computes_between_frames(data: Path) -> None:
    path = data / "usd/CesiumMan.usdz"
    codes = np.array([1.3, 20.75, 41.5])
    with mixseq.open_sequence(path) as reader:
        points = joined(reader.blocks_at(codes / reader.header.fps))
        name = reader.header.objects[0].path
    stage = Usd.Stage.Open(str(path))
    cache = UsdSkel.Cache()
    root = next(UsdSkel.Root(prim) for prim in stage.Traverse() if UsdSkel.Root(prim))
    cache.Populate(root, Usd.PrimDefaultPredicate)
    (binding,) = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(name))
    vertices = Weld.from_mesh(mesh, np.array(mesh.GetPointsAttr().Get())).vertex_of_point
    for code, got in zip(codes.tolist(), points, strict=True):
        skinned_points = Vt.Vec3fArray(mesh.GetPointsAttr().Get())
        transforms = cache.GetSkelQuery(binding.GetSkeleton()).ComputeSkinningTransforms(code)
        assert binding.GetSkinningTargets()[0].ComputeSkinnedPoints(transforms, skinned_points, code)
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(binding.GetSkeleton().GetPrim()))
        expected = np.array(skinned_points) @ matrix[:3, :3] + matrix[3, :3]
        np.testing.assert_allclose(got[vertices], expected, atol=1e-6)


# Keys of baked rigs ---------------------------------------------------------------------------------------

KEYS = np.array([0, 5, 7, 13, 17, 20]) / 10
PLACES = np.stack([[0, 3, -1, 2, 2, 5], [0, 1, 4, 1, 0, 0], np.zeros(6)], axis=1)


def test_a_model_of_steps_holds_every_pose_until_its_key(tmp_path: Path) -> None:
    with opened(moving(KEYS, PLACES, "STEP"), tmp_path) as reader:
        assert reader.header.keys is not None
        assert reader.header.keys.is_held
        model = mixseq.fit(reader, exact=True, space="vertex")
    at = np.array([0.2, 0.49, 0.5, 0.69, 0.71, 1.9, 2.0])
    np.testing.assert_allclose(model(at)[:, 0, 0], [0, 0, 3, 3, -1, 2, 5], atol=1e-6)


@pytest.mark.parametrize("turned", [False, True], ids=["moved", "turned"])
def test_a_model_of_linear_keys_has_corners_there_only(tmp_path: Path, turned: bool) -> None:
    """Straight between them, or on the arcs of joints."""
    maker = skinned(WEIGHTS, JOINTS) if turned else moving(KEYS, PLACES, "LINEAR")
    if turned:
        angles = PLACES[:, 0] / 4
        quats = np.stack([0 * angles, 0 * angles, np.sin(angles / 2), np.cos(angles / 2)], axis=1)
        del maker.json["animations"]
        maker.animate(0, "rotation", KEYS, quats)
    with opened(maker, tmp_path) as reader:
        times, keys = reader.header.times, reader.header.keys
        assert keys is not None
        np.testing.assert_allclose(times[list(keys.frames)], KEYS, atol=1e-6)
        model = mixseq.fit(reader, exact=True, space="vertex")
        at = (times[1:] + times[:-1]) / 2
        expected = joined(reader.blocks_at(at))
    np.testing.assert_allclose(model.time.breaks, KEYS[1:-1], atol=1e-6)
    np.testing.assert_allclose(model(at), expected, atol=5e-3 if turned else 1e-6)
    sequence = mixseq.read(tmp_path / "rig.glb")
    assert sequence.keys == keys  # also when baked
    assert sequence.header.with_times(sequence.times + 1).keys is None


def test_keys_that_were_baked_at_every_frame_or_differ_in_kind_say_nothing(tmp_path: Path) -> None:
    dense = np.arange(21) / 24
    path = np.sin(3 * dense)[:, None] * [1, 0, 0]
    maker = moving(dense, path, "LINEAR")
    with opened(maker, tmp_path) as reader:
        assert reader.header.keys is None
    mixed = moving(KEYS, PLACES, "STEP")
    mixed.animate(0, "scale", KEYS, 1 + PLACES / 10, "LINEAR")
    with opened(mixed, tmp_path) as reader:
        assert reader.header.keys is None


def test_keys_of_a_stage_are_linear(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateNew(str(tmp_path / "rig.usda"))
    stage.SetTimeCodesPerSecond(10)
    mesh = UsdGeom.Mesh.Define(stage, "/body")
    mesh.CreatePointsAttr(CORNERS)
    mesh.CreateFaceVertexCountsAttr([4, 3])
    mesh.CreateFaceVertexIndicesAttr(INDICES)
    move = mesh.AddTranslateOp()
    for key, place in zip(KEYS * 10, PLACES.tolist(), strict=True):
        move.Set(Gf.Vec3d(place), float(key))
    stage.Save()
    with open_usd(tmp_path / "rig.usda") as reader:
        keys = reader.header.keys
        assert keys is not None
        assert not keys.is_held
        np.testing.assert_allclose(reader.header.times[list(keys.frames)], KEYS, atol=1e-9)
