"""OFF files: what trimesh reads, and what it would let pass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write

SQUARE = "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n"


@pytest.mark.parametrize(
    "text",
    [
        SQUARE,
        SQUARE.replace("OFF\n", "OFF "),
        SQUARE.replace("OFF", "# a square\n\nOFF").replace("4 2 0", "4 2 0 # counts"),
        SQUARE.replace("OFF", "COFF").replace(" 0\n", " 0 255 0 0 255\n").replace("4 2 0 255 0 0 255", "4 2 0"),
        SQUARE.removesuffix("\n"),
        SQUARE.replace("4 2 0", "4 1 0").replace("3 0 1 2\n3 0 2 3", "4 0 1 2 3"),
    ],
    ids=["plain", "one line", "comments", "colours", "no end", "quad"],
)
def test_a_square(text: str, tmp_path: Path) -> None:
    (tmp_path / "square.off").write_text(text)
    square = read(tmp_path / "square.off")
    assert square.points[0].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert square.points.dtype == np.float64
    assert square.faces.tolist() in ([[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [2, 3, 0]])  # trimesh turns the quad's


def test_files_are_told_to_lose_polygons(tmp_path: Path) -> None:
    quad = MeshSequence.from_arrays(np.eye(4, 3)[None], Polygons(np.array([4]), np.arange(4)))
    with pytest.warns(MixseqWarning, match="polygons"):
        write(tmp_path / "quad.off", quad)


def test_cut_anywhere(tmp_path: Path) -> None:
    for end in range(len(SQUARE) - 2):
        (tmp_path / "cut.off").write_text(SQUARE[:end])
        with pytest.raises((FormatError, InvalidSequenceError), match=r"cut.off"):
            read(tmp_path / "cut.off")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("4 2 0", "5 2 0", "announces 5 vertices and 2 faces and has 6 lines"),
        ("4 2 0", "4 1 0", "announces 4 vertices and 1 faces and has 6 lines"),
        ("4 2 0", "-4 10 0", "has 6 lines of them"),
        ("4 2 0", "99999999999 2 0", "announces 99999999999 vertices"),
        ("3 0 1 2", "2 0 1 2", "face 0: '2 0 1 2' is not a face"),
        ("3 0 1 2", "-3 0 1 2", "face 0: '-3 0 1 2' is not a face"),
        ("3 0 2 3", "4 0 2 3", "face 1: '4 0 2 3' is not a face"),
        ("3 0 2 3", "3 0 2", "face 1: '3 0 2' is not a face"),
        ("3 0 2 3", "3 0 2 3 0 1 2 0 1", "face 1: '3 0 2 3 0 1 2 0 1' is not a face"),
        ("3 0 2 3", "3 0\f2 3", "cannot be read as an OFF file"),
        ("3 0 2 3", "3 0 2 4", "(cannot be read as an OFF file|face 1 uses vertex 4)"),  # by version of trimesh
        ("1 1 0", "1 one 0", "cannot be read as an OFF file"),
        ("OFF", "OF", "cannot be read as an OFF file"),
    ],
)
def test_refusals(old: str, new: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "bad.off").write_text(SQUARE.replace(old, new, 1))
    with pytest.raises((FormatError, InvalidSequenceError), match=rf"bad.off.*{message}"):
        read(tmp_path / "bad.off")


def test_other_faces_in_a_later_frame(tmp_path: Path) -> None:
    (tmp_path / "walk_1.off").write_text(SQUARE)
    (tmp_path / "walk_2.off").write_text(SQUARE.replace("3 0 2 3", "3 2 3 0"))
    with pytest.raises(InvalidSequenceError, match=r"walk_2.off \(frame 2\) has other faces"):
        read(tmp_path / "walk_#.off")


@pytest.mark.parametrize(
    ("colour", "expected"),
    [("255 0 51 102", [1, 0, 0.2, 0.4]), ("1 0 0.2 0.4", [1, 0, 0.2, 0.4]), ("255 0 51", [1, 0, 0.2, 1]), ("7", None)],
)
def test_colours(tmp_path: Path, colour: str, expected: list[float] | None) -> None:
    text = f"COFF\n3 1 0\n0 0 0 {colour}\n1 0 0 {colour}\n0 1 0 {colour}\n3 0 1 2\n"
    (tmp_path / "a.off").write_text(text)
    colours = read(tmp_path / "a.off").surface.colours
    assert (colours is None) == (expected is None)
    if colours is not None:
        np.testing.assert_allclose(colours.at_corners, np.array([expected] * 3), atol=1e-7)
    (tmp_path / "a.off").write_text(text.replace(f" {colour}\n1", "\n1"))  # the first vertex has none
    assert read(tmp_path / "a.off").surface.colours is None


@pytest.mark.parametrize("colour", ["a b c", "1 1 red", "0.5 0.5 0.5 full"])
def test_colours_that_are_no_numbers(tmp_path: Path, colour: str) -> None:
    white = " ".join("1" for _ in colour.split())
    (tmp_path / "bad.off").write_text(f"COFF\n3 1 0\n0 0 0 {white}\n1 0 0 {colour}\n0 1 0 {white}\n3 0 1 2\n")
    with pytest.raises(
        FormatError, match=rf"bad.off, vertex 1: the colour '{colour}' is not {len(colour.split())} num"
    ):
        read(tmp_path / "bad.off")
