"""Diffusion, against the heat kernel of small meshes, which is a matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.distance import cdist

from mixseq.mesh.topology import Topology
from mixseq.segmentation import silhouettes
from mixseq.segmentation.silhouettes import Diffusion
from tests.meshes import Mesh, grid, joined, rotation, tetrahedron, topology_of, torus, tube


def on(mesh: Mesh) -> Diffusion:
    return Diffusion(mesh[0], topology_of(mesh))


def test_areas_add_up() -> None:
    assert on(grid(3, 5)).areas.sum() == pytest.approx(15.0)
    assert on(tetrahedron()).areas == pytest.approx(
        [np.sqrt(3.0) * 2.0] * 4
    )  # a third of three faces of 2 sqrt(3)


def test_cotangents_of_a_regular_tetrahedron() -> None:
    """Both angles opposite an edge are 60 degrees."""
    expected = (np.eye(4) * 4 - 1) / np.sqrt(3.0)
    np.testing.assert_allclose(on(tetrahedron()).laplacian.toarray(), expected, atol=1e-12)


@pytest.mark.parametrize("mesh", [grid(6, 4), tube(7, 9), torus(9, 6)])
def test_smoothing_keeps_the_mean_and_the_bounds(mesh: Mesh) -> None:
    surface = on(mesh)
    values = np.random.default_rng(3).uniform(-1, 2, len(mesh[0]))
    smooth = surface.smoothed(values, 0.7)
    assert surface.areas @ smooth == pytest.approx(surface.areas @ values)
    assert values.min() < smooth.min() < smooth.max() < values.max()
    assert np.ptp(surface.smoothed(values, 2.0)) < np.ptp(smooth)
    np.testing.assert_array_equal(surface.smoothed(values, 0.0), values)
    np.testing.assert_allclose(surface.smoothed(np.full(len(values), 3.0), 0.7), 3.0)


def test_smoothing_does_not_cross_from_one_component_to_another() -> None:
    values = np.zeros(8)
    values[:4] = 1.0
    np.testing.assert_allclose(on(joined(tetrahedron(), tetrahedron())).smoothed(values, 5.0), values)


def test_distances_are_those_of_the_heat_kernel() -> None:
    """With K = exp(-t M^-1 L) M^-1, d_t(v, w)^2 = K_2t(v, v) + K_2t(w, w) - 2 K_2t(v, w)."""
    surface, time = on(tube(5, 6)), 0.13
    kernel = expm(-2 * time * surface.laplacian.toarray() / surface.areas[:, None]) / surface.areas
    squared = np.diag(kernel)[:, None] + np.diag(kernel) - 2 * kernel
    places = surface.embedding(time, len(surface.areas) - 1)
    np.testing.assert_allclose(cdist(places, places) ** 2, squared, atol=1e-10)


def test_the_sparse_solver_finds_the_same_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = on(torus(24, 10))  # a symmetric mesh: most eigenvalues are double
    dense = surface.embedding(0.3, 40)
    monkeypatch.setattr(silhouettes, "_DENSE", 0)
    sparse = surface.embedding(0.3, 40)
    assert not np.allclose(dense, sparse)  # other bases ...
    np.testing.assert_allclose(cdist(sparse, sparse), cdist(dense, dense), atol=1e-6)  # ... same distances


def test_distances_depend_on_the_shape_only() -> None:
    points, faces = tube(6, 8)
    order = np.random.default_rng(1).permutation(len(points))
    place = np.argsort(order)
    turned = Diffusion(points[order] @ rotation((1.0, 2.0, 0.5)).T + 3.0, Topology(place[faces], len(points)))
    one = Diffusion(points, Topology(faces, len(points))).embedding(0.2, 30)
    other = turned.embedding(0.2, 30)[place]
    np.testing.assert_allclose(cdist(one, one), cdist(other, other), atol=1e-5)


def test_components_are_embedded_one_by_one() -> None:
    alone = on(tube(5, 6)).embedding(0.1, 12)
    both = on(joined(tube(5, 6), tetrahedron())).embedding(0.1, 12)
    np.testing.assert_allclose(cdist(both[:32], both[:32]), cdist(alone, alone), atol=1e-9)
    assert (both[32:, 3:] == 0.0).all()  # four vertices have three eigenvectors
    assert np.ptp(cdist(both[32:], both[32:])[np.triu_indices(4, 1)]) < 1e-9


def test_flat_faces_and_lone_vertices_are_no_trouble() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0], [9, 9, 9]])
    surface = Diffusion(points, Topology(np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3]]), 5))
    assert np.isfinite(surface.laplacian.toarray()).all()
    assert np.isfinite(surface.smoothed(np.arange(5.0), 0.5)).all()
    assert np.isfinite(surface.embedding(0.1, 3)).all()


def test_faces_on_a_line_have_equal_areas() -> None:
    points, faces = grid(3, 2)
    surface = Diffusion(points * [1.0, 0.0, 0.0], Topology(faces, len(points)))
    assert np.ptp(surface.areas) == 0.0 < surface.areas[0]
    assert np.isfinite(surface.smoothed(points[:, 0], 0.5)).all()
    assert np.isfinite(surface.embedding(0.1, 3)).all()
