"""Rotations as unit quaternions: closed forms, products, and signs that do not jump."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mixseq.mesh.rotations import (
    align_quat_signs,
    matrix_to_quat,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotvec_to_quat,
)
from mixseq.types import Float
from tests.meshes import rotation, seeds

AXIS = np.array([1.0, -2.0, 2.0]) / 3

vectors = arrays.arrays(np.float64, 3, elements=st.floats(-10, 10))


def turn(angle: float) -> Float:
    """The quaternion of a turn about `AXIS`."""
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * AXIS])


def random(seed: int, *shape: int) -> Float:
    return normalise_quat(np.random.default_rng(seed).normal(size=(*shape, 4)))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi / 2, 3.1, -2.0])
def test_a_quaternion_is_cosine_and_sine_of_half_the_angle(angle: float) -> None:
    np.testing.assert_allclose(matrix_to_quat(rotation(AXIS * angle)), turn(angle), atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(turn(angle)), rotation(AXIS * angle), atol=1e-15)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_have_no_real_part(axis: Float) -> None:
    q = matrix_to_quat(rotation(axis * np.pi))
    np.testing.assert_allclose(np.abs(q), [0.0, *axis], atol=1e-12)
    np.testing.assert_allclose(quat_to_matrix(q), 2 * np.outer(axis, axis) - np.eye(3), atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(vector=vectors)
def test_rotations_come_back(vector: Float) -> None:
    q = matrix_to_quat(rotation(vector))
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(quat_to_matrix(q), rotation(vector), atol=1e-12)


def test_neither_length_nor_sign_matters() -> None:
    q = random(0, 5)
    np.testing.assert_allclose(quat_to_matrix(-3.0 * q), quat_to_matrix(q), atol=1e-14)
    np.testing.assert_array_equal(normalise_quat(np.zeros((2, 4))), 0.0)
    np.testing.assert_array_equal(quat_to_matrix(np.zeros(4)), np.eye(3))


def test_shapes_are_kept() -> None:
    q = random(0, 3, 2)
    assert quat_to_matrix(q).shape == (3, 2, 3, 3)
    assert matrix_to_quat(quat_to_matrix(q)).shape == q.shape
    assert matrix_to_quat(np.zeros((0, 2, 3, 3))).shape == (0, 2, 4)
    assert quat_to_matrix(np.zeros((0, 4))).shape == (0, 3, 3)
    assert quat_multiply(q, q[0]).shape == q.shape


def test_units_multiply_as_hamilton_has_them() -> None:
    one, i, j, k = np.eye(4)
    for first, second, third in ((i, j, k), (j, k, i), (k, i, j)):
        np.testing.assert_array_equal(quat_multiply(first, second), third)
        np.testing.assert_array_equal(quat_multiply(second, first), -third)
        np.testing.assert_array_equal(quat_multiply(first, first), -one)
        np.testing.assert_array_equal(quat_multiply(one, first), first)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_products_are_rotations_one_after_the_other(seed: int) -> None:
    p, q = random(seed, 2, 3)
    np.testing.assert_allclose(quat_to_matrix(quat_multiply(p, q)), quat_to_matrix(p) @ quat_to_matrix(q), atol=1e-14)
    np.testing.assert_allclose(quat_multiply(q, quat_conjugate(q)), [[1, 0, 0, 0]] * 3, atol=1e-15)
    np.testing.assert_allclose(quat_to_matrix(quat_conjugate(q)), np.swapaxes(quat_to_matrix(q), 1, 2), atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-14, 1e-9, 0.7, 3.0, -2.5, 6.0, 9.0, -20.0])
def test_exponentials_count_turns(angle: float) -> None:
    np.testing.assert_allclose(rotvec_to_quat(AXIS * angle), turn(angle), atol=1e-14)


@settings(max_examples=20, deadline=None)
@given(vector=vectors)
def test_exponentials_are_rotations_of_vectors(vector: Float) -> None:
    np.testing.assert_allclose(quat_to_matrix(rotvec_to_quat(vector)), rotation(vector), atol=1e-12)
    size = np.linalg.norm(vector)
    if size > 1e-3:
        np.testing.assert_allclose(rotvec_to_quat(vector * (1 + 2 * np.pi / size)), -rotvec_to_quat(vector), atol=1e-12)


@pytest.mark.parametrize("step", [10.0, 90.0, 179.0, -45.0])
def test_signs_do_not_jump_however_often_a_body_turns(step: float) -> None:
    angles = np.radians(np.arange(0, 1441, abs(step)) * np.sign(step))
    expected = np.stack([turn(angle) for angle in angles])
    nearest = matrix_to_quat(quat_to_matrix(expected))
    assert (nearest[:, 0] >= 0).all()
    np.testing.assert_allclose(align_quat_signs(nearest), expected, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_continued_changes_signs_only(seed: int) -> None:
    path = random(seed, 20, 3)
    smooth = align_quat_signs(path)
    np.testing.assert_array_equal(np.abs(smooth), np.abs(path))
    np.testing.assert_array_equal(smooth[0], path[0])
    assert (np.einsum("tpi,tpi->tp", smooth[1:], smooth[:-1]) >= 0).all()


def test_the_reference_says_which_sign_the_first_frame_has() -> None:
    path = np.stack([turn(angle) for angle in (0.5, 0.9)])
    np.testing.assert_array_equal(align_quat_signs(path, turn(0.4)), path)
    np.testing.assert_array_equal(align_quat_signs(path, turn(0.4 + 2 * np.pi)), -path)


def test_block_by_block_is_the_same() -> None:
    path = random(1, 40, 2)
    whole = align_quat_signs(path)
    first = align_quat_signs(path[:17])
    np.testing.assert_array_equal(np.concatenate([first, align_quat_signs(path[17:], first[-1])]), whole)
    assert align_quat_signs(path[:0]).shape == (0, 2, 4)
