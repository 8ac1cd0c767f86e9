"""Coarse surfaces have the area one, and distances along them are those of the plane where it is one."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.suggestions import CoarseSurface
from tests.meshes import grid, joined, rotation, topology_of, tube
from tests.retargeting.foxes import short


def test_distances_in_a_plane() -> None:
    mesh = grid(20, 20)
    surface = CoarseSurface.of(mesh[0], topology_of(mesh))
    straight = np.linalg.norm(surface.points[:, None] - surface.points, axis=2)
    along = surface.distances(np.arange(len(mesh[0])))
    assert (along >= straight - 1e-9).all()
    assert (along <= 1.09 * straight + 1e-9).all()  # edges and both diagonals: 1.082 where it is worst


def test_distances_around_a_tube() -> None:
    mesh = tube(24, 30, closed=False)
    surface = CoarseSurface.of(mesh[0], topology_of(mesh))
    half = np.pi * 0.5 / surface.size  # radius 0.5
    across = surface.distances(np.array([0]))[0, 12]
    assert across == pytest.approx(half, rel=0.01)


def test_its_unit_is_that_of_the_area() -> None:
    fox = short()
    surface = CoarseSurface.of(fox.points, fox.topology)
    moved = CoarseSurface.of(30 * fox.points @ rotation((1.0, 0.3, 0.2)).T + 7, fox.topology)
    assert surface.mesh.face_areas.sum() == pytest.approx(1)
    assert moved.size == pytest.approx(30 * surface.size)
    own, other = (each.distances(np.array([3])) for each in (surface, moved))
    np.testing.assert_allclose(own, other, atol=1e-9)
    np.testing.assert_allclose(surface.centre + surface.size * surface.points, fox.points, atol=1e-12)


def test_the_largest_component_is_thinned_out() -> None:
    small, large = tube(6, 5), tube(12, 40, length=9.0, radius=1.0)
    mesh = joined(small, large)
    surface = CoarseSurface.of(mesh[0], topology_of(mesh), 200)
    assert surface.vertices.min() >= len(small[0])
    assert 150 <= len(surface.vertices) <= 200
    assert np.isfinite(surface.distances(np.array([0]))).all()


def test_no_area() -> None:
    mesh = np.zeros((3, 3)), np.array([[0, 1, 2]])
    with pytest.raises(SettingsError, match="no triangle of the mesh has an area"):
        CoarseSurface.of(mesh[0], topology_of(mesh))
