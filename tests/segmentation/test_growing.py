"""Regions that grow over landscapes whose passes are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology, face_patches
from mixseq.segmentation.elements import Passes, check_parts, flood
from mixseq.types import Float
from tests.meshes import grid, joined, seeds, tetrahedron, topology_of


def chain(heights: list[float], areas: list[float] | None = None) -> Passes:
    """A strip of faces one after the other, with the heights of the hinges between them."""
    count = len(heights) + 1
    faces = np.array([[k, k + 1, k + 2] if k % 2 == 0 else [k + 1, k, k + 2] for k in range(count)])
    h = np.array(heights)
    bottoms = np.minimum(np.append(h, np.inf), np.insert(h, 0, np.inf))
    return flood(Topology(faces, count + 2), h, bottoms, np.ones(count) if areas is None else np.array(areas))


LANDSCAPE = [1.0, 5.0, 2.0, 3.0, 9.0, 0.0]
"""Bottoms of 1, 2 and 0, with passes of 5 and 9."""


def test_passes_of_a_chain() -> None:
    passes = chain(LANDSCAPE)
    assert passes.hinges.tolist() == [5, 0, 2, 3, 1, 4]
    assert passes.areas.tolist() == [1, 1, 1, 1, 2, 2]
    assert passes.depths.tolist() == [
        0,
        0,
        0,
        0,
        3,
        8,
    ]  # 5 - 2, and 9 - 1: the shallower lake is the one left of it


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
    return topology, heights, flood(topology, heights, bottoms, rng.uniform(0.1, 1.0, len(topology.faces)))


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
        check_parts(parts, topology_of(tetrahedron()))
    check_parts(4, topology_of(tetrahedron()))
    check_parts(None, topology_of(tetrahedron()))
