from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import SPACES, SpaceName
from mixseq.errors import SettingsError
from mixseq.runtime.parallel import serial_executor, thread_executor
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.edge import EdgeSettings, EdgeSpace
from mixseq.spaces.making import MixedSettings, make_space
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.spaces.temporal import Poses, TemporalOperator, insert_midpoints
from tests.meshes import bar, bending, tube

LONG = bar(sides=4, rings=9, frames=19)
"""More frames than a block has."""


@pytest.mark.parametrize("name", SPACES)
def test_frames_come_back(name: SpaceName) -> None:
    space = make_space(LONG, name)
    assert space.name == name
    assert space.scale == LONG.diagonal
    np.testing.assert_allclose(space.decode(space.encode(LONG.points[:4])), LONG.points[:4], atol=1e-9)


@pytest.mark.parametrize("name", SPACES)
def test_spaces_do_not_depend_on_who_works(name: SpaceName) -> None:
    one, two = (make_space(LONG, name, workers=workers) for workers in (serial_executor, thread_executor(3)))
    np.testing.assert_array_equal(one.encode(LONG.points), two.encode(LONG.points))
    np.testing.assert_array_equal(one.weights, two.weights)


@pytest.mark.parametrize("name", SPACES)
def test_spaces_can_be_sent(name: SpaceName) -> None:
    space = make_space(LONG, name)
    vectors = space.encode(LONG.points[:3])
    decoded = space.decode(vectors)
    sent = pickle.loads(pickle.dumps(space))
    np.testing.assert_array_equal(sent.encode(LONG.points[:3]), vectors)
    np.testing.assert_array_equal(sent.decode(vectors), decoded)


@pytest.mark.parametrize("name", SPACES)
def test_no_vectors_are_no_frames(name: SpaceName) -> None:
    space = make_space(LONG, name)
    assert space.decode(np.zeros((0, space.dim))).shape == (0, LONG.vertex_count, 3)


@pytest.mark.parametrize("name", SPACES)
def test_no_frames_are_no_vectors(name: SpaceName) -> None:
    space = make_space(LONG, name)
    assert space.encode(LONG.points[:0]).shape == (0, space.dim)


@pytest.mark.parametrize("name", SPACES)
def test_one_pose_is_one_frame(name: SpaceName) -> None:
    """Of any real type."""
    space = make_space(LONG, name)
    pose = np.round(LONG.points[1] * 64)
    whole = space.encode(pose[None])
    for dtype in (np.float64, np.float32, np.int16):
        np.testing.assert_array_equal(space.encode(pose.astype(dtype)), whole)


@pytest.mark.parametrize("name", SPACES)
def test_frames_of_other_meshes_are_refused(name: SpaceName) -> None:
    space, points = make_space(LONG, name), LONG.points
    assert space.vertex_count == LONG.vertex_count
    for wrong in (points[:, :-1], points[:, :, :2], points[0, 0], points[None], points[:0, :-1]):
        with pytest.raises(SettingsError, match=r"points have shape .*; \(T, 38, 3\) is expected, or \(38, 3\)"):
            space.encode(wrong)
    for dtype in (np.complex128, np.bool_, np.object_):
        with pytest.raises(SettingsError, match=r"points are (complex128|bool|object); real numbers"):
            space.encode(points.astype(dtype))
    for number in (np.nan, np.inf, -np.inf):
        damaged = points.copy()
        damaged[2, 5, 1] = number
        with pytest.raises(SettingsError, match="frame 2 has points that are not finite"):
            space.encode(damaged)


@pytest.mark.parametrize("name", SPACES)
def test_vectors_of_other_spaces_are_refused(name: SpaceName) -> None:
    space = make_space(LONG, name)
    for wrong in (np.zeros(space.dim), np.zeros((2, space.dim + 1)), np.zeros((1, 1, space.dim))):
        with pytest.raises(SettingsError, match=rf"vectors have shape .*; \(T, {space.dim}\) is expected"):
            space.decode(wrong)


