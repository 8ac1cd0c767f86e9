"""Where neighbouring parts meet, in closed forms."""

from __future__ import annotations

import numpy as np

from mixseq.segmentation.elements import Boundaries, Rim
from mixseq.segmentation.methods import segment_by_labels
from mixseq.types import Index
from tests.meshes import Mesh, flipped, grid, joined, pages, rotation, topology_of, tube


def cut(mesh: Mesh, *heights: float, axis: int = 2) -> Index:
    """Labels of the faces of a mesh that is cut at heights."""
    middles = mesh[0][mesh[1]].mean(axis=1)[:, axis]
    return segment_by_labels(np.searchsorted(heights, middles), topology_of(mesh))


def boundaries_of(mesh: Mesh, labels: Index) -> Boundaries:
    return Boundaries.of(topology_of(mesh), labels)


def test_two_halves_of_a_tube_meet_in_a_ring() -> None:
    mesh = tube(6, 9)
    boundaries = boundaries_of(mesh, cut(mesh, 2.0))
    assert boundaries.parts.tolist() == [[0, 1]]
    assert boundaries.pair.tolist() == [0] * 6
    np.testing.assert_array_equal(np.unique(boundaries.edges), 6 * 4 + np.arange(6))
    np.testing.assert_allclose(boundaries.middles(mesh[0]), [[0, 0, 2]], atol=1e-15)


def test_middles_move_with_the_frame() -> None:
    mesh = tube(7, 9)
    boundaries = boundaries_of(mesh, cut(mesh, 1.0, 3.0))
    turn, shift = rotation((0.4, -1.0, 2.0)), np.array([1.0, 2.0, 3.0])
    moved = boundaries.middles(mesh[0] @ turn.T + shift)
    np.testing.assert_allclose(moved, boundaries.middles(mesh[0]) @ turn.T + shift, atol=1e-14)


def test_a_chain_meets_link_by_link() -> None:
    mesh = tube(5, 13)
    labels = cut(mesh, 1.0, 2.0, 3.0)
    boundaries = boundaries_of(mesh, labels)
    assert (boundaries.parts[:, 0] < boundaries.parts[:, 1]).all()
    along = np.argsort([mesh[0][mesh[1][labels == part]].mean(axis=(0, 1))[2] for part in range(4)])
    links = {tuple(sorted(pair)) for pair in zip(along[:-1].tolist(), along[1:].tolist(), strict=True)}
    assert {tuple(pair) for pair in boundaries.parts.tolist()} == links
    np.testing.assert_allclose(np.sort(boundaries.middles(mesh[0])[:, 2]), [1, 2, 3], atol=1e-14)


def test_middles_are_means_of_the_middles_of_edges() -> None:
    """Two halves of a sheet meet in the column x = 2."""
    mesh = grid(3, 4)
    middles = boundaries_of(mesh, cut(mesh, 2.0, axis=0)).middles(mesh[0])
    np.testing.assert_allclose(middles, [[2.0, 1.5, 0.0]], atol=1e-15)


def test_faces_that_are_turned_over_meet_no_less() -> None:
    mesh = tube(6, 9)
    labels = cut(mesh, 2.0)
    other = boundaries_of((mesh[0], flipped(mesh[1])), labels)
    np.testing.assert_array_equal(other.parts, [[0, 1]])
    np.testing.assert_allclose(other.middles(mesh[0]), [[0, 0, 2]], atol=1e-15)


def test_at_a_spine_sheets_meet_one_after_the_other() -> None:
    """Where three sheets share an edge it has two hinges, each between one sheet and the next."""
    mesh = pages(3, rows=4, columns=2)
    boundaries = boundaries_of(mesh, np.repeat(np.arange(3), len(mesh[1]) // 3))
    assert boundaries.parts.tolist() == [[0, 1], [1, 2]]
    np.testing.assert_allclose(boundaries.middles(mesh[0]), [[0, 0, 2], [0, 0, 2]], atol=1e-15)


def test_parts_that_do_not_touch_do_not_meet() -> None:
    mesh = joined(tube(5, 6), tube(5, 6))
    for labels in (np.repeat([0, 1], len(mesh[1]) // 2), np.zeros(len(mesh[1]), dtype=np.int64)):
        boundaries = boundaries_of(mesh, labels)
        assert boundaries.parts.shape == (0, 2)
        assert boundaries.edges.shape == (0, 2)
        assert boundaries.middles(mesh[0]).shape == (0, 3)


def test_of_four_rings_of_faces_one_and_a_half_are_near_a_boundary() -> None:
    mesh = tube(6, 9, closed=False)
    labels = cut(mesh, 2.0)
    rim = Rim.of(topology_of(mesh), labels)
    np.testing.assert_array_equal(rim.narrowness(labels), [3 / 8, 3 / 8])
    np.testing.assert_array_equal(rim.narrowness(np.zeros_like(labels)), [0.0])


def test_what_is_left_of_a_rim_is_the_rim_of_what_is_left() -> None:
    mesh = tube(5, 13)
    labels = cut(mesh, 1.0, 2.0, 3.5)
    rim = Rim.of(topology_of(mesh), labels)
    for keep, drop in ((0, 1), (2, 3), (0, 2)):
        merged = np.where(labels == drop, keep, labels)
        np.testing.assert_array_equal(
            rim.narrowness(merged), Rim.of(topology_of(mesh), merged).narrowness(merged)
        )
