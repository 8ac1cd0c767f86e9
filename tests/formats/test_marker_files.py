"""Files of markers: everything that people write them in, and what is wrong with others."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mixseq.compression.numbering import NumberedVertices
from mixseq.errors import FormatError, MissingExtraError, OutputError
from mixseq.retargeting.markers import Markers
from mixseq_io.text.markers import read_markers, write_markers

FILES = {
    "spaces.txt": "1 2\n\n 3   4 \n",
    "commas.txt": "1,2\n3, 4",
    "arrows.txt": "1->2\n3 -> 4",
    "colons.txt": "1:2\n3 : 4\n",
    "semicolons.csv": "1;2\n3; 4",
    "heading.csv": "source,target\n1,2\n3,4",
    "counted.cons": "2\n1, 2\n3, 4\n",
    "counted.corr": "2\n1,2\n3,4",
    "windows.txt": "\ufeff1\t2\r\n3\t4\r\n",
    "commented.txt": "# horse, camel\n2\n# head\n1 2\n3 4\n# the end",
    "pairs.json": "[[1, 2], [3, 4]]",
    "texts.json": '["1:2", "3 -> 4"]',
    "under.json": '{"by": "me", "markers": [[1, 2], [3, 4]]}',
    "columns.json": '{"source": [1, 3], "target": [2, 4]}',
    "objects.json": '[{"source": 1, "target": 2}, {"target": 4, "source": 3}]',
    "texts.yml": 'source:\n  reference: a.obj\ntarget:\n  reference: b.obj\nmarkers:\n  - "1:2"\n  - "3:4"\n',
    "pairs.yaml": "- [1, 2]\n- - 3\n  - 4\n",
    "times.yaml": "- 1:2\n- 3:4\n",
    "columns.yaml": "source: [1, 3]\ntarget: [2, 4]\n",
    "objects.yaml": "markers:\n  - source: 1\n    target: 2\n  - {source: 3, target: 4}\n",
}


@pytest.mark.parametrize("name", FILES)
def test_all_forms_are_read(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_bytes(FILES[name].encode())
    markers = read_markers(file)
    assert markers.source.tolist() == [1, 3]
    assert markers.target.tolist() == [2, 4]
    assert markers.names == ()
    assert read_markers(file, reverse=True).source.tolist() == [2, 4]


NAMED = {
    "a.txt": "1 2 # left  ear\n3 4\n",
    "a.yml": '# heading\nmarkers:\n  - "1:2"  #left ear\n  # between\n  - "3:4"\n',
    "b.yml": "- [1, 2] # left ear\n- [3, 4]",
    "c.yml": "- source: 1\n  target: 2\n  name: left ear\n- source: 3  # no name\n  target: 4\n",
    "a.json": '[{"source": 1, "target": 2, "name": "left ear"}, [3, 4]]',
    "b.json": '{"source": [1, 3], "target": [2, 4], "names": ["left ear", ""]}',
}


@pytest.mark.parametrize("name", NAMED)
def test_comments_and_names_are_kept(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    file.write_text(NAMED[name])
    markers = read_markers(file)
    assert markers.names == ("left ear", "")
    assert markers.name(0) == "'left ear' (1 -> 2)"
    assert markers.name(1) == "2 (3 -> 4)"


WRONG = {
    "word.txt": ("1 2\n3 x\n", r"word.txt, line 2: '3 x' is not a pair of vertices; two vertex numbers"),
    "lone.txt": ("1 2\n3\n", "line 2: '3' is not a pair"),
    "three.txt": ("1 2 3\n", "line 1: '1 2 3' is not a pair"),
    "minus.txt": ("1 -2\n", "line 1: '1 -2' is not a pair"),
    "short.cons": ("3\n1, 2\n3, 4\n", "announces 3 markers, but 2 follow; is it truncated"),
    "empty.txt": ("# nothing\n", "has no markers"),
    "large.txt": (f"1 {10**20}", "is not a vertex number"),
    "digits.txt": ("9" * 5000, "is not a pair of vertices"),
    "digits.json": (f"[[1, {'9' * 5000}]]", "cannot be read as JSON"),
    "itself.yml": ("- &a [*a]", "itself.yml, line 1: anchors .* are not read"),
    "bomb.yml": ("a: &a [1, 2]\nmarkers: [*a, *a]\n", "bomb.yml, line 1: anchors .* are not read"),
    "deep.yml": ("[" * 500, "cannot be read as YAML"),
    "broken.json": ("[[1, 2]", "cannot be read as JSON"),
    "deep.json": ("[" * 100000, "cannot be read as JSON"),
    "text.json": ('{"pairs": [[1, 2]]}', "has no list of markers"),
    "uneven.json": ('{"source": [1, 2], "target": [1]}', "are not equally long"),
    "lonely.json": ('{"source": [1, 2]}', "are not equally long"),
    "half.json": ("[[1, 2], [1.5, 2]]", r"half.json, marker 2: 1.5 is not a vertex number"),
    "true.json": ("[[1, true]]", "True is not a vertex number"),
    "minus.json": ("[[1, -1]]", "vertices are numbered from 0"),
    "triple.json": ("[[1, 2, 3]]", "marker 1: .1, 2, 3. is not a marker; a pair of vertices"),
    "one.json": ('[{"source": 1}]', "None is not a vertex number"),
    "broken.yml": ("markers: [1, 2", r"broken.yml, line 1 cannot be read as YAML"),
    "wrong.yml": ('markers:\n  - "1:2"\n  - "12"\n', r"wrong.yml, line 3: '12' is not a pair"),
    "tagged.yml": ("!!python/object/apply:os.getcwd []", "no markers"),
    "scalar.yml": ("nothing", "has no list of markers"),
    "empty.yml": ("", "has no list of markers"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_name_file_and_line(tmp_path: Path, name: str) -> None:
    text, message = WRONG[name]
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(FormatError, match=message):
        read_markers(file)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"none\.txt does not exist"):
        read_markers(tmp_path / "none.txt")
    with pytest.raises(FormatError, match="is a folder, not markers"):
        read_markers(tmp_path)
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(FormatError, match="cannot be read as markers: its text is UTF-16"):
        read_markers(tmp_path / "binary.txt")
    with pytest.raises(OutputError, match="does not exist"):
        write_markers(tmp_path / "no" / "markers.txt", Markers.from_pairs([[1, 2]]))


_name = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), max_size=5)


@pytest.mark.parametrize("extension", ["txt", "json", "yml"])
@settings(max_examples=20)
@given(rows=st.lists(st.tuples(st.integers(0, 2**40), st.integers(0, 9), _name), min_size=1, max_size=5))
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, extension: str, rows: list[tuple[int, int, str]]
) -> None:
    file = tmp_path_factory.mktemp("markers") / f"markers.{extension}"
    names = tuple(name for _, _, name in rows)
    markers = Markers.from_pairs([row[:2] for row in rows], names if any(names) else ())
    write_markers(file, markers)
    again = read_markers(file)
    assert again.source.tolist() == markers.source.tolist()
    assert again.target.tolist() == markers.target.tolist()
    assert again.names == markers.names


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "count", "first", "last"),
    [
        ("golevka_horse_camel.cons", 107, "1 (750 -> 3386)", "107 (2070 -> 8896)"),
        ("kylegh_horse_camel_vert.corr", 17, "1 (2957 -> 451)", "17 (4927 -> 16755)"),
        ("markers-cat-lion.yml", 55, "'left front paw left side' (2653 -> 1316)", "'neck' (3236 -> 1641)"),
        ("markers-horse-camel.yml", 124, "1 (750 -> 3386)", "124 (5554 -> 4593)"),
    ],
)
def test_files_of_others(data: Path, name: str, count: int, first: str, last: str) -> None:
    markers = read_markers(data / "markers" / name)
    assert len(markers) == count
    assert (markers.name(0), markers.name(count - 1)) == (first, last)


@pytest.mark.realdata
def test_two_files_of_one_correspondence_are_each_others_reverse(data: Path) -> None:
    one = read_markers(data / "markers" / "kylegh_horse_camel_vert.corr")
    two = read_markers(data / "markers" / "kylegh_camel_horse_vert.corr", reverse=True)
    assert set(zip(one.source.tolist(), one.target.tolist(), strict=True)) == set(
        zip(two.source.tolist(), two.target.tolist(), strict=True)
    )


def test_without_pyyaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (file := tmp_path / "pairs.yaml").write_text("- [1, 2]\n")
    monkeypatch.setitem(sys.modules, "yaml", None)
    with pytest.raises(MissingExtraError, match=r"pairs.yaml: .* pip install 'mixseq\[yaml\]'"):
        read_markers(file)


@pytest.mark.parametrize("extension", ["txt", "json", "yml"])
def test_numbers_in_other_files_are_kept(tmp_path: Path, extension: str) -> None:
    if extension == "yml":
        pytest.importorskip("yaml")
    meshes = NumberedVertices("a", "b", {3: 7}), NumberedVertices("c", "d", {4: 0})
    path = tmp_path / f"markers.{extension}"
    write_markers(path, replace(Markers.from_pairs([[3, 4]], ("nose",)), meshes=meshes))
    again, reverse = read_markers(path), read_markers(path, reverse=True)
    assert (again.source.tolist(), again.target.tolist(), again.names, again.meshes) == ([3], [4], ("nose",), meshes)
    assert reverse.meshes == meshes[::-1]
    path.write_text(path.read_text().replace('"checksum": "c"', '"sum": "c"'))
    with pytest.raises(FormatError, match="'meshes' is damaged; delete it"):
        read_markers(path)


def test_a_map_is_no_list_of_markers(tmp_path: Path) -> None:
    file = tmp_path / "map.npz"
    file.write_bytes(b"PK")
    with pytest.raises(FormatError, match=r"map\.npz is a map.*--map"):
        read_markers(file)
