"""Normals of a cube in closed form, with its edges hard and soft."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.measures import hard_edges_of_normals, shared_normals, vector_areas
from mixseq.mesh.polygons import Polygons

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
SIDES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
CUBE = Polygons(np.full(6, 4), SIDES.reshape(-1))
OUTWARDS = np.array([[-1, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


def test_vector_areas_of_a_cube() -> None:
    np.testing.assert_allclose(vector_areas(CORNERS[None], CUBE)[0], 4.0 * OUTWARDS)


def test_areas_do_not_cancel_far_away() -> None:
    far = CORNERS[None] + 1e7
    np.testing.assert_array_equal(vector_areas(far, CUBE)[0], 4.0 * OUTWARDS)


def test_soft_corners_point_along_the_diagonals() -> None:
    np.testing.assert_allclose(shared_normals(CORNERS[None], CUBE)[0], CORNERS / np.sqrt(3), atol=1e-7)


def test_hard_edges_keep_the_normals_of_their_sides() -> None:
    hard = np.repeat(np.arange(6), 4)
    np.testing.assert_allclose(shared_normals(CORNERS[None], CUBE, hard)[0], OUTWARDS, atol=1e-7)


def test_normals_turn_with_the_mesh() -> None:
    turned = CORNERS[:, [1, 2, 0]]
    both = shared_normals(np.stack([CORNERS, turned]), CUBE)
    np.testing.assert_allclose(both[1], both[0][:, [1, 2, 0]], atol=1e-7)


def test_no_area_no_direction() -> None:
    flat = np.zeros((1, 8, 3))
    np.testing.assert_array_equal(shared_normals(flat, CUBE)[0], np.tile([0.0, 0.0, 1.0], (8, 1)))


def test_hard_edges_are_found_and_kept() -> None:
    authored = np.repeat(OUTWARDS, 4, axis=0).astype(np.float32)
    groups = hard_edges_of_normals(CUBE, authored)
    assert groups is not None
    assert len(np.unique(groups)) == 24
    again = shared_normals(CORNERS[None], CUBE, groups)[0][groups]
    np.testing.assert_allclose(again, authored, atol=1e-6)


def test_one_normal_per_vertex_is_no_hard_edge() -> None:
    smooth = (CORNERS / np.sqrt(3))[CUBE.indices]
    assert hard_edges_of_normals(CUBE, smooth + 1e-5) is None


def test_triangles_have_the_normals_of_polygons() -> None:
    random = np.random.default_rng(0)
    points, triangles = random.standard_normal((2, 12, 3)), random.integers(0, 12, (40, 3))
    with_a_square = Polygons(
        np.append(np.full(40, 3), 4), np.append(triangles, [0, 0, 0, 0])
    )  # without an area
    expected = shared_normals(points, with_a_square)
    np.testing.assert_array_equal(shared_normals(points, Polygons.from_triangles(triangles)), expected)
