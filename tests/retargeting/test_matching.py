"""From a registered source to a correspondence, and what is reported of it."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Markers, pair_components
from mixseq.retargeting.matching import Matches, MatchingSettings, Quality, assess, match
from tests.meshes import Mesh, grid, joined, topology_of, tube


def surface(mesh: Mesh) -> TriangleMesh:
    return TriangleMesh(mesh[0], topology_of(mesh))


def matched(
    source: Mesh,
    target: Mesh,
    pairs: list[tuple[int, int]],
    settings: MatchingSettings | None = None,
) -> Matches:
    """Match meshes that lie on each other."""
    markers = Markers.of(pairs)
    start, goal = surface(source), surface(target)
    return match(start, goal, pair_components(start.topology, goal.topology, markers), settings)


def subdivided(mesh: Mesh) -> Mesh:
    """Every triangle cut into four; the points it had come first."""
    points, faces = mesh
    topology = topology_of(mesh)
    middle = len(points) + topology.face_edges  # of sides 01, 12, 20
    a, b, c = faces.T
    ab, bc, ca = middle.T
    cut = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([points, points[topology.edges].mean(axis=1)]), cut


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
    np.testing.assert_allclose(found.carry(mesh[0][None])[0], fine[0], atol=1e-12)


def test_sides_that_touch_are_told_apart_by_their_normals() -> None:
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
    carried = found.carry(before[None])[0, :, 0]
    straight = (y < 7) | (y > 13)
    np.testing.assert_allclose(carried[straight], y[straight], atol=0.5)


def test_what_finds_nothing_is_filled_along_the_surface() -> None:
    """A bump on the target, higher than matches reach."""
    source = grid(12, 12)
    points = source[0].copy()
    middle = (np.abs(points[:, :2] - 6) <= 1).all(axis=1)
    points[middle, 2] = 5.0
    result = matched(source, (points, source[1]), [(0, 0)])
    found = result.correspondence
    assert np.array_equal(result.found_vertices, ~middle)
    assert found.matched.all()
    assert (found.faces >= 0).all()
    assert np.array_equal(found.leaders, np.arange(len(points)))
    carried = found.carry(source[0][None])[0]
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
    np.testing.assert_array_equal(found.carry(body[0][None])[0, own], np.tile(body[0][97], (len(own), 1)))


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


def test_a_component_of_which_nothing_is_near_matches_all_the_same() -> None:
    mesh = tube(8, 12)
    away = mesh[0] + [50.0, 0, 0]
    result = matched(mesh, (away, mesh[1]), [(0, 0)])
    assert not result.found_vertices.any()
    assert result.correspondence.matched.all()
    assert (result.correspondence.faces >= 0).all()


def test_it_repeats() -> None:
    mesh = tube(8, 12)
    fine = subdivided(mesh)
    first, second = (matched(mesh, fine, [(0, 0)]).correspondence for _ in range(2))
    assert np.array_equal(first.corners, second.corners)
    assert np.array_equal(first.weights, second.weights)


@pytest.mark.parametrize("bad", [{"largest_angle": 0.0}, {"largest_distance": -1.0}])
def test_settings_are_checked(bad: dict[str, float]) -> None:
    with pytest.raises(SettingsError, match="the largest"):
        MatchingSettings(**bad)


# Quality --------------------------------------------------------------------------------------------------


def quality(source: Mesh, target: Mesh, markers: Markers) -> Quality:
    """Of meshes that lie on each other."""
    settings = MatchingSettings()
    start, goal = (TriangleMesh(mesh[0], topology_of(mesh)) for mesh in (source, target))
    pairings = pair_components(start.topology, goal.topology, markers)
    return assess(start, goal, pairings, markers, match(start, goal, pairings, settings), settings)


def test_of_a_mesh_on_itself_nothing_is_missing() -> None:
    mesh = tube(8, 12)
    found = quality(mesh, mesh, Markers.of([(0, 0), (50, 50)]))
    assert found.source_coverage == pytest.approx(1.0)
    assert found.target_coverage == pytest.approx(1.0)
    assert found.largest < 1e-12
    assert (found.flipped, found.filled_vertices, found.filled_faces, found.followers) == (0, 0, 0, 0)
    assert found.marker_distances.max() == 0


def test_distances_are_in_diagonals_of_the_target() -> None:
    sheet = grid(3, 4)
    lifted = sheet[0] + [0, 0, 0.1]
    found = quality((lifted, sheet[1]), sheet, Markers.of([(0, 0)]))
    assert (found.mean, found.p99, found.largest) == pytest.approx((0.02, 0.02, 0.02))
    assert found.marker_distances == pytest.approx([0.02])


def test_half_a_source_covers_half() -> None:
    sheet = grid(10, 10)
    half = sheet[0][:, 0].max() / 2
    left = sheet[1][(sheet[0][sheet[1]][:, :, 0] <= half + 1e-9).all(axis=1)]
    far = sheet[0] * [3.0, 1.0, 1.0]  # so that a third of the target's area, and a little more, is reached
    assert quality(sheet, (sheet[0], left), Markers.of([(0, 0)])).source_coverage == pytest.approx(
        0.5, abs=0.11
    )
    assert quality(sheet, (far, sheet[1]), Markers.of([(0, 0)])).target_coverage == pytest.approx(
        1 / 3, abs=0.1
    )


def test_followers_are_counted_and_lower_the_coverage() -> None:
    body, hat = tube(8, 12), tube(8, 12)
    found = quality(body, joined(body, (hat[0] + [3.0, 0, 0], hat[1])), Markers.of([(0, 0)]))
    assert found.followers == 1
    assert found.target_coverage == pytest.approx(0.5)
    assert found.source_coverage == pytest.approx(1.0)


def test_vertices_in_no_triangle_are_no_followers() -> None:
    points, faces = tube(8, 12)
    stray = np.concatenate([points, [[9.0, 0, 0]]])
    assert quality((points, faces), (stray, faces), Markers.of([(0, 0)])).followers == 0


def test_flipped_faces_are_counted() -> None:
    sheet = grid(6, 6)
    faces = sheet[1].copy()
    faces[0] = faces[0, ::-1]
    found = quality(sheet, (sheet[0], faces), Markers.of([(0, 0)]))
    assert found.flipped == 1
    assert found.filled_faces == 1


def test_the_worst_markers_are_named() -> None:
    mesh = tube(8, 12)
    markers = Markers.of([(0, 0), (1, 3), (2, 2)], ("nose", "left ear", "tail"))
    found = quality(mesh, mesh, markers)
    (name, distance), second = found.worst_markers(2)
    assert name == "'left ear' (1 -> 3)"
    gap = np.linalg.norm(mesh[0][1] - mesh[0][3]) / np.linalg.norm(np.ptp(mesh[0], axis=0))
    assert distance == pytest.approx(gap)
    assert second[1] == 0.0
