"""The walk over polygons meets all of them, from edge to edge, wherever they are listed, and the same for ever."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression.bitstream.corners import walk_polygons
from mixseq.mesh.polygons import Polygons
from mixseq.types import Index
from tests.meshes import flipped, grid, joined, pages, tetrahedron, torus, tube

pytestmark = pytest.mark.slow


def shuffled(polygons: Polygons, seed: int) -> tuple[Polygons, Index]:
    """Return the same polygons in another order, each begun elsewhere, and the old number of each."""
    random = np.random.default_rng(seed)
    rows = np.split(polygons.indices, np.cumsum(polygons.counts)[:-1])
    order = random.permutation(len(rows))
    new = [np.roll(rows[each], random.integers(9)) for each in order]
    return Polygons(polygons.counts[order], np.concatenate(new)), order


def quads(rows: int, columns: int) -> Polygons:
    number = np.arange(rows * columns).reshape(rows, columns)
    corners = [number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]]
    return Polygons(np.full((rows - 1) * (columns - 1), 4), np.stack(corners, axis=-1).reshape(-1))


MESHES = {
    "tetrahedron": Polygons.from_triangles(tetrahedron()[1]),
    "grid": Polygons.from_triangles(grid(9, 7)[1]),
    "quads": quads(6, 5),
    "torus": Polygons.from_triangles(torus(20, 9)[1]),
    "three at an edge": Polygons.from_triangles(pages(3)[1]),
    "components": Polygons.from_triangles(joined(tube(6, 9), tetrahedron(), tube(5, 7))[1]),
    "turned over": Polygons.from_triangles(flipped(tube(8, 25)[1])),
}


def test_a_fan_is_walked_around() -> None:
    """Six triangles around vertex 0: the walk begins there and turns around it."""
    fan = Polygons.from_triangles([[0, each + 1, (each + 1) % 6 + 1] for each in (3, 0, 5, 2, 1, 4)])
    order, entered = walk_polygons(fan, 7)
    second = fan.indices.reshape(-1, 3)[order, 1]
    assert np.isin(np.diff(second) % 6, (1, 5)).all()
    assert fan.indices[entered[0]] == 0


@pytest.mark.parametrize("name", MESHES)
def test_every_polygon_is_met_once_and_entered_at_a_corner_of_its_own(name: str) -> None:
    polygons = MESHES[name]
    order, entered = walk_polygons(polygons, int(polygons.indices.max()) + 3)
    assert sorted(order.tolist()) == list(range(len(polygons.counts)))
    owner = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    np.testing.assert_array_equal(owner[entered], order)


@pytest.mark.parametrize("name", ["tetrahedron", "grid", "quads", "torus"])
def test_every_polygon_but_the_first_is_entered_across_an_edge(name: str) -> None:
    polygons = MESHES[name]
    order, entered = walk_polygons(polygons, int(polygons.indices.max()) + 1)
    rows = np.split(polygons.indices, np.cumsum(polygons.counts)[:-1])
    starts = np.cumsum(polygons.counts) - polygons.counts
    met: set[tuple[int, int]] = set()
    for place, (polygon, corner) in enumerate(zip(order, entered, strict=True)):
        row = rows[polygon].tolist()
        edges = list(zip(row, row[1:] + row[:1], strict=True))
        assert not place or edges[corner - starts[polygon]][::-1] in met
        met.update(edges)


@pytest.mark.parametrize("name", MESHES)
@settings(max_examples=10)
@given(st.integers(0, 100))
def test_it_does_not_matter_how_polygons_are_listed(name: str, seed: int) -> None:
    polygons = MESHES[name]
    count = int(polygons.indices.max()) + 1
    others, which = shuffled(polygons, seed)
    order, entered = walk_polygons(polygons, count)
    again, entered_again = walk_polygons(others, count)
    np.testing.assert_array_equal(which[again], order)
    np.testing.assert_array_equal(others.indices[entered_again], polygons.indices[entered])


def test_components_follow_each_other_by_their_lowest_vertices() -> None:
    polygons = MESHES["components"]
    _, entered = walk_polygons(polygons, int(polygons.indices.max()) + 1)
    ends = np.cumsum([len(mesh[0]) for mesh in (tube(6, 9), tetrahedron())])
    of_component = np.searchsorted(ends, polygons.indices[entered], side="right")
    assert (np.diff(of_component) >= 0).all()
    assert polygons.indices[entered[0]] == 0


def test_no_polygons_are_no_walk() -> None:
    nothing = Polygons(np.zeros(0, np.int32), np.zeros(0, np.int32))
    assert [each.tolist() for each in walk_polygons(nothing, 4)] == [[], []]


def test_the_walk_stays_the_same() -> None:
    """Frozen: files with the vertices of this walk are compared with their originals."""
    digest = hashlib.sha256()
    for polygons in MESHES.values():
        for numbers in walk_polygons(polygons, int(polygons.indices.max()) + 1):
            digest.update(numbers.astype("<i8").tobytes())
    assert digest.hexdigest()[:16] == "b76ba595da2974f2"
