"""Colours in the viewer: entries of palettes, scales that reach what is shown, and captions."""

from __future__ import annotations

import colorsys
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.measures import dihedral_angles, wrap_angles
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.mesh.topology import Topology
from mixseq.pictures.colours import (
    JOINT_ENTRY,
    JOINT_RED,
    MAX_PALETTE_COLOURS,
    MEASURES,
    MIN_SCALE_ENDS,
    PALETTE_PARTS,
    SCALE_QUANTILES,
    Colouring,
    available_colourings,
    curvature_from_rest,
    format_two_digits,
    make_colouring,
    own_colours,
    part_colours,
    segmentation_colours,
    strain_from_rest,
    vertex_distances,
    viridis,
)
from mixseq.pictures.film import FilmSettings, film
from mixseq.pictures.raster import shade
from mixseq.pictures.scene import CLAY_COLOUR, SceneItem
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray
from tests.meshes import Mesh, bar, flipped, grid, joined, pages, rotation, tetrahedron, torus, tube

BAR = bar(frames=4)
REST = BAR.points[0]
PALETTE = np.zeros((256, 3), dtype=np.uint8)


def poses(sequence: MeshSequence = BAR) -> Iterator[tuple[float, NDArray[np.float64]]]:
    """What a viewer shows of a sequence, pose by pose."""
    return ((float(t - sequence.times[0]), x) for t, x in zip(sequence.times, sequence.points, strict=True))


def original(elapsed: float) -> NDArray[np.float64]:
    return np.asarray(BAR.points[round(elapsed * BAR.fps)])


def halves(mesh: MeshSequence = BAR) -> Decomposition:
    upper = mesh.points[0][mesh.faces].mean(axis=1)[:, 2] > 2
    return decompose(Topology(mesh.faces, mesh.vertex_count), upper.astype(np.int64), 2)


def cut(part_of_face: list[int]) -> tuple[MeshSequence, Decomposition]:
    """A flat strip of two squares, cut into parts without joints."""
    flat, faces = grid(1, 2)
    strip = MeshSequence.from_arrays(flat[None], faces)
    return strip, Decomposition(np.array(part_of_face), (), (), np.zeros(0, dtype=np.int64))


# Which there are


def test_there_are_those_that_can_be_shown() -> None:
    assert list(available_colourings(BAR.header, REST)) == ["clay", "strain", "curvature"]
    everything = available_colourings(BAR.header, REST, halves(), original, poses())
    assert list(everything) == ["clay", "parts", "error", "strain", "curvature"]
    for name, colouring in everything.items():
        assert colouring.name == name
        assert colouring.palette.shape == (256, 3)
        assert colouring.palette.dtype == np.uint8
        indices = colouring.entries(REST, 0.0)
        assert indices.shape == (BAR.vertex_count,)
        assert indices.dtype == np.uint8
    assert [name for name, colouring in everything.items() if colouring.is_constant] == ["clay", "parts"]


@pytest.mark.parametrize("shape", ["constant", "moving"])
def test_values_are_from_the_smallest_to_the_largest(shape: str) -> None:
    track, count = BAR, BAR.vertex_count
    row = np.linspace(-3, 2, count)
    values = row if shape == "constant" else row + 10 * np.arange(track.frame_count)[:, None]
    found = available_colourings(track.header, REST, values=values)
    assert next(iter(found)) == "values"
    colouring, top = found["values"], values.max()
    assert (colouring.low, colouring.top) == (-3, top)
    last = np.broadcast_to(values, (track.frame_count, count))[-1]
    expected = np.rint(255 * (last + 3) / (top + 3))
    assert np.array_equal(colouring.entries(REST, float(track.times[-1] - track.times[0])), expected)


