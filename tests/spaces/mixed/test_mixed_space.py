"""The mixed shape space: exact at the frames, blind to where bodies are, and steered by lengths and angles."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.choices import PLACEMENTS, PlacementName
from mixseq.errors import ReconstructionError, SettingsError
from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rigid import kabsch, transform_points
from mixseq.mesh.rotations import matrix_to_quat, normalise_quat, quat_multiply, quat_to_matrix, rotate_vectors
from mixseq.segmentation.joints import decompose
from mixseq.segmentation.methods import segment_by_labels
from mixseq.spaces.base import ANGLE_WEIGHT, VertexSpace
from mixseq.spaces.mixed.construction import Purpose, mixed_space
from mixseq.spaces.mixed.mixed_space import (
    ARTICULATION_WEIGHT,
    JOINT_EMBEDDING_WEIGHT,
    JOINT_WEIGHT,
    MixedSpace,
    Projection,
    as_mixed,
)
from mixseq.spaces.temporal import Poses, TemporalOperator, insert_midpoints, interpolate_poses
from mixseq.types import Float
from tests.meshes import SEQUENCES, Mesh, bending, bent, rigid_motions, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import (
    MESHES,
    chain,
    error,
    in_all_ways,
    labels_of,
    of_slices,
    sequence_of,
    space_of,
    steered,
)

both = pytest.mark.parametrize("placement", PLACEMENTS)

MOVING = ["bar", "folding sheet", "several components", "three pages", "inconsistent", "bowtie"]


def at(space: MixedSpace, vectors: Float, operator: TemporalOperator, times: Float) -> Float:
    """Vectors at times, as an exact model has them."""
    size, end = space.shape_dim, space.shape_dim + space.placement_dim
    poses = vectors[:, size - space.pose_dim : size]
    targets, placed = space.interpolate_poses(operator, poses, vectors[:, size:end], times)
    shapes = operator.weights_at(times).interpolate(vectors[:, :size])
    corrections = space.pose_corrections(shapes[:, size - space.pose_dim :], targets)
    return np.concatenate([shapes, placed, corrections], axis=1)


def with_placement(space: MixedSpace, vectors: Float, turn: Float, shift: Float) -> Float:
    """Vectors whose bodies are all moved, in diagonals."""
    blocks = space.split(vectors)
    turns = quat_multiply(matrix_to_quat(turn), blocks.body_rotations)
    return space.join(blocks._replace(body_rotations=turns, body_centres=blocks.body_centres @ turn.T + shift))


# Frames come back -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_come_back(name: str) -> None:
    points = sequence_of(name).points
    for space in in_all_ways(name):
        vectors = space.encode(points)
        assert vectors.shape == (len(points), space.dim)
        assert error(space, points, space.decode(vectors)) < 1e-9


@both
@pytest.mark.parametrize("width", [1, 2, 4])
def test_frames_come_back_at_every_width(width: int, placement: PlacementName) -> None:
    points = sequence_of("bar").points
    space = space_of("bar", placement, width=width)
    assert error(space, points, space.decode(space.encode(points))) < 1e-9


@pytest.mark.parametrize("unit", [1e-12, 1e-3, 1e9])
@pytest.mark.parametrize("away", [0.0, 1e3])
def test_frames_come_back_in_any_unit_and_far_away(unit: float, away: float) -> None:
    points = unit * (sequence_of("bar").points + away)
    topology, labels = labels_of("bar")
    for placement in PLACEMENTS:
        space = mixed_space(points, topology, decompose(topology, labels, 3, points), placement)
        assert error(space, points, space.decode(space.encode(points))) < 1e-9


@settings(max_examples=8, deadline=None)
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
    made = [mixed_space(points, topology, decomposition, placement) for placement in PLACEMENTS]
    made.append(mixed_space(points, topology, decomposition, purpose="blends"))
    made.append(replace(made[0], joint_faces=rng.random(len(mesh[1])) < 0.5, projection=Projection(share=1.0)))
    for space in made:
        assert error(space, points, space.decode(space.encode(points))) < 1e-9


@pytest.mark.parametrize("place", ["middle", "corner"])
@pytest.mark.parametrize("shift", [0.0, 0.1])
def test_frames_come_back_in_which_triangles_lose_their_area(place: str, shift: float) -> None:
    """As eyelids do that close; rounding determines their normals."""
    mesh = tube(6, 17)
    points, topology = bending(mesh), topology_of(mesh)
    for face in (90, 95, 102, 120):
        a, b, c = mesh[1][face]
        points[2, c] = points[2, a] if place == "corner" else (points[2, a] + points[2, b]) / 2
    points += shift * np.arange(1, 4)
    labels = segment_by_labels((mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2).astype(int), topology)
    space = mixed_space(points, topology, decompose(topology, labels, 3, points), purpose="blends")
    for faces in (space.joint_faces, np.ones_like(space.joint_faces)):
        for steps in (0, 8):
            told = replace(space, joint_faces=faces, projection=Projection(share=1.0, steps=steps))
            assert error(told, points, told.decode(told.encode(points))) < 1e-9


def test_frames_that_the_space_was_not_made_for_come_back() -> None:
    for space in in_all_ways("bar"):
        stranger = sequence_of("bar").points[2:3] * [1.2, 0.9, 1.0] + [0, 0, 0.1]
        assert error(space, stranger, space.decode(space.encode(stranger))) < 1e-9


@both
def test_a_point_mesh_has_no_size_but_comes_back(placement: PlacementName) -> None:
    mesh = tube(5, 6)
    points = np.full((2, len(mesh[0]), 3), 7.0)
    topology = topology_of(mesh)
    labels = (np.arange(len(mesh[1])) > 20).astype(np.int64)
    space = mixed_space(points, topology, decompose(topology, labels, 3, points), placement)
    assert space.scale == 1.0
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-9)


def test_encoding_block_by_block_is_encoding() -> None:
    for name in ("bar", "rigid component", "several components"):
        for space in in_all_ways(name):
            points = sequence_of(name).points
            whole = space.encode(points)
            first = space.encode(points[:2])
            second = space.encode(points[2:3], previous=first[-1])
            third = space.encode(points[3:], previous=second[-1])
            np.testing.assert_allclose(np.concatenate([first, second, third]), whole, atol=1e-13)
            np.testing.assert_array_equal(space.unwrap(space.encode_independently(points)), whole)
            np.testing.assert_array_equal(space.encode(points[0]), whole[:1])


@both
def test_no_vectors_decode_to_no_frames(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    nothing, shape = np.zeros((0, space.dim)), (0, space.vertex_count, 3)
    assert space.decode(nothing).shape == shape
    assert [moving.shape for moving in space.decode_with_velocities(nothing, nothing)] == [shape, shape]
    assert space.encode(np.zeros(shape)).shape == nothing.shape


@both
def test_vectors_of_other_spaces_are_refused(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    for wrong in (np.zeros(space.dim), np.zeros((2, space.dim + 1)), np.zeros((1, 1, space.dim))):
        for decode in (space.decode, space.split, lambda v: space.decode_with_velocities(v, v)):
            with pytest.raises(SettingsError, match=rf"\(T, {space.dim}\) is expected"):
                decode(wrong)


def test_spaces_can_be_sent() -> None:
    points = sequence_of("bar").points
    for space in in_all_ways("bar"):
        vectors = space.encode(points)
        decoded = space.decode(vectors)
        sent = pickle.loads(pickle.dumps(space))
        np.testing.assert_array_equal(sent.encode(points), vectors)
        np.testing.assert_array_equal(sent.decode(vectors), decoded)


def test_as_mixed_is_for_the_mixed_space_alone() -> None:
    space = space_of("bar")
    assert as_mixed(space) is space
    with pytest.raises(SettingsError, match="the vertex space has no parts; fit a model with space='mixed'"):
        as_mixed(VertexSpace(3, 1.0))


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"share": -0.1}, "share is -0.1; a number from 0 to 1"),
        ({"share": 1.5}, "share is 1.5; a number from 0 to 1"),
        ({"share": np.nan}, "share is nan; a number from 0 to 1"),
        ({"hold": 0.0}, "hold is 0.0; a positive weight"),
        ({"relations": np.inf}, "relations is inf; a positive weight"),
        ({"steps": -1}, "steps is -1; a whole number of 0 or more"),
        ({"steps": 1.5}, "steps is 1.5; a whole number of 0 or more"),
    ],
)
def test_projections_are_checked(settings_: dict[str, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Projection(**settings_)  # type: ignore[arg-type]


# The vector -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["bar", "rigid component", "still", "unused vertices"])
def test_blocks_are_what_they_are_called(name: str) -> None:
    points = sequence_of(name).points
    for space in in_all_ways(name):
        x, vectors = points / space.scale, space.encode(points)
        blocks = space.split(vectors)
        assert tuple(block[0].size for block in blocks) == space.block_sizes
        assert space.dim == sum(space.block_sizes) == vectors.shape[1] == len(space.weights)
        assert space.dim == space.shape_dim + space.placement_dim + space.correction_dim
        assert space.scale == pytest.approx(np.linalg.norm(np.ptp(points[0], axis=0)))
        np.testing.assert_array_equal(blocks.lengths, edge_lengths(x, space.topology.edges[space.edge_ids]))
        angles = dihedral_angles(x, space.topology.hinges[space.hinge_ids])
        np.testing.assert_allclose(np.exp(1j * blocks.angles), np.exp(1j * angles), atol=1e-12)
        for turns in (blocks.part_rotations, blocks.relation_rotations, blocks.body_rotations):
            np.testing.assert_allclose(np.linalg.norm(turns, axis=2), 1.0, atol=1e-12)
        assert not blocks.corrections.any()
        np.testing.assert_array_equal(space.join(blocks), vectors)
        size = space.shape_dim
        poses = space.split_poses(vectors[:, size - space.pose_dim : size])
        for found, expected in zip(poses, blocks.part_poses, strict=True):
            np.testing.assert_array_equal(found, expected)
        placed = space.unpack_placements(vectors[:, size : size + space.placement_dim])
        np.testing.assert_array_equal(placed.rotations, blocks.body_rotations)
        np.testing.assert_array_equal(placed.centres, blocks.body_centres)


def test_parts_are_where_their_poses_say() -> None:
    """Turned since the reference frame, and seen from their body."""
    space, points = space_of("rigid component"), sequence_of("rigid component").points
    assert (len(space.decomposition.parts), space.rotation_count, space.centre_count) == (3, 2, 2)
    x, blocks = points / space.scale, space.split(space.encode(points))
    bodies = Poses(blocks.body_rotations, blocks.body_centres)
    world = space.articulation.to_world_axes(Poses(blocks.part_rotations, blocks.part_centres), bodies)
    for number, part in enumerate(space.decomposition.parts):
        np.testing.assert_allclose(world.centres[:, number], x[:, part].mean(axis=1), atol=1e-12)
        turn = quat_to_matrix(world.rotations[:, number])[:, None]
        placed = rotate_vectors(turn, x[0, part] - x[0, part].mean(axis=0)) + world.centres[:, number, None]
        assert np.linalg.norm(placed - x[:, part], axis=2).max() < 0.05  # nearly rigid


def test_the_reference_is_unposed_as_it_is() -> None:
    """But for its mean shapes: parts stand in the first frame as they do in the reference."""
    space, points = space_of("three pages"), sequence_of("three pages").points
    blocks = space.split(space.encode(points[:1]))
    np.testing.assert_allclose(blocks.rest_vertices[0], space.reference, atol=1e-5)
    np.testing.assert_allclose(blocks.body_rotations[0, 0], [1, 0, 0, 0], atol=1e-5)


def test_inside_a_part_unposed_vertices_are_the_aligned_ones() -> None:
    """As the paper has them, but where the part is in the reference frame."""
    space, points = space_of("bar"), sequence_of("bar").points
    unposed = space.split(space.encode(points)).rest_vertices
    starts = np.cumsum([0, *map(len, space.decomposition.parts)])
    for number, part in enumerate(space.decomposition.parts):
        own = space.rigid_part_of_vertex[part] == number
        assert own.any()
        shape = space.shapes[starts[number] : starts[number + 1]]
        rest = kabsch(shape, space.reference[part])
        for frame, x in zip(unposed, points / space.scale, strict=True):
            aligned = transform_points(x[part], *kabsch(x[part], shape))
            np.testing.assert_allclose(frame[part[own]], transform_points(aligned, *rest)[own], atol=1e-9)


@pytest.mark.parametrize("name", ["bar", "several components", "unused vertices"])
@settings(max_examples=10, deadline=None)
@given(motion=rigid_motions, frame=st.integers(0, 3), purpose=st.sampled_from(["sequence", "blends"]))
def test_a_rigid_motion_of_a_frame_changes_the_placement_only(
    name: str, motion: tuple[Float, Float], frame: int, purpose: Purpose
) -> None:
    space, points = space_of(name, purpose=purpose), sequence_of(name).points[frame]
    turn, shift = motion
    still, moved = space.encode(points), space.encode(points @ turn.T + shift)
    shape = space.shape_dim
    np.testing.assert_allclose(moved[:, :shape], still[:, :shape], atol=1e-9)
    before, after = (space.unpack_placements(each[:, shape : shape + space.placement_dim]) for each in (still, moved))
    np.testing.assert_allclose(quat_to_matrix(after.rotations), turn @ quat_to_matrix(before.rotations), atol=1e-9)
    np.testing.assert_allclose(after.centres, before.centres @ turn.T + shift / space.scale, atol=1e-9)


@settings(max_examples=10, deadline=None)
@given(motion=rigid_motions)
def test_decoding_moves_with_the_placement(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    for space in in_all_ways("bar"):
        middle = space.encode(sequence_of("bar").points)[[1, 3]].mean(axis=0, keepdims=True)
        expected = space.decode(middle)[0] @ turn.T + shift
        decoded = space.decode(with_placement(space, middle, turn, shift / space.scale))[0]
        assert error(space, expected, decoded) < 1e-7


@settings(max_examples=12, deadline=None)
@given(motion=rigid_motions, steps=st.sampled_from([0, 8]), weight=st.sampled_from([0.25, 0.5, 1.5]))
def test_blends_do_not_depend_on_how_poses_are_turned(motion: tuple[Float, Float], steps: int, weight: float) -> None:
    """As shapes: the blend itself is turned by a share of it."""
    turn, shift = motion
    points = sequence_of("bar").points
    for space in (space_of("bar"), steered("bar", 1.0, steps)):
        found = []
        for second in (points[4], points[4] @ turn.T + shift):
            vectors = space.encode(np.stack([points[0], second]))
            found.append(space.decode((np.array([1 - weight, weight]) @ vectors)[None])[0])
        here, there = found
        assert error(space, here, transform_points(there, *kabsch(there, here))) < 1e-6


@pytest.mark.parametrize("name", ["bar", "rigid component"])
def test_the_metric_is_in_diagonals(name: str) -> None:
    space = steered(name)
    weights = space.split(space.weights[None])
    edges = space.topology.edges[space.topology.hinge_edges[space.hinge_ids]]
    angle = ANGLE_WEIGHT * edge_lengths(space.reference, edges)
    own = ARTICULATION_WEIGHT * np.sqrt([len(part) for part in space.decomposition.parts])
    np.testing.assert_array_equal(weights.lengths, np.full((1, len(space.edge_ids)), JOINT_WEIGHT))
    np.testing.assert_allclose(weights.angles[0], JOINT_WEIGHT * angle, rtol=1e-12)
    assert (weights.rest_vertices == 1).all() and (weights.body_centres == 1).all()
    np.testing.assert_allclose(weights.part_rotations[0], np.tile((2 * space.part_radii * own)[:, None], 4), rtol=1e-12)
    np.testing.assert_allclose(weights.part_centres[0], np.tile(own[:, None], 3), rtol=1e-12)
    assert not weights.relation_rotations.any() and not weights.relation_points.any()
    spins, shifts = weights.corrections.reshape(2, -1, 3)
    np.testing.assert_array_equal(spins, np.tile(space.part_radii[:, None], 3))
    assert (shifts == 1).all()
    embedding = space.embedding_weights
    lengths, angles = space.block_sizes[:2]
    np.testing.assert_array_equal(embedding[:lengths], JOINT_EMBEDDING_WEIGHT)
    np.testing.assert_allclose(embedding[lengths : lengths + angles], JOINT_EMBEDDING_WEIGHT * angle)
    assert len(embedding) == space.shape_dim == len(space.shape_weights)


def test_a_placement_that_changes_moves_vertices_by_its_weight() -> None:
    """Root mean square over the vertices of a body, for changes that keep the length of its quaternion."""
    space = space_of("rigid component")
    vectors = space.encode(sequence_of("rigid component").points[:1])
    body = int(space.articulation.body_of_part[2])  # the moon, which no joint touches
    turns = space.split(vectors).body_rotations[0, body]
    rates = np.zeros((3, space.dim))
    for axis in range(3):
        across = np.eye(4)[axis] - turns * turns[axis]
        space.split(rates).body_rotations[axis, body] = across / np.linalg.norm(across)
    _, velocities = space.decode_with_velocities(np.repeat(vectors, 3, axis=0), rates)
    moved = np.linalg.norm(velocities[:, space.decomposition.parts[2]], axis=2) / space.scale
    weight = space.split(space.weights[None]).body_rotations[0, body, 0]
    assert np.sqrt(np.square(moved).mean()) == pytest.approx(weight * np.sqrt(2 / 3), rel=0.05)


# Between frames -------------------------------------------------------------------------------------------


def test_one_part_is_a_body_with_a_pose() -> None:
    """Half way between two poses it has turned by half the angle."""
    mesh = tube(5, 4)
    axis, angle = np.array([1.0, 2, 2]) / 3, 2.8
    points = np.stack([mesh[0], mesh[0] @ rotation(axis * angle).T + [1, 2, 3]])
    centre, moved = mesh[0].mean(axis=0), points[1].mean(axis=0)
    expected = (mesh[0] - centre) @ rotation(axis * angle / 2).T + (centre + moved) / 2
    topology = topology_of(mesh)
    whole = decompose(topology, np.zeros(len(mesh[1]), dtype=np.int64))
    for placement in PLACEMENTS:
        space = mixed_space(points, topology, whole, placement)
        assert space.block_sizes == (0, 0, 3 * len(mesh[0]), 4, 3, 0, 0, 4, 3, 6)
        vectors = space.encode(points)
        poses = space.split(vectors)
        between = quat_to_matrix(poses.body_rotations[1, 0]) @ quat_to_matrix(poses.body_rotations[0, 0]).T
        np.testing.assert_allclose(between, rotation(axis * angle), atol=1e-12)
        np.testing.assert_allclose(poses.part_rotations, np.tile(np.eye(4)[0], (2, 1, 1)), atol=1e-12)
        half = space.decode(vectors.mean(axis=0, keepdims=True))[0]
        assert error(space, expected, half) < 1e-12


def test_shapes_of_a_part_blend_linearly() -> None:
    """A body that swells by s and by 3s is 2s between."""
    mesh = tube(6, 5, length=1.0)
    centred = mesh[0] - mesh[0].mean(axis=0)
    points = np.stack([centred, 3 * centred @ rotation((0.5, -1.0, 0.3)).T])
    topology = topology_of(mesh)
    whole = decompose(topology, np.zeros(len(mesh[1]), dtype=np.int64))
    for placement in PLACEMENTS:
        space = mixed_space(points, topology, whole, placement)
        vectors = space.encode(points)
        decoded = space.decode(vectors.mean(axis=0, keepdims=True))[0]
        np.testing.assert_allclose(decoded, 2 * centred @ rotation((0.25, -0.5, 0.15)).T, atol=1e-9)


def test_affine_combinations_are_weighted_sums() -> None:
    for space in in_all_ways("bar"):
        vectors = space.encode(sequence_of("bar").points)
        weights = np.array([0.5, -0.25, 0.25, 0.0, 0.5])
        combined = (weights @ vectors)[None]
        assert np.isfinite(space.decode(combined)).all()
        for block, own in zip(space.split(combined), space.split(vectors), strict=True):
            np.testing.assert_allclose(block[0], np.tensordot(weights, own, 1), atol=1e-14)


def test_decoding_is_posing_then_moving_joints() -> None:
    for name in MOVING:
        space = steered(name, 0.5)
        vectors = space.encode(sequence_of(name).points).mean(axis=0, keepdims=True)
        blocks, posed = space.split(vectors), space.skin(vectors)
        expected = space.joint_projection.project(posed[0], blocks.lengths[0], blocks.angles[0], 0.5)
        np.testing.assert_allclose(space.decode(vectors)[0] / space.scale, expected, atol=1e-13)
        plain = replace(space, projection=Projection(share=0.0))
        np.testing.assert_allclose(plain.decode(vectors) / space.scale, posed, atol=1e-13)


def test_decoding_is_linear_in_unposed_vertices() -> None:
    space = space_of("bar")
    vectors = space.encode(sequence_of("bar").points)
    start = sum(space.block_sizes[:3])
    vectors[:, start:] = vectors[2, start:]
    weights = np.array([0.5, -0.25, 0.75, 0.0, 0.0])
    combined = space.decode((weights @ vectors)[None])[0]
    assert error(space, np.tensordot(weights, space.decode(vectors), 1), combined) < 1e-12


@pytest.mark.parametrize(("share", "steps"), [(0.25, 0), (1.0, 0), (1.0, 8)])
def test_longer_lengths_make_joints_longer(share: float, steps: int) -> None:
    """Where they count; where they do not, nothing moves."""
    space = steered("bar", share, steps)
    vectors = space.encode(sequence_of("bar").points[:1])
    space.split(vectors).lengths[:] *= 1.1
    edges = space.topology.edges
    grown = edge_lengths(space.decode(vectors), edges) / edge_lengths(sequence_of("bar").points[:1], edges)
    assert 1.0 + 0.3 * share * 0.1 < np.median(grown) < 1.105
    still = replace(space, projection=Projection(share=0.0))
    assert error(still, sequence_of("bar").points[:1], still.decode(vectors)) < 1e-12


def test_half_way_a_joint_bends_by_half() -> None:
    """Of two frames, a quarter turn apart: vertices that no blend touches are where they were."""
    mesh = tube(8, 33)
    points = np.stack([bent(mesh[0], angle) for angle in np.radians([0.0, 30.0, 60.0, 90.0])])
    space = of_slices(points, mesh, 2.0)
    operator = TemporalOperator(np.arange(4.0))
    middle = space.decode(at(space, space.encode(points), operator, np.array([1.5])))[0]
    expected = bent(mesh[0], np.radians(45))
    splined = operator.weights_at(np.array([1.5])).interpolate(points)[0]
    assert np.abs(middle - expected).max() < 0.15 * np.abs(splined - expected).max()
    rigid = np.abs(mesh[0][:, 2] - 2) > 1
    assert np.abs(middle - expected)[rigid].max() < 0.1 * np.abs(splined - expected)[rigid].max()


def test_between_frames_a_body_turns_as_evenly_as_at_them() -> None:
    """By 160 degrees a frame, several times around."""
    mesh = tube(6, 9)
    axis, step = np.array([2.0, -1, 2]) / 3, np.radians(160)
    centred = mesh[0] - mesh[0].mean(axis=0)
    points = np.stack([centred @ rotation(axis * step * number).T for number in range(8)])
    space = of_slices(points, mesh)
    times = np.linspace(0, 7, 50)
    decoded = space.decode(at(space, space.encode(points), TemporalOperator(np.arange(8.0)), times))
    expected = np.stack([centred @ rotation(axis * step * time).T for time in times])
    assert error(space, expected, decoded) < 1e-9


@pytest.mark.parametrize(("links", "degrees"), [(4, 100.0), (4, 170.0), (6, 120.0)])
def test_nothing_jumps_when_parts_far_apart_turn_past_half_a_turn(links: int, degrees: float) -> None:
    """The ends of the chain turn against each other by up to 600 degrees, neighbours by less than 180."""
    bends = np.radians(np.linspace(0, degrees, 11))
    points, mesh = chain(bends, links)
    space = of_slices(points, mesh, *(4.0 * number for number in range(1, links)))
    assert len(space.decomposition.parts) == links
    vectors = space.encode(points)
    assert error(space, points, space.decode(vectors)) < 1e-12
    frames = np.arange(11.0)
    times = np.linspace(0, 10, 201)
    decoded = space.decode(at(space, vectors, TemporalOperator(frames), times))
    truth, _ = chain(np.interp(times, frames, bends), links)
    splined = TemporalOperator(frames).weights_at(times).interpolate(points)
    steps, true_steps = (np.linalg.norm(np.diff(x, axis=0), axis=2).max() for x in (decoded, truth))
    assert steps < 1.05 * true_steps
    assert np.abs(decoded - truth).max() < 0.3 * np.abs(splined - truth).max()


def test_signs_go_on_when_a_body_turns_twice() -> None:
    mesh = tube(6, 13)
    axis, angles = np.array([2.0, -1, 2]) / 3, np.linspace(0, 4 * np.pi, 13)
    points = np.stack([mesh[0] @ rotation(axis * angle).T for angle in angles])
    space = of_slices(points, mesh, 2.0, width=2)
    vectors = space.encode(points)
    half = angles[:, None] / 2
    expected = np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)
    np.testing.assert_allclose(space.split(vectors).body_rotations[:, 0], expected, atol=1e-5)
    block = space.encode(points[6:], previous=vectors[5])
    np.testing.assert_allclose(block, vectors[6:], atol=1e-9)


def test_hinges_that_fold_over_are_unwrapped() -> None:
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
    mesh = frames[0], np.concatenate([strip + 2 * k for k in range(5)])
    topology = topology_of(mesh)
    number = int(np.flatnonzero((np.sort(topology.hinges[:, :2], axis=1) == [4, 5]).all(axis=1))[0])
    raw = dihedral_angles(frames, topology.hinges[[number]])[:, 0]
    assert np.abs(np.diff(raw)).max() > np.pi  # the hinge does pass half a turn
    space = mixed_space(frames, topology, decompose(topology, np.repeat([0, 1], [4, 6]), 2))
    space = replace(space, joint_faces=np.ones(10, dtype=bool))
    column = np.flatnonzero(space.hinge_ids == number)
    vectors = space.encode(frames)
    stored = space.split(vectors).angles[:, column[0]]
    np.testing.assert_allclose(np.diff(stored), np.sign(stored[0]) * np.diff(angles), atol=1e-9)
    block = space.encode(frames[4:], previous=vectors[3])  # by now nearer to the first frame on another turn
    np.testing.assert_allclose(block, vectors[4:], atol=1e-12)


def test_a_still_sequence_does_not_move_between_its_frames() -> None:
    points = sequence_of("still").points
    for space in in_all_ways("still"):
        vectors = space.encode(points)
        np.testing.assert_array_equal(vectors, np.broadcast_to(vectors[0], vectors.shape))
        assert error(space, points[:1], space.decode(vectors[:1] * 0.3 + vectors[1:2] * 0.7)) < 1e-12


def test_blends_of_half_turns_are_finite() -> None:
    """Of parts, and of bodies: quaternions may add up to nothing."""
    space = space_of("bar")
    vectors = space.encode(sequence_of("bar").points[:1])
    for name in ("part_rotations", "relation_rotations", "body_rotations"):
        blend = vectors.copy()
        getattr(space.split(blend), name)[:] = 0.0
        assert np.isfinite(space.decode(blend)).all()
        points, velocities = space.decode_with_velocities(blend, np.zeros_like(blend))
        assert np.isfinite(points).all() and not velocities.any()


def test_changes_by_hand_arrive() -> None:
    """What `shape_difference` says, added to the shape, moves the vertices that were moved, and no others."""
    for space, atol in ((space_of("bar"), 1e-12), (steered("bar", 0.5), 2e-3), (space_of("bar", "free"), 2e-2)):
        vectors = space.encode(sequence_of("bar").points)
        vector = vectors[2] if space.placement == "free" else vectors[[1, 3]].mean(axis=0)
        before = space.decode(vector[None])[0]
        after = before.copy()
        after[[3, 100, 101]] += 0.02 * space.scale * np.array([[1, 0, 1], [1, 1, 0], [0, 1, -1]])
        change = space.shape_difference(vector, before, after)
        assert change.shape == (space.shape_dim,)
        assert not space.shape_difference(vector, before, before).any()
        vector[: space.shape_dim] += change
        assert error(space, after, space.decode(vector[None])[0]) < atol


# Velocities -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MOVING)
@settings(max_examples=4, deadline=None)
@given(seed=seeds, scaled=st.booleans(), share=st.sampled_from([0.0, 0.5, 1.0]))
def test_velocities_are_derivatives_of_decoded_points(name: str, seed: int, scaled: bool, share: float) -> None:
    """At any combination of frames, along any rate, also of corrections; quaternions may have any length."""
    rng = np.random.default_rng(seed)
    space = steered(name, share)
    vectors = space.encode(sequence_of(name).points)
    vector = (rng.dirichlet(np.ones(len(vectors))) @ vectors)[None]
    rate = (rng.normal(size=(1, len(vectors))) @ (vectors - vectors[0])) + 0.1 * rng.normal(size=vector.shape)
    space.split(vector).corrections[:] += 0.1 * rng.normal(size=space.correction_dim)
    if scaled:
        space.split(vector).body_rotations[:] *= rng.uniform(0.5, 2.0, (1, space.rotation_count, 1))
    points, velocities = space.decode_with_velocities(vector, rate)
    np.testing.assert_allclose(points, space.decode(vector), atol=1e-12 * space.scale)
    step = 1e-6
    ahead, behind, further, back = (space.decode(vector + n * step * rate) for n in (1, -1, 2, -2))
    quotient = (8 * (ahead - behind) - (further - back)) / (12 * step)
    assert np.abs(velocities - quotient).max() < 1e-5 * np.abs(quotient).max()


@pytest.mark.parametrize("steps", [0, 10])
def test_velocities_in_the_free_placement_and_after_steps(steps: int) -> None:
    free = space_of("bar", "free")
    for space in (replace(free, projection=replace(free.projection, steps=steps)), steered("bar", 1.0, steps)):
        vectors = space.encode(sequence_of("bar").points)
        rate = (vectors[2] - vectors[1])[None]
        vector = vectors[1] + 0.4 * rate
        decoded, velocities = space.decode_with_velocities(vector, rate)
        step = 1e-3
        quotient = (space.decode(vector + step * rate) - space.decode(vector - step * rate)) / (2 * step)
        np.testing.assert_allclose(decoded, space.decode(vector), atol=1e-12)
        assert np.abs(velocities - quotient).max() < 1e-3 * np.abs(quotient).max()


def test_a_rate_of_a_rigid_motion_is_its_velocity() -> None:
    points = sequence_of("bar").points
    spin, speed, step = np.array([0.3, -1.0, 0.7]), np.array([1.0, 2.0, -1.0]), 1e-5
    for space in (space_of("bar"), steered("bar")):
        moved = [points[2] @ rotation(sign * step * spin).T + sign * step * speed for sign in (1, -1)]
        ahead, behind = (space.encode(frame) for frame in moved)
        _, velocities = space.decode_with_velocities(space.encode(points[2]), (ahead - behind) / (2 * step))
        np.testing.assert_allclose(velocities[0], np.cross(spin, points[2]) + speed, atol=1e-6)


def test_still_vectors_have_no_velocity() -> None:
    for space in (space_of("three pages"), steered("three pages")):
        vectors = space.encode(sequence_of("three pages").points)
        assert not space.decode_with_velocities(vectors, np.zeros_like(vectors))[1].any()


def test_points_that_are_not_finite_are_refused_by_steps() -> None:
    for space in (space_of("bar", "free"), steered("bar", 1.0, 8)):
        vectors = space.encode(sequence_of("bar").points[:1])
        vectors[0, 3] = np.nan
        with pytest.raises(ReconstructionError, match="not finite"):
            space.decode(vectors)


# Predictions and corrections ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SEQUENCES)
def test_predictions_pass_through_the_frames(name: str) -> None:
    points = sequence_of(name).points
    space = space_of(name)
    vectors = space.encode(points)
    size, end = space.shape_dim, space.shape_dim + space.placement_dim
    times = np.arange(len(points)) / 24
    targets, placed = space.interpolate_poses(
        TemporalOperator(times, 4.0),
        vectors[:, size - space.pose_dim : size],
        vectors[:, size:end],
        insert_midpoints(times),
    )
    assert len(targets.centres) == len(placed) == 2 * len(points) - 1
    np.testing.assert_allclose(placed[::2], vectors[:, size:end], atol=1e-12)
    blocks = space.split(vectors)
    np.testing.assert_allclose(targets.centres[::2], blocks.part_centres, atol=1e-12)
    cosines = np.einsum("tpi,tpi->tp", targets.rotations[::2], blocks.part_rotations)
    np.testing.assert_allclose(np.abs(cosines), 1.0, atol=1e-12)
    assert np.isfinite(space.decode(at(space, vectors, TemporalOperator(times, 4.0), insert_midpoints(times)))).all()


def test_bodies_that_do_not_touch_are_predicted_alone() -> None:
    """The moon has no neighbours."""
    space, points = space_of("rigid component"), sequence_of("rigid component").points
    assert 2 not in space.articulation.pairs
    body, size = int(space.articulation.body_of_part[2]), space.shape_dim
    vectors = space.encode(points)
    placements = vectors[:, size : size + space.placement_dim]
    operator, middles = TemporalOperator(np.arange(5.0)), np.arange(4.0) + 0.5
    _, placed = space.interpolate_poses(operator, vectors[:, size - space.pose_dim : size], placements, middles)
    found, alone = (
        space.unpack_placements(placed),
        interpolate_poses(operator.weights_at(middles), space.unpack_placements(placements)),
    )
    turns, expected = (quat_to_matrix(each.rotations[:, body]) for each in (found, alone))
    np.testing.assert_allclose(turns, expected, atol=1e-12)
    np.testing.assert_allclose(found.centres[:, body], alone.centres[:, body], atol=1e-12)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_corrected_poses_are_those_that_are_wanted(seed: int) -> None:
    """Whatever blended poses are: corrections and corrected poses are inverse."""
    rng = np.random.default_rng(seed)
    for name in ("bar", "several components"):
        space = space_of(name)
        vectors = space.encode(sequence_of(name).points)
        blends = rng.dirichlet(np.ones(len(vectors)), 4) @ vectors
        poses = blends[:, space.shape_dim - space.pose_dim : space.shape_dim]
        parts = len(space.decomposition.parts)
        turns = normalise_quat(np.array([1.0, 0, 0, 0]) + 0.4 * rng.normal(size=(4, parts, 4)))
        centres = rng.normal(size=(4, parts, 3))
        corrections = space.pose_corrections(poses, Poses(turns, centres))
        assert corrections.shape == (4, space.correction_dim)
        found = space.correct_poses(poses, corrections)
        np.testing.assert_allclose(quat_to_matrix(found.rotations), quat_to_matrix(turns), atol=1e-12)
        np.testing.assert_allclose(found.centres, centres, atol=1e-12)
        blocks = space.split(blends)
        posed = space.skin(space.join(blocks._replace(corrections=corrections)))
        single = [space.rigid_part_of_vertex == part for part in range(parts)]
        for part, own in enumerate(single):
            bodies = Poses(normalise_quat(blocks.body_rotations), blocks.body_centres)
            world = space.articulation.to_world_axes(found, bodies)
            rest = blocks.rest_vertices[:, own] - space.articulation.rest_centres[part]
            expected = (
                rotate_vectors(quat_to_matrix(world.rotations[:, None, part]), rest) + world.centres[:, part, None]
            )
            np.testing.assert_allclose(posed[:, own], expected, atol=1e-11)


@pytest.mark.parametrize("name", ["bar", "rigid component"])
def test_frames_need_no_corrections(name: str) -> None:
    space = space_of(name)
    blocks = space.split(space.encode(sequence_of(name).points))
    poses = space.encode(sequence_of(name).points)[:, space.shape_dim - space.pose_dim : space.shape_dim]
    targets = Poses(blocks.part_rotations, blocks.part_centres)
    np.testing.assert_allclose(space.pose_corrections(poses, targets), 0.0, atol=1e-9)


@pytest.mark.parametrize("name", SEQUENCES)
def test_vectors_of_exact_models_are_those_of_the_frames(name: str) -> None:
    """Also by the signs of quaternions."""
    sequence = sequence_of(name)
    model = mixseq.fit(sequence, exact=True)
    np.testing.assert_allclose(model.vectors, model.space.encode(sequence.points), atol=1e-6)
