"""Meshes that go through themselves."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest

from mixseq.errors import InvalidSequenceError
from mixseq.mesh.nearest import self_intersections
from mixseq.types import Index
from tests.meshes import Mesh, grid, joined, rotation, tetrahedron, torus, tube

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
@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("scale", [1.0, 1e-5, 1e7])
def test_pairs(name: str, turn: int, scale: float) -> None:
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
    wide, thin = (
        tube(4, 2, length=4, radius=2, closed=False),
        tube(sides, 2, length=8, radius=0.1, closed=False),
    )
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


@pytest.mark.parametrize(
    "mesh", [tetrahedron(), torus(20, 12), tube(9, 20), grid(9, 9)], ids=lambda _: "mesh"
)
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


def test_meshes_that_are_refused() -> None:
    points = np.zeros((3, 3))
    with pytest.raises(InvalidSequenceError, match="triangle 1 is of vertices"):
        self_intersections(points, np.array([[0, 1, 2], [0, 1, -1]]))
    with pytest.raises(InvalidSequenceError, match="not finite"):
        self_intersections(points * np.nan, np.array([[0, 1, 2]]))
