"""Overlapping pieces come together from anywhere."""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.mesh.rigid import transform_points
from mixseq.types import Float, Index
from scripts.paper_study.common.registration import Overlaps, register
from tests.meshes import rotation, seeds

Pieces = list[Index]


def cloud(count: int = 60) -> Float:
    return np.random.default_rng(7).normal(size=(count, 3))


def chain(links: int = 5, ring: bool = False) -> Pieces:
    """Pieces of 16 vertices, each sharing 4 with the next one (and the last one with the first)."""
    pieces = [np.arange(12 * k, 12 * k + 16) for k in range(links)]
    if ring:
        pieces[-1] = np.concatenate([pieces[-1][:12], np.arange(4)])
    return pieces


def star() -> Pieces:
    return [
        np.arange(16),
        *(np.concatenate([[k, k + 1, k + 2], 16 + 5 * k + np.arange(5)]) for k in (0, 4, 8)),
    ]


GRAPHS: dict[str, Pieces] = {
    "pair": chain(2),
    "tree": star(),
    "chain": chain(),
    "ring": chain(ring=True),
    "all": [np.setdiff1d(np.arange(20), [k, k + 5]) for k in range(4)],
    "three copies": [np.arange(10), np.arange(10), np.arange(3, 12)],
}


def scattered(points: Float, pieces: Pieces, rng: np.random.Generator) -> Float:
    """The pieces' points, each piece moved at random."""
    motions = [(rotation(rng.uniform(-3, 3, 3)), rng.normal(size=3)) for _ in pieces]
    return np.concatenate([points[v] @ r.T + t for v, (r, t) in zip(pieces, motions, strict=True)])


def placed(overlaps: Overlaps, points: Float, motions: tuple[Float, Float]) -> Float:
    owner = overlaps.owner
    return np.asarray(np.einsum("nij,nj->ni", motions[0][owner], points) + motions[1][owner])


def energy(overlaps: Overlaps, points: Float) -> float:
    """Sum of squared distances between all copies, from the definition."""
    return float(np.sum((points[overlaps.rows[:, 0]] - points[overlaps.rows[:, 1]]) ** 2))


def overlaps_of(points: Float, pieces: Pieces) -> Overlaps:
    return Overlaps.of(pieces, [points[v] for v in pieces])


