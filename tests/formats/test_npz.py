"""npz: files that others made with numpy.savez."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import open_sequence, read, write
from mixseq_io.npz import read_values
from tests.formats.conftest import CASES

POINTS = np.arange(4 * 5 * 3, dtype=np.float32).reshape(4, 5, 3)
FACES = np.array([[0, 1, 2], [2, 3, 4]])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "walk.npz"


def save(path: Path, **arrays: Any) -> None:
    np.savez_compressed(path, **{"points": POINTS, "faces": FACES, **arrays})


@pytest.mark.parametrize("name", ["a.npy", "a.txt", "a.csv", "a.npz"])
@pytest.mark.parametrize("shape", [(5,), (4, 5)])
def test_values_of_vertices(tmp_path: Path, name: str, shape: tuple[int, ...]) -> None:
    values, path = np.arange(np.prod(shape), dtype=float).reshape(shape), tmp_path / name
    match path.suffix:
        case ".npy":
            np.save(path, values)
        case ".npz":
            np.savez(path, heat=values)
        case _:
            np.savetxt(path, values, delimiter="," if name == "a.csv" else " ")
    assert np.array_equal(read_values(path), values)


def test_values_are_found_by_name(path: Path) -> None:
    save(path, values=np.arange(5))
    assert read_values(path).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(("name", "text"), [("a.txt", "1\nred"), ("b.txt", "1 2\n3"), ("c.npy", "1 2"), ("d.npz", "1")])
def test_what_is_not_numbers(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=name):
        read_values(tmp_path / name)


def test_points_and_faces_are_enough(path: Path) -> None:
    save(path)
    sequence = read(path)
    np.testing.assert_array_equal(sequence.points, POINTS)
    np.testing.assert_array_equal(sequence.faces, FACES)
    assert (sequence.fps, sequence.name, sequence.up_axis) == (24, "walk", "Y")
    np.testing.assert_array_equal(sequence.times, np.arange(4) / 24)


def test_rates_and_times(path: Path) -> None:
    save(path)
    assert read(path, fps=10).times[1] == 0.1
    save(path, fps=np.float32(50))
    assert read(path, fps=10).times[1] == 0.02  # what the file says counts
    save(path, times=[0, 1, 2, 4], fps=50)
    assert read(path).times.tolist() == [0, 1, 2, 4]


@pytest.mark.parametrize(
    ("points", "dtype"),
    [
        (POINTS.astype(">f4"), np.float32),
        (POINTS.astype(">f8"), np.float64),
        (POINTS.astype(np.float16), np.float32),
        (POINTS.astype(np.int16), np.float64),
        (np.asfortranarray(POINTS), np.float32),
        (POINTS[:, ::-1][:, ::-1], np.float32),
    ],
    ids=["big endian", "big endian 64", "half", "integers", "columns", "view"],
)
def test_unusual_arrays(path: Path, points: Any, dtype: type) -> None:
    save(path, points=points)
    with open_sequence(path) as reader:
        blocks = list(reader.blocks(3))
    assert [len(block) for block in blocks] == [3, 1]
    assert all(block.dtype == dtype and block.dtype.isnative for block in blocks)
    np.testing.assert_array_equal(np.concatenate(blocks), POINTS)


def test_quads_in_one_array(path: Path) -> None:
    save(path, faces=[[0, 1, 2, 3], [1, 2, 3, 4]])
    assert read(path).polygons.counts.tolist() == [4, 4]


@pytest.mark.parametrize(
    ("arrays", "error", "message"),
    [
        ({"points": POINTS[0]}, FormatError, r"points have shape \(5, 3\)"),
        ({"points": POINTS.astype(np.complex64)}, FormatError, "points have type complex64"),
        ({"faces": [0, 1, 2]}, FormatError, r"faces have shape \(3,\)"),
        ({"faces": FACES * 1.5}, InvalidSequenceError, "integers are expected"),
        ({"faces": FACES + 1}, InvalidSequenceError, "face 1 uses vertex 5"),
        ({"faces": [[0, 1, -1]]}, InvalidSequenceError, "face 0 uses vertex -1"),
        ({"times": [0, 1, 1, 2]}, InvalidSequenceError, "frame 2 is at 1 s"),
        ({"times": [0, 1]}, FormatError, "4 frames of points for 2 times"),
        ({"fps": 0}, InvalidSequenceError, "fps is 0"),
        ({"fps": [24, 25]}, FormatError, "cannot be read as an npz file"),
        ({"times": np.array([None] * 4)}, FormatError, "cannot be read as an npz file"),
        ({"up_axis": "W"}, InvalidSequenceError, "up axis is 'W'"),
        ({"up_axis": np.full(1, 0x110000, "<u4").view("<U1")}, FormatError, "up_axis has characters that do not exist"),
    ],
)
def test_arrays_that_are_no_sequence(path: Path, arrays: dict[str, Any], error: type[Exception], message: str) -> None:
    save(path, **arrays)
    with pytest.raises(error, match=f"(?s)walk.npz.*{message}"):
        read(path)


def test_missing_arrays(path: Path) -> None:
    np.savez(path, vertices=POINTS, triangles=FACES)
    with pytest.raises(FormatError, match="has the arrays triangles, vertices; `points`, and `faces`"):
        read(path)


def test_a_size_that_is_not_there_is_refused_before_memory_is_taken(path: Path) -> None:
    save(path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["points.npy"] = members["points.npy"].replace(b"(4, 5, 3)", b"(4,999,3)")
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    with pytest.raises(FormatError, match=r"points of shape \(4, 999, 3\) do not fill"):
        read(path)


def test_numpy_can_load_it(path: Path) -> None:
    polygons = CASES["polygons"]()
    write(path, polygons)
    with np.load(path, allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["points"], polygons.points)
        np.testing.assert_array_equal(arrays["face_counts"], polygons.polygons.counts)
        assert str(arrays["name"]) == polygons.name


def test_the_same_sequence_gives_the_same_bytes(path: Path, plain: MeshSequence) -> None:
    write(path, plain)
    first = path.read_bytes()
    write(path, plain)
    assert path.read_bytes() == first
