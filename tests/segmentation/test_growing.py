"""Regions that grow over landscapes whose passes are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation.elements import Boundaries, Passes, Rim, check_part_count, find_passes
from mixseq.segmentation.methods import segment_by_labels
from mixseq.types import Float, Index
from tests.meshes import Mesh, flipped, grid, joined, pages, rotation, seeds, tetrahedron, topology_of, tube


def chain(heights: list[float], areas: list[float] | None = None) -> Passes:
    """A strip of faces one after the other, with the heights of the hinges between them."""
    count = len(heights) + 1
    faces = np.array([[k, k + 1, k + 2] if k % 2 == 0 else [k + 1, k, k + 2] for k in range(count)])
    h = np.array(heights)
    bottoms = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))
    return find_passes(Topology(faces, count + 2), h, bottoms, np.ones(count) if areas is None else np.array(areas))


LANDSCAPE = [1.0, 5.0, 2.0, 3.0, 9.0, 0.0]
"""Bottoms of 1, 2 and 0, with passes of 5 and 9."""


def test_passes_of_a_chain() -> None:
    passes = chain(LANDSCAPE)
    assert passes.hinges.tolist() == [5, 0, 2, 3, 1, 4]
    assert passes.areas.tolist() == [1, 1, 1, 1, 2, 2]
    assert passes.depths.tolist() == [0, 0, 0, 0, 3, 8]  # 5 - 2, and 9 - 1: the shallower lake is the one left of it


def test_cutting_at_passes() -> None:
    passes = chain(LANDSCAPE)
    assert passes.cut(np.array([5])).tolist() == [0, 0, 0, 0, 0, 1, 1]
    assert passes.cut(np.array([4, 5])).tolist() == [1, 1, 0, 0, 0, 2, 2]  # the largest is number 0
    assert passes.cut(np.zeros(0, dtype=np.int64)).tolist() == [0] * 7


def test_deepest_passes_first() -> None:
    passes = chain(LANDSCAPE)
    assert passes.deepest(1, 2.0).tolist() == []
    assert passes.deepest(2, 2.0).tolist() == [5]
    assert passes.deepest(3, 2.0).tolist() == [5, 4]
    assert len(passes.deepest(4, 2.0)) == 3  # smaller regions, as there are no more of this area
    assert len(passes.deepest(99, 2.0)) == 6


def test_passes_deeper_than() -> None:
    passes = chain(LANDSCAPE)
    assert passes.deeper(2.9, 2.0).tolist() == [4, 5]
    assert passes.deeper(3.0, 2.0).tolist() == [5]
    assert passes.deeper(3.0, 2.1).tolist() == []
    assert passes.deeper(-1.0, 0.0).tolist() == [0, 1, 2, 3, 4, 5]


def test_a_crumb_does_not_hide_a_part() -> None:
    """The highest hinge cuts off one face; the pass between the two large lakes is lower."""
    passes = chain([1.0, 1, 6, 1, 1, 9], [1.0, 1, 1, 1, 1, 1, 0.1])
    assert passes.cut(passes.deepest(2, 1.0)).tolist() == [1, 1, 1, 0, 0, 0, 0]


def random_landscape(seed: int) -> tuple[Topology, Float, Passes]:
    rng = np.random.default_rng(seed)
    topology = topology_of(joined(grid(5, 4), tetrahedron()))
    heights = rng.integers(0, 9, len(topology.hinges)).astype(float)
    bottoms = np.full(len(topology.faces), np.inf)
    np.minimum.at(bottoms, topology.hinge_faces.reshape(-1), np.repeat(heights, 2))
    return (topology, heights, find_passes(topology, heights, bottoms, rng.uniform(0.1, 1.0, len(topology.faces))))


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_the_tree_is_minimal(seed: int) -> None:
    topology, heights, passes = random_landscape(seed)
    i, j = topology.hinge_faces.T.astype(np.int32)  # all that older SciPy takes
    graph = coo_array((heights + 1.0, (i, j)), shape=(len(topology.faces),) * 2)
    best = minimum_spanning_tree(graph.tocsr())
    assert len(passes.hinges) == best.nnz == len(topology.faces) - 2
    assert heights[passes.hinges].sum() == pytest.approx(best.sum() - best.nnz)


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_regions_are_connected_and_large_enough(seed: int) -> None:
    topology, _, passes = random_landscape(seed)
    where = passes.deeper(0.5, 1.5)
    labels = passes.cut(where)
    area = np.bincount(labels, passes.face_areas)
    assert len(area) == len(where) + 2
    assert (np.diff(area) <= 0).all()
    for region in range(len(area)):
        assert face_patches(topology, labels == region).max() == 0
        alone = set(topology.component_of_face[labels == region].tolist()) == {1}  # the tetrahedron
        assert area[region] >= 1.5 or alone


@settings(max_examples=20, deadline=None)
@given(seed=seeds)
def test_as_many_regions_as_asked_for(seed: int) -> None:
    topology, _, passes = random_landscape(seed)
    for parts in (1, 2, 3, 7, len(topology.faces)):
        assert passes.cut(passes.deepest(parts, 1.5)).max() + 1 == max(parts, 2)  # there are two components


@pytest.mark.parametrize("parts", [0, -1, 5])
def test_numbers_that_no_segmentation_has(parts: int) -> None:
    with pytest.raises(SettingsError, match=rf"parts is {parts}; a whole number from 1 to 4 \(the faces\)"):
        check_part_count(parts, topology_of(tetrahedron()))
    check_part_count(4, topology_of(tetrahedron()))
    check_part_count(None, topology_of(tetrahedron()))


# Where neighbouring parts meet, in closed forms


def cut(mesh: Mesh, *heights: float, axis: int = 2) -> Index:
    """Labels of the faces of a mesh that is cut at heights."""
    middles = mesh[0][mesh[1]].mean(axis=1)[:, axis]
    return segment_by_labels(np.searchsorted(heights, middles), topology_of(mesh))


def boundaries_of(mesh: Mesh, labels: Index) -> Boundaries:
    return Boundaries.from_labels(topology_of(mesh), labels)


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
    rim = Rim.from_labels(topology_of(mesh), labels)
    np.testing.assert_array_equal(rim.narrowness(labels), [3 / 8, 3 / 8])
    np.testing.assert_array_equal(rim.narrowness(np.zeros_like(labels)), [0.0])


def test_what_is_left_of_a_rim_is_the_rim_of_what_is_left() -> None:
    mesh = tube(5, 13)
    labels = cut(mesh, 1.0, 2.0, 3.5)
    rim = Rim.from_labels(topology_of(mesh), labels)
    for keep, drop in ((0, 1), (2, 3), (0, 2)):
        merged = np.where(labels == drop, keep, labels)
        np.testing.assert_array_equal(
            rim.narrowness(merged), Rim.from_labels(topology_of(mesh), merged).narrowness(merged)
        )
