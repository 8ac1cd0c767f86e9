"""glTF, writing: which files a sequence is laid over, and that real ones keep what they had."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqError, MixseqWarning, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.gltf.writer import write_gltf
from tests.formats.conftest import lossy
from tests.formats.gltf.test_carry import change
from tests.formats.gltf_files import Gltf, Json, read, rigged, validate, write_glb, written
from tests.meshes import grid

pytestmark = pytest.mark.slow


def test_flatten_leaves_the_file_behind(lifted: MeshSequence, tmp_path: Path) -> None:
    file = written(tmp_path / "new.glb", lifted, flatten=True)
    assert "images" not in file.json
    assert [each.get("name") for each in file.json["nodes"]] == ["body"]
    assert file.json["materials"][0]["name"] == "fur"


def test_a_file_that_is_gone_or_another_is_done_without(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    rig.rename(tmp_path / "moved.glb")
    with pytest.warns(MixseqWarning, match=r"rig.glb does not exist; the result is a stand-alone file"):
        file = written(tmp_path / "new.glb", lifted)
    assert "images" not in file.json
    file = written(tmp_path / "new.glb", lifted, onto=tmp_path / "moved.glb")
    assert "images" in file.json
    rig.write_bytes(b"glTF")
    with pytest.warns(MixseqWarning, match="the result is a stand-alone file"):
        written(tmp_path / "new.glb", lifted)


def test_difference_from_a_mirrored_mesh(tmp_path: Path) -> None:
    """Of a mesh whose triangles are all reversed in the file, only the flipped triangle is a difference."""
    points, faces = grid(3, 4)
    mixseq.write(tmp_path / "strip.glb", MeshSequence.from_arrays(points[None], faces, name="strip"))
    file = Gltf(tmp_path / "strip.glb")
    file.node("strip")["scale"] = [-1, 1, 1]
    write_glb(tmp_path / "strip.glb", file.json, file.buffer)
    strip = mixseq.read(tmp_path / "strip.glb")
    changed = strip.faces.copy()
    changed[2] = changed[2, ::-1]
    flipped = replace(strip, polygons=Polygons.from_triangles(changed))
    with pytest.raises(OutputError, match=r"polygon 2 of the sequence \(.*\) is flipped in the file"):
        mixseq.write(tmp_path / "new.glb", flipped, onto=tmp_path / "strip.glb")


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            lambda document: document["nodes"][1].update(name="torso", mesh=1),
            "has no mesh with the faces of 'rig/body'",
        ),
        (lambda document: twin(document), "has 2 meshes with the faces of 'rig/body', 'rig/torso', 'twin'"),
        (lambda document: document["nodes"][1].update(mesh=1), "no mesh with the faces of 'rig/body': it has"),
        (
            lambda document: document["meshes"][0]["primitives"][0].update(mode=6),
            "has no mesh with the faces of 'rig/body'",
        ),
        (lambda document: document["bufferViews"][0].update(byteLength=1 << 40), "bufferViews.0. does not fit"),
        (lambda document: document["materials"][0].update(alphaCutoff=float("nan")), "is damaged, truncated or"),
        (lambda document: document["images"].append(7), "is damaged, truncated or"),
        (lambda document: document["animations"].append({"channels": [{}]}), "is damaged, truncated or"),
    ],
)
def test_files_that_do_not_fit(
    rig: Path, lifted: MeshSequence, tmp_path: Path, edit: Callable[[Json], object], message: str
) -> None:
    change(rig, edit)
    with pytest.warns(MixseqWarning, match=f"{message}.*; the result is a stand-alone file"):
        written(tmp_path / "new.glb", lifted)
    (tmp_path / "new.glb").unlink()
    with pytest.raises(OutputError, match=f"cannot write .*new.glb onto another file: .*{message}"):
        written(tmp_path / "new.glb", lifted, onto=rig)
    assert not (tmp_path / "new.glb").exists()


def test_a_mesh_of_lines_does_not_hide_the_others(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    def add_lines(document: Json) -> None:
        document["meshes"].append({"primitives": [{"attributes": {"POSITION": 0}, "mode": 1}]})
        document["scenes"][0]["nodes"].append(len(document["nodes"]))
        document["nodes"].append({"name": "wire", "mesh": len(document["meshes"]) - 1})

    change(rig, add_lines)
    other = MeshSequence.from_arrays(lifted.points, lifted.faces, times=lifted.times)
    assert "images" in written(tmp_path / "new.glb", other, onto=rig).json


def twin(document: Json) -> None:
    """Call the body otherwise, and show it once more."""
    document["nodes"][1].update(name="torso")
    document["scenes"][0]["nodes"].append(len(document["nodes"]))
    document["nodes"].append({"name": "twin", "mesh": 0})


def test_a_mesh_at_another_path_is_found_by_its_triangles(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    """As of a sequence that comes from another format, with its triangles in another order."""
    faces = np.roll(lifted.faces[::-1], 1, axis=1)
    other = MeshSequence.from_arrays(lifted.points, faces, times=lifted.times)
    file = written(tmp_path / "new.glb", other, onto=rig)
    assert "images" in file.json
    with lossy():
        again = read(tmp_path / "new.glb")
    np.testing.assert_array_equal(again.points, lifted.points)
    np.testing.assert_array_equal(again.faces, lifted.faces)


def test_a_file_is_not_written_onto_itself(rig: Path, lifted: MeshSequence) -> None:
    before = rig.read_bytes()
    # Nor if it does not fit any more, so that the sequence would be written alone.
    torn = MeshSequence.from_header(
        replace(lifted.header, surface=Surface(origin=lifted.surface.origin)), lifted.points
    )
    for sequence, onto in ((lifted, None), (lifted, rig), (torn, None)):
        with pytest.raises(OutputError, match="is the original and would be lost; write to another name"):
            write_gltf(rig, sequence.header, [sequence.points], onto=onto)
    assert rig.read_bytes() == before
    written(rig, lifted, flatten=True)


def test_flatten_and_onto_exclude_each_other(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="give one of them"):
        written(tmp_path / "new.glb", lifted, flatten=True, onto=rig)


def test_damaged_files_end_in_an_error_of_ours(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    """Replace one value of the JSON after the other by nonsense."""
    text = json.dumps(rigged()[0])

    def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        children = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, child in children:
            yield (*path, key)
            yield from places(child, (*path, key))

    everywhere = [
        place for place in places(json.loads(text)) if place[:1] != ("accessors",) or place < ("accessors", 4)
    ]
    for number, place in enumerate(everywhere[::2]):
        document = json.loads(text)
        owner = document
        for key in place[:-1]:
            owner = owner[key]
        owner[place[-1]] = [None, -1, "x", [], {}, 1e300, 99, [[]]][number % 8]
        write_glb(rig, document, rigged()[1])
        with lossy():
            try:
                written(tmp_path / "new.glb", lifted, onto=rig)
            except MixseqError:
                continue


def test_the_validator_passes_what_is_carried_over(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    # The image is none: only that may be found fault with.
    change(rig, lambda document: (document.pop("images"), document["textures"][0].pop("source")))
    written(tmp_path / "new.glb", lifted)
    written(tmp_path / "new.gltf", lifted)
    validate(tmp_path / "new.glb", tmp_path / "new.gltf")


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["KhronosFox", "CesiumMan"])
def test_real_characters_keep_their_textures(data: Path, tmp_path: Path, name: str) -> None:
    source, target = data / "gltf" / f"{name}.glb", tmp_path / f"{name}.glb"
    with lossy():
        sequence = read(source)
        file, before = written(target, sequence), Gltf(source)
    assert file.view(file.json["images"][0]["bufferView"]) == before.view(before.json["images"][0]["bufferView"])
    assert file.json["materials"] == before.json["materials"]
    again = read(target)
    assert again.polygons.same_as(sequence.polygons)
    assert np.abs(again.points - sequence.points).max() < 1e-7 * sequence.diagonal


@pytest.mark.realdata
@pytest.mark.parametrize("flatten", [False, True])
def test_the_validator_passes_real_characters(data: Path, tmp_path: Path, flatten: bool) -> None:
    for name in ("KhronosFox", "CesiumMan", "Stag"):
        with lossy():
            written(tmp_path / f"{name}.glb", read(data / "gltf" / f"{name}.glb"), flatten=flatten)
    validate(*sorted(tmp_path.iterdir()))
