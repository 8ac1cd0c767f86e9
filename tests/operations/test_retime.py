"""Retiming: closed-form maps, their slopes, and text files with and without mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.errors import FormatError, SettingsError
from mixseq.operations.retime import Retiming, read_retiming

GRID = np.linspace(0, 1, 201)


# Maps -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("retiming", "end", "sources", "slope"),
    [
        (Retiming.section(1, 3), 3, lambda o: o, 1),
        (Retiming.section(1, 3, speed=4), 1.5, lambda o: 1 + 4 * (o - 1), 4),
        (Retiming.section(1, 3, speed=0.5), 5, lambda o: 1 + (o - 1) / 2, 0.5),
        (Retiming.section(1, 3, reverse=True), 3, lambda o: 4 - o, -1),
        (Retiming.section(1, 3, 0.5, True), 5, lambda o: 3 - (o - 1) / 2, -0.5),
        (Retiming.section(1, 1), 1, lambda o: o, 1),
        (Retiming.section(1, 1, 2, True), 1, lambda o: o, -2),
        (Retiming.hold(7, 1, 3), 3, lambda o: 7 + 0 * o, 0),
    ],
)
def test_straight_maps(retiming: Retiming, end: float, sources: object, slope: float) -> None:
    assert callable(sources)
    assert (retiming.start, retiming.end) == (1, end)
    times = 1 + (end - 1) * GRID
    assert retiming(times) == pytest.approx(sources(times), abs=1e-14)
    assert retiming.slope(times) == pytest.approx(np.full(len(times), slope))


def test_at_its_own_speed_a_section_keeps_every_bit() -> None:
    times = np.arange(7, 96) / 23.976
    assert np.array_equal(Retiming.section(times[0], times[-1])(times), times)


def test_lines_through_points() -> None:
    retiming = Retiming.through([0, 1, 3], [5, 7, 6], smooth=False)
    assert retiming([0, 0.5, 1, 2, 3]).tolist() == [5, 6, 7, 6.5, 6]
    assert retiming.slope([0, 0.5, 1, 2, 3]).tolist() == [2, 2, -0.5, -0.5, -0.5]


def test_smooth_through_two_points_is_a_line() -> None:
    retiming = Retiming.through([1, 3], [0, 1])
    assert retiming([1, 2, 2.5]) == pytest.approx([0, 0.5, 0.75])


@pytest.mark.parametrize("smooth", [True, False])
def test_it_passes_through_its_points(smooth: bool) -> None:
    outputs, sources = [0, 0.4, 0.5, 2], [3, 3, 1, 4]
    assert Retiming.through(outputs, sources, smooth)(outputs) == pytest.approx(sources, abs=1e-14)


@given(
    st.lists(st.floats(0.1, 1), min_size=2, max_size=6),
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.booleans(),
)
def test_it_rises_and_falls_only_where_its_points_do(
    steps: list[float], changes: list[float], smooth: bool
) -> None:
    outputs = np.cumsum(steps)
    sources = np.cumsum(changes)[: len(outputs)]
    retiming = Retiming.through(outputs, sources, smooth)
    for piece in range(len(outputs) - 1):
        times = outputs[piece] + (outputs[piece + 1] - outputs[piece]) * GRID
        rising = np.sign(sources[piece + 1] - sources[piece])
        assert (rising * np.diff(retiming(times)) >= -1e-12).all()


def test_the_slope_is_the_derivative_and_is_continuous() -> None:
    retiming = Retiming.through([0, 0.3, 0.7, 1], [0, 0.1, 0.8, 0.5])
    inner, step = GRID[1:-1], 1e-6
    differences = (retiming(inner + step) - retiming(inner - step)) / (2 * step)
    assert retiming.slope(inner) == pytest.approx(differences, abs=1e-5)
    for knot in (0.3, 0.7):
        before, after = retiming.slope([knot - 1e-9, knot + 1e-9])
        assert before == pytest.approx(after, abs=1e-6)


@pytest.mark.parametrize("time", [0.999, 3.001, np.nan, np.inf])
def test_times_outside(time: float) -> None:
    retiming = Retiming.section(1, 3)
    for ask in (retiming, retiming.slope):
        with pytest.raises(
            SettingsError, match=f"from 1 to 3 s of the output, and tells nothing of {time:g} s"
        ):
            ask([2, time])


@pytest.mark.parametrize(
    ("outputs", "sources", "message"),
    [
        ([0], [0], "has 1 output times and 1 source times; two of each"),
        ([0, 1], [0], "has 2 output times and 1 source times"),
        ([[0, 1]], [[0, 1]], "two of each"),
        ([0, 0], [0, 1], "output times increase"),
        ([1, 0], [0, 1], "output times increase"),
        ([0, np.nan], [0, 1], "must be finite"),
        ([0, 1], [0, np.inf], "must be finite"),
    ],
)
def test_points_that_make_no_map(outputs: object, sources: object, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Retiming.through(outputs, sources)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ((2, 1), "no time between the start, 2 s, and the end, 1 s"),
        ((np.nan, 1), "no time between"),
        ((0, np.inf), "no time between"),
        ((0, 1, 0), "speed is 0; a positive number"),
        ((0, 1, -1), "speed is -1; a positive number"),
        ((0, 1, np.inf), "speed is inf"),
    ],
)
def test_sections_that_make_no_map(settings: tuple[float, ...], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Retiming.section(*settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("settings", [(0, 2, 1), (np.nan, 0, 1), (0, 0, np.inf)])
def test_what_cannot_be_held(settings: tuple[float, float, float]) -> None:
    with pytest.raises(SettingsError, match="cannot be held"):
        Retiming.hold(*settings)


# Files ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", "0,5\n1,7\n3,6\n"),
        ("a.csv", "output,source\n0,5\n1,7\n3,6"),
        ("a.csv", "\ufeffOutput , Source\r\n0, 5\r\n1, 7\r\n3, 6\r\n"),
        ("a.csv", "source,output\n5,0\n7,1\n6,3\n"),
        ("a.txt", "# a ramp\n\n0,5  # here\n1e0,7.0\n   \n3,6\n"),
        ("a.toml", "[[key]]\noutput=0\nsource=5\n[[key]]\noutput=1.0\nsource=7\n[[key]]\nsource=6\noutput=3"),
        ("a.toml", "output = [0, 1.0, 3]\nsource = [5, 7, 6]"),
        ("a.TOML", "key = [{output=0, source=5}, {output=1, source=7}, {output=3, source=6}]"),
    ],
)
def test_files(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8", newline="")
    for smooth in (True, False):
        read = read_retiming(tmp_path / name, smooth)
        expected = Retiming.through([0, 1, 3], [5, 7, 6], smooth)
        assert np.array_equal(read(3 * GRID), expected(3 * GRID))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "a.csv has 0 points; a retiming needs two or more"),
        ("a.csv", "output,source\n", "a.csv has 0 points"),
        ("a.csv", "0,1", "a.csv has 1 points"),
        ("a.csv", "time,value\n0,1\n1,2", "a.csv, line 1: 'time,value' is no point"),
        ("a.csv", "0,1\noutput,source\n1,2", "a.csv, line 2: 'output,source' is no point"),
        ("a.csv", "0,1\n\n1,two", "a.csv, line 3: '1,two' is no point of a retiming; two times in seconds"),
        ("a.csv", "0,1\n1", "a.csv, line 2: '1' is no point"),
        ("a.csv", "0,1\n1,2,3", "a.csv, line 2: '1,2,3' is no point"),
        ("a.csv", "0;1\n1;2", "a.csv, line 1: '0;1' is no point"),
        ("a.csv", "0,1\n2,1\n# no\n2,3", "a.csv, line 4: the output time 2 s is not after 2 s of line 2"),
        ("a.csv", "0,1\nnan,1", "a.csv, line 2: the times nan, 1 are not finite"),
        ("a.csv", "0,1\n1,inf", "a.csv, line 2: the times 1, inf are not finite"),
        ("a.toml", "key = \n1", "a.toml is not TOML: .*line 1"),
        ("a.toml", "", "a.toml has nothing; tables"),
        ("a.toml", "key = 3", "a.toml has key; tables"),
        ("a.toml", "keys = []", "a.toml has keys; tables"),
        ("a.toml", "output = 1\nsource = 2", "a.toml has output, source; tables"),
        ("a.toml", "output = [0, 1]\nsource = [0]", "a.toml has 2 output times and 1 source times"),
        ("a.toml", "[[key]]\noutput=0", "a.toml, key 1: an output and a source are expected"),
        ("a.toml", "[[key]]\noutput=0\nsource=1\nease=2", "a.toml, key 1: .* nothing else"),
        ("a.toml", "key = [1, 2]", "a.toml, key 1: an output and a source"),
        ("a.toml", "output=[0, 'x']\nsource=[0, 1]", "a.toml, key 2: .* not a time in seconds"),
        ("a.toml", "output=[0, 1]\nsource=[0, true]", "a.toml, key 2: .* not a time in seconds"),
        (
            "a.toml",
            "output=[0, 0]\nsource=[0, 1]",
            "a.toml, key 2: the output time 0 s is not after 0 s of key 1",
        ),
    ],
)
def test_files_with_mistakes(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=message):
        read_retiming(tmp_path / name)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none.csv cannot be read: No such file"):
        read_retiming(tmp_path / "none.csv")
    with pytest.raises(FormatError, match="cannot be read: Is a directory"):
        read_retiming(tmp_path)
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="is not text; a CSV or TOML file"):
        read_retiming(tmp_path / "a.csv")
