"""The anchored placement: vertices as their frames see them, decoded by posing and one constant solve."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mixseq.spaces.mixed.anchored import JOINT, SIDE

from mixseq.arrays import Float
from mixseq.geometry.rotations import inverse, product, rotations_of, turned
from mixseq.prediction.operator import Operator, with_middles
from mixseq.prediction.poses import predicted_alone
from mixseq.segmentation import decompose
from mixseq.segmentation.boundaries import Boundaries
from mixseq.spaces import mixed_space
from mixseq.spaces.mixed import AnchoredSpace
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from tests.meshes import SEQUENCES, bar, bent, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import anchored, chain, error, of_slices, sequence_of

MOVING = [
    "bar",
    "folding sheet",
    "several components",
    "three pages",
    "inconsistent",
    "bowtie",
    "unused vertices",
]


def at(space: AnchoredSpace, vectors: Float, operator: Operator, times: Float) -> Float:
    """Vectors at times, as a model has them."""
    shape = space.shape_dim
    placements = space.predicted_placements(operator, vectors[:, shape:], times)
    return np.concatenate([operator.at(times).of(vectors[:, :shape]), placements], axis=1)


def test_every_part_has_a_pose() -> None:
    space, points = anchored("rigid component"), sequence_of("rigid component").points
    assert space.rotation_count == len(space.decomposition.parts) == 3
    x, blocks = points / space.scale, space.split(space.encode(points))
    starts = np.cumsum([0, *map(len, space.decomposition.parts)])
    for number, part in enumerate(space.decomposition.parts):
        shape = space.shapes[starts[number] : starts[number + 1]]
        placed = (
            turned(rotations_of(blocks.rotations[:, None, number]), shape) + blocks.centres[:, None, number]
        )
        away = np.linalg.norm(placed - x[:, part], axis=2)
        assert away.max() < 0.03  # what the paper calls nearly rigid
        np.testing.assert_allclose(blocks.centres[:, number], x[:, part].mean(axis=1), atol=1e-12)


def test_inside_a_part_unposed_vertices_are_the_aligned_ones() -> None:
    """As the paper has them, but where the part is in the reference frame."""
    space, points = anchored("bar"), sequence_of("bar").points
    unposed = space.split(space.encode(points)).unposed
    aligned = np.stack([space.registered(frame / space.scale)[0] for frame in points])
    starts = np.cumsum([0, *map(len, space.decomposition.parts)])
    for number, part in enumerate(space.decomposition.parts):
        own = space.frames.alone[part] == number
        assert own.any()
        rest = rotations_of(space.frames.rest.rotations[0, number]), space.frames.rest.centres[0, number]
        expected = aligned[:, starts[number] : starts[number + 1]][:, own] @ rest[0].T + rest[1]
        np.testing.assert_allclose(unposed[:, part[own]], expected, atol=1e-12)


def test_the_reference_is_unposed_as_it_is() -> None:
    space, points = anchored("three pages"), sequence_of("three pages").points
    blocks = space.split(space.encode(points[:1]))
    np.testing.assert_allclose(blocks.unposed[0], space.reference, atol=1e-12)
    corners = space.reference[space.seams.faces]
    np.testing.assert_allclose(blocks.sides[0], corners[:, 1:] - corners[:, :1], atol=1e-12)


@pytest.mark.parametrize("name", SEQUENCES)
def test_joints_are_where_faces_bend(name: str) -> None:
    """In some frame; there, and only there, lengths, angles and sides are known."""
    space, points = anchored(name), sequence_of(name).points
    poses = space.poses(space.encode(points)[:, space.shape_dim :])
    bends = np.zeros(len(space.topology.faces), dtype=bool)
    for rotations, centres in zip(*poses, strict=True):
        bends |= space.frames.bent(space.frames.motions(rotations, centres))
    free = np.unique(space.topology.faces[bends])
    np.testing.assert_array_equal(np.flatnonzero(space.free), free)
    edges, hinges = space.topology.edges, space.topology.hinges
    np.testing.assert_array_equal(space.edge_ids, np.flatnonzero(np.isin(edges, free).any(axis=1)))
    np.testing.assert_array_equal(space.hinge_ids, np.flatnonzero(np.isin(hinges, free).any(axis=1)))
    known = np.isin(space.topology.faces, free).any(axis=1)
    np.testing.assert_array_equal(space.seams.faces, space.topology.faces[known])
    np.testing.assert_array_equal(space.seams.vertices, free)


@pytest.mark.parametrize("name", ["still", "one frame"])
def test_without_motion_there_are_no_joints(name: str) -> None:
    space = anchored(name)
    assert not space.free.any()
    assert space.sizes[:2] == (0, 0)
    assert space.sizes[3] == 0


def test_the_metric_is_in_diagonals() -> None:
    space = anchored("bar")
    weights = space.split(space.weights[None])
    for block, weight in (
        (weights.unposed, 1),
        (weights.centres, 1),
        (weights.lengths, JOINT),
        (weights.sides, SIDE),
    ):
        assert block.size
        assert (block == weight).all()
    hinges = space.topology.hinges[space.hinge_ids]
    edges = np.linalg.norm(space.reference[hinges[:, 1]] - space.reference[hinges[:, 0]], axis=1)
    np.testing.assert_allclose(weights.angles[0], 0.3 * JOINT * edges, rtol=1e-12)
    assert (weights.rotations[0] == 2 * space.radii[:, None]).all()
    assert (space.radii > 0.05).all()
    assert (space.radii < 0.6).all()


def test_a_quaternion_that_changes_moves_its_part_by_its_weight() -> None:
    """Root mean square over the vertices of the part, for changes that keep its length."""
    space = anchored("rigid component")
    vectors = space.encode(sequence_of("rigid component").points[:1])
    number = 2  # the moon, which no joint touches
    blocks = space.split(vectors)
    rates = np.zeros((3, space.dim))
    for axis in range(3):
        q = blocks.rotations[0, number]
        across = np.eye(4)[axis] - q * q[axis]
        space.split(rates).rotations[axis, number] = across / np.linalg.norm(across)
    _, velocities = space.decode_moving(np.repeat(vectors, 3, axis=0), rates)
    moved = np.linalg.norm(velocities[:, space.decomposition.parts[number]], axis=2) / space.scale
    assert np.sqrt(np.square(moved).mean()) == pytest.approx(
        2 * space.radii[number] * np.sqrt(2 / 3), rel=0.05
    )


@pytest.mark.parametrize("name", SEQUENCES)
def test_decoding_is_posing_and_settling(name: str) -> None:
    space = anchored(name)
    vectors = space.encode(sequence_of(name).points).mean(axis=0, keepdims=True)
    blocks = space.split(vectors)
    motions = space.frames.motions(blocks.rotations[0], blocks.centres[0])
    posed = kernels.pose(motions, np.ascontiguousarray(blocks.unposed[0]))
    decoded = space.decode(vectors)[0] / space.scale
    np.testing.assert_allclose(decoded[~space.free], posed[~space.free], atol=1e-13)
    settled = space.seams.settle(motions, np.ascontiguousarray(blocks.sides[0]), posed)
    np.testing.assert_allclose(decoded, settled, atol=1e-13)


def test_decoding_is_linear_in_all_but_the_poses() -> None:
    space = anchored("bar")
    vectors = space.encode(sequence_of("bar").points)
    vectors[:, space.shape_dim :] = vectors[2, space.shape_dim :]
    weights = np.array([0.5, -0.25, 0.75, 0.0, 0.0])
    combined = space.decode((weights @ vectors)[None])[0]
    assert error(space, np.tensordot(weights, space.decode(vectors), 1), combined) < 1e-13


def test_lengths_and_angles_do_not_decide() -> None:
    space = anchored("bar")
    vectors = space.encode(sequence_of("bar").points)
    others = vectors.copy()
    others[:, : sum(space.sizes[:2])] = 0
    np.testing.assert_array_equal(space.decode(others), space.decode(vectors))


@pytest.mark.parametrize("name", MOVING)
@settings(max_examples=4, deadline=None)
@given(seed=seeds, scaled=st.booleans())
def test_velocities_are_derivatives_of_decoded_points(name: str, seed: int, scaled: bool) -> None:
    """At any combination of frames, along any rate; quaternions need not be of length one."""
    rng = np.random.default_rng(seed)
    space = anchored(name)
    vectors = space.encode(sequence_of(name).points)
    vector = (rng.dirichlet(np.ones(len(vectors))) @ vectors)[None]
    rate = (rng.normal(size=(1, len(vectors))) @ (vectors - vectors[0])) + 0.1 * rng.normal(size=vector.shape)
    if scaled:
        space.split(vector).rotations[:] *= rng.uniform(0.5, 2.0, (1, space.rotation_count, 1))
    points, velocities = space.decode_moving(vector, rate)
    np.testing.assert_allclose(points, space.decode(vector), atol=1e-12 * space.scale)
    step = 1e-5
    quotient = (space.decode(vector + step * rate) - space.decode(vector - step * rate)) / (2 * step)
    assert np.abs(velocities - quotient).max() < 1e-6 * np.abs(quotient).max()


def test_a_rate_of_a_rigid_motion_is_its_velocity() -> None:
    space, points = anchored("bar"), sequence_of("bar").points
    spin, speed, step = np.array([0.3, -1.0, 0.7]), np.array([1.0, 2.0, -1.0]), 1e-5
    moved = [points[2] @ rotation(sign * step * spin).T + sign * step * speed for sign in (1, -1)]
    ahead, behind = (space.encode(frame[None]) for frame in moved)
    _, velocities = space.decode_moving(space.encode(points[2:3]), (ahead - behind) / (2 * step))
    np.testing.assert_allclose(velocities[0], np.cross(spin, points[2]) + speed, atol=1e-6)


def test_still_vectors_have_no_velocity() -> None:
    space = anchored("three pages")
    vectors = space.encode(sequence_of("three pages").points)
    assert not space.decode_moving(vectors, np.zeros_like(vectors))[1].any()


def test_neighbours_see_the_middles_of_boundaries() -> None:
    space = anchored("bar", 3)
    boundaries = Boundaries.of(space.topology, space.decomposition.part_of_face)
    neighbours = space.neighbours
    assert neighbours.parts.tolist() == [[0, 1], [1, 0]]
    np.testing.assert_array_equal(neighbours.radii, space.radii)
    rest = space.frames.rest
    seen = neighbours.parts[:, 1]
    places = turned(rotations_of(rest.rotations[0, seen]), neighbours.pivots) + rest.centres[0, seen]
    np.testing.assert_allclose(places, np.tile(boundaries.middles(space.reference), (2, 1)), atol=1e-12)


@pytest.mark.parametrize("name", SEQUENCES)
def test_predictions_pass_through_the_frames(name: str) -> None:
    points = sequence_of(name).points
    space = anchored(name)
    vectors = space.encode(points)
    times = np.arange(len(points)) / 24
    both = at(space, vectors, Operator(times, 4.0), with_middles(times))
    np.testing.assert_allclose(both[::2], vectors, atol=1e-14)
    assert np.isfinite(space.decode(both)).all()


def test_bodies_that_do_not_touch_are_predicted_alone() -> None:
    """The moon has no neighbours."""
    space, points = anchored("rigid component"), sequence_of("rigid component").points
    assert 2 not in space.neighbours.parts
    placements = space.encode(points)[:, space.shape_dim :]
    operator, middles = Operator(np.arange(5.0)), np.arange(4.0) + 0.5
    found = space.poses(space.predicted_placements(operator, placements, middles))
    alone = predicted_alone(operator.at(middles), space.poses(placements))
    np.testing.assert_allclose(found.rotations[:, 2], alone.rotations[:, 2], atol=1e-12)
    np.testing.assert_allclose(found.centres[:, 2], alone.centres[:, 2], atol=1e-12)


def test_between_frames_a_body_turns_as_evenly_as_at_them() -> None:
    """By 160 degrees a frame, several times around."""
    mesh = tube(6, 9)
    axis, step = np.array([2.0, -1, 2]) / 3, np.radians(160)
    centred = mesh[0] - mesh[0].mean(axis=0)
    points = np.stack([centred @ rotation(axis * step * number).T for number in range(8)])
    space = of_slices(points, mesh)
    times = np.linspace(0, 7, 50)
    decoded = space.decode(at(space, space.encode(points), Operator(np.arange(8.0)), times))
    expected = np.stack([centred @ rotation(axis * step * time).T for time in times])
    assert error(space, expected, decoded) < 1e-11


def test_half_way_a_joint_bends_by_half() -> None:
    """Of two frames, a quarter turn apart: vertices that no blend touches are where they were."""
    mesh = tube(8, 33)
    angles = np.radians([0.0, 30.0, 60.0, 90.0])
    points = np.stack([bent(mesh[0], angle) for angle in angles])
    space = of_slices(points, mesh, 2.0)
    operator = Operator(np.arange(4.0))
    middle = space.decode(at(space, space.encode(points), operator, np.array([1.5])))[0]
    expected = bent(mesh[0], np.radians(45))
    splined = operator.at(np.array([1.5])).of(points)[0]
    assert np.abs(middle - expected).max() < 0.25 * np.abs(splined - expected).max()
    rigid = np.abs(mesh[0][:, 2] - 2) > 1
    assert np.abs(middle - expected)[rigid].max() < 0.1 * np.abs(splined - expected)[rigid].max()


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
    decoded = space.decode(at(space, vectors, Operator(frames), times))
    truth, _ = chain(np.interp(times, frames, bends), links)
    splined = Operator(frames).at(times).of(points)
    steps, true_steps = (np.linalg.norm(np.diff(x, axis=0), axis=2).max() for x in (decoded, truth))
    assert steps < 1.05 * true_steps
    assert np.abs(decoded - truth).max() < 0.5 * np.abs(splined - truth).max()


def test_signs_go_on_body_by_body() -> None:
    """Within a frame neighbours have signs that agree; from frame to frame those of a body change together."""
    points, mesh = chain(np.radians(np.linspace(0, 170, 11)), 4)
    space = of_slices(points, mesh, 4.0, 8.0, 12.0)
    turns = space.poses(space.encode(points)[:, space.shape_dim :]).rotations
    assert not space.frames.bodies.any()
    relative = product(turns, inverse(space.frames.rest.rotations[0]))
    first, second = Boundaries.of(space.topology, space.decomposition.part_of_face).parts.T
    assert (np.einsum("tpi,tpi->tp", relative[:, first], relative[:, second]) > 0).all()
    assert (np.einsum("tpi,tpi->t", turns[1:], turns[:-1]) > 0).all()
    apart = space.poses(space.encode_apart(points)[:, space.shape_dim :]).rotations
    assert (np.ptp(np.sign(np.einsum("tpi,tpi->tp", turns, apart)), axis=1) == 0).all()


def test_a_space_of_other_frames_knows_its_reference() -> None:
    """The first frame encoded stays near its angles, whatever it is."""
    sequence = bar(frames=2)
    topology = topology_of((sequence.points[0], sequence.faces.astype(np.int64)))
    space = mixed_space(
        sequence.points, topology, decompose(topology, np.zeros(len(sequence.faces), dtype=np.int64))
    )
    assert isinstance(space, AnchoredSpace)
    np.testing.assert_array_equal(space.reference, sequence.points[0] / space.scale)
    np.testing.assert_array_equal(space.shares.toarray(), 1.0)
    assert space.sizes == (0, 0, 3 * sequence.vertex_count, 0, 4, 3)
