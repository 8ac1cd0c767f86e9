"""Maps that somebody made become correspondences, complete and exact where they can be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.matching import from_barycentric, from_triangles, from_vertices
from tests.meshes import Mesh, grid, joined, pages, tetrahedron, torus, tube

MESHES = {
    "torus": torus(9, 6),
    "tube": tube(7, 5),
    "sheet": grid(4, 3),
    "pages": pages(),
    "two": joined(torus(9, 6), (tetrahedron()[0] + 5, tetrahedron()[1])),
}


def numbers(mesh: Mesh) -> tuple[int, int]:
    return len(mesh[0]), len(mesh[1])


@pytest.mark.parametrize("name", MESHES)
def test_identical_meshes_give_the_identity(name: str) -> None:
    mesh = MESHES[name]
    vertices, faces = numbers(mesh)
    for found in (
        from_vertices(np.arange(vertices), mesh, mesh),
        from_triangles(np.arange(faces), mesh, mesh),
        from_barycentric(*_corners(mesh), mesh, mesh),
    ):
        assert np.array_equal(found.carry(mesh[0]), mesh[0])
        assert found.faces.tolist() == list(range(faces))
        assert found.leaders.tolist() == list(range(vertices))
        found.check((vertices, faces), (vertices, faces))


def _corners(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Every vertex as a corner of the last triangle around it."""
    corners, weights = np.zeros((len(mesh[0]), 3), np.int64), np.zeros((len(mesh[0]), 3))
    for face in mesh[1]:
        for k, vertex in enumerate(face):
            corners[vertex], weights[vertex] = face, np.eye(3)[k]
    return corners, weights


@pytest.mark.parametrize("name", MESHES)
def test_other_numbers_of_the_same_mesh_are_followed(name: str) -> None:
    points, faces = MESHES[name]
    rng = np.random.default_rng(3)
    vertices, triangles = rng.permutation(len(points)), rng.permutation(len(faces))
    place = np.argsort(vertices)
    # The triangles of the target begin at other corners, too.
    target = points[vertices], np.roll(place[faces[triangles]], 1, axis=1)
    found = from_vertices(vertices, (points, faces), target)
    assert found.faces.tolist() == triangles.tolist()
    inner = from_triangles(triangles, (points, faces), target)
    # Two triangles around a vertex share two, and so do all three that meet in the end of a spine.
    shared = np.bincount(target[1].reshape(-1), minlength=len(points)) > (3 if name == "pages" else 2)
    assert np.array_equal(inner.carry(points)[shared], target[0][shared])
    assert np.linalg.norm(inner.carry(points) - target[0], axis=1).max() < 1.5


def test_a_finer_mesh_is_moved_by_the_triangles_that_it_is_on() -> None:
    source = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]]), np.array([[0, 1, 2], [1, 3, 2]])
    target = grid(2, 2)
    corners = np.array([[0, 1, 2]] * 9)
    x, y = target[0][:, 0] / 2, target[0][:, 1] / 2
    weights = np.stack([1 - x - y, x, y], axis=1)
    found = from_barycentric(corners, weights, source, target)
    assert np.allclose(found.carry(source[0]), target[0], atol=1e-12)
    beyond = target[0][target[1]].mean(axis=1)[:, :2].sum(axis=1) - 2
    clear = np.abs(beyond) > 1e-9  # two triangles have their centres on the diagonal
    assert np.array_equal(found.faces[clear], (beyond > 0).astype(int)[clear])


def test_triangles_that_have_no_partner_find_the_closest() -> None:
    """A map of most triangles: corners of the others are known from their neighbours."""
    mesh = MESHES["torus"]
    given = np.arange(len(mesh[1]))
    given[::5] = -1
    found = from_triangles(given, mesh, mesh)
    assert found.matched.all()
    assert np.mean(found.faces == np.arange(len(mesh[1]))) > 0.95
    assert np.array_equal(found.faces[given >= 0], given[given >= 0])


def test_what_is_left_out_follows() -> None:
    mesh = MESHES["two"]
    ring = len(torus(9, 6)[0])
    given = np.arange(len(mesh[0]))
    given[ring:] = -1
    given[7] = -1
    found = from_vertices(given, mesh, mesh)
    # A vertex of the ring follows the nearest of the ring; the tetrahedron follows one vertex as a whole.
    near = np.linalg.norm(mesh[0][:ring] - mesh[0][7], axis=1)
    near[7] = np.inf
    assert found.leaders[7] == near.argmin()
    assert len(np.unique(found.leaders[ring:])) == 1
    assert found.matched[found.leaders].all()
    lost = np.isin(mesh[1], [7, *range(ring, len(mesh[0]))]).any(axis=1)
    assert np.array_equal(found.faces < 0, lost)


def test_two_sides_of_a_sheet_keep_apart() -> None:
    """Where two surfaces touch, triangles go to the one that faces the same way."""
    points, faces = grid(3, 3)
    both = joined((points, faces), (points - [0, 0, 1e-3], faces[:, ::-1]))
    fine, fine_faces = grid(6, 6)
    nearest = np.array([np.linalg.norm(points - p / 2, axis=1).argmin() for p in fine])
    found = from_vertices(nearest + len(points), both, (fine / 2, fine_faces[:, ::-1]))
    assert (found.faces >= len(faces)).all()


def test_weights_are_made_to_add_to_one() -> None:
    mesh = tetrahedron()
    weights = np.full((4, 3), 0.3334)
    found = from_barycentric(np.array([[0, 1, 2]] * 4), weights, mesh, mesh)
    assert np.allclose(found.weights.sum(axis=1), 1, atol=1e-15)


MAP = np.arange(4)
CORNERS, WEIGHTS = np.array([[0, 1, 2]] * 4), np.full((4, 3), 1 / 3)


@pytest.mark.parametrize(
    ("make", "given", "message"),
    [
        (from_vertices, (MAP[:3],), r"shape \(3,\).*the target has 4 vertices"),
        (from_vertices, (MAP * 1.0,), "whole numbers are expected"),
        (from_vertices, (MAP + 1,), "entry 3 of the map is 4, but the source has 4.*count from 1"),
        (from_vertices, (MAP - 2,), "entry 0 of the map is -2"),
        (from_vertices, (np.full(4, -1),), "the map leaves out all vertices"),
        (from_triangles, (MAP + 5,), "the source has 4 .triangles., 0 to 3.*are not exchanged$"),
        (from_barycentric, (CORNERS, WEIGHTS[:2]), r"weights have shape \(2, 3\)"),
        (from_barycentric, (CORNERS, WEIGHTS * np.nan), "finite"),
        (from_barycentric, (CORNERS, WEIGHTS * 2), r"target vertex 0 add to 2; 1 is expected \(4 vertices\)"),
        (from_barycentric, (CORNERS[:2], WEIGHTS), "the target has 12 corners, three for each"),
    ],
)
def test_maps_of_other_meshes_are_refused(
    make: Callable[..., Correspondence], given: tuple[Any, ...], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        make(*given, tetrahedron(), tetrahedron())
