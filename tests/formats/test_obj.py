"""Numbered OBJ files: names, numbers, dialects of the text, and what OBJ cannot hold."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqWarning, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write

TRIANGLE = "v 0 0 {z}\nv 1 0 {z}\nv 0 1 {z}\nf 1 2 3\n"


def save(folder: Path, *names: str, text: str = TRIANGLE) -> None:
    for z, name in enumerate(names):
        (folder / name).write_text(text.format(z=z))


@pytest.mark.parametrize("pattern", ["walk_####.obj", "walk_%04d.obj", "walk_*.obj", "walk*", "."])
def test_ways_to_name_a_sequence(tmp_path: Path, pattern: str) -> None:
    save(tmp_path, "walk_0009.obj", "walk_0010.obj", "walk_0011.obj")
    if pattern == "walk*":
        pattern = "w?lk_00*.obj"
    sequence = read(tmp_path / pattern, fps=10)
    np.testing.assert_array_equal(sequence.points[:, 0, 2], [0, 1, 2])
    np.testing.assert_allclose(sequence.times, [0.9, 1.0, 1.1])
    assert (sequence.name, sequence.fps) == ("walk", 10)


def test_frames_are_sorted_by_number_not_by_name(tmp_path: Path) -> None:
    save(tmp_path, "walk9.obj", "walk10.obj", "walk11.obj")
    for pattern in ("walk#.obj", "walk%d.obj", "walk*.obj"):
        assert read(tmp_path / pattern).points[:, 0, 2].tolist() == [0, 1, 2]
    with pytest.raises(FormatError, match="no numbered files of this name"):
        read(tmp_path / "walk####.obj")


def test_other_files_are_left_out(tmp_path: Path) -> None:
    save(tmp_path, "walk_1.obj", "walk_2.obj", "walk_3.obj.bak", "walk_.obj", "run_3.obj")
    assert read(tmp_path / "walk_#.obj").frame_count == 2


def test_a_single_file(tmp_path: Path) -> None:
    save(tmp_path, "walk_0009.obj", "odd#name*.obj")
    for name in ("walk_0009.obj", "odd#name*.obj"):
        assert read(tmp_path / name).times.tolist() == [0]


def test_gaps(tmp_path: Path) -> None:
    save(tmp_path, "a_01.obj", "a_02.obj", "a_04.obj", "a_10.obj")
    with pytest.raises(InvalidSequenceError, match=r"numbers 3, 5-9 are missing between a_01.obj and a_10.obj"):
        read(tmp_path / "a_##.obj")
    sequence = read(tmp_path / "a_##.obj", allow_gaps=True, fps=1)
    assert sequence.times.tolist() == [1, 2, 4, 10]


def test_double_numbers(tmp_path: Path) -> None:
    save(tmp_path, "a_1.obj", "a_01.obj")
    with pytest.raises(InvalidSequenceError, match="have the same number"):
        read(tmp_path / "a_*.obj")


def test_several_sequences_in_a_folder(tmp_path: Path) -> None:
    save(tmp_path, "cat_1.obj", "cat_2.obj", "dog_1.obj")
    with pytest.raises(AmbiguousError, match=r"several sequences: cat_#\.obj, dog_#\.obj"):
        read(tmp_path)
    assert read(tmp_path / "cat_*.obj").frame_count == 2


def test_an_empty_folder(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="without numbered files"):
        read(tmp_path)


DIALECT = """# comment
mtllib a.mtl
o  Spot the cow
v\t0 0 0 1.0
 v 1 0 0 0.5 0.5 0.5
v 1 1 0
v 0 1 \\
  1e-1
