"""Names of numbered files, of all formats that hold one frame per file."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import (
    AmbiguousError,
    FormatError,
    InvalidSequenceError,
    MixseqWarning,
    OutputError,
    SettingsError,
)
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write
from mixseq_io.numbered.files import find_frame_files, frame_file_name, is_pattern

KINDS = ("obj", "ply", "stl", "off")


def moving(frames: int) -> MeshSequence:
    points = np.eye(3) + np.arange(frames)[:, None, None]
    return MeshSequence.from_arrays(points.astype(np.float32), [[0, 1, 2]])


@pytest.mark.parametrize(
    ("pattern", "name"),
    [("a_####.ply", "a_0007.ply"), ("a_%04d.ply", "a_0007.ply"), ("a.%d.ply", "a.7.ply"), ("a.ply", "a.ply")],
)
def test_numbers_in_names(pattern: str, name: str) -> None:
    assert frame_file_name(Path(pattern), 7) == name
    assert is_pattern(Path(pattern)) == (pattern != name)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("pattern", ["walk_####.{}", "walk_%04d.{}", "walk_*.{}", "."])
def test_ways_to_name_a_sequence(tmp_path: Path, kind: str, pattern: str) -> None:
    sequence = moving(3)
    write(tmp_path / f"walk_####.{kind}", sequence, start=9)
    got = read(tmp_path / pattern.format(kind), fps=10)
    np.testing.assert_array_equal(got.points, sequence.points)
    np.testing.assert_allclose(got.times, [0.9, 1.0, 1.1])  # a time is a number by the rate
    assert got.name == ("mesh" if kind == "obj" else "walk")  # only OBJ holds a name


@pytest.mark.parametrize("kind", KINDS)
def test_gaps(tmp_path: Path, kind: str) -> None:
    write(tmp_path / f"a_#.{kind}", moving(5), start=1)
    (tmp_path / f"a_2.{kind}").unlink()
    with pytest.raises(InvalidSequenceError, match=rf"numbers 2 are missing between a_1\.{kind} and a_5\.{kind}"):
        read(tmp_path / f"a_#.{kind}")
    assert read(tmp_path / f"a_#.{kind}", allow_gaps=True, fps=1).times.tolist() == [1, 3, 4, 5]


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_written_files(tmp_path: Path, kind: str) -> None:
    write(tmp_path / f"a_%03d.{kind}", moving(2), start=99)
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"a_099.{kind}", f"a_100.{kind}"]
    with pytest.raises(SettingsError, match="start is -1"):
        write(tmp_path / f"a_#.{kind}", moving(2), start=-1)
    with pytest.raises(OutputError, match=rf"holds one frame, this sequence has 2; .* such as b_####\.{kind}"):
        write(tmp_path / f"b.{kind}", moving(2))
    with pytest.warns(MixseqWarning, match=r"1 files of another sequence, a_100"):
        write(tmp_path / f"a_###.{kind}", moving(1), start=99)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("first", "files"), [(0, (0, 1)), (1001, (1001, 1002)), (7.5, (1, 2)), (-3, (1, 2))])
def test_files_have_the_numbers_of_their_frames(
    tmp_path: Path, kind: str, first: float, files: tuple[int, int]
) -> None:
    sequence = moving(2)
    shot = MeshSequence.from_header(sequence.header.numbered_from(first), sequence.points)
    held = first == files[0]
    with nullcontext() if held else pytest.warns(MixseqWarning, match="the times of the frames"):
        write(tmp_path / f"a_#.{kind}", shot)
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"a_{number}.{kind}" for number in files]
    if held:
        np.testing.assert_array_equal(read(tmp_path).times, shot.times)


@pytest.mark.parametrize("kind", KINDS)
def test_rate_out_of_range(tmp_path: Path, kind: str) -> None:
    write(tmp_path / f"a.{kind}", moving(1))
    with pytest.raises(SettingsError, match="fps is nan"):
        read(tmp_path / f"a.{kind}", fps=float("nan"))


def test_a_folder_of_several_kinds(tmp_path: Path) -> None:
    write(tmp_path / "a_#.obj", moving(2))
    write(tmp_path / "a_#.ply", moving(2))
    with pytest.raises(AmbiguousError, match="OBJ and PLY"):
        read(tmp_path)
    assert find_frame_files(tmp_path, False, ".ply")[0] == [tmp_path / "a_0.ply", tmp_path / "a_1.ply"]


def test_extensions_in_capitals(tmp_path: Path) -> None:
    write(tmp_path / "A_#.STL", moving(2))
    (tmp_path / "notes.txt").touch()
    assert read(tmp_path).frame_count == 2


def test_nothing_there(tmp_path: Path) -> None:
    for name in ("a_#.ply", "a_*.ply"):
        with pytest.raises(FormatError, match="no numbered files of this name"):
            read(tmp_path / name)
    with pytest.raises(FormatError, match="does not exist"):
        read(tmp_path / "a.ply")
