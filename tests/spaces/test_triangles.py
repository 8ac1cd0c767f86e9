"""Triangles with a fourth vertex, and those that stand in for triangles without area."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.triangle_mesh import completed, with_area
from tests.meshes import topology_of

CORNERS = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [6, 0, 0], [1, 1, 1]])


def matrices_of(faces: list[list[int]]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    index = np.array(faces)
    return completed(CORNERS, index, topology_of((CORNERS, index)).edges)


def test_the_fourth_vertex_grows_with_the_triangle() -> None:
    (matrix,) = matrices_of([[0, 1, 2]])
    np.testing.assert_allclose(matrix, np.diag([2.0, 3.0, np.sqrt(6)]), atol=1e-15)
    triangle = np.array([[0, 1, 2]])
    larger = completed(5 * CORNERS, triangle, triangle[:, :2])
    np.testing.assert_allclose(larger[0], 5 * matrix)


def test_a_flat_triangle_asks_its_neighbour() -> None:
    _, flat = matrices_of([[0, 2, 1], [0, 1, 3]])
    np.testing.assert_allclose(flat, [[2.0, 6.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.06]], atol=1e-15)
    (alone,) = matrices_of([[0, 1, 3]])
    np.testing.assert_allclose(alone[:, 2], [0.0, 0.06, 0.0])


def test_stand_ins_are_equilateral_on_the_longest_side() -> None:
    matrices = matrices_of([[0, 1, 2], [1, 0, 3], [4, 4, 4], [0, 2, 2]])
    found = with_area(matrices)
    np.testing.assert_array_equal(found[0], matrices[0])
    assert (np.linalg.det(found) > 0).all()
    first, second = found[1:, :, 0], found[1:, :, 1]
    sides = np.linalg.norm([first, second - first, second], axis=2)
    usual = (np.sqrt(13) + 6 + 3) / 3
    np.testing.assert_allclose(sides, np.tile([6, usual, 3], (3, 1)))
    np.testing.assert_allclose(second[0] - first[0], [6.0, 0.0, 0.0], atol=1e-12)  # from 0 to 3
    np.testing.assert_allclose(first[2], [0.0, 3.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found[1:, :, 2], axis=1) ** 2, sides[0] ** 2 * np.sqrt(0.75))


def test_a_mesh_that_is_a_point_gets_the_size_one() -> None:
    found = with_area(np.zeros((2, 3, 3)))
    np.testing.assert_allclose(np.linalg.norm(found[:, :, :2], axis=1), 1)
    np.testing.assert_allclose(np.linalg.det(found), np.sqrt(0.75) ** 1.5)
