"""Modes, and the affine maps that blend them."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.errors import SettingsError
from mixseq.signals.pose import PoseMap, _from_coordinates, _from_frames, fit_plane, principal_modes
from mixseq.types import Float


def vectors(count: int = 6, rank: int = 3, dim: int = 40, seed: int = 0) -> Float:
    random = np.random.default_rng(seed)
    left = random.standard_normal((count, rank)) * 10.0 ** -np.arange(rank)
    return np.asarray(left @ random.standard_normal((rank, dim)) + random.standard_normal(dim))


METRIC = np.linspace(0.1, 2, 40)


@given(count=st.integers(1, 7), rank=st.integers(0, 4), seed=st.integers(0, 50))
def test_weights_add_up_to_one(count: int, rank: int, seed: int) -> None:
    modes = principal_modes(vectors(count, rank, seed=seed), METRIC)
    points = modes.sizes * np.random.default_rng(seed).standard_normal((5, len(modes.sizes)))
    np.testing.assert_allclose(modes.pose_map().weights(points).sum(axis=1), 1, atol=1e-12)


def test_coordinates_can_be_the_weights() -> None:
    weights = np.array([[0.2, 0.5, 0.3], [1.0, 0, 0], [-1, 1, 1]])
    np.testing.assert_allclose(PoseMap.from_key_count(3).weights(weights[:, 1:]), weights, atol=1e-15)


@pytest.mark.parametrize(
    ("offset", "matrix", "message"),
    [
        ([0.5, 0.4], [[1.0, -1]], "do not add up to one"),
        ([0.5, 0.5], [[1.0, -0.9]], "do not add up to one"),
        ([0.5, 0.5], [[1.0, -1, 0]], "a matrix of shape"),
        ([], np.zeros((0, 0)), "a matrix of shape"),
    ],
)
def test_unsound_maps_are_refused(offset: list[float], matrix: Float, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        PoseMap(np.array(offset), np.array(matrix))


def test_the_layout_is_the_plane_of_the_first_two_components() -> None:
    given_ = vectors(count=7, rank=4)
    modes = principal_modes(given_, METRIC)
    origin, axes, directions = fit_plane(np.eye(7)[:, 1:], PoseMap.from_key_count(7), given_, METRIC)
    drawn = (np.eye(7) - origin) @ axes
    np.testing.assert_allclose(np.abs(drawn), np.abs(modes.scores[:, :2]), atol=1e-9)
    steps = directions.T @ (given_[1:] - given_[0]) * METRIC
    np.testing.assert_allclose(steps @ steps.T, np.eye(2), atol=1e-9)  # as long as in the plane
    np.testing.assert_allclose(directions.T @ PoseMap.from_key_count(7).matrix @ axes, np.eye(2), atol=1e-9)
    flat = fit_plane(np.eye(3)[:, 1:], PoseMap.from_key_count(3), np.ones((3, 40)), METRIC)
    assert not flat.axes.any()
    assert not flat.directions.any()


def test_the_plane_of_many_frames_is_found_among_few_key_shapes() -> None:
    random = np.random.default_rng(0)
    points, pose = random.standard_normal((50, 3)) * [3.0, 2.0, 1.0], PoseMap.from_key_count(4)
    shapes = random.standard_normal((4, 60))
    few = fit_plane(points, pose, shapes, np.ones(60))
    frames = np.concatenate([points] * 2)  # more than a shape has coordinates, and the same plane
    many = fit_plane(frames, pose, shapes, np.ones(60))
    np.testing.assert_allclose(many.origin, few.origin, atol=1e-12)
    np.testing.assert_allclose(many.axes, few.axes, atol=1e-9)
    np.testing.assert_allclose(many.directions, few.directions, atol=1e-9)
    still = fit_plane(np.zeros((100, 3)), pose, shapes, np.ones(60))
    assert not still.axes.any()
    assert not still.directions.any()


@pytest.mark.parametrize("rank", [0, 1, 3])
def test_modes_reproduce_what_has_their_rank(rank: int) -> None:
    given_ = vectors(rank=rank)
    modes = principal_modes(given_, METRIC)
    rebuilt = modes.pose_map().weights(modes.scores) @ modes.key_shapes()
    np.testing.assert_allclose(rebuilt, given_, atol=1e-13)
    if rank:
        singular = np.linalg.svd((given_ - given_.mean(axis=0)) * METRIC, compute_uv=False)
        np.testing.assert_allclose(modes.sizes[:rank], singular[:rank], rtol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(modes.scores, axis=0), modes.sizes)


def test_distances_in_pose_space_are_distances_of_shapes() -> None:
    given_ = vectors()
    scores = principal_modes(given_, METRIC).scores
    for i in range(6):
        apart = np.linalg.norm((given_ - given_[i]) * METRIC, axis=1)
        np.testing.assert_allclose(np.linalg.norm(scores - scores[i], axis=1), apart, atol=1e-12)


def test_the_first_modes_are_the_best() -> None:
    given_ = vectors(count=9, rank=6)
    modes = principal_modes(given_, METRIC).first(2)
    error = (modes.pose_map().weights(modes.scores) @ modes.key_shapes() - given_) * METRIC
    singular = np.linalg.svd((given_ - given_.mean(axis=0)) * METRIC, compute_uv=False)
    np.testing.assert_allclose(np.linalg.norm(error), np.linalg.norm(singular[2:]), rtol=1e-9)


@pytest.mark.parametrize(("count", "rank"), [(41, 0), (90, 3), (300, 40)])
def test_many_frames_have_no_more_modes_than_coordinates(count: int, rank: int) -> None:
    given_ = vectors(count, min(rank, 12))
    given_ += 1e-3 * np.random.default_rng(1).standard_normal(given_.shape) * (rank > 12)
    modes = principal_modes(given_, METRIC)
    assert len(modes.sizes) <= 40
    assert (np.diff(modes.sizes) <= 0).all()
    rebuilt = modes.pose_map().weights(modes.scores) @ modes.key_shapes()
    np.testing.assert_allclose(rebuilt, given_, atol=1e-13)


def test_modes_of_many_frames_are_those_of_their_products() -> None:
    given_ = vectors(60, rank=6)
    few, many = _from_frames(given_, METRIC), _from_coordinates(given_, METRIC)
    np.testing.assert_allclose(many.sizes[:6], few.sizes[:6], rtol=1e-9)
    np.testing.assert_allclose(many.scores[:, :4], few.scores[:, :4], atol=1e-8 * few.sizes[0])
    shapes = [modes.first(4).key_shapes() for modes in (few, many)]
    np.testing.assert_allclose(shapes[1], shapes[0], atol=1e-9)


@pytest.mark.parametrize("metric", [np.where(np.arange(40) < 3, 0.0, METRIC), np.zeros(40)])
def test_what_has_no_weight_is_kept_among_many_frames(metric: Float) -> None:
    given_ = vectors(90, rank=6)
    modes = principal_modes(given_, metric)
    rebuilt = modes.pose_map().weights(modes.scores) @ modes.key_shapes()
    np.testing.assert_allclose(rebuilt, given_, atol=1e-5)
    np.testing.assert_allclose(rebuilt * metric, given_ * metric, atol=1e-13)


def test_no_matrix_is_as_large_as_the_square_of_many_frames() -> None:
    given_ = np.random.default_rng(0).standard_normal((2000, 10))
    tracemalloc.start()
    principal_modes(given_, np.ones(10)).key_shapes()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * given_.nbytes < 8 * 2000**2 / 10
