"""The adjusted Rand index, against counting pairs."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from mixseq.errors import SegmentationError
from mixseq.segmentation.methods import adjusted_rand_index, near_rigid_errors, segment_by_labels
from tests.meshes import grid, joined, seeds, tetrahedron, topology_of


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


def test_labels_are_numbered_densely() -> None:
    topology = topology_of(tetrahedron())
    assert segment_by_labels([9, 9, -4, 9], topology).tolist() == [1, 1, 0, 1]
    assert segment_by_labels(np.array([9, 9, 200, 9], dtype=np.uint8), topology).tolist() == [0, 0, 1, 0]


def test_equal_labels_that_are_not_connected_are_several_parts() -> None:
    topology = topology_of(joined(grid(1, 3), tetrahedron()))
    # Six triangles in a row: the two ends have the same label, the tetrahedron has it, too.
    assert segment_by_labels([1, 1, 2, 2, 1, 1, 1, 1, 1, 1], topology).tolist() == [0, 0, 3, 3, 1, 1, 2, 2, 2, 2]


def test_parts_that_touch_in_a_vertex_only_are_not_connected() -> None:
    topology = topology_of(grid(2, 2))
    checkers = np.array([0, 0, 1, 1, 1, 1, 0, 0])
    assert segment_by_labels(checkers, topology).max() == 3


@pytest.mark.parametrize(
    "labels", [[0, 1, 2], [0.0, 1.0, 2.0, 3.0], [[0, 1, 2, 3]], [True, False, True, True], 3, ["a"] * 4]
)
def test_what_is_not_one_whole_number_per_face_is_refused(labels: Any) -> None:
    with pytest.raises(SegmentationError, match="one whole number for each of the 4 triangles is expected"):
        segment_by_labels(labels, topology_of(tetrahedron()))


# How near-rigid parts are


def test_near_rigid_errors() -> None:
    """Two triangles turn as a book's pages: each alone is rigid, together they are not; one that stretches is soft."""
    angle = np.linspace(0, 1, 4)
    points = np.zeros((4, 6, 3))
    points[:, 1, 0], points[:, 2, 1] = 1, 1
    points[:, 3] = points[:, 0] + [0, 0, 5]
    points[:, 4] = points[:, 3] + np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    points[:, 5] = points[:, 3] + np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    parts, whole = near_rigid_errors(points, faces, np.array([0, 1]))
    np.testing.assert_allclose(parts, 0, atol=1e-5)
    assert whole < 1e-5
    parts, whole = near_rigid_errors(points, faces, np.array([0, 0]))
    assert parts[0] == pytest.approx(whole)
    assert whole > 1
    points[1:, 1, 0] = 1.3
    parts, _ = near_rigid_errors(points, faces, np.array([0, 1]))
    assert parts[0] > 5 > 1e-5 > parts[1]
