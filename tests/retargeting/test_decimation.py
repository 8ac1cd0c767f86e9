"""Decimation keeps original vertices, the topology, and nearly the surface."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.decimation import decimate
from mixseq.mesh.measures import signed_volume
from mixseq.mesh.topology import Topology
from tests.meshes import Mesh, grid, pages, tetrahedron, topology_of, torus, tube

MESHES = {"tube": tube(12, 40), "open tube": tube(12, 40, closed=False), "torus": torus(30, 16), "sheet": grid(20, 20)}


def euler(topology: Topology) -> int:
    return topology.vertex_count - len(topology.edges) + len(topology.faces)


def boundary_loops(topology: Topology) -> int:
    ends = topology.edges[topology.boundary_edges]
    return len(np.unique(ends)) - len(ends)


@pytest.mark.parametrize("name", MESHES)
def test_topology_is_preserved(name: str) -> None:
    points, faces = MESHES[name]
    count = len(points) // 8
    kept, coarse = decimate(points, faces, count)
    before, after = Topology(faces, len(points)), Topology(coarse, len(kept))
    assert len(kept) == count
    assert (np.diff(kept) > 0).all()
    assert after.unused_vertices.size == after.non_manifold_edges.size == after.inconsistent_edges.size == 0
    assert euler(after) == euler(before)
    assert after.component_count == 1
    assert boundary_loops(after) == boundary_loops(before) == 0
    assert bool(len(after.boundary_edges)) == bool(len(before.boundary_edges))


def test_decimation_preserves_shape() -> None:
    points, faces = torus(40, 20)
    kept, coarse = decimate(points, faces, 200)
    assert signed_volume(points[kept], coarse) == pytest.approx(signed_volume(points, faces), rel=0.05)
    points, faces = grid(20, 30)
    kept, coarse = decimate(points, faces, 40)
    x = points[kept]
    normals = np.cross(x[coarse[:, 1]] - x[coarse[:, 0]], x[coarse[:, 2]] - x[coarse[:, 0]])
    assert (normals[:, 2] > 0).all()
    assert normals[:, 2].sum() / 2 == pytest.approx(600.0)  # corners and borders stay


def test_decimation_stops_without_removable_vertices() -> None:
    points, faces = tetrahedron()
    kept, coarse = decimate(points, faces, 2)
    assert kept.tolist() == [0, 1, 2, 3]
    assert len(coarse) == 4
    kept, coarse = decimate(points, faces[:1], 1)
    assert kept.tolist() == [0, 1, 2]
    assert len(coarse) == 1


def test_spines_are_preserved() -> None:
    """Vertices of edges with three faces stay, and the pages stay with them."""
    mesh = pages(3, rows=16, columns=6)
    topology = topology_of(mesh)
    spine = np.unique(topology.edges[topology.non_manifold_edges])
    kept, coarse = decimate(*mesh, 40)
    after = Topology(coarse, len(kept))
    assert np.isin(spine, kept).all()
    assert len(after.non_manifold_edges) == len(topology.non_manifold_edges)
    assert after.component_of_face.max() == 0


def test_faces_with_repeated_corners_are_kept() -> None:
    points, faces = tube(8, 12)
    faces = np.concatenate([faces, [[3, 3, 4]]])
    kept, coarse = decimate(points, faces, 30)
    assert np.isin([3, 4], kept).all()
    assert (np.sort(kept[coarse], axis=1) == [3, 3, 4]).all(axis=1).any()


def test_decimation_is_deterministic(mesh: Mesh = MESHES["torus"]) -> None:
    first, second = decimate(*mesh, 50), decimate(*mesh, 50)
    assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
