"""Closest points on meshes."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from numpy.typing import NDArray
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist
from trimesh.proximity import closest_point_naive

from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.box_tree import unit_normals
from mixseq.mesh.nearest import (
    Attachments,
    ClosestPointQuery,
    ClosestPoints,
    attach_pieces,
    intersect_ray,
    self_intersections,
)
from mixseq.types import Float, Index
from tests.meshes import Mesh, grid, joined, rigid_motions, rotation, seeds, tetrahedron, torus, tube

RIGHT: Mesh = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])


def places(mesh: Mesh, found: ClosestPoints) -> Float:
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
    each = [ClosestPointQuery.from_mesh(points, face[None]).query(queries).distances for face in faces]
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
    found = ClosestPointQuery.from_mesh(RIGHT[0], np.roll(RIGHT[1], turn, axis=1)).query(np.array([query]))
    assert found.faces.tolist() == [0]
    np.testing.assert_allclose(np.roll(found.weights[0], -turn), weights, atol=1e-15)
    np.testing.assert_allclose(found.distances, [distance], rtol=1e-15)


def test_points_inside_a_tetrahedron() -> None:
    mesh = tetrahedron()
    found = ClosestPointQuery.from_mesh(*mesh).query(np.array([[0.0, 0, 0], [3, 3, 3], [-0.1, -0.1, -0.1]]))
    np.testing.assert_allclose(found.distances, [1 / np.sqrt(3), 2 * np.sqrt(3), 1 / np.sqrt(3) - 0.1 * np.sqrt(3)])
    assert found.faces[1] == 0  # of the three around the corner the first
    np.testing.assert_allclose(found.weights[1], [1, 0, 0])
    assert found.faces[2] == 3  # opposite (1, 1, 1)
    np.testing.assert_allclose(found.weights[2], 1 / 3)


@pytest.mark.parametrize("count", [1, 2, 4, 5, 9, 150])
def test_as_triangle_by_triangle(count: int) -> None:
    rng = np.random.default_rng(count)
    mesh = soup(count, count)
    queries = np.concatenate([1.5 * rng.normal(size=(200, 3)), mesh[0][:50], mesh[0][mesh[1]].mean(axis=1)[:50]])
    found = ClosestPointQuery.from_mesh(*mesh).query(queries)
    faces, distances = one_by_one(mesh, queries, np.ones((count, 1), dtype=bool))
    np.testing.assert_array_equal(found.faces, faces)
    np.testing.assert_array_equal(found.distances, distances)
    assert (found.weights >= 0).all() and (found.weights <= 1).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(places(mesh, found) - queries, axis=1), distances, atol=1e-14)


@pytest.mark.parametrize("mesh", [torus(12, 8), tube(7, 9), tetrahedron()], ids=["torus", "tube", "tetrahedron"])
def test_trimesh_finds_the_same(mesh: Mesh) -> None:
    queries = 2 * np.random.default_rng(7).normal(size=(50, 3)) * np.abs(mesh[0]).max()
    found = ClosestPointQuery.from_mesh(*mesh).query(queries)
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
    found = ClosestPointQuery.from_mesh(*mesh).query(queries, normals, angle)
    faces, distances = one_by_one(mesh, queries, cosines >= np.cos(np.radians(angle)) - 1e-12)
    np.testing.assert_array_equal(found.faces, faces)
    np.testing.assert_array_equal(found.distances, distances)
    assert (found.faces[:20] >= 0).all()
    assert (found.faces < 0).any() == (angle < 90)
    limit = float(np.median(distances))  # a distance itself is within it
    near = ClosestPointQuery.from_mesh(*mesh).query(queries, normals, angle, limit)
    np.testing.assert_array_equal(near.faces, np.where(distances <= limit, faces, -1))
    np.testing.assert_array_equal(near.distances, np.where(distances <= limit, distances, np.inf))
    np.testing.assert_array_equal(near.weights[near.faces >= 0], found.weights[near.faces >= 0])


def test_both_sides_of_a_thin_sheet() -> None:
    sheet, faces = grid(4, 4)
    mesh = joined((sheet, faces), (sheet - np.array([0, 0, 0.01]), faces[:, ::-1]))
    queries = np.tile([[1.3, 2.6, -1.0]], (3, 1))
    found = ClosestPointQuery.from_mesh(*mesh).query(queries, np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, 0]]))
    np.testing.assert_allclose(found.distances, [1.0, 0.99, np.inf])
    assert found.faces[0] < len(faces) <= found.faces[1]
    assert found.faces[2] == -1 and (found.weights[2] == 0).all()


@pytest.mark.parametrize("mesh", [torus(12, 8), tube(7, 9)], ids=["torus", "tube"])
def test_ties_go_to_the_first_triangle(mesh: Mesh) -> None:
    points, faces = mesh
    sides = faces[:, [1, 2, 0]]
    queries = np.concatenate([points, (0.25 * points[faces] + 0.75 * points[sides]).reshape(-1, 3)])
    queries = queries + 1e-3 * np.sign(queries)
    normal = ClosestPointQuery.from_mesh(*mesh).query(queries)
    last = ClosestPointQuery.from_mesh(points, faces[::-1]).query(queries)
    np.testing.assert_array_equal(normal.distances, last.distances)
    assert (normal.faces <= len(faces) - 1 - last.faces).all()
    assert (normal.faces < len(faces) - 1 - last.faces).any()


def test_motions_and_scales_change_nothing() -> None:
    rng = np.random.default_rng(4)
    points, faces = torus(30, 16)
    queries = 2 * rng.normal(size=(300, 3))
    found = ClosestPointQuery.from_mesh(points, faces).query(queries)
    turn = rotation((0.3, -1.0, 2.0))
    for scale, shift in ((1e-6, 0.0), (1e6, 0.0), (1.0, 100.0)):
        moved = ClosestPointQuery.from_mesh(scale * points @ turn.T + shift, faces).query(
            scale * queries @ turn.T + shift
        )
        np.testing.assert_allclose(moved.distances, scale * found.distances, rtol=1e-9, atol=1e-12 * scale)
        assert (moved.faces == found.faces).mean() > 0.9  # the others are ties


def test_an_empty_mesh_and_no_queries() -> None:
    none = ClosestPointQuery.from_mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    found = none.query(np.zeros((2, 3)))
    assert found.faces.tolist() == [-1, -1] and np.isinf(found.distances).all() and not found.weights.any()
    found = ClosestPointQuery.from_mesh(*RIGHT).query(np.empty((0, 3)), np.empty((0, 3)))
    assert found.faces.shape == (0,) and found.weights.shape == (0, 3)


def test_meshes_that_are_refused() -> None:
    points, faces = RIGHT
    with pytest.raises(InvalidSequenceError, match=r"triangle 0 has vertices \[0, 1, 3\], but there are 3 points"):
        ClosestPointQuery.from_mesh(points, np.array([[0, 1, 3]]))
    with pytest.raises(InvalidSequenceError, match="triangle 0 has a corner that is not finite"):
        ClosestPointQuery.from_mesh(np.where(points == 1, np.nan, points), faces)
    with pytest.raises(InvalidSequenceError, match=r"faces of shape \(1, 4\) are not a triangle mesh"):
        ClosestPointQuery.from_mesh(points, np.array([[0, 1, 2, 0]]))


def test_queries_that_are_refused() -> None:
    mesh = ClosestPointQuery.from_mesh(*RIGHT)
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


# What holds pieces of a mesh together


def pieces_of(sizes: list[int]) -> list[Index]:
    return np.split(np.arange(sum(sizes)), np.cumsum(sizes)[:-1])


def rows(found: Attachments) -> list[tuple[int, int, int, int]]:
    columns = (found.pieces, found.vertices, found.holder_vertices, found.holders)
    return list(zip(*(column.tolist() for column in columns), strict=True))


# Vertices on the x axis: a long body, and beads in a chain away from it.
CHAIN = np.array([[0.0], [10.0], [13.0], [13.5], [11.0], [11.5], [15.0]]) * [1.0, 0.0, 0.0]


def test_a_chain_is_held_one_by_one() -> None:
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    found = attach_pieces(pieces, CHAIN, np.arange(7))
    assert found.root == 0
    assert rows(found) == [(2, 4, 1, 0), (1, 2, 5, 2), (3, 6, 3, 1)]
    assert len(found) == 3


def test_the_largest_piece_is_the_root_wherever_it_is_listed() -> None:
    pieces = [np.array([6]), np.array([2, 3]), np.array([0, 1]), np.array([4, 5])]
    found = attach_pieces(pieces, CHAIN, np.arange(7))
    assert found.root == 2
    assert rows(found) == [(3, 4, 1, 2), (1, 2, 5, 3), (0, 6, 3, 1)]


def test_followers_are_held_by_their_leaders_and_never_the_root() -> None:
    leaders = np.arange(7)
    leaders[[0, 1]] = 6  # the longest piece follows the last vertex
    leaders[[4, 5]] = 2
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    found = attach_pieces(pieces, CHAIN, leaders)
    assert found.root == 1
    # By their vertices nearest to the leader; after the piece that it is on.
    assert rows(found) == [(3, 6, 3, 1), (0, 1, 6, 3), (2, 5, 2, 1)]


def test_a_piece_that_follows_in_part_is_free() -> None:
    leaders = np.arange(7)
    leaders[5] = 4
    pieces = [np.array([0, 1]), np.array([2, 3]), np.array([4, 5]), np.array([6])]
    assert rows(attach_pieces(pieces, CHAIN, leaders))[0] == (2, 4, 1, 0)


def test_one_piece_needs_nothing() -> None:
    found = attach_pieces([np.arange(7)], CHAIN, np.arange(7))
    assert (found.root, len(found)) == (0, 0)
    assert found.vertices.dtype == np.int64


def test_pieces_that_share_a_vertex_are_held_there() -> None:
    found = attach_pieces([np.array([0, 1, 2]), np.array([2, 3, 4])], np.eye(5)[:, :3] * 9, np.arange(5))
    assert rows(found) == [(1, 2, 2, 0)]


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_attachments_are_as_short_as_can_be(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = pieces_of(rng.integers(1, 6, 8).tolist())
    owner = np.repeat(np.arange(8), [len(each) for each in pieces])
    points = rng.normal(size=(len(owner), 3)) + 4 * rng.normal(size=(8, 3))[owner]
    found = attach_pieces(pieces, points, np.arange(len(points)))
    lengths = np.linalg.norm(points[found.vertices] - points[found.holder_vertices], axis=1)
    apart = np.array([[cdist(points[a], points[b]).min() for a in pieces] for b in pieces])
    np.testing.assert_allclose(lengths.sum(), minimum_spanning_tree(apart).sum())
    assert np.array_equal(owner[found.vertices], found.pieces)
    assert np.array_equal(owner[found.holder_vertices], found.holders)
    before = [found.root]
    for piece, holder in zip(found.pieces.tolist(), found.holders.tolist(), strict=True):
        assert holder in before
        before.append(piece)
    assert sorted(before) == list(range(8))


# Meshes that go through themselves

Place = tuple[Fraction, ...]

FLOOR = [(0, 0, 0), (6, 0, 0), (0, 6, 0)]
OTHERS = {
    "pierces": ([(1, 1, -1), (1, 1, 1), (2, 1, 1)], True),
    "cuts a side": ([(-1, 1, -1), (3, 1, 1), (-1, 1, 1)], True),
    "one corner in the plane": ([(1, 1, 0), (3, 1, 1), (3, 1, -1)], True),
    "wider than the floor": ([(-9, 1, -9), (20, 1, -9), (0, 1, 20)], True),
    "stands on a corner": ([(1, 1, 0), (3, 1, 1), (1, 1, 1)], False),
    "stands on a side": ([(1, 1, 0), (3, 1, 0), (1, 1, 1)], False),
    "corner on a side": ([(3, 0, 0), (3, -2, 1), (3, -2, -1)], False),
    "sides touch": ([(3, 0, -1), (3, 0, 1), (3, -2, 0)], False),
    "in the same plane": ([(1, 1, 0), (3, 1, 0), (1, 3, 0)], False),
    "parallel": ([(1, 1, 1), (3, 1, 1), (1, 3, 1)], False),
    "beside it on the common line": ([(-3, 1, -1), (-1, 1, 1), (-3, 1, 1)], False),
    "above": ([(1, 1, 1), (3, 1, 1), (1, 1, 2)], False),
    "a segment": ([(1, 1, -1), (1, 1, 1), (1, 1, 3)], False),
    "a point": ([(1, 1, 0), (1, 1, 0), (1, 1, 0)], False),
    "a common corner": ([(0, 0, 0), (2, 2, 1), (2, 2, -1)], False),
}


@pytest.mark.parametrize("name", OTHERS)
def test_pairs(name: str) -> None:
    for scale in [1.0, 1e-5, 1e7]:
        for turn in range(3):
            other, cross = OTHERS[name]
            points = scale * np.array(FLOOR + other, dtype=np.float64)
            faces = np.array([np.roll([0, 1, 2], turn), np.roll([5, 4, 3], turn)])
            for shown in (faces, faces[::-1], faces[:, ::-1]):
                assert self_intersections(points, shown).tolist() == ([[0, 1]] if cross else [])


@pytest.mark.parametrize("sides", [3, 8, 41])
def test_a_tube_through_a_floor(sides: int) -> None:
    floor = np.array([[-9.0, -5, 1.9], [9, -5, 1.9], [0, 9, 1.9]]), np.array([[0, 1, 2]])
    pairs = self_intersections(*joined(floor, tube(sides, 2, closed=False)))
    assert pairs.dtype == np.int64
    assert pairs.tolist() == [[0, k] for k in range(1, 2 * sides + 1)]


def crossing_tubes(sides: int) -> Mesh:
    """A thin tube through two opposite walls, and through one triangle of each, of a wide one with four walls."""
    turn = rotation((0, 0, np.pi / 4))  # walls face x and y
    wide, thin = (tube(4, 2, length=4, radius=2, closed=False), tube(sides, 2, length=8, radius=0.1, closed=False))
    moved = thin[0][:, [2, 0, 1]] + [-4, 0.5, 1.0]
    return joined((wide[0] @ turn.T, wide[1]), (moved, thin[1]))


@pytest.mark.parametrize("sides", [4, 9])
def test_crossing_tubes(sides: int) -> None:
    assert len(self_intersections(*crossing_tubes(sides))) == 4 * sides


def test_more_pairs_than_triangles() -> None:
    one = np.array([(0.0, 0, 0), (9, 0, 0), (0, 9, 0)]), np.array([[0, 1, 2]])
    floors = [(one[0] + [0, 0, 0.01 * k], one[1]) for k in range(12)]
    walls = [(one[0][:, [0, 2, 1]] + [0.5, 0.1 * k + 0.5, -1], one[1]) for k in range(10)]
    pairs = self_intersections(*joined(*floors, *walls))
    assert pairs.tolist() == [[i, 12 + j] for i in range(12) for j in range(10)]


@pytest.mark.parametrize("mesh", [tetrahedron(), torus(20, 12), tube(9, 20), grid(9, 9)], ids=lambda _: "mesh")
def test_sound_meshes_do_not_cross_themselves(mesh: Mesh) -> None:
    points, faces = mesh
    assert self_intersections(points, faces).shape == (0, 2)
    cut = points[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)  # every side a seam
    assert len(self_intersections(*cut)) == 0


def test_motions_change_nothing() -> None:
    points, faces = torus(24, 14)
    both = joined((points, faces), (points @ rotation((1.0, 0.3, 0)).T + [1.5, 0, 0], faces))
    pairs = self_intersections(*both)
    assert len(pairs) > 30
    moved = both[0] @ rotation((2.0, -1.0, 0.4)).T * 30 + [100, 0, -50]
    np.testing.assert_array_equal(self_intersections(moved, both[1]), pairs)


def exactly(points: Index, faces: Index) -> list[list[int]]:
    """All pairs of triangles with integer corners, in exact arithmetic: where sides of one meet the other."""

    def minus(p: Place, q: Place) -> Place:
        return tuple(a - b for a, b in zip(p, q, strict=True))

    def cross(p: Place, q: Place) -> Place:
        return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]

    def dot(p: Place, q: Place) -> Fraction:
        return sum((a * b for a, b in zip(p, q, strict=True)), Fraction(0))

    def meets(f: list[Place], g: list[Place]) -> set[Place] | None:
        """Where sides of f meet g; None if f is not on both sides of g."""
        normal = cross(minus(g[1], g[0]), minus(g[2], g[0]))
        heights = [dot(normal, minus(p, g[0])) for p in f]
        if not min(heights) < 0 < max(heights):
            return None
        found = set()
        for k in range(3):
            p, q, d, e = f[k], f[k - 1], heights[k], heights[k - 1]
            if d * e <= 0:
                x = tuple(a + (b - a) * d / (d - e) for a, b in zip(p, q, strict=True))
                if all(dot(normal, cross(minus(g[i], g[i - 1]), minus(x, g[i - 1]))) >= 0 for i in range(3)):
                    found.add(x)
        return found

    corners = [[tuple(Fraction(int(x)) for x in points[v]) for v in face] for face in faces]
    pairs = []
    for i, j in combinations(range(len(faces)), 2):
        if not set(corners[i]) & set(corners[j]):
            first, second = meets(corners[i], corners[j]), meets(corners[j], corners[i])
            if first is not None and second is not None and len(first | second) > 1:
                pairs.append([i, j])
    return pairs


@pytest.mark.parametrize(("size", "seed"), [(3, 0), (4, 1), (6, 2), (50, 3)])
def test_as_in_exact_arithmetic(size: int, seed: int) -> None:
    """On small lattices contact, common planes, common corners and flat triangles are frequent."""
    rng = np.random.default_rng(seed)
    points, faces = rng.integers(0, size, (120, 3)), np.arange(120).reshape(-1, 3)
    pairs = exactly(points, faces)
    assert len(pairs) > 20
    assert self_intersections(points.astype(np.float64), faces).tolist() == pairs
    places, number = np.unique(points, axis=0, return_inverse=True)
    turned = places @ rotation((0.3, 0.7, -2.0)).T + [5, 0, 100]  # rounded, and still contact is contact
    assert self_intersections(turned, number.reshape(-1, 3)).tolist() == pairs


def test_an_empty_mesh() -> None:
    nothing = self_intersections(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    assert nothing.shape == (0, 2)
    assert nothing.dtype == np.int64


def test_meshes_without_intersections_to_look_for_are_refused() -> None:
    points = np.zeros((3, 3))
    with pytest.raises(InvalidSequenceError, match="triangle 1 has vertices"):
        self_intersections(points, np.array([[0, 1, 2], [0, 1, -1]]))
    with pytest.raises(InvalidSequenceError, match="not finite"):
        self_intersections(points * np.nan, np.array([[0, 1, 2]]))


# Rays


@pytest.mark.parametrize(("place", "vertex"), [((0.1, 0.1), 0), ((0.8, 0.1), 1), ((0.1, 0.8), 2)])
@pytest.mark.parametrize("side", [3.0, -3.0])
def test_a_triangle_from_both_sides(place: tuple[float, float], vertex: int, side: float) -> None:
    found = intersect_ray(*RIGHT, origin=[*place, side], direction=[0, 0, -np.sign(side)])
    assert found == (0, vertex, 3.0)


def test_the_distance_is_in_lengths_of_the_direction() -> None:
    found = intersect_ray(*RIGHT, origin=[0.2, 0.2, 3], direction=[0, 0, -0.5])
    assert found is not None
    assert found.distance == pytest.approx(6.0)


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ([0.6, 0.6, 3], [0, 0, -1]),  # next to it
        ([-0.1, 0.5, 3], [0, 0, -1]),
        ([0.2, 0.2, 3], [0, 0, 1]),  # away from it
        ([0.2, 0.2, 3], [1, 0, 0]),  # along it
        ([-1.0, 0.2, 0], [1, 0, 0]),  # in its plane
        ([0.2, 0.2, 3], [0, 0, 0]),
        ([0.2, 0.2, 3], [0, 0, -1e-310]),  # farther away than numbers go
        ([0.2, 0.2, 3], [np.nan, 0, 0]),
    ],
)
def test_misses(origin: list[float], direction: list[float]) -> None:
    assert intersect_ray(*RIGHT, origin=origin, direction=direction) is None


def test_the_first_of_several() -> None:
    sheet = grid(2, 2)
    stack = joined(sheet, (sheet[0] + [0, 0, 5.0], sheet[1]), (sheet[0] - [0, 0, 5.0], sheet[1]))
    above = intersect_ray(*stack, origin=[0.7, 0.2, 9], direction=[0, 0, -1])
    below = intersect_ray(*stack, origin=[0.7, 0.2, -9], direction=[0, 0, 1])
    between = intersect_ray(*stack, origin=[0.7, 0.2, 1], direction=[0, 0, -1])
    assert above is not None
    assert below is not None
    assert between is not None
    count = len(sheet[1])
    assert [found.face // count for found in (above, below, between)] == [1, 2, 0]
    assert [found.distance for found in (above, below, between)] == pytest.approx([4, 4, 1])
    assert stack[0][above.vertex].tolist() == [1, 0, 5]


@pytest.mark.parametrize("corners", [[0, 0, 0], [0, 0, 1], [0, 1, 3]], ids=["point", "edge", "line"])
def test_triangles_without_area_are_not_met(corners: list[int]) -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]])
    for origin in ([0.5, 0, 3], [0.0, 0, 3], [0.25, 0.25, 3]):
        assert intersect_ray(points, np.array([corners]), origin, [0, 0, -1]) is None
    found = intersect_ray(points, np.array([corners, [0, 1, 2]]), [0.25, 0.25, 3], [0, 0, -1])
    assert found is not None
    assert found.face == 1


def test_single_precision_and_numbers_of_any_kind() -> None:
    points, faces = RIGHT
    found = intersect_ray(points.astype(np.float32), faces.astype(np.uint32), (0.2, 0.2, 3), (0, 0, -1))
    assert found == (0, 0, 3.0)
    assert type(found.face) is type(found.vertex) is int


@given(seeds, rigid_motions)
def test_a_point_on_a_face_is_found_from_outside(
    seed: int, motion: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> None:
    rng = np.random.default_rng(seed)
    points, faces = tetrahedron()
    points = points @ motion[0].T + motion[1]
    face = int(rng.integers(len(faces)))
    weights = rng.dirichlet([2, 2, 2])
    assume(weights.min() > 1e-3)
    a, b, c = points[faces[face]]
    place = weights @ points[faces[face]]
    normal = np.cross(b - a, c - a)
    found = intersect_ray(points, faces, place + 2 * normal, -normal)
    assert found is not None
    assert (found.face, found.vertex) == (
        face,
        faces[face][np.linalg.norm(points[faces[face]] - place, axis=1).argmin()],
    )
    assert found.distance == pytest.approx(2.0)


def test_against_every_triangle_one_by_one() -> None:
    points, faces = torus(12, 7)
    rng = np.random.default_rng(5)
    hits = 0
    for origin, target in zip(6 * rng.normal(size=(60, 3)), rng.normal(size=(60, 3)), strict=True):
        along = target - origin
        distances = []
        for face in faces:
            a, b, c = points[face]
            # o + t d = a + u (b - a) + v (c - a)
            t, u, v = np.linalg.solve(np.stack([-along, b - a, c - a], axis=1), origin - a)
            distances.append(t if min(u, v, t) >= 0 and u + v <= 1 else np.inf)
        found = intersect_ray(points, faces, origin, along)
        assert (found is None) == np.isinf(min(distances))
        if found is not None:
            hits += 1
            assert found.face == int(np.argmin(distances))
            assert found.distance == pytest.approx(min(distances))
    assert 10 < hits < 60
