"""Bodies: distances along coarse surfaces, prominences of maxima, and the tips of the fox."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.bodies import CoarseBody, CoarseSurface, find_maxima
from mixseq.types import Float
from tests.meshes import grid, joined, rotation, topology_of, tube
from tests.retargeting.foxes import short, tall

TIPS = {"tail4", "nose", *(f"{where}paw.{side}" for where in ("fore", "hind") for side in "lr")}
WHOLE = 2500
"""More vertices than these meshes have."""


def test_maxima_of_two_hills() -> None:
    points, faces = grid(30, 30)
    low, high = points.min(axis=0), points.max(axis=0)

    def hill(at: tuple[float, float], height: float) -> Float:
        place = low[:2] + np.array(at) * (high - low)[:2]
        away = np.linalg.norm(points[:, :2] - place, axis=1) / (high - low)[0]
        return np.asarray(height * np.maximum(1 - away / 0.3, 0))

    surface = CoarseSurface.from_mesh(points, topology_of((points, faces)), WHOLE)
    values = np.maximum(hill((0.2, 0.2), 3.0), hill((0.75, 0.75), 2.0))
    vertices, prominences = find_maxima(values, surface)
    np.testing.assert_allclose(prominences[:2], [values.max(), values[vertices[1]]])  # a plain between them
    assert values[vertices[0]] == values.max()
    assert np.linalg.norm(points[vertices[1], :2] - (low + 0.75 * (high - low))[:2]) < 0.06 * (high - low)[0]

    raised = np.maximum(values, 1.5)  # a plateau, from which the hills rise
    assert np.allclose(find_maxima(raised, surface)[1][1], values[vertices[1]] - 1.5)


def test_tips_of_the_fox() -> None:
    for fox in (short(), tall()):
        body = CoarseBody.from_poses(fox.points[None], fox.topology, 700, np.zeros(0, np.int64))
        assert {fox.bones[vertex] for vertex in body.surface.vertices[body.tips]} == TIPS
        assert fox.bones[body.surface.vertices[body.mean_distances.argmin()]] in {"pelvis", "belly", "chest"}


# Coarse surfaces have the area one, and distances along them are those of the plane where it is one


def test_distances_in_a_plane() -> None:
    mesh = grid(20, 20)
    surface = CoarseSurface.from_mesh(mesh[0], topology_of(mesh), WHOLE)
    straight = np.linalg.norm(surface.points[:, None] - surface.points, axis=2)
    along = surface.distances(np.arange(len(mesh[0])))
    assert (along >= straight - 1e-9).all()
    assert (along <= 1.09 * straight + 1e-9).all()  # edges and both diagonals: 1.082 where it is worst


def test_distances_around_a_tube() -> None:
    mesh = tube(24, 30, closed=False)
    surface = CoarseSurface.from_mesh(mesh[0], topology_of(mesh), WHOLE)
    half = np.pi * 0.5 / surface.size  # radius 0.5
    across = surface.distances(np.array([0]))[0, 12]
    assert across == pytest.approx(half, rel=0.01)


def test_coarse_surface_has_unit_area() -> None:
    fox = short()
    surface = CoarseSurface.from_mesh(fox.points, fox.topology, WHOLE)
    moved = CoarseSurface.from_mesh(30 * fox.points @ rotation((1.0, 0.3, 0.2)).T + 7, fox.topology, WHOLE)
    assert surface.mesh.face_areas.sum() == pytest.approx(1)
    assert moved.size == pytest.approx(30 * surface.size)
    own, other = (each.distances(np.array([3])) for each in (surface, moved))
    np.testing.assert_allclose(own, other, atol=1e-9)
    np.testing.assert_allclose(surface.centre + surface.size * surface.points, fox.points, atol=1e-12)


def test_the_largest_component_is_decimated() -> None:
    small, large = tube(6, 5), tube(12, 40, length=9.0, radius=1.0)
    mesh = joined(small, large)
    surface = CoarseSurface.from_mesh(mesh[0], topology_of(mesh), 200)
    assert surface.vertices.min() >= len(small[0])
    assert 150 <= len(surface.vertices) <= 200
    assert np.isfinite(surface.distances(np.array([0]))).all()


def test_meshes_without_area_are_refused() -> None:
    mesh = np.zeros((3, 3)), np.array([[0, 1, 2]])
    with pytest.raises(SettingsError, match="no triangle of the mesh has an area"):
        CoarseSurface.from_mesh(mesh[0], topology_of(mesh), WHOLE)