@pytest.mark.parametrize(
    ("values", "message"), [(np.zeros(5), r"shape \(5,\); give 202 numbers"), (np.full(202, np.nan), "not all finite")]
)
def test_values_are_of_the_vertices(values: NDArray[np.float64], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        available_colourings(BAR.header, REST, values=values)


def test_equal_values_have_a_scale() -> None:
    colouring = available_colourings(BAR.header, REST, values=np.full(202, 4.0))["values"]
    assert (colouring.low, colouring.top) == (4, 5)


def test_clay_is_clay() -> None:
    clay = available_colourings(BAR.header, REST)["clay"]
    assert np.allclose(clay.palette[clay.entries(REST, 0)] / 255, CLAY_COLOUR, atol=0.5 / 255)


# Parts


def test_joints_are_pale_and_red_where_parts_meet() -> None:
    parts = available_colourings(BAR.header, REST, halves())["parts"]
    entries = parts.entries(REST, 0.0)
    joint = np.zeros(BAR.vertex_count, dtype=bool)
    joint[BAR.faces[halves().joint_of_face >= 0]] = True
    upper = np.array([halves().part_of_face[(BAR.faces == vertex).any(axis=1)] for vertex in range(202)], dtype=object)
    meets = np.array([len(set(labels.tolist())) == 2 for labels in upper])
    assert 0 < (joint & meets).sum() < joint.sum() < BAR.vertex_count
    assert np.array_equal(entries == JOINT_ENTRY, joint & meets)
    assert np.array_equal(entries >= PALETTE_PARTS, joint)
    assert np.array_equal(entries[~joint], REST[~joint][:, 2] > 2)
    colours = parts.palette[[0, 1, JOINT_ENTRY]] / 255
    assert np.allclose(colours, [*part_colours(2), JOINT_RED], atol=0.5 / 255)
    assert (parts.palette[PALETTE_PARTS] > parts.palette[0]).all()


def test_most_faces_of_a_vertex_tell_its_part() -> None:
    # triangles 0 1 4, 0 4 3, 1 2 5, 1 5 4
    strip, decomposition = cut([2, 1, 2, 1])
    parts = available_colourings(strip.header, strip.points[0], decomposition)["parts"]
    # 0: 2 and 1; 1: 2, 2 and 1; 2: 2; 3: 1; 4: 2, 1 and 1; 5: 2 and 1
    assert parts.entries(strip.points[0], 0).tolist() == [1, 2, 2, 1, 1, 1]


def test_numbers_of_parts_go_around_below_the_joints() -> None:
    strip, decomposition = cut([126, 127, 126, 128])
    parts = available_colourings(strip.header, strip.points[0], decomposition)["parts"]
    # ties are of the lowest part, not of the lowest entry
    assert parts.entries(strip.points[0], 0).tolist() == [126, 126, 126, 0, 126, 126]


def test_vertices_without_faces_are_survived() -> None:
    strip, decomposition = cut([3, 3, 3, 3])
    points = np.concatenate([strip.points, [[[9.0, 9, 9]]]], axis=1)
    loose = MeshSequence.from_arrays(points, strip.faces)
    assert available_colourings(loose.header, points[0], decomposition)["parts"].entries(points[0], 0)[6] == 0


def test_shared_colours_cannot_be_written_to() -> None:
    with pytest.raises(ValueError, match="read-only"):
        available_colourings(BAR.header, REST)["clay"].entries(REST, 0)[0] = 1


# Numbers


def test_scales_reach_what_is_shown() -> None:
    found = available_colourings(BAR.header, REST, original=original, poses=poses())
    strain, curvature = strain_from_rest(REST, BAR.faces), curvature_from_rest(REST, BAR.faces)
    assert np.isclose(
        found["strain"].top, max(100 * np.quantile(strain(x), SCALE_QUANTILES["strain"]) for x in BAR.points)
    )
    assert np.isclose(
        found["curvature"].top, max(np.quantile(curvature(x), SCALE_QUANTILES["curvature"]) for x in BAR.points)
    )
    assert found["error"].top == MIN_SCALE_ENDS["error"]  # it is the original
    assert np.array_equal(found["curvature"].entries(REST, 0), np.zeros(BAR.vertex_count))
    assert found["curvature"].entries(BAR.points[-1], 0.3).max() == 255


def test_errors_are_at_the_same_time_in_diagonals() -> None:
    diagonal = float(np.linalg.norm(np.ptp(REST, axis=0)))
    moved = MeshSequence.from_arrays(
        BAR.points + np.array([0.1 * diagonal, 0, 0]), BAR.faces, fps=BAR.fps, times=BAR.times + 5
    )
    error = available_colourings(moved.header, moved.points[0], None, original, poses(moved))["error"]
    assert np.isclose(error.top, 0.1)
    assert np.array_equal(error.with_top(0.4).entries(moved.points[2], 0.2), np.full(BAR.vertex_count, 64))
    assert error.with_top(0.4).entries(moved.points[2], 0.0).max() > 64
    assert error.unit == "diagonals"


@pytest.mark.parametrize(("name", "reached"), [("strain", 2.0), ("curvature", 2.0), ("error", 1e6)])
def test_one_vertex_in_a_hundred_may_have_more_strain_but_no_error(name: str, reached: float) -> None:
    values = np.append(np.full(999, 2.0), 1e6)
    assert Colouring(name, PALETTE, measure=lambda points, elapsed: values).scale_end(REST, 0) == reached


@given(st.floats(0, 10), st.floats(0.01, 10))
def test_entries_are_shares_of_the_scale(value: float, top: float) -> None:
    colouring = Colouring("a", PALETTE, measure=lambda points, elapsed: np.array([value]), top=top)
    assert colouring.entries(REST, 0).tolist() == [round(255 * min(value / top, 1))]


def test_poses_are_used_once_and_one_by_one() -> None:
    alive = []

    def once() -> Iterator[tuple[float, NDArray[np.float64]]]:
        for elapsed, points in poses():
            alive.append(elapsed)
            yield elapsed, points

    iterator = once()
    available_colourings(BAR.header, REST, None, original, iterator)
    assert len(alive) == BAR.frame_count
    assert next(iterator, None) is None


def test_a_rigid_motion_has_no_colours() -> None:
    moved = (REST @ rotation((0.3, 1, 2)).T + [1, 2, 3]).astype(np.float32)
    found = available_colourings(BAR.header, REST.astype(np.float32), poses=[(0.0, REST), (1.0, moved)])
    for name in ("strain", "curvature"):
        assert found[name].top == MIN_SCALE_ENDS[name]
        assert found[name].entries(moved, 1.0).max() < 20
    assert (found["strain"].unit, found["curvature"].unit) == ("%", "degrees")


def test_ends_of_scales_have_two_digits() -> None:
    assert [format_two_digits(top) for top in (0.0123, 0.1, 12, 123.4)] == ["0.012", "0.1", "12", "120"]


# Refusals


@pytest.mark.parametrize("top", [0, -1, np.nan, np.inf])
def test_scales_are_positive(top: float) -> None:
    with pytest.raises(SettingsError, match="give a positive number"):
        available_colourings(BAR.header, REST)["strain"].with_top(top)


def test_what_means_no_numbers_has_no_scale() -> None:
    with pytest.raises(SettingsError, match="the colour clay has no scale; choose another one"):
        available_colourings(BAR.header, REST)["clay"].with_top(1)


def test_colours_are_fixed_or_measured() -> None:
    constant_entries = np.zeros(3, dtype=np.uint8)
    for given_ in ({}, {"constant_entries": constant_entries, "measure": lambda points, elapsed: constant_entries}):
        with pytest.raises(SettingsError, match="either constant entries or a measure"):
            Colouring("a", PALETTE, **given_)  # type: ignore[arg-type]


def test_other_meshes_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"the rest pose has the shape \(7, 3\), the mesh 202 vertices"):
        available_colourings(BAR.header, REST[:7])
    with pytest.raises(SettingsError, match=r"the original has the shape \(7, 3\)"):
        available_colourings(BAR.header, REST, original=lambda elapsed: REST[:7])
    decomposition = replace(halves(), part_of_face=np.zeros(7, dtype=np.int64))
    with pytest.raises(SettingsError, match="the parts have 7 triangles, the mesh 400"):
        available_colourings(BAR.header, REST, decomposition)


