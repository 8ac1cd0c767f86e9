"""Poses of parts between frames: joints that stay closed, bodies that turn, and nothing that depends on axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rotations import continued, product, quaternions, rotations_of, turned
from mixseq.spaces.mixed.articulation import Articulation, Steadiness
from mixseq.spaces.mixed.pose_prediction import PosePrediction
from mixseq.spaces.temporal import LENGTHS, Operator, Poses, chosen, predicted_alone, with_middles
from mixseq.types import Float, Index
from tests.meshes import rigid_motions, rotation, seeds
from tests.spaces.moving import turns_of, wandering


def related(pairs: Index, pivots: Float, radii: Float, rest: Float) -> Articulation:
    """Parts of one body, whose neighbours see each other at pivots."""
    count = len(radii)
    return Articulation(
        rest_centres=rest,
        radii=radii,
        masses=np.ones(count),
        areas=np.ones(count),
        bodies=np.zeros(count, dtype=np.int64),
        pairs=pairs,
        pivots=pivots,
        steadiness=Steadiness.equal(count, len(pairs)),
    )


def strangers(count: int) -> Articulation:
    rest = np.random.default_rng(0).normal(size=(count, 3))
    return related(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), np.full(count, 0.5), rest)


def ring(parts: int, seed: int = 0, alone: int = 0) -> Articulation:
    """Every part sees the one before and the one after it, but for the last ones, which are alone."""
    rng = np.random.default_rng(seed)
    pairs = np.stack([np.arange(parts), (np.arange(parts) + 1) % parts], axis=1)
    both, count = np.concatenate([pairs, pairs[:, ::-1]]), parts + alone
    pivots = rng.normal(scale=0.5, size=(len(both), 3))
    return related(both, pivots, rng.uniform(0.2, 1.0, count), rng.normal(size=(count, 3)))


def two_bones(bends: Float, turns: Float, shifts: Float) -> tuple[Poses, Articulation]:
    """A lower bone that moves about, and an upper one that is hinged to it at its end; both are 2 long."""
    lower = turns_of(turns)[:, 0]
    upper = product(lower, turns_of(bends, np.array([1.0, 0, 0]))[:, 0])
    end = np.array([0.0, 0.0, 1.0])
    pivots = shifts + turned(rotations_of(lower), end)
    centres = np.stack([shifts, pivots + turned(rotations_of(upper), end)], axis=1)
    poses = Poses(continued(np.stack([lower, upper], axis=1)), centres)
    rest = np.stack([0 * end, 2 * end])
    return poses, related(np.array([[0, 1], [1, 0]]), np.array([-end, end]), np.full(2, 0.6), rest)


def gaps(poses: Poses, parts: Articulation) -> Float:
    """How far the two ends of every pivot are apart, ``(N, n)``."""
    seen = parts.pairs[:, 1]
    places = turned(rotations_of(poses.rotations[:, seen]), parts.pivots) + poses.centres[:, seen]
    half = len(seen) // 2
    return np.asarray(np.linalg.norm(places[:, :half] - places[:, half:], axis=2))


def predicted(
    operator: Operator, poses: Poses, parts: Articulation, times: Float, in_body: bool = False
) -> Poses:
    bodies, seen = PosePrediction(parts, operator, poses, in_body).at(times)
    placed = parts.placed(seen, bodies)
    return placed._replace(rotations=continued(placed.rotations))


def moved(poses: Poses, turn: Float, shift: Float) -> Poses:
    return Poses(product(quaternions(turn), poses.rotations), poses.centres @ turn.T + shift)


@settings(max_examples=15, deadline=None)
@given(
    seed=seeds,
    length=st.sampled_from(LENGTHS),
    frames=st.sampled_from([2, 3, 12, 60]),
    in_body=st.booleans(),
)
def test_frames_are_passed(seed: int, length: float, frames: int, in_body: bool) -> None:
    poses = wandering(seed, 3, frames)
    times = np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, frames))
    found = predicted(Operator(times, length), poses, ring(3), with_middles(times), in_body)
    np.testing.assert_allclose(found.centres[::2], poses.centres, atol=1e-12)
    np.testing.assert_allclose(rotations_of(found.rotations)[::2], rotations_of(poses.rotations), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found.rotations, axis=2), 1.0, atol=1e-14)
    assert (np.einsum("tpi,tpi->tp", found.rotations[1:], found.rotations[:-1]) > 0).all()


@pytest.mark.parametrize("in_body", [False, True])
def test_fused_poses_come_near_frames_without_a_jump(in_body: bool) -> None:
    """What is solved for near a frame goes to what is taken over at the frame."""
    poses, operator = wandering(3, 4), Operator(np.arange(12.0), 2.0)
    near = predicted(operator, poses, ring(4), np.array([4.0, 4.0 + 1e-7, 5.0 - 1e-7, 5.0]), in_body)
    for block in near:
        np.testing.assert_allclose(block[1], block[0], atol=1e-6)
        np.testing.assert_allclose(block[2], block[3], atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, motion=rigid_motions, parts=st.integers(1, 5), in_body=st.booleans())
def test_rigid_motions_of_everything_go_through(
    seed: int, motion: tuple[Float, Float], parts: int, in_body: bool
) -> None:
    poses, articulation = wandering(seed, parts), ring(parts) if parts > 1 else strangers(1)
    operator = Operator(np.arange(12.0), 4.0)
    times = with_middles(operator.times)
    here = moved(predicted(operator, poses, articulation, times, in_body), *motion)
    there = predicted(operator, moved(poses, *motion), articulation, times, in_body)
    np.testing.assert_allclose(rotations_of(there.rotations), rotations_of(here.rotations), atol=1e-9)
    np.testing.assert_allclose(there.centres, here.centres, atol=1e-9)


@pytest.mark.parametrize("frames", [2, 4, 12])
def test_in_the_body_a_turn_of_all_is_no_motion_of_parts(frames: int) -> None:
    """Parts of a body that turns about its middle keep their distances; each in the world takes a chord."""
    chain = ring(3)
    rest = chain.rest_centres - chain.rest_centres.mean(axis=0)
    turns = turns_of(np.radians(80.0) * np.arange(float(frames)))
    turns = np.repeat(turns, 3, axis=1)
    poses = Poses(turns, turned(rotations_of(turns), rest))
    operator, middles = Operator(np.arange(float(frames))), np.arange(frames - 1.0) + 0.5
    _, seen = PosePrediction(chain, operator, poses, in_body=True).at(middles)
    np.testing.assert_allclose(seen.centres, np.broadcast_to(rest, seen.centres.shape), atol=1e-6)
    back = rotations_of(turns_of(np.radians(80.0) * middles)).swapaxes(2, 3)
    alone = predicted_alone(operator.at(middles), poses)
    assert np.abs(turned(back, alone.centres) - rest).max() > 1e-2


def test_units_of_length_matter_only_where_errors_are_small() -> None:
    """A mesh that is twice as large moves twice as far, but for errors below `FLOOR`."""
    poses, parts, times = wandering(6, 3), ring(3), np.arange(12.0)
    here = predicted(Operator(times), poses, parts, with_middles(times))
    twice = related(parts.pairs, 2 * parts.pivots, 2 * parts.radii, 2 * parts.rest_centres)
    there = predicted(Operator(times), Poses(poses.rotations, 2 * poses.centres), twice, with_middles(times))
    np.testing.assert_allclose(there.centres, 2 * here.centres, atol=1e-4)


@pytest.mark.parametrize("frames", [4, 12])
@pytest.mark.parametrize("in_body", [False, True])
def test_joints_stay_closed(frames: int, in_body: bool) -> None:
    """Each on its own the bones come apart; what they see of each other keeps them together."""
    rng = np.random.default_rng(frames)
    bends, turns = np.cumsum(rng.uniform(-1.5, 1.5, (2, frames)), axis=1)
    poses, bones = two_bones(bends, turns, np.cumsum(rng.normal(scale=0.3, size=(frames, 3)), axis=0))
    assert gaps(poses, bones).max() < 1e-12
    times = np.arange(frames) / 24
    operator, middles = Operator(times), (times[1:] + times[:-1]) / 2
    alone = gaps(predicted_alone(operator.at(middles), poses), bones)
    together = gaps(predicted(operator, poses, bones, middles, in_body), bones)
    assert alone.mean() > 0.05
    assert together.mean() < 0.6 * alone.mean()
    assert together.max() < alone.max()


def test_an_elbow_that_bends_evenly_is_predicted() -> None:
    """Sparse frames: the forearm's centre is on a circle, of which the spline knows four points."""
    angles = np.radians([0.0, 60.0, 120.0, 180.0])
    poses, bones = two_bones(angles, np.zeros(4), np.zeros((4, 3)))
    operator, middles = Operator(np.arange(4.0)), np.arange(3.0) + 0.5
    expected, _ = two_bones(np.radians([30.0, 90.0, 150.0]), np.zeros(3), np.zeros((3, 3)))
    alone = predicted_alone(operator.at(middles), poses)
    together = predicted(operator, poses, bones, middles)
    off = [gaps(found, bones).max() for found in (alone, together)]
    assert off[1] < 0.5 * off[0]
    np.testing.assert_allclose(rotations_of(together.rotations), rotations_of(expected.rotations), atol=5e-3)


