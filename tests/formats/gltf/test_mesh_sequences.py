"""GLB files with the extension MIXSEQ_mesh_sequence: what comes back, the still, materials, and what is refused."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import STILLS, StillName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.errors import FormatError, MixseqWarning, OutputError, SettingsError
from mixseq.mesh.surface import CornerValues, FaceSet, Origin, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.bodies import Relation
from mixseq.types import FloatArray
from mixseq_io.model_files import compressed_sizes, read_compressed, read_container
from tests.formats.compressed.stream_cases import assert_same
from tests.formats.gltf_files import validate
from tests.meshes import bar, torus

NAME = "MIXSEQ_mesh_sequence"


def dressed_bar() -> MeshSequence:
    """A bent bar with a seam, a hard edge and two materials that take turns."""
    plain = bar(6, 12, 8)
    polygons = plain.polygons
    corners = polygons.indices
    uvs = np.random.default_rng(3).random((plain.vertex_count, 2)).astype(np.float32)
    at_corners = np.concatenate([uvs, uvs[:1] + np.float32(0.5)])
    indices = corners.copy()
    indices[np.flatnonzero(corners == corners[0])[0]] = len(uvs)  # a seam at one vertex
    hard = corners.copy()
    hard[np.flatnonzero(corners == corners[9])[-1]] = len(uvs)
    count = len(polygons.counts)
    skin = np.concatenate([np.arange(0, count // 3), np.arange(count // 2, count)])
    surface = Surface(
        uvs=CornerValues(at_corners, indices),
        hard_edges=hard,
        face_sets=(FaceSet("skin", skin, "skin"), FaceSet("felt", np.arange(count // 3, count // 2), "felt")),
    )
    return replace(plain, surface=surface, name="Stange", up_axis="Z", metres_per_unit=0.01)


@pytest.fixture(scope="module")
def sequence() -> MeshSequence:
    return dressed_bar()


@pytest.fixture(scope="module")
def coded(sequence: MeshSequence) -> CompressedSequence:
    return mixseq.compress(sequence, max_error=1e-3)


@pytest.fixture
def path(tmp_path: Path, coded: CompressedSequence) -> Path:
    file = tmp_path / "walk.glb"
    mixseq.save(file, coded, still="plain")
    return file


def needs_draco(still: StillName) -> None:
    if still == "draco":
        pytest.importorskip("DracoPy")


def document(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk, without our reader."""
    data = path.read_bytes()
    size = int(struct.unpack_from("<I", data, 12)[0])
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def write(path: Path, content: dict[str, Any], binary: bytes) -> None:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def view(content: dict[str, Any], binary: bytes, number: int) -> bytes:
    found = content["bufferViews"][number]
    start = found.get("byteOffset", 0)
    return binary[start : start + found["byteLength"]]


def values(content: dict[str, Any], binary: bytes, number: int) -> FloatArray:
    accessor = content["accessors"][number]
    kind = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
    data = view(content, binary, accessor["bufferView"])[accessor.get("byteOffset", 0) :]
    return np.frombuffer(data, kind, accessor["count"] * width).reshape(-1, width)


@pytest.mark.parametrize("still", STILLS)
def test_the_model_comes_back(tmp_path: Path, coded: CompressedSequence, still: StillName) -> None:
    needs_draco(still)
    mixseq.save(tmp_path / "walk.h5", coded)
    mixseq.save(tmp_path / "walk.glb", coded, still=still)
    expected, got = mixseq.load(tmp_path / "walk.h5"), mixseq.load(tmp_path / "walk.glb")
    for time in np.linspace(0, expected.times[-1], 23):
        np.testing.assert_array_equal(got(time), expected(time))
    assert got.header.name == "Stange"
    assert got.header.surface.face_sets[1].material == "felt"
    frames = mixseq.read(tmp_path / "walk.glb")
    np.testing.assert_array_equal(frames.points, expected.sample().points)
    found = mixseq.verify(tmp_path / "walk.glb", dressed_bar())
    assert found.holds and found.promised and found.bound == 1e-3


