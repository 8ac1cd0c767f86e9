"""The adjusted Rand index, against counting pairs."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.errors import SegmentationError
from mixseq.segmentation.methods import adjusted_rand_index
from tests.meshes import seeds


def by_pairs(a: list[int], b: list[int], w: list[float]) -> float:
    """Agreement over pairs of faces that weigh the product of their weights, corrected for chance."""
    together = first = second = pairs = 0.0
    for i, j in combinations(range(len(a)), 2):
        weight = w[i] * w[j]
        pairs += weight
        first += weight * (a[i] == a[j])
        second += weight * (b[i] == b[j])
        together += weight * (a[i] == a[j] and b[i] == b[j])
    expected = first * second / pairs
    return (together - expected) / ((first + second) / 2 - expected)


@settings(max_examples=30, deadline=None)
@given(seed=seeds)
def test_it_counts_pairs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 4, (2, 15))
    a[:2], b[:2] = (0, 1), (1, 1)
    weights = rng.uniform(0.1, 2.0, 15)
    for w in (np.ones(15), weights):
        given_weights = None if (w == 1).all() else w
        index = adjusted_rand_index(a, b, given_weights)
        assert index == pytest.approx(by_pairs(a.tolist(), b.tolist(), w.tolist()))
        assert adjusted_rand_index(b, a, given_weights) == pytest.approx(index)
        assert adjusted_rand_index(9 - 3 * a, b, given_weights) == pytest.approx(index)


@pytest.mark.parametrize(
    ("a", "b", "index"),
    [
        ([0, 0, 1, 1], [1, 1, 0, 0], 1.0),
        ([0, 0, 1, 2], [0, 0, 1, 1], 4 / 7),
        ([0, 0, 0, 0], [0, 1, 2, 3], 0.0),
        ([0, 0, 1, 1], [0, 1, 0, 1], -0.5),
        ([2, 2, 2], [0, 0, 0], 1.0),
        ([0, 1, 2], [2, 0, 1], 1.0),
        ([5], [7], 1.0),
        ([], [], 1.0),
    ],
)
def test_known_values(a: list[int], b: list[int], index: float) -> None:
    assert adjusted_rand_index(a, b) == pytest.approx(index)


def test_faces_that_are_all_alone_are_the_same_segmentation() -> None:
    """Exactly, whatever the weights, and however many there are."""
    rng = np.random.default_rng(4)
    for count in (7, 1000, 60_000):
        weights = rng.uniform(0.0, 1.0, count)
        assert adjusted_rand_index(rng.permutation(count), np.arange(count), weights) == 1.0


def test_weights_count() -> None:
    """What disagrees hardly matters where it hardly weighs."""
    a, b = [0, 0, 1, 1, 0], [0, 0, 1, 1, 1]
    assert adjusted_rand_index(a, b) < 0.5
    assert adjusted_rand_index(a, b, [1, 1, 1, 1, 1e-6]) == pytest.approx(1.0, abs=1e-5)


def test_chance_agrees_with_nothing() -> None:
    a, b = np.random.default_rng(0).integers(0, 6, (2, 20_000))
    assert abs(adjusted_rand_index(a, b)) < 0.005


@pytest.mark.parametrize(
    ("a", "b", "weights", "message"),
    [
        ([0, 1], [0, 1, 2], None, r"labels have shapes \(2,\) and \(3,\)"),
        ([[0, 1]], [[0, 1]], None, "one for each face of the same mesh"),
        ([0, 1], [0, 1], [1.0], r"weights have shape \(1,\); for each of the 2 faces"),
        ([0, 1], [0, 1], [1.0, -1.0], "at least 0"),
        ([0, 1], [0, 1], [1.0, np.nan], "at least 0"),
    ],
)
def test_refusals(a: list[int], b: list[int], weights: list[float] | None, message: str) -> None:
    with pytest.raises(SegmentationError, match=message):
        adjusted_rand_index(a, b, weights)
