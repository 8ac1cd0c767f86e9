"""Retimings from text files with and without mistakes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, SettingsError
from mixseq.operations.retiming import Retiming, read_retiming

GRID = np.linspace(0, 1, 201)


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
        ("a.csv", "time,value\n0,1\n1,2", "a.csv, line 1: 'time,value' is not a point"),
        ("a.csv", "0,1\noutput,source\n1,2", "a.csv, line 2: 'output,source' is not a point"),
        ("a.csv", "0,1\n\n1,two", "a.csv, line 3: '1,two' is not a point of a retiming; two times"),
        ("a.csv", "0,1\n1", "a.csv, line 2: '1' is not a point"),
        ("a.csv", "0,1\n1,2,3", "a.csv, line 2: '1,2,3' is not a point"),
        ("a.csv", "0;1\n1;2", "a.csv, line 1: '0;1' is not a point"),
        ("a.csv", "0,1\n2,1\n# no\n2,3", "a.csv, line 4: the output time 2 is not after 2 of line 2"),
        ("a.csv", "0,1\nnan,1", "a.csv, line 2: the times nan, 1 are not finite"),
        ("a.csv", "0,1\n1,inf", "a.csv, line 2: the times 1, inf are not finite"),
        ("a.toml", "key = \n1", "a.toml is not a TOML file: .*line 1"),
        ("a.toml", f"key = [{{output=0, source=1{'0' * 400}}}]", "a.toml is not a TOML file: 1000.* more than 64 bits"),
        ("a.toml", "", "a.toml has nothing; tables"),
        ("a.toml", "key = 3", "a.toml has key; tables"),
        ("a.toml", "keys = []", "a.toml has keys; tables"),
        ("a.toml", "output = 1\nsource = 2", "a.toml has output, source; tables"),
        ("a.toml", "output = [0, 1]\nsource = [0]", "a.toml has 2 output times and 1 source times"),
        ("a.toml", "[[key]]\noutput=0", "a.toml, key 1: an output and a source are expected"),
        ("a.toml", "[[key]]\noutput=0\nsource=1\nease=2", "a.toml, key 1: .* nothing else"),
        ("a.toml", "key = [1, 2]", "a.toml, key 1: an output and a source"),
        ("a.toml", "output=[0, 'x']\nsource=[0, 1]", "a.toml, key 2: .* not a time"),
        ("a.toml", "output=[0, 1]\nsource=[0, true]", "a.toml, key 2: .* not a time"),
        ("a.toml", "output=[0, 0]\nsource=[0, 1]", "a.toml, key 2: the output time 0 is not after 0 of key 1"),
    ],
)
def test_files_with_mistakes(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=message):
        read_retiming(tmp_path / name)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none.csv does not exist"):
        read_retiming(tmp_path / "none.csv")
    with pytest.raises(FormatError, match="cannot be read: Is a directory"):
        read_retiming(tmp_path)
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="cannot be read as a CSV or TOML file: its text is UTF-16; save it as UTF-8"):
        read_retiming(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.csv", 'unit = "frames"\n# later\nsource,output\n1001,10\n1005,18\n'),
        ("a.csv", "unit=frames\n10,1001\n18,1005\n"),
        ("a.toml", 'unit = "frames"\noutput = [10, 18]\nsource = [1001, 1005]\n'),
    ],
)
def test_times_may_be_frames(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    read = read_retiming(tmp_path / name, output_fps=20, source_fps=10)
    assert (read.start, read.end) == (0.5, 0.9)
    np.testing.assert_allclose(read([0.5, 0.9]), [100.1, 100.5])
    same = read_retiming(tmp_path / name, source_fps=10)
    assert (same.start, same.end) == (1.0, 1.8)
    with pytest.raises(SettingsError, match="is in frames; give source_fps"):
        read_retiming(tmp_path / name)


@pytest.mark.parametrize(("name", "text"), [("a.csv", "unit = days\n0,1\n1,2"), ("a.toml", "unit = 3\n")])
def test_unknown_units_are_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SettingsError, match=rf"{name}.*: the unit is (\'days\'|3); \'seconds\' or"):
        read_retiming(tmp_path / name)
