"""The basis space: frames are combinations of a basis, and so are blends of frames."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from mixseq.spaces.vertex import BasisSpace
from mixseq.types import Float
from tests.meshes import tube

VECTORS = np.random.default_rng(1).normal(size=(4, 30)) * np.array([[1.0], [1e-3], [10], [1e4]])
SPACE = BasisSpace(VECTORS, 2.5)


def some_vectors(count: int, seed: int = 0) -> Float:
    """Vectors whose coordinates all move vertices about as far."""
    return np.asarray(np.random.default_rng(seed).normal(size=(count, SPACE.dim)) / SPACE.weights)


def test_frames_are_combinations_of_a_basis() -> None:
    vectors = some_vectors(3)
    expected = 2.5 * np.einsum("kv,tki->tvi", VECTORS, vectors.reshape(3, 4, 3))
    np.testing.assert_allclose(SPACE.decode(vectors), expected, atol=1e-12)


def test_frames_of_the_span_come_back() -> None:
    vectors = some_vectors(5)
    points = SPACE.decode(vectors)
    found = SPACE.encode(points)
    np.testing.assert_allclose(found * SPACE.weights, vectors * SPACE.weights, atol=1e-11)
    np.testing.assert_allclose(SPACE.decode(found), points, atol=1e-11)


def test_other_frames_become_the_nearest_of_the_span() -> None:
    points = np.random.default_rng(2).normal(size=(2, 30, 3))
    orthonormal = np.linalg.qr((VECTORS / np.linalg.norm(VECTORS, axis=1, keepdims=True)).T)[0]
    nearest = orthonormal @ (orthonormal.T @ points)
    np.testing.assert_allclose(SPACE.decode(SPACE.encode(points)), nearest, atol=1e-10)


def test_decoding_is_linear() -> None:
    one, other = SPACE.decode(some_vectors(2))
    blend = SPACE.decode(np.array([[0.3, 0.7]]) @ some_vectors(2))[0]
    np.testing.assert_allclose(blend, 0.3 * one + 0.7 * other, atol=1e-12)


def test_weights_are_how_far_vertices_move() -> None:
    """A change of a coordinate by one moves the vertices by its weight, root of the sum of squares, in diagonals."""
    for coordinate, unit in enumerate(np.eye(SPACE.dim)):
        moved = np.linalg.norm(SPACE.decode(unit[None])) / SPACE.scale
        assert SPACE.weights[coordinate] == pytest.approx(moved, rel=1e-12)


def test_velocities_are_those_of_the_basis() -> None:
    vectors, rates = some_vectors(2, 1), some_vectors(2, 2)
    points, velocities = SPACE.decode_with_velocities(vectors, rates)
    np.testing.assert_array_equal(points, SPACE.decode(vectors))
    difference = SPACE.decode(vectors + rates) - points
    np.testing.assert_allclose(velocities, difference, atol=1e-10)


def test_frames_are_the_same_bits_alone() -> None:
    vectors = some_vectors(6)
    np.testing.assert_array_equal(SPACE.decode(vectors)[4], SPACE.decode(vectors[4:5])[0])
    points = SPACE.decode(vectors)
    np.testing.assert_array_equal(SPACE.encode(points)[4], SPACE.encode(points[4:5])[0])


def test_skinning_is_of_this_space() -> None:
    """Weights, and weights times coordinates, are its basis: then vectors are the matrices of the bones."""
    rest, _ = tube(5, 6)
    first = np.clip(rest[:, 2] / 4, 0, 1)
    weights = np.stack([first, 1 - first])
    corners = np.concatenate([rest, np.ones((len(rest), 1))], axis=1)
    space = BasisSpace((weights[:, :, None] * corners).transpose(0, 2, 1).reshape(8, -1), 1.0)
    rng = np.random.default_rng(0)
    bones = rng.normal(size=(2, 4, 3))
    skinned = sum(weight[:, None] * (corners @ bone) for weight, bone in zip(weights, bones, strict=True))
    np.testing.assert_allclose(space.decode(bones.reshape(1, -1))[0], skinned, atol=1e-12)
    np.testing.assert_allclose(space.decode(space.encode(np.asarray(skinned)[None]))[0], skinned, atol=1e-9)


def test_vectors_that_depend_on_each_other_are_no_harm() -> None:
    space = BasisSpace(np.concatenate([VECTORS, VECTORS[:1] + VECTORS[2:3]]), 1.0)
    points = SPACE.decode(some_vectors(2))
    np.testing.assert_allclose(space.decode(space.encode(points)), points, atol=1e-7)


def test_it_is_a_space() -> None:
    assert SPACE.name == "basis"
    assert SPACE.dim == len(SPACE.weights) == 12
    assert SPACE.shape_dim == 12
    assert SPACE.placement_dim == SPACE.rotation_count == SPACE.centre_count == 0
    assert not SPACE.basis.flags.writeable
    copy = pickle.loads(pickle.dumps(SPACE))
    np.testing.assert_array_equal(copy.decode(some_vectors(1)), SPACE.decode(some_vectors(1)))


def test_vectors_of_parts_are_as_all_of_them() -> None:
    """Where vectors are zero on each other's vertices, only those of a vertex's part are added; some have none."""
    basis = np.zeros((6, 31))
    for part in range(3):
        basis[part::3, part:30:3] = np.random.default_rng(part).normal(size=(2, 10))
    space = BasisSpace(basis, 2.0)
    vectors = np.random.default_rng(4).normal(size=(3, 18))
    expected = 2.0 * np.einsum("kv,tki->tvi", basis, vectors.reshape(3, 6, 3))
    np.testing.assert_allclose(space.decode(vectors), expected, atol=1e-12)
    assert not space.decode(vectors)[:, 30].any()
    np.testing.assert_array_equal(space.decode(vectors)[1], space.decode(vectors[1:2])[0])