@settings(max_examples=15, deadline=None)
@given(seed=seeds, name=st.sampled_from(list(GRAPHS)))
def test_exact_pieces_come_together(seed: int, name: str) -> None:
    points, pieces = cloud(80), GRAPHS[name]
    overlaps = overlaps_of(points, pieces)
    assert set(overlaps.group) == {0}
    loose = scattered(points, pieces, np.random.default_rng(seed))
    rotations, translations = register(overlaps, loose)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-9)
    np.testing.assert_allclose(rotations[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(translations[0], 0, atol=1e-12)
    together = placed(overlaps, loose, (rotations, translations))
    assert energy(overlaps, together) < 1e-18
    # ... and what comes together is the cloud, in the first piece's place.
    number = np.concatenate(pieces)
    first = np.array([together[np.flatnonzero(number == v)[0]] for v in np.unique(number)])
    original = points[np.unique(number)]
    np.testing.assert_allclose(
        np.linalg.norm(first[:, None] - first, axis=2),
        np.linalg.norm(original[:, None] - original, axis=2),
        atol=1e-8,
    )


@settings(max_examples=10, deadline=None)
@given(seed=seeds, name=st.sampled_from(list(GRAPHS)))
def test_no_small_motion_of_a_piece_is_better(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    points, pieces = cloud(80), GRAPHS[name]
    overlaps = overlaps_of(points, pieces)
    loose = scattered(points, pieces, rng)
    loose += 0.05 * rng.normal(size=loose.shape)
    rotations, translations = register(overlaps, loose)
    best = energy(overlaps, placed(overlaps, loose, (rotations, translations)))
    assert best > 0
    for _ in range(15):
        piece = int(rng.integers(len(pieces)))
        turned, moved = rotations.copy(), translations.copy()
        turned[piece] = rotation(1e-3 * rng.normal(size=3)) @ turned[piece]
        moved[piece] += 1e-3 * rng.normal(size=3)
        assert energy(overlaps, placed(overlaps, loose, (turned, moved))) >= best * (1 - 1e-9)


@settings(max_examples=10, deadline=None)
@given(seed=seeds, name=st.sampled_from(["ring", "all", "three copies"]))
def test_sweeps_lower_the_energy_of_the_tree(seed: int, name: str) -> None:
    rng = np.random.default_rng(seed)
    points, pieces = cloud(80), GRAPHS[name]
    overlaps = overlaps_of(points, pieces)
    loose = scattered(points, pieces, rng)
    loose += 0.05 * rng.normal(size=loose.shape)
    energies = [
        energy(overlaps, placed(overlaps, loose, register(overlaps, loose, sweeps=sweeps)))
        for sweeps in (0, 1, 2, 4, 500)
    ]
    assert all(later <= earlier * (1 + 1e-9) for earlier, later in pairwise(energies))


def test_a_tree_of_overlaps_is_solved_by_its_start() -> None:
    """Two pieces that overlap by noisy copies: the best motion is Kabsch's, found without a sweep."""
    rng = np.random.default_rng(2)
    points, pieces = cloud(80), GRAPHS["chain"]
    overlaps = overlaps_of(points, pieces)
    loose = scattered(points, pieces, rng)
    loose += 0.05 * rng.normal(size=loose.shape)
    start = energy(overlaps, placed(overlaps, loose, register(overlaps, loose, sweeps=0)))
    end = energy(overlaps, placed(overlaps, loose, register(overlaps, loose)))
    assert start == pytest.approx(end, rel=1e-9)


def test_groups() -> None:
    points = cloud(40)
    pieces = [np.arange(8), np.arange(20, 28), np.arange(5, 12), np.arange(24, 32), np.arange(33, 36)]
    overlaps = overlaps_of(points, pieces)
    assert overlaps.group.tolist() == [0, 1, 0, 1, 4]
    assert overlaps.tree.tolist() == [-1, -1, 0, 1, -1]
    loose = scattered(points, pieces, np.random.default_rng(0))
    motions = register(overlaps, loose)
    for root in (0, 1, 4):
        np.testing.assert_allclose(motions[0][root], np.eye(3), atol=1e-12)
        np.testing.assert_allclose(motions[1][root], 0, atol=1e-12)
    assert energy(overlaps, placed(overlaps, loose, motions)) < 1e-18


def test_pieces_that_share_a_line_do_not_hold_each_other() -> None:
    points = cloud(20)
    points[:4] = np.arange(4)[:, None] * [1.0, 2.0, 3.0]
    pieces = [np.arange(10), np.concatenate([np.arange(4), np.arange(10, 15)]), np.arange(8, 20)]
    overlaps = overlaps_of(points, pieces)
    assert overlaps.group.tolist() == [0, 1, 1]
    assert overlaps.pieces.tolist()[:4] == [[0, 1]] * 4  # but their copies count


@pytest.mark.parametrize("shared", [0, 1, 2])
def test_fewer_than_three_shared_vertices_do_not_hold(shared: int) -> None:
    points = cloud(20)
    overlaps = overlaps_of(points, [np.arange(10), np.arange(10 - shared, 20)])
    assert overlaps.group.tolist() == [0, 1]


def test_pairs_are_all_copies_of_a_vertex() -> None:
    pieces = [np.array([3, 5, 9]), np.array([5, 3]), np.array([9, 3])]
    overlaps = Overlaps.of(pieces, [np.zeros((len(v), 3)) for v in pieces])
    number, owner = np.concatenate(pieces), np.repeat([0, 1, 2], [3, 2, 2])
    expected = {(owner[i], owner[j], i, j) for i, j in combinations(range(7), 2) if number[i] == number[j]}
    found = {(*p, *r) for p, r in zip(overlaps.pieces.tolist(), overlaps.rows.tolist(), strict=True)}
    assert found == expected


def test_a_single_piece_stays() -> None:
    points = cloud(5)
    overlaps = overlaps_of(points, [np.arange(5)])
    rotations, translations = register(overlaps, points)
    np.testing.assert_array_equal(transform_points(points[None], rotations, translations)[0], points)
