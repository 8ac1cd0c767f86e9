"""Modes: principal components of vectors, of few frames or of many."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from mixseq.signals.pose import _from_coordinates, _from_frames, principal_modes
from mixseq.types import Float


def vectors(count: int = 6, rank: int = 3, dim: int = 40, seed: int = 0) -> Float:
    random = np.random.default_rng(seed)
    left = random.standard_normal((count, rank)) * 10.0 ** -np.arange(rank)
    return np.asarray(left @ random.standard_normal((rank, dim)) + random.standard_normal(dim))


METRIC = np.linspace(0.1, 2, 40)


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
