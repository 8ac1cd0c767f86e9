"""Colours: bytes and floats, from file to file, and what becomes of them where a format has less room."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

import mixseq
from mixseq.choices import OrderName
from mixseq.compression.numbering import cheapest_numbering
from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import FrameStore, MeshSequence
from mixseq.types import FloatArray, IntArray
from mixseq_io import read, write, write_blocks
from mixseq_io.numbered.files import parse_colours
from mixseq_io.surfaces import (
    SURFACE_ARRAY_NAMES,
    VISIBLE_ERROR_DIAGONALS,
    Arrays,
    RoundingMonitor,
    bytes_to_colours,
    clip_to_unit,
    colours_to_bytes,
    colours_to_exact_bytes,
    ensure_alpha,
    scale_text_colours,
    surface_from_arrays,
    surface_to_arrays,
)
from tests.formats.conftest import fan, painted, wave
from tests.meshes import bar
from tests.promises import distance


def coloured(sequence: MeshSequence, values: FloatArray, indices: IntArray) -> MeshSequence:
    return replace(sequence, surface=replace(sequence.surface, colours=CornerValues(values, indices)))


def square(values: FloatArray, indices: IntArray | None = None) -> MeshSequence:
    """Two triangles with a colour at every vertex, or as indices tell."""
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)[None]
    sequence = MeshSequence.from_arrays(points, [[0, 1, 2], [0, 2, 3]])
    return coloured(sequence, values, sequence.polygons.indices if indices is None else indices)


def colours(sequence: SequenceHeader) -> NDArray[np.float32]:
    assert sequence.surface.colours is not None
    return sequence.surface.colours.at_corners


def test_all_bytes_are_bytes_again() -> None:
    every = np.arange(256, dtype=np.uint8)
    np.testing.assert_array_equal(colours_to_exact_bytes(bytes_to_colours(every)), every)
    # However a program divides by 255, the nearest float32 is the same.
    np.testing.assert_array_equal(bytes_to_colours(every), (every / 255).astype(np.float32))
    np.testing.assert_array_equal(bytes_to_colours(every)[[0, 51, 255]], np.array([0, 0.2, 1], np.float32))


@given(arrays(np.float32, (3, 4), elements=st.floats(0, 1, width=32)))
def test_floats_are_bytes_only_if_nothing_is_lost(values: NDArray[np.float32]) -> None:
    exact = colours_to_exact_bytes(values)
    if exact is None:
        assert (bytes_to_colours(colours_to_bytes(values)) != values).any()
        assert np.abs(bytes_to_colours(colours_to_bytes(values)) - values).max() <= 0.5001 / 255
    else:
        np.testing.assert_array_equal(bytes_to_colours(exact), values)


def test_what_is_no_byte() -> None:
    for value in (0.3, -0.0001, 1.5, np.nan):
        assert colours_to_exact_bytes(np.array([0.0, value], np.float32)) is None
    np.testing.assert_array_equal(clip_to_unit(np.array([-1, 0.5, 2, np.nan])), [0, 0.5, 1, 0])
    np.testing.assert_array_equal(colours_to_bytes(np.array([-1, 0.5, 2, np.nan])), [0, 128, 255, 0])


def test_alpha_and_texts() -> None:
    assert ensure_alpha(np.array([[0.1, 0.2, 0.3]])).tolist() == [[0.1, 0.2, 0.3, 1.0]]
    assert ensure_alpha(np.array([[0.1, 0.2, 0.3, 0.4]])).tolist() == [[0.1, 0.2, 0.3, 0.4]]
    assert scale_text_colours(np.array([[0, 255, 51]])).tolist() == [[0, 1, 0.2]]
    assert scale_text_colours(np.zeros((0, 3))).shape == (0, 3)
    assert scale_text_colours(np.array([[np.nan, 255, 51]]))[0, 1:].tolist() == [1, 0.2]


@pytest.mark.parametrize(
    ("largest", "divisor"), [(1, 1), (1.00001, 1), (1.5, 1), (2, 1), (16, 1), (16.5, 255), (254.5, 255), (255, 255)]
)
def test_the_largest_number_tells_bytes(largest: float, divisor: float) -> None:
    for low in (0, 0.5):
        numbers = np.array([[low, 1.0, largest]])
        np.testing.assert_array_equal(scale_text_colours(numbers), numbers / divisor)


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply"])
def test_bytes_that_are_not_whole_and_bright_whole_numbers(name: str, tmp_path: Path) -> None:
    faces = {"a.obj": "f 1 2 3", "a.off": "3 0 1 2", "a.ply": "3 0 1 2"}[name]
    head = {
        "a.obj": "",
        "a.off": "COFF\n3 1 0\n",
        "a.ply": "ply\nformat ascii 1.0\nelement vertex 3\n"
        + "".join(f"property float {each}\n" for each in ("x", "y", "z", "red", "green", "blue"))
        + "element face 1\nproperty list uchar int vertex_indices\nend_header\n",
    }[name]
    for red, green, expected in ((127.5, 255, [0.5, 1]), (2, 1, [2, 1])):
        text = "".join(f"{'v ' * (not head)}{n} {n * n} 0 {red} {green} 0\n" for n in range(3))
        (tmp_path / name).write_text(f"{head}{text}{faces}\n")
        np.testing.assert_allclose(colours(read(tmp_path / name))[:, :2], [expected] * 3)


def test_bytes_stay_bytes_in_arrays() -> None:
    assert surface_to_arrays(painted().surface)["colour_values"].dtype == np.uint8
    assert surface_to_arrays(square(np.full((4, 4), 0.3)).surface)["colour_values"].dtype == np.float32


BEYOND = np.array([[-0.5, 0, 0, 1], [0.25, 0, 0, 1], [2, 0, 0, 1], [0, 0.1, 0, 1]], np.float32)


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply", "a.glb", "a.pc2"])
def test_colours_beyond_white_are_cut_with_a_warning(name: str, tmp_path: Path) -> None:
    with pytest.warns(MixseqWarning, match=r"cannot hold .*colours below 0 and above 1 \(0 and 1 are written\)"):
        write(tmp_path / name, square(BEYOND))
    np.testing.assert_allclose(colours(read(tmp_path / name)), colours(square(clip_to_unit(BEYOND))), atol=1e-7)


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply"])
@pytest.mark.parametrize(
    ("odd", "told"),
    [
        (np.nan, "colours that are no numbers (0 is written)"),
        (-0.5, "colours below 0 (0 is written)"),
        (np.inf, "colours above 1 (1 is written)"),
    ],
)
def test_warnings_say_what_is_lost_and_no_more(name: str, odd: float, told: str, tmp_path: Path) -> None:
    values = np.full((4, 4), 0.3)
    values[:, 3] = 1
    values[2, 1] = odd
    with pytest.warns(MixseqWarning, match=rf"cannot hold {re.escape(told)}; USD"):
        write(tmp_path / name, square(values))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.obj", "v 0 0 0 1e300 0 0\nv 1 0 0 0 0 0\nv 0 1 0 0 0 0\nf 1 2 3\n"),
        ("a.off", "COFF\n3 1 0\n0 0 0 1e300 0 0\n1 0 0 0 0 0\n0 1 0 0 0 0\n3 0 1 2\n"),
    ],
)
def test_colours_beyond_single_precision_are_very_bright(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    assert colours(read(tmp_path / name))[0].tolist() == [np.inf, 0, 0, 1]


def test_what_is_not_written_is_not_lost(tmp_path: Path) -> None:
    """Corners that differ in what is cut off or in alpha only have one colour; rows of no corner have none."""
    values = np.array([[0.3, 1.5, 0, 1], [0.3, 2.5, 0, 0.5], [-1, -1, -1, 0]])
    with pytest.warns(MixseqWarning, match=r"cannot hold colours above 1 \(1 is written\), the alpha of colours; USD"):
        write(tmp_path / "a.obj", square(values, np.array([0, 0, 0, 1, 1, 1])))


@pytest.mark.parametrize("suffix", ["obj", "off", "ply"])
def test_colours_that_change_over_frames_are_told_once(suffix: str, tmp_path: Path) -> None:
    ramp = np.array([[n / 8, 0, 0, 1] for n in range(4)])
    for frame, values in enumerate((ramp, ramp, ramp[::-1], ramp[[1, 1, 1, 1]])):
        write(tmp_path / f"a_{frame}.{suffix}", square(values))
    with pytest.warns(MixseqWarning) as caught:
        got = read(tmp_path / f"a_#.{suffix}")
    (told,) = (str(each.message) for each in caught)
    assert "colours that change over time stay as they are in the first frame" in told
    assert f"a_2.{suffix} (frame 2) has others" in told
    np.testing.assert_array_equal(colours(got), ramp[square(ramp).polygons.indices].astype(np.float32))


@pytest.mark.parametrize("suffix", ["obj", "off", "ply"])
def test_colours_that_come_or_go_are_told(suffix: str, tmp_path: Path) -> None:
    painted_square = square(np.where(np.arange(4) == 3, 1, np.eye(4)))
    plain = replace(painted_square, surface=Surface())
    for first, second in ((painted_square, plain), (plain, painted_square)):
        write(tmp_path / f"a_0.{suffix}", first)
        write(tmp_path / f"a_1.{suffix}", second)
        with pytest.warns(MixseqWarning, match="colours that change over time"):
            read(tmp_path / f"a_#.{suffix}")


@pytest.mark.parametrize("first", [" 1 0 0", ""], ids=["colours", "none"])
@pytest.mark.parametrize("suffix", ["obj", "off"])
def test_colours_that_cannot_be_read_later_are_others(suffix: str, first: str, tmp_path: Path) -> None:
    for frame, colour in enumerate((first, first, " 1 red 0", " x x x")):
        rows = "".join(f"{'v ' * (suffix == 'obj')}{n} {n * n} {frame}{colour}\n" for n in range(3))
        text = f"{rows}f 1 2 3\n" if suffix == "obj" else f"COFF\n3 1 0\n{rows}3 0 1 2\n"
        (tmp_path / f"a_{frame}.{suffix}").write_text(text)
    with pytest.warns(MixseqWarning) as caught:
        got = read(tmp_path / f"a_#.{suffix}")
    (told,) = (str(each.message) for each in caught)
    assert f"a_2.{suffix} (frame 2) has others" in told
    assert got.points[:, 0, 2].tolist() == [0, 1, 2, 3]
    assert (got.surface.colours is None) == (first == "")


@pytest.mark.parametrize("suffix", ["obj", "off"])
def test_colours_are_parsed_no_more_often_than_needed(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not where their text is that of the first frame, and not after the warning."""
    ramp = np.array([[n / 8, 0, 0, 1] for n in range(4)])
    for frame, values in enumerate((ramp, ramp, ramp[::-1], ramp[[1, 1, 1, 1]], ramp)):
        write(tmp_path / f"a_{frame}.{suffix}", square(values))
    parsed = []

    def logged(file: Path, *rest: Any) -> FloatArray:
        parsed.append(file.name)
        return parse_colours(file, *rest)

    for parser in ("obj", "stl_off"):
        monkeypatch.setattr(f"mixseq_io.numbered.{parser}.parse_colours", logged)
    with pytest.warns(MixseqWarning, match=rf"a_2.{suffix} \(frame 2\) has others"):
        read(tmp_path / f"a_#.{suffix}")
    assert parsed == [f"a_0.{suffix}", f"a_2.{suffix}"]


