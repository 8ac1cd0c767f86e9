"""Normals that every face and vertex has."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings

from mixseq.mesh.triangle_mesh import across, face_normals, unit, vertex_normals
from mixseq.types import Float
from tests.meshes import grid, rigid_motions, tetrahedron, topology_of


def test_normals_of_faces_are_twice_as_long_as_areas() -> None:
    points, faces = grid(1, 1)
    np.testing.assert_allclose(face_normals(2 * points, faces), [[0, 0, 4], [0, 0, 4]])


def test_slivers_have_no_normal() -> None:
    apex = np.array([[0.5, 1e-3, 0], [0.5, 1e-5, 0]])
    points = np.concatenate([[[0.0, 0, 0], [1, 0, 0]], apex])
    np.testing.assert_allclose(
        face_normals(points, np.array([[0, 1, 2], [0, 1, 3], [0, 0, 1], [1, 1, 1]])),
        np.diag([0, 0, 1e-3, 0])[[2, 0, 0, 0], :3],
    )


def test_unit_vectors() -> None:
    np.testing.assert_allclose(
        unit(np.array([[3.0, 0, 4], [0, 0, 0], [0, 1e-150, 0]])),
        [[0.6, 0.0, 0.8], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
    )


def test_vectors_across_are_perpendicular_and_those_of_opposites() -> None:
    directions = np.concatenate([np.eye(3), np.random.default_rng(0).normal(size=(50, 3)), np.zeros((1, 3))])
    found = across(directions)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(np.sum(found * directions, axis=1), 0, atol=1e-14)
    np.testing.assert_array_equal(across(-directions), found)


def test_vertices_of_a_tetrahedron_look_outwards() -> None:
    points, faces = tetrahedron()
    normals = vertex_normals(points, faces, topology_of((points, faces)).edges)
    np.testing.assert_allclose(normals, points / np.sqrt(3), atol=1e-14)


def test_vertices_without_a_normal_ask_their_neighbours_and_theirs() -> None:
    """A triangle with area, and a chain of flat ones, out along its side; and a piece with none."""
    points = np.array(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [9, 9, 9], [9, 9, 8]]
    )
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 3, 4], [3, 4, 5], [6, 7, 7]])
    normals = vertex_normals(points, faces, topology_of((points, faces)).edges)
    np.testing.assert_allclose(normals, [[0, 0, 1]] * 6 + [[0, 0, 0]] * 2)


@settings(max_examples=10, deadline=None)
@given(motion=rigid_motions)
def test_opposite_faces_cancel_and_chance_has_no_say(motion: tuple[Float, Float]) -> None:
    """A sheet whose two sides coincide, but for one corner that leaves it."""
    turn, shift = motion
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, -0.5, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0], [1, 0, 4]])
    moved = points @ turn.T + shift
    normals = vertex_normals(moved, faces, topology_of((points, faces)).edges)
    np.testing.assert_allclose(normals, np.tile(turn @ [0, 0, 1.0], (5, 1)), atol=1e-12)