def test_parts_that_move_as_one_nearly_stay_as_they_are_to_each_other() -> None:
    """Their relations do not change at all, and weigh as much as errors of `FLOOR` let them."""
    body, parts = wandering(7, 1), ring(3)
    rest = np.random.default_rng(2).normal(size=(3, 3))
    turns = np.repeat(body.rotations, 3, axis=1)
    poses = Poses(turns, turned(rotations_of(turns), rest) + body.centres)
    operator, middles = Operator(np.arange(12.0)), np.arange(11.0) + 0.5

    def away(found: Poses) -> Float:
        back = np.swapaxes(rotations_of(found.rotations[:, :1]), -1, -2)
        seen = turned(back, found.centres - found.centres[:, :1])
        return np.asarray(np.linalg.norm(seen - (rest - rest[0]), axis=2)[:, 1:])

    found = predicted(operator, poses, parts, middles)
    assert away(found).mean() < 0.5 * away(predicted_alone(operator.at(middles), poses)).mean()
    cosines = np.einsum("tpi,ti->tp", found.rotations, found.rotations[:, 0])
    assert cosines.min() > 1 - 1e-8


@pytest.mark.parametrize("in_body", [False, True])
def test_what_is_still_stays(in_body: bool) -> None:
    poses = Poses(*(np.repeat(block[:1], 6, axis=0) for block in wandering(8, 4)))
    times = np.arange(6.0)
    found = predicted(chosen(times, np.zeros((6, 3))), poses, ring(4), with_middles(times), in_body)
    for block, own in zip(found, poses, strict=True):
        np.testing.assert_allclose(block, np.broadcast_to(own[0], block.shape), atol=1e-9)