@pytest.mark.parametrize("name", ["a.usda", "a.npz", "a.h5", "a.abc"])
def test_colours_beyond_white_are_kept(name: str, tmp_path: Path) -> None:
    write(tmp_path / name, square(BEYOND))
    np.testing.assert_array_equal(colours(read(tmp_path / name)), colours(square(BEYOND)))


@pytest.mark.parametrize(("name", "alpha"), [("a.obj", 1.0), ("a.off", 0.5)])
def test_vertices_have_the_colour_of_their_first_corner(name: str, alpha: float, tmp_path: Path) -> None:
    reds = np.array([[n / 8, 0, 0, 0.5] for n in range(6)], np.float32)
    told = "several colours at a vertex" + (", the alpha of colours" if alpha == 1 else "")
    told = told.replace(",", r" \(that of its first corner is written\),")
    with pytest.warns(MixseqWarning, match=told):
        write(tmp_path / name, square(reds, np.arange(6)))
    got = colours(read(tmp_path / name))
    np.testing.assert_array_equal(got[:, 0], np.array([0, 1, 2, 0, 2, 5]) / 8)
    np.testing.assert_array_equal(got[:, 3], alpha)


def test_one_colour_at_a_vertex_is_no_loss(tmp_path: Path) -> None:
    """Rows differ from corner to corner, as of readers that have a row for each; values do not."""
    mesh = square(np.eye(4))
    apart = coloured(mesh, np.array(colours(mesh)), np.arange(6))
    apart = coloured(mesh, np.where(np.arange(4) == 3, 1, apart.surface.colours.values), np.arange(6))  # type: ignore[union-attr]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name in ("a.obj", "a.off", "a.ply"):
            write(tmp_path / name, apart)
            np.testing.assert_array_equal(colours(read(tmp_path / name)), colours(apart))


