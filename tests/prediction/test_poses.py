"""Poses between frames: closed forms for even turns, joints that stay closed, nothing that depends on axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.arrays import Float, Index
from mixseq.geometry.rotations import continued, normalised, product, quaternions, rotations_of, turned
from mixseq.prediction.operator import LENGTHS, Operator, chosen, with_middles
from mixseq.prediction.poses import Neighbours, Poses, blended, chained, predicted, predicted_alone
from tests.meshes import rigid_motions, rotation, seeds

AXIS = np.array([2.0, -1.0, 2.0]) / 3

NOBODY = Neighbours(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), np.ones(1))


def turns_of(angles: Float, axis: Float = AXIS) -> Float:
    """Quaternions ``(T, 1, 4)`` of turns about an axis."""
    half = np.asarray(angles)[:, None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)[:, None]


def wandering(seed: int, parts: int, frames: int = 12) -> Poses:
    """Parts that turn and move about by chance, a little every frame."""
    rng = np.random.default_rng(seed)
    q = normalised(rng.normal(size=(1, parts, 4)))
    path = [q[0]]
    for _ in range(frames - 1):
        path.append(product(path[-1], normalised([1.0, 0, 0, 0] + 0.3 * rng.normal(size=(parts, 4)))))
    return Poses(continued(np.stack(path)), np.cumsum(rng.normal(scale=0.2, size=(frames, parts, 3)), axis=0))


def ring(parts: int, seed: int = 0) -> Neighbours:
    """Every part sees the one before and the one after it."""
    rng = np.random.default_rng(seed)
    pairs = np.stack([np.arange(parts), (np.arange(parts) + 1) % parts], axis=1)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return Neighbours(both, rng.normal(scale=0.5, size=(len(both), 3)), rng.uniform(0.2, 1.0, parts))


def two_bones(bends: Float, turns: Float, shifts: Float) -> tuple[Poses, Neighbours]:
    """A lower bone that moves about, and an upper one that is hinged to it at its end; both are 2 long."""
    lower = turns_of(turns)[:, 0]
    upper = product(lower, turns_of(bends, np.array([1.0, 0, 0]))[:, 0])
    end = np.array([0.0, 0.0, 1.0])
    pivots = shifts + turned(rotations_of(lower), end)
    centres = np.stack([shifts, pivots + turned(rotations_of(upper), end)], axis=1)
    pairs: Index = np.array([[0, 1], [1, 0]])
    poses = Poses(continued(np.stack([lower, upper], axis=1)), centres)
    return poses, Neighbours(pairs, np.array([-end, end]), np.full(2, 0.6))


def gaps(poses: Poses, neighbours: Neighbours) -> Float:
    """How far the two ends of every pivot are apart, ``(N, n)``."""
    parts = neighbours.parts[:, 1]
    places = turned(rotations_of(poses.rotations[:, parts]), neighbours.pivots) + poses.centres[:, parts]
    half = len(parts) // 2
    return np.asarray(np.linalg.norm(places[:, :half] - places[:, half:], axis=2))


@pytest.mark.parametrize("step", [0.0, 20.0, 90.0, 179.0, -120.0])
@pytest.mark.parametrize("length", LENGTHS)
def test_even_turns_go_on_evenly_however_many(step: float, length: float) -> None:
    frames = np.arange(20.0)
    operator = Operator(frames, length)
    times = np.linspace(0, 19, 77)
    found = chained(operator.at(times), turns_of(np.radians(step) * frames))
    expected = np.stack([rotation(AXIS * np.radians(step) * time) for time in times])
    np.testing.assert_allclose(rotations_of(found[:, 0]), expected, atol=1e-11)
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found[1:], found[:-1]) > 0).all()


def test_turns_about_one_axis_are_angles_that_are_predicted() -> None:
    times, angles = np.arange(9) / 24, np.cumsum(np.random.default_rng(0).uniform(-1.5, 1.5, 9))
    operator = Operator(times, 2.8)
    middles = (times[1:] + times[:-1]) / 2
    found = chained(operator.at(middles), turns_of(angles))
    expected = turns_of(operator.at(middles).of(angles))
    np.testing.assert_allclose(rotations_of(found), rotations_of(expected), atol=1e-13)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, length=st.sampled_from(LENGTHS), frames=st.sampled_from([2, 3, 12, 60]))
def test_frames_are_passed(seed: int, length: float, frames: int) -> None:
    poses = wandering(seed, 3, frames)
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, frames))
    operator = Operator(times, length)
    for found in (predicted_alone(operator.at(times), poses), predicted(operator, poses, ring(3), times)):
        np.testing.assert_allclose(found.rotations, poses.rotations, atol=1e-15)
        np.testing.assert_array_equal(found.centres, poses.centres)
    between = predicted(operator, poses, ring(3), with_middles(times))
    np.testing.assert_allclose(between.rotations[::2], poses.rotations, atol=1e-15)
    np.testing.assert_array_equal(between.centres[::2], poses.centres)
    np.testing.assert_allclose(np.linalg.norm(between.rotations, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", between.rotations[1:], between.rotations[:-1]) > 0).all()


def test_fused_poses_come_near_frames_without_a_jump() -> None:
    """What is solved for near a frame goes to what is taken over at the frame."""
    poses, neighbours = wandering(3, 4), ring(4)
    operator = Operator(np.arange(12.0), 2.0)
    near = predicted(operator, poses, neighbours, np.array([4.0, 4.0 + 1e-7, 5.0 - 1e-7, 5.0]))
    for block in near:
        np.testing.assert_allclose(block[1], block[0], atol=1e-6)
        np.testing.assert_allclose(block[2], block[3], atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, motion=rigid_motions, parts=st.integers(1, 5))
def test_rigid_motions_of_everything_go_through(seed: int, motion: tuple[Float, Float], parts: int) -> None:
    turn, shift = motion
    poses, neighbours = wandering(seed, parts), ring(parts) if parts > 1 else NOBODY
    moved = Poses(product(quaternions(turn), poses.rotations), poses.centres @ turn.T + shift)
    times = np.arange(12.0)
    here, there = (
        predicted(Operator(times, 4.0), p, neighbours, with_middles(times)) for p in (poses, moved)
    )
    np.testing.assert_allclose(rotations_of(there.rotations), turn @ rotations_of(here.rotations), atol=1e-9)
    np.testing.assert_allclose(there.centres, here.centres @ turn.T + shift, atol=1e-9)


def test_axes_of_parts_do_not_matter() -> None:
    """Parts may be turned in their own axes: then they see pivots there, and are predicted the same."""
    poses, neighbours = wandering(5, 3), ring(3)
    own = normalised(np.random.default_rng(1).normal(size=(3, 4)))
    back = np.swapaxes(rotations_of(own), 1, 2)[neighbours.parts[:, 1]]
    others = Neighbours(neighbours.parts, turned(back, neighbours.pivots), neighbours.radii)
    times = np.arange(12.0)
    here = predicted(Operator(times), poses, neighbours, with_middles(times))
    changed = Poses(product(poses.rotations, own), poses.centres)
    there = predicted(Operator(times), changed, others, with_middles(times))
    np.testing.assert_allclose(
        rotations_of(there.rotations), rotations_of(product(here.rotations, own)), atol=1e-9
    )
    np.testing.assert_allclose(there.centres, here.centres, atol=1e-9)


def test_units_of_length_matter_only_where_errors_are_small() -> None:
    """A mesh that is twice as large moves twice as far, but for errors below `FLOOR`."""
    poses, neighbours = wandering(6, 3), ring(3)
    times = np.arange(12.0)
    here = predicted(Operator(times), poses, neighbours, with_middles(times))
    twice = Neighbours(neighbours.parts, 2 * neighbours.pivots, 2 * neighbours.radii)
    there = predicted(Operator(times), Poses(poses.rotations, 2 * poses.centres), twice, with_middles(times))
    np.testing.assert_allclose(there.centres, 2 * here.centres, atol=1e-4)


@pytest.mark.parametrize("frames", [4, 12])
def test_joints_stay_closed(frames: int) -> None:
    """Each on its own the bones come apart; what they see of each other keeps them together."""
    rng = np.random.default_rng(frames)
    bends, turns = np.cumsum(rng.uniform(-1.5, 1.5, (2, frames)), axis=1)
    poses, neighbours = two_bones(bends, turns, np.cumsum(rng.normal(scale=0.3, size=(frames, 3)), axis=0))
    assert gaps(poses, neighbours).max() < 1e-12
    times = np.arange(frames) / 24
    operator, middles = Operator(times), (times[1:] + times[:-1]) / 2
    alone = gaps(predicted_alone(operator.at(middles), poses), neighbours)
    together = gaps(predicted(operator, poses, neighbours, middles), neighbours)
    assert alone.mean() > 0.05
    assert together.mean() < 0.4 * alone.mean()
    assert together.max() < 0.4 * alone.max()


def test_an_elbow_that_bends_evenly_is_predicted() -> None:
    """Sparse frames: the forearm's centre is on a circle, of which the spline knows four points."""
    angles = np.radians([0.0, 60.0, 120.0, 180.0])
    poses, neighbours = two_bones(angles, np.zeros(4), np.zeros((4, 3)))
    times = np.arange(4.0)
    middles = times[:-1] + 0.5
    expected, _ = two_bones(np.radians([30.0, 90.0, 150.0]), np.zeros(3), np.zeros((3, 3)))
    operator = Operator(times)
    alone = predicted_alone(operator.at(middles), poses)
    together = predicted(operator, poses, neighbours, middles)
    errors = [np.abs(found.centres - expected.centres).max() for found in (alone, together)]
    assert errors[1] < 0.2 * errors[0]
    np.testing.assert_allclose(rotations_of(together.rotations), rotations_of(expected.rotations), atol=5e-3)