def test_who_has_no_neighbours_is_alone() -> None:
    poses, operator, middles = wandering(10, 4), Operator(np.arange(12.0)), np.arange(11.0) + 0.5
    alone = predicted_alone(operator.at(middles), poses)
    for parts, some in ((strangers(4), slice(None)), (ring(3, alone=1), slice(3, None))):
        found = predicted(operator, poses, parts, middles)
        turns, expected = (rotations_of(each.rotations[:, some]) for each in (found, alone))
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_allclose(found.centres[:, some], alone.centres[:, some], atol=1e-12)


@pytest.mark.parametrize("in_body", [False, True])
def test_one_frame_is_everywhere(in_body: bool) -> None:
    poses = wandering(11, 3, 1)
    found = predicted(Operator(np.array([0.5])), poses, ring(3), np.array([0.0, 0.5, 2.0]), in_body)
    turns = rotations_of(found.rotations)
    np.testing.assert_allclose(turns, np.repeat(rotations_of(poses.rotations), 3, axis=0), atol=1e-12)
    np.testing.assert_allclose(found.centres, np.repeat(poses.centres, 3, axis=0), atol=1e-12)


def test_between_two_frames_bones_bend_by_half() -> None:
    """As seen from their body, which turns by half of what both turn by."""
    poses, bones = two_bones(np.radians([0.0, 90.0]), np.zeros(2), np.zeros((2, 3)))
    found = predicted(Operator(np.array([0.0, 1.0])), poses, bones, np.array([0.5]))
    between = product(found.rotations[0, :1] * [1.0, -1, -1, -1], found.rotations[0, 1:])
    np.testing.assert_allclose(rotations_of(between)[0], rotation((np.pi / 4, 0, 0)), atol=1e-9)


def test_many_times_are_predicted_in_blocks() -> None:
    poses, operator = wandering(4, 3), Operator(np.arange(12.0))
    times = np.linspace(0.01, 10.99, 150)
    whole = predicted(operator, poses, ring(3), times, True)
    for number in (0, 63, 64, 149):
        single = predicted(operator, poses, ring(3), times[number : number + 1], True)
        turns, expected = (rotations_of(each) for each in (single.rotations[0], whole.rotations[number]))
        np.testing.assert_allclose(turns, expected, atol=1e-12)
        np.testing.assert_allclose(single.centres[0], whole.centres[number], atol=1e-12)
