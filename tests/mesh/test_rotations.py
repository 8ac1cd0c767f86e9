"""Rotation vectors without jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mixseq.mesh.rotations import continuous_rotvec, matrix_to_rotvec, rotvec_to_matrix
from mixseq.types import Float
from tests.meshes import rotation, seeds

AXIS = np.array([1.0, -2.0, 2.0]) / 3


@settings(max_examples=50, deadline=None)
@given(vector=arrays.arrays(np.float64, 3, elements=st.floats(-10, 10)))
def test_the_exponential_is_rodrigues_formula(vector: Float) -> None:
    np.testing.assert_allclose(rotvec_to_matrix(vector), rotation(vector), atol=1e-9)
    back = matrix_to_rotvec(rotvec_to_matrix(vector))
    assert np.linalg.norm(back) <= np.pi + 1e-12
    np.testing.assert_allclose(rotvec_to_matrix(back), rotation(vector), atol=1e-9)
    if np.linalg.norm(vector) < 3.1:
        np.testing.assert_allclose(back, vector, atol=1e-6)


def test_shapes_are_kept() -> None:
    many = np.random.default_rng(0).normal(size=(4, 2, 3))
    assert rotvec_to_matrix(many).shape == (4, 2, 3, 3)
    np.testing.assert_allclose(matrix_to_rotvec(rotvec_to_matrix(many)), many, atol=1e-9)
    assert rotvec_to_matrix(np.zeros((0, 3))).shape == (0, 3, 3)


@pytest.mark.parametrize("step", [10.0, 90.0, 120.0, 179.0, -45.0])
def test_two_turns_are_four_pi(step: float) -> None:
    degrees = np.arange(0, 721, abs(step)) * np.sign(step)
    turns = np.stack([rotation(AXIS * np.radians(angle)) for angle in degrees])
    np.testing.assert_allclose(continuous_rotvec(turns), np.radians(degrees)[:, None] * AXIS, atol=1e-6)


def test_turning_there_and_back() -> None:
    degrees = np.concatenate([np.arange(0, 700, 35.0), np.arange(700, -400, -35.0)])
    turns = np.stack([rotation(AXIS * np.radians(angle)) for angle in degrees])
    np.testing.assert_allclose(continuous_rotvec(turns), np.radians(degrees)[:, None] * AXIS, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_random_walks_are_followed_without_jumps(seed: int) -> None:
    """Three bodies, each turned by at most 0.2 radians more about a random axis every frame."""
    rng = np.random.default_rng(seed)
    turns = [np.stack([rotation(rng.uniform(-3, 3, 3)) for _ in range(3)])]
    for _ in range(80):
        more = rng.uniform(-1, 1, (3, 3))
        more *= 0.2 * rng.random((3, 1)) / np.linalg.norm(more, axis=1, keepdims=True)
        turns.append(np.stack([rotation(v) @ turn for v, turn in zip(more, turns[-1], strict=True)]))
    path = continuous_rotvec(np.stack(turns))
    assert path.shape == (81, 3, 3)
    np.testing.assert_allclose(rotvec_to_matrix(path), np.stack(turns), atol=1e-9)
    # No other branch of the logarithm is closer to the frame before.
    for before, after in pairwise(path):
        angle = np.linalg.norm(after, axis=1, keepdims=True)
        axis = after / angle
        own = np.linalg.norm(after - before, axis=1)
        for turn in (-2, -1, 1, 2):
            other = np.linalg.norm(after + 2 * np.pi * turn * axis - before, axis=1)
            assert (own <= other + 1e-9).all()


def test_the_reference_says_where_the_first_frame_goes() -> None:
    turns = np.stack([rotation(AXIS * angle) for angle in (0.5, 0.9)])
    path = continuous_rotvec(turns, reference=AXIS * (4 * np.pi + 0.4))
    np.testing.assert_allclose(path, (4 * np.pi + np.array([[0.5], [0.9]])) * AXIS, atol=1e-9)
    np.testing.assert_allclose(continuous_rotvec(turns), np.array([[0.5], [0.9]]) * AXIS, atol=1e-9)


def test_the_identity_stays_on_its_turn() -> None:
    """After a full turn the axis of the identity is that of the frame before."""
    turns = np.stack([rotation(AXIS * angle) for angle in (5.0, 6.0)] + [np.eye(3)] * 2)
    path = continuous_rotvec(turns, reference=AXIS * 4.5)
    np.testing.assert_allclose(path[2:], np.array([[2 * np.pi], [2 * np.pi]]) * AXIS, atol=1e-9)
    np.testing.assert_array_equal(continuous_rotvec(np.stack([np.eye(3)] * 3)), np.zeros((3, 3)))


def test_half_turns_do_not_flip() -> None:
    """At 180 degrees both axes are right; the one of the frame before counts."""
    turns = np.stack([rotation(AXIS * np.radians(angle)) for angle in (175.0, 180.0, 185.0, 180.0)])
    expected = np.radians([[175.0], [180.0], [185.0], [180.0]]) * AXIS
    np.testing.assert_allclose(continuous_rotvec(turns), expected, atol=1e-6)


def test_block_by_block_is_the_same() -> None:
    rng = np.random.default_rng(1)
    turns = np.stack([rotation(AXIS * t + 0.1 * rng.normal(size=3)) for t in np.linspace(0, 15, 40)])
    whole = continuous_rotvec(turns)
    first = continuous_rotvec(turns[:17])
    second = continuous_rotvec(turns[17:], reference=first[-1])
    np.testing.assert_array_equal(np.concatenate([first, second]), whole)
