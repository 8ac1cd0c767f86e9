"""Sides of faces: what agrees stays, what does not meets in the middle."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from mixseq.spaces.mixed.settling import COTANGENTS, POSED_WEIGHT, Sides

from mixseq.arrays import Float
from mixseq.geometry.rotations import normalised, quaternions
from mixseq.spaces.mixed import vertex_frame_kernels as kernels
from tests.meshes import Mesh, grid, rotation, seeds, tube


def sides_of(mesh: Mesh, free: list[int]) -> Sides:
    marked = np.zeros(len(mesh[0]), dtype=bool)
    marked[free] = True
    return Sides.of(mesh[1], marked, mesh[0])


MESH = tube(6, 9)
RINGS = [*range(3 * 6, 6 * 6)]
TUBE = sides_of(MESH, RINGS)
"""Three rings in the middle are free."""

STILL = np.tile([1.0, 0, 0, 0, 0, 0, 0], (len(MESH[0]), 1))


def wild(seed: int) -> tuple[Float, Float]:
    """Motions that differ from vertex to vertex, and points."""
    rng = np.random.default_rng(seed)
    turns = normalised([1.0, 0, 0, 0] + 0.3 * rng.normal(size=(len(MESH[0]), 4)))
    return np.concatenate([turns, rng.normal(size=(len(MESH[0]), 3))], axis=1), MESH[0] + rng.normal(
        scale=0.1, size=MESH[0].shape
    )


def test_faces_at_free_vertices_are_known() -> None:
    assert len(TUBE.faces) == 2 * 6 * 4
    np.testing.assert_array_equal(TUBE.vertices, RINGS)
    assert set(range(2 * 6, 7 * 6)) == set(TUBE.faces.reshape(-1).tolist())


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_what_agrees_stays(seed: int) -> None:
    motions, x = wild(seed)
    np.testing.assert_allclose(TUBE.settle(motions, TUBE.local(motions, x), x), x, atol=1e-13)


@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_only_free_vertices_move(seed: int) -> None:
    motions, x = wild(seed)
    sides = TUBE.local(motions, x) + np.random.default_rng(seed).normal(
        scale=0.1, size=(len(TUBE.faces), 2, 3)
    )
    settled = TUBE.settle(motions, sides, x)
    away = np.abs(settled - x).max(axis=1)
    held = np.setdiff1d(np.arange(len(x)), RINGS)
    assert (away[held] == 0).all()
    assert (away[RINGS] > 1e-4).all()


def test_one_free_vertex_goes_most_of_the_way() -> None:
    """It was pulled away; sides that are those of the flat sheet take it back, against `POSED_WEIGHT`."""
    mesh = grid(2, 2)
    sides = sides_of(mesh, [4])
    still = np.tile([1.0, 0, 0, 0, 0, 0, 0], (9, 1))
    flat, pull = sides.local(still, mesh[0]), np.array([0.1, -0.2, 0.3])
    pulled = mesh[0].copy()
    pulled[4] += pull
    weight = sides.weights[(sides.faces == 4) | (np.roll(sides.faces, -1, axis=1) == 4)].sum()
    # Legs of right triangles have cotangents of one; hypotenuses have none, but `COTANGENTS` says at least .05.
    assert weight == pytest.approx(4 * 1.0 + 2 * 0.05)
    expected = mesh[0].copy()
    expected[4] += pull * POSED_WEIGHT / (POSED_WEIGHT + weight)
    np.testing.assert_allclose(sides.settle(still, flat, pulled), expected, atol=1e-14)


def test_sides_are_seen_from_the_mean_of_the_corners_frames() -> None:
    """Corners that turn by a, b and c about one axis: the face turns by nearly their mean, for small angles."""
    mesh = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
    sides = sides_of(mesh, [0, 1, 2])
    axis = np.array([1.0, 2, -2]) / 3
    turns = quaternions(np.stack([rotation(axis * angle) for angle in (0.0, 0.2, 0.4)]))
    motions = np.concatenate([turns, np.zeros((3, 3))], axis=1)
    mean = rotation(axis * 0.2)
    np.testing.assert_allclose(sides.frames(motions), quaternions(mean)[None], atol=1e-14)
    np.testing.assert_allclose(sides.local(motions, mesh[0] @ mean.T), [mesh[0][1:]], atol=1e-14)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_it_is_the_minimum(seed: int) -> None:
    """No free vertex that is moved a little makes the energy smaller."""
    motions, x = wild(seed)
    rng = np.random.default_rng(seed)
    sides = TUBE.local(STILL, MESH[0]) + rng.normal(scale=0.05, size=(len(TUBE.faces), 2, 3))
    turned = kernels.turn_sides(TUBE.frames(motions), sides, False)
    wanted = np.stack([turned[:, 0], turned[:, 1] - turned[:, 0], -turned[:, 1]], axis=1)

    def energy(y: Float) -> float:
        corners = y[TUBE.faces]
        misfits = np.roll(corners, -1, axis=1) - corners - wanted
        return float((TUBE.weights[:, :, None] * misfits**2).sum() + POSED_WEIGHT * ((y - x) ** 2).sum())

    settled = TUBE.settle(motions, sides, x)
    least = energy(settled)
    for _ in range(5):
        other = settled.copy()
        other[RINGS] += 1e-3 * rng.normal(size=(len(RINGS), 3))
        back = settled.copy()
        back[RINGS] -= other[RINGS] - settled[RINGS]
        assert energy(other) > least
        assert energy(other) - least == pytest.approx(energy(back) - least, rel=1e-6)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_velocities_are_difference_quotients(seed: int) -> None:
    """Of sides and posed points that change; motions stay."""
    motions, x = wild(seed)
    rng = np.random.default_rng(seed)
    sides, rates = rng.normal(size=(2, len(TUBE.faces), 2, 3))
    speeds = rng.normal(size=x.shape)
    points, velocities = TUBE.settle_moving(motions, np.zeros((len(x), 6)), sides, rates, x, speeds)
    np.testing.assert_array_equal(points, TUBE.settle(motions, sides, x))
    ahead = TUBE.settle(motions, sides + rates, x + speeds)  # it is linear in them
    np.testing.assert_allclose(velocities, ahead - points, atol=1e-12)


def test_where_all_spins_about_a_point_velocities_are_of_that_turn() -> None:
    motions, x = wild(3)
    sides = TUBE.local(motions, x)
    spin = np.array([0.3, -1.0, 0.7])
    changes = np.concatenate([np.tile(spin, (len(x), 1)), np.cross(spin, motions[:, 4:])], axis=1)
    speeds = np.cross(spin, x)
    _, velocities = TUBE.settle_moving(motions, changes, sides, np.zeros_like(sides), x, speeds)
    np.testing.assert_allclose(velocities, speeds, atol=1e-12)


def test_without_free_vertices_nothing_is_solved() -> None:
    sides = sides_of(MESH, [])
    motions, x = wild(4)
    assert sides.local(motions, x).shape == (0, 2, 3)
    np.testing.assert_array_equal(sides.settle(motions, np.zeros((0, 2, 3)), x), x)


def test_weights_are_positive_whatever_the_triangles_are() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0], [0.5, 1e-9, 0]])
    mesh = points, np.array([[0, 1, 2], [0, 3, 1], [0, 1, 4], [3, 3, 0]])
    weights = sides_of(mesh, [0, 1, 2, 3, 4]).weights
    assert (weights >= COTANGENTS[0] / 2).all()
    assert (weights <= COTANGENTS[1] / 2).all()
    equilateral = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]]), np.array([[0, 1, 2]])
    np.testing.assert_allclose(sides_of(equilateral, [0]).weights, 0.5 / np.sqrt(3))


def test_sides_can_be_sent() -> None:
    motions, x = wild(5)
    seen = TUBE.local(motions, x) * 1.1
    settled = TUBE.settle(motions, seen, x)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(TUBE)).settle(motions, seen, x), settled)
