"""Compressed glTF in: a tube that other programs packed, and what is damaged in it."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError, MissingExtraError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.gltf import codecs
from mixseq_io.gltf.codecs import decompress_document
from mixseq_io.gltf.document import load_document
from mixseq_io.gltf.reader import open_gltf
from mixseq_io.gltf.writer import write_gltf
from tests.formats.gltf.packed_files import FOLDER, MADE, tube
from tests.formats.gltf_files import write_glb
from tests.formats.gltf_maker import load

pytestmark = pytest.mark.slow

Json = dict[str, Any]
WITH_DRACO = pytest.mark.skipif(find_spec("DracoPy") is None, reason="DracoPy is not installed")
NAMES = [pytest.param(name, marks=WITH_DRACO) if name == "draco" else name for name in MADE]


def test_the_tube_is_the_one_that_was_packed(tmp_path: Path) -> None:
    assert tube().glb(tmp_path / "tube.glb").read_bytes() == (FOLDER / "tube.glb").read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_what_other_programs_packed(name: str) -> None:
    """Vertices come in another order. Points are rounded to 14 bits of the largest extent, 4; draco's to 14, too."""
    original, packed = load(FOLDER / "tube.glb", fps=4), load(FOLDER / f"{name}.glb", fps=4)
    assert packed.points.shape == original.points.shape
    distance = np.linalg.norm(packed.points[:, :, None] - original.points[:, None], axis=3)
    match = distance[0].argmin(axis=1)
    assert sorted(match) == list(range(original.vertex_count))
    assert distance[:, np.arange(len(match)), match].max() < 2e-3
    assert {frozenset(face) for face in match[packed.faces]} == {frozenset(face) for face in original.faces}


def corners(sequence: MeshSequence) -> dict[tuple[float, ...], tuple[float, float]]:
    assert sequence.surface.uvs is not None
    points = sequence.points[0][sequence.faces.reshape(-1)].round(1).tolist()
    uvs = sequence.surface.uvs.at_corners.tolist()
    return {(*point, round(u)): (u, v) for point, (u, v) in zip(points, uvs, strict=True)}


