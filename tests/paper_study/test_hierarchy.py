"""Patches cover their mesh, are connected, and overlap on every level."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from mixseq.mesh.topology import Topology, face_patches
from scripts.paper_study.msgi.hierarchy import Region, divide
from tests import meshes

pytestmark = pytest.mark.slow

MESHES = {
    "tube": meshes.tube(6, 9),
    "open tube": meshes.tube(6, 9, closed=False),
    "torus": meshes.torus(10, 6),
    "sheet": meshes.grid(8, 6),
    "book": meshes.pages(3, 5, 4),
}


def regions(region: Region) -> Iterator[Region]:
    yield region
    for child in region.children:
        yield from regions(child)


@pytest.fixture(params=MESHES)
def topology(request: pytest.FixtureRequest) -> Topology:
    return meshes.topology_of(MESHES[request.param])


@pytest.mark.parametrize(("leaf", "group", "strips"), [(1, 2, 1), (20, 2, 1), (30, 5, 2)])
def test_patches(topology: Topology, leaf: int, group: int, strips: int) -> None:
    whole = divide(topology, np.arange(len(topology.faces)), leaf, group, strips)
    assert whole.faces.tolist() == list(range(len(topology.faces)))
    for region in regions(whole):
        inside = np.zeros(len(topology.faces), dtype=bool)
        inside[region.faces] = True
        assert face_patches(topology, inside).max() == 0, "a patch is not hinge-connected"
        assert (np.diff(region.faces) > 0).all()
        if not region.children:
            continue
        assert 2 <= len(region.children) <= group
        assert np.array_equal(np.unique(np.concatenate([child.faces for child in region.children])), region.faces)
        # Children hang together by overlaps of at least two faces.
        held, waiting = [region.children[0]], list(region.children[1:])
        while waiting:
            reached = [c for c in waiting if any(len(np.intersect1d(c.faces, h.faces)) >= 2 for h in held)]
            assert reached, "a child does not overlap with its siblings"
            held += reached
            waiting = [c for c in waiting if c not in reached]


def test_leaves_are_small() -> None:
    topology = meshes.topology_of(meshes.grid(25, 25))
    whole = divide(topology, np.arange(len(topology.faces)), 100, 6, 1)
    leaves = [region for region in regions(whole) if not region.children]
    assert len(leaves) >= len(topology.faces) / 100
    assert max(len(each.faces) for each in leaves) < 250


def test_part_of_a_mesh() -> None:
    topology = meshes.topology_of(meshes.joined(meshes.tube(8, 12), meshes.tube(6, 9)))
    second = np.flatnonzero(topology.component_of_face == 1)
    assert np.array_equal(divide(topology, second, 20, 4, 1).faces, second)


def test_one_face() -> None:
    whole = divide(Topology(np.array([[0, 1, 2]]), 3), np.array([0]), 1, 2, 1)
    assert whole.faces.tolist() == [0]
    assert whole.children == ()


def test_faces_that_touch_in_a_point_do_not_join() -> None:
    """The strip from face 0 to face 6 comes back to its vertex 0; there it touches itself only in that point."""
    strip = np.array([[0, 1, 2], [1, 3, 2], [2, 3, 4], [3, 5, 4], [4, 5, 6], [5, 7, 6], [6, 7, 0]])
    topology = Topology(strip, 8)
    assert len(topology.hinges) == len(strip) - 1
    whole = divide(topology, np.arange(7), 1, 7, 1)
    first = next(child for child in whole.children if 0 in child.faces and 6 not in child.faces)
    assert first.faces.tolist() == list(range(first.faces.max() + 1))


def test_same_again() -> None:
    topology = meshes.topology_of(MESHES["torus"])
    one, two = (list(regions(divide(topology, np.arange(len(topology.faces)), 20, 4, 1))) for _ in "ab")
    assert [each.faces.tolist() for each in one] == [each.faces.tolist() for each in two]


def test_larger_leaves_are_fewer() -> None:
    topology = meshes.topology_of(MESHES["torus"])
    counts = [
        sum(not region.children for region in regions(divide(topology, np.arange(len(topology.faces)), leaf, 4, 1)))
        for leaf in (10, 40, 100, 10_000)
    ]
    assert all(many > few for many, few in pairwise(counts))
    assert counts[-1] == 1
