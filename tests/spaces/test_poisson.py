"""Vertices from differences: exact where they fit, weighted least squares where they do not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.spaces.gradient import Integration
from tests.meshes import grid, joined, seeds, tetrahedron, topology_of

TRIANGLE = np.array([[0, 1], [1, 2], [2, 0]])


def test_a_gap_is_shared_by_weight() -> None:
    """Around a triangle differences miss by 6: each side takes part of it, inversely to its weight."""
    system = Integration(TRIANGLE, np.array([1.0, 2.0, 2.0]), 3)
    x = system.vertices(np.array([[2.0, 0, 0]] * 3))
    np.testing.assert_allclose(x, np.outer([0, -1, -0.5], [1, 0, 0]), atol=1e-14)


@settings(max_examples=10, deadline=None)
@given(seed=seeds)
def test_true_differences_give_the_mesh(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = joined(grid(4, 5), (np.zeros((1, 3)), np.zeros((0, 3), int)), tetrahedron())
    edges = topology_of(mesh).edges
    x = rng.normal(size=mesh[0].shape)
    system = Integration(edges, rng.uniform(0.5, 2.0, len(edges)), len(x))
    wanted = np.concatenate([x[:30] - x[0], [[0, 0, 0]], x[31:] - x[31]])
    np.testing.assert_allclose(system.vertices(x[edges[:, 1]] - x[edges[:, 0]]), wanted, atol=1e-11)


def test_sides_may_repeat_and_stand_still() -> None:
    sides = np.array([[0, 1], [1, 0], [1, 1]])
    x = Integration(sides, np.ones(3), 2).vertices(np.array([[1.0, 0, 0], [-3, 0, 0], [7, 7, 7]]))
    np.testing.assert_allclose(x, [[0, 0, 0], [2, 0, 0]])


def test_points_alone_are_the_origin() -> None:
    system = Integration(np.zeros((0, 2), dtype=np.int64), np.zeros(0), 3)
    np.testing.assert_array_equal(system.vertices(np.zeros((0, 3))), np.zeros((3, 3)))


def test_refusals() -> None:
    with pytest.raises(
        SettingsError, match=r"differences have shape \(2, 3\); one for each side is expected, \(3, 3\)"
    ):
        Integration(TRIANGLE, np.ones(3), 3).vertices(np.zeros((2, 3)))
    with pytest.raises(ReconstructionError, match="no unique solution"):
        Integration(TRIANGLE, np.zeros(3), 3).vertices(np.zeros((3, 3)))
