"""Blends of poses: what any space must do, and what sets the rotation-invariant ones apart."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import PLACEMENTS, SPACES, PlacementName, SpaceName
from mixseq.errors import SettingsError
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float
from tests.meshes import SEQUENCES, bar, bent, rotation, tube

POSES = bar(sides=5, rings=13, frames=4)

KINDS: list[tuple[SpaceName, dict[str, Any]]] = [
    *((space, {}) for space in SPACES),
    ("mixed", {"placement": "free"}),
    ("edge", {"projection": "dso"}),
    ("edge", {"projection": "dso", "volume": 1.0}),
]


def lengths(points: Float, faces: Any) -> Float:
    sides = points[faces] - points[np.roll(faces, 1, axis=1)]
    return np.asarray(np.linalg.norm(sides, axis=2))


@pytest.mark.parametrize(("space", "settings"), KINDS, ids=str)
def test_a_pose_alone_comes_back(space: SpaceName, settings: dict[str, Any]) -> None:
    interpolator = PoseInterpolator.from_poses(POSES, space, **settings)
    assert interpolator.space.dim == interpolator.vectors.shape[1]
    for pose, points in zip(POSES.points, interpolator.iterate_blends(np.eye(4)), strict=True):
        np.testing.assert_allclose(points, pose, atol=1e-9)


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("name", ["several components", "rigid component", "unused vertices", "one frame", "float32"])
def test_awkward_meshes_come_back(name: str, space: SpaceName) -> None:
    poses = SEQUENCES[name]()
    last = mixseq.interpolate(poses, np.eye(poses.frame_count)[-1], space)
    assert last.dtype == np.float64
    assert last.shape == poses.points[0].shape
    np.testing.assert_allclose(last, poses.points[-1], atol=1e-6 * poses.diagonal)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("name", ["repeated corners", "zero area", "three pages", "bowtie"])
def test_awkward_meshes_blend(name: str, placement: PlacementName) -> None:
    poses = SEQUENCES[name]()
    weights = np.zeros(poses.frame_count)
    weights[[0, -1]] = 0.5
    middle = mixseq.interpolate(poses, weights, placement=placement)
    assert np.ptp(middle, axis=0).max() < 2 * poses.diagonal


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_blends_approximate_models_between_frames(placement: PlacementName) -> None:
    """But a model has corrections, and a blend follows lengths and angles."""
    pair = MeshSequence.from_arrays(POSES.points[[0, 3]], POSES.faces, [0.0, 1.0])
    model = mixseq.fit(pair, exact=True, placement=placement)
    for weight, within in ((0.5, 0.1), (1.0, 1e-9)):
        ours = mixseq.interpolate(pair, [1 - weight, weight], placement=placement)
        np.testing.assert_allclose(ours, model(weight), atol=within * pair.diagonal)


def test_vertices_blend_linearly() -> None:
    weights = [0.5, -0.25, 0.25, 0.5]
    expected = np.tensordot(weights, POSES.points, axes=1)
    np.testing.assert_allclose(mixseq.interpolate(POSES, weights, "vertex"), expected, atol=1e-12)


@pytest.mark.parametrize("space", ["mixed", "gradient", "lri", "edge"])
def test_a_body_that_turns_keeps_its_size(space: SpaceName) -> None:
    """Half of a turn by 120 degrees is a turn by 60; vertices would be half as far from the axis."""
    points, faces = tube(5, 9)
    middle = points.mean(axis=0)
    turned = [(points - middle) @ rotation((0, 0, angle)).T + middle for angle in np.radians([0, 60, 120])]
    pair = MeshSequence.from_arrays([turned[0], turned[2]], faces)
    half = mixseq.interpolate(pair, [0.5, 0.5], space)
    np.testing.assert_allclose(half, turned[1], atol=1e-6)
    shrunk = mixseq.interpolate(pair, [0.5, 0.5], "vertex")
    assert np.abs(shrunk - turned[1]).max() > 0.1


@pytest.mark.parametrize("space", ["mixed", "lri", "edge"])
def test_a_bar_between_two_bends_keeps_its_lengths(space: SpaceName) -> None:
    """Bent by 0 and by 120 degrees: edges are nearly as long as they are bent by 60; those of vertices are not."""
    points, faces = tube(6, 17)
    poses = [bent(points, np.radians(angle)) for angle in (0, 120)]
    pair = MeshSequence.from_arrays(poses, faces)
    wanted = (lengths(poses[0], faces) + lengths(poses[1], faces)) / 2

    def strain(name: SpaceName) -> float:
        half = mixseq.interpolate(pair, [0.5, 0.5], name)
        return float(np.sqrt(np.mean(np.square(lengths(half, faces) / wanted - 1))))

    assert strain(space) < 0.5 * strain("vertex")


def test_poses_may_have_any_order() -> None:
    """As long as angles and rotations do not pass half a turn."""
    ahead = mixseq.interpolate(POSES, [0.1, 0.2, 0.3, 0.4], "edge")
    back = MeshSequence.from_arrays(POSES.points[[0, 2, 1, 3]], POSES.faces)
    np.testing.assert_allclose(mixseq.interpolate(back, [0.1, 0.3, 0.2, 0.4], "edge"), ahead, atol=1e-6)


def test_settings_are_used() -> None:
    interpolator = PoseInterpolator.from_poses(POSES, parts=2, joint_width=1)
    assert isinstance(interpolator.space, mixseq.spaces.MixedSpace)
    assert len(interpolator.space.decomposition.parts) == 2
    assert interpolator.space.placement == "anchored"
    free = PoseInterpolator.from_poses(POSES, parts=np.arange(len(POSES.faces)) % 2 * 0, placement="free").space
    assert isinstance(free, mixseq.spaces.MixedSpace)
    assert (free.placement, len(free.decomposition.parts)) == ("free", 1)


def test_lengths_and_angles_are_made_to_agree_between_poses_that_are_apart() -> None:
    """In an animation of the same frames there is no need to."""
    space = PoseInterpolator.from_poses(POSES, pose_ids=[0, 3]).space
    assert isinstance(space, MixedSpace) and space.joint_faces.any()
    assert space.projection.steps > 0 and space.projection.share == 1
    near = MeshSequence.from_arrays(POSES.points[[0, 0]] + np.array([0.0, 1.0])[:, None, None], POSES.faces)
    for other in (mixseq.fit(POSES).space, PoseInterpolator.from_poses(near).space):
        assert isinstance(other, MixedSpace)
        assert not (other.projection.steps or other.projection.share or other.joint_faces.any())


def test_fits_are_reported() -> None:
    points, reports = PoseInterpolator.from_poses(POSES, "edge", pose_ids=[0, 1]).blend_with_reports([0.5, 0.5])
    np.testing.assert_array_equal(points, mixseq.interpolate(POSES, [0.5, 0.5, 0, 0], "edge"))
    assert reports
    assert all(report.converged for report in reports)
    assert not PoseInterpolator.from_poses(POSES, "vertex").blend_with_reports([1, 0, 0, 0])[1]


def test_blends_do_not_depend_on_who_works() -> None:
    weights = np.array([[0.5, 0.5, 0, 0], [0, 0.3, 0, 0.7], [0.1, 0.2, 0.3, 0.4]])
    results = []
    for workers in (serial_executor, thread_executor(3)):
        told: list[tuple[int, int, str]] = []
        interpolator = PoseInterpolator.from_poses(
            POSES, workers=workers, progress=lambda *step, told=told: told.append(step)
        )
        results.append(np.stack(list(interpolator.iterate_blends(weights, workers=workers))))
        assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
        assert told[-1][0] == told[-1][1]
    np.testing.assert_array_equal(results[0], results[1])


def test_sequences_that_stream(tmp_path: Path) -> None:
    mixseq.write(tmp_path / "poses.npz", POSES)
    weights = [0.25, 0.25, 0.25, 0.25]
    with mixseq.open_sequence(tmp_path / "poses.npz") as reader:
        streamed = mixseq.interpolate(reader, weights)
    np.testing.assert_array_equal(streamed, mixseq.interpolate(POSES, weights))


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ([0.5, 0.5], r"weights have shape \(2,\); one number for each of the 4 poses"),
        ([[1, 0, 0, 0]], r"weights have shape \(1, 4\)"),
        ([0.5, 0.5, np.nan, 0], r"the weight of pose 2 is nan; finite numbers"),
        ([0.5, np.inf, 0, 0], r"the weight of pose 1 is inf"),
        ([0.5, 0.5, 0.5, 0.5], r"weights add up to 2 and must add up to 1; divide them by their sum"),
        ([0.5, 0.5 + 1e-5, 0, 0], r"weights add up to 1\.00001 and must"),
        ([1, -1, 0, 0], r"weights add up to 0 and must add up to 1; raise one"),
    ],
)
def test_weights_are_checked(weights: Any, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        mixseq.interpolate(POSES, weights)


def test_weights_in_single_precision_will_do() -> None:
    third = np.full(3, 1 / 3, dtype=np.float32)
    three = MeshSequence.from_arrays(POSES.points[:3], POSES.faces)
    blended = mixseq.interpolate(three, third, "vertex")
    np.testing.assert_allclose(blended, three.points.mean(axis=0), atol=1e-7)


@pytest.mark.parametrize("rows", [[[0.5, 0.5, 0, 0], [1.0]], [["all", 0, 0, 0]]])
def test_rows_of_weights_are_checked(rows: Any) -> None:
    with pytest.raises(SettingsError, match="not a table of numbers, with a row for every blend"):
        next(PoseInterpolator.from_poses(POSES, "vertex").iterate_blends(rows))


def test_poses_to_blend_are_checked() -> None:
    for pose in (-1, 4):
        with pytest.raises(SettingsError, match=f"there is no pose {pose}; poses are 0 to 3"):
            PoseInterpolator.from_poses(POSES, "vertex", pose_ids=[0, pose])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"space": "polar"}, "space is 'polar'; one of mixed, vertex"),
        ({"space": "vertex", "placement": "free"}, "the vertex space has no use for placement"),
        ({"space": "lri", "parts": 2}, "the lri space has no use for parts"),
        ({"placement": "loose"}, "placement is 'loose'"),
        ({"volume": 1.0}, "the mixed space has no use for volume"),
    ],
)
def test_settings_are_checked(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        mixseq.interpolate(POSES, [1, 0, 0, 0], **settings)


@pytest.mark.realdata
@pytest.mark.parametrize("space", SPACES)
def test_lions_come_back(data: Path, space: SpaceName) -> None:
    lions = mixseq.read(data / "npz" / "lion_poses.npz")
    poses = MeshSequence.from_arrays(lions.points[[0, 2, 5]], lions.polygons)
    for pose, points in zip(
        poses.points, PoseInterpolator.from_poses(poses, space).iterate_blends(np.eye(3)), strict=True
    ):
        assert np.linalg.norm(points - pose, axis=1).max() < 1e-6 * poses.diagonal


@pytest.mark.realdata
@pytest.mark.parametrize("space", SPACES)
def test_a_fox_comes_back_from_its_file(data: Path, space: SpaceName, tmp_path: Path) -> None:
    fox = mixseq.read(data / "npz" / "fox_run.npz")
    some = MeshSequence.from_header(fox.header.with_times(fox.times[::8]), fox.points[::8])
    mixseq.save(tmp_path / "fox.h5", mixseq.fit(some, exact=True, space=space))
    decoded = mixseq.load(tmp_path / "fox.h5").sample()
    assert np.linalg.norm(decoded.points - some.points, axis=2).max() < 1e-6 * some.diagonal
