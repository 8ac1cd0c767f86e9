"""Triangles from lengths, their frames, and how frames of neighbours stand to each other."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.mesh.measures import dihedral_angles, edge_lengths
from mixseq.mesh.rotations import product, quaternions, rotations_of
from mixseq.shells.face_frames import Hinges, flat_triangles, frames_of
from tests.meshes import Mesh, flipped, grid, pages, rotation, topology_of, torus, tube

MESHES: list[Mesh] = [
    tube(6, 9),
    torus(9, 6),
    grid(5, 5),
    pages(3, 5, 3),
    (tube(6, 9)[0], flipped(tube(6, 9)[1])),
    (
        tube(5, 6)[0],
        np.where(np.arange(len(tube(5, 6)[1]))[:, None] % 3, tube(5, 6)[1], tube(5, 6)[1][:, ::-1]),
    ),
]


@given(st.lists(st.floats(0.1, 10.0), min_size=3, max_size=3))
def test_sides_have_their_lengths_where_there_is_a_triangle(sides: list[float]) -> None:
    lengths = np.array(sides)
    (flat,) = flat_triangles(lengths[None])
    found = np.linalg.norm(np.roll(flat, -1, axis=0) - flat, axis=1)
    np.testing.assert_allclose(found[[0, 2]], lengths[[0, 2]], rtol=1e-9)
    if 2 * lengths.max() < lengths.sum():
        np.testing.assert_allclose(found, lengths, rtol=1e-6)
    else:
        assert flat[2, 1] == pytest.approx(0.0, abs=1e-6)


def test_frames_turn_with_triangles() -> None:
    rng = np.random.default_rng(3)
    x, faces = rng.normal(size=(40, 3)), np.arange(39).reshape(-1, 3)
    turn = rotation((0.3, -2.0, 1.0))
    turned = product(quaternions(turn), frames_of(x, faces))
    same = np.abs((turned * frames_of(x @ turn.T, faces)).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-12)
    sides = x[faces[:, 1]] - x[faces[:, 0]]
    along = rotations_of(frames_of(x, faces))[:, :, 0]
    np.testing.assert_allclose(along * np.linalg.norm(sides, axis=1)[:, None], sides, atol=1e-12)


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0, 0]] * 3,
        [[0, 0, 0], [1, 1, 1], [2, 2, 2]],
        [[0, 0, 0], [0, 0, 0], [1, 0, 0]],
        [[1, 2, 3], [1, 2, 4], [1, 2, 3]],
    ],
)
def test_triangles_without_area_have_frames(corners: list[list[int]]) -> None:
    (frame,) = frames_of(np.array(corners, dtype=np.float64), np.array([[0, 1, 2]]))
    assert np.linalg.norm(frame) == pytest.approx(1.0)
    matrix = rotations_of(frame)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("mesh", MESHES)
def test_frames_differ_by_what_lengths_and_angles_tell(mesh: Mesh) -> None:
    topology = topology_of(mesh)
    x = mesh[0] + 0.05 * np.random.default_rng(1).normal(size=mesh[0].shape)
    flat = flat_triangles(edge_lengths(x, topology.edges)[topology.face_edges])
    turns = Hinges(topology.faces, topology.hinges, topology.hinge_faces).turns(
        flat, dihedral_angles(x, topology.hinges)
    )
    frames = frames_of(x, topology.faces)
    expected = product(frames[topology.hinge_faces[:, 0]], turns)
    same = np.abs((expected * frames[topology.hinge_faces[:, 1]]).sum(axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-10)
