"""Closest points on meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from trimesh.proximity import closest_point_naive

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.box_tree import unit_normals
from mixseq.mesh.nearest import Found, Nearest
from mixseq.types import Float, Index
from tests.meshes import Mesh, grid, joined, rotation, tetrahedron, torus, tube

RIGHT: Mesh = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])


def places(mesh: Mesh, found: Found) -> Float:
    points, faces = mesh
    return np.asarray(np.einsum("nk,nki->ni", found.weights, points[faces[found.faces]]))


def soup(seed: int, count: int) -> Mesh:
    """Triangles anywhere, some of them needles, segments, points, and twins of others."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + 0.3 * rng.normal(size=(count, 3, 3))
    kind = rng.integers(0, 8, count)
    at = rng.random((count, 1))
    between = (1 - at) * corners[:, 0] + at * corners[:, 1]
    corners[kind == 0, 2] = between[kind == 0]  # segments, but for rounding
    corners[kind == 1, 2] = corners[kind == 1, 1]
    corners[kind == 2, 1:] = corners[kind == 2, :1]
    corners[kind == 3, 2] = between[kind == 3] + 1e-7 * rng.normal(size=(3,))
    twins = np.flatnonzero(kind == 4)
    corners[twins] = corners[twins[::-1]]
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(count, 3)


def one_by_one(mesh: Mesh, queries: Float, allowed: NDArray[np.bool_]) -> tuple[Index, Float]:
    """Ask every triangle alone, as a mesh of its own, in its place: the first of the closest."""
    points, faces = mesh
    each = [Nearest.of(points, face[None]).query(queries).distances for face in faces]
    distances = np.where(allowed, np.stack(each), np.inf)
    best = distances.argmin(axis=0)
    least = distances.min(axis=0)
    return np.where(np.isfinite(least), best, -1), least


@pytest.mark.parametrize(
    ("query", "weights", "distance"),
    [
        ((0.25, 0.25, 2.0), (0.5, 0.25, 0.25), 2.0),
        ((0.25, 0.5, 0.0), (0.25, 0.25, 0.5), 0.0),
        ((-3.0, -4.0, 0.0), (1, 0, 0), 5.0),
        ((2.0, 0.0, -1.0), (0, 1, 0), np.sqrt(2)),
        ((0.0, 3.0, 0.0), (0, 0, 1), 2.0),
        ((0.25, -1.0, 0.0), (0.75, 0.25, 0), 1.0),
        ((-2.0, 0.5, 0.0), (0.5, 0, 0.5), 2.0),
        ((1.0, 1.0, 0.0), (0, 0.5, 0.5), np.sqrt(0.5)),
    ],
)
@pytest.mark.parametrize("turn", [0, 1, 2])
def test_regions_of_a_triangle(
    query: tuple[float, ...], weights: tuple[float, ...], distance: float, turn: int
) -> None:
    found = Nearest.of(RIGHT[0], np.roll(RIGHT[1], turn, axis=1)).query(np.array([query]))
    assert found.faces.tolist() == [0]
    np.testing.assert_allclose(np.roll(found.weights[0], -turn), weights, atol=1e-15)
    np.testing.assert_allclose(found.distances, [distance], rtol=1e-15)


def test_points_inside_a_tetrahedron() -> None:
    mesh = tetrahedron()
    found = Nearest.of(*mesh).query(np.array([[0.0, 0, 0], [3, 3, 3], [-0.1, -0.1, -0.1]]))
    np.testing.assert_allclose(
        found.distances, [1 / np.sqrt(3), 2 * np.sqrt(3), 1 / np.sqrt(3) - 0.1 * np.sqrt(3)]
    )
    assert found.faces[1] == 0  # of the three around the corner the first
    np.testing.assert_allclose(found.weights[1], [1, 0, 0])
    assert found.faces[2] == 3  # opposite (1, 1, 1)
    np.testing.assert_allclose(found.weights[2], 1 / 3)


@pytest.mark.parametrize("count", [1, 2, 4, 5, 9, 150])
def test_as_triangle_by_triangle(count: int) -> None:
    rng = np.random.default_rng(count)
    mesh = soup(count, count)
    queries = np.concatenate(
        [1.5 * rng.normal(size=(200, 3)), mesh[0][:50], mesh[0][mesh[1]].mean(axis=1)[:50]]
    )
    found = Nearest.of(*mesh).query(queries)
    faces, distances = one_by_one(mesh, queries, np.ones((count, 1), dtype=bool))
    np.testing.assert_array_equal(found.faces, faces)
    np.testing.assert_array_equal(found.distances, distances)
    assert (found.weights >= 0).all() and (found.weights <= 1).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(places(mesh, found) - queries, axis=1), distances, atol=1e-14)


@pytest.mark.parametrize(
    "mesh", [torus(12, 8), tube(7, 9), tetrahedron()], ids=["torus", "tube", "tetrahedron"]
)
def test_trimesh_finds_the_same(mesh: Mesh) -> None:
    queries = 2 * np.random.default_rng(7).normal(size=(50, 3)) * np.abs(mesh[0]).max()
    found = Nearest.of(*mesh).query(queries)
    points, distances, _ = closest_point_naive(trimesh.Trimesh(*mesh, process=False), queries)  # type: ignore[no-untyped-call]
    np.testing.assert_allclose(found.distances, distances, atol=1e-12)
    np.testing.assert_allclose(places(mesh, found), points, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 20.0, 90.0, 180.0])
