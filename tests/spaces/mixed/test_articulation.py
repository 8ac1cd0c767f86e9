"""Rigid frames of vertices: closed forms for two parts, signs along chains, derivatives."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from mixseq.spaces.mixed.vertex_frames import VertexFrames, rest_poses
from scipy import sparse

from mixseq.arrays import Float
from mixseq.geometry.rotations import normalised, product, quaternions, rotations_of, turned
from mixseq.prediction.poses import Poses
from mixseq.segmentation import decompose
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from tests.meshes import grid, joined, rigid_motions, rotation, seeds, topology_of, tube
from tests.spaces.mixed.made import sliced

AXIS = np.array([2.0, -1.0, 2.0]) / 3
MESH = tube(6, 17)


def in_links(parts: int, rest: Poses | None = None) -> VertexFrames:
    """A tube of links of equal length; every vertex has half a share in the links at the nearest boundary.

    Without other poses at rest the links are centred in their middles, and not turned.
    """
    cuts = np.linspace(0, 4, parts + 1)
    decomposition = decompose(topology_of(MESH), sliced(MESH, *cuts[1:-1]), 1)
    labels = decomposition.part_of_face
    along = np.array([MESH[0][MESH[1][labels == part]][:, :, 2].mean() for part in range(parts)])
    order = np.argsort(along)
    nearest = np.clip(np.round(MESH[0][:, 2] / 4 * parts), 1, parts - 1).astype(int)
    shares = np.zeros((len(MESH[0]), parts))
    for part in (order[nearest - 1], order[nearest]):
        shares[np.arange(len(shares)), part] += 0.5
    middles = np.zeros((parts, 3))
    middles[order, 2] = (cuts[1:] + cuts[:-1]) / 2
    rest = rest or Poses(np.tile(np.eye(4)[:1], (1, parts, 1)), middles[None])
    return VertexFrames(topology_of(MESH), decomposition, rest, sparse.csr_array(shares))


def bent(frames: VertexFrames, bend: float, axis: Float = AXIS) -> tuple[Float, Float]:
    """Poses of links that each bend by an angle from the one before, at the boundaries between them."""
    parts = len(frames.decomposition.parts)
    rotations, centres = np.zeros((parts, 4)), np.zeros((parts, 3))
    pivot, half = np.zeros(3), np.array([0, 0, 2.0 / parts])
    for number, part in enumerate(np.argsort(frames.rest.centres[0, :, 2])):
        turn = rotation(axis * bend * number)
        centres[part] = pivot + turn @ half
        rotations[part] = quaternions(turn)
        pivot = pivot + 2 * turn @ half
    return rotations, centres


def wild(seed: int, parts: int) -> tuple[Float, Float]:
    rng = np.random.default_rng(seed)
    near = normalised([1.0, 0, 0, 0] + 0.3 * rng.normal(size=(parts, 4)))
    return product(near, normalised(rng.normal(size=4))), rng.normal(size=(parts, 3))


def moved(motions: Float, points: Float) -> Float:
    return turned(rotations_of(motions[:, :4]), points) + motions[:, 4:]


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 2, -2.0, 3.1])
def test_with_half_a_share_a_vertex_turns_by_half_the_angle(angle: float) -> None:
    """The axis stays where it is."""
    frames = in_links(2)
    motions = frames.motions(*bent(frames, angle))
    half = rotation(AXIS * angle / 2)
    np.testing.assert_allclose(
        rotations_of(motions[:, :4]), np.broadcast_to(half, (len(motions), 3, 3)), atol=1e-14
    )
    pivot = np.array([0, 0, 2.0])
    np.testing.assert_allclose(moved(motions, MESH[0]), (MESH[0] - pivot) @ half.T + pivot, atol=1e-14)


def test_half_of_a_screw_is_half_the_turn_and_half_the_way() -> None:
    frames = in_links(2)
    rotations, centres = bent(frames, 1.4)
    upper = int(np.argmax(frames.rest.centres[0, :, 2]))
    centres[upper] += 0.6 * AXIS
    half, pivot = rotation(AXIS * 0.7), np.array([0, 0, 2.0])
    expected = (MESH[0] - pivot) @ half.T + pivot + 0.3 * AXIS
    np.testing.assert_allclose(moved(frames.motions(rotations, centres), MESH[0]), expected, atol=1e-14)


def test_who_follows_one_part_alone_moves_as_it_does() -> None:
    frames = in_links(3)
    part = np.arange(len(MESH[0])) % 3
    alone = VertexFrames(
        frames.topology, frames.decomposition, frames.rest, sparse.csr_array(np.eye(3)[part])
    )
    np.testing.assert_array_equal(alone.alone, part)
    assert (frames.alone == -1).all()
    rotations, centres = wild(0, 3)
    expected = turned(rotations_of(rotations[part]), MESH[0] - frames.rest.centres[0, part]) + centres[part]
    np.testing.assert_allclose(moved(alone.motions(rotations, centres), MESH[0]), expected, atol=1e-14)


def test_one_part_is_a_rigid_body() -> None:
    topology = topology_of(MESH)
    whole = decompose(topology, np.zeros(len(MESH[1]), dtype=np.int64))
    rest = rest_poses(rotation((0.3, -1.0, 0.2))[None], np.array([[1.0, 2.0, 3.0]]))
    frames = VertexFrames(topology, whole, rest, sparse.csr_array(np.ones((len(MESH[0]), 1))))
    turn = rotation((1.0, 0.3, -0.2))
    motions = frames.motions(quaternions(turn @ rotations_of(rest.rotations[0])), np.array([[0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(
        moved(motions, MESH[0]), (MESH[0] - [1, 2, 3]) @ turn.T + [0, 1, 0], atol=1e-13
    )


def test_at_rest_nothing_moves() -> None:
    frames = in_links(4, Poses(*(block[None] for block in wild(1, 4))))
    motions = frames.motions(frames.rest.rotations[0], frames.rest.centres[0])
    np.testing.assert_allclose(moved(motions, MESH[0]), MESH[0], atol=1e-14)


@settings(max_examples=10, deadline=None)
@given(seed=seeds, motion=rigid_motions)
def test_rigid_motions_of_all_parts_go_through(seed: int, motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    frames = in_links(4)
    rotations, centres = wild(seed, 4)
    here = moved(frames.motions(rotations, centres), MESH[0])
    carried = product(quaternions(turn), rotations), centres @ turn.T + shift
    there = moved(frames.motions(*carried), MESH[0])
    np.testing.assert_allclose(there, here @ turn.T + shift, atol=1e-11)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_neither_sign_nor_length_of_quaternions_matters(seed: int) -> None:
    frames = in_links(4)
    rotations, centres = wild(seed, 4)
    here = moved(frames.motions(rotations, centres), MESH[0])
    rng = np.random.default_rng(seed)
    other = rotations * rng.choice([-1.0, 1.0], (4, 1)) * rng.uniform(0.3, 3.0, (4, 1))
    np.testing.assert_allclose(moved(frames.motions(other, centres), MESH[0]), here, atol=1e-13)


@pytest.mark.parametrize("parts", [2, 4, 8])
@pytest.mark.parametrize("degrees", [10.0, 60.0, 100.0, 170.0])
def test_signs_follow_from_neighbour_to_neighbour(parts: int, degrees: float) -> None:
    """However far the ends of a chain turn against each other, between two links are the means of these two."""
    frames = in_links(parts)
    bend = np.radians(degrees)
    motions = frames.motions(*bent(frames, bend))
    boundary = np.clip(np.round(MESH[0][:, 2] / 4 * parts), 1, parts - 1)
    expected = np.stack([rotation(AXIS * bend * (number - 0.5)) for number in boundary])
    np.testing.assert_allclose(rotations_of(motions[:, :4]), expected, atol=1e-13)


def test_quaternions_get_signs_along_the_chain() -> None:
    """Those of the first part stays; eight links that bend by 100 degrees each go almost twice around."""
    frames = in_links(8)
    rotations, _ = bent(frames, np.radians(100.0))
    rng = np.random.default_rng(0)
    signed = frames.signed(rotations * rng.choice([-1.0, 1.0], (8, 1)) * np.sign(rotations[:, :1]))
    along = signed[np.argsort(frames.rest.centres[0, :, 2])]
    assert (np.einsum("pi,pi->p", along[1:], along[:-1]) > 0).all()
    np.testing.assert_array_equal(np.abs(signed), np.abs(rotations))
    np.testing.assert_array_equal(frames.signed(signed), signed)
    np.testing.assert_array_equal(frames.signed(-signed), -signed)
    assert frames.bodies.tolist() == [0] * 8


@pytest.mark.parametrize(
    ("degrees", "bends"), [(0.0, False), (19.0, False), (21.0, True), (-90.0, True), (300.0, True)]
)
def test_faces_bend_where_frames_of_corners_differ(degrees: float, bends: bool) -> None:
    """By more than 10 degrees: next to the middle ring, which turns by half the angle of the part above."""
    frames = in_links(2)
    upper = int(np.argmax(frames.rest.centres[0, :, 2]))
    shares = np.zeros((len(MESH[0]), 2))
    shares[:, upper] = np.select([MESH[0][:, 2] < 1.99, MESH[0][:, 2] < 2.01], [0.0, 0.5], 1.0)
    shares[:, 1 - upper] = 1 - shares[:, upper]
    ramp = VertexFrames(frames.topology, frames.decomposition, frames.rest, sparse.csr_array(shares))
    marked = ramp.bent(ramp.motions(*bent(frames, np.radians(degrees))))
    touching = (np.abs(MESH[0][MESH[1]][:, :, 2] - 2) < 0.01).any(axis=1)
    np.testing.assert_array_equal(marked, touching & bends)


def test_every_body_has_signs_of_its_own() -> None:
    mesh = joined(MESH, MESH, grid(1, 1))
    half = np.repeat([0, 1], len(MESH[1]) // 2)
    labels = np.concatenate([half, half + 2, [4, 4]])
    decomposition = decompose(topology_of(mesh), labels, 1)
    rest = rest_poses(np.tile(np.eye(3), (5, 1, 1)), np.zeros((5, 3)))
    shares = np.zeros((len(mesh[0]), 5))
    count = len(MESH[0])
    shares[:count, :2] = shares[count : 2 * count, 2:4] = 0.5
    shares[2 * count :, 4] = 1
    frames = VertexFrames(topology_of(mesh), decomposition, rest, sparse.csr_array(shares))
    assert frames.bodies.tolist() == [0, 0, 1, 1, 2]
    angles = np.array([0.0, 1.0, 3.0, 4.0, 6.0])
    turns = np.stack([rotation(AXIS * angle) for angle in angles])
    motions = frames.motions(quaternions(turns), np.zeros((5, 3)))
    expected = np.repeat([0.5, 3.5, 6.0], [count, count, 4])
    expected = np.stack([rotation(AXIS * angle) for angle in expected])
    np.testing.assert_allclose(rotations_of(motions[:, :4]), expected, atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_posing_and_unposing_are_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motions = np.concatenate([normalised(rng.normal(size=(30, 4))), rng.normal(size=(30, 3))], axis=1)
    x = rng.normal(size=(30, 3))
    np.testing.assert_allclose(kernels.pose(motions, x), moved(motions, x), atol=1e-13)
    np.testing.assert_allclose(kernels.pose(motions, kernels.unpose(motions, x)), x, atol=1e-12)
    np.testing.assert_allclose(kernels.unpose(motions, kernels.pose(motions, x)), x, atol=1e-12)


def test_an_even_turn_has_its_spin() -> None:
    """Upper half turns by 1 radian a second about the axis through the pivot, vertices between by half of that."""
    frames = in_links(2)
    rotations, centres = bent(frames, 0.8)
    upper = int(np.argmax(frames.rest.centres[0, :, 2]))
    pivot = np.array([0, 0, 2.0])
    rates, speeds = np.zeros((2, 4)), np.zeros((2, 3))
    rates[upper] = 0.5 * product(np.array([0, *AXIS]), rotations[upper])
    speeds[upper] = np.cross(AXIS, centres[upper] - pivot)
    motions, changes = frames.moving(rotations, centres, rates, speeds)
    np.testing.assert_array_equal(motions, frames.motions(rotations, centres))
    np.testing.assert_allclose(changes[:, :3], np.broadcast_to(AXIS / 2, (len(changes), 3)), atol=1e-14)
    x = kernels.pose(motions, MESH[0])
    velocities = kernels.pose_moving(motions, changes, x, np.zeros_like(x))
    np.testing.assert_allclose(velocities, np.cross(AXIS / 2, x - pivot), atol=1e-14)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_rates_are_difference_quotients(seed: int) -> None:
    """Quaternions need not be of length one, nor stay so."""
    frames = in_links(4, Poses(*(block[None] for block in wild(1, 4))))
    rng = np.random.default_rng(seed)
    rotations, centres = wild(seed, 4)
    rotations = rotations * rng.uniform(0.5, 2.0, (4, 1))
    rates, speeds = rng.normal(size=(4, 4)), rng.normal(size=(4, 3))
    unposed, changing = rng.normal(size=(2, len(MESH[0]), 3))
    step = 1e-6

    def at(time: float) -> tuple[Float, Float]:
        motions = frames.motions(rotations + time * rates, centres + time * speeds)
        return motions, kernels.pose(motions, unposed + time * changing)

    motions, changes = frames.moving(rotations, centres, rates, speeds)
    x = kernels.pose(motions, unposed)
    (_, ahead), (_, behind) = at(step), at(-step)
    quotient = (ahead - behind) / (2 * step)
    velocities = kernels.pose_moving(motions, changes, x, changing)
    assert np.abs(velocities - quotient).max() < 1e-6 * np.abs(quotient).max()
    faces = MESH[1].astype(np.int64)
    turns = [rotations_of(kernels.face_frames(at(time)[0], faces)) for time in (step, -step)]
    spinning = (turns[0] - turns[1]) / (2 * step)
    spinning = spinning @ np.swapaxes(rotations_of(kernels.face_frames(motions, faces)), 1, 2)
    measured = np.stack([spinning[:, 2, 1], spinning[:, 0, 2], spinning[:, 1, 0]], axis=1)
    spins = kernels.face_spins(motions, changes, faces)
    assert np.abs(spins - measured).max() < 1e-6 * np.abs(measured).max()


def test_frames_can_be_sent() -> None:
    frames = in_links(3)
    poses = bent(frames, 0.5)
    motions = frames.motions(*poses)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(frames)).motions(*poses), motions)
