"""Blended motions: rigid where a vertex follows one part, half a screw between two, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rotations import normalised, product, quaternions
from mixseq.spaces.mixed import posing_kernels as kernels
from mixseq.spaces.mixed.joints import values_and_rates, with_rates
from mixseq.types import Float, Index
from tests.meshes import rigid_motions, rotation, seeds

AXIS = np.array([2.0, -1.0, 2.0]) / 3
POINTS = np.random.default_rng(3).normal(size=(40, 3))


def dual(turn: Float, shift: Float) -> Float:
    """The motion that turns about the origin, then shifts, as a unit dual quaternion."""
    real = quaternions(turn)
    return np.concatenate([real, 0.5 * product(np.array([0.0, *shift]), real)])


def rows(weights: Float) -> tuple[Index, Index, Float]:
    """Weights ``(V, p)`` as rows of a sparse matrix; zeros are none."""
    vertices, parts = np.nonzero(weights)
    starts = np.concatenate([[0], np.cumsum(np.bincount(vertices, minlength=len(weights)))])
    return starts.astype(np.int64), parts.astype(np.int64), weights[vertices, parts]


def wild(seed: int, parts: int = 4) -> tuple[tuple[Index, Index, Float], Float]:
    """Weights of some of the parts, and motions by less than half a turn from each other."""
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.ones(parts), len(POINTS)) * (rng.random((len(POINTS), parts)) < 0.6)
    weights[np.arange(len(POINTS)), rng.integers(0, parts, len(POINTS))] += 0.2
    weights /= weights.sum(axis=1, keepdims=True)
    first, shifts = rng.normal(size=3), rng.normal(size=(parts, 3))
    turns = [rotation(first) @ rotation(0.5 * rng.normal(size=3)) for _ in range(parts)]
    duals = np.stack([dual(turn, shift) for turn, shift in zip(turns, shifts, strict=True)])
    signs = np.where(duals[:, :4] @ duals[0, :4] < 0, -1.0, 1.0)
    return rows(weights), duals * signs[:, None]


@settings(max_examples=30, deadline=None)
@given(motion=rigid_motions)
def test_who_follows_one_part_moves_as_it_does(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    weights = rows(np.tile([[1.0, 0.0]], (len(POINTS), 1)))
    duals = np.stack([dual(turn, shift), dual(rotation((1.0, 2, 3)), np.ones(3))])
    np.testing.assert_allclose(kernels.pose(*weights, duals, POINTS), POINTS @ turn.T + shift, atol=1e-13)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_parts_that_move_as_one_take_all_along(share: float) -> None:
    turn, shift = rotation((1.0, -2, 0.5)), np.array([3.0, -1, 2])
    weights = rows(np.tile([[share, 1.0 - share]], (len(POINTS), 1)))
    moved = kernels.pose(*weights, np.stack([dual(turn, shift)] * 2), POINTS)
    np.testing.assert_allclose(moved, POINTS @ turn.T + shift, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 0.5, np.pi / 2, -2.0, 3.1])
@pytest.mark.parametrize("way", [0.0, 0.6])
def test_half_of_a_screw_is_half_the_turn_and_half_the_way(angle: float, way: float) -> None:
    """About an axis that is not through the origin."""
    pivot, half = np.array([0.5, 0, 2.0]), rotation(AXIS * angle / 2)
    full = half @ half
    duals = np.stack([dual(np.eye(3), np.zeros(3)), dual(full, pivot - full @ pivot + way * AXIS)])
    weights = rows(np.full((len(POINTS), 2), 0.5))
    expected = (POINTS - pivot) @ half.T + pivot + way / 2 * AXIS
    np.testing.assert_allclose(kernels.pose(*weights, duals, POINTS), expected, atol=1e-13)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_posing_and_unposing_are_inverse(seed: int) -> None:
    weights, duals = wild(seed)
    posed = kernels.pose(*weights, duals, POINTS)
    np.testing.assert_allclose(kernels.unpose(*weights, duals, posed), POINTS, atol=1e-12)
    np.testing.assert_allclose(
        kernels.pose(*weights, duals, kernels.unpose(*weights, duals, POINTS)), POINTS, atol=1e-12
    )


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_distances_to_neighbours_that_follow_the_same_are_kept(seed: int) -> None:
    """Every motion is rigid, however far apart those that are blended are."""
    (starts, parts, shares), duals = wild(seed)
    first = slice(starts[0], starts[1])
    count = starts[1]
    alike = (
        np.arange(len(POINTS) + 1) * count,
        np.tile(parts[first], len(POINTS)),
        np.tile(shares[first], len(POINTS)),
    )
    moved = kernels.pose(*alike, duals, POINTS)
    here, there = (np.linalg.norm(x[:, None] - x, axis=2) for x in (POINTS, moved))
    np.testing.assert_allclose(there, here, atol=1e-12)


def test_motions_that_add_up_to_nothing_move_nothing() -> None:
    weights, duals = rows(np.full((len(POINTS), 2), 0.5)), dual(rotation((1.0, 2, 3)), np.ones(3))
    np.testing.assert_array_equal(kernels.pose(*weights, np.stack([duals, -duals]), POINTS), POINTS)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, back=st.booleans())
def test_complex_steps_are_difference_quotients(seed: int, back: bool) -> None:
    rng = np.random.default_rng(seed)
    weights, duals = wild(seed)
    rates, speeds = rng.normal(size=duals.shape), rng.normal(size=POINTS.shape)
    rates[:, :4] -= duals[:, :4] * np.einsum("pi,pi->p", rates[:, :4], duals[:, :4])[:, None]
    kernel, step = kernels.unpose if back else kernels.pose, 1e-5

    def at(time: float) -> Float:
        real = duals[:, :4] + time * rates[:, :4]
        moved = np.concatenate([normalised(real), duals[:, 4:] + time * rates[:, 4:]], axis=1)
        return np.asarray(kernel(*weights, moved, POINTS + time * speeds))

    values, found = values_and_rates(kernel(*weights, with_rates(duals, rates), with_rates(POINTS, speeds)))
    np.testing.assert_allclose(values, at(0.0), atol=1e-13)
    quotient = (at(step) - at(-step)) / (2 * step)
    assert np.abs(found - quotient).max() < 1e-6 * np.abs(quotient).max()
