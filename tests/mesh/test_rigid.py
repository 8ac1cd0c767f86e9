"""Rigid registration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rigid import kabsch, largest_rotation, mean_shape, nearest_rotations, transform_points
from mixseq.mesh.rotations import rotate_vectors
from mixseq.types import Float
from tests.meshes import rigid_motions, rotation, seeds

CLOUD = np.random.default_rng(3).normal(size=(12, 3))


@settings(max_examples=50, deadline=None)
@given(motion=rigid_motions)
def test_rigid_motions_are_found(motion: tuple[Float, Float]) -> None:
    turn, shift = motion
    found, moved = kabsch(CLOUD, CLOUD @ turn.T + shift)
    np.testing.assert_allclose(found, turn, atol=1e-9)
    np.testing.assert_allclose(moved, shift, atol=1e-8)
    np.testing.assert_allclose(transform_points(CLOUD, found, moved), CLOUD @ turn.T + shift, atol=1e-8)


FLAT = CLOUD * [1, 1, 0]
ODD_SETS: dict[str, Float] = {
    "in a plane": FLAT,
    "on a line": np.arange(5.0)[:, None] * [1.0, -2, 0.5],
    "two points": CLOUD[:2],
    "one point": CLOUD[:1],
    "one place": np.ones((4, 3)),
    "three points": CLOUD[:3],
    "tiny": 1e-9 * CLOUD,
    "huge": 1e9 * CLOUD,
}


@settings(max_examples=60, deadline=None)
@given(motion=rigid_motions, name=st.sampled_from(list(ODD_SETS)))
def test_sets_that_leave_a_rotation_free_get_a_proper_one(motion: tuple[Float, Float], name: str) -> None:
    points = ODD_SETS[name]
    target = points @ motion[0].T + motion[1]
    turn, shift = kabsch(points, target)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(turn) == pytest.approx(1)
    size = max(1e-6, float(np.abs(points).max()))
    np.testing.assert_allclose(points @ turn.T + shift, target, atol=1e-5 * size + 1e-12)


@pytest.mark.parametrize("name", ["in a plane", "on a line", "two points", "one point", "one place"])
def test_what_does_not_move_is_not_turned(name: str) -> None:
    points = ODD_SETS[name]
    turn, shift = kabsch(points, points + np.array([1.0, 2, 3]))
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(shift, [1, 2, 3], atol=1e-9)


def test_reflections_are_refused() -> None:
    turn, _ = kabsch(CLOUD, CLOUD * [1, 1, -1])
    assert np.linalg.det(turn) == pytest.approx(1)


def residual(source: Float, target: Float, turn: Float, shift: Float, weights: Float) -> float:
    return float(weights @ np.sum((source @ turn.T + shift - target) ** 2, axis=1))


@settings(max_examples=20, deadline=None)
@given(seed=seeds, mirror=st.booleans())
def test_no_other_motion_is_closer(seed: int, mirror: bool) -> None:
    rng = np.random.default_rng(seed)
    target = rng.normal(size=CLOUD.shape) + (CLOUD * [1, 1, -1] if mirror else CLOUD)
    weights = rng.uniform(0.1, 3, len(CLOUD))
    turn, shift = kabsch(CLOUD, target, weights)
    best = residual(CLOUD, target, turn, shift, weights)
    for _ in range(30):
        other = rotation(rng.normal(size=3) * rng.choice([0.01, 1.0])) @ turn
        moved = shift + rng.normal(size=3) * 0.01
        assert residual(CLOUD, target, other, moved, weights) >= best - 1e-9


def test_weights_of_zero_leave_points_out() -> None:
    turn, shift = rotation((0.3, 0.2, 0.1)), np.array([1.0, 2, 3])
    target = CLOUD @ turn.T + shift
    target[5:] += 10.0
    found, moved = kabsch(CLOUD, target, (np.arange(12) < 5).astype(float))
    np.testing.assert_allclose(found, turn, atol=1e-9)
    np.testing.assert_allclose(moved, shift, atol=1e-9)


def test_many_targets_at_once() -> None:
    turns = [rotation((t, -t, 0.5)) for t in (0.1, 1.0, 3.0)]
    targets = np.stack([CLOUD @ turn.T + turn[0] for turn in turns])
    found, moved = kabsch(CLOUD, targets)
    np.testing.assert_allclose(found, np.stack(turns), atol=1e-9)
    np.testing.assert_allclose(transform_points(np.stack([CLOUD] * 3), found, moved), targets, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_nearest_rotations_are_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(3, 3))
    (near,) = nearest_rotations(matrix[None])
    np.testing.assert_allclose(near @ near.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(near) == pytest.approx(1)
    for _ in range(30):
        other = rotation(rng.normal(size=3)) @ near
        assert np.linalg.norm(matrix - other) >= np.linalg.norm(matrix - near) - 1e-12


def by_lapack(matrices: Float) -> Float:
    u, _, vt = np.linalg.svd(matrices)
    u[..., :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[..., None]
    return np.asarray(u @ vt)


@pytest.mark.parametrize(
    "values", [[1, 0.5, 0.2], [1, 0.5, -0.2], [1, 1, 1], [1, 1, 0], [1, 1, -0.5], [1, 1e-3, 1e-4], [1, 1e-3, -1e-4]]
)
@pytest.mark.parametrize("scale", [1e-150, 1.0, 1e150])
def test_nearest_rotations_are_those_of_lapack(values: list[float], scale: float) -> None:
    """Also of matrices that mirror or flatten, and to the last digits where the rotation is well defined."""
    rng = np.random.default_rng(5)
    left, right = (np.stack([rotation(rng.uniform(-2, 2, 3)) for _ in range(50)]) for _ in range(2))
    matrices = scale * (left * values) @ right
    found = nearest_rotations(matrices)
    defined = values[1] + values[2]  # how much turning about the first axis costs
    np.testing.assert_allclose(found, by_lapack(matrices), atol=2e-14 / defined)
    np.testing.assert_allclose(found, left @ right, atol=2e-14 / defined)
    np.testing.assert_allclose(found @ np.swapaxes(found, 1, 2), np.tile(np.eye(3), (50, 1, 1)), atol=1e-14)
    assert nearest_rotations(matrices.reshape(5, 10, 3, 3)).shape == (5, 10, 3, 3)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nearest_rotations_of_what_is_not_finite_are_refused(bad: float) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="not finite"):
        nearest_rotations(np.diag([1.0, bad, 1.0]))


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1.0, 0, 0]), -np.eye(3)])
def test_nearest_rotations_of_matrices_that_are_none(matrix: Float) -> None:
    near = nearest_rotations(matrix)
    np.testing.assert_allclose(near @ near.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(near) == pytest.approx(1)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_the_mean_of_rigid_motions_is_the_shape(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = np.stack([CLOUD @ rotation(rng.uniform(-3, 3, 3)).T + rng.normal(size=3) for _ in range(6)])
    np.testing.assert_allclose(mean_shape(frames), frames[0] - frames[0].mean(axis=0), atol=1e-9)


def test_the_mean_minimises_the_distances_of_aligned_frames() -> None:
    rng = np.random.default_rng(8)
    frames = np.stack([CLOUD @ rotation(rng.normal(size=3)).T for _ in range(5)])
    frames += 0.2 * rng.normal(size=frames.shape)
    mean = mean_shape(frames)

    def spread(shape: Float) -> float:
        turns, shifts = kabsch(frames, shape)
        return float(np.sum((transform_points(frames, turns, shifts) - shape) ** 2))

    np.testing.assert_allclose(mean.mean(axis=0), 0, atol=1e-12)
    for _ in range(20):
        assert spread(mean + 0.02 * rng.normal(size=mean.shape)) > spread(mean)
    turns, shifts = kabsch(frames, mean)  # at the minimum the mean is the mean of what is aligned to it
    np.testing.assert_allclose(transform_points(frames, turns, shifts).mean(axis=0), mean, atol=1e-8)
    turn, _ = kabsch(mean, frames[0])
    np.testing.assert_allclose(turn, np.eye(3), atol=1e-9)  # oriented like the first frame


def test_the_mean_of_one_frame_is_the_frame() -> None:
    np.testing.assert_allclose(mean_shape(CLOUD[None].astype(np.float32)), CLOUD - CLOUD.mean(axis=0), atol=1e-6)


def test_bend_is_the_largest_relative_turn() -> None:
    """The second body turns with the first one, and by 0, 10, -25 degrees about z on top."""
    base = [rotation((t, 2 * t, -t)) for t in (0.0, 1.0, 2.0)]
    extra = [rotation((0, 0, np.radians(a))) for a in (0.0, 10.0, -25.0)]
    second = np.stack([b @ e for b, e in zip(base, extra, strict=True)])
    assert largest_rotation(np.stack(base), second) == pytest.approx(35.0)
    assert largest_rotation(second, np.stack(base)) == pytest.approx(35.0)
    assert largest_rotation(second, second) == pytest.approx(0, abs=1e-5)


def test_vectors_are_turned_each_by_its_matrix() -> None:
    matrices = np.random.default_rng(0).normal(size=(4, 3, 3))
    vectors = np.random.default_rng(1).normal(size=(4, 3))
    expected = [m @ v for m, v in zip(matrices, vectors, strict=True)]
    np.testing.assert_allclose(rotate_vectors(matrices, vectors), expected)
    np.testing.assert_allclose(rotate_vectors(matrices[None], vectors), [expected])