@pytest.mark.parametrize("name", SPACES)
def test_a_vector_is_a_shape_a_placement_and_a_correction(name: SpaceName) -> None:
    space = make_space(LONG, name)
    vectors, size = space.encode(LONG.points[:3]), space.shape_dim
    assert space.dim == size + space.placement_dim + space.correction_dim == len(space.weights)
    assert space.placement_dim == 4 * space.rotation_count + 3 * space.centre_count
    np.testing.assert_array_equal(space.shape_weights, space.weights[:size])
    placements, corrections = np.split(vectors[:, size:], [space.placement_dim], axis=1)
    poses = space.unpack_placements(placements)
    assert poses.rotations.shape == (3, space.rotation_count, 4)
    assert poses.centres.shape == (3, space.centre_count, 3)
    np.testing.assert_array_equal(space.pack_placements(poses), placements)
    assert not corrections.any()
    assert bool(space.pose_dim) == bool(space.correction_dim) == (name == "mixed")


@pytest.mark.parametrize("name", SPACES)
def test_predicted_poses_pass_through_the_frames(name: SpaceName) -> None:
    """And need no corrections there."""
    space, times = make_space(LONG, name), LONG.times
    vectors, size = space.encode(LONG.points), space.shape_dim
    poses, placements = (vectors[:, size - space.pose_dim : size], vectors[:, size : size + space.placement_dim])
    targets, placed = space.interpolate_poses(TemporalOperator(times, 2.0), poses, placements, insert_midpoints(times))
    assert placed.shape == (2 * len(times) - 1, space.placement_dim)
    np.testing.assert_allclose(placed[::2], placements, atol=1e-12)
    corrections = space.pose_corrections(poses, Poses(*(block[::2] for block in targets)))
    assert corrections.shape == (len(times), space.correction_dim)
    np.testing.assert_allclose(corrections, 0.0, atol=1e-7)


@pytest.mark.parametrize("name", SPACES)
def test_a_mesh_without_extent_has_a_unit(name: SpaceName) -> None:
    mesh = tube(4, 3)
    points = np.zeros((2, len(mesh[0]), 3))
    assert make_space(MeshSequence.from_arrays(points, mesh[1]), name).scale == 1.0


def test_reference_lengths_are_means_over_all_frames() -> None:
    """A tube that is twice as large in one of four frames: lengths are 1.25 times those of the first."""
    points, faces = tube(4, 5)
    sequence = MeshSequence.from_arrays(np.stack([points, points, 2 * points, points]), faces)
    space = make_space(sequence, "edge", EdgeSettings("dso", volume=0.25))
    assert isinstance(space, EdgeSpace)
    ends = points[space.topology.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / sequence.diagonal
    np.testing.assert_allclose(space.reference_lengths, 1.25 * lengths, rtol=1e-12)
    assert space.settings.volume == 0.25


def test_spaces_and_settings_that_do_not_go_together() -> None:
    with pytest.raises(SettingsError, match="space is 'polar'; one of mixed, "):
        make_space(LONG, "polar")  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="settings are MixedSettings; the vertex space takes NoSettings"):
        make_space(LONG, "vertex", MixedSettings())


@pytest.mark.parametrize(
    ("settings", "check"),
    [
        (MixedSettings(parts=3), lambda space: len(space.decomposition.parts) == 3),
        (MixedSettings(placement="free"), lambda space: space.placement == "free"),
        (MixedSettings(joint_width=1), lambda space: space.decomposition.widths.max() == 1),
    ],
)
def test_settings_of_the_mixed_space_are_used(settings: MixedSettings, check: Any) -> None:
    space = make_space(LONG, "mixed", settings)
    assert isinstance(space, MixedSpace)
    assert check(space)


@pytest.mark.parametrize(("name", "said"), [("mixed", 3), ("vertex", 0), ("edge", 1)])
def test_progress_counts_up(name: SpaceName, said: int) -> None:
    told: list[tuple[int, int, str]] = []
    make_space(LONG, name, progress=lambda *step: told.append(step))
    assert len({what for _, _, what in told}) == said
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert not told or told[-1][0] == told[-1][1]


def test_the_first_frame_is_the_unit_in_every_space() -> None:
    """Also where it is float32, as files have it."""
    points = bending(tube(4, 5), frames=3).astype(np.float32)
    sequence = MeshSequence.from_arrays(points, tube(4, 5)[1])
    assert {make_space(sequence, name).scale for name in SPACES} == {sequence.diagonal}


def test_misspelt_settings_are_corrected(bent_bar: MeshSequence) -> None:
    with pytest.raises(SettingsError, match="there is no setting tolerence; did you mean tolerance"):
        mixseq.fit(bent_bar, tolerence=1e-3)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="there is no setting colour; settings of spaces are joint_width, "):
        mixseq.fit(bent_bar, colour=1)  # type: ignore[call-arg]