vt 0 0
vn 0 0 1
g body
usemtl skin
s off
f 1/1/1 2/1/1 3//1 4
v 5 5 5
f -1 -2/1 -3
l 1 2
p 3
f 1 2 3 4 5
"""


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_dialects_of_the_text(tmp_path: Path, ends: str) -> None:
    (tmp_path / "cow.obj").write_bytes(DIALECT.replace("\n", ends).encode())
    sequence = read(tmp_path / "cow.obj")
    assert sequence.points[0].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.1], [5, 5, 5]]
    assert sequence.polygons.counts.tolist() == [4, 3, 5]
    assert sequence.polygons.indices.tolist() == [0, 1, 2, 3, 4, 3, 2, 0, 1, 2, 3, 4]
    assert sequence.name == "Spot the cow"
    assert sequence.points.dtype == np.float64
    assert [(each.name, each.material, each.polygons.tolist()) for each in sequence.surface.face_sets] == [
        ("skin", "skin", [0, 1, 2]),
        ("body", "", [0, 1, 2]),
    ]


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("v 0 0\nf 1 2 3", FormatError, r"line 1: 'v 0 0' is not a vertex; three numbers"),
        ("v 0 0 x", FormatError, "line 1: 'v 0 0 x' is not a vertex"),
        (TRIANGLE.format(z=0) + "f 1 2 a", FormatError, "face 1: 'f 1 2 a' is not a face"),
        (TRIANGLE.format(z=0) + "f 0 1 2", FormatError, "face 1: 'f 0 1 2' is not a face"),
        (TRIANGLE.format(z=0) + "f 1 2 99999999999999999999", FormatError, "is not a face"),
        ("vt x\n" + TRIANGLE.format(z=0), FormatError, "line 1: 'vt x' is not a texture coordinate"),
        ("vn 0 1\n" + TRIANGLE.format(z=0), FormatError, "line 1: 'vn 0 1' is not a normal; three numbers"),
        (TRIANGLE.format(z=0) + "f 1/a 2 3", FormatError, "face 1: 'f 1/a 2 3' is not a face"),
        ("vt 0\n" + TRIANGLE.format(z=0) + "f 1/1 2/2 3", FormatError, "face 1 uses texture coordinate 2"),
        ("vt 0\n" + TRIANGLE.format(z=0) + "f 1/1 2/-2 3", FormatError, "face 1 uses texture coordinate 0"),
        (
            "vn 0 0 1\n" + TRIANGLE.format(z=0).replace("f 1 2 3", "f 1//1 2//1 3//2"),
            FormatError,
            "face 0 uses normal 2",
        ),
        (TRIANGLE.format(z=0) + "f 1 2", InvalidSequenceError, "polygon 1 has 2 corners"),
        (TRIANGLE.format(z=0) + "f 1 2 4", InvalidSequenceError, "face 1 uses vertex 3, but vertices are 0 to 2"),
        (TRIANGLE.format(z=0) + "f 1 2 -4", InvalidSequenceError, "face 1 uses vertex -1"),
        (TRIANGLE.format(z="nan"), InvalidSequenceError, "frame 0: vertex 0 is"),
        (TRIANGLE.format(z="1e999"), InvalidSequenceError, "frame 0: vertex 0 is"),
        ("v 0 0 0\nv 1 1 1\nv 2 2 2", InvalidSequenceError, "has no faces"),
        ("hello", FormatError, "no vertices"),
        (TRIANGLE.format(z=0) + "fo 1 2", InvalidSequenceError, "polygon 1 has 2 corners"),
    ],
)
def test_bad_text(tmp_path: Path, text: str, error: type[Exception], message: str) -> None:
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(error, match=f"bad.obj.*{message}"):
        read(tmp_path / "bad.obj")


def test_lines_that_mean_nothing_are_told(tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text(TRIANGLE.format(z=0) + "d 1 2 3\n\x00\nF 3 2 1\n")
    with pytest.warns(MixseqWarning, match=r"bad.obj, line 5: 'd 1 2 3' is not a statement .* like 2 other lines"):
        assert len(read(tmp_path / "bad.obj").faces) == 1


def test_changing_connectivity(tmp_path: Path) -> None:
    save(tmp_path, "a_1.obj", "a_2.obj", "a_3.obj")
    (tmp_path / "a_3.obj").write_text(TRIANGLE.format(z=0).replace("1 2 3", "2 1 3"))
    with pytest.raises(InvalidSequenceError, match=r"a_3\.obj \(frame 3\) has other faces than .*a_1\.obj"):
        read(tmp_path / "a_#.obj")
    (tmp_path / "a_3.obj").write_text("v 0 0 0\n" + TRIANGLE.format(z=0))
    with pytest.raises(InvalidSequenceError, match=r"a_3\.obj \(frame 3\) has 4 vertices, .*a_1\.obj has 3"):
        read(tmp_path / "a_#.obj")


def test_the_same_faces_written_otherwise(tmp_path: Path) -> None:
    save(tmp_path, "a_1.obj", "a_2.obj")
    (tmp_path / "a_2.obj").write_text(TRIANGLE.format(z=7).replace("f 1 2 3", "f -3/1 -2/1 -1/1"))
    assert read(tmp_path / "a_#.obj").points[1, 0, 2] == 7


def test_numbers_of_written_files(tmp_path: Path, plain: MeshSequence) -> None:
    write(tmp_path / "out_####.obj", plain)
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"out_000{i}.obj" for i in range(5)]
    write(tmp_path / "big.%d.obj", plain, start=98)
    assert len(list(tmp_path.glob("big.*.obj"))) == 5
    with pytest.raises(SettingsError, match="start is -1"):
        write(tmp_path / "out_####.obj", plain, start=-1)


def test_several_frames_need_a_pattern(tmp_path: Path, plain: MeshSequence) -> None:
    for name in ("out.obj", "out_*.obj"):
        with pytest.raises(OutputError, match=r"holds one frame, this sequence has 5; .* such as out_+####\.obj"):
            write(tmp_path / name, plain)
    single = MeshSequence.from_arrays(plain.points[:1], plain.polygons)
    write(tmp_path / "out.obj", single)
    np.testing.assert_array_equal(read(tmp_path / "out.obj").points, single.points)


def test_one_warning_names_all_that_is_lost(tmp_path: Path, plain: MeshSequence) -> None:
    rich = MeshSequence.from_arrays(
        plain.points, plain.polygons, times=[0, 1, 2, 3, 5], fps=30, up_axis="Z", metres_per_unit=0.01
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write(tmp_path / "out_#.obj", rich)
    (warning,) = caught
    assert warning.category is MixseqWarning
    assert "30 frames per second, the times of the frames, Z up, 0.01 metres per unit" in str(warning.message)
    assert warning.filename == __file__  # the line that wrote, not one of ours


def test_leftovers_of_a_longer_sequence(tmp_path: Path, plain: MeshSequence) -> None:
    write(tmp_path / "out_#.obj", plain)
    shorter = MeshSequence.from_arrays(plain.points[:3], plain.polygons)
    with pytest.warns(MixseqWarning, match=r"2 files of another sequence, out_3\.obj to out_4\.obj"):
        write(tmp_path / "out_#.obj", shorter)


def test_rate_out_of_range(tmp_path: Path) -> None:
    save(tmp_path, "a.obj")
    with pytest.raises(SettingsError, match="fps is 0"):
        read(tmp_path / "a.obj", fps=0)


SQUARES = """o left
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0.5
usemtl red
f 1/1 2/2 3/-2 4
o right
v 2 0 0
v 3 0 0
v 3 1 0
usemtl blue
f -3/4 -2/1 -1/1
"""


def test_texture_coordinates(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(SQUARES)
    uvs = read(tmp_path / "a.obj").surface.uvs
    assert uvs is not None
    # The fourth corner has none; -2 is the last but one of those before its face.
    assert uvs.at_corners.tolist() == [[0, 0], [1, 0], [1, 1], [0, 0], [0.5, 0], [0, 0], [0, 0]]


def test_coordinates_that_no_file_has(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(TRIANGLE.format(z=0).replace("1 2 3", "1/1/1 2/2/2 3/3/3"))
    surface = read(tmp_path / "a.obj").surface
    assert surface.uvs is None and surface.hard_edges is None


def test_objects_with_vertices_of_their_own(tmp_path: Path) -> None:
    vertices_first = sorted(SQUARES.splitlines(), key=lambda line: not line.startswith("v "))
    for text in (SQUARES, "\n".join(vertices_first).replace("-3/4 -2/1 -1/1", "5/4 6/1 7/1")):
        (tmp_path / "two.obj").write_text(text)
        sequence = read(tmp_path / "two.obj")
        assert sequence.objects == (MeshObject("left", "", 4, 1), MeshObject("right", "", 3, 1))
        assert sequence.name == "two"
        assert [(each.name, each.polygons.tolist()) for each in sequence.surface.face_sets] == [
            ("red", [0]),
            ("blue", [1]),
        ]


def test_objects_that_share_vertices_are_face_sets(tmp_path: Path) -> None:
    (tmp_path / "two.obj").write_text(SQUARES.replace("f -3/4", "f 1/4"))
    surface = read(tmp_path / "two.obj").surface
    assert surface.objects == ()
    assert [each.name for each in surface.face_sets] == ["red", "blue", "left", "right"]


def test_objects_without_a_mesh_do_not_count(tmp_path: Path) -> None:
    (tmp_path / "one.obj").write_text("o camera\no box\n" + TRIANGLE.format(z=0) + "o light\n")
    sequence = read(tmp_path / "one.obj")
    assert (sequence.name, sequence.surface.objects) == ("box", ())


def test_groups(tmp_path: Path) -> None:
    faces = "g body arm\nf 1 2 3\ng\nf 1 3 2\ng arm\nf 2 3 1\ng (null)\nusemtl (null)\nf 3 2 1\n"
    (tmp_path / "a.obj").write_text(TRIANGLE.format(z=0) + faces)
    sets = read(tmp_path / "a.obj").surface.face_sets
    assert [(each.name, each.material, each.polygons.tolist()) for each in sets] == [
        ("body", "", [1]),
        ("arm", "", [1, 3]),
    ]


ROOF = """v 0 0 0
v 1 0 0
v 1 1 1
v 0 1 1
v 1 2 0
v 0 2 0
{normals}
f 1//1 2//1 3//{a} 4//{a}
f 4//{b} 3//{b} 5//2 6//2
"""


def test_hard_edges_are_where_a_vertex_has_several_normals(tmp_path: Path) -> None:
    normals = "vn 0 -1 1\nvn 0 2 2\nvn 0 0 1\n"
    (tmp_path / "sharp.obj").write_text(ROOF.format(normals=normals, a=1, b=2))
    (tmp_path / "smooth.obj").write_text(ROOF.format(normals=normals, a=3, b=3))
    hard_edges = read(tmp_path / "sharp.obj").surface.hard_edges
    assert hard_edges is not None
    _, first, second, third, fourth, *_ = (int(group) for group in hard_edges[1:])
    assert len({first, second, third, fourth}) == 4
    assert read(tmp_path / "smooth.obj").surface.hard_edges is None


def rich(frames: int = 2) -> MeshSequence:
    """Two objects, seams of texture coordinates, a hard edge, materials on part of the mesh, groups that overlap."""
    points = np.random.default_rng(5).normal(size=(frames, 7, 3)).astype(np.float32)
    polygons = Polygons(np.array([4, 3, 3]), np.array([0, 1, 2, 3, 4, 5, 6, 4, 6, 5]))
    surface = Surface(
        uvs=CornerValues(np.random.default_rng(6).normal(size=(5, 2)), np.arange(10) % 5),
        hard_edges=np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
        face_sets=(
            FaceSet("red", np.array([0]), "/looks/red"),
            FaceSet("front", np.array([0, 2])),
            FaceSet("all", np.array([0, 1, 2])),
        ),
        objects=(MeshObject("left one", "", 4, 1), MeshObject("rechts 右", "", 3, 2)),
    )
    return replace(MeshSequence.from_arrays(points, polygons), surface=surface)


def test_what_is_on_the_mesh_is_kept(tmp_path: Path) -> None:
    written = rich()
    write(tmp_path / "a_#.obj", written)
    got = read(tmp_path / "a_#.obj")
    np.testing.assert_array_equal(got.points, written.points)
    assert got.polygons.same_as(written.polygons)
    assert got.surface.uvs is not None and written.surface.uvs is not None
    np.testing.assert_array_equal(got.surface.uvs.at_corners, written.surface.uvs.at_corners)
    assert got.surface.hard_edges is not None
    assert np.unique(got.surface.hard_edges).size == 10  # numbers may change, groups may not
    assert got.objects == written.objects
    assert [(each.name, each.material, each.polygons.tolist()) for each in got.surface.face_sets] == [
        ("red", "red", [0]),
        ("front", "", [0, 2]),
        ("all", "", [0, 1, 2]),
    ]


def test_normals_are_those_of_each_frame(tmp_path: Path) -> None:
    flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32)
    points = np.stack([flat, flat[:, [1, 2, 0]]])
    surface = Surface(hard_edges=np.arange(6))
    folded = replace(MeshSequence.from_arrays(points, [[0, 1, 2], [0, 2, 3]]), surface=surface)
    write(tmp_path / "a_#.obj", folded)
    for number, normal in ((0, "vn 0 0 1"), (1, "vn 0 1 0")):
        lines = (tmp_path / f"a_{number}.obj").read_text().splitlines()
        assert [line for line in lines if line.startswith("vn")] == [normal] * 6
        assert "f 1//1 2//2 3//3" in lines


def test_materials_of_the_same_last_name_keep_their_paths(tmp_path: Path) -> None:
    sets = (FaceSet("/a/red", np.array([0]), "/a/red"), FaceSet("/b/red", np.array([1]), "/b/red"))
    sequence = replace(rich(1), surface=Surface(face_sets=sets))
    write(tmp_path / "a.obj", sequence)
    assert [each.material for each in read(tmp_path / "a.obj").surface.face_sets] == ["/a/red", "/b/red"]


@pytest.mark.parametrize(
    ("surface", "message"),
    [
        (Surface(subdivision="catmullClark"), "catmullClark subdivision"),
        (
            Surface(face_sets=(FaceSet("a", np.array([0, 1]), "a"), FaceSet("b", np.array([1]), "b"))),
            "several materials on one polygon",
        ),
        (Surface(face_sets=(FaceSet("a", np.array([0]), "/looks/b"),)), "names of face sets that differ"),
        (Surface(face_sets=(FaceSet("left arm", np.array([0])),)), "spaces in the names of face sets"),
    ],
)
def test_what_obj_cannot_hold_of_a_surface(tmp_path: Path, surface: Surface, message: str) -> None:
    with pytest.warns(MixseqWarning, match=message):
        write(tmp_path / "a.obj", replace(rich(1), surface=surface))
    read(tmp_path / "a.obj")


def test_relative_numbers_mean_other_vertices_after_other_lines(tmp_path: Path) -> None:
    vertices = [f"v {x} {x * x} 0" for x in range(4)]
    (tmp_path / "a_1.obj").write_text("\n".join([*vertices[:3], "f -3 -2 -1", vertices[3]]))
    (tmp_path / "a_2.obj").write_text("\n".join([*vertices, "f -3 -2 -1"]))
    with pytest.raises(InvalidSequenceError, match="other faces"):
        read(tmp_path / "a_#.obj")


def colours_of(path: Path) -> list[list[float]]:
    found = read(path).surface.colours
    assert found is not None
    rounded: list[list[float]] = np.round(found.at_corners.astype(np.float64), 6).tolist()
    return rounded


@pytest.mark.parametrize("red", ["1 0 0.2", "255 0 51"])
def test_colours_follow_the_coordinates(tmp_path: Path, red: str) -> None:
    (tmp_path / "a.obj").write_text(f"v 0 0 0 {red}\nv 1 0 0\nv 0 1 0 0 0 0\nf 3 2 1\n")
    assert colours_of(tmp_path / "a.obj") == [[0, 0, 0, 1], [1, 1, 1, 1], [1, 0, 0.2, 1]]
    assert read(tmp_path / "a.obj").points[0].tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


def test_weights_are_no_colours(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n")
    assert read(tmp_path / "a.obj").surface.colours is None
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0 1 red 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FormatError, match=r"a.obj, vertex 1: the colour '1 red 0' is not 3 numbers"):
        read(tmp_path / "a.obj")
