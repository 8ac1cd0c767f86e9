"""Variations of angles and lengths, against meshes that bend by known amounts."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.segmentation.silhouettes import (
    angle_variation,
    length_variation,
    some_frames,
    vertex_bending,
    vertex_strain,
)
from mixseq.types import Float
from tests.meshes import bar, bending, grid, rotation, topology_of, tube

SQUARE = Topology(np.array([[0, 1, 2], [1, 0, 3]]), 4)


def folded(angles: list[float]) -> Float:
    """Two triangles that share the edge from (0, 0, 0) to (1, 0, 0), folded about it."""
    return np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -np.cos(t), np.sin(t)]] for t in angles])


@pytest.mark.parametrize(
    ("angles", "largest"),
    [([0.3], 0.0), ([0.0, 0.5, 0.2], 0.5), ([-0.4, 0.1, 0.9], 1.3), ([3.0, -3.0], 2 * np.pi - 6.0)],
)
def test_largest_change_between_any_two_frames(angles: list[float], largest: float) -> None:
    assert angle_variation(folded(angles), SQUARE) == pytest.approx([largest], abs=1e-12)


def test_a_wheel_of_angles_varies_by_half_a_turn_at_most() -> None:
    assert angle_variation(folded([0.0, 2.0, 4.0]), SQUARE) == pytest.approx([2 * np.pi - 4.0])


def test_rigid_motion_deforms_nothing() -> None:
    points, faces = tube(7, 9)
    topology = Topology(faces, len(points))
    moved = np.stack([points, points @ rotation((0.3, 2.0, -1.0)).T + [4.0, -2, 1]])
    assert angle_variation(moved, topology).max() < 1e-12
    assert length_variation(moved, topology).max() < 1e-12
    assert vertex_bending(moved, topology).max() < 1e-12
    assert vertex_strain(moved, topology).max() < 1e-12


def test_stretching_strains_all_vertices_alike() -> None:
    mesh = grid(4, 3)
    stretched = np.stack([mesh[0], 1.5 * mesh[0], 1.2 * mesh[0]])
    np.testing.assert_allclose(vertex_strain(stretched, topology_of(mesh)), 0.5)
    np.testing.assert_allclose(vertex_bending(stretched, topology_of(mesh)), 0.0, atol=1e-12)


def test_a_bar_bends_in_the_middle_only() -> None:
    mesh = tube(8, 25)
    bends = vertex_bending(bending(mesh, wobble=0.0), topology_of(mesh))
    z = mesh[0][:, 2]
    assert bends[np.abs(z - 2.0) > 0.8].max() < 1e-9  # bones blend over 0.8 about z = 2
    assert bends[np.abs(z - 2.0) < 0.3].min() > 0.02


def test_vertices_of_no_face_do_not_deform() -> None:
    topology = Topology(SQUARE.faces, 6)
    points = np.concatenate([folded([0.0, 1.0]), np.zeros((2, 2, 3))], axis=1)
    assert vertex_bending(points, topology)[4:].tolist() == [0.0, 0.0]
    assert vertex_strain(points, topology)[4:].tolist() == [0.0, 0.0]


def test_frames_are_spread_and_in_diagonals() -> None:
    points = 7.0 + 20.0 * bar(frames=30).points
    some = some_frames(points, 4)
    assert some.shape == (4, *points.shape[1:])
    assert np.linalg.norm(np.ptp(some[0], axis=0)) == pytest.approx(1.0)
    np.testing.assert_allclose(
        some[-1] - some[0], (points[-1] - points[0]) / np.linalg.norm(np.ptp(points[0], axis=0))
    )


def test_a_first_frame_that_is_a_point_has_no_diagonal() -> None:
    points = np.array([[[5.0, 5, 5]] * 2, [[0, 0, 0], [3, 4, 0]], [[0, 0, 0], [0, 0, 1]]])
    np.testing.assert_allclose(np.linalg.norm(np.ptp(some_frames(points, 9), axis=1), axis=1), [0, 1, 0.2])
    assert np.ptp(some_frames(points[:1], 9)) == 0.0