def test_text_and_streams_are_those_of_hdf5(tmp_path: Path, coded: CompressedSequence, path: Path) -> None:
    mixseq.save(tmp_path / "walk.h5", coded)
    content, binary = document(path)
    extension = content["meshes"][0]["extensions"][NAME]
    container = read_container(tmp_path / "walk.h5")
    assert view(content, binary, extension["coding"]) == container.text
    assert view(content, binary, extension["streams"]) == container.streams
    assert extension["version"] == container.version == 1
    assert read_container(path) == container
    assert content["extensionsUsed"] == [NAME]
    assert "extensionsRequired" not in content


def test_the_still_is_the_first_frame(path: Path, sequence: MeshSequence) -> None:
    content, binary = document(path)
    first = mixseq.load(path)(sequence.times[0])
    corners: dict[tuple[float, ...], int] = {}
    polygons, uvs = sequence.polygons, sequence.surface.uvs
    assert uvs is not None
    extension, runs = content["meshes"][0]["extensions"][NAME], []
    triangles = []
    for number, each in enumerate(content["meshes"][0]["primitives"]):
        points = values(content, binary, each["attributes"]["POSITION"])
        indices = values(content, binary, each["indices"]).reshape(-1, 3)
        bounds = content["accessors"][each["attributes"]["POSITION"]]
        np.testing.assert_array_equal(bounds["min"], points.min(axis=0))
        np.testing.assert_array_equal(bounds["max"], points.max(axis=0))
        textures = values(content, binary, each["attributes"]["TEXCOORD_0"])
        normals = values(content, binary, each["attributes"]["NORMAL"])
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
        triangles.append(np.concatenate([points[indices], textures[indices]], axis=2))
        runs.append((number, content["materials"][each["material"]]["name"]))
        corners.update({tuple(row): number for row in points.tolist()})
    assert runs == [(0, "skin"), (1, "felt")]
    count = len(polygons.counts)
    halves = [count // 3, count // 2 - count // 3, count - count // 2]
    assert extension["polygons"] == [0, halves[0], 1, halves[1], 0, halves[2]]
    # Every triangle of the sequence is there once, with its texture coordinates upside down.
    ours = np.arange(len(polygons.indices))
    fans = type(polygons)(polygons.counts, ours).triangles
    flipped = uvs.at_corners * (1, -1) + (0, 1)
    expected = np.concatenate([first[polygons.indices[fans]], flipped[fans]], axis=2)
    found = np.concatenate(triangles)
    assert found.shape == expected.shape
    order = [np.lexsort(each.reshape(len(each), -1).round(5).T) for each in (found, expected)]
    np.testing.assert_allclose(found[order[0]], expected[order[1]], atol=1e-3)


def test_stills_by_draco_are_the_first_frame(tmp_path: Path, coded: CompressedSequence) -> None:
    draco = pytest.importorskip("DracoPy")
    file = tmp_path / "walk.glb"
    mixseq.save(file, coded)
    content, binary = document(file)
    assert content["extensionsRequired"] == ["KHR_draco_mesh_compression"]
    first = mixseq.load(file)(0.0)
    for each in content["meshes"][0]["primitives"]:
        extension = each["extensions"]["KHR_draco_mesh_compression"]
        found = draco.decode(view(content, binary, extension["bufferView"]))
        numbers = {attribute["unique_id"]: attribute["data"] for attribute in found.attributes}
        points = numbers[extension["attributes"]["POSITION"]]
        nearest = np.abs(points[:, None] - first[None]).max(axis=2).min(axis=1)
        assert nearest.max() < np.ptp(first, axis=0).max() / 2**11
        for name, number in extension["attributes"].items():
            accessor = content["accessors"][each["attributes"][name]]
            assert accessor["count"] == len(numbers[number])
            assert "bufferView" not in accessor
        assert content["accessors"][each["indices"]]["count"] == found.faces.size


def test_stills_may_be_left_out(tmp_path: Path, coded: CompressedSequence, path: Path) -> None:
    file = tmp_path / "bare.glb"
    mixseq.save(file, coded, still="none")
    content, _ = document(file)
    assert content["extensionsRequired"] == [NAME]
    assert len(content["bufferViews"]) == 2
    assert [each["material"] for each in content["meshes"][0]["primitives"]] == [0, 1]
    assert compressed_sizes(file)["still"] == 0
    assert compressed_sizes(path)["still"] > 3000
    assert_same(mixseq_coded(file), mixseq_coded(path))


def mixseq_coded(path: Path) -> CompressedSequence:
    from mixseq_io.model_files import read_compressed

    return read_compressed(path)


def test_the_node_shows_the_points_upright(path: Path) -> None:
    content, _ = document(path)
    matrix = np.reshape(content["nodes"][0]["matrix"], (4, 4)).T
    np.testing.assert_allclose(matrix @ [0, 0, 1, 1], [0, 0.01, 0, 1], atol=1e-12)  # up, in centimetres


def test_the_validator_is_content(tmp_path: Path, coded: CompressedSequence) -> None:
    files = []
    for still in STILLS:
        needs_draco(still)
        files.append(tmp_path / f"{still}.glb")
        mixseq.save(files[-1], coded, still=still)
    validate(*files)


def test_materials_and_textures_come_along(tmp_path: Path, sequence: MeshSequence) -> None:
    texture = b"\x89PNG\r\n\x1a\nnot much of one"
    original = tmp_path / "original.glb"
    views = [{"buffer": 0, "byteLength": len(texture)}]
    write(
        original,
        {
            "asset": {"version": "2.0"},
            "buffers": [{"byteLength": len(texture)}],
            "bufferViews": views,
            "images": [{"uri": "gone.png"}, {"bufferView": 0, "mimeType": "image/png"}],
            "samplers": [{"wrapS": 33071}, {"magFilter": 9728}],
            "textures": [{"source": 0}, {"source": 1, "sampler": 1}],
            "materials": [
                {"name": "other", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
                {
                    "name": "felt",
                    "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}, "metallicFactor": 0.25},
                    "emissiveTexture": {"index": 1},
                },
            ],
        },
        texture + bytes(-len(texture) % 4),
    )
    surface = replace(sequence.surface, origin=Origin("glTF", str(original)))
    coded = mixseq.compress(replace(sequence, surface=surface), max_error=1e-2)
    mixseq.save(tmp_path / "walk.glb", coded, still="none")
    content, binary = document(tmp_path / "walk.glb")
    felt, skin = content["materials"]
    assert (felt["name"], skin["name"]) == ("felt", "skin")
    assert felt["pbrMetallicRoughness"] == {"baseColorTexture": {"index": 0}, "metallicFactor": 0.25}
    assert felt["emissiveTexture"] == {"index": 0}
    assert content["textures"] == [{"source": 0, "sampler": 0}]
    assert content["samplers"] == [{"magFilter": 9728}]
    assert view(content, binary, content["images"][0]["bufferView"]) == texture
    original.unlink()
    with pytest.warns(MixseqWarning, match="does not exist.*but are plain"):
        mixseq.save(tmp_path / "again.glb", coded, still="none")


def test_only_compressed_models(tmp_path: Path, sequence: MeshSequence, path: Path) -> None:
    whole = path.read_bytes()
    for model in (mixseq.fit(sequence, space="vertex"), mixseq.load(path)):
        with pytest.raises(OutputError, match=r"walk\.glb: a \.glb holds compressed models; .*mixseq\.compress"):
            mixseq.save(path, model)
    assert path.read_bytes() == whole


def test_settings_are_checked(tmp_path: Path, coded: CompressedSequence, path: Path) -> None:
    with pytest.raises(SettingsError, match="still is 'sharp'; one of draco, plain, none"):
        mixseq.save(tmp_path / "walk.glb", coded, still="sharp")  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="holds a compressed model, which has no prim to choose"):
        mixseq.read(path, prim="/")


def test_stills_without_areas_are_plain_where_draco_cannot_be(tmp_path: Path) -> None:
    pytest.importorskip("DracoPy")
    points, faces = torus(5, 4)
    sequence = MeshSequence.from_arrays(np.stack([0 * points, points]), faces)
    with pytest.warns(MixseqWarning, match="the still of these is plain"):
        mixseq.save(tmp_path / "pop.glb", mixseq.compress(sequence, max_error=1e-3))
    content, _ = document(tmp_path / "pop.glb")
    assert "extensionsRequired" not in content
    assert "extensions" not in content["meshes"][0]["primitives"][0]
    assert np.abs(mixseq.load(tmp_path / "pop.glb")(1 / 24) - points).max() < 0.01


def test_missing_draco_is_told(tmp_path: Path, coded: CompressedSequence, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(mixseq.errors.MissingExtraError, match=r"pip install 'mixseq\[gltf\]', or write a plain"):
        mixseq.save(tmp_path / "walk.glb", coded)
    assert not list(tmp_path.iterdir())


def test_other_glb_files_are_sequences(tmp_path: Path, sequence: MeshSequence) -> None:
    from mixseq_io.model_files import is_model

    file = tmp_path / f"{NAME}.glb"
    mixseq.write(file, bar(6, 12, 3))
    assert not is_model(file)
    assert mixseq.read(file).frame_count == 3
    with pytest.raises(FormatError, match="has no compressed model; make one with mixseq encode --max-error"):
        mixseq.load(file)


CHANGES: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda c: extension_of(c).pop("coding"), "coding is missing or damaged; a non-negative integer is expected"),
    (lambda c: extension_of(c).update(streams=99), r"bufferViews\[99\] is referenced, but there are"),
    (lambda c: extension_of(c).update(streams=-1), "streams is missing or damaged"),
    (lambda c: extension_of(c).update(coding=1), "its index is damaged"),
    (lambda c: extension_of(c).update(version=9), "of version 9, this mixseq reads 1"),
    (lambda c: c["meshes"][0].update(extensions=3), "extensions is missing or damaged; an object is expected"),
    (lambda c: c["meshes"][0]["extensions"].update({NAME: []}), "an object is expected"),
    (lambda c: c["bufferViews"][1].update(byteLength=1 << 20), "does not fit its buffer"),
    (lambda c: c["bufferViews"][1].update(byteLength=10), "its index is damaged"),
    (lambda c: c["buffers"][0].update(byteLength=1 << 40), "it is truncated"),
]