def test_only_triangles_that_face_the_same_way(angle: float) -> None:
    rng = np.random.default_rng(1)
    mesh = soup(5, 120)
    queries, normals = rng.normal(size=(150, 3)), 3 * rng.normal(size=(150, 3))
    own = unit_normals(mesh[0][mesh[1]])
    normals[:20] = own[np.isfinite(own[:, 0])][:20]
    cosines = own @ (normals / np.linalg.norm(normals, axis=1, keepdims=True)).T
    assert np.isnan(own).any()
    found = Nearest.of(*mesh).query(queries, normals, angle)
    faces, distances = one_by_one(mesh, queries, cosines >= np.cos(np.radians(angle)) - 1e-12)
    np.testing.assert_array_equal(found.faces, faces)
    np.testing.assert_array_equal(found.distances, distances)
    assert (found.faces[:20] >= 0).all()
    assert (found.faces < 0).any() == (angle < 90)


def test_both_sides_of_a_thin_sheet() -> None:
    sheet, faces = grid(4, 4)
    mesh = joined((sheet, faces), (sheet - np.array([0, 0, 0.01]), faces[:, ::-1]))
    queries = np.tile([[1.3, 2.6, -1.0]], (3, 1))
    found = Nearest.of(*mesh).query(queries, np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, 0]]))
    np.testing.assert_allclose(found.distances, [1.0, 0.99, np.inf])
    assert found.faces[0] < len(faces) <= found.faces[1]
    assert found.faces[2] == -1 and (found.weights[2] == 0).all()


@pytest.mark.parametrize("mesh", [torus(12, 8), tube(7, 9)], ids=["torus", "tube"])
def test_ties_go_to_the_first_triangle(mesh: Mesh) -> None:
    points, faces = mesh
    sides = faces[:, [1, 2, 0]]
    queries = np.concatenate([points, (0.25 * points[faces] + 0.75 * points[sides]).reshape(-1, 3)])
    queries = queries + 1e-3 * np.sign(queries)
    normal = Nearest.of(*mesh).query(queries)
    last = Nearest.of(points, faces[::-1]).query(queries)
    np.testing.assert_array_equal(normal.distances, last.distances)
    assert (normal.faces <= len(faces) - 1 - last.faces).all()
    assert (normal.faces < len(faces) - 1 - last.faces).any()


def test_motions_and_scales_change_nothing() -> None:
    rng = np.random.default_rng(4)
    points, faces = torus(30, 16)
    queries = 2 * rng.normal(size=(300, 3))
    found = Nearest.of(points, faces).query(queries)
    turn = rotation((0.3, -1.0, 2.0))
    for scale, shift in ((1e-6, 0.0), (1e6, 0.0), (1.0, 100.0)):
        moved = Nearest.of(scale * points @ turn.T + shift, faces).query(scale * queries @ turn.T + shift)
        np.testing.assert_allclose(moved.distances, scale * found.distances, rtol=1e-9, atol=1e-12 * scale)
        assert (moved.faces == found.faces).mean() > 0.9  # the others are ties


def test_an_empty_mesh_and_no_queries() -> None:
    none = Nearest.of(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    found = none.query(np.zeros((2, 3)))
    assert found.faces.tolist() == [-1, -1] and np.isinf(found.distances).all() and not found.weights.any()
    found = Nearest.of(*RIGHT).query(np.empty((0, 3)), np.empty((0, 3)))
    assert found.faces.shape == (0,) and found.weights.shape == (0, 3)


def test_meshes_that_are_refused() -> None:
    points, faces = RIGHT
    with pytest.raises(
        InvalidSequenceError, match=r"triangle 0 is of vertices \[0, 1, 3\], but there are 3 points"
    ):
        Nearest.of(points, np.array([[0, 1, 3]]))
    with pytest.raises(InvalidSequenceError, match="triangle 0 has a corner that is not finite"):
        Nearest.of(np.where(points == 1, np.nan, points), faces)
    with pytest.raises(InvalidSequenceError, match=r"faces of shape \(1, 4\) are no triangle mesh"):
        Nearest.of(points, np.array([[0, 1, 2, 0]]))


def test_queries_that_are_refused() -> None:
    mesh = Nearest.of(*RIGHT)
    one = np.zeros((1, 3))
    with pytest.raises(SettingsError, match=r"queries have the shape \(3,\)"):
        mesh.query(np.zeros(3))
    with pytest.raises(SettingsError, match=r"queries\[0\] is not finite"):
        mesh.query(one + np.inf)
    with pytest.raises(SettingsError, match=r"normals\[0\] is not finite"):
        mesh.query(one, one + np.nan)
    with pytest.raises(SettingsError, match="1 queries and 2 normals"):
        mesh.query(one, np.zeros((2, 3)))
    with pytest.raises(SettingsError, match="largest angle is 181"):
        mesh.query(one, one, 181)
