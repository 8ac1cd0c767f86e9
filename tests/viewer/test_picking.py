"""What is under the pointer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from numpy.typing import NDArray

from mixseq.viewer.session import pick
from tests.meshes import grid, joined, rigid_motions, seeds, tetrahedron, torus

TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])


@pytest.mark.parametrize(("place", "vertex"), [((0.1, 0.1), 0), ((0.8, 0.1), 1), ((0.1, 0.8), 2)])
@pytest.mark.parametrize("side", [3.0, -3.0])
def test_a_triangle_from_both_sides(place: tuple[float, float], vertex: int, side: float) -> None:
    found = pick(*TRIANGLE, origin=[*place, side], direction=[0, 0, -np.sign(side)])
    assert found == (0, vertex, 3.0)


def test_the_distance_is_in_lengths_of_the_direction() -> None:
    found = pick(*TRIANGLE, origin=[0.2, 0.2, 3], direction=[0, 0, -0.5])
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
    assert pick(*TRIANGLE, origin=origin, direction=direction) is None


def test_the_first_of_several() -> None:
    sheet = grid(2, 2)
    stack = joined(sheet, (sheet[0] + [0, 0, 5.0], sheet[1]), (sheet[0] - [0, 0, 5.0], sheet[1]))
    above = pick(*stack, origin=[0.7, 0.2, 9], direction=[0, 0, -1])
    below = pick(*stack, origin=[0.7, 0.2, -9], direction=[0, 0, 1])
    between = pick(*stack, origin=[0.7, 0.2, 1], direction=[0, 0, -1])
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
        assert pick(points, np.array([corners]), origin, [0, 0, -1]) is None
    found = pick(points, np.array([corners, [0, 1, 2]]), [0.25, 0.25, 3], [0, 0, -1])
    assert found is not None
    assert found.face == 1


def test_single_precision_and_numbers_of_any_kind() -> None:
    points, faces = TRIANGLE
    found = pick(points.astype(np.float32), faces.astype(np.uint32), (0.2, 0.2, 3), (0, 0, -1))
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
    found = pick(points, faces, place + 2 * normal, -normal)
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
        found = pick(points, faces, origin, along)
        assert (found is None) == np.isinf(min(distances))
        if found is not None:
            hits += 1
            assert found.face == int(np.argmin(distances))
            assert found.distance == pytest.approx(min(distances))
    assert 10 < hits < 60