def test_they_need_no_matplotlib() -> None:
    code = "import mixseq.pictures.colours, sys; assert not {'matplotlib', 'viser'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


# Colours that meshes bring along: exact where a palette can hold them, near where it cannot


def painted(sequence: MeshSequence, values: FloatArray) -> MeshSequence:
    """The sequence with linear colours ``(V, 4)`` of its vertices."""
    return replace(sequence, surface=Surface(colours=CornerValues(values, np.asarray(sequence.polygons.indices))))


def by_place(sequence: MeshSequence) -> MeshSequence:
    """The sequence painted by where its vertices are in the first frame."""
    low, size = sequence.points[0].min(axis=0), np.ptp(sequence.points[0], axis=0)
    return painted(sequence, np.hstack([(sequence.points[0] - low) / size, np.ones((sequence.vertex_count, 1))]))


def shown(sequence: MeshSequence) -> NDArray[np.uint8]:
    palette, entries = own_colours(sequence.header)
    assert len(palette) <= MAX_PALETTE_COLOURS
    return palette[entries]


def srgb(linear: FloatArray) -> FloatArray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def test_linear_colours_are_shown_in_srgb() -> None:
    points, faces = tetrahedron()
    values = np.array([[1, 0, 0, 1], [0.5, 0.5, 0.5, 0.1], [-1, 2, np.nan, 1], [0.2159, 0.002, 1, 1]])
    sequence = painted(MeshSequence.from_arrays(points[None], faces), values)
    assert shown(sequence).tolist() == [[255, 0, 0], [188, 188, 188], [0, 255, 0], [128, 7, 255]]


