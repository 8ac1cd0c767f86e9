"""Geometry of a triangle mesh in one pose."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from tests.meshes import grid, joined, tetrahedron, topology_of


def test_the_diagonal_is_of_the_triangles() -> None:
    points, faces = grid(3, 4)
    stray = np.concatenate([points, [[1e6, 0, 0]]])
    assert TriangleMesh(stray, Topology(faces, len(stray))).diagonal == pytest.approx(5.0)


def test_areas_and_normals() -> None:
    points, faces = grid(3, 4)
    sheet = TriangleMesh(points, Topology(np.concatenate([faces, [[0, 1, 1]]]), len(points)))
    assert sheet.vertex_areas.sum() == pytest.approx(12.0)
    assert sheet.edge_areas.sum() == pytest.approx(12.0)
    np.testing.assert_allclose(sheet.vertex_normals, np.tile([0.0, 0, 1], (len(points), 1)), atol=1e-15)
    assert sheet.face_normals[-1].tolist() == [0, 0, 0]


def test_components_attach_to_one_nearest_vertex() -> None:
    """All vertices of a component get the same vertex; an unused vertex is a component of its own."""
    small = tetrahedron()[0] / 10
    right, above = (small + np.array(offset) for offset in ([3, 0, 0], [0, 4, 0]))
    points, faces = joined(grid(2, 2), (right, tetrahedron()[1]), (above, tetrahedron()[1]))
    points = np.concatenate([points, [[1.1, 1.2, 0.5]]])
    mesh = TriangleMesh(points, Topology(faces, len(points)))
    lost = np.arange(9, 18)
    assert mesh.nearest_by_component(lost, np.arange(9)).tolist() == [2] * 4 + [6] * 4 + [4]
    assert mesh.nearest_by_component(lost[:0], np.arange(9)).tolist() == []


def test_of_equal_vertices_the_lowest_decides() -> None:
    points = np.array([[0.0, 0, 0], [9, 0, 0], [0, 1, 0], [9, 1, 0], [4, 1, 0]])
    mesh = TriangleMesh(points, topology_of((points, np.array([[2, 3, 4]]))))
    assert mesh.nearest_by_component(np.array([2, 3, 4]), np.array([1, 0])).tolist() == [0, 0, 0]
