"""Connectivity in closed form."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csgraph

from mixseq.mesh.polygons import label_vertices
from mixseq.mesh.topology import (
    Topology,
    dilate_vertices,
    face_patches,
    interior_hinges,
    mark_face_vertices,
    propagate_depth,
)
from tests.meshes import flipped, grid, joined, pages, seeds, tetrahedron, topology_of, torus, tube


def test_two_triangles() -> None:
    pair = Topology(np.array([[0, 1, 2], [2, 1, 3]]), 4)
    assert pair.edges.tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    assert pair.face_edges.tolist() == [[0, 2, 1], [2, 3, 4]]
    assert pair.edge_face_counts.tolist() == [1, 1, 2, 1, 1]
    # The first face runs 1 -> 2, so a = 1, b = 2; opposite are 0 and 3.
    assert pair.hinges.tolist() == [[1, 2, 0, 3]]
    assert pair.hinge_faces.tolist() == [[0, 1]]
    assert pair.hinge_edges.tolist() == [2]
    assert pair.boundary_edges.tolist() == [0, 1, 3, 4]
    assert pair.inconsistent_edges.size == pair.non_manifold_edges.size == pair.unused_vertices.size == 0


def test_tetrahedron() -> None:
    report = topology_of(tetrahedron()).report()
    assert report == {
        "vertices": 4,
        "faces": 4,
        "edges": 6,
        "hinges": 6,
        "components": 1,
        "boundary_edges": 0,
        "non_manifold_edges": 0,
        "inconsistent_edges": 0,
        "unused_vertices": 0,
        "closed": True,
    }


@pytest.mark.parametrize(("sides", "rings"), [(3, 2), (8, 5), (13, 20)])
def test_tubes(sides: int, rings: int) -> None:
    bands = rings - 1
    opened = topology_of(tube(sides, rings, closed=False)).report()
    assert opened["faces"] == 2 * sides * bands
    assert opened["edges"] == sides * rings + 2 * sides * bands
    assert opened["boundary_edges"] == 2 * sides
    assert opened["hinges"] == sides * (rings - 2) + 2 * sides * bands
    assert not opened["closed"]
    closed = topology_of(tube(sides, rings)).report()
    assert closed["faces"] == 2 * sides * rings
    assert closed["edges"] == closed["hinges"] == 3 * sides * rings
    assert closed["vertices"] == sides * rings + 2
    assert closed["closed"]
    assert closed["inconsistent_edges"] == 0


@pytest.mark.parametrize(("mesh", "characteristic"), [(tube(7, 4), 2), (torus(9, 5), 0), (grid(3, 4), 1)])
def test_eulers_formula(mesh: tuple[np.ndarray, np.ndarray], characteristic: int) -> None:
    topology = topology_of(mesh)
    assert topology.vertex_count - len(topology.edges) + len(topology.faces) == characteristic


def test_every_hinge_is_an_edge_with_two_faces() -> None:
    topology = topology_of(tube(6, 5))
    for (a, b, c, d), (first, second), edge in zip(
        topology.hinges.tolist(), topology.hinge_faces, topology.hinge_edges, strict=True
    ):
        assert topology.edges[edge].tolist() == sorted((a, b))
        one, two = topology.faces[first].tolist(), topology.faces[second].tolist()
        assert sorted(one) == sorted((a, b, c))
        assert sorted(two) == sorted((a, b, d))
        assert one[(one.index(a) + 1) % 3] == b  # the first face runs a -> b ...
        assert two[(two.index(b) + 1) % 3] == a  # ... and the second one back
        assert edge in topology.face_edges[first]
        assert edge in topology.face_edges[second]


def test_three_faces_at_an_edge_are_two_hinges_in_a_row() -> None:
    fan = Topology(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]), 5)
    assert fan.non_manifold_edges.tolist() == [0]
    assert fan.edge_face_counts[0] == 3
    assert fan.hinge_faces.tolist() == [[0, 1], [1, 2]]
    assert fan.hinges.tolist() == [[0, 1, 2, 3], [1, 0, 3, 4]]
    assert fan.component_of_face.tolist() == [0, 0, 0]
    assert fan.inconsistent_edges.size == 0  # orientation across such an edge means nothing


@pytest.mark.parametrize("count", [3, 4, 6])
def test_books(count: int) -> None:
    topology = topology_of(pages(count, rows=5, columns=2))
    assert len(topology.non_manifold_edges) == 5
    assert set(topology.edge_face_counts[topology.non_manifold_edges].tolist()) == {count}
    at_spine = np.isin(topology.hinge_edges, topology.non_manifold_edges)
    assert np.count_nonzero(at_spine) == 5 * (count - 1)


def test_faces_that_are_turned_over_are_found() -> None:
    points, faces = grid(3, 3)
    turned = faces.copy()
    turned[8] = turned[8, ::-1]
    topology = Topology(turned, len(points))
    sides = set(topology.face_edges[8].tolist()) - set(topology.boundary_edges.tolist())
    assert set(topology.inconsistent_edges.tolist()) == sides
    assert len(topology.hinges) == len(Topology(faces, len(points)).hinges)
    everything = Topology(flipped(faces, 1), len(points))
    assert everything.inconsistent_edges.size == 0


def test_unused_vertices_are_no_component() -> None:
    topology = Topology(np.array([[1, 3, 5]]), 7)
    assert topology.unused_vertices.tolist() == [0, 2, 4, 6]
    assert topology.component_count == 1
    assert np.unique(topology.component_of_vertex).size == 5
    assert topology.report()["unused_vertices"] == 4


def test_components() -> None:
    topology = topology_of(joined(tetrahedron(), grid(2, 2), tube(4, 3)))
    assert topology.component_count == 3
    assert np.bincount(topology.component_of_face).tolist() == [4, 8, 24]
    assert topology.component_of_vertex.tolist() == [0] * 4 + [1] * 9 + [2] * 14


def test_a_bowtie_is_one_component_of_vertices_and_two_of_faces() -> None:
    topology = Topology(np.array([[0, 1, 2], [2, 3, 4]]), 5)
    assert topology.component_count == 1
    assert topology.component_of_face.tolist() == [0, 1]
    assert topology.hinges.shape == (0, 4)


def test_adjacency_is_symmetric_and_counts() -> None:
    topology = topology_of(torus(6, 4))
    vertices, faces = topology.vertex_adjacency.toarray(), topology.face_adjacency.toarray()
    np.testing.assert_array_equal(vertices, vertices.T)
    np.testing.assert_array_equal(faces, faces.T)
    assert vertices.sum() == 2 * len(topology.edges)
    np.testing.assert_array_equal(vertices.sum(axis=1), 6)  # every vertex of this torus has six neighbours
    np.testing.assert_array_equal(faces.sum(axis=1), 3)


def test_the_same_triangle_twice_is_joined_by_three_hinges() -> None:
    topology = Topology(np.array([[0, 1, 2], [0, 1, 2]]), 3)
    assert len(topology.hinges) == 3
    assert topology.face_adjacency.toarray().tolist() == [[0, 3], [3, 0]]
    assert len(topology.inconsistent_edges) == 3


def test_triangles_that_name_a_vertex_twice_have_no_hinge_with_themselves() -> None:
    topology = Topology(np.array([[0, 0, 1], [1, 2, 3]]), 4)
    assert topology.hinges.shape == (0, 4)
    assert topology.edges.tolist() == [[0, 0], [0, 1], [1, 2], [1, 3], [2, 3]]


def test_some_hinges_are_those_of_all() -> None:
    for topology in (topology_of(torus(6, 4)), Topology(np.array([[0, 1, 2], [0, 1, 2], [3, 0, 1]]), 4)):
        some = np.arange(len(topology.hinges))[::2]
        np.testing.assert_array_equal(topology.hinges_at(some), topology.hinges[some])


def test_hinges_inside_are_between_marked_faces() -> None:
    topology = topology_of(torus(6, 4))
    faces = np.arange(len(topology.faces)) % 3 > 0
    expected = [h for h, pair in enumerate(topology.hinge_faces.tolist()) if faces[pair].all()]
    assert 0 < len(expected) < len(topology.hinges)
    assert interior_hinges(topology, faces).tolist() == expected


def test_vertices_near_are_a_few_edges_away() -> None:
    topology = topology_of(grid(9, 6))
    marked = np.arange(topology.vertex_count) == 7
    hops = csgraph.shortest_path(topology.vertex_adjacency, indices=7, unweighted=True)
    for rings in range(5):
        np.testing.assert_array_equal(dilate_vertices(topology, marked, rings), hops <= rings)


def test_face_patches() -> None:
    """Six triangles in the row 1 0 3 2 5 4; what is left when some are taken out."""
    strip = topology_of(grid(1, 3))
    assert face_patches(strip, np.ones(6, dtype=bool)).tolist() == [0] * 6
    assert face_patches(strip, np.array([1, 1, 0, 1, 0, 1], dtype=bool)).tolist() == [0, 0, -1, 0, -1, 1]
    assert face_patches(strip, np.array([0, 1, 1, 0, 1, 0], dtype=bool)).tolist() == [-1, 0, 1, -1, 2, -1]
    assert face_patches(strip, np.zeros(6, dtype=bool)).tolist() == [-1] * 6


def test_marks() -> None:
    strip = topology_of(grid(1, 3))  # vertices 0 to 3 below, 4 to 7 above
    assert np.flatnonzero(mark_face_vertices(strip, np.arange(6) == 0)).tolist() == [0, 1, 5]


@settings(max_examples=20, deadline=None)
@given(seed=seeds, deepest=st.integers(-2, 6))
def test_spread_is_the_largest_depth_less_the_distance(seed: int, deepest: int) -> None:
    rng = np.random.default_rng(seed)
    topology = topology_of(joined(grid(5, 4), tube(4, 5, closed=False)))
    depth = np.where(rng.random(topology.vertex_count) < 0.15, rng.integers(-2, deepest + 1, topology.vertex_count), 0)
    neighbours: list[set[int]] = [set() for _ in range(topology.vertex_count)]
    for i, j in topology.edges.tolist():
        neighbours[i].add(j)
        neighbours[j].add(i)
    expected = np.maximum(depth, 0)
    for start in range(topology.vertex_count):
        hops, queue = {start: 0}, deque([start])
        while queue:
            vertex = queue.popleft()
            for other in neighbours[vertex] - hops.keys():
                hops[other] = hops[vertex] + 1
                queue.append(other)
        for vertex, distance in hops.items():
            expected[vertex] = max(expected[vertex], depth[start] - distance)
    np.testing.assert_array_equal(propagate_depth(topology, depth), expected)


def test_vertices_have_the_label_of_most_triangles() -> None:
    faces = np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]])
    assert label_vertices(faces, np.array([0, 1, 3, 3]), 7).tolist() == [0, 0, 0, 1, 1, 1, 0]
    assert label_vertices(faces[:0], np.zeros(0, dtype=np.int64), 2).tolist() == [0, 0]
