"""What holds pieces of a mesh together."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from mixseq.mesh.nearest import Attachments, attach
from mixseq.types import Index
from tests.meshes import seeds


def pieces_of(sizes: list[int]) -> list[Index]:
    return np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])


def rows(found: Attachments) -> list[tuple[int, int, int, int]]:
    columns = (found.pieces, found.own, found.other, found.holders)
    return list(zip(*(column.tolist() for column in columns), strict=True))


# Vertices on the x axis: a long body, and beads in a chain away from it.
CHAIN = np.array([[0.0], [10.0], [13.0], [13.5], [11.0], [11.5], [15.0]]) * [1.0, 0.0, 0.0]


def test_a_chain_is_held_one_by_one() -> None:
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    found = attach(pieces, CHAIN, np.arange(7))
    assert found.root == 0
    assert rows(found) == [(2, 4, 1, 0), (1, 2, 5, 2), (3, 6, 3, 1)]
    assert len(found) == 3


def test_the_largest_piece_is_the_root_wherever_it_is_listed() -> None:
    pieces = [np.array([6]), np.array([2, 3]), np.array([0, 1]), np.array([4, 5])]
    found = attach(pieces, CHAIN, np.arange(7))
    assert found.root == 2
    assert rows(found) == [(3, 4, 1, 2), (1, 2, 5, 3), (0, 6, 3, 1)]


def test_followers_are_held_by_their_leaders_and_never_the_root() -> None:
    leaders = np.arange(7)
    leaders[[0, 1]] = 6  # the longest piece follows the last vertex
    leaders[[4, 5]] = 2
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    found = attach(pieces, CHAIN, leaders)
    assert found.root == 1
    # By their vertices nearest to the leader; after the piece that it is on.
    assert rows(found) == [(3, 6, 3, 1), (0, 1, 6, 3), (2, 5, 2, 1)]


def test_a_piece_that_follows_in_part_is_free() -> None:
    leaders = np.arange(7)
    leaders[5] = 4
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    assert rows(attach(pieces, CHAIN, leaders))[0] == (2, 4, 1, 0)


def test_one_piece_needs_nothing() -> None:
    found = attach([np.arange(7)], CHAIN, np.arange(7))
    assert (found.root, len(found)) == (0, 0)
    assert found.own.dtype == np.int64


def test_pieces_that_share_a_vertex_are_held_there() -> None:
    found = attach([np.array([0, 1, 2]), np.array([2, 3, 4])], np.eye(5)[:, :3] * 9, np.arange(5))
    assert rows(found) == [(1, 2, 2, 0)]


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_attachments_are_as_short_as_can_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = pieces_of(rng.integers(1, 6, 8).tolist())
    owner = np.repeat(np.arange(8), [len(each) for each in pieces])
    points = rng.normal(size=(len(owner), 3)) + 4 * rng.normal(size=(8, 3))[owner]
    found = attach(pieces, points, np.arange(len(points)))
    lengths = np.linalg.norm(points[found.own] - points[found.other], axis=1)
    apart = np.array([[cdist(points[a], points[b]).min() for a in pieces] for b in pieces])
    np.testing.assert_allclose(lengths.sum(), minimum_spanning_tree(apart).sum())
    assert np.array_equal(owner[found.own], found.pieces)
    assert np.array_equal(owner[found.other], found.holders)
    before = [found.root]
    for piece, holder in zip(found.pieces.tolist(), found.holders.tolist(), strict=True):
        assert holder in before
        before.append(piece)
    assert sorted(before) == list(range(8))