@pytest.mark.parametrize("name", NAMES)
def test_texture_coordinates_are_those_of_the_texture(name: str) -> None:
    """They go from 0 to 3: gltfpack lets the material scale what is in the file."""
    original, packed = load(FOLDER / "tube.glb"), load(FOLDER / f"{name}.glb")
    expected = corners(original)
    assert packed.surface.uvs is not None
    assert packed.surface.uvs.values.max() == pytest.approx(3, abs=1e-3)
    found = corners(packed)
    shared = expected.keys() & found.keys()
    assert len(shared) > 90
    for key in shared:
        assert found[key] == pytest.approx(expected[key], abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_colours_of_vertices(name: str) -> None:
    with open_gltf(FOLDER / f"{name}.glb") as reader:
        found = reader.header.surface.colours
        height = next(reader.blocks(1))[0, reader.header.polygons.indices, 1] / 4
    assert found is not None
    expected = np.stack([height, 1 - height, 0.5 + 0 * height], axis=1)
    np.testing.assert_allclose(found.at_corners[:, :3], expected, atol=0.01)


@pytest.mark.parametrize("name", NAMES)
def test_frames_over_a_compressed_file(name: str, tmp_path: Path) -> None:
    """What is written has the rest of the file without its compression."""
    sequence = load(FOLDER / f"{name}.glb", fps=4)
    raised = sequence.with_points(sequence.points + np.array([0, 1, 0], np.float32))
    path = tmp_path / "new.glb"
    write_gltf(path, raised.header, [raised.points])
    document = load_document(path)
    assert not [each for each in document.top.texts("extensionsUsed") if "compression" in each]
    assert len(document.items("buffers")) == 1
    assert document.items("materials")[0].text("name") == "skin"
    again = load(path, fps=4)
    np.testing.assert_allclose(again.points, raised.points, atol=1e-6)
    np.testing.assert_array_equal(again.faces, raised.faces)
    assert again.surface.uvs is not None
    assert raised.surface.uvs is not None
    np.testing.assert_array_equal(again.surface.uvs.at_corners, raised.surface.uvs.at_corners)


def test_plain_files_stay_as_they_are() -> None:
    document = load_document(FOLDER / "tube.glb")
    assert decompress_document(document).json == document.json


def parts(name: str) -> tuple[Json, bytes]:
    content = (FOLDER / f"{name}.glb").read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def changed(path: Path, name: str, change: Callable[[Json], object]) -> Path:
    document, buffer = parts(name)
    change(document)
    write_glb(path, document, buffer, document["buffers"][1:])
    return path


def packed_view(document: Json, **fields: Any) -> None:
    view = next(each for each in document["bufferViews"] if "extensions" in each)
    view["extensions"]["EXT_meshopt_compression"].update(fields)


DAMAGES: dict[str, tuple[Json, str]] = {
    "more elements": ({"count": 10**9}, "unlike the length of the view"),
    "no stride": ({"byteStride": 0}, "unlike the length of the view"),
    "unknown mode": ({"mode": "KNOTS"}, "cannot be unpacked.*'KNOTS'"),
    "other mode": ({"mode": "INDICES"}, "cannot be unpacked.*'INDICES'"),
    "unknown filter": ({"filter": "KALMAN"}, "cannot be unpacked.*'KALMAN'"),
    "beyond the buffer": ({"byteLength": 10**6}, "does not fit its buffer"),
    "too short": ({"byteLength": 40}, "cannot be unpacked"),
    "no such buffer": ({"buffer": 7}, r"buffers\[7\]"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_views(damage: str, tmp_path: Path) -> None:
    fields, message = DAMAGES[damage]
    path = changed(tmp_path / "bad.glb", "gltfpack-ext", lambda document: packed_view(document, **fields))
    with pytest.raises(FormatError, match=message):
        load(path)


def test_a_view_that_unpacks_to_far_more_than_the_file(tmp_path: Path) -> None:
    def enlarge(document: Json) -> None:
        view = next(each for each in document["bufferViews"] if "extensions" in each)
        packed = view["extensions"]["EXT_meshopt_compression"]
        packed["count"] = 10**8
        view["byteLength"] = packed["count"] * packed["byteStride"]

    with pytest.raises(FormatError, match="damaged, or repeats"):
        load(changed(tmp_path / "bomb.glb", "gltfpack-ext", enlarge))


def test_draco_without_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codecs, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"draco.glb is compressed with Draco.*pip install 'mixseq\[gltf\]'"):
        load(FOLDER / "draco.glb")


@WITH_DRACO
@pytest.mark.parametrize("name", ["POSITION", "NORMAL"])
def test_draco_with_other_numbers(name: str, tmp_path: Path) -> None:
    def shorten(document: Json) -> None:
        accessor = document["meshes"][0]["primitives"][0]["attributes"][name]
        document["accessors"][accessor]["count"] -= 1

    with pytest.raises(FormatError, match="are expected; the file is damaged"):
        load(changed(tmp_path / "bad.glb", "draco", shorten))


@WITH_DRACO
@pytest.mark.parametrize("place", [0, 5, 11, 40, 200])
def test_draco_that_is_damaged(place: int, tmp_path: Path) -> None:
    document, buffer = parts("draco")
    start = document["bufferViews"][
        document["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["bufferView"]
    ].get("byteOffset", 0)
    damaged = bytearray(buffer)
    damaged[start + place : start + place + 8] = b"\xff" * 8
    path = write_glb(tmp_path / "bad.glb", document, bytes(damaged))
    try:
        load(path)
    except FormatError as error:
        assert "bad.glb" in str(error)


def test_a_packed_primitive_that_has_plain_data_is_read_plain(tmp_path: Path) -> None:
    maker = tube()
    primitive = maker.json["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}}
    maker.json["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    found = load(maker.glb(tmp_path / "both.glb"))
    np.testing.assert_array_equal(found.points, load(FOLDER / "tube.glb").points)
    document = decompress_document(load_document(tmp_path / "both.glb"))
    assert "extensions" not in document.json["meshes"][0]["primitives"][0]
