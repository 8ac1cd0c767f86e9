"""Correspondence of two sequences from markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.topology import Topology
from mixseq.retargeting.correspond import correspond, correspond_and_assess
from mixseq.retargeting.markers import Markers
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, Index
from tests.meshes import grid, joined, rotation, tube
from tests.retargeting.pairs import subdivided

pytestmark = pytest.mark.slow

BODY = tube(10, 25)
MARKED = np.array([0, 3, 5, 62, 67, 120, 125, 182, 187, 243, 248, 250, 251])


def still(points: Float, faces: Index) -> MeshSequence:
    return MeshSequence.from_arrays(points[None], faces, fps=24)


def warp(points: Float) -> Float:
    """A smooth deformation of the tube: it widens, winds and turns."""
    z = points[:, 2:]
    result = points * (1 + 0.1 * z * [1, 1, 0])
    result = result + 0.3 * np.sin(z) * [1.0, 0.0, 0.0]
    return np.asarray(3.0 * result @ rotation((0.4, 1.0, -0.3)).T + [7.0, 0.0, 2.0])


def error(carried: Float, truth: Float) -> Float:
    """Distances of points of the source from where they should be, in its diagonals."""
    return np.asarray(np.linalg.norm(carried - truth, axis=1) / np.linalg.norm(np.ptp(truth, axis=0)))


@pytest.mark.parametrize("moved", [False, True])
def test_a_mesh_corresponds_to_itself_and_its_similarities(moved: bool) -> None:
    points = 5.0 * BODY[0] @ rotation((1.0, 0.2, -2.0)).T + [10.0, -3.0, 8.0] if moved else BODY[0]
    correspondence, quality = correspond_and_assess(still(*BODY), still(points, BODY[1]), Markers(MARKED, MARKED))
    found = correspondence
    own = (found.weights * (found.corners == np.arange(len(points))[:, None])).sum(axis=1)
    np.testing.assert_allclose(own, 1.0, atol=1e-6)
    assert np.array_equal(found.faces, np.arange(len(BODY[1])))
    assert quality.flipped_count == 0
    assert quality.source_coverage == pytest.approx(1.0)


def test_a_warped_mesh_corresponds_to_itself() -> None:
    found = correspond(still(*BODY), still(warp(BODY[0]), BODY[1]), Markers(MARKED, MARKED))
    off = error(found.interpolate(BODY[0][None])[0], BODY[0])
    assert off.mean() < 0.004
    assert off.max() < 0.015


def test_a_mesh_corresponds_to_its_subdivision() -> None:
    fine = subdivided(BODY)
    found = correspond(still(*BODY), still(warp(fine[0]), fine[1]), Markers(MARKED, MARKED))
    off = error(found.interpolate(BODY[0][None])[0], fine[0])
    assert off.mean() < 0.004
    assert off.max() < 0.015


def test_a_mesh_corresponds_to_its_decimation() -> None:
    fine = subdivided(BODY)
    found = correspond(still(*fine), still(warp(BODY[0]), BODY[1]), Markers(MARKED, MARKED))
    assert error(found.interpolate(fine[0][None])[0], BODY[0]).max() < 0.015


def test_an_extra_component_follows() -> None:
    hat = tube(5, 4, length=0.2, radius=0.1)
    target = joined(BODY, (hat[0] + [0, 0, 4.2], hat[1]))
    correspondence, quality = correspond_and_assess(still(*BODY), still(*target), Markers(MARKED, MARKED))
    count = len(BODY[0])
    assert set(correspondence.leaders[count:]) == {251}
    assert quality.follower_count == 1


def test_the_rest_pose_is_a_frame_of_the_source() -> None:
    source = MeshSequence.from_arrays(np.stack([warp(BODY[0]), BODY[0]]), BODY[1], fps=24)
    _, quality = correspond_and_assess(source, still(*BODY), Markers(MARKED, MARKED), rest=1)
    assert quality.largest_distance < 1e-6


def test_correspondence_is_deterministic() -> None:
    target = still(warp(BODY[0]), BODY[1])
    first, second = (correspond(still(*BODY), target, Markers(MARKED, MARKED)) for _ in range(2))
    assert np.array_equal(first.corners, second.corners)
    assert np.array_equal(first.weights, second.weights)
    assert np.array_equal(first.faces, second.faces)


def test_a_frame_that_does_not_exist_is_refused() -> None:
    with pytest.raises(SettingsError, match="no frame 1"):
        correspond(still(*BODY), still(*BODY), Markers(MARKED, MARKED), rest=1)


def test_inverted_meshes_are_refused_before_registration() -> None:
    """The volume of a closed mesh is negative if it is inside out."""
    told: list[int] = []
    with pytest.raises(SettingsError, match="inside out"):
        correspond(
            still(*BODY),
            still(BODY[0], BODY[1][:, ::-1]),
            Markers(MARKED, MARKED),
            progress=lambda done, *_: told.append(done),
        )
    assert told == []


def test_an_inverted_open_mesh_is_refused_after_registration() -> None:
    points, faces = grid(8, 8)
    bumpy = points + [0, 0, 1] * np.sin(points[:, :1]) * np.cos(points[:, 1:2])
    marked = Markers(np.array([0, 8, 30, 40, 50, 72, 80]), np.array([0, 8, 30, 40, 50, 72, 80]))
    with pytest.raises(SettingsError, match="faces away from the source that was fitted"):
        correspond(still(bumpy, faces), still(bumpy, faces[:, ::-1]), marked)


def test_unused_vertices_do_not_change_the_correspondence() -> None:
    """They change neither the unit of lengths nor the followers."""
    markers, target = Markers(MARKED, MARKED), warp(BODY[0])
    alone_correspondence, alone = correspond_and_assess(still(*BODY), still(target, BODY[1]), markers)
    stray = np.random.default_rng(0).normal(size=(50, 3)) * 1e4
    source = still(np.concatenate([BODY[0], stray]), BODY[1])
    correspondence, quality = correspond_and_assess(source, still(np.concatenate([target, stray]), BODY[1]), markers)
    carried, expected = (each.interpolate(BODY[0]) for each in (correspondence, alone_correspondence))
    np.testing.assert_allclose(carried[: len(BODY[0])], expected, atol=1e-6)
    assert quality.largest_distance == pytest.approx(alone.largest_distance)
    assert quality.follower_count == 0


def test_a_marked_component_without_area_follows() -> None:
    """Three vertices in one place, as exporters leave them."""
    count = len(BODY[0])
    faces = np.concatenate([BODY[1], [[count, count + 1, count + 2]]])
    source = np.concatenate([BODY[0], np.tile(BODY[0][62] * 1.2, (3, 1))])
    marked = np.append(MARKED, count)
    found = correspond(still(source, faces), still(warp(source), faces), Markers(marked, marked))
    assert error(found.interpolate(source), source).max() < 0.015


@pytest.mark.parametrize("side", ["source", "target"])
def test_a_mesh_without_area_is_refused(side: str) -> None:
    flat = BODY[0], BODY[1][:, [0, 1, 1]]
    meshes = (flat, BODY) if side == "source" else (BODY, flat)
    with pytest.raises(SettingsError, match=f"all markers of the {side} are on components without area"):
        correspond(still(*meshes[0]), still(*meshes[1]), Markers(MARKED, MARKED))


def test_unmarked_area_causes_a_warning() -> None:
    """No two triangles share a vertex, so few of them are in a marked component."""
    points, faces = BODY
    loose = points[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    first = np.array([np.flatnonzero(faces.reshape(-1) == vertex)[0] for vertex in MARKED])
    with pytest.warns(MixseqWarning, match="only 3 % of the target's area.*weld"):
        correspond(still(*BODY), still(*loose), Markers(MARKED, first))


WOLF_TO_HORSE = [
    *((982, 971), (939, 970), (302, 849), (844, 887), (321, 888), (272, 421), (375, 445), (87, 388)),
    *((346, 868), (820, 406), (738, 27), (788, 435), (203, 448), (258, 188), (128, 991), (754, 986)),
    *((176, 303), (73, 235), (66, 368), (329, 66), (792, 1080), (639, 601), (510, 1003), (890, 1002)),
    *((558, 712), (420, 782), (388, 775), (686, 481), (921, 1087)),
]
"""Nose, chin, tail, back, belly; of either side the ear, foot, hock, elbow, wrist, flank and eye."""


@pytest.mark.realdata
def test_wolf_to_horse(data: Path) -> None:
    wolf, horse = (mixseq.read(data / "npz" / f"{name}.npz") for name in ("q_wolf_gallop", "q_horse_gallop"))
    correspondence, quality = correspond_and_assess(wolf, horse, Markers.from_pairs(WOLF_TO_HORSE))
    assert quality.source_coverage > 0.97
    assert quality.target_coverage > 0.99
    assert quality.p99_distance < 0.015
    assert quality.flipped_count == 0
    assert quality.marker_distances.max() < 0.005
    # Both animals are nearly symmetric: left stays left.
    across = correspondence.interpolate(np.asarray(wolf.points[:1], dtype=np.float64))[0, :, 0]
    x = np.asarray(horse.points[0, :, 0], dtype=np.float64)
    sides = np.abs(x) > 0.15
    assert (np.sign(across[sides]) == np.sign(x[sides])).mean() > 0.97
    # Neighbours on the horse are neighbours on the wolf.
    places = correspondence.interpolate(np.asarray(wolf.points[:1], dtype=np.float64))[0]
    i, j = Topology(horse.faces, horse.vertex_count).edges.T
    apart = np.linalg.norm(places[i] - places[j], axis=1) / np.linalg.norm(np.ptp(wolf.points[0], axis=0))
    assert apart.max() < 0.12
