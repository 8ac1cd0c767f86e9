"""The one place where sequences are validated."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import FrozenInstanceError, dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import mixseq
from mixseq.choices import UNITS
from mixseq.errors import InvalidSequenceError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Origin, Surface
from mixseq.runtime import low_memory
from mixseq.runtime.low_memory import DiskArray
from mixseq.sequence.header import SequenceHeader, header_fields
from mixseq.sequence.sequence import (
    MeshSequence,
    UnitConversion,
    block_size,
    bounding_diagonal,
    check_block,
    check_frames,
    convert_units,
    iterate_blocks,
    join_blocks,
    largest_coordinate,
    largest_offset,
    load_frames,
    parse_unit,
    reference_diagonal,
    rounding_error,
)
from mixseq.types import FloatArray
from tests.meshes import bar


def points(frames: int = 3, vertices: int = 4) -> Any:
    return np.random.default_rng(0).normal(size=(frames, vertices, 3))


FACES = [[0, 1, 2], [0, 2, 3]]


def spoilt(value: float, frame: int = 1, vertex: int = 2) -> Any:
    result = points()
    result[frame, vertex, 1] = value
    return result


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "two dimensions": (
        lambda: MeshSequence.from_arrays(np.zeros((4, 3)), FACES),
        r"points have shape \(4, 3\); \(frames, vertices, 3\) is expected",
    ),
    "plane": (lambda: MeshSequence.from_arrays(np.zeros((2, 4, 2)), FACES), r"points have shape \(2, 4, 2\)"),
    "text": (lambda: MeshSequence.from_arrays([[["a", "b", "c"]] * 3], FACES), "points are not numbers"),
    "nan": (
        lambda: MeshSequence.from_arrays(spoilt(np.nan), FACES),
        r"frame 1: vertex 2 is \[.*nan.*\]; coordinates must be finite",
    ),
    "inf": (lambda: MeshSequence.from_arrays(spoilt(-np.inf, 0, 3), FACES), r"frame 0: vertex 3 is \[.*-inf"),
    "no frames": (lambda: MeshSequence.from_arrays(points(0), FACES), "the sequence has no frames"),
    "two vertices": (
        lambda: MeshSequence.from_arrays(points(2, 2), [[0, 1, 1]]),
        "the mesh has 2 vertices; at least 3 are needed",
    ),
    "no faces": (
        lambda: MeshSequence.from_arrays(points(), np.zeros((0, 3), dtype=int)),
        "the mesh has no faces; give a mesh with faces",
    ),
    "quads as faces": (
        lambda: MeshSequence.from_arrays(points(), [[0, 1, 2, 3]]),
        r"faces have shape \(1, 4\); \(F, 3\) is expected",
    ),
    "fractions": (
        lambda: MeshSequence.from_arrays(points(), [[0.0, 1.0, 2.0]]),
        "faces have type float64; integers are expected",
    ),
    "beyond": (
        lambda: MeshSequence.from_arrays(points(), [[0, 1, 2], [1, 2, 4]]),
        "face 1 uses vertex 4, but vertices are 0 to 3",
    ),
    "below": (lambda: MeshSequence.from_arrays(points(), [[0, 1, -1]]), "face 0 uses vertex -1"),
    "beyond in polygons": (
        lambda: MeshSequence.from_arrays(points(), Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 0, 1, 9]))),
        "face 1 uses vertex 9",
    ),
    "huge indices": (lambda: MeshSequence.from_arrays(points(), [[0, 1, 2**31]]), "faces do not fit into 32 bits"),
    "lines": (
        lambda: Polygons(np.array([3, 2]), np.array([0, 1, 2, 0, 1])),
        "polygon 1 has 2 corners; a face needs at least 3",
    ),
    "corners missing": (
        lambda: Polygons(np.array([3, 3]), np.array([0, 1, 2, 0, 1])),
        "add up to 6 but 5 corners are given",
    ),
    "too few times": (lambda: MeshSequence.from_arrays(points(), FACES, [0.0, 1.0]), "3 frames of points but 2 times"),
    "times stand still": (
        lambda: MeshSequence.from_arrays(points(), FACES, [0.0, 1.0, 1.0]),
        "frame 2 is at 1 s, not after frame 1 at 1 s; times must increase",
    ),
    "times run back": (lambda: MeshSequence.from_arrays(points(), FACES, [0.0, -1.0, 1.0]), "frame 1 is at -1 s"),
    "no time": (
        lambda: MeshSequence.from_arrays(points(), FACES, [0.0, np.nan, 1.0]),
        "frame 1: its time is not finite",
    ),
    "fps 0": (lambda: MeshSequence.from_arrays(points(), FACES, fps=0.0), "fps is 0.0; a positive number"),
    "fps nan": (
        lambda: MeshSequence.from_arrays(points(), FACES, [0, 1, 2], fps=np.nan),
        "fps is nan; a positive number",
    ),
    "no size": (
        lambda: MeshSequence.from_arrays(points(), FACES, metres_per_unit=-1),
        "metres_per_unit is -1.0; a positive number",
    ),
    "axis": (
        lambda: MeshSequence.from_arrays(points(), FACES, up_axis="z"),
        "up axis is 'z'; one of X, Y, Z is expected",
    ),
    "name": (lambda: MeshSequence.from_arrays(points(), FACES, name="a\0b"), "has characters that no file can hold"),
    "half a letter": (lambda: MeshSequence.from_arrays(points(), FACES, name="\ud800"), "no file can hold"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_a_sequence_is_refused(name: str) -> None:
    make, message = BAD[name]
    with pytest.raises(InvalidSequenceError, match=message):
        make()


def test_defaults() -> None:
    sequence = MeshSequence.from_arrays(points(), FACES)
    np.testing.assert_allclose(sequence.times, [0, 1 / 24, 2 / 24])
    assert (sequence.fps, sequence.up_axis, sequence.metres_per_unit, sequence.name) == (24, "Y", 1, "mesh")
    assert (len(sequence), sequence.frame_count, sequence.vertex_count) == (3, 3, 4)
    assert repr(sequence) == "MeshSequence('mesh': 3 frames, 4 vertices, 2 faces, 24 fps)"


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [(np.float32, np.float32), (np.float64, np.float64), (np.int16, np.float64), (np.float16, np.float64)],
)
def test_points_keep_single_and_double_precision(dtype: type, kept: type) -> None:
    array: NDArray[Any] = np.arange(36).reshape(3, 4, 3).astype(dtype)
    sequence = MeshSequence.from_arrays(array, FACES)
    assert sequence.points.dtype == kept
    np.testing.assert_array_equal(sequence.points, array)


def test_polygons_are_fanned_about_their_first_corners() -> None:
    polygons = Polygons(np.array([5, 3, 4]), np.array([4, 0, 1, 2, 3, 7, 8, 9, 5, 6, 1, 0]))
    assert polygons.triangles.tolist() == [[4, 0, 1], [4, 1, 2], [4, 2, 3], [7, 8, 9], [5, 6, 1], [5, 1, 0]]
    assert polygons.triangles.dtype == np.int32
    assert not polygons.only_triangles
    assert Polygons.from_triangles(FACES).only_triangles
    assert Polygons.from_triangles(FACES).triangles.tolist() == FACES


def test_the_triangulation_does_not_depend_on_the_pose() -> None:
    """A quad that is folded along one diagonal or the other has the same triangles."""
    quad = Polygons(np.array([4]), np.array([0, 1, 2, 3]))
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for corner in range(4):
        folded = flat.copy()
        folded[corner, 2] = 0.9
        sequence = MeshSequence.from_arrays(folded[None], quad)
        assert sequence.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_polygons_are_compared_corner_by_corner() -> None:
    quad = Polygons(np.array([4]), np.array([0, 1, 2, 3]))
    assert quad.same_as(Polygons(np.array([4]), np.array([0, 1, 2, 3])))
    assert not quad.same_as(Polygons(np.array([4]), np.array([1, 2, 3, 0])))
    assert not quad.same_as(Polygons.from_triangles(FACES))


def whole() -> MeshSequence:
    return MeshSequence.from_arrays(
        points(), Polygons(np.array([4]), np.arange(4)), [0.5, 0.75, 2.0], 30, "Z", 0.01, "läufer"
    )


def test_a_sequence_is_its_header_and_its_points() -> None:
    sequence = whole()
    header = sequence.header
    assert type(header) is SequenceHeader
    again = MeshSequence.from_header(header, sequence.points)
    assert header_fields(again).keys() == header_fields(sequence).keys()
    for name, value in header_fields(sequence).items():
        assert getattr(again, name) is value or np.array_equal(getattr(again, name), value), name
    np.testing.assert_array_equal(again.points, sequence.points)
    assert (header.vertex_count, header.frame_count, header.fps, header.up_axis) == (4, 3, 30, "Z")


def test_other_times_and_other_points() -> None:
    sequence = whole()
    header = sequence.header.with_times([1, 2], fps=5)
    assert (header.times.tolist(), header.fps, header.name) == ([1.0, 2.0], 5, "läufer")
    assert header.polygons is sequence.polygons
    assert sequence.header.with_times([0.0]).fps == 30
    doubled = sequence.with_points(2 * sequence.points)
    np.testing.assert_array_equal(doubled.points, 2 * sequence.points)
    np.testing.assert_array_equal(doubled.times, sequence.times)
    with pytest.raises(InvalidSequenceError, match=r"frame 15 \(index 0\) has 5 vertices, the mesh has 4"):
        sequence.with_points(points(3, 5))


def test_sequences_do_not_change() -> None:
    sequence = whole()
    for array in (sequence.points, sequence.times, sequence.polygons.counts, sequence.polygons.indices, sequence.faces):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(FrozenInstanceError):
        sequence.fps = 12.0  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError):
        sequence.points = points()  # type: ignore[misc]


def test_the_callers_array_stays_writeable() -> None:
    mine = points()
    MeshSequence.from_arrays(mine, FACES)
    mine[0] = 0.0


def test_diagonal() -> None:
    box = np.array([[[0.0, 0, 0], [1, 2, 2], [0.5, 1, 1]]] * 2)
    box[1] *= 10
    assert MeshSequence.from_arrays(box, [[0, 1, 2]]).diagonal == pytest.approx(3)
    assert bounding_diagonal(box[1]) == pytest.approx(30)
    assert bounding_diagonal(np.full((3, 3), 3e38, dtype=np.float32)) == 0
    wide = np.array([[-3e38, 0, 0], [3e38, 0, 0]], dtype=np.float32)
    assert bounding_diagonal(wide) == pytest.approx(6e38)  # more than float32 holds


@given(
    exponent=st.integers(-190, 190),
    offset=st.sampled_from([0.0, 1.0, 1e3]),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_the_diagonal_of_a_mesh_that_grows_from_a_point_scales_with_it(
    exponent: int, offset: float, dtype: type[np.floating]
) -> None:
    exponent //= 4 if dtype is np.float32 else 1
    box = np.array([[0.0, 0, 0], [1, 2, 2], [0.5, 1, 1]])
    grown = np.stack([0 * box, 3 * box, 2 * box]) + offset
    points = np.ldexp(grown, exponent).astype(dtype)
    assert reference_diagonal(iter([points])).length == pytest.approx(np.ldexp(9.0, exponent), rel=1e-3)
    assert MeshSequence.from_arrays(points, [[0, 1, 2]]).diagonal == reference_diagonal([points]).length
    points[0] = np.ldexp(offset + 1e-3 * box, exponent)  # small, but no point
    small = np.ldexp(3e-3, exponent)
    assert reference_diagonal([points]).length == pytest.approx(small, rel=0.1)


def test_a_point_up_to_rounding() -> None:
    box = np.array([[0.0, 0, 0], [1, 2, 2], [0.5, 1, 1]])
    rounded = (np.pi + 3e-7 * box).astype(np.float32)
    assert 0 < bounding_diagonal(rounded) < 1e-6
    assert reference_diagonal([np.stack([rounded, np.float32(box)])]).length == pytest.approx(3)
    far = np.stack([box, 2 * box]) + 1e8  # of the same size as later frames
    assert reference_diagonal([far]).length == pytest.approx(3)
    assert reference_diagonal([np.ones((3, 4, 3))]).length == 0


def test_blocks_after_the_first_are_read_only_for_a_point() -> None:
    box = np.array([[0.0, 0, 0], [1, 2, 2]])

    def blocks(first: FloatArray) -> Iterator[FloatArray]:
        yield first[None]
        raise InterruptedError

    assert reference_diagonal(blocks(box)).length == pytest.approx(3)
    with pytest.raises(InterruptedError):
        reference_diagonal(blocks(0 * box))


def test_blocks_are_collected() -> None:
    sequence = whole()
    gathered = join_blocks(sequence.header, iter([sequence.points[:1], sequence.points[1:]]))
    np.testing.assert_array_equal(gathered.points, sequence.points)
    with pytest.raises(InvalidSequenceError, match="0 frames of points but 3 times"):
        join_blocks(sequence.header, iter([]))


def test_blocks_are_checked_by_the_frames_they_hold() -> None:
    header = whole().header
    check_block(header, points(2), first_frame=100)
    with pytest.raises(InvalidSequenceError, match="frame 101: vertex 2 is"):
        check_block(header, spoilt(np.nan), first_frame=100)
    with pytest.raises(InvalidSequenceError, match="frame 100 has 7 vertices, the mesh has 4"):
        check_block(header, points(2, 7), first_frame=100)
    with pytest.raises(InvalidSequenceError, match=r"points have shape \(4, 3\)"):
        check_block(header, points()[0], first_frame=0)


@pytest.mark.parametrize("wrong", ["walk.npz", np.zeros((2, 3, 3)), None])
def test_what_is_no_sequence_is_refused(wrong: object) -> None:
    with pytest.raises(InvalidSequenceError, match="a MeshSequence or an open sequence is expected, not"):
        check_frames(wrong)


# Sequences in other units: what they are in the world stays

CORNER = [[[0.0, 0, 0], [1, 2, 3], [4, 0, 0]]]


def sequence(dtype: type = np.float64, **header: object) -> MeshSequence:
    made = MeshSequence.from_arrays(np.array(CORNER, dtype), [[0, 1, 2]], **header)  # type: ignore[arg-type]
    return replace(made, velocities=np.array(CORNER, dtype) * 10)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("Y", "Z", [1, -3, 2]),
        ("Z", "Y", [1, 3, -2]),
        ("X", "Y", [-2, 1, 3]),
        ("Y", "X", [2, -1, 3]),
        ("X", "Z", [-3, 2, 1]),
        ("Z", "X", [3, 2, -1]),
        ("Y", "Y", [1, 2, 3]),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_turned(old: str, new: str, expected: list[float], dtype: type) -> None:
    turned = convert_units(sequence(dtype, up_axis=old), up_axis=new)
    assert turned.up_axis == new
    assert turned.points.dtype == dtype
    assert turned.points[0, 1].tolist() == expected
    assert turned.velocities is not None
    np.testing.assert_array_equal(turned.velocities, 10 * turned.points)
    assert "XYZ"[int(np.argmax(turned.points[0, 1] == [1, 2, 3]["XYZ".index(old)]))] == new


def test_faces_keep_their_side() -> None:
    """A rotation turns no mesh inside out."""
    for old in "XYZ":
        for new in "XYZ":
            assert np.linalg.det(UnitConversion.from_header(sequence(up_axis=old), new).rotation) == pytest.approx(1)


def test_scaled() -> None:
    small = convert_units(sequence(metres_per_unit=0.01), units="m")
    assert small.metres_per_unit == 1
    np.testing.assert_array_equal(small.points, 0.01 * np.array(CORNER))
    assert convert_units(sequence(), units="ft").points[0, 2, 0] == pytest.approx(4 / 0.3048)


@pytest.mark.parametrize("units", [*UNITS, 0.5])
def test_there_and_back(units: str | float) -> None:
    once = convert_units(sequence(np.float32), up_axis="Z", units=units)
    back = convert_units(once, up_axis="Y", units="m")
    np.testing.assert_allclose(back.points, np.array(CORNER), rtol=1e-6)
    assert (back.up_axis, back.metres_per_unit) == ("Y", 1)


def test_nothing_to_do_changes_no_bit() -> None:
    before = sequence(np.float32, up_axis="Z", metres_per_unit=0.01)
    after = mixseq.convert_units(before, up_axis="Z", units="cm")
    assert not UnitConversion.from_header(before.header, "Z", 0.01).changes
    assert after.points.tobytes() == before.points.tobytes()
    assert after.header.surface is before.header.surface


@pytest.mark.parametrize(("form", "kept"), [("USD", True), ("Alembic", False)])
def test_files_that_do_not_tell_their_units_are_forgotten(form: str, kept: bool) -> None:
    origin = Origin(form, "/shot")
    before = replace(sequence(), surface=Surface(origin=origin))
    assert (convert_units(before, units="cm").surface.origin == origin) is kept
    assert convert_units(before, units="m").surface.origin == origin


def test_refusals() -> None:
    with pytest.raises(SettingsError, match="up_axis is 'W'; one of X, Y, Z"):
        convert_units(sequence(), up_axis="W")
    for units in ("parsec", 0, -1, "nan", "inf"):
        with pytest.raises(SettingsError, match=f"the unit is {units!r}; one of mm, cm, m"):
            parse_unit(units)


# What streams is copied once, and checked on the way

BAR = bar(sides=4, rings=5, frames=7)


@dataclass
class Streamed:
    """A sequence that is given in blocks, and counts how often."""

    header: SequenceHeader
    given: list[FloatArray]
    times: int = 0

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        self.times += 1
        yield from self.given


def test_what_is_in_memory_stays_there() -> None:
    assert load_frames(BAR).points is BAR.points
    assert [len(block) for block in BAR.blocks(3)] == [3, 3, 1]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("limit", [0, 1 << 30])
def test_what_streams_is_read_once(dtype: type, limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(low_memory, "MAX_BYTES_IN_MEMORY", limit)
    points: FloatArray = BAR.points.astype(dtype)
    source = Streamed(BAR.header, [points[:2], points[2:3], points[3:]])
    told: list[tuple[int, int, str]] = []
    copy = load_frames(source, lambda *step: told.append(step))
    assert isinstance(copy.points, DiskArray) == (limit == 0)
    assert copy.points.dtype == dtype
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate(list(iterate_blocks(copy.points))), points)
    assert source.times == 1
    assert [done for done, _, _ in told] == [2, 3, 7]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        ([BAR.points[:5]], "5 frames of points but 7 times"),
        ([], "0 frames of points but 7 times"),
        ([BAR.points, BAR.points], "more frames than the 7 times"),
        ([BAR.points[:, 1:]], "frame 0 has 21 vertices, the mesh has 22"),
        ([BAR.points[:3], np.full((4, 22, 3), np.nan)], r"frame 3: vertex 0 .* must be finite"),
    ],
)
def test_unsound_streams_are_refused(frames: list[FloatArray], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        load_frames(Streamed(BAR.header, frames))


@pytest.mark.parametrize(
    ("factor", "offset", "message"),
    [
        (1e-310, 0.0, "e-310 units across, .* from 1e-60 to 1e.60 is expected"),
        (1e-61, 0.0, "e-61 units across"),
        (1e61, 0.0, r"e\+61 units across"),
        (1e307, 0.0, "units across"),
        (1.0, 1e200, r"coordinates are up to 1e\+200 units"),
    ],
)
@pytest.mark.parametrize("streams", [False, True])
def test_lengths_whose_squares_do_not_fit_are_refused(
    factor: float, offset: float, message: str, streams: bool
) -> None:
    points = BAR.points.copy()
    points[3] += offset
    far = BAR.with_points(points * factor)
    with pytest.raises(InvalidSequenceError, match=f"^{far.header.name!r}: .*{message}"):
        load_frames(Streamed(far.header, [far.points]) if streams else far)


def test_a_first_frame_that_is_one_point_may_be_anywhere() -> None:
    point = BAR.with_points(np.full_like(BAR.points, 1e59))
    assert load_frames(point).points is point.points
    assert rounding_error(largest_coordinate(point.points)) == 1e59 * 2.0**-40


def test_how_far_vertices_get_does_not_depend_on_the_origin() -> None:
    triangle = np.array([[0.0, 0, 0], [2, 0, 0], [0, 4, 0]])
    points = np.stack([triangle, 10 * triangle]) + np.array([100.0, -1000, 0])
    assert largest_offset(points) == 38.0
    assert largest_coordinate(points) == 1000.0


def test_blocks_depend_on_the_mesh_only() -> None:
    assert [block_size(count) for count in (3, 100_000, 169_000, 1 << 20, 1 << 24)] == [8, 8, 6, 1, 1]
    long = MeshSequence.from_arrays(np.zeros((20, 3, 3)), [[0, 1, 2]])
    assert [len(block) for block in iterate_blocks(long.points)] == [8, 8, 4]


def test_frames_by_index() -> None:
    sequence = replace(bar(frames=4), velocities=np.ones((4, 202, 3)))
    np.testing.assert_array_equal(sequence[-1], sequence.points[3])
    np.testing.assert_array_equal(list(sequence), sequence.points)
    middle = sequence[1:3]
    np.testing.assert_array_equal(middle.points, sequence.points[1:3])
    np.testing.assert_array_equal(middle.times, sequence.times[1:3])
    assert middle.velocities is not None and len(middle.velocities) == 2
    with pytest.raises(IndexError):
        sequence[4]


def test_a_frame_in_trimesh() -> None:
    sequence = bar(frames=4)
    mesh = sequence.to_trimesh(2)
    np.testing.assert_array_equal(mesh.vertices, sequence.points[2])
    np.testing.assert_array_equal(mesh.faces, sequence.faces)


def test_notebooks_show_a_table() -> None:
    html = replace(bar(frames=4), name="<b>ar")._repr_html_()
    assert "<caption>&lt;b&gt;ar</caption>" in html
    assert "<th>vertices</th><td>202</td>" in html
