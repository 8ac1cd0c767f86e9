from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from mixseq.choices import SPACES, SpaceName
from mixseq.errors import SettingsError
from mixseq.mapping import on_threads, serially
from mixseq.prediction.operator import Operator, with_middles
from mixseq.sequence import MeshSequence
from mixseq.spaces import EdgeSettings, EdgeSpace, MixedSettings, MixedSpace, make_space
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
    one, two = (make_space(LONG, name, workers=workers) for workers in (serially, on_threads(3)))
    np.testing.assert_array_equal(one.encode(LONG.points), two.encode(LONG.points))
    np.testing.assert_array_equal(one.weights, two.weights)


@pytest.mark.parametrize("name", SPACES)
def test_spaces_can_be_sent(name: SpaceName) -> None:
    space = make_space(LONG, name)
    vectors = space.encode(LONG.points[:3])
    space.prepared()
    sent = pickle.loads(pickle.dumps(space))
    np.testing.assert_array_equal(sent.encode(LONG.points[:3]), vectors)
    np.testing.assert_array_equal(sent.decode(vectors), space.decode(vectors))


@pytest.mark.parametrize("name", SPACES)
def test_no_vectors_are_no_frames(name: SpaceName) -> None:
    space = make_space(LONG, name)
    assert space.decode(np.zeros((0, space.dim))).shape == (0, LONG.vertex_count, 3)


@pytest.mark.parametrize("name", SPACES)
def test_a_vector_is_a_shape_and_a_placement(name: SpaceName) -> None:
    space = make_space(LONG, name)
    vectors = space.encode(LONG.points[:3])
    assert space.dim == space.shape_dim + space.placement_dim == len(space.weights)
    assert space.placement_dim == 4 * space.rotation_count + 3 * space.centre_count
    np.testing.assert_array_equal(space.shape_weights, space.weights[: space.shape_dim])
    placements = vectors[:, space.shape_dim :]
    poses = space.poses(placements)
    assert poses.rotations.shape == (3, space.rotation_count, 4)
    assert poses.centres.shape == (3, space.centre_count, 3)
    np.testing.assert_array_equal(space.placements(poses), placements)


@pytest.mark.parametrize("name", SPACES)
def test_predicted_placements_pass_through_the_frames(name: SpaceName) -> None:
    space, times = make_space(LONG, name), LONG.times
    placements = space.encode(LONG.points)[:, space.shape_dim :]
    found = space.predicted_placements(Operator(times, 2.0), placements, with_middles(times))
    assert found.shape == (2 * len(times) - 1, space.placement_dim)
    np.testing.assert_allclose(found[::2], placements, atol=1e-14)


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
