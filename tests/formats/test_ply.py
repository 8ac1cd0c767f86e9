"""PLY files: dialects of the header, text and binary of both byte orders, polygons, and damage."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write

HEADER = """ply
format {format} 1.0
comment a quad and a triangle
obj_info anything
element vertex 5
property {real} x
property {real} y
property {real} z
property uchar red
element face 2
property list uchar int vertex_indices
property float quality
element edge 1
property int vertex1
property int vertex2
end_header
"""
POINTS: list[list[float]] = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.1], [0, 2, 0.25]]
FACES: list[list[int]] = [[0, 1, 2, 3], [3, 2, 4]]


def text() -> bytes:
    rows = [" ".join(map(str, point)) + " 255" for point in POINTS]
    rows += [" ".join(map(str, [len(face), *face])) + " 0.5" for face in FACES]
    return (HEADER.format(format="ascii", real="double") + "\n".join([*rows, "0 1"]) + "\n").encode()


def binary(order: str, real: str = "double") -> bytes:
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    code = {"double": "d", "float32": "f"}[real]
    data = HEADER.format(format=kind, real=real).encode()
    data += b"".join(struct.pack(f"{order}3{code}B", *point, 255) for point in POINTS)
    for face in FACES:
        data += struct.pack(f"{order}B{len(face)}if", len(face), *face, 0.5)
    return data + struct.pack(f"{order}2i", 0, 1)


@pytest.mark.parametrize(
    "content", [text(), text().replace(b"\n", b"\r\n"), binary("<"), binary(">")], ids=["text", "crlf", "little", "big"]
)
def test_dialects(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    sequence = read(tmp_path / "a.ply")
    assert sequence.points.dtype == np.float64
    assert sequence.points[0].tolist() == POINTS
    assert sequence.polygons.counts.tolist() == [4, 3]
    assert sequence.polygons.indices.tolist() == [0, 1, 2, 3, 3, 2, 4]
    assert (sequence.name, sequence.surface.uvs) == ("a", None)


def test_single_precision_stays(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(binary(">", "float32"))
    points = read(tmp_path / "a.ply").points
    assert points.dtype == np.float32
    np.testing.assert_array_equal(points[0], np.array(POINTS, dtype=np.float32))


def test_integer_coordinates(tmp_path: Path) -> None:
    content = text().replace(b"double", b"short").replace(b"0.1 255", b"7 255").replace(b"0.25", b"8")
    (tmp_path / "a.ply").write_bytes(content)
    assert read(tmp_path / "a.ply").points[0, 3:].tolist() == [[0, 1, 7], [0, 2, 8]]


def test_the_older_name_of_corners(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(text().replace(b"vertex_indices", b"vertex_index"))
    assert len(read(tmp_path / "a.ply").polygons.counts) == 2


@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices(tmp_path: Path, names: tuple[str, str]) -> None:
    content = text().replace(b"uchar red", f"float {names[0]}\nproperty float {names[1]}".encode())
    (tmp_path / "a.ply").write_bytes(content.replace(b" 255", b" 0.25 0.75"))
    uvs = read(tmp_path / "a.ply").surface.uvs
    assert uvs is not None
    assert uvs.at_corners.tolist() == [[0.25, 0.75]] * 7


def with_surface(surface: Surface) -> MeshSequence:
    points = np.random.default_rng(1).normal(size=(2, 5, 3))
    polygons = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 3, 2, 4]))
    return replace(MeshSequence.from_arrays(points, polygons), surface=surface)


@pytest.mark.parametrize("seam", [False, True])
def test_texture_coordinates_are_kept(tmp_path: Path, seam: bool) -> None:
    values = np.random.default_rng(2).normal(size=(7, 2)).astype(np.float32)
    indices = np.arange(7) if seam else np.array([0, 1, 2, 3, 3, 2, 4])
    written = with_surface(Surface(uvs=CornerValues(values, indices)))
    write(tmp_path / "a_#.ply", written)
    got = read(tmp_path / "a_#.ply")
    assert got.surface.uvs is not None
    np.testing.assert_array_equal(got.surface.uvs.at_corners, values[indices])
    np.testing.assert_array_equal(got.points, written.points)
    assert got.polygons.same_as(written.polygons)
    assert (b"texcoord" in (tmp_path / "a_1.ply").read_bytes()) == seam


def with_wedges(quad: bytes, triangle: bytes) -> bytes:
    content = text().replace(b"property float quality", b"property list uchar float texcoord")
    return content.replace(b"1 2 3 0.5", b"1 2 3 " + quad).replace(b"3 2 4 0.5", b"3 2 4 " + triangle)


def test_faces_without_texture_coordinates_among_others(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(with_wedges(b"0", b"6 .25 0 1 0 1 1"))
    uvs = read(tmp_path / "a.ply").surface.uvs
    assert uvs is not None
    assert uvs.at_corners.tolist() == [[0, 0]] * 4 + [[0.25, 0], [1, 0], [1, 1]]
    (tmp_path / "a.ply").write_bytes(with_wedges(b"0", b"0"))
    assert read(tmp_path / "a.ply").surface.uvs is None


@pytest.mark.parametrize("count", [1, 4, 8])
def test_a_face_with_too_few_or_too_many_texture_coordinates(tmp_path: Path, count: int) -> None:
    (tmp_path / "bad.ply").write_bytes(with_wedges(b"8" + b" 0" * 8, b"%d" % count + b" 0" * count))
    with pytest.raises(FormatError, match=rf"bad.ply, face 1 has {count} numbers of .* for 3 corners"):
        read(tmp_path / "bad.ply")


def test_triangle_strips_are_refused(tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(text().replace(b"element edge", b"element tristrips"))
    with pytest.raises(FormatError, match=r"bad.ply has triangle strips, which are not read"):
        read(tmp_path / "bad.ply")


def test_what_ply_cannot_hold(tmp_path: Path) -> None:
    surface = Surface(
        hard_edges=np.arange(7),
        face_sets=(FaceSet("a", np.array([0])),),
        objects=(MeshObject("a", "", 5, 2), MeshObject("b", "", 0, 0)),
        subdivision="loop",
    )
    lost = "hard edges, face sets, the names of 2 objects, loop subdivision; USD"
    with pytest.warns(MixseqWarning, match=f"PLY files cannot hold {lost}"):
        write(tmp_path / "a_#.ply", with_surface(surface))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"ply\n", b"plx\n", "no header"),
        (b"end_header", b"end_of", "no header"),
        (b"format ascii 1.0\n", b"", "is invalid|no format line"),
        (b"format ascii 1.0", b"format ascii 2.0", "is invalid"),
        (b"format ascii", b"format zipped", "is invalid"),
        (b"property double x", b"property quad x", "'property quad x' of its header is invalid"),
        (b"list uchar", b"list float", "is invalid"),
        (b"element vertex 5", b"element vertex -5", "'element vertex -5' of its header"),
        (b"element vertex 5", b"element vertex 4000000000", "too short for 4000000000 times element vertex"),
        (b"element vertex 5", b"element vertex " + b"9" * 200, "is invalid"),
        (b"element vertex 5", b"element vertex 4", "list of|too short|too many|ends within"),
        (b"element face 2", b"element face 1", "extra bytes|list of"),
        (b"element edge 1", b"element edge 0", "16 extra bytes follow"),
        (b"property double y", b"property double x", "a name twice among x, x, z"),
        (b"element edge", b"element face", "a name twice among vertex, face, face"),
        (b"property double x", b"property double w", "no vertices with x, y and z"),
        (b"vertex_indices", b"corners", "no faces with vertex_indices"),
        (b"3 3 2 4 0.5", b"-3 3 2 4 0.5", "list of -3 numbers"),
        (b"3 3 2 4 0.5", b"nan 3 2 4 0.5", "list of nan numbers"),
        (b"3 3 2 4 0.5", b"1e300 3 2 4 0.5", "list of"),
        (b"3 3 2 4 0.5", b"3 3 2 x 0.5", "damaged, truncated or of another type$"),
        (b"3 3 2 4 0.5", b"3 3 2 1.5 0.5", "not a vertex number"),
        (b"3 3 2 4 0.5", b"3 3 2 inf 0.5", "not a vertex number"),
    ],
)
def test_damaged_text(tmp_path: Path, old: bytes, new: bytes, message: str) -> None:
    assert old in text()
    (tmp_path / "bad.ply").write_bytes(text().replace(old, new))
    with pytest.raises(FormatError, match=rf"bad\.ply cannot be read as a PLY file.*({message})"):
        read(tmp_path / "bad.ply")


def test_faces_of_vertices_that_do_not_exist(tmp_path: Path) -> None:
    (tmp_path / "bad.ply").write_bytes(text().replace(b"3 3 2 4", b"3 3 2 5"))
    with pytest.raises(InvalidSequenceError, match=r"bad\.ply: face 1 uses vertex 5, but vertices are 0 to 4"):
        read(tmp_path / "bad.ply")
    (tmp_path / "bad.ply").write_bytes(text().replace(b"3 3 2 4 ", b"2 3 2 "))
    with pytest.raises(InvalidSequenceError, match=r"bad\.ply: polygon 1 has 2 corners"):
        read(tmp_path / "bad.ply")


@pytest.mark.parametrize("order", ["<", ">"])
def test_truncated_and_longer_files(tmp_path: Path, order: str) -> None:
    content = binary(order)
    for end in {*range(0, len(content), 3), len(content) - 1}:
        (tmp_path / "bad.ply").write_bytes(content[:end])
        with pytest.raises(FormatError, match=r"bad\.ply"):
            read(tmp_path / "bad.ply")
    (tmp_path / "bad.ply").write_bytes(content + b"more")
    with pytest.raises(FormatError, match="4 extra bytes"):
        read(tmp_path / "bad.ply")


def test_lists_longer_than_the_file(tmp_path: Path) -> None:
    content = (
        binary("<")
        .replace(b"list uchar", b"list uint ")
        .replace(struct.pack("<Bi", 4, 0), struct.pack("<I", 2**32 - 1))
    )
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(FormatError, match="list of 4"):
        read(tmp_path / "bad.ply")


def test_changing_connectivity(tmp_path: Path) -> None:
    (tmp_path / "a_1.ply").write_bytes(text())
    (tmp_path / "a_2.ply").write_bytes(binary(">"))  # the same in other bytes
    assert read(tmp_path / "a_#.ply").frame_count == 2
    (tmp_path / "a_2.ply").write_bytes(text().replace(b"3 3 2 4", b"3 2 4 3"))
    with pytest.raises(InvalidSequenceError, match=r"a_2\.ply \(frame 2\) has other faces than .*a_1\.ply"):
        read(tmp_path / "a_#.ply")
    more = text().replace(b"vertex 5", b"vertex 6").replace(b"4 0 1 2 3", b"9 9 9 255\n4 0 1 2 3")
    (tmp_path / "a_2.ply").write_bytes(more)
    with pytest.raises(InvalidSequenceError, match=r"a_2\.ply \(frame 2\) has 6 vertices, .*a_1\.ply has 5"):
        read(tmp_path / "a_#.ply")
    more = text().replace(b"face 2", b"face 3").replace(b"\n0 1\n", b"\n3 0 1 4 0.5\n0 1\n")
    (tmp_path / "a_2.ply").write_bytes(more)
    with pytest.raises(InvalidSequenceError, match="other faces"):
        read(tmp_path / "a_#.ply")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_trimesh_agrees(tmp_path: Path, encoding: str) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=1)
    (tmp_path / "theirs.ply").write_bytes(ball.export(file_type="ply", encoding=encoding))
    theirs = read(tmp_path / "theirs.ply")
    np.testing.assert_allclose(theirs.points[0], ball.vertices, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(theirs.faces, ball.faces)
    ours = MeshSequence.from_arrays(np.asarray(ball.vertices)[None], ball.faces)
    write(tmp_path / "ours.ply", ours)
    got = trimesh.load(tmp_path / "ours.ply", process=False)
    np.testing.assert_array_equal(got.vertices, ours.points[0])
    np.testing.assert_array_equal(got.faces, ours.faces)


def painted(vertex: str = "", of_vertices: str = "", face: str = "", of_faces: tuple[str, str] = ("", "")) -> bytes:
    """Return a text file of a quad and a triangle with more properties, and their numbers."""
    head = ["ply", "format ascii 1.0", "element vertex 5"]
    head += [*(f"property float {axis}" for axis in "xyz"), *filter(None, [vertex]), "element face 2"]
    head += ["property list uchar int vertex_indices", *filter(None, [face]), "end_header"]
    rows = [" ".join(map(str, point)) + f" {of_vertices}" for point in POINTS]
    rows += [f"{len(each)} {' '.join(map(str, each))} {own}" for each, own in zip(FACES, of_faces, strict=True)]
    return "\n".join([*head, *rows]).encode() + b"\n"


def channels(kind: str, *names: str) -> str:
    return "\n".join(f"property {kind} {name}" for name in names)


WEDGES = ("12 " + "1 0 0.2 " * 4, "9 " + "0 0 1 " * 3)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (painted(channels("uchar", "red", "green", "blue"), "255 0 51"), [[1, 0, 0.2, 1]] * 7),
        (painted(channels("uchar", "red", "green", "blue", "alpha"), "0 0 51 102"), [[0, 0, 0.2, 0.4]] * 7),
        (painted(channels("float", "red", "green", "blue"), "1 0 0.2"), [[1, 0, 0.2, 1]] * 7),
        (
            painted(face=channels("uchar", "red", "green", "blue"), of_faces=("255 0 0", "0 0 255")),
            [[1, 0, 0, 1]] * 4 + [[0, 0, 1, 1]] * 3,
        ),
        (painted(face="property list uchar float color", of_faces=WEDGES), [[1, 0, 0.2, 1]] * 4 + [[0, 0, 1, 1]] * 3),
        (
            painted(face="property list uchar float color", of_faces=(WEDGES[0], "0")),
            [[1, 0, 0.2, 1]] * 4 + [[1, 1, 1, 1]] * 3,
        ),
        (painted(channels("uchar", "red", "green", "blue"), "1 0 1"), [[1 / 255, 0, 1 / 255, 1]] * 7),
        (painted(channels("int", "red", "green", "blue"), "255 0 51"), [[1, 0, 0.2, 1]] * 7),
        (painted(channels("ushort", "red", "green", "blue"), "13107 0 65535"), [[0.2, 0, 1, 1]] * 7),
        (painted(channels("ushort", "red", "green", "blue"), "65535 0 255"), [[1, 0, 255 / 65535, 1]] * 7),
        (
            painted(channels("short", "red", "green", "blue") + "\nproperty uchar alpha", "255 51 0 51"),
            [[1, 0.2, 0, 0.2]] * 7,
        ),
        (
            painted(channels("uchar", "red", "green", "blue") + "\nproperty float alpha", "255 51 1 0.5"),
            [[1, 0.2, 1 / 255, 0.5]] * 7,
        ),
        (
            painted(channels("float", "red", "green", "blue") + "\nproperty uchar alpha", "1 0.5 0.25 51"),
            [[1, 0.5, 0.25, 0.2]] * 7,
        ),
        (
            painted(face="property list uchar uchar color", of_faces=("12" + 12 * " 1", "9" + 9 * " 0")),
            [[1 / 255, 1 / 255, 1 / 255, 1]] * 4 + [[0, 0, 0, 1]] * 3,
        ),
        (painted(channels("uchar", "red", "green"), "255 0"), None),
    ],
    ids=[
        "bytes",
        "alpha",
        "floats",
        "faces",
        "corners",
        "some corners",
        "ones",
        "bytes in int",
        "ushort",
        "ushort, some small",
        "bytes in short",
        "float alpha",
        "byte alpha",
        "ones of corners",
        "two channels",
    ],
)
def test_colours(tmp_path: Path, content: bytes, expected: list[list[float]] | None) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    colours = read(tmp_path / "a.ply").surface.colours
    assert (colours is None) == (expected is None)
    if colours is not None:
        np.testing.assert_allclose(colours.at_corners, np.array(expected), atol=1e-7)


def test_bytes_beside_a_float_alpha_in_binary_files(tmp_path: Path) -> None:
    colour = channels("uchar", "red", "green", "blue") + "\nproperty float alpha"
    head = painted(colour).partition(b"end_header\n")[0].replace(b"ascii", b"binary_little_endian")
    rows = [struct.pack("<3f3Bf", *point, 255, 51, 1, 0.5) for point in POINTS]
    rows += [struct.pack(f"<B{len(face)}i", len(face), *face) for face in FACES]
    (tmp_path / "a.ply").write_bytes(head + b"end_header\n" + b"".join(rows))
    colours = read(tmp_path / "a.ply").surface.colours
    assert colours is not None
    np.testing.assert_allclose(colours.at_corners, [[1, 0.2, 1 / 255, 0.5]] * 7, atol=1e-7)


@pytest.mark.parametrize(
    ("of_faces", "told"),
    [
        (("3 1 0 0", "3 1 0 0"), r"face 0 has 3 numbers of colours for 4 corners, not 3 for each"),
        (("16" + 16 * " 1", "9" + 9 * " 1"), r"face 1 has 9 numbers of colours for 3 corners, not 4 for each"),
    ],
)
@pytest.mark.parametrize("also_vertices", [False, True])
def test_lists_of_colours_of_another_length(
    tmp_path: Path, of_faces: tuple[str, str], told: str, also_vertices: bool
) -> None:
    vertex = (channels("uchar", "red", "green", "blue"), "255 0 0") if also_vertices else ("", "")
    content = painted(*vertex, face="property list uchar float color", of_faces=of_faces)
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.warns(MixseqWarning, match=rf"a.ply, {told}; the colours of corners are left out"):
        colours = read(tmp_path / "a.ply").surface.colours
    if also_vertices:
        assert colours is not None
        assert colours.at_corners.tolist() == [[1, 0, 0, 1]] * 7
    else:
        assert colours is None


def test_colours_of_corners_that_change_over_frames(tmp_path: Path) -> None:
    for frame, last in enumerate(("0 0 1 ", "0 1 1 ")):
        of_faces = (WEDGES[0], "9 " + last * 3)
        content = painted(
            channels("uchar", "red", "green", "blue"), "9 9 9", "property list uchar float color", of_faces
        )
        (tmp_path / f"a_{frame}.ply").write_bytes(content)
    with pytest.warns(MixseqWarning, match=r"colours that change over time .*a_1.ply \(frame 1\) has others"):
        read(tmp_path / "a_#.ply")
    # Those of vertices are hidden by them.
    other = (tmp_path / "a_0.ply").read_bytes().replace(b"9 9 9", b"8 8 8")
    (tmp_path / "a_1.ply").write_bytes(other)
    assert read(tmp_path / "a_#.ply").frame_count == 2


@pytest.mark.parametrize(
    ("values", "property_"),
    [
        (np.tile([1, 0, 0.2, 1], (5, 1)), b"property uchar blue\nelement face"),
        (np.tile([1, 0, 0.2, 0.4], (5, 1)), b"property uchar alpha\nelement face"),
        (np.tile([1, 0, 0.3, 1], (5, 1)), b"property float blue\nelement face"),
    ],
    ids=["bytes", "alpha", "floats"],
)
def test_colours_are_written_in_few_bytes(tmp_path: Path, values: np.ndarray, property_: bytes) -> None:
    polygons = Polygons(np.array([4, 3]), np.concatenate(FACES))
    plain = MeshSequence.from_arrays(np.array([POINTS]), polygons)
    write(tmp_path / "a.ply", replace(plain, surface=Surface(colours=CornerValues(values, polygons.indices))))
    assert property_ in (tmp_path / "a.ply").read_bytes()
    colours = read(tmp_path / "a.ply").surface.colours
    assert colours is not None
    np.testing.assert_array_equal(colours.values, values.astype(np.float32))
