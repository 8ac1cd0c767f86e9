"""Colours: bytes and floats, from file to file, and what becomes of them where a format has less room."""

from __future__ import annotations

import re
import warnings
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
from mixseq.errors import MixseqWarning
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray, IntArray
from mixseq_io import read, write
from mixseq_io.numbered.files import colours_of_words
from mixseq_io.surfaces import (
    as_bytes,
    from_text,
    nearest_bytes,
    of_bytes,
    surface_arrays,
    with_alpha,
    within_one,
)
from tests.formats.conftest import painted
from tests.meshes import bar


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
    np.testing.assert_array_equal(as_bytes(of_bytes(every)), every)
    # However a program divides by 255, the nearest float32 is the same.
    np.testing.assert_array_equal(of_bytes(every), (every / 255).astype(np.float32))
    np.testing.assert_array_equal(of_bytes(every)[[0, 51, 255]], np.array([0, 0.2, 1], np.float32))


@given(arrays(np.float32, (3, 4), elements=st.floats(0, 1, width=32)))
def test_floats_are_bytes_only_if_nothing_is_lost(values: NDArray[np.float32]) -> None:
    exact = as_bytes(values)
    if exact is None:
        assert (of_bytes(nearest_bytes(values)) != values).any()
        assert np.abs(of_bytes(nearest_bytes(values)) - values).max() <= 0.5001 / 255
    else:
        np.testing.assert_array_equal(of_bytes(exact), values)


def test_what_is_no_byte() -> None:
    for value in (0.3, -0.0001, 1.5, np.nan):
        assert as_bytes(np.array([0.0, value], np.float32)) is None
    np.testing.assert_array_equal(within_one(np.array([-1, 0.5, 2, np.nan])), [0, 0.5, 1, 0])
    np.testing.assert_array_equal(nearest_bytes(np.array([-1, 0.5, 2, np.nan])), [0, 128, 255, 0])


def test_alpha_and_texts() -> None:
    assert with_alpha(np.array([[0.1, 0.2, 0.3]])).tolist() == [[0.1, 0.2, 0.3, 1.0]]
    assert with_alpha(np.array([[0.1, 0.2, 0.3, 0.4]])).tolist() == [[0.1, 0.2, 0.3, 0.4]]
    assert from_text(np.array([[0, 255, 51]])).tolist() == [[0, 1, 0.2]]
    assert from_text(np.zeros((0, 3))).shape == (0, 3)
    assert from_text(np.array([[np.nan, 255, 51]]))[0, 1:].tolist() == [1, 0.2]


@pytest.mark.parametrize(
    ("largest", "divisor"),
    [(1, 1), (1.00001, 1), (1.5, 1), (2, 1), (16, 1), (16.5, 255), (254.5, 255), (255, 255)],
)
def test_the_largest_number_tells_bytes(largest: float, divisor: float) -> None:
    for low in (0, 0.5):
        numbers = np.array([[low, 1.0, largest]])
        np.testing.assert_array_equal(from_text(numbers), numbers / divisor)


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
    assert surface_arrays(painted().surface)["colour_values"].dtype == np.uint8
    assert surface_arrays(square(np.full((4, 4), 0.3)).surface)["colour_values"].dtype == np.float32


BEYOND = np.array([[-0.5, 0, 0, 1], [0.25, 0, 0, 1], [2, 0, 0, 1], [0, 0.1, 0, 1]], np.float32)


@pytest.mark.parametrize("name", ["a.obj", "a.off", "a.ply", "a.glb", "a.pc2"])
def test_colours_beyond_white_are_cut_with_a_warning(name: str, tmp_path: Path) -> None:
    with pytest.warns(
        MixseqWarning, match=r"cannot hold .*colours below 0 and above 1 \(0 and 1 are written\)"
    ):
        write(tmp_path / name, square(BEYOND))
    np.testing.assert_allclose(colours(read(tmp_path / name)), colours(square(within_one(BEYOND))), atol=1e-7)


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
    with pytest.warns(
        MixseqWarning, match=r"cannot hold colours above 1 \(1 is written\), the alpha of colours; USD"
    ):
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
        return colours_of_words(file, *rest)

    for parser in ("obj", "stl_off"):
        monkeypatch.setattr(f"mixseq_io.numbered.{parser}.colours_of_words", logged)
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
    values = of_bytes(rng.integers(0, 256, (sequence.vertex_count + 1, 4)).astype(np.uint8))
    ninth = np.repeat(np.arange(len(sequence.polygons.counts)) % 9 == 0, 3)
    return coloured(sequence, values, np.where(ninth, sequence.vertex_count, sequence.polygons.indices))


@pytest.mark.parametrize("of", ["corners", "vertices", "floats"])
@pytest.mark.parametrize("order", ["keep", "vertices", "free"])
@pytest.mark.parametrize("suffix", [".h5", ".glb"])
def test_compressed_files_keep_every_bit(
    painted_bar: MeshSequence, of: str, order: OrderName, suffix: str, tmp_path: Path
) -> None:
    sequence = painted_bar
    if of != "corners":
        values = np.array(sequence.surface.colours.values) ** (1 if of == "vertices" else 1.5)  # type: ignore[union-attr]
        sequence = coloured(sequence, values[:-1], sequence.polygons.indices)
    mixseq.save(tmp_path / f"a{suffix}", mixseq.compress(sequence, max_error=0.01, order=order))
    got = mixseq.load(tmp_path / f"a{suffix}").header
    expected = cheapest_numbering(sequence.header, order).of_header(sequence.header)
    assert got.polygons.same_as(expected.polygons)
    np.testing.assert_array_equal(colours(got), colours(expected))


def test_colours_of_vertices_take_a_byte_for_a_channel_at_most(
    painted_bar: MeshSequence, tmp_path: Path
) -> None:
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
    height = man.points[0, :, 2]
    shade = np.rint(255 * (height - height.min()) / np.ptp(height)).astype(np.uint8)
    values = of_bytes(np.column_stack([shade, 255 - shade, shade // 2, np.full_like(shade, 255)]))
    man = coloured(man, values, man.polygons.indices)
    man = replace(man, surface=replace(man.surface, origin=None))
    for name in ("a.glb", "a.usdc", "a.abc", "a.npz", "a.h5", "a_####.ply", "a_####.obj", "a_####.off"):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MixseqWarning)
            write(tmp_path / name, mixseq.sequence.sequence.collect(man.header, man.blocks()))
        got = read(tmp_path / name)
        assert got.surface.colours is not None
        at_vertices = got.surface.colours.at_vertices(got.polygons.indices, got.vertex_count, np.zeros(4))  # type: ignore[arg-type]
        np.testing.assert_array_equal(at_vertices, values, err_msg=name)
