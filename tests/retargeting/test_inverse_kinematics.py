"""Limbs that reach for a point."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.rotations import matrices, vectors
from mixseq.retargeting.limbs import turn_limbs

FADE = np.sin(np.linspace(0.0, np.pi, 81)) ** 2


def leg(bend: float, frames: int = 1) -> np.ndarray:
    """Levers (frames, 1, 3, 3) of a leg of length 1 with a foot; thigh and shank are off the vertical by `bend`."""
    s, c = 0.5 * np.sin(bend), 0.5 * np.cos(bend)
    return np.tile(np.array([[s, -c, 0], [-s, -c, 0], [0.1, -0.05, 0]]), (frames, 1, 1, 1))


def ends(levers: np.ndarray, turns: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("nkij,ngkj->ngi", turns, levers))


ANKLE = np.array([1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    "move", [[0.1, 0, 0], [0, 0.05, 0], [0, -0.05, 0], [0, 0, 0.1], [0.05, 0.02, 0.05]], ids=str
)
def test_a_bent_leg_reaches_its_goal(move: list[float]) -> None:
    levers = leg(0.6)
    turns, left = turn_limbs(levers, np.array([[move]]), ANKLE)
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends(levers, turns) - levers.sum(axis=2), [[move]], atol=1e-12)
    np.testing.assert_array_equal(turns[:, 2], np.eye(3)[None])  # the sole stays level
    np.testing.assert_allclose(
        turns @ np.swapaxes(turns, -1, -2), np.tile(np.eye(3), (1, 3, 1, 1)), atol=1e-14
    )


def test_one_bone_swings_like_a_pendulum() -> None:
    angle = 0.3
    levers = np.array([[[[0.0, -2.0, 0.0]]]])
    swung = 2.0 * np.array([np.sin(angle), -np.cos(angle), 0.0])
    turns, left = turn_limbs(levers, (swung - levers[0, 0])[None], np.ones(1))
    direction = ends(levers, turns)[0, 0] / 2.0
    # The move along the bone is not made by turning it; across it, all is.
    assert np.degrees(np.arccos(direction @ swung / 2.0)) < 3.0
    np.testing.assert_allclose(
        ends(levers, turns) - levers[:, :, 0] + left, (swung - levers[0, 0])[None], atol=1e-15
    )


def test_nothing_turns_for_nothing() -> None:
    turns, left = turn_limbs(leg(0.3), np.zeros((1, 1, 3)), ANKLE)
    np.testing.assert_array_equal(turns, np.tile(np.eye(3), (1, 3, 1, 1)))
    np.testing.assert_array_equal(left, 0.0)


def test_a_contact_without_a_limb_stays() -> None:
    moves = np.array([[[1.0, 2, 3]]])
    np.testing.assert_array_equal(turn_limbs(np.zeros((1, 1, 2, 3)), moves, np.ones(2))[1], moves)


def test_turns_with_the_world() -> None:
    rng = np.random.default_rng(0)
    levers, moves, world = leg(0.4, 5), 0.05 * rng.normal(size=(5, 1, 3)), matrices(rng.normal(size=3))
    turns, left = turn_limbs(levers, moves, ANKLE)
    turned, other = turn_limbs(levers @ world.T, moves @ world.T, ANKLE)
    np.testing.assert_allclose(other, left @ world.T, atol=1e-12)
    np.testing.assert_allclose(turned, world @ turns @ world.T, atol=1e-11)


def test_two_limbs_share_a_part() -> None:
    """A trunk with two legs: one foot moves, the other keeps its place."""
    levers = np.zeros((1, 2, 5, 3))
    levers[0, :, 0] = [0.4, 0.0, 0.0]
    levers[0, 0, 1:3] = levers[0, 1, 3:5] = leg(0.5)[0, 0, :2]
    moves = np.array([[[0.05, 0.03, 0.02], [0, 0, 0]]])
    turns, left = turn_limbs(levers, moves, np.array([0.25, 1, 1, 1, 1]))
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
    np.testing.assert_allclose(ends(levers, turns) - levers.sum(axis=2), moves, atol=1e-12)
    bent = np.linalg.norm(vectors(turns[0]), axis=1)
    assert bent[0] < bent[1:3].max()  # the leg rather than the trunk


@pytest.mark.parametrize("bend", [0.0, 1e-6, 1e-3, 0.03, 0.1, 0.2, 0.3, 0.5])
@pytest.mark.parametrize(
    "move", [[0, 0.1, 0], [0, -0.1, 0], [0, 0.03, 0], [0, -0.03, 0], [0.2, 0, 0]], ids=str
)
def test_knees_do_not_pop(bend: float, move: list[float]) -> None:
    """However straight the leg is: the knee accelerates at most four times as much as the foot is asked to."""
    levers, moves = leg(bend, len(FADE)), FADE[:, None, None] * np.array(move)
    turns, left = turn_limbs(levers, moves, ANKLE)
    knees = np.einsum("nij,nj->ni", turns[:, 0], levers[:, 0, 0])
    asked = np.linalg.norm(np.diff(moves[:, 0], 2, axis=0), axis=1).max()
    assert np.linalg.norm(np.diff(knees, 2, axis=0), axis=1).max() < 4.0 * asked
    assert np.linalg.norm(np.diff(left[:, 0], 2, axis=0), axis=1).max() < 4.0 * asked


def test_legs_that_are_too_short_stretch_out() -> None:
    levers = leg(0.6)
    turns, left = turn_limbs(levers, np.array([[[0.0, -3.0, 0.0]]]), ANKLE)
    assert np.isfinite(turns).all()
    np.testing.assert_allclose(
        ends(levers, turns) - levers.sum(axis=2) + left, [[[0.0, -3.0, 0.0]]], atol=1e-12
    )
