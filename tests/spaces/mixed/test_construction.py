"""What both mixed spaces promise: exact at the frames, linear in between, blind to rigid motions."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.arrays import Float
from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rotations import product, quaternions, rotations_of
from mixseq.mapping import on_threads
from mixseq.segmentation import decompose, segment_by_labels
from mixseq.spaces.mixed import AnchoredSpace, FreeSpace, mixed_space
from tests.meshes import SEQUENCES, Mesh, bar, bending, rigid_motions, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import MESHES, error, in_both, sequence_of, space_of

both = pytest.mark.parametrize("placement", PLACEMENTS)


@both
@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_come_back(name: str, placement: PlacementName) -> None:
    points = sequence_of(name).points
    space = space_of(name, placement)
    vectors = space.encode(points)
    assert vectors.shape == (len(points), space.dim)
    assert error(space, points, space.decode(vectors)) < 1e-9


@both
@pytest.mark.parametrize("width", [1, 2, 4])
def test_frames_come_back_at_every_width(width: int, placement: PlacementName) -> None:
    points = sequence_of("bar").points
    space = space_of("bar", placement, width)
    assert any(joint.free.any() for joint in space.decomposition.joints) == (width > 1)
    assert error(space, points, space.decode(space.encode(points))) < 1e-9


@settings(max_examples=12, deadline=None)
@given(seed=seeds, mesh=st.sampled_from(MESHES), parts=st.integers(1, 7), width=st.integers(1, 4))
def test_frames_come_back_whatever_the_parts(seed: int, mesh: Mesh, parts: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    topology = topology_of(mesh)
    points = bending(mesh, frames=2) + rng.normal(size=(2, len(mesh[0]), 3)) * rng.choice([0.0, 0.02, 0.3])
    centres = mesh[0][mesh[1]].mean(axis=1)
    nearest = ((centres[:, None] - rng.choice(centres, parts)) ** 2).sum(axis=2).argmin(axis=1)
    scattered = rng.integers(0, parts, len(mesh[1]))
    labels = segment_by_labels(nearest if rng.random() < 0.7 else scattered, topology)
    decomposition = decompose(topology, labels, width, points if rng.random() < 0.5 else None)
    for placement in PLACEMENTS:
        space = mixed_space(points, topology, decomposition, placement)
        assert error(space, points, space.decode(space.encode(points))) < 1e-9


@both
def test_a_frame_that_the_space_was_not_made_for_comes_back(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    stranger = sequence_of("bar").points[2:3] * [1.2, 0.9, 1.0] + [0, 0, 0.1]
    assert error(space, stranger, space.decode(space.encode(stranger))) < 1e-9


@both
@pytest.mark.parametrize("name", ["bar", "rigid component", "still"])
def test_blocks_are_what_they_are_called(name: str, placement: PlacementName) -> None:
    space, points = space_of(name, placement), sequence_of(name).points
    x = points / space.scale
    vectors = space.encode(points)
    assert isinstance(space, AnchoredSpace | FreeSpace)
    blocks = space.split(vectors)
    assert tuple(block[0].size for block in blocks) == space.sizes
    assert space.dim == sum(space.sizes) == vectors.shape[1] == len(space.weights)
    assert space.scale == pytest.approx(np.linalg.norm(np.ptp(points[0], axis=0)))
    np.testing.assert_array_equal(blocks.lengths, edge_lengths(x, space.topology.edges[space.edge_ids]))
    angles = dihedral_angles(x, space.topology.hinges[space.hinge_ids])
    np.testing.assert_allclose(np.exp(1j * blocks.angles), np.exp(1j * angles), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(blocks.rotations, axis=2), 1.0, atol=1e-14)


@both
@pytest.mark.parametrize("name", SEQUENCES)
def test_a_vector_ends_with_quaternions_and_centres(name: str, placement: PlacementName) -> None:
    space = space_of(name, placement)
    assert isinstance(space, AnchoredSpace | FreeSpace)
    vectors = space.encode(sequence_of(name).points)
    blocks = space.split(vectors)
    assert space.rotation_count == space.centre_count == blocks.rotations.shape[1]
    assert space.placement_dim == 7 * space.rotation_count
    assert space.shape_dim == space.dim - space.placement_dim
    end = vectors[:, space.shape_dim :]
    poses = space.poses(end)
    np.testing.assert_array_equal(poses.rotations, blocks.rotations)
    np.testing.assert_array_equal(poses.centres, blocks.centres)
    np.testing.assert_array_equal(space.placements(poses), end)


@both
def test_split_and_join_are_inverse(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    vectors = np.random.default_rng(0).normal(size=(3, space.dim))
    if isinstance(space, AnchoredSpace):
        joined = space.join(space.split(vectors))
    else:
        assert isinstance(space, FreeSpace)
        joined = space.join(space.split(vectors))
    np.testing.assert_array_equal(joined, vectors)


@settings(max_examples=15, deadline=None)
@given(motion=rigid_motions, placement=st.sampled_from(PLACEMENTS), frame=st.integers(0, 4))
def test_a_rigid_motion_changes_the_pose_only(
    motion: tuple[Float, Float], placement: PlacementName, frame: int
) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points[frame]
    turn, shift = motion
    still, moved = space.encode(points[None]), space.encode((points @ turn.T + shift)[None])
    shape = space.shape_dim
    np.testing.assert_allclose(moved[:, :shape], still[:, :shape], atol=1e-10)
    before, after = space.poses(still[:, shape:]), space.poses(moved[:, shape:])
    np.testing.assert_allclose(
        rotations_of(after.rotations), turn @ rotations_of(before.rotations), atol=1e-10
    )
    np.testing.assert_allclose(after.centres, before.centres @ turn.T + shift / space.scale, atol=1e-10)


@settings(max_examples=6, deadline=None)
@given(motion=rigid_motions, placement=st.sampled_from(PLACEMENTS))
def test_decoding_moves_with_the_pose(motion: tuple[Float, Float], placement: PlacementName) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points
    turn, shift = motion
    middle = space.encode(points)[[1, 3]].mean(axis=0, keepdims=True)
    poses = space.poses(middle[:, space.shape_dim :])
    carried = poses._replace(
        rotations=product(quaternions(turn), poses.rotations),
        centres=poses.centres @ turn.T + shift / space.scale,
    )
    moved = np.concatenate([middle[:, : space.shape_dim], space.placements(carried)], axis=1)
    expected = space.decode(middle)[0] @ turn.T + shift
    assert error(space, expected, space.decode(moved)[0]) < 1e-7


@both
def test_one_part_is_a_body_with_a_pose(placement: PlacementName) -> None:
    """Half way between two poses it has turned by half the angle."""
    mesh = tube(5, 4)
    axis, angle = np.array([1.0, 2, 2]) / 3, 2.8
    points = np.stack([mesh[0], mesh[0] @ rotation(axis * angle).T + [1, 2, 3]])
    topology = topology_of(mesh)
    labels = np.zeros(len(mesh[1]), dtype=np.int64)
    space = mixed_space(points, topology, decompose(topology, labels), placement)
    vectors = space.encode(points)
    poses = space.poses(vectors[:, space.shape_dim :])
    turned = rotations_of(poses.rotations[1, 0]) @ rotations_of(poses.rotations[0, 0]).T
    np.testing.assert_allclose(turned, rotation(axis * angle), atol=1e-12)
    np.testing.assert_allclose(poses.centres[:, 0] * space.scale, points.mean(axis=1), atol=1e-12)
    half = space.decode(vectors.mean(axis=0, keepdims=True))[0]
    centre, moved = mesh[0].mean(axis=0), points[1].mean(axis=0)
    expected = (mesh[0] - centre) @ rotation(axis * angle / 2).T + (centre + moved) / 2
    assert error(space, expected, half) < 1e-12


@both
def test_shapes_of_a_part_blend_linearly(placement: PlacementName) -> None:
    """A body that swells by s and by 3s is 2s between."""
    mesh = tube(6, 5, length=1.0)
    centred = mesh[0] - mesh[0].mean(axis=0)
    points = np.stack([centred, 3 * centred @ rotation((0.5, -1.0, 0.3)).T])
    topology = topology_of(mesh)
    labels = np.zeros(len(mesh[1]), dtype=np.int64)
    space = mixed_space(points, topology, decompose(topology, labels), placement)
    assert space.dim == 3 * len(centred) + 7
    vectors = space.encode(points)
    np.testing.assert_allclose(vectors[1, : space.shape_dim], 3 * vectors[0, : space.shape_dim], atol=1e-12)
    decoded = space.decode(vectors.mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(decoded, 2 * centred @ rotation((0.25, -0.5, 0.15)).T, atol=1e-12)


@both
def test_affine_combinations_are_weighted_sums(placement: PlacementName) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points
    assert isinstance(space, AnchoredSpace | FreeSpace)
    vectors = space.encode(points)
    weights = np.array([0.5, -0.25, 0.25, 0.0, 0.5])
    assert weights.sum() == 1
    combined = (weights @ vectors)[None]
    assert np.isfinite(space.decode(combined)).all()
    for block, own in zip(space.split(combined), space.split(vectors), strict=True):
        np.testing.assert_allclose(block[0], np.tensordot(weights, own, 1), atol=1e-14)


@pytest.mark.parametrize("name", ["bar", "rigid component", "several components"])
def test_encoding_block_by_block_is_encoding(name: str) -> None:
    for space in in_both(name):
        points = sequence_of(name).points
        whole = space.encode(points)
        first = space.encode(points[:2])
        second = space.encode(points[2:3], previous=first[-1])
        third = space.encode(points[3:], previous=second[-1])
        np.testing.assert_allclose(np.concatenate([first, second, third]), whole, atol=1e-13)
        np.testing.assert_array_equal(space.unwrap(space.encode_apart(points)), whole)


@both
def test_signs_go_on_when_a_body_turns_twice(placement: PlacementName) -> None:
    mesh = tube(6, 13)
    axis, frames = np.array([2.0, -1, 2]) / 3, 13
    angles = np.linspace(0, 4 * np.pi, frames)
    points = np.stack([mesh[0] @ rotation(axis * angle).T for angle in angles])
    topology = topology_of(mesh)
    labels = segment_by_labels((mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2).astype(int), topology)
    space = mixed_space(points, topology, decompose(topology, labels, 2), placement)
    vectors = space.encode(points)
    rotations = space.poses(vectors[:, space.shape_dim :]).rotations
    half = angles[:, None, None] / 2
    expected = np.concatenate([np.cos(half), np.sin(half) * axis], axis=2)
    np.testing.assert_allclose(rotations, np.broadcast_to(expected, rotations.shape), atol=1e-7)
    assert error(space, points, space.decode(vectors)) < 1e-9
    block = space.encode(points[6:], previous=vectors[5])
    np.testing.assert_allclose(block, vectors[6:], atol=1e-9)


@both
def test_hinges_that_fold_over_are_unwrapped(placement: PlacementName) -> None:
    """A hinge that closes past 180 degrees goes on growing, so that half way is not its mirror image."""
    angles = np.radians([150.0, 190.0, 250.0, 310.0, 370.0, 410.0])
    points = []
    for angle in angles:
        fold = rotation((-angle, 0, 0))
        flap = np.array([[0.0, -1, 0], [1, -1, 0], [0, -2, 0], [1, -2, 0], [0, -3, 0], [1, -3, 0]]) @ fold.T
        sheet = [[0.0, 2, 0], [1, 2, 0], [0.0, 1, 0], [1, 1, 0], [0, 0, 0], [1, 0, 0]]
        points.append(np.concatenate([sheet, flap]))
    frames = np.stack(points) * [1.0, 1.0, -1.0]
    strip = np.array([[0, 1, 2], [2, 1, 3]])
    faces = np.concatenate([strip + 2 * k for k in range(5)])
    mesh = frames[0], faces
    topology = topology_of(mesh)
    number = int(np.flatnonzero((np.sort(topology.hinges[:, :2], axis=1) == [4, 5]).all(axis=1))[0])
    raw = dihedral_angles(frames, topology.hinges[[number]])[:, 0]
    assert np.abs(np.diff(raw)).max() > np.pi  # the hinge does pass half a turn

    labels = np.repeat([0, 1], [4, 6])
    decomposition = decompose(topology, labels, 1 if placement == "free" else 2)
    space = mixed_space(frames, topology, decomposition, placement)
    assert isinstance(space, AnchoredSpace | FreeSpace)
    column = np.flatnonzero(space.hinge_ids == number)
    assert column.size == 1
    vectors = space.encode(frames)
    stored = space.split(vectors).angles[:, column[0]]
    np.testing.assert_allclose(np.diff(stored), np.sign(stored[0]) * np.diff(angles), atol=1e-9)
    block = space.encode(frames[4:], previous=vectors[3])  # by now nearer to the first frame on another turn
    np.testing.assert_allclose(block, vectors[4:], atol=1e-12)


@both
def test_a_still_sequence_does_not_move_between_its_frames(placement: PlacementName) -> None:
    space, points = space_of("still", placement), sequence_of("still").points
    vectors = space.encode(points)
    np.testing.assert_array_equal(vectors, np.broadcast_to(vectors[0], vectors.shape))
    assert error(space, points[:1], space.decode(vectors[:1] * 0.3 + vectors[1:2] * 0.7)) < 1e-12


@both
def test_a_point_mesh_has_no_size_but_comes_back(placement: PlacementName) -> None:
    mesh = tube(5, 6)
    points = np.full((2, len(mesh[0]), 3), 7.0)
    topology = topology_of(mesh)
    labels = (np.arange(len(mesh[1])) > 20).astype(np.int64)
    space = mixed_space(points, topology, decompose(topology, labels, 3, points), placement)
    assert space.scale == 1.0
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-9)


@both
def test_changes_by_hand_arrive(placement: PlacementName) -> None:
    """What `shape_difference` says, added to the shape, moves the vertices that were moved, and no others."""
    space = space_of("bar", placement)
    vectors = space.encode(sequence_of("bar").points)
    vector = vectors[2] if placement == "free" else vectors[[1, 3]].mean(axis=0)
    before = space.decode(vector[None])[0]
    after = before.copy()
    after[[3, 100, 101]] += 0.02 * space.scale * np.array([[1, 0, 1], [1, 1, 0], [0, 1, -1]])
    change = space.shape_difference(vector, before, after)
    assert change.shape == (space.shape_dim,)
    assert not space.shape_difference(vector, before, before).any()
    vector[: space.shape_dim] += change
    assert error(space, after, space.decode(vector[None])[0]) < (2e-2 if placement == "free" else 1e-12)


def test_settings_are_checked() -> None:
    sequence = bar(frames=2)
    topology = topology_of((sequence.points[0], sequence.faces.astype(np.int64)))
    whole = decompose(topology, np.zeros(len(sequence.faces), dtype=np.int64))
    with pytest.raises(SettingsError, match=r"placement is 'loose'; 'anchored' or 'free' is expected"):
        mixed_space(sequence.points, topology, whole, "loose")  # type: ignore[arg-type]
    for placement in PLACEMENTS:
        space = mixed_space(sequence.points, topology, whole, placement)
        for wrong in (np.zeros(space.dim), np.zeros((2, space.dim + 1)), np.zeros((1, 1, space.dim))):
            with pytest.raises(SettingsError, match=rf"\(T, {space.dim}\) is expected"):
                space.decode(wrong)
        with pytest.raises(SettingsError, match="is expected"):
            space.encode(sequence.points, previous=np.zeros(3))


@both
def test_decoding_tells_its_progress(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    told: list[tuple[int, int, str]] = []
    vectors = space.encode(sequence_of("bar").points[:3])
    space.decode(vectors, progress=lambda *step: told.append(step))
    assert told == [(1, 3, "decoding frames"), (2, 3, "decoding frames"), (3, 3, "decoding frames")]


@both
def test_making_tells_its_progress_to_the_end(placement: PlacementName) -> None:
    points, space = sequence_of("bar").points, space_of("bar", placement)
    told: list[tuple[int, int, str]] = []
    mixed_space(
        points, space.topology, space.decomposition, placement, progress=lambda *step: told.append(step)
    )
    assert "registering parts" in {what for _, _, what in told}
    assert told[-1][0] == told[-1][1]


@both
def test_no_vectors_decode_to_no_frames(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    nothing = np.zeros((0, space.dim))
    shape = (0, space.topology.vertex_count, 3)
    assert space.decode(nothing).shape == shape
    assert [moving.shape for moving in space.decode_moving(nothing, nothing)] == [shape, shape]


@both
def test_spaces_are_the_same_whoever_makes_them_and_can_be_sent(placement: PlacementName) -> None:
    points, space = sequence_of("bar").points, space_of("bar", placement)
    other = mixed_space(points, space.topology, space.decomposition, placement, workers=on_threads(3))
    vectors = space.encode(points)
    np.testing.assert_array_equal(other.encode(points), vectors)
    space.prepared()
    sent = pickle.loads(pickle.dumps(space))
    np.testing.assert_array_equal(sent.encode(points), vectors)
    np.testing.assert_array_equal(sent.decode(vectors), space.decode(vectors))