def test_parts_that_move_as_one_nearly_stay_as_they_are_to_each_other() -> None:
    """Their relations do not change at all, and weigh as much as errors of `FLOOR` let them."""
    body, neighbours = wandering(7, 1), ring(3)
    rest = np.random.default_rng(2).normal(size=(3, 3))
    turns = np.repeat(body.rotations, 3, axis=1)
    poses = Poses(turns, turned(rotations_of(turns), rest) + body.centres)
    times = np.arange(12.0)
    operator, middles = Operator(times), times[:-1] + 0.5

    def away(found: Poses) -> Float:
        back = np.swapaxes(rotations_of(found.rotations[:, :1]), -1, -2)
        seen = turned(back, found.centres - found.centres[:, :1])
        return np.asarray(np.linalg.norm(seen - (rest - rest[0]), axis=2)[:, 1:])

    found, alone = (
        predicted(operator, poses, neighbours, middles),
        predicted_alone(operator.at(middles), poses),
    )
    assert away(found).mean() < 0.5 * away(alone).mean()
    cosines = np.einsum("tpi,ti->tp", found.rotations, found.rotations[:, 0])
    assert cosines.min() > 1 - 1e-8


def test_what_is_still_stays() -> None:
    poses = Poses(*(np.repeat(block[:1], 6, axis=0) for block in wandering(8, 4)))
    times = np.arange(6.0)
    found = predicted(chosen(times, np.zeros((6, 3))), poses, ring(4), with_middles(times))
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.broadcast_to(own[0], block.shape), atol=1e-9)


