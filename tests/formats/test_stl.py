"""STL files: vertices of corners that stay together, text and binary, and damage."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import FaceSet, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io import read, write

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def binary(corners: FloatArray, start: bytes = b"") -> bytes:
    data = start.ljust(80, b"\0") + struct.pack("<I", len(corners))
    return data + b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.reshape(-1), 7) for triangle in corners)


def text(corners: FloatArray, name: str = "solid vertex 3") -> bytes:
    lines = [f"solid {name}"]
    for triangle in corners:
        lines += ["facet normal 0 0 1", "  OUTER LOOP"]
        lines += ["    vertex " + " ".join(f"{x:.9g}" for x in corner) for corner in triangle]
        lines += ["  endloop", "endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""]).encode()


@pytest.mark.parametrize("make", [binary, text])
def test_corners_at_the_same_place_are_one_vertex(tmp_path: Path, make: object) -> None:
    assert callable(make)
    corners = SQUARE[FACES]
    corners[1, 0] = -0.0  # the same place as 0
    (tmp_path / "a.stl").write_bytes(make(corners))
    sequence = read(tmp_path / "a.stl")
    np.testing.assert_array_equal(sequence.points[0], SQUARE)
    np.testing.assert_array_equal(sequence.faces, FACES)
    assert sequence.points.dtype == (np.float32 if make is binary else np.float64)


def test_a_binary_file_may_begin_like_text(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(binary(SQUARE[FACES], b"solid Cura"))
    np.testing.assert_array_equal(read(tmp_path / "a.stl").faces, FACES)


def test_solids_are_one_mesh(tmp_path: Path) -> None:
    corners = SQUARE[FACES]
    (tmp_path / "a.stl").write_bytes(text(corners[:1], "one") + text(corners[1:], ""))
    np.testing.assert_array_equal(read(tmp_path / "a.stl").faces, FACES)


def test_vertices_are_numbered_as_they_occur(tmp_path: Path) -> None:
    (tmp_path / "a.stl").write_bytes(binary(SQUARE[[[3, 1, 0], [1, 3, 2]]]))
    sequence = read(tmp_path / "a.stl")
    assert sequence.faces.tolist() == [[0, 1, 2], [1, 0, 3]]
    np.testing.assert_array_equal(sequence.points[0], SQUARE[[3, 1, 0, 2]])


LIPS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0], [0, -1, 0]], dtype=np.float32).reshape(2, 3, 3)


@pytest.mark.parametrize("opening_frame", [1, 2, 3])
def test_lips_that_touch_in_some_frames_stay_apart(tmp_path: Path, opening_frame: int) -> None:
    frames = np.stack([LIPS] * 3)
    frames[opening_frame - 1, 1, 0, 1] = -0.5  # a corner of the mouth opens, the other stays shut
    for frame, corners in enumerate(frames, start=1):
        (tmp_path / f"a_{frame}.stl").write_bytes(binary(corners))
    sequence = read(tmp_path / "a_#.stl")
    assert sequence.faces.tolist() == [[0, 1, 2], [3, 0, 4]]
    np.testing.assert_array_equal(sequence.points[:, sequence.faces], frames)


def grid(rows: int, at: float) -> tuple[FloatArray, FloatArray]:
    """Return points ``(V, 3)`` of a bent grid far from the origin, and its triangles ``(F, 3)``."""
    x, y = np.meshgrid(np.arange(rows), np.arange(rows), indexing="ij")
    points = np.stack([x, y, np.sin(x) * y / 7], axis=-1).reshape(-1, 3) / 7 + at
    corner = (x * rows + y)[:-1, :-1].reshape(-1)
    faces = [[corner, corner + rows, corner + 1], [corner + 1, corner + rows, corner + rows + 1]]
    return points, np.concatenate([np.stack(each, axis=1) for each in faces])


@pytest.mark.parametrize("make", [binary, text])
def test_corners_apart_in_the_last_digit_are_one_vertex(tmp_path: Path, make: object) -> None:
    assert callable(make)
    points, faces = grid(5, at=100)
    rng = np.random.default_rng(1)
    digit = np.spacing(np.float32(100)) if make is binary else 1e-4  # of nine digits, six are written as text
    for frame in (1, 2, 3):
        corners = points[faces] + rng.integers(-1, 2, (*faces.shape, 3)) * digit
        data = make(corners.astype(np.float32)) if make is binary else make(corners.round(4))
        (tmp_path / f"a_{frame}.stl").write_bytes(data)
    got = read(tmp_path / "a_#.stl")
    assert got.vertex_count == len(points)
    np.testing.assert_allclose(got.points[:, got.faces], np.stack([points[faces]] * 3), rtol=0, atol=2 * digit)


def test_small_triangles_and_thin_shells_are_kept(tmp_path: Path) -> None:
    step = float(np.spacing(np.float32(100)))
    speck = np.array([[100, 0, 0], [100 + step, 0, 0], [100, 1, 0]], dtype=np.float32)
    (tmp_path / "speck.stl").write_bytes(binary(speck[None]))
    assert read(tmp_path / "speck.stl").faces.tolist() == [[0, 1, 2]]
    tetrahedron = np.array([[100, 0, 0], [101, 0, 0], [100, 1, 0], [100, 0, 1]], dtype=np.float32)
    closed = tetrahedron[[[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]]
    (tmp_path / "shells.stl").write_bytes(binary(np.concatenate([closed, closed + np.array([step, 0, 0])])))
    assert read(tmp_path / "shells.stl").vertex_count == 8  # both are closed without welding


def test_changing_numbers_of_triangles(tmp_path: Path) -> None:
    (tmp_path / "a_1.stl").write_bytes(binary(SQUARE[FACES]))
    (tmp_path / "a_2.stl").write_bytes(binary(SQUARE[FACES[:1]]))
    with pytest.raises(InvalidSequenceError, match=r"a_2\.stl \(frame 2\): it has 1 triangles, the first frame has 2"):
        read(tmp_path / "a_#.stl")


def test_what_is_written_is_read(tmp_path: Path) -> None:
    points = np.random.default_rng(3).normal(size=(3, 5, 3)) * 1e7
    written = MeshSequence.from_arrays(points, [[0, 1, 2], [2, 1, 3], [0, 4, 1]])
    write(tmp_path / "a_#.stl", written)
    got = read(tmp_path / "a_#.stl")
    np.testing.assert_array_equal(got.points, points.astype(np.float32))
    assert got.polygons.same_as(written.polygons)


def test_lips_that_open_are_written_and_read(tmp_path: Path) -> None:
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    points = np.stack([LIPS.reshape(-1, 3)] * 2)
    points[1, 3:, 1] -= 0.5
    write(tmp_path / "a_#.stl", MeshSequence.from_arrays(points, faces))  # warnings are errors
    np.testing.assert_array_equal(read(tmp_path / "a_#.stl").points, points)
    with pytest.warns(MixseqWarning, match="4 will be read instead of 6.*at one position in all frames"):
        write(tmp_path / "b_#.stl", MeshSequence.from_arrays(points[:1], faces))


def test_normals_of_triangles(tmp_path: Path) -> None:
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 0]], dtype=np.float32)[None]
    with pytest.warns(MixseqWarning, match="3 will be read instead of 4"):
        write(tmp_path / "a.stl", MeshSequence.from_arrays(points, [[0, 1, 2], [0, 3, 1]]))
    data = (tmp_path / "a.stl").read_bytes()
    assert struct.unpack_from("<3f", data, 84) == (0, 0, 1)
    assert struct.unpack_from("<3f", data, 134) == (0, 0, 0)  # it has no area


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 2], [0, 2, 4]], "4 will be read instead of 5, as unused ones are lost"),
        ([[1, 0, 2], [0, 3, 4]], "vertices will be read in another"),
        (Polygons(np.array([5]), np.arange(5)), "STL files cannot hold polygons"),
    ],
)
def test_what_stl_cannot_hold(tmp_path: Path, faces: object, message: str) -> None:
    points = np.random.default_rng(3).normal(size=(1, 5, 3)).astype(np.float32)
    with pytest.warns(MixseqWarning, match=message):
        write(tmp_path / "a.stl", MeshSequence.from_arrays(points, faces))  # type: ignore[arg-type]


def test_what_is_on_the_mesh_is_lost(tmp_path: Path) -> None:
    surface = Surface(face_sets=(FaceSet("a", np.array([0]), "red"),), hard_edges=np.arange(6))
    sequence = replace(MeshSequence.from_arrays(SQUARE[None], FACES), surface=surface)
    with pytest.warns(MixseqWarning, match="STL files cannot hold hard edges, face sets; "):
        write(tmp_path / "a.stl", sequence)


def test_truncated_and_longer_files(tmp_path: Path) -> None:
    file = tmp_path / "bad.stl"
    content = binary(SQUARE[FACES])
    for data in (*(content[:end] for end in range(0, len(content), 3)), content[:-1], content + b"\n"):
        file.write_bytes(data)
        with pytest.raises(FormatError, match=r"bad\.stl"):
            read(file)
    content = text(SQUARE[FACES]).rstrip()
    for end in range(0, len(content) - len(" solid vertex 3"), 3):
        file.write_bytes(content[:end])
        with pytest.raises(FormatError, match=r"bad\.stl"):
            read(file)


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        (b"vertex 0 0 0", b"vertex 0 0 x", FormatError, "line 4: 'vertex 0 0 x' is not a vertex"),
        (b"vertex 0 0 0", b"vertex 0 0", FormatError, "line 4: 'vertex 0 0' is not expected here"),
        (b"    vertex 0 0 0\n", b"", FormatError, "'endfacet' is not expected here"),
        (b"endsolid", b"solid", FormatError, "is not expected here"),
        (b"vertex 0 0 0", b"vertex nan 0 0", InvalidSequenceError, "coordinates must be finite"),
        (
            b"facet normal 0 0 1\n",
            b"facet normal 0 0 1\nfacet",
            FormatError,
            "'facet  OUTER LOOP' is not expected here",
        ),
        (b"facet normal", b"triangle", FormatError, "'triangle 0 0 1' is not expected here"),
    ],
)
def test_damaged_text(tmp_path: Path, old: bytes, new: bytes, error: type[Exception], message: str) -> None:
    (tmp_path / "bad.stl").write_bytes(text(SQUARE[FACES], "a").replace(old, new, 1))
    with pytest.raises(error, match=f"bad.stl.*{message}"):
        read(tmp_path / "bad.stl")


def test_facets_without_vertices(tmp_path: Path) -> None:
    lines = text(SQUARE[FACES], "a").splitlines(keepends=True)
    (tmp_path / "bad.stl").write_bytes(b"".join(lines[:3] + lines[6:]))
    with pytest.raises(FormatError, match=r"bad.stl, line 5: 'endfacet' is not expected here"):
        read(tmp_path / "bad.stl")


def test_no_triangles(tmp_path: Path) -> None:
    for content in (binary(SQUARE[FACES][:0]), text(SQUARE[FACES][:0])):
        (tmp_path / "bad.stl").write_bytes(content)
        with pytest.raises(InvalidSequenceError, match=r"bad\.stl: the mesh has 0 vertices"):
            read(tmp_path / "bad.stl")


@pytest.mark.parametrize("kind", ["stl", "stl_ascii"])
def test_trimesh_agrees(tmp_path: Path, kind: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=1)
    exported = ball.export(file_type=kind)
    (tmp_path / "theirs.stl").write_bytes(exported.encode() if isinstance(exported, str) else exported)
    theirs = read(tmp_path / "theirs.stl")
    assert theirs.vertex_count == len(ball.vertices)
    np.testing.assert_allclose(theirs.points[0][theirs.faces], ball.triangles, rtol=0, atol=1e-7)
    write(tmp_path / "ours.stl", theirs)
    got = trimesh.load(tmp_path / "ours.stl", process=False)
    np.testing.assert_array_equal(got.triangles, theirs.points[0].astype(np.float32)[theirs.faces])
    np.testing.assert_allclose(got.face_normals, ball.face_normals, atol=1e-6)