def test_up_to_256_colours_are_exact() -> None:
    sequence = bar(sides=16, rings=40, frames=1)
    values = np.ones((sequence.vertex_count, 4))
    values[:, 0] = (np.arange(sequence.vertex_count) % 256) / 255
    expected = np.rint(255 * srgb(values[:, :3]))
    np.testing.assert_array_equal(shown(painted(sequence, values)), expected)


def test_more_colours_are_near() -> None:
    """Of a bar that is painted by place, thousands of colours, as 256."""
    sequence = by_place(bar(sides=30, rings=200, frames=1))
    assert sequence.surface.colours is not None
    exact = 255 * srgb(sequence.surface.colours.values[:, :3].astype(np.float64))
    assert len(np.unique(np.rint(exact), axis=0)) > 1000
    apart = np.linalg.norm(shown(sequence) - exact, axis=1)
    assert np.sqrt(np.square(apart).mean()) < 12
    np.testing.assert_array_equal(shown(sequence), shown(sequence))


def test_vertices_have_the_colour_of_their_first_corner_and_white_without_one() -> None:
    points, _ = tetrahedron()
    sequence = MeshSequence.from_arrays(np.vstack([points, [[9, 9, 9]]])[None], [[0, 1, 2], [2, 1, 3]])
    values = np.array([[1, 0, 0, 1], [0, 0, 1, 1]], np.float32)
    two = replace(sequence, surface=Surface(colours=CornerValues(values, np.array([0, 0, 0, 1, 1, 1]))))
    red, blue, white = [255, 0, 0], [0, 0, 255], [255, 255, 255]
    assert shown(two).tolist() == [red, red, red, blue, white]


def test_faces_of_films_have_the_mean_of_their_vertices() -> None:
    points, faces = tetrahedron()
    values = np.ones((4, 4))
    values[0, 1:3] = 0
    sequence = painted(MeshSequence.from_arrays(points[None], faces), values)
    colouring = make_colouring("own", sequence.header, points)
    expected = np.where((sequence.faces == 0).any(axis=1)[:, None], [1, 2 / 3, 2 / 3], [1.0, 1, 1])
    np.testing.assert_allclose(np.asarray(colouring.face_colours), expected, atol=1e-6)
    assert colouring.is_constant


def test_films_of_meshes_without_colours_are_refused(tmp_path: object) -> None:
    sequence = bar(sides=5, rings=5, frames=2)
    with pytest.raises(SettingsError, match="bar has no vertex colours; choose another colour"):
        film(f"{tmp_path}/a.gif", [SceneItem("bar", sequence)], FilmSettings(colour="own"))


# Colours: parts differ from each other and, in any light, from the joints


def test_part_colours_are_colours_and_do_not_depend_on_their_number() -> None:
    colours = part_colours(24)
    assert colours.shape == (24, 3)
    assert colours.min() >= 0 and colours.max() <= 1
    assert np.array_equal(colours[:7], part_colours(7))


def test_part_colours_differ() -> None:
    colours = part_colours(20)
    distances = np.linalg.norm(colours[:, None] - colours, axis=2)
    assert distances[np.triu_indices(20, 1)].min() > 0.06
    assert np.diag(distances, 1).min() > 0.2