def test_without_neighbours_each_is_alone() -> None:
    poses, times = wandering(9, 3), np.arange(12.0)
    operator = Operator(times, 2.0)
    found, alone = (
        predicted(operator, poses, NOBODY, times + 0.3),
        predicted_alone(operator.at(times + 0.3), poses),
    )
    for block, expected in zip(found, alone, strict=True):
        np.testing.assert_array_equal(block, expected)


def test_who_has_no_neighbours_is_alone_among_others() -> None:
    poses, times = wandering(10, 4), np.arange(12.0)
    some = ring(3)
    neighbours = Neighbours(some.parts, some.pivots, np.full(4, 0.5))
    operator, middles = Operator(times), np.arange(11.0) + 0.5
    found, alone = (
        predicted(operator, poses, neighbours, middles),
        predicted_alone(operator.at(middles), poses),
    )
    np.testing.assert_allclose(
        rotations_of(found.rotations[:, 3]), rotations_of(alone.rotations[:, 3]), atol=1e-12
    )
    np.testing.assert_allclose(found.centres[:, 3], alone.centres[:, 3], atol=1e-12)


def test_one_frame_is_everywhere() -> None:
    poses = wandering(11, 3, 1)
    found = predicted(Operator(np.array([0.5])), poses, ring(3), np.array([0.0, 0.5, 2.0]))
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.repeat(own, 3, axis=0), atol=1e-15)


