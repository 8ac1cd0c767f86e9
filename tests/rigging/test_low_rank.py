"""Basis vectors of parts, in closed form, and within what is promised."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.rigging.low_rank import LowRank, fit_low_rank
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from tests.meshes import SEQUENCES, bar, coarse_walk, rotation

pytestmark = pytest.mark.slow


def error(fitted: LowRank, sequence: MeshSequence) -> float:
    """Return the largest distance, in diagonals."""
    points = np.einsum("vk,tvki->tvi", fitted.basis, fitted.coefficients[:, fitted.parts])
    apart = np.linalg.norm(points - sequence.points, axis=2).max()
    return float(apart / (bounding_diagonal(sequence.points[0]) or 1.0))


def test_a_rigid_body_takes_four() -> None:
    still = bar(frames=1)
    angles = np.linspace(0, 3, 20)
    turned = [still.points[0] @ rotation((angle, 0.3 * angle, 0)).T + [angle, 0, 1] for angle in angles]
    moved = MeshSequence.from_arrays(np.stack(turned), still.faces)
    fitted = fit_low_rank(moved, 1e-6)
    assert fitted.rank == 4
    assert error(fitted, moved) <= 1e-6


def test_two_rigid_bodies_take_four_each() -> None:
    still = bar(frames=1)
    count = still.vertex_count
    angles = np.linspace(0, 2, 15)
    one = np.stack([still.points[0] @ rotation((0, 0, angle)).T for angle in angles])
    other = np.stack([still.points[0] @ rotation((0, -angle, 0)).T + [9, 0, angle] for angle in angles])
    faces = np.concatenate([still.faces, still.faces + count])
    both = MeshSequence.from_arrays(np.concatenate([one, other], axis=1), faces)
    fitted = fit_low_rank(both, 1e-6)
    assert fitted.rank == 4
    assert len(set(fitted.parts[:count])) == len(set(fitted.parts[count:])) == 1


def test_bounds_hold_and_larger_ones_take_fewer_vectors() -> None:
    fox = coarse_walk(frames=6)
    ranks = []
    for max_error in (1e-2, 1e-4):
        fitted = fit_low_rank(fox, max_error)
        assert error(fitted, fox) <= max_error * (1 + 1e-6)
        assert np.abs(fitted.basis).max() <= 1 + 1e-12
        ranks.append(fitted.rank)
    assert ranks[0] < ranks[1]


@pytest.mark.parametrize("name", SEQUENCES)
def test_odd_meshes(name: str) -> None:
    sequence = SEQUENCES[name]()
    assert error(fit_low_rank(sequence, 1e-3), sequence) <= 1e-3 * (1 + 1e-6)


def test_units_do_not_matter() -> None:
    fox = coarse_walk(frames=3)
    large = fox.with_points(fox.points * 1024)
    np.testing.assert_array_equal(fit_low_rank(fox, 1e-3).parts, fit_low_rank(large, 1e-3).parts)