@pytest.fixture(scope="module")
def painted_bar() -> MeshSequence:
    """A bending bar with a colour at every vertex, and one polygon in nine of another colour."""
    sequence = bar(5, 9, 4)
    rng = np.random.default_rng(8)
    values = bytes_to_colours(rng.integers(0, 256, (sequence.vertex_count + 1, 4)).astype(np.uint8))
    ninth = np.repeat(np.arange(len(sequence.polygons.counts)) % 9 == 0, 3)
    return coloured(sequence, values, np.where(ninth, sequence.vertex_count, sequence.polygons.indices))


@pytest.mark.parametrize("of", ["corners", "vertices", "floats"])
@pytest.mark.parametrize("order", ["keep", "vertices", "free"])
def test_compressed_files_keep_every_bit(painted_bar: MeshSequence, of: str, order: OrderName, tmp_path: Path) -> None:
    sequence = painted_bar
    if of != "corners":
        values = np.array(sequence.surface.colours.values) ** (1 if of == "vertices" else 1.5)  # type: ignore[union-attr]
        sequence = coloured(sequence, values[:-1], sequence.polygons.indices)
    coded = mixseq.compress(sequence, max_error=0.01, order=order)
    expected = cheapest_numbering(sequence.header, order).renumber_header(sequence.header)
    for name in ("a.h5", "a.glb"):
        mixseq.save(tmp_path / name, coded)
        got = mixseq.load(tmp_path / name).header
        assert got.polygons.same_as(expected.polygons)
        np.testing.assert_array_equal(colours(got), colours(expected))


