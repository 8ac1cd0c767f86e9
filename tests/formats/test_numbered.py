"""Names of numbered files, of all formats that hold one frame per file."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqWarning, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write
from mixseq_io.numbered.files import (
    find_frame_files,
    find_numbered_files,
    frame_file_name,
    group_numbered_files,
    is_pattern,
)

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


def test_signs_and_subframes_in_names() -> None:
    assert [frame_file_name(Path("a.%04d.ply"), number) for number in (-7, 7.25)] == ["a.-007.ply", "a.0007.25.ply"]


NAMED_FRAMES = {  # stems of files in order, and their numbers
    "sub-frames, whole ones without a point": (["w.0001", "w.0001.5", "w.0002", "w.0002.5"], [1, 1.5, 2, 2.5]),
    "sub-frames, all with a point": (["w_9.00", "w_9.25", "w_9.75", "w_10.00"], [9, 9.25, 9.75, 10]),
    "signs after a separator": (["w_-010", "w_-009", "w_-008"], [-10, -9, -8]),
    "signs of printf": (["w.-001", "w.0000", "w.0001"], [-1, 0, 1]),
    "signs after a letter": (["w-2", "w-1", "w0", "w1"], [-2, -1, 0, 1]),
    "hyphens as separators": (["w-0001", "w-0002"], [1, 2]),
    "a version before a point": (["w_2.0001", "w_2.0002"], [1, 2]),
    "a date": (["2026-11-27_1", "2026-11-27_2"], [1, 2]),
    "a word after the number": (["w_-1_high", "w_0_high"], [-1, 0]),
    "negative sub-frames": (["w.-1", "w.-0.5", "w.0"], [-1, -0.5, 0]),
}


@pytest.mark.parametrize("case", NAMED_FRAMES)
def test_numbers_of_files_in_a_folder(tmp_path: Path, case: str) -> None:
    stems, numbers = NAMED_FRAMES[case]
    files = [tmp_path / f"{stem}.obj" for stem in stems]
    for frame, file in enumerate(files):
        write(file, MeshSequence.from_arrays(moving(len(stems)).points[frame : frame + 1], [[0, 1, 2]]))
    assert find_frame_files(tmp_path, False) == (files, numbers)
    sequence = read(tmp_path)
    np.testing.assert_array_equal(sequence.times, np.array(numbers) / 24)
    np.testing.assert_array_equal(sequence.points, moving(len(stems)).points)
    [series] = group_numbered_files(files)
    assert [file for _, file in find_numbered_files(tmp_path / series.pattern)] == files


def test_versions_are_several_sequences(tmp_path: Path) -> None:
    for version in (1, 2):
        write(tmp_path / f"w_{version}.####.obj", moving(3), start=1)
    with pytest.raises(AmbiguousError, match=r"several sequences: w_1\.####\.obj, w_2\.####\.obj; give one"):
        read(tmp_path)
    assert read(tmp_path / "w_2.####.obj").frame_count == 3
    with pytest.raises(FormatError, match="no numbered files of this name"):
        read(tmp_path / "w_#.obj")  # 1.0001, 1.0002, ... are no sub-frames


def test_patterns_find_subframes(tmp_path: Path) -> None:
    numbers = np.array([0.75, 1, 1.25, 1.75, 2, 2.25])
    sequence = moving(6)
    shot = MeshSequence.from_header(sequence.header.with_times(numbers / 24), sequence.points)
    write(tmp_path / "w.##.obj", shot)  # without a warning
    assert sorted(file.name for file in tmp_path.iterdir())[:2] == ["w.00.75.obj", "w.01.25.obj"]
    for path in (tmp_path, tmp_path / "w.##.obj", tmp_path / "w.%02d.obj", tmp_path / "w.*.obj"):
        np.testing.assert_array_equal(read(path).times, shot.times)
    assert read(tmp_path).header.name == "mesh"
    (tmp_path / "w.02.obj").unlink()
    with pytest.raises(InvalidSequenceError, match=r"numbers 2 are missing between w\.00\.75\.obj"):
        read(tmp_path / "w.##.obj")


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
@pytest.mark.parametrize(("first", "files"), [(0, (0, 1)), (1001, (1001, 1002)), (7.5, (1, 2)), (-3, (-3, -2))])
def test_files_have_the_numbers_of_their_frames(
    tmp_path: Path, kind: str, first: float, files: tuple[int, int]
) -> None:
    sequence = moving(2)
    shot = MeshSequence.from_header(sequence.header.numbered_from(first), sequence.points)
    held = first == files[0]
    with nullcontext() if held else pytest.warns(MixseqWarning, match="the times of the frames"):
        write(tmp_path / f"a_#.{kind}", shot)
    assert {file.name for file in tmp_path.iterdir()} == {f"a_{number}.{kind}" for number in files}
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


SQUARE_TEXT = {
    "obj": "v 0 0 0\nv 1 0 0\nv 1 1 \\\n0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n",
    "off": "OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n",
    "ply": "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2\n3 0 2 3\n",
    "stl": "solid a\nfacet\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 1 1 0\nendloop\nendfacet\n"
    "facet\nouter loop\nvertex 0 0 0\nvertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
}


@pytest.mark.parametrize("line_end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("extension", SQUARE_TEXT)
def test_byte_order_marks_and_line_ends(extension: str, encoding: str, line_end: str, tmp_path: Path) -> None:
    file = tmp_path / f"square.{extension}"
    file.write_bytes(SQUARE_TEXT[extension].replace("\n", line_end).encode(encoding))
    square = read(file)
    np.testing.assert_array_equal(square.points, [[[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]])
    np.testing.assert_array_equal(square.faces, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("extension", ["obj", "off", "ply", "stl", "gltf", "usda"])
@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_other_encodings_are_named(extension: str, encoding: str, tmp_path: Path) -> None:
    file = tmp_path / f"square.{extension}"
    file.write_bytes(SQUARE_TEXT.get(extension, "{} #usda").encode(encoding))
    with pytest.raises(
        FormatError, match=rf"square\.{extension} .* its text is {encoding[:6].upper()}; save it as UTF-8"
    ):
        read(file)


def test_byte_order_mark_of_a_usd_text_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.usda").write_bytes("#usda 1.0\n".encode("utf-8-sig"))
    with pytest.raises(FormatError, match="begins with a byte order mark, which USD does not read"):
        read(tmp_path / "a.usda")


def test_a_binary_ply_after_a_header_with_other_line_ends(tmp_path: Path) -> None:
    """The first byte of the rows is a line feed, which is no part of the header."""
    header = SQUARE_TEXT["ply"].partition("0 0 0\n")[0].replace("ascii", "binary_little_endian")
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
    points[0, 0] = np.frombuffer(b"\n\n\n\n", "<f4")[0]
    faces = b"".join(b"\3" + np.array(corners, "<i4").tobytes() for corners in ([0, 1, 2], [0, 2, 3]))
    for line_end in ("\n", "\r\n", "\r"):
        (tmp_path / "a.ply").write_bytes(header.replace("\n", line_end).encode() + points.tobytes() + faces)
        np.testing.assert_array_equal(read(tmp_path / "a.ply").points, points[None])
