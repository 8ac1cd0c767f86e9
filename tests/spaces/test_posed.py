"""Spaces whose vectors end with poses, seen in the smallest one: corners of a tetrahedron about their centre."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.errors import SettingsError
from mixseq.spaces.posed import PosedSpace
from mixseq.topology import Topology
from tests.meshes import Float, rigid_motions, rotation, tetrahedron


@dataclass(frozen=True, eq=False)
class Sizes(PosedSpace):
    """Regular tetrahedra: the shape is the distance of the corners from the centre."""

    name = "sizes"
    shape_dim = 1
    shape_metric = np.ones(1)

    def shape_of(self, x: Float) -> Float:
        return np.array([np.linalg.norm(x - x.mean(axis=0), axis=1).mean()])

    def rebuilt(self, shape: Float) -> Float:
        # Anywhere: neither upright nor at the origin.
        rows = shape * (tetrahedron()[0] / np.sqrt(3)) @ rotation((1.0, 2.0, 3.0)).T + 5.0
        return np.asarray(rows)


POINTS, FACES = tetrahedron()
SPACE = Sizes(Topology(FACES, 4), 2.0, POINTS / 2.0)


def test_a_vector_is_shape_rotation_and_centre() -> None:
    turn = rotation((0.1, -0.2, 0.3))
    vector = SPACE.encode((1.5 * POINTS @ turn.T + [2.0, 4, 6])[None])
    np.testing.assert_allclose(vector, [[1.5 * np.sqrt(3) / 2, 0.1, -0.2, 0.3, 1, 2, 3]], atol=1e-12)
    assert SPACE.dim == 7
    assert SPACE.placement_dim == SPACE.stored_placement_dim == 6
    np.testing.assert_allclose(SPACE.weights, [1, *[np.sqrt(3) / 2] * 3, 1, 1, 1])


@settings(max_examples=30, deadline=None)
@given(motion=rigid_motions)
def test_rigid_motions_change_poses_only_and_come_back(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    points = (POINTS @ turn.T + shift)[None]
    vector = SPACE.encode(points)
    assert vector[0, 0] == pytest.approx(np.sqrt(3) / 2, abs=1e-12)
    np.testing.assert_allclose(SPACE.decode(vector), points, atol=1e-10)


def test_half_way_is_half_a_turn() -> None:
    axis, angle = np.array([1.0, 2, -2]) / 3, 3.0
    vectors = SPACE.encode(np.stack([POINTS, 3 * POINTS @ rotation(axis * angle).T + [1.0, 0, 0]]))
    half = SPACE.decode(vectors.mean(axis=0, keepdims=True))[0]
    np.testing.assert_allclose(half, 2 * POINTS @ rotation(axis * angle / 2).T + [0.5, 0, 0], atol=1e-12)


def test_a_body_that_turns_twice_goes_on_block_by_block() -> None:
    angles = np.linspace(0, 4 * np.pi, 13)
    points = np.stack([POINTS @ rotation((0.0, 0, angle)).T for angle in angles])
    vectors = SPACE.encode(points)
    np.testing.assert_allclose(vectors[:, 3], angles, atol=1e-12)
    np.testing.assert_allclose(SPACE.encode(points[6:], vectors[5]), vectors[6:], atol=1e-13)
    np.testing.assert_array_equal(SPACE.without_jumps(SPACE.encode_apart(points)), vectors)


def test_vectors_of_other_spaces_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"vectors have shape \(2, 6\); \(T, 7\) is expected"):
        SPACE.decode(np.zeros((2, 6)))
    with pytest.raises(SettingsError, match=r"\(7,\)"):
        SPACE.decode(np.zeros(7))
