"""Checks of markers and of the orientation of meshes: errors, warnings, and no false alarms."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.checks import check_facing, check_markers, check_orientation, find_conflicts, find_orientation
from mixseq.retargeting.markers import Markers
from mixseq.types import Float, Index
from mixseq_io.text.markers import read_markers
from tests.meshes import grid, joined, rotation, tetrahedron, torus, tube
from tests.retargeting.pairs import surface

pytestmark = pytest.mark.slow

LEGS = ((-0.5, -2.0), (0.5, -2.0), (-0.5, 2.0), (0.5, 2.0))
"""Where the four legs of `creature` stand: x (left is negative) and z."""


def creature() -> Float:
    """A body along z from the side to the side, and under it four legs of four points each: (28, 3)."""
    body = [[x, 2 + 0.3 * (z > 1), z] for z in (-2.5, -0.9, 0.8, 2.6) for x in (-0.6, 0.0, 0.7)]
    legs = [[x * (1 + 0.1 * y), y, z + 0.2 * y] for x, z in LEGS for y in (0.0, 0.5, 1.0, 1.5)]
    return np.array(body + legs)


def cloud(points: Float) -> TriangleMesh:
    """Points in triangles, so that none is unused."""
    return surface((points, np.repeat(np.arange(len(points))[:, None], 3, axis=1)))


def ring() -> tuple[Float, Index]:
    """A torus whose triangles are counter-clockwise from outside."""
    points, faces = torus(9, 6)
    return points, faces[:, ::-1]


def leg(number: int) -> Index:
    return np.arange(12 + 4 * number, 16 + 4 * number)


def other(points: Float) -> Float:
    """Another creature in another place: longer, with longer legs, bent a little."""
    x, y, z = points.T
    shaped = np.stack([1.3 * x, y + 0.4 * np.minimum(y - 1, 0), 1.2 * z + 0.1 * y**2], axis=1)
    return np.asarray(3 * shaped @ rotation((0.3, 1.0, -0.2)).T + [5, 0, 2])


def markers(targets: Index | None = None) -> Markers:
    """Mark all points of the creature, paired with themselves or with given targets."""
    source = np.arange(28)
    return Markers(source, source if targets is None else targets, tuple(f"<{n}>" for n in source))


def exchanged(*pairs: tuple[int, int]) -> Index:
    order = np.arange(28)
    for i, j in pairs:
        order[[i, j]] = order[[j, i]]
    return order


def warned(given: Markers, source: Float, target: Float) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_markers(given, cloud(source), cloud(target))
    assert all(warning.category is MixseqWarning for warning in caught)
    return [str(warning.message) for warning in caught]


def named(messages: list[str]) -> set[int]:
    return {int(number) for number in re.findall(r"<(\d+)>", " ".join(messages))}


# Markers that are right, exchanged, or wrong ------------------------------------------------------------------


def test_correct_markers_cause_no_warning() -> None:
    assert warned(markers(), creature(), other(creature())) == []
    assert warned(markers(), creature(), creature()) == []


def test_repeated_pairs_cause_no_warning() -> None:
    twice = np.concatenate([np.arange(28), np.arange(28)])
    assert warned(Markers(twice, twice), creature(), other(creature())) == []


@pytest.mark.parametrize("pair", [(12, 16), (13, 17), (20, 24), (14, 19), (13, 26)])
def test_two_exchanged_markers_are_named(pair: tuple[int, int]) -> None:
    messages = warned(markers(exchanged(pair)), creature(), other(creature()))
    assert named(messages) == set(pair)
    assert "seem exchanged" in messages[0]


def test_two_pairs_of_exchanged_markers_are_named() -> None:
    messages = warned(markers(exchanged((12, 16), (21, 25))), creature(), other(creature()))
    assert named(messages) == {12, 16, 21, 25}


@pytest.mark.parametrize("first", [0, 2])
def test_exchanged_left_and_right_leg_are_named(first: int) -> None:
    left, right = leg(first), leg(first + 1)
    order = exchanged(*zip(left.tolist(), right.tolist(), strict=True))
    messages = warned(markers(order), creature(), other(creature()))
    assert messages
    found = named(messages)
    assert len(found & {*left.tolist(), *right.tolist()}) >= 4
    assert len(found - {*left.tolist(), *right.tolist()}) <= 1


def test_a_marker_far_away_is_named() -> None:
    points, target = creature(), other(creature())
    away = target[:12].mean(axis=0) + np.array([0.0, 9, 0])
    target = np.concatenate([target, away[None]])
    order = np.arange(28)
    order[17] = 28
    messages = warned(markers(order), points, target)
    assert named(messages) == {17}
    assert "seems wrong" in messages[0]


def test_conflicts_are_reversed_directions_and_distances_that_differ() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.1]])
    every = np.arange(4)
    assert not find_conflicts(points, 3 * points, every).any()
    exchanged = np.argwhere(find_conflicts(points, points[[1, 0, 2, 3]], every))
    assert exchanged.tolist() == [[0, 1], [0, 3], [1, 0], [1, 3], [3, 0], [3, 1]]  # 3 is near 0, then near 1
    assert not find_conflicts(points[[0, 3]], points[[3, 0]], every[:2]).any()  # too near each other for a direction


# Markers that cannot be used ----------------------------------------------------------------------------------


def test_a_mirrored_target_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"left and right are exchanged in all markers, or one mesh is mirrored"):
        check_markers(markers(), cloud(creature()), cloud(other(creature()) * [-1, 1, 1]))


def test_markers_that_exchange_left_and_right_throughout_are_refused() -> None:
    sides_of_body = [(number, number + 2) for number in range(0, 12, 3)]
    legs = [*zip(leg(0), leg(1), strict=True), *zip(leg(2), leg(3), strict=True)]
    with pytest.raises(SettingsError, match="left and right are exchanged"):
        check_markers(markers(exchanged(*sides_of_body, *legs)), cloud(creature()), cloud(other(creature())))


def test_a_flat_sheet_may_be_turned_over() -> None:
    """Rotations and reflections of a plane are the same to its points; nothing is said of a sheet."""
    sheet = grid(3, 3)[0]
    every = np.arange(len(sheet))
    assert warned(Markers(every, every), sheet, sheet * [-1, 1, 1]) == []


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([[0, 0], [1, 1], [2, 2]], "there are 3 markers; at least 4"),
        ([[0, 0], [1, 1], [2, 2], [28, 3]], r"marker 4 \(28 -> 3\): the source has 28 vertices, 0 to 27"),
        ([[1, 1], [2, 2], [3, 3], [28, 4]], "subtract 1 from all: the file may count from 1"),
        ([[0, 0], [1, 1], [2, 2], [3, 99]], r"the target has 28 vertices.* are not exchanged$"),
        ([[0, 0], [1, 1], [2, 2], [3, -1]], "the target has 28 vertices"),
        ([[0, 0], [1, 1], [2, 2], [0, 3]], r"markers 1 \(0 -> 0\) and 4 \(0 -> 3\) give vertex 0 of the source two"),
        ([[0, 0], [1, 1], [2, 2], [3, 1]], r"markers 2 \(1 -> 1\) and 4 \(3 -> 1\) give vertex 1 of the target two"),
    ],
)
def test_invalid_markers_are_refused(pairs: list[list[int]], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        check_markers(Markers.from_pairs(pairs), cloud(creature()), cloud(other(creature())))


def test_markers_on_a_line_are_refused() -> None:
    points = creature()
    points[:5] = np.linspace(0, 1, 5)[:, None] * [1, 2, 3]
    with pytest.raises(SettingsError, match="all markers of the source are on one line"):
        check_markers(Markers.from_pairs([[k, k] for k in range(5)]), cloud(points), cloud(other(creature())))


def test_markers_on_a_plane_cause_a_warning() -> None:
    points = creature()
    points[:6] = [[x, y, 0.0] for x in (-0.5, 0.5) for y in (0.0, 1.0, 2.0)]
    with pytest.warns(MixseqWarning, match="all markers of the source are on one plane"):
        check_markers(Markers.from_pairs([[k, k] for k in range(6)]), cloud(points), cloud(points + np.eye(28, 3)))


def test_markers_on_vertices_without_triangles_are_refused() -> None:
    mesh = surface((creature(), np.array([[1, 2, 3]])))
    with pytest.raises(SettingsError, match=r"marker 1 \(0 -> 0\): no triangle of the source uses"):
        check_markers(Markers.from_pairs([[0, 0], [1, 1], [2, 2], [3, 3]]), mesh, mesh)


def test_repeated_markers_count_once() -> None:
    pairs = [[0, 0], [1, 1], [2, 2], [1, 1]]
    with pytest.raises(SettingsError, match="3 markers that differ, of 4; at least 4"):
        check_markers(Markers.from_pairs(pairs), cloud(creature()), cloud(other(creature())))


def test_unused_vertices_beside_a_flat_mesh_are_ignored() -> None:
    """An unused vertex outside the plane of the markers causes no warning."""
    points, faces = grid(4, 4)
    mesh = surface((np.concatenate([points, [[1.0, 1.0, 7.0]]]), faces))
    pairs = [[k, k] for k in (0, 4, 12, 20, 24)]
    check_markers(Markers.from_pairs(pairs), mesh, mesh)


# Inside out ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mesh", [tetrahedron(), ring(), tube(7, 5)])
def test_closed_components_have_an_orientation(mesh: tuple[Float, Index]) -> None:
    points, faces = mesh
    assert find_orientation(surface((points + 100, faces))).signs.tolist() == [1]
    assert find_orientation(surface((points, faces[:, ::-1]))).signs.tolist() == [-1]


def test_open_surfaces_have_no_orientation() -> None:
    assert find_orientation(surface(grid(3, 4))).signs.tolist() == [0]
    points, faces = ring()
    assert find_orientation(surface((points, faces[1:]))).signs.tolist() == [1]  # a small hole does not matter


def test_an_inside_out_mesh_is_refused_by_name() -> None:
    points, faces = ring()
    check_orientation(surface((points, faces)), surface((2 * points, faces)))
    check_orientation(surface((points, faces[:, ::-1])), surface((2 * points, faces[:, ::-1])))
    with pytest.raises(SettingsError, match=r"the target is inside out.*turn its triangles over"):
        check_orientation(surface((points, faces)), surface((2 * points, faces[:, ::-1])))
    with pytest.raises(SettingsError, match="the source is inside out"):
        check_orientation(surface((points, faces[:, ::-1])), surface((2 * points, faces)))


def test_single_inverted_components_cause_a_warning() -> None:
    points, faces = joined(ring(), (tetrahedron()[0] / 4 + 9, tetrahedron()[1]))
    faces[-4:] = faces[-4:, ::-1]
    with pytest.warns(MixseqWarning, match=rf"1 of 2 components .*that of triangle {len(faces) - 4}\)"):
        check_orientation(surface(ring()), surface((points, faces)))


def test_inverted_open_surfaces_are_found_after_registration() -> None:
    points, faces = grid(4, 4)
    check_orientation(surface((points, faces)), surface((points, faces[:, ::-1])))
    check_facing(surface((points, faces)), surface((points, faces)))
    with pytest.raises(SettingsError, match=r"100 % of the target's area faces away"):
        check_facing(surface((points, faces)), surface((points, faces[:, ::-1])))


# Markers that people set --------------------------------------------------------------------------------------

Case = tuple[Markers, Float, Float]


def horse_camel(file: str) -> Callable[[Path], Case]:
    return lambda data: _case(data, data / "markers" / file, "horse_poses", "camel_poses")


def ours(file: str, source: str, target: str) -> Callable[[Path], Case]:
    folder = Path(__file__).parents[2] / "scripts" / "benchmarks" / "markers"
    return lambda data: _case(data, folder / file, source, target)


CASES = {
    "cons": horse_camel("golevka_horse_camel.cons"),
    "corr": horse_camel("kylegh_horse_camel_vert.corr"),
    "yml": horse_camel("markers-horse-camel.yml"),
    "cat": lambda data: _case(data, data / "markers" / "markers-cat-lion.yml", "cat_poses", "lion_poses"),
    "wolf": ours("wolf_horse.txt", "q_wolf_gallop", "q_horse_gallop"),
    "man": ours("man_woman.txt", "q_man_run", "q_woman_run"),
}


def _case(data: Path, file: Path, source: str, target: str) -> Case:
    points = [mixseq.read(data / "npz" / f"{name}.npz").points[0].astype(float) for name in (source, target)]
    found = read_markers(file)
    return (Markers(found.source, found.target, tuple(f"<{n}>" for n in range(len(found)))), points[0], points[1])


@pytest.mark.realdata
@pytest.mark.parametrize("name", CASES)
def test_published_markers_cause_no_warning(data: Path, name: str) -> None:
    assert warned(*CASES[name](data)) == []


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["cons", "corr", "yml", "cat"])
def test_exchanged_legs_are_named(data: Path, name: str) -> None:
    given, source, target = CASES[name](data)
    places = source[given.source]
    low, high = source.min(axis=0), source.max(axis=0)
    across = (places[:, 0] - (low + high)[0] / 2) / (high - low)[0]
    on_leg = places[:, 1] < (low + high)[1] / 2
    pairs = [
        (i, j) for i in np.flatnonzero(on_leg & (across < -0.05)) for j in np.flatnonzero(on_leg & (across > 0.05))
    ]
    chosen = np.random.default_rng(0).permutation(len(pairs))[:2]
    for i, j in (pairs[number] for number in chosen):
        targets = given.target.copy()
        targets[[i, j]] = targets[[j, i]]
        assert named(warned(Markers(given.source, targets, given.names), source, target)) == {i, j}
