"""Maxima are as prominent as summits are, and the extremities of the fox are its tips."""

from __future__ import annotations

import numpy as np

from mixseq.retargeting.suggestions import CoarseSurface, Extremities, far_apart, maxima, mean_distance
from mixseq.types import Float
from tests.meshes import grid, topology_of
from tests.retargeting.foxes import Fox, short, tall

TIPS = {"tail4", "nose", *(f"{where}paw.{side}" for where in ("fore", "hind") for side in "lr")}
EARS = {"ear.l", "ear.r"}


def surface_of(fox: Fox) -> CoarseSurface:
    return CoarseSurface.of(fox.points, fox.topology)


def test_maxima_of_two_hills() -> None:
    points, faces = grid(30, 30)
    low, high = points.min(axis=0), points.max(axis=0)

    def hill(at: tuple[float, float], height: float) -> Float:
        place = low[:2] + np.array(at) * (high - low)[:2]
        away = np.linalg.norm(points[:, :2] - place, axis=1) / (high - low)[0]
        return np.asarray(height * np.maximum(1 - away / 0.3, 0))

    surface = CoarseSurface.of(points, topology_of((points, faces)))
    values = np.maximum(hill((0.2, 0.2), 3.0), hill((0.75, 0.75), 2.0))
    vertices, prominences = maxima(values, surface)
    np.testing.assert_allclose(prominences[:2], [values.max(), values[vertices[1]]])  # a plain between them
    assert values[vertices[0]] == values.max()
    assert np.linalg.norm(points[vertices[1], :2] - (low + 0.75 * (high - low))[:2]) < 0.06 * (high - low)[0]

    raised = np.maximum(values, 1.5)  # a plateau, from which the hills rise
    assert np.allclose(maxima(raised, surface)[1][1], values[vertices[1]] - 1.5)


def test_samples_are_far_from_each_other() -> None:
    surface = surface_of(short())
    samples, distances = far_apart(surface, 20)
    apart = distances[:, samples] + np.diag(np.full(20, np.inf))
    rest = distances.min(axis=0)
    assert apart.min() >= rest.max() - 1e-9


def test_the_mean_distance_is_least_in_the_trunk() -> None:
    fox = short()
    values = mean_distance(surface_of(fox))
    assert fox.bones[int(values.argmin())] in {"pelvis", "belly", "chest"}


def test_extremities_of_the_fox() -> None:
    for fox in (short(), tall()):
        found = Extremities.of(surface_of(fox))
        names = [fox.bones[vertex] for vertex in found.vertices]
        assert set(names[:6]) == TIPS
        assert set(names[6:8]) == EARS
        assert (np.diff(found.prominences) <= 0).all()
        np.testing.assert_allclose(found.distances, found.distances.T, atol=1e-9)
