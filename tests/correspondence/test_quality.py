"""What is told of a correspondence."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.correspondence.markers import Markers, pair_components
from mixseq.correspondence.matching import MatchingSettings, match
from mixseq.correspondence.quality import Quality, assess
from mixseq.correspondence.triangle_mesh import TriangleMesh
from tests.meshes import Mesh, grid, joined, topology_of, tube


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