def test_between_two_frames_a_joint_bends_by_half() -> None:
    poses, neighbours = two_bones(np.radians([0.0, 90.0]), np.zeros(2), np.zeros((2, 3)))
    operator = Operator(np.array([0.0, 1.0]))
    found = predicted(operator, poses, neighbours, np.array([0.5]))
    alone = predicted_alone(operator.at(np.array([0.5])), poses)
    np.testing.assert_allclose(alone.rotations[0, 1], turns_of(np.array([np.pi / 4]), np.eye(3)[0])[0, 0])
    np.testing.assert_allclose(rotations_of(found.rotations[0, 1]), rotation((np.pi / 4, 0, 0)), atol=0.02)
    assert gaps(found, neighbours).max() < 0.8 * gaps(alone, neighbours).max()


@pytest.mark.parametrize("weight", [-0.5, 0.25, 0.5, 0.75, 1.5])
def test_a_hinge_opens_less_between_far_poses(weight: float) -> None:
    """Sums of centres open the hinge of two bones that turn, as chords are shorter than arcs."""
    poses, neighbours = two_bones(
        np.array([0.0, 1.2]), np.array([0.0, 0.8]), np.array([[0.0, 0, 0], [1, 0, 2]])
    )
    weights = np.array([1.0 - weight, weight])
    alone = Poses(
        normalised(np.tensordot(weights, poses.rotations, 1))[None],
        np.tensordot(weights, poses.centres, 1)[None],
    )
    opened = gaps(alone, neighbours).max()
    assert opened > 0.03
    assert gaps(blended(weights, poses, neighbours), neighbours).max() < 0.5 * opened


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_a_blend_of_one_pose_is_that_pose(seed: int) -> None:
    poses, neighbours = wandering(seed, 4, frames=3), ring(4, seed)
    for number in range(3):
        found = blended(np.eye(3)[number], poses, neighbours)
        np.testing.assert_allclose(found.rotations[0], poses.rotations[number], atol=1e-12)
        np.testing.assert_allclose(found.centres[0], poses.centres[number], atol=1e-12)


@given(seed=seeds, motion=rigid_motions)
@settings(max_examples=20, deadline=None)
def test_blends_of_moved_poses_are_moved(seed: int, motion: tuple[Float, Float]) -> None:
    poses, neighbours = wandering(seed, 4, frames=3), ring(4, seed)
    turn, shift = motion
    moved = Poses(product(quaternions(turn), poses.rotations), poses.centres @ turn.T + shift)
    weights = np.array([0.5, 0.2, 0.3])
    found, expected = blended(weights, moved, neighbours), blended(weights, poses, neighbours)
    turns = turn @ rotations_of(expected.rotations)
    np.testing.assert_allclose(rotations_of(found.rotations), turns, atol=1e-8)
    np.testing.assert_allclose(found.centres, expected.centres @ turn.T + shift, atol=1e-8)