def test_colours_of_vertices_take_a_byte_for_a_channel_at_most(painted_bar: MeshSequence, tmp_path: Path) -> None:
    """Noise cannot be packed: what is left is the index of corners, which is not stored."""
    plain = replace(painted_bar, surface=Surface())
    assert painted_bar.surface.colours is not None
    values = painted_bar.surface.colours.values[:-1]
    sizes = []
    for sequence in (plain, coloured(plain, values, plain.polygons.indices)):
        mixseq.save(tmp_path / "a.h5", mixseq.compress(sequence, max_error=0.01))
        sizes.append((tmp_path / "a.h5").stat().st_size)
    assert 0 < sizes[1] - sizes[0] <= values.size + 120


def test_models_and_operations_carry_them(painted_bar: MeshSequence, tmp_path: Path) -> None:
    mixseq.save(tmp_path / "a.h5", mixseq.fit(painted_bar, space="vertex"))
    model = mixseq.load(tmp_path / "a.h5")
    np.testing.assert_array_equal(colours(model.sample()), colours(painted_bar))


@pytest.mark.realdata
def test_a_painted_character_through_all_formats(data: Path, tmp_path: Path) -> None:
    """CesiumMan, painted by height, is the same in each format and in each after another."""
    man = read(data / "gltf" / "CesiumMan.glb")
    man = MeshSequence.from_header(man.header.with_times(man.times[:2]), man.points[:2])
    height = man.points[0, :, 2]
    shade = np.rint(255 * (height - height.min()) / np.ptp(height)).astype(np.uint8)
    values = bytes_to_colours(np.column_stack([shade, 255 - shade, shade // 2, np.full_like(shade, 255)]))
    man = coloured(man, values, man.polygons.indices)
    man = replace(man, surface=replace(man.surface, origin=None))
    for name in ("a.glb", "a.usdc", "a.abc", "a.npz", "a.h5", "a_####.ply", "a_####.obj", "a_####.off"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MixseqWarning)
            write(tmp_path / name, mixseq.sequence.sequence.join_blocks(man.header, man.blocks()))
        got = read(tmp_path / name)
        assert got.surface.colours is not None
        at_vertices = got.surface.colours.at_vertices(got.polygons.indices, got.vertex_count, np.zeros(4))  # type: ignore[arg-type]
        np.testing.assert_array_equal(at_vertices, values, err_msg=name)


# Surfaces as arrays: there and back, and what is refused


def full() -> Surface:
    return Surface(
        uvs=CornerValues(np.random.default_rng(1).random((5, 2)), np.arange(7) % 5),
        colours=CornerValues(np.random.default_rng(2).random((3, 4)), np.arange(7) % 3),
        hard_edges=np.arange(7)[::-1],
        face_sets=(FaceSet("Hände", np.array([0, 1]), "/Looks/Haut 皮"), FaceSet("empty", np.array([], dtype=int))),
        objects=(MeshObject("a", "/w/a", 4, 1), MeshObject("ä", "/w/ä", 3, 1, subdivision="none")),
        subdivision="loop",
        origin=Origin("glTF", "/tmp/走る.glb"),
    )


def test_there_and_back() -> None:
    surface = full()
    arrays = surface_to_arrays(surface)
    assert set(arrays) == set(SURFACE_ARRAY_NAMES)
    got = surface_from_arrays(arrays)
    assert got.uvs is not None and surface.uvs is not None
    np.testing.assert_array_equal(got.uvs.values, surface.uvs.values)
    np.testing.assert_array_equal(got.uvs.indices, surface.uvs.indices)
    assert got.colours is not None and surface.colours is not None
    np.testing.assert_array_equal(got.colours.values, surface.colours.values)
    np.testing.assert_array_equal(got.colours.indices, surface.colours.indices)
    assert got.hard_edges is not None
    assert got.hard_edges.tolist() == [6, 5, 4, 3, 2, 1, 0]
    assert [(each.name, each.polygons.tolist(), each.material) for each in got.face_sets] == [
        ("Hände", [0, 1], "/Looks/Haut 皮"),
        ("empty", [], ""),
    ]
    assert got.objects == surface.objects
    assert (got.subdivision, got.origin) == (surface.subdivision, surface.origin)


def test_nothing_is_nothing() -> None:
    assert surface_to_arrays(Surface()) == {}
    bare = surface_from_arrays({})
    assert bare.colours is None
    assert (bare.uvs, bare.hard_edges, bare.face_sets, bare.objects) == (None, None, (), ())
    assert (bare.subdivision, bare.origin) == ("none", None)


def without(*names: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {name: array for name, array in arrays.items() if name not in names}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("uv_indices"), "uv_indices of the surface are missing"),
        (without("colour_values"), "colour_values of the surface are missing"),
        (without("face_set_sizes", "face_set_names"), "face_set_names, face_set_sizes of the surface are missing"),
        (lambda a: a | {"face_set_sizes": np.array([1, 2])}, "do not fit each other"),
        (lambda a: a | {"face_set_sizes": np.array([3, -1])}, "do not fit each other"),
        (lambda a: a | {"object_sizes": np.zeros((2, 3), dtype=int)}, "do not fit each other"),
        (lambda a: a | {"object_subdivisions": np.array(["loop"])}, "schemes of subdivision do not fit"),
        (lambda a: a | {"creases": np.zeros(7)}, "creases of the surface are float64; integers are expected"),
        (lambda a: a | {"origin": np.array(["USD"])}, "not a format and a path"),
    ],
    ids=["half", "no colours", "two", "sum", "negative", "columns", "schemes", "floats", "origin"],
)
def test_refusals(change: Callable[[Arrays], Arrays], message: str) -> None:
    with pytest.raises(InvalidSequenceError, match=message):
        surface_from_arrays(change(surface_to_arrays(full())))


# Files of single precision tell when vertices are visibly off in them, and by how much

CLOUD = MeshSequence.from_arrays(wave(dtype=np.float64), fan(), name="cloud")


WITHOUT_NODES = ("a.pc2", "a.mdd")


def error_told(path: Path, sequence: MeshSequence) -> float:
    """Write frame by frame; return the error that a warning tells, 0 if there is none."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_blocks(path, sequence.header, list(sequence.blocks(1)))
    told = [re.search(r"off by up to (\S+) of the diagonal", str(each.message)) for each in caught]
    return max((float(found[1]) for found in told if found), default=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.usdc", "a.abc", "a.glb", "a.pc2", "a.mdd"])
def test_the_error_that_is_told_is_that_of_the_file(name: str, tmp_path: Path) -> None:
    for offset in (0.0, 100.0, 1e5, 1e8):
        far = CLOUD.with_points(CLOUD.points + offset)
        told = error_told(tmp_path / name, far)
        apart = np.linalg.norm(read(tmp_path / name).points.astype(np.float64) - far.points, axis=2)
        error = apart.max() / far.diagonal
        assert told == pytest.approx(error if error > VISIBLE_ERROR_DIAGONALS else 0.0, rel=0.06)
        assert (told > 0) is (offset >= 1e5 and name in WITHOUT_NODES)
        assert name in WITHOUT_NODES or error < 2e-7


@pytest.mark.parametrize("promised", [True, False])
@pytest.mark.parametrize("name", ["a.pc2", "a.mdd"])
def test_a_promised_bound_that_rounding_may_exceed_is_an_error(name: str, promised: bool, tmp_path: Path) -> None:
    """Encoders keep a margin for two roundings of the largest coordinate, if this is at most half of the bound."""
    far = CLOUD.with_points(CLOUD.points + 100.0)
    margin = 2 * 3**0.5 * 2.0**-24 * np.abs(far.points).max() / far.diagonal
    for bound, is_kept in ((1e-6, False), (1.99 * margin, False), (2.01 * margin, True), (1e-8, True)):
        header = FrameStore(far.header, far.points).trace(bound, promised)
        sequence = MeshSequence.from_header(header, far.points)
        if is_kept or not promised:
            assert error_told(tmp_path / name, sequence) == 0
        else:
            with pytest.raises(OutputError, match=f"exceed the promised {bound:g}; write .npz, .h5 or .ply, .*glTF"):
                write_blocks(tmp_path / f"new{name[1:]}", header, far.blocks(1))
            assert not (tmp_path / f"new{name[1:]}").exists()


@pytest.mark.parametrize("name", ["a.pc2", "a.mdd", "a.usdc", "a.usdz", "a.abc", "a.glb", "a.gltf"])
def test_a_file_that_would_break_a_promise_replaces_none(name: str, tmp_path: Path) -> None:
    """Where a format has a node for the origin, other numbers of large coordinates are beyond single precision."""
    apart = CLOUD.with_points(CLOUD.points + np.linspace(0, 1e3, CLOUD.vertex_count)[:, None])
    write(tmp_path / name, CLOUD)
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(OutputError, match="exceed the promised 2e-08"):
        write_blocks(tmp_path / name, FrameStore(apart.header, apart.points).trace(2e-8, True), apart.blocks(1))
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.* holds points in single precision")
@pytest.mark.parametrize("bound", [1e-3, 1e-5, 2e-6])
@pytest.mark.parametrize("offset", [0.0, 1e2, 1e4, 1e6])
def test_promised_bounds_hold_in_files_of_single_precision(bound: float, offset: float, tmp_path: Path) -> None:
    """Far away, an origin on a node keeps them; without nodes, files that break them are refused."""
    for precision in (np.float32, np.float64):
        far = CLOUD.with_points((CLOUD.points + offset).astype(precision))
        mixseq.save(tmp_path / "far.h5", mixseq.compress(far, max_error=bound, inbetweens=False))
        model = mixseq.load(tmp_path / "far.h5")
        for name in ("a.usdc", "a.abc", "a.glb", "a.pc2"):
            try:
                write(tmp_path / name, model)
            except OutputError:
                assert offset
                assert name in WITHOUT_NODES
            else:
                assert distance(far.points, read(tmp_path / name).points) <= bound


def test_a_mesh_that_grows_from_a_point_is_measured_in_its_size(tmp_path: Path) -> None:
    popping = np.concatenate([0 * CLOUD.points[:1], 1e-3 * CLOUD.points])
    assert error_told(tmp_path / "a.pc2", MeshSequence.from_arrays(popping, CLOUD.faces)) == 0
    far = MeshSequence.from_arrays(popping + 100.0, CLOUD.faces)
    error = np.linalg.norm(far.points - far.points.astype(np.float32), axis=2).max() / far.diagonal
    assert error_told(tmp_path / "a.pc2", far) == pytest.approx(error, rel=0.5)
    assert error > VISIBLE_ERROR_DIAGONALS


@pytest.mark.parametrize("name", ["a.npz", "a_####.ply", "a_####.obj", "a_####.off"])
def test_doubles_are_not_off(name: str, tmp_path: Path) -> None:
    assert error_told(tmp_path / name, CLOUD.with_points(CLOUD.points + 1e8)) == 0


def test_a_warning_says_what_would_help(tmp_path: Path) -> None:
    far = CLOUD.with_points(CLOUD.points + np.array([0, 0, 0, 1e6, 1e4])[:, None, None])
    message = r"a\.pc2: PC2 holds points in single precision, .* most in frame 3; write \.npz, \.h5 or \.ply"
    with pytest.warns(MixseqWarning, match=message):
        write(tmp_path / "a.pc2", far)


def test_single_precision_stays_what_it_is(tmp_path: Path) -> None:
    assert error_told(tmp_path / "a.pc2", CLOUD.with_points((CLOUD.points + 1e8).astype(np.float32))) == 0


def monitored(*blocks: FloatArray) -> RoundingMonitor:
    rounding = RoundingMonitor(Path("a.pc2"), "PC2", CLOUD.header)
    list(rounding.watch(blocks))
    return rounding


def test_what_is_hardly_larger_than_zero_is_off() -> None:
    for points in (CLOUD.points, CLOUD.points * 1e-30, CLOUD.points * 1e-36):
        assert monitored(points).error < 1e-7
    rounding = monitored(CLOUD.points * 1e-310)
    largest = np.linalg.norm(CLOUD.points, axis=2).max() / CLOUD.diagonal
    assert rounding.error == pytest.approx(largest)


def test_frames_are_counted_over_blocks_of_both_precisions() -> None:
    exact = CLOUD.points.astype(np.float32)
    far = CLOUD.points + np.array([0, 0, 0, 1e6, 1e4])[:, None, None]
    rounding = monitored(exact, far, exact)
    assert rounding.frame == len(exact) + 3


def test_a_first_frame_that_is_one_point_has_the_diagonal_one() -> None:
    rounding = monitored(np.full((1, 4, 3), 1.0), np.full((1, 4, 3), 2.0**24 + 1))
    assert rounding.error == pytest.approx(3**0.5)
    assert rounding.frame == 1
