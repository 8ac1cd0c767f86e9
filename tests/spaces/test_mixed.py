"""The mixed shape space: exact at the frames, linear in between, blind to rigid motions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.geometry.rigid import kabsch
from mixseq.geometry.rotations import matrices
from mixseq.geometry.rotations import vectors as logarithm
from mixseq.reconstruction.agreement import solve
from mixseq.reconstruction.shells import ShellSettings
from mixseq.segmentation import decompose, segment_by_labels, segment_by_motion
from mixseq.sequence import MeshSequence
from mixseq.spaces import MixedSpace, mixed_space
from mixseq.spaces.mixed import PLACEMENTS, PlacementName
from mixseq.topology import Topology
from tests.meshes import (
    SEQUENCES,
    Float,
    Mesh,
    bar,
    bending,
    flipped,
    grid,
    joined,
    pages,
    rigid_motions,
    rotation,
    seeds,
    tetrahedron,
    torus,
    tube,
)

BONES = {"bar": 2, "rigid component": 3}
"""Their bends would be parts of their own."""


@cache
def sequence_of(name: str) -> MeshSequence:
    return SEQUENCES[name]()


@cache
def labels_of(name: str) -> tuple[Topology, Any]:
    sequence = sequence_of(name)
    topology = Topology(sequence.faces, sequence.vertex_count)
    return topology, segment_by_motion(sequence.points, topology, BONES.get(name))


@cache
def space_of(name: str, placement: PlacementName, width: int = 3) -> MixedSpace:
    topology, labels = labels_of(name)
    points = sequence_of(name).points
    return mixed_space(points, topology, decompose(topology, labels, width, points), placement)


def in_both(name: str) -> list[MixedSpace]:
    return [space_of(name, placement) for placement in PLACEMENTS]


def error(space: MixedSpace, points: Any, decoded: Float) -> float:
    return float(np.abs(decoded - points).max() / space.scale)


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("name", SEQUENCES)
def test_frames_come_back(name: str, placement: PlacementName) -> None:
    points = sequence_of(name).points
    space = space_of(name, placement)
    vectors = space.encode(points)
    assert vectors.shape == (len(points), space.dim)
    assert error(space, points, space.decode(vectors)) < 1e-9


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("width", [1, 2, 4])
def test_frames_come_back_at_every_width(width: int, placement: PlacementName) -> None:
    points = sequence_of("bar").points
    space = space_of("bar", placement, width)
    assert any(joint.free.any() for joint in space.decomposition.joints) == (width > 1)
    assert error(space, points, space.decode(space.encode(points))) < 1e-9


def rms(differences: Float) -> float:
    return float(np.sqrt(np.mean(differences**2)))


MESHES: list[Mesh] = [
    tube(6, 13),
    tube(5, 9, closed=False),
    torus(14, 7),
    grid(7, 7),
    pages(3, 8, 3),
    joined(tube(5, 7), torus(8, 5)),
    (tube(6, 13)[0], flipped(tube(6, 13)[1])),
    tetrahedron(),
]


@settings(max_examples=12, deadline=None)
@given(seed=seeds, mesh=st.sampled_from(MESHES), parts=st.integers(1, 7), width=st.integers(1, 4))
def test_frames_come_back_whatever_the_parts(seed: int, mesh: Mesh, parts: int, width: int) -> None:
    rng = np.random.default_rng(seed)
    topology = Topology(mesh[1], len(mesh[0]))
    points = bending(mesh, frames=2) + rng.normal(size=(2, len(mesh[0]), 3)) * rng.choice([0.0, 0.02, 0.3])
    centres = mesh[0][mesh[1]].mean(axis=1)
    nearest = ((centres[:, None] - rng.choice(centres, parts)) ** 2).sum(axis=2).argmin(axis=1)
    scattered = rng.integers(0, parts, len(mesh[1]))
    labels = segment_by_labels(nearest if rng.random() < 0.7 else scattered, topology)
    decomposition = decompose(topology, labels, width, points if rng.random() < 0.5 else None)
    for placement in PLACEMENTS:
        space = mixed_space(points, topology, decomposition, placement)
        assert error(space, points, space.decode(space.encode(points))) < 1e-9


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_frame_that_the_space_was_not_made_for_comes_back(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    stranger = sequence_of("bar").points[2:3] * [1.2, 0.9, 1.0] + [0, 0, 0.1]
    assert error(space, stranger, space.decode(space.encode(stranger))) < 1e-9


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_blocks_are_what_they_are_called(placement: PlacementName) -> None:
    space, points = space_of("rigid component", placement), sequence_of("rigid component").points
    x = points / space.scale
    vectors = space.encode(points)
    blocks = space.split(vectors)
    assert tuple(block[0].size for block in blocks) == space.sizes
    assert space.dim == sum(space.sizes) == vectors.shape[1]
    assert space.scale == pytest.approx(np.linalg.norm(np.ptp(points[0], axis=0)))

    np.testing.assert_array_equal(
        blocks.lengths, edge_lengths(x, space.topology.edges[space.projection.edge_ids])
    )
    angles = dihedral_angles(x, space.topology.hinges[space.projection.hinge_ids])
    np.testing.assert_allclose(np.exp(1j * blocks.angles), np.exp(1j * angles), atol=1e-12)
    np.testing.assert_allclose(blocks.lengths.mean(axis=0), space.reference_lengths, atol=1e-14)
    parts = space.decomposition.parts
    assert blocks.parts.shape[1] == sum(map(len, parts)) == len(space.shapes)

    starts = np.cumsum([0, *map(len, parts)])
    for pose, part in enumerate(space.projection.posed):
        rows = slice(starts[part], starts[part + 1])
        moved = blocks.parts[:, rows] @ np.swapaxes(matrices(blocks.rotations[:, pose]), 1, 2)
        np.testing.assert_allclose(moved + blocks.translations[:, pose, None], x[:, parts[part]], atol=1e-12)
    for part in range(len(parts)):  # every frame of a part is aligned to its mean shape
        rows = slice(starts[part], starts[part + 1])
        turns, shifts = kabsch(space.shapes[rows], blocks.parts[:, rows])
        np.testing.assert_allclose(turns, np.broadcast_to(np.eye(3), turns.shape), atol=1e-7)
        np.testing.assert_allclose(shifts, 0, atol=1e-12)


def test_poses_stored() -> None:
    anchored, free = in_both("rigid component")
    assert len(anchored.projection.posed) == len(anchored.decomposition.parts) == 3
    assert len(free.projection.posed) == 2  # one for each connected component
    assert free.dim > anchored.dim - 6 * 3  # and the edges between a joint's held vertices on top


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_split_and_join_are_inverse(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    vectors = np.random.default_rng(0).normal(size=(3, space.dim))
    np.testing.assert_array_equal(space.join(space.split(vectors)), vectors)


@settings(max_examples=15, deadline=None)
@given(motion=rigid_motions, placement=st.sampled_from(PLACEMENTS), frame=st.integers(0, 4))
def test_a_rigid_motion_changes_the_pose_only(
    motion: tuple[Float, Float], placement: PlacementName, frame: int
) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points[frame]
    turn, shift = motion
    still, moved = space.encode(np.stack([points])), space.encode(np.stack([points @ turn.T + shift]))
    before, after = space.split(still), space.split(moved)
    np.testing.assert_allclose(after.lengths, before.lengths, atol=1e-12)
    np.testing.assert_allclose(after.angles, before.angles, atol=1e-10)
    np.testing.assert_allclose(after.parts, before.parts, atol=1e-10)
    np.testing.assert_allclose(matrices(after.rotations), turn @ matrices(before.rotations), atol=1e-10)
    np.testing.assert_allclose(
        after.translations, before.translations @ turn.T + shift / space.scale, atol=1e-10
    )


@settings(max_examples=5, deadline=None)
@given(motion=rigid_motions, placement=st.sampled_from(PLACEMENTS))
def test_decoding_moves_with_the_pose(motion: tuple[Float, Float], placement: PlacementName) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points
    turn, shift = motion
    middle = space.encode(points)[[1, 3]].mean(axis=0, keepdims=True)
    blocks = space.split(middle)
    turned = matrices(blocks.rotations)
    moved = blocks._replace(
        rotations=logarithm(turn @ turned), translations=blocks.translations @ turn.T + shift / space.scale
    )
    expected = space.decode(middle)[0] @ turn.T + shift
    assert error(space, expected, space.decode(space.join(moved))[0]) < 1e-7


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_poses_blend_linearly(placement: PlacementName) -> None:
    """Half way between two poses of a rigid body about one axis it has turned by half the angle."""
    mesh = tube(5, 4)
    axis, angle = np.array([1.0, 2, 2]) / 3, 2.8
    points = np.stack([mesh[0], mesh[0] @ rotation(axis * angle).T + [1, 2, 3]])
    topology = Topology(mesh[1], len(mesh[0]))
    labels = np.zeros(len(mesh[1]), dtype=np.int64)
    space = mixed_space(points, topology, decompose(topology, labels), placement)
    half = space.decode(space.encode(points).mean(axis=0, keepdims=True))[0]
    centre = mesh[0].mean(axis=0)
    moved = points[1].mean(axis=0)
    expected = (mesh[0] - centre) @ rotation(axis * angle / 2).T + (centre + moved) / 2
    assert error(space, expected, half) < 1e-12


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_parts_blend_linearly(placement: PlacementName) -> None:
    """Without joints the space is the aligned vertices: a body that swells by s and by 3s is 2s between."""
    mesh = tube(6, 5, length=1.0)
    centred = mesh[0] - mesh[0].mean(axis=0)
    turn = rotation((0.5, -1.0, 0.3))
    points = np.stack([centred, 3 * centred @ turn.T])
    topology = Topology(mesh[1], len(mesh[0]))
    space = mixed_space(
        points, topology, decompose(topology, np.zeros(len(mesh[1]), dtype=np.int64)), placement
    )
    vectors = space.encode(points)
    assert space.sizes == (0, 0, 3 * len(centred), 3, 3, 0, 0)
    blocks = space.split(vectors)
    np.testing.assert_allclose(blocks.parts[1], 3 * blocks.parts[0], atol=1e-12)
    decoded = space.decode(vectors.mean(axis=0, keepdims=True))[0]
    expected = 2 * centred @ rotation((0.25, -0.5, 0.15)).T
    np.testing.assert_allclose(decoded, expected, atol=1e-12)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_affine_combinations_are_weighted_sums(placement: PlacementName) -> None:
    """What a combination decodes to has the combined lengths and angles at the joints."""
    space, points = space_of("bar", placement), sequence_of("bar").points
    vectors = space.encode(points)
    weights = np.array([0.5, -0.25, 0.25, 0.0, 0.5])
    assert weights.sum() == 1
    combined = (weights @ vectors)[None]
    blocks, each = space.split(combined), space.split(vectors)
    for block, own in zip(blocks, each, strict=True):
        np.testing.assert_allclose(block[0], np.tensordot(weights, own, 1), atol=1e-14)


def test_free_half_way_the_joint_bends_by_half() -> None:
    """Averaged vertices, which shorten and fold what turns, are the yardstick."""
    space, points = space_of("bar", "free"), sequence_of("bar").points
    middle = space.encode(points)[[0, 4]].mean(axis=0, keepdims=True)
    decoded, reports = space.decode_with_reports(middle)
    assert all(report.converged for report in reports[0])
    averaged = points[[0, 4]].mean(axis=0, keepdims=True)
    wanted, got, plain = (
        space.split(vectors)
        for vectors in (middle, space.encode(decoded, middle[0]), space.encode(averaged, middle[0]))
    )
    assert rms(got.angles - wanted.angles) < 0.3 * rms(plain.angles - wanted.angles)
    assert rms(got.lengths - wanted.lengths) < 0.1 * rms(plain.lengths - wanted.lengths)
    assert np.abs(got.parts - wanted.parts).max() < 0.02


def test_anchored_half_way_the_parts_are_where_their_poses_say() -> None:
    space, points = space_of("bar", "anchored"), sequence_of("bar").points
    middle = space.encode(points)[2:4].mean(axis=0, keepdims=True)
    decoded, reports = space.decode_with_reports(middle)
    assert all(report.converged for report in reports[0])
    wanted, got = space.split(middle), space.split(space.encode(decoded, previous=middle[0]))
    rotations, translations = solve(space.links, wanted.poses)
    np.testing.assert_allclose(got.parts, wanted.parts, atol=2e-3)
    np.testing.assert_allclose(matrices(got.rotations), rotations, atol=4e-3)
    np.testing.assert_allclose(got.translations, translations, atol=2e-3)
    start = 0
    for part, vertices in enumerate(space.decomposition.parts):
        aligned = wanted.parts[0, start : start + len(vertices)]
        placed = aligned @ rotations[0, part].T + translations[0, part]
        alone = np.array([sum(v in other for other in space.decomposition.parts) == 1 for v in vertices])
        np.testing.assert_allclose(decoded[0, vertices[alone]], space.scale * placed[alone], atol=1e-12)
        start += len(vertices)


@pytest.mark.parametrize("name", SEQUENCES)
def test_placements_follow_from_poses(name: str) -> None:
    """The end of a vector says where things are; turns and gaps follow from the poses before them."""
    for space in in_both(name):
        vectors = space.encode(sequence_of(name).points)
        blocks = space.split(vectors)
        end = vectors[:, space.dim - space.placement_dim :]
        assert space.stored_placement_dim == blocks.rotations[0].size + blocks.translations[0].size
        assert space.placement_dim - space.stored_placement_dim == 6 * len(space.links)
        np.testing.assert_allclose(
            space.complete_placement(end[:, : space.stored_placement_dim]), end, atol=1e-12
        )
        with pytest.raises(SettingsError, match="placements have shape"):
            space.complete_placement(end[:, 1:])


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_the_metric_is_in_diagonals(placement: PlacementName) -> None:
    space = space_of("bar", placement)
    weights = space.split(space.weights[None])
    joints = 0.3 if placement == "anchored" else 1.0  # where offsets tell of them too
    for block in (weights.parts, weights.translations, weights.gaps, weights.lengths / joints):
        assert (block == 1).all()
    hinges = space.topology.hinges[space.projection.hinge_ids]
    edges = np.linalg.norm(space.reference[hinges[:, 1]] - space.reference[hinges[:, 0]], axis=1)
    np.testing.assert_allclose(weights.angles[0], 0.3 * joints * edges, rtol=1e-12)
    assert (weights.rotations[0] == space.radii[space.projection.posed, None]).all()
    assert (space.radii > 0.05).all()
    assert (space.radii < 0.6).all()
    assert (weights.turns[0] == space.radii[space.links.parts].min(axis=1)[:, None]).all()


def test_rigid_motions_change_no_turn_and_no_gap() -> None:
    space, points = space_of("bar", "anchored"), sequence_of("bar").points
    turn = rotation((0.4, 1.0, -0.2))
    still, moved = (space.split(space.encode(frames)) for frames in (points, points @ turn.T + [3.0, 1, 2]))
    np.testing.assert_allclose(moved.turns, still.turns, atol=1e-12)
    np.testing.assert_allclose(moved.gaps, still.gaps, atol=1e-12)


@pytest.mark.parametrize("name", ["bar", "rigid component", "several components"])
def test_encoding_block_by_block_is_encoding(name: str) -> None:
    for space in in_both(name):
        points = sequence_of(name).points
        whole = space.encode(points)
        first = space.encode(points[:2])
        second = space.encode(points[2:3], previous=first[-1])
        third = space.encode(points[3:], previous=second[-1])
        np.testing.assert_allclose(np.concatenate([first, second, third]), whole, atol=1e-13)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_body_that_turns_twice_has_pose_vectors_of_four_pi(placement: PlacementName) -> None:
    mesh = tube(6, 13)
    axis, frames = np.array([2.0, -1, 2]) / 3, 13
    angles = np.linspace(0, 4 * np.pi, frames)
    points = np.stack([mesh[0] @ rotation(axis * angle).T for angle in angles])
    topology = Topology(mesh[1], len(mesh[0]))
    labels = segment_by_labels((mesh[0][mesh[1]].mean(axis=1)[:, 2] > 2).astype(int), topology)
    space = mixed_space(points, topology, decompose(topology, labels, 2), placement)
    vectors = space.encode(points)
    rotations = space.split(vectors).rotations
    expected = np.broadcast_to(angles[:, None, None] * axis, rotations.shape)
    np.testing.assert_allclose(rotations, expected, atol=1e-7)
    assert error(space, points, space.decode(vectors)) < 1e-9
    block = space.encode(points[6:], previous=vectors[5])
    np.testing.assert_allclose(block, vectors[6:], atol=1e-9)


def test_hinges_that_fold_over_are_unwrapped() -> None:
    """A hinge that closes past 180 degrees goes on growing, so that half way is not its mirror image."""
    angles = np.radians([150.0, 190.0, 250.0, 310.0, 370.0, 410.0])
    points = []
    for angle in angles:
        fold = rotation((-angle, 0, 0))
        flap = np.array([[0.0, -1, 0], [1, -1, 0], [0, -2, 0], [1, -2, 0]]) @ fold.T
        points.append(np.concatenate([[[0.0, 1, 0], [1, 1, 0], [0, 0, 0], [1, 0, 0]], flap]))
    frames = np.stack(points) * [1.0, 1.0, -1.0]
    faces = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5], [4, 5, 6], [6, 5, 7]])
    topology = Topology(faces, 8)
    number = int(np.flatnonzero((np.sort(topology.hinges[:, :2], axis=1) == [2, 3]).all(axis=1))[0])
    raw = dihedral_angles(frames, topology.hinges[[number]])[:, 0]
    assert np.abs(np.diff(raw)).max() > np.pi  # the hinge does pass half a turn

    labels = np.array([0, 0, 1, 1, 1, 1])
    space = mixed_space(frames, topology, decompose(topology, labels, 1), "free")
    column = np.flatnonzero(space.projection.hinge_ids == number)
    assert column.size == 1
    vectors = space.encode(frames)
    stored = space.split(vectors).angles[:, column[0]]
    np.testing.assert_allclose(np.diff(stored), np.sign(stored[0]) * np.diff(angles), atol=1e-9)
    block = space.encode(frames[4:], previous=vectors[3])  # by now nearer to the first frame on another turn
    np.testing.assert_allclose(block, vectors[4:], atol=1e-12)


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_still_sequence_does_not_move_between_its_frames(placement: PlacementName) -> None:
    space, points = space_of("still", placement), sequence_of("still").points
    vectors = space.encode(points)
    np.testing.assert_array_equal(vectors, np.broadcast_to(vectors[0], vectors.shape))
    assert error(space, points[:1], space.decode(vectors[:1] * 0.3 + vectors[1:2] * 0.7)) < 1e-12


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_a_point_mesh_has_no_size_but_comes_back(placement: PlacementName) -> None:
    mesh = tube(5, 6)
    points = np.full((2, len(mesh[0]), 3), 7.0)
    topology = Topology(mesh[1], len(mesh[0]))
    labels = (np.arange(len(mesh[1])) > 20).astype(np.int64)
    space = mixed_space(points, topology, decompose(topology, labels, 3, points), placement)
    assert space.scale == 1.0
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-9)


def test_settings_are_checked() -> None:
    sequence = bar(frames=2)
    topology = Topology(sequence.faces, sequence.vertex_count)
    whole = decompose(topology, np.zeros(len(sequence.faces), dtype=np.int64))
    with pytest.raises(SettingsError, match=r"placement is 'loose'; 'anchored' or 'free' is expected"):
        mixed_space(sequence.points, topology, whole, "loose")  # type: ignore[arg-type]
    space = mixed_space(sequence.points, topology, whole)
    for wrong in (np.zeros(space.dim), np.zeros((2, space.dim + 1)), np.zeros((1, 1, space.dim))):
        with pytest.raises(SettingsError, match=rf"\(T, {space.dim}\) is expected"):
            space.decode(wrong)
    with pytest.raises(SettingsError, match="is expected"):
        space.encode(sequence.points, previous=np.zeros(3))


def test_decoding_tells_its_progress() -> None:
    space = space_of("bar", "anchored")
    told: list[tuple[int, int, str]] = []
    vectors = space.encode(sequence_of("bar").points[:3])
    space.decode(vectors, progress=lambda *step: told.append(step))
    assert told == [(1, 3, "decoding frames"), (2, 3, "decoding frames"), (3, 3, "decoding frames")]


def test_no_vectors_decode_to_no_frames() -> None:
    space = space_of("bar", "free")
    assert space.decode(np.zeros((0, space.dim))).shape == (0, space.topology.vertex_count, 3)


def test_offsets_tell_which_blend_was_meant() -> None:
    """Decoding the frames with their offsets changes nothing; half-way blends go where offsets pull them."""
    space, points = space_of("bar", "anchored"), sequence_of("bar").points
    vectors = space.encode(points)
    offsets = space.offsets(points, vectors)
    assert offsets.shape == (len(points), space.offset_dim)
    assert space.offset_dim == 3 * sum(int(joint.free.sum()) for joint in space.decomposition.joints)
    assert error(space, points, space.decode(vectors, offsets=offsets)) < 1e-12
    middle, half = vectors[[1, 2]].mean(axis=0)[None], offsets[[1, 2]].mean(axis=0)[None]
    free = space.projection.rows.free  # type: ignore[attr-defined]
    pulled = {}
    for trust in (0.1, 10.0, 1e4):
        trusting = replace(space, trust=np.full(len(space.trust), trust))
        decoded = trusting.decode(middle, offsets=half)
        pulled[trust] = rms(trusting.offsets(decoded, middle) - half)
        assert np.abs(decoded - space.decode(middle))[0, free].max() < 0.1
    assert pulled[1e4] < pulled[10.0] < pulled[0.1]
    assert pulled[1e4] < 1e-6


def test_the_free_placement_has_no_offsets() -> None:
    space, points = space_of("bar", "free"), sequence_of("bar").points
    vectors = space.encode(points)
    assert space.offset_dim == 0
    assert space.offsets(points, vectors).shape == (len(points), 0)


def test_trust_is_the_ratio_of_prediction_errors() -> None:
    """Where nothing moves both errors are zero."""
    mesh = tube(8, 25)
    still = np.repeat(bending(mesh, frames=2)[:1], 9, axis=0)
    topology = Topology(mesh[1], len(mesh[0]))
    z = mesh[0][mesh[1]].mean(axis=1)[:, 2]
    decomposition = decompose(topology, segment_by_labels((z > 2).astype(int), topology), 3)
    assert mixed_space(still, topology, decomposition).trust == pytest.approx(3.0)


@pytest.mark.parametrize("name", SEQUENCES)
def test_trust_is_bounded(name: str) -> None:
    trust = space_of(name, "anchored").trust
    assert ((trust >= 0.1) & (trust <= 10.0)).all()


@pytest.mark.parametrize("placement", PLACEMENTS)
@pytest.mark.parametrize("blend", [0.0, 0.4])
def test_velocities_are_derivatives_of_decoded_points(placement: PlacementName, blend: float) -> None:
    space, points = space_of("bar", placement), sequence_of("bar").points
    vectors = space.encode(points)
    offsets = space.offsets(points, vectors)
    rate, offset_rate = (vectors[2] - vectors[1])[None], (offsets[2] - offsets[1])[None]
    vector, offset = vectors[1] + blend * rate, offsets[1] + blend * offset_rate
    tight = replace(space, settings=ShellSettings(tolerance=1e-13))
    decoded, velocities = tight.decode_moving(vector, rate, offset, offset_rate)
    step = 1e-4
    ahead, behind = (tight.decode(vector + s * rate, offsets=offset + s * offset_rate) for s in (step, -step))
    quotient = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(decoded, tight.decode(vector, offsets=offset), atol=1e-12)
    assert np.abs(velocities - quotient).max() < 1e-3 * np.abs(quotient).max()
