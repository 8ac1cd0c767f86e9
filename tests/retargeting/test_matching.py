"""Matching of a registered source, its quality, and completion of maps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.retargeting.correspond import (
    CorrespondenceQuality,
    Matches,
    assess,
    from_barycentric,
    from_triangles,
    from_vertices,
    match,
)
from mixseq.retargeting.markers import Correspondence, Markers, pair_components
from tests.meshes import Mesh, grid, joined, pages, tetrahedron, torus, tube
from tests.retargeting.pairs import subdivided, surface


def matched(source: Mesh, target: Mesh, pairs: list[tuple[int, int]]) -> Matches:
    """Match meshes that lie on each other."""
    markers = Markers.from_pairs(pairs)
    start, goal = surface(source), surface(target)
    return match(start, goal, pair_components(start.topology, goal.topology, markers))


def test_a_mesh_matches_itself() -> None:
    mesh = tube(8, 12)
    found = matched(mesh, mesh, [(0, 0)]).correspondence
    places = np.take_along_axis(found.corners, found.weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    assert np.array_equal(places, np.arange(len(mesh[0])))
    np.testing.assert_allclose(found.weights.max(axis=1), 1.0, atol=1e-9)
    assert np.array_equal(found.faces, np.arange(len(mesh[1])))
    assert np.array_equal(found.leaders, np.arange(len(mesh[0])))


def test_a_subdivided_mesh_matches_the_triangles_it_was_cut_from() -> None:
    mesh = tube(8, 12)
    fine = subdivided(mesh)
    found = matched(mesh, fine, [(0, 0)]).correspondence
    assert np.array_equal(found.faces, np.repeat(np.arange(len(mesh[1])), 4))
    np.testing.assert_allclose(found.interpolate(mesh[0][None])[0], fine[0], atol=1e-12)


def test_touching_sides_are_separated_by_normals() -> None:
    """Two sheets of one folded strip, a hair apart, that come to lie on the wrong side of each other."""
    points, faces = grid(20, 4)
    y = points[:, 1]

    def folded(gap: float) -> Mesh:
        turn = np.pi / 4
        up = np.where(y <= 8, 0.0, np.where(y >= 12, gap, gap * (1 - np.cos((y - 8) * turn)) / 2))
        along = np.where(y <= 8, y, np.where(y >= 12, 20 - y, 8 + np.sin((y - 8) * turn)))
        return np.stack([points[:, 0], along, up], axis=1), faces

    target = folded(0.05)
    found = matched((folded(0.05)[0] - [0, 0, 0.06], faces), target, [(0, 0)]).correspondence
    before = np.tile(y[:, None], (1, 3))
    carried = found.interpolate(before[None])[0, :, 0]
    straight = (y < 7) | (y > 13)
    np.testing.assert_allclose(carried[straight], y[straight], atol=0.5)


def test_unmatched_vertices_are_filled_along_the_surface() -> None:
    """A bump on the target, higher than matches reach."""
    source = grid(12, 12)
    points = source[0].copy()
    middle = (np.abs(points[:, :2] - 6) <= 1).all(axis=1)
    points[middle, 2] = 5.0
    result = matched(source, (points, source[1]), [(0, 0)])
    found = result.correspondence
    assert np.array_equal(result.has_vertex_match, ~middle)
    assert found.matched.all()
    assert (found.faces >= 0).all()
    assert np.array_equal(found.leaders, np.arange(len(points)))
    carried = found.interpolate(source[0][None])[0]
    assert np.abs(carried - source[0])[:, :2].max() <= 2.0 + 1e-9
    assert np.isinf(result.distances[middle]).all()


def test_a_component_without_a_marker_follows_one_vertex() -> None:
    body, hat = tube(8, 12), tube(5, 4, length=0.2, radius=0.1)
    placed = hat[0] + [0, 0, 4.2]
    found = matched(body, joined(body, (placed, hat[1])), [(0, 0)]).correspondence
    own = np.arange(len(body[0]), len(body[0]) + len(hat[0]))
    assert (found.corners[own] == -1).all()
    assert set(found.leaders[own]) == {97}  # the cap's middle
    assert (found.faces[len(body[1]) :] == -1).all()
    assert (found.faces[: len(body[1])] >= 0).all()
    np.testing.assert_array_equal(found.interpolate(body[0][None])[0, own], np.tile(body[0][97], (len(own), 1)))


def test_unused_vertices_follow() -> None:
    mesh = tube(8, 12)
    lone = np.concatenate([mesh[0], [[0.0, 0.0, 9.0]]]), mesh[1]
    found = matched(mesh, lone, [(0, 0)]).correspondence
    assert found.leaders[-1] == 97


def test_components_match_only_those_that_share_a_marker() -> None:
    inner, outer = tube(8, 12, radius=0.5), tube(8, 12, radius=0.52)
    count = len(inner[0])
    source = joined(inner, outer)
    target = joined(outer, inner)  # each lies on the other
    found = matched(source, target, [(0, 0), (count, count)]).correspondence
    assert (found.corners[:count] < count).all()
    assert (found.corners[count:] >= count).all()


def test_a_distant_component_matches_at_any_distance() -> None:
    mesh = tube(8, 12)
    away = mesh[0] + [50.0, 0, 0]
    result = matched(mesh, (away, mesh[1]), [(0, 0)])
    assert not result.has_vertex_match.any()
    assert result.correspondence.matched.all()
    assert (result.correspondence.faces >= 0).all()


# Quality --------------------------------------------------------------------------------------------------


def quality(source: Mesh, target: Mesh, markers: Markers) -> CorrespondenceQuality:
    """Of meshes that lie on each other."""
    start, goal = surface(source), surface(target)
    pairings = pair_components(start.topology, goal.topology, markers)
    return assess(start, goal, pairings, markers, match(start, goal, pairings))


def test_quality_of_a_mesh_on_itself_is_perfect() -> None:
    mesh = tube(8, 12)
    found = quality(mesh, mesh, Markers.from_pairs([(0, 0), (50, 50)]))
    assert found.source_coverage == pytest.approx(1.0)
    assert found.target_coverage == pytest.approx(1.0)
    assert found.largest_distance < 1e-12
    counts = found.flipped_count, found.filled_vertex_count, found.filled_face_count, found.follower_count
    assert counts == (0, 0, 0, 0)
    assert found.marker_distances.max() == 0


def test_distances_are_in_diagonals_of_the_target() -> None:
    sheet = grid(3, 4)
    lifted = sheet[0] + [0, 0, 0.1]
    found = quality((lifted, sheet[1]), sheet, Markers.from_pairs([(0, 0)]))
    assert (found.mean_distance, found.p99_distance, found.largest_distance) == pytest.approx((0.02, 0.02, 0.02))
    assert found.marker_distances == pytest.approx([0.02])


def test_distances_without_matches_are_infinite() -> None:
    sheet = grid(3, 4)
    away = sheet[0] + [0, 0, 50.0]
    found = quality((away, sheet[1]), sheet, Markers.from_pairs([(0, 0)]))
    assert (found.source_coverage, found.target_coverage) == (0, 0)
    assert (found.mean_distance, found.p99_distance, found.largest_distance) == (np.inf, np.inf, np.inf)


def test_half_a_source_covers_half() -> None:
    sheet = grid(10, 10)
    half = sheet[0][:, 0].max() / 2
    left = sheet[1][(sheet[0][sheet[1]][:, :, 0] <= half + 1e-9).all(axis=1)]
    far = sheet[0] * [3.0, 1.0, 1.0]  # so that a third of the target's area, and a little more, is reached
    assert quality(sheet, (sheet[0], left), Markers.from_pairs([(0, 0)])).source_coverage == pytest.approx(
        0.5, abs=0.11
    )
    assert quality(sheet, (far, sheet[1]), Markers.from_pairs([(0, 0)])).target_coverage == pytest.approx(
        1 / 3, abs=0.1
    )


def test_followers_are_counted_and_lower_the_coverage() -> None:
    body, hat = tube(8, 12), tube(8, 12)
    found = quality(body, joined(body, (hat[0] + [3.0, 0, 0], hat[1])), Markers.from_pairs([(0, 0)]))
    assert found.follower_count == 1
    assert found.target_coverage == pytest.approx(0.5)
    assert found.source_coverage == pytest.approx(1.0)


def test_vertices_in_no_triangle_are_no_followers() -> None:
    points, faces = tube(8, 12)
    stray = np.concatenate([points, [[9.0, 0, 0]]])
    assert quality((points, faces), (stray, faces), Markers.from_pairs([(0, 0)])).follower_count == 0


def test_flipped_faces_are_counted() -> None:
    sheet = grid(6, 6)
    faces = sheet[1].copy()
    faces[0] = faces[0, ::-1]
    found = quality(sheet, (sheet[0], faces), Markers.from_pairs([(0, 0)]))
    assert found.flipped_count == 1
    assert found.filled_face_count == 1


def test_the_worst_marker_is_found() -> None:
    mesh = tube(8, 12)
    markers = Markers.from_pairs([(0, 0), (1, 3), (2, 2)], ("nose", "left ear", "tail"))
    found = quality(mesh, mesh, markers)
    assert found.worst_marker == 1
    gap = np.linalg.norm(mesh[0][1] - mesh[0][3]) / np.linalg.norm(np.ptp(mesh[0], axis=0))
    assert found.marker_distances == pytest.approx([0, gap, 0])


# Maps that somebody made become correspondences, complete and exact where they can be

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
        assert np.array_equal(found.interpolate(mesh[0]), mesh[0])
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
def test_renumbered_meshes_are_followed(name: str) -> None:
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
    assert np.array_equal(inner.interpolate(points)[shared], target[0][shared])
    assert np.linalg.norm(inner.interpolate(points) - target[0], axis=1).max() < 1.5


def test_a_finer_mesh_maps_to_its_parent_triangles() -> None:
    source = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0], [2, 2, 0]]), np.array([[0, 1, 2], [1, 3, 2]])
    target = grid(2, 2)
    corners = np.array([[0, 1, 2]] * 9)
    x, y = target[0][:, 0] / 2, target[0][:, 1] / 2
    weights = np.stack([1 - x - y, x, y], axis=1)
    found = from_barycentric(corners, weights, source, target)
    assert np.allclose(found.interpolate(source[0]), target[0], atol=1e-12)
    beyond = target[0][target[1]].mean(axis=1)[:, :2].sum(axis=1) - 2
    clear = np.abs(beyond) > 1e-9  # two triangles have their centres on the diagonal
    assert np.array_equal(found.faces[clear], (beyond > 0).astype(int)[clear])


def test_triangles_that_have_no_partner_find_the_closest() -> None:
    """A map of most triangles determines the corners of the remaining ones from their neighbours."""
    mesh = MESHES["torus"]
    given = np.arange(len(mesh[1]))
    given[::5] = -1
    found = from_triangles(given, mesh, mesh)
    assert found.matched.all()
    assert np.mean(found.faces == np.arange(len(mesh[1]))) > 0.95
    assert np.array_equal(found.faces[given >= 0], given[given >= 0])


def test_unmapped_vertices_follow() -> None:
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


def test_two_sides_of_a_sheet_stay_separate() -> None:
    """Where two surfaces touch, triangles go to the one that faces the same way."""
    points, faces = grid(3, 3)
    both = joined((points, faces), (points - [0, 0, 1e-3], faces[:, ::-1]))
    fine, fine_faces = grid(6, 6)
    nearest = np.array([np.linalg.norm(points - p / 2, axis=1).argmin() for p in fine])
    found = from_vertices(nearest + len(points), both, (fine / 2, fine_faces[:, ::-1]))
    assert (found.faces >= len(faces)).all()


def test_weights_are_normalised() -> None:
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
        (from_vertices, (MAP * 1.0,), "whole number for each is expected"),
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