def extension_of(content: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = content["meshes"][0]["extensions"][NAME]
    return found


@pytest.mark.parametrize(("change", "message"), CHANGES, ids=[message for _, message in CHANGES])
def test_what_is_wrong_is_named(path: Path, change: Callable[[dict[str, Any]], object], message: str) -> None:
    content, binary = document(path)
    change(content)
    write(path, content, binary)
    for read in (mixseq.load, mixseq.read, mixseq.verify):
        with pytest.raises(FormatError, match=rf"walk\.glb.*{message}"):
            read(path)


def test_every_body_has_a_scene(coded: CompressedSequence, tmp_path: Path) -> None:
    other = replace(coded, header=replace(coded.header, name="Keule"), relation=Relation((0.0, 0.0, 1.0, 0.0)))
    mixseq.save(tmp_path / "two.glb", replace(coded, bodies=(other,)), still="plain")
    content, _ = document(tmp_path / "two.glb")
    assert content["scene"] == 0
    assert [[content["nodes"][node]["name"] for node in scene["nodes"]] for scene in content["scenes"]] == [
        ["Stange"],
        ["Keule"],
    ]
    validate(tmp_path / "two.glb")
    again = read_compressed(tmp_path / "two.glb")
    assert_same(again, coded)
    assert_same(again.bodies[0], other)
    assert again.bodies[0].relation == other.relation
    sizes = compressed_sizes(tmp_path / "two.glb")
    mixseq.save(tmp_path / "one.glb", coded, still="plain")
    one = compressed_sizes(tmp_path / "one.glb")
    assert (sizes["connectivity"], sizes["still"]) == (2 * one["connectivity"], 2 * one["still"])


def test_two_bodies_of_one_name_are_refused(path: Path) -> None:
    content, binary = document(path)
    content["meshes"].append(content["meshes"][0])
    write(path, content, binary)
    with pytest.raises(FormatError, match="two bodies have the same name, 'Stange'; it is damaged"):
        mixseq.load(path)
