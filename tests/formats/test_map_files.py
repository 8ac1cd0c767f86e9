"""Files of maps: what we write comes back bit by bit, what others write is read, all else is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError, OutputError
from mixseq.retargeting.correspond import RestMesh, from_barycentric, from_vertices
from mixseq.retargeting.markers import Correspondence
from mixseq_io.text.maps import mesh_checksum, read_map, to_correspondence, write_map
from tests.meshes import grid, tetrahedron, torus

SOURCE, TARGET = torus(9, 6), tetrahedron()


def some_map() -> Correspondence:
    """A tetrahedron on a torus; its last vertex follows another."""
    rng = np.random.default_rng(0)
    corners = SOURCE[1][rng.integers(len(SOURCE[1]), size=4)]
    corners[3] = -1
    return from_barycentric(corners, rng.dirichlet([1, 1, 1], 4), SOURCE, TARGET)


def same(a: Correspondence, b: Correspondence) -> bool:
    names = "source_size", "target_size", "corners", "weights", "faces", "leaders"
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def loaded(file: Path, source: RestMesh = SOURCE, target: RestMesh = TARGET) -> Correspondence:
    return to_correspondence(read_map(file), source, target)


# What we write ------------------------------------------------------------------------------------------------


def test_what_is_written_is_read(tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    write_map(file, some_map(), SOURCE[1], TARGET[1])
    write_map(file, some_map(), SOURCE[1].astype(np.int32), TARGET[1])  # over the old one
    assert same(loaded(file), some_map())
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]


def test_maps_of_other_meshes_are_refused_by_name(tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    write_map(file, some_map(), SOURCE[1], TARGET[1])
    turned = TARGET[0], TARGET[1][:, ::-1]
    with pytest.raises(FormatError, match=r"map\.npz: this is a map of another target.*make a new map"):
        loaded(file, target=turned)
    with pytest.raises(FormatError, match="this is a map of another source"):
        loaded(file, source=(np.concatenate([SOURCE[0], [[0, 0, 0]]]), SOURCE[1]))


def test_checksums_are_of_the_connectivity() -> None:
    assert mesh_checksum(4, TARGET[1]) == mesh_checksum(4, TARGET[1].astype(np.int32))
    assert len({mesh_checksum(4, TARGET[1]), mesh_checksum(5, TARGET[1]), mesh_checksum(4, TARGET[1][::-1])}) == 3


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("version", np.int64(2), "is a map of version 2; this mixseq reads version 1"),
        ("corners", np.full((4, 3), 99), "'corners' does not fit"),
        ("corners", np.zeros((3, 3), int), "'corners' does not fit"),
        ("leaders", np.full(4, -1), "'leaders' does not fit"),
        ("faces", np.zeros(4), "'faces' does not fit"),
        ("weights", np.full((4, 3), np.nan), "'weights' does not fit"),
        ("leaders", None, "has no array 'leaders'; it is damaged"),
    ],
)
def test_damage_is_told(tmp_path: Path, name: str, value: Any, message: str) -> None:
    file = tmp_path / "map.npz"
    write_map(file, some_map(), SOURCE[1], TARGET[1])
    with np.load(file) as archive:
        arrays = {key: archive[key] for key in archive.files if key != name}
    np.savez(file, **arrays | ({} if value is None else {name: value}))
    with pytest.raises(FormatError, match=message):
        loaded(file)


def test_files_that_are_no_maps(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("text")
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    with (tmp_path / "array.npz").open("wb") as stream:
        np.save(stream, np.zeros(3))
    for name, message in (
        ("text", "cannot be read as an npz file"),
        ("array", "cannot be read as an npz file"),
        ("other", "has the arrays points; a map has `vertices`"),
        ("none", "does not exist"),
    ):
        with pytest.raises(FormatError, match=message):
            read_map(tmp_path / f"{name}.npz")
    with pytest.raises(OutputError, match=r"extension \.npz"):
        write_map(tmp_path / "map.txt", some_map(), SOURCE[1], TARGET[1])


# What others write --------------------------------------------------------------------------------------------

VERTICES = {
    "column.txt": "5\n6\n7\n-1\n",
    "pairs.txt": "5 0\n6 1\n7 2\n",
    "arrows.txt": "# vertices\n5 -> 0\n\n# more\n7 -> 2  # last\n6 -> 1\n",
    "pairs.csv": "vertices\n5,0\n6,1\n7,2,\n",
    "counted.txt": "3\n5;0\n6;1\n7;2",
    "column.json": "[5, 6, 7, null]",
    "pairs.json": '{"vertices": [[5, 0], [7, 2], [6, 1]]}',
}


@pytest.mark.parametrize("name", VERTICES)
def test_maps_of_vertices(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text(VERTICES[name])
    assert same(loaded(file), from_vertices([5, 6, 7, -1], SOURCE, TARGET))


TRIANGLES = {
    "column.txt": "# triangles\n5\n6\n7\n8\n",
    "pairs.tricorrs": "5\n5, 0\n6, 1\n9, 1\n7, 2\n8, 3\n",
    "pairs.json": '{"triangles": [5, 6, 7, 8]}',
}


@pytest.mark.parametrize("name", TRIANGLES)
def test_maps_of_triangles(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text(TRIANGLES[name])
    assert loaded(file).faces.tolist() == [5, 6, 7, 8]


BARYCENTRIC = {
    "rows.txt": "4 0.5 0.25 0.25\n5 1 0 0\n6 0 1 0\n-1 0 0 0\n",
    "targets.txt": "# barycentric\n5, 1, 1, 0, 0\n4, 0, 0.5, 0.25, 0.25\n6, 2, 0, 1, 0\n",
    "rows.json": '{"barycentric": [[4, 0.5, 0.25, 0.25], [5, 1, 0, 0], [6, 0, 1, 0], [-1, 0, 0, 0]]}',
}


@pytest.mark.parametrize("name", BARYCENTRIC)
def test_maps_to_points_of_triangles(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text(BARYCENTRIC[name])
    points, faces = SOURCE
    found = loaded(file)
    a, b, c = points[faces[4]]
    assert np.allclose(found.interpolate(points)[0], a / 2 + b / 4 + c / 4, atol=1e-15)
    assert np.array_equal(found.interpolate(points)[1:3], [points[faces[5, 0]], points[faces[6, 1]]])
    assert found.matched.tolist() == [True, True, True, False]


def test_arrays_of_others(tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    np.savez(file, vertices=[5, 6, 7, -1])
    assert same(loaded(file), from_vertices([5, 6, 7, -1], SOURCE, TARGET))
    np.savez(file, triangles=[5, 6, 7, 8])
    assert loaded(file).faces.tolist() == [5, 6, 7, 8]
    np.savez(file, corners=some_map().corners, weights=some_map().weights)
    assert same(loaded(file), some_map())


WRONG = {
    "word.txt": ("5 0\nx 1\n", "line 2: 'x 1' is not a row of a map"),
    "uneven.txt": ("5 0\n6\n", "line 2 has 1 numbers; rows of a vertices map have 1 or 2"),
    "wide.txt": ("1 2 3\n", "line 1 has 3 numbers; rows of a barycentric map"),
    "half.txt": ("5\n6.5\n7\n8\n", "line 2: 6.5 is not the number of a vertex"),
    "nan.txt": ("5\nnan\n7\n8\n", "line 2: nan is not the number"),
    "kind.txt": ("# triangles\n1 2 3 4\n", "rows of a triangles map have 1 or 2"),
    "count.txt": ("4\n5 0\n6 1\n", "announces 4 rows, but 2 follow; is it truncated"),
    "empty.txt": ("# vertices\n", "has no rows"),
    "broken.json": ("[", "cannot be read as JSON"),
    "empty.json": ("{}", "has no map"),
    "text.json": ('["a"]', "row 1: a is not a row of numbers"),
    "digits.json": (f"[{'9' * 5000}]", "cannot be read as JSON"),
    "huge.json": (f"[{10**400}]", "is not a row of numbers"),
    "few.txt": ("5\n6\n", r"few.txt: there are 2 rows; one for each of the target's 4"),
    "target.txt": ("5 4\n", "there is no target 4: it has 4 .vertices.*the source's number first"),
    "source.txt": ("99\n6\n7\n8\n", "entry 0 of the map is 99, but the source has 54"),
    "twice.txt": ("5 0\n6 0\n", "target 0 is given two sources, 5 and 6"),
    "sum.txt": ("4 0.5 0.25 0.1\n5 1 0 0\n6 0 1 0\n-1 0 0 0\n", "target vertex 0 add to 0.85"),
    "outside.txt": (
        "4 1 0 0\n500 1 0 0\n6 0 1 0\n-1 0 0 0\n",
        "target vertex 1 is on triangle 500, but the source has",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_name_file_and_line(tmp_path: Path, name: str) -> None:
    text, message = WRONG[name]
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(FormatError, match=message) as caught:
        loaded(file)
    assert name in str(caught.value)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"version": "two", "corners": some_map().corners}, "is a map of version two; this mixseq reads version 1"),
        ({"version": [1, 1], "corners": some_map().corners}, "this mixseq reads version 1"),
        ({"corners": some_map().corners, "weights": some_map().weights.astype(str)}, "type <U32; finite numbers"),
        ({"corners": some_map().corners, "weights": some_map().weights + 0j}, "type complex128; finite numbers"),
    ],
)
def test_arrays_of_other_types_are_refused(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    file = tmp_path / "map.npz"
    np.savez(file, **arrays)
    with pytest.raises(FormatError, match=message):
        loaded(file)


def test_a_few_rows_are_no_map(tmp_path: Path) -> None:
    """Markers, given as a map by mistake."""
    points, faces = grid(5, 5)
    file = tmp_path / "pairs.txt"
    file.write_text("1 2\n3 4\n")
    with pytest.raises(FormatError, match=r"pairs\.txt: it has rows for 2 of the target's 36 vertices.*as markers"):
        to_correspondence(read_map(file), (points, faces), (points, faces))