def test_no_part_looks_like_a_joint_in_any_light() -> None:
    normals = np.random.default_rng(1).normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    def lit(colour: object) -> NDArray[np.float64]:
        return shade(np.broadcast_to(np.asarray(colour, dtype=np.float64), normals.shape), normals, 1.0)

    def hues(colours: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([360 * colorsys.rgb_to_hsv(*colour)[0] for colour in colours])

    reds = lit(JOINT_RED)
    for colour in part_colours(50):
        lights = lit(colour)
        turn = np.abs((hues(lights)[:, None] - hues(reds) + 180) % 360 - 180)
        assert turn.min() > 30
        assert np.linalg.norm(lights[:, None] - reds, axis=2).min() > 0.1


def test_segmentation_colours() -> None:
    strip, _ = grid(1, 4)
    faces = grid(1, 4)[1]
    parts = (strip[faces, 0].mean(axis=1) > 2).astype(int)
    joints = np.where(abs(strip[faces, 0].mean(axis=1) - 2) < 1.5, 0, -1)
    colours = segmentation_colours(parts, joints, faces)
    touching = (strip[faces, 0] == 2).sum(axis=1)
    assert (touching[joints >= 0] < 2).any()
    assert np.allclose(colours[(joints >= 0) & (touching >= 2)], JOINT_RED)
    assert np.allclose(colours[joints < 0], part_colours(2)[parts[joints < 0]])
    pale = (joints >= 0) & (touching < 2)
    assert (colours[pale] > part_colours(2)[parts[pale]]).all()


def test_viridis_is_that_of_matplotlib() -> None:
    maps = pytest.importorskip("matplotlib").colormaps
    assert viridis().shape == (256, 3)
    assert np.abs(viridis() - maps["viridis"](np.arange(256))[:, :3]).max() < 1.4 / 255


# Measures of poses: known numbers on bent strips, none for rigid motions, and nothing without lengths or angles


def rolled(columns: int, degrees: float) -> Float:
    """The strip `grid(1, columns)`, bent by some degrees in each of the lines between its squares."""
    directions = np.radians(degrees) * np.arange(columns)
    x = np.concatenate([[0], np.cumsum(np.cos(directions))])
    z = np.concatenate([[0], np.cumsum(np.sin(directions))])
    return np.concatenate([np.stack([x, np.full_like(x, y), z], axis=1) for y in (0.0, 1.0)])


def folded(degrees: float) -> Float:
    """Two triangles that share the edge from vertex 0 to vertex 1, with some degrees between their planes."""
    angle = np.radians(degrees)
    return np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, -np.cos(angle), -np.sin(angle)]])


BOOK = np.array([[0, 1, 2], [1, 0, 3]])

AWKWARD: dict[str, Mesh] = {
    "closed": tetrahedron(),
    "torus": torus(12, 8),
    "open": grid(3, 4),
    "not a manifold": pages(),
    "orientations": (tube(6, 5)[0], flipped(tube(6, 5)[1])),
    "pieces": joined(tetrahedron(), grid(2, 2)),
}


# Strain


def test_strain_is_the_mean_of_the_edges() -> None:
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    longer = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0.0]])
    strain = strain_from_rest(rest, np.array([[0, 1, 2]]))
    hypotenuse = np.sqrt(5 / 2) - 1
    assert np.allclose(strain(longer), [0.5, (1 + hypotenuse) / 2, hypotenuse / 2])
    assert np.allclose(strain(rest), 0)


def test_edges_without_length_are_not_strained() -> None:
    rest = np.array([[0, 0, 0], [0, 0, 0], [0, 1, 0.0]])
    longer = np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0.0]])
    opposite = np.sqrt(5) - 1
    assert np.allclose(strain_from_rest(rest, np.array([[0, 1, 2]]))(longer), [0, opposite / 2, opposite / 2])


# Curvature


@pytest.mark.parametrize("degrees", [10, -35, 90])
def test_a_strip_bends_between_its_squares(degrees: float) -> None:
    columns = 5
    flat, faces = grid(1, columns)
    change = curvature_from_rest(flat, faces)(rolled(columns, degrees)).reshape(2, -1)
    # every vertex inside has one line between squares, that bends, and one diagonal, that does not
    assert np.allclose(change[:, 1:-1], abs(degrees) / 2)
    assert np.allclose(change[:, [0, -1]], 0)


def test_it_is_the_change_that_counts() -> None:
    _, faces = grid(1, 4)
    change = curvature_from_rest(rolled(4, 20), faces)
    assert np.allclose(change(rolled(4, 50)), change(rolled(4, -10)))
    assert np.allclose(change(rolled(4, 50)).max(), 15)


