"""Corners know their twins, and polygons are visited each beside those before it."""

from __future__ import annotations

import numpy as np

from mixseq.compression.bitstream.corners import corners_on_nodes, growing_order, next_corner, previous_corner
from mixseq.mesh.polygons import Polygons
from tests.meshes import grid, pages


def test_twins_run_the_other_way() -> None:
    """A quad, a triangle beside it, and one that is turned over."""
    polygons = Polygons(np.array([4, 3, 3]), np.array([0, 1, 2, 3, 2, 1, 4, 1, 2, 5]))
    corners = corners_on_nodes(polygons, 6)
    assert corners.twin.tolist() == [-1, 4, -1, -1, 1, -1, -1, -1, -1, -1]
    assert [next_corner(corners, corner) for corner in range(4)] == [1, 2, 3, 0]
    assert [previous_corner(corners, corner) for corner in range(4, 7)] == [6, 4, 5]
    assert corners.around[corners.around_starts[1] : corners.around_starts[2]].tolist() == [1, 5, 7]


def test_of_several_half_edges_the_first_is_the_twin_of_the_first() -> None:
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4], [2, 2, 3]])
    twin = corners_on_nodes(Polygons.from_triangles(faces), 5).twin
    assert (twin[0], twin[3], twin[6]) == (6, -1, 0)
    assert twin[9] == -1  # an edge from a vertex to itself
    faces = pages(3)[1]
    spine = corners_on_nodes(Polygons.from_triangles(faces), int(faces.max()) + 1)
    has = np.flatnonzero(spine.twin >= 0)
    np.testing.assert_array_equal(spine.twin[spine.twin[has]], has)


def test_every_polygon_is_beside_those_before() -> None:
    points, faces = grid(6, 9)
    faces = np.random.default_rng(0).permutation(faces)
    order = growing_order(corners_on_nodes(Polygons.from_triangles(faces), len(points)))
    assert sorted(order) == list(range(len(faces)))
    assert order[0] == 0
    for place in range(1, len(order)):
        shared = [len(set(faces[order[place]]) & set(faces[other])) for other in order[:place]]
        assert max(shared) >= 2
