"""Normals that every face and vertex has."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings

from mixseq.mesh.triangle_mesh import (
    area_normals,
    normalise,
    perpendicular,
    replace_degenerate,
    triangle_matrices,
    vertex_normals,
)
from mixseq.types import Float
from tests.meshes import grid, rigid_motions, tetrahedron, topology_of


def test_normals_of_faces_are_twice_as_long_as_areas() -> None:
    points, faces = grid(1, 1)
    np.testing.assert_allclose(area_normals(2 * points, faces), [[0, 0, 4], [0, 0, 4]])


def test_slivers_have_no_normal() -> None:
    apex = np.array([[0.5, 1e-3, 0], [0.5, 1e-5, 0]])
    points = np.concatenate([[[0.0, 0, 0], [1, 0, 0]], apex])
    np.testing.assert_allclose(
        area_normals(points, np.array([[0, 1, 2], [0, 1, 3], [0, 0, 1], [1, 1, 1]])),
        np.diag([0, 0, 1e-3, 0])[[2, 0, 0, 0], :3],
    )


def test_unit_vectors() -> None:
    np.testing.assert_allclose(
        normalise(np.array([[3.0, 0, 4], [0, 0, 0], [0, 1e-150, 0]])),
        [[0.6, 0.0, 0.8], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    )


def test_vectors_across_are_perpendicular_and_those_of_opposites() -> None:
    directions = np.concatenate([np.eye(3), np.random.default_rng(0).normal(size=(50, 3)), np.zeros((1, 3))])
    found = perpendicular(directions)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(np.sum(found * directions, axis=1), 0, atol=1e-14)
    np.testing.assert_array_equal(perpendicular(-directions), found)


def test_vertices_of_a_tetrahedron_look_outwards() -> None:
    points, faces = tetrahedron()
    normals = vertex_normals(points, faces, topology_of((points, faces)).edges.astype(np.int64))
    np.testing.assert_allclose(normals, points / np.sqrt(3), atol=1e-14)


def test_vertices_without_a_normal_ask_their_neighbours_and_theirs() -> None:
    """A triangle with area, and a chain of flat ones, out along its side; and a piece with none."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [9, 9, 9], [9, 9, 8]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 3, 4], [3, 4, 5], [6, 7, 7]])
    normals = vertex_normals(points, faces, topology_of((points, faces)).edges.astype(np.int64))
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 6 + [[0, 0, 0]] * 2)


@settings(max_examples=10, deadline=None)
@given(motion=rigid_motions)
def test_opposite_faces_cancel_and_chance_has_no_say(motion: tuple[Float, Float]) -> None:
    """A sheet whose two sides coincide, but for one corner that leaves it."""
    turn, shift = motion
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, -0.5, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0], [1, 0, 4]])
    moved = points @ turn.T + shift
    normals = vertex_normals(moved, faces, topology_of((points, faces)).edges.astype(np.int64))
    np.testing.assert_allclose(normals, np.tile(turn @ [0, 0, 1.0], (5, 1)), atol=1e-12)


# Triangles with a fourth vertex, and those that stand in for triangles without area

CORNERS = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [6, 0, 0], [1, 1, 1]])


def matrices_of(faces: list[list[int]]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    index = np.array(faces)
    return triangle_matrices(CORNERS, index, topology_of((CORNERS, index)).edges.astype(np.int64))


def test_the_fourth_vertex_grows_with_the_triangle() -> None:
    (matrix,) = matrices_of([[0, 1, 2]])
    np.testing.assert_allclose(matrix, np.diag([2.0, 3.0, np.sqrt(6)]), atol=1e-15)
    triangle = np.array([[0, 1, 2]])
    larger = triangle_matrices(5 * CORNERS, triangle, triangle[:, :2])
    np.testing.assert_allclose(larger[0], 5 * matrix)


def test_a_flat_triangle_asks_its_neighbour() -> None:
    _, flat = matrices_of([[0, 2, 1], [0, 1, 3]])
    np.testing.assert_allclose(flat, [[2.0, 6.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -0.06]], atol=1e-15)
    (alone,) = matrices_of([[0, 1, 3]])
    np.testing.assert_allclose(alone[:, 2], [0.0, 0.06, 0.0])


def test_stand_ins_are_equilateral_on_the_longest_side() -> None:
    matrices = matrices_of([[0, 1, 2], [1, 0, 3], [4, 4, 4], [0, 2, 2]])
    found = replace_degenerate(matrices)
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
    found = replace_degenerate(np.zeros((2, 3, 3)))
    np.testing.assert_allclose(np.linalg.norm(found[:, :, :2], axis=1), 1)
    np.testing.assert_allclose(np.linalg.det(found), np.sqrt(0.75) ** 1.5)