def test_angles_change_the_shorter_way_round() -> None:
    change = curvature_from_rest(folded(170), BOOK)
    assert np.allclose(change(folded(-170)), [20, 20, 0, 0])
    assert np.allclose(change(folded(-10)), [180, 180, 0, 0])


@pytest.mark.parametrize("name", AWKWARD)
def test_angles_are_those_of_the_signals(name: str) -> None:
    rest, faces = AWKWARD[name]
    now = rest + 0.3 * np.sin(5 * rest[:, [1, 2, 0]] + [0, 1, 2])
    topology = Topology(faces, len(rest))
    change = np.degrees(
        np.abs(wrap_angles(dihedral_angles(now, topology.hinges) - dihedral_angles(rest, topology.hinges)))
    )
    of_vertex: list[list[float]] = [[] for _ in rest]
    for (a, b, _, _), value in zip(topology.hinges, change, strict=True):
        of_vertex[a].append(value)
        of_vertex[b].append(value)
    expected = [sum(values) / max(len(values), 1) for values in of_vertex]
    assert max(expected) > 1
    assert np.allclose(curvature_from_rest(rest, faces)(now), expected, atol=1e-9)


def test_hinges_of_faces_without_area_do_not_bend() -> None:
    flat, faces = grid(1, 2)
    collapsed = flat.copy()
    collapsed[3] = flat[0]  # only of the triangle 0 4 3, whose diagonal is its one hinge
    turned = rolled(2, 40)
    for rest, now in ((collapsed, turned), (turned, collapsed)):
        assert np.allclose(curvature_from_rest(rest, faces)(now), [0, 20, 0, 0, 20, 0])
    nothing = np.zeros_like(flat)
    assert np.array_equal(curvature_from_rest(nothing, faces)(turned), np.zeros(6))
    assert np.array_equal(curvature_from_rest(turned, faces)(nothing), np.zeros(6))


def test_slivers_do_not_bend() -> None:
    book = folded(0)
    for height in (1e-5, -1e-5):  # below and above its edge: half a turn, if it had an area
        book[3] = [50, height, 0]
        assert np.array_equal(curvature_from_rest(folded(0), BOOK)(book), np.zeros(4))


# Both


@pytest.mark.parametrize("name", MEASURES)
@given(st.tuples(*3 * [st.floats(-3, 3)]), st.tuples(*3 * [st.floats(-10, 10)]), st.sampled_from(sorted(AWKWARD)))
def test_rigid_motions_change_nothing(
    name: str, turn: tuple[float, float, float], move: tuple[float, float, float], mesh: str
) -> None:
    rest, faces = AWKWARD[mesh]
    assert MEASURES[name](rest, faces)(rest @ rotation(turn).T + np.array(move)).max() < 1e-9


@given(st.floats(0.01, 100), st.sampled_from(sorted(AWKWARD)))
def test_scaling_is_strain_and_no_bend(scale: float, mesh: str) -> None:
    rest, faces = AWKWARD[mesh]
    assert np.allclose(strain_from_rest(rest, faces)(scale * rest), abs(scale - 1), atol=1e-9)
    assert curvature_from_rest(rest, faces)(scale * rest).max() < 1e-9


@pytest.mark.parametrize("name", MEASURES)
def test_vertices_without_edges_or_hinges_have_nothing(name: str) -> None:
    rest = np.concatenate([folded(30), [[5.0, 5, 5]]])
    now = np.concatenate([2 * folded(60), [[9.0, 5, 5]]])
    assert MEASURES[name](rest, BOOK)(now)[4] == 0
    assert curvature_from_rest(rest, BOOK[:1])(now).tolist() == [0] * 5  # a triangle alone


@pytest.mark.parametrize("name", MEASURES)
def test_single_precision_is_widened(name: str) -> None:
    rest, faces = torus(9, 7)
    now = (1.1 * rest).astype(np.float32)
    single = rest.astype(np.float32)
    found = MEASURES[name](single, faces)(now)
    assert found.dtype == np.float64
    assert np.array_equal(found, MEASURES[name](single.astype(float), faces)(now.astype(float)))


def test_distances_are_in_diagonals() -> None:
    points = tetrahedron()[0]
    assert np.allclose(vertex_distances(points + np.array([0, 3, 4]), points, 10), 0.5)
