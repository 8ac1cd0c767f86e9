"""Lengths on the command line: fractions of the diagonal, and lengths in units."""

from __future__ import annotations

import json
from pathlib import Path

import click
import numpy as np
import pytest

import mixseq
from mixseq.cli.group import in_diagonals, length_text, parse_length
from mixseq.errors import SettingsError
from mixseq_io.model_files import read_compressed
from tests.cli.conftest import Run


def moving(scale: float = 1.0, metres_per_unit: float = 1.0) -> mixseq.MeshSequence:
    """Return a tetrahedron whose bounding box has the sides 3, 4 and 12, and the diagonal 13, times a scale."""
    corners = scale * np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [0, 0, 12]])
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    return mixseq.MeshSequence.from_arrays(np.stack([corners, corners * 1.1]), faces, metres_per_unit=metres_per_unit)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("0.001", 0.001), ("1e-3", 0.001), (".5", 0.5), ("0.5mm", "0.5mm"), ("2 CM", "2cm"), ("1in", "1in")],
)
def test_numbers_are_fractions_and_units_stay_text(text: str, expected: float | str) -> None:
    assert parse_length(text) == expected


@pytest.mark.parametrize("text", ["0", "-1", "0mm", "-1mm", "mm", "1 parsec", "nan", "inf", "1e999mm", ""])
def test_what_is_no_length_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match=r"is not a length above 0, such as 0.001 .* or 0.5mm"):
        parse_length(text)


@pytest.mark.parametrize(
    ("length", "scale", "unit", "expected"),
    [("13m", 1.0, 1.0, 1.0), ("13mm", 1.0, 1.0, 1e-3), ("13mm", 1.0, 0.01, 0.1), ("1.3cm", 10.0, 0.01, 0.01)],
)
def test_a_length_is_divided_by_the_diagonal_in_metres(length: str, scale: float, unit: float, expected: float) -> None:
    converted = in_diagonals({"max_error": length, "kg": 0.1}, moving(scale, unit), "max_error")
    assert converted == {"max_error": pytest.approx(expected, rel=1e-12), "kg": 0.1}


def test_fractions_need_no_frame() -> None:
    class NoFrames:
        header = moving().header

        def blocks(self, size: int = 1) -> None:
            raise AssertionError("frames were read")

    assert in_diagonals({"tolerance": 0.1}, NoFrames(), "tolerance") == {"tolerance": 0.1}  # type: ignore[arg-type]
    assert in_diagonals({}, NoFrames(), "tolerance") == {}  # type: ignore[arg-type]


def test_a_length_is_divided_by_the_largest_diagonal_if_the_first_is_zero() -> None:
    frames = moving()
    points = frames.points.copy()
    points[0] = 0
    popping = frames.with_points(points)
    assert in_diagonals({"tolerance": "13m"}, popping, "tolerance") == {"tolerance": 13 / popping.diagonal}


def test_a_point_has_no_diagonal() -> None:
    with pytest.raises(SettingsError, match="has no size in any frame"):
        in_diagonals({"tolerance": "1mm"}, moving(0.0), "tolerance")


@pytest.mark.parametrize(
    ("fraction", "diagonal", "expected"),
    [
        (0.0005, 1.8, "0.0005 diagonals (0.9 mm)"),
        (0.1, 1.8, "0.1 diagonals (18 cm)"),
        (1.0, 2.5, "1 diagonals (2.5 m)"),
        (0.5, 5000.0, "0.5 diagonals (2.5 km)"),
        (1e-9, 1.0, "1e-09 diagonals (1e-06 mm)"),
        (0.0, 1.0, "0 diagonals (0 mm)"),
    ],
)
def test_reports_have_both(fraction: float, diagonal: float, expected: str) -> None:
    assert length_text(fraction, diagonal) == expected


@pytest.mark.slow
def test_commands_take_lengths(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mixseq.write("walk.npz", moving(metres_per_unit=0.01))  # 13 cm
    assert run("encode", "walk.npz", "small.h5", "--max-error", "1.3mm", "-q").exit_code == 0
    assert read_compressed(Path("small.h5")).parameters.max_error == pytest.approx(0.01)
    assert "diagonals (1.3 mm) from walk.npz, requested" in run("verify", "small.h5", "walk.npz").stdout
    assert run("encode", "walk.npz", "walk.h5", "--tolerance", "1.3mm", "-q").exit_code == 0
    result = run("compare", "walk.npz", "walk.h5", "--json")
    assert json.loads(result.stdout)["max_error"] <= 0.01
    assert " diagonals (" in run("compare", "walk.npz", "walk.h5").stdout
    result = run("encode", "walk.npz", "other.h5", "--tolerance", "1 parsec")
    assert result.exit_code == 2
    assert "not a length above 0" in result.stderr


@pytest.mark.slow
def test_a_batch_converts_by_the_size_of_every_asset(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("shots").mkdir()
    mixseq.write("shots/small.npz", moving())
    mixseq.write("shots/large.npz", moving(10.0))
    assert run("batch", "encode", "shots", "--out", "models", "--max-error", "130mm", "-q").exit_code == 0
    bounds = [read_compressed(Path(f"models/{name}.h5")).parameters.max_error for name in ("small", "large")]
    assert bounds == pytest.approx([0.01, 0.001])
