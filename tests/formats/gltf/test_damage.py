"""glTF files in: references, damage, and what is refused."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError, InvalidSequenceError, MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_maker import JOINTS, TRIANGLE, Maker, load, morphing, moving, skinned, split_square

pytestmark = pytest.mark.slow


def test_data_uris_and_files_beside(tmp_path: Path) -> None:
    maker = moving()
    inside = load(maker.gltf(tmp_path / "inside.gltf"))
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "größer 1.bin").write_bytes(maker.binary)
    beside = load(maker.gltf(tmp_path / "beside.gltf", "data/gr%C3%B6%C3%9Fer%201.bin"))
    np.testing.assert_array_equal(inside.points, beside.points)
    assert beside.points[1, 0, 0] == 2


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "a/../../secret.bin",
        "%2e%2e/secret.bin",
        "/etc/passwd",
        "file:///etc/passwd",
        "C:secret.bin",
        "http://localhost/secret.bin",
        "..\\secret.bin",
        "link.bin",
        "secret\0.bin",
    ],
)
def test_references_out_of_the_folder(tmp_path: Path, uri: str) -> None:
    maker = moving()
    (tmp_path / "secret.bin").write_bytes(maker.binary)
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "link.bin").symlink_to(tmp_path / "secret.bin")
    with pytest.raises(FormatError, match="only files in the folder of the glTF file are read"):
        load(maker.gltf(tmp_path / "folder" / "file.gltf", uri))


@pytest.mark.parametrize(
    ("uri", "message"),
    [
        ("missing.bin", "not a file beside"),
        (".", "not a file beside"),
        ("data:,abc", "without base64"),
        ("data:;base64,a!", "invalid base64"),
        ("data:;base64,AAAA", "has 3 bytes of .*truncated"),
    ],
)
def test_buffers_that_are_not_there(tmp_path: Path, uri: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        load(moving().gltf(tmp_path / "file.gltf", uri))


OWNERS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "node": lambda it: it["nodes"][0],
    "mesh": lambda it: it["meshes"][0],
    "primitive": lambda it: it["meshes"][0]["primitives"][0],
    "accessor": lambda it: it["accessors"][0],
    "material": lambda it: it.setdefault("materials", [{}])[0],
    "channel": lambda it: it["animations"][0]["channels"][0],
    "document": lambda it: it,
}


@pytest.mark.parametrize("owner", OWNERS)
def test_unknown_extensions_are_named(made: Callable[..., MeshSequence], owner: str) -> None:
    """They are ignored where they are used, declared or not, and refused where they are required."""
    maker = moving()
    OWNERS[owner](maker.json)["extensions"] = {"ACME_teapots": {"spouts": 2}, "ACME_materials_clay": {}}
    maker.json["extensionsUsed"] = ["ACME_cups"]
    with pytest.warns(MixseqWarning, match="not supported are ignored: 'ACME_cups', 'ACME_teapots'$"):
        assert made(maker).frame_count == 2
    maker.json["extensionsRequired"] = ["KHR_mesh_quantization", "ACME_teapots", "ACME_cups"]
    with pytest.raises(FormatError, match="requires 'ACME_cups', 'ACME_teapots', extensions that are not supported"):
        made(maker)


@pytest.mark.parametrize("name", ["KHR_materials_unlit", "KHR_texture_transform", "KHR_node_visibility"])
def test_extensions_that_do_not_matter(made: Callable[..., MeshSequence], name: str) -> None:
    maker = moving()
    maker.json["extensionsRequired"] = [name]
    assert made(maker).frame_count == 2


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "cycle": (lambda it: it["nodes"].append({"children": [1]}), r"nodes\[1\] is below itself"),
    "cycle of two": (lambda it: it["nodes"].extend([{"children": [2]}, {"children": [1]}]), "is below itself"),
    "two parents": (lambda it: it["nodes"].extend([{"children": [0]}] * 2), "child of two nodes, 1 and 2"),
    "no such child": (lambda it: it["nodes"].append({"children": [9]}), r"nodes\[9\] is referenced"),
    "no such mesh": (lambda it: it["nodes"][0].update(mesh=3), r"meshes\[3\] is referenced"),
    "negative mesh": (lambda it: it["nodes"][0].update(mesh=-1), r"nodes\[0\].mesh is missing or damaged"),
    "no such skin": (lambda it: it["nodes"][0].update(skin=0), r"skins\[0\] is referenced"),
    "no joints": (lambda it: it.update(skins=[{"joints": []}]) or it["nodes"][0].update(skin=0), "has no joints"),
    "no weights": (
        lambda it: it.update(skins=[{"joints": [0]}]) or it["nodes"][0].update(skin=0),
        "has no JOINTS_0 and WEIGHTS_0",
    ),
    "no such joint": (
        lambda it: it.update(skins=[{"joints": [5]}]) or it["nodes"][0].update(skin=0),
        r"nodes\[5\] is referenced",
    ),
    "no such scene": (lambda it: it.update(scene=4, scenes=[{}]), r"scenes\[4\]"),
    "count": (lambda it: it["accessors"][0].update(count=2**40), r"accessors\[0\] has .* more than its 36 bytes"),
    "count of zeros": (
        lambda it: it["accessors"].__setitem__(0, {"count": 10**9, "componentType": 5126, "type": "VEC3"}),
        "have 3000000000 numbers, but the file only",
    ),
    "offset": (lambda it: it["accessors"][0].update(byteOffset=8), "more than its 36 bytes"),
    "stride": (lambda it: it["bufferViews"][0].update(byteStride=4), "does not fit its buffer"),
    "view": (lambda it: it["bufferViews"][0].update(byteLength=10**9), "does not fit its buffer"),
    "type": (lambda it: it["accessors"][0].update(type="MAT3"), "type 'MAT3'"),
    "width": (lambda it: it["accessors"][0].update(type="VEC2"), "POSITION of shape"),
    "sparse": (
        lambda it: it["accessors"][0].update(
            sparse={"count": 1, "indices": {"bufferView": 0, "byteOffset": 12, "componentType": 5125}, "values": {}}
        ),
        "indices go up to 1065353216, but there are 3",
    ),
    "indices": (lambda it: it["meshes"][0]["primitives"][0].update(indices=1), "integers are expected"),
    "mode": (lambda it: it["meshes"][0]["primitives"][0].update(mode="fan"), "mode is missing or damaged"),
    "sampler": (lambda it: it["animations"][0]["channels"][0].update(sampler=5), "has sampler 5 of 1"),
    "interpolation": (lambda it: it["animations"][0]["samplers"][0].update(interpolation="BEZIER"), "'BEZIER'"),
    "keys": (lambda it: it["accessors"][2].update(count=1), "has 6 values for 1 keys of translation"),
    "times": (lambda it: it["animations"][0]["samplers"][0].update(input=1), "times that do not increase"),
    "matrix": (lambda it: it["nodes"][0].update(matrix=np.eye(4).ravel().tolist()), "its translation is animated"),
    "short matrix": (lambda it: it["nodes"][0].update(matrix=[1]), "a list of 16 finite numbers"),
    "buffer": (lambda it: it.update(bufferViews=[{"buffer": 7, "byteLength": 1}] * 3), r"buffers\[7\] is referenced"),
    "version": (lambda it: it["asset"].update(version="1.0"), "version 1.0; convert it to version 2"),
    "asset": (lambda it: it.pop("asset"), "version unknown"),
    "no nodes": (lambda it: it.pop("nodes"), "no triangles to read"),
    "list": (lambda it: it.update(nodes={}), "nodes is missing or damaged; a list"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_json(made: Callable[..., MeshSequence], damage: str) -> None:
    maker = moving()
    change, message = DAMAGES[damage]
    change(maker.json)
    with pytest.raises(FormatError, match=message):
        made(maker)


def test_indices_beyond_the_vertices(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(TRIANGLE, [0, 1, 3]))
    with pytest.raises(FormatError, match="uses vertex 3, but has 3"):
        made(maker)
    maker = Maker()
    maker.node(mesh=maker.mesh(TRIANGLE, [0, 1]))
    with pytest.raises(FormatError, match="2 corners of triangles, which is not a multiple of 3"):
        made(maker)


def test_joints_beyond_the_skin(made: Callable[..., MeshSequence]) -> None:
    with pytest.raises(FormatError, match="has 2 joints, but vertices follow joint 2"):
        made(skinned([[1, 0, 0, 0]] * 3, [[2, 0, 0, 0]] * 3))
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["skins"][0]["inverseBindMatrices"] = 0
    with pytest.raises(FormatError, match="inverse bind matrices of shape"):
        made(maker)


def test_morph_weights_that_do_not_fit(made: Callable[..., MeshSequence]) -> None:
    maker = morphing()
    maker.animate(0, "weights", [0, 1], np.zeros((2, 3)))
    with pytest.raises(FormatError, match="has 2 morph targets, but 3 weights are animated"):
        made(maker)
    maker = morphing(weights=[1])
    with pytest.raises(FormatError, match=r"weights .* 2 finite numbers"):
        made(maker)
    maker = split_square(targets=[{}])
    with pytest.raises(FormatError, match="has 1 morph targets, another primitive of the mesh 0"):
        made(maker)


def test_a_root_of_the_scene_that_is_a_child(made: Callable[..., MeshSequence]) -> None:
    """The transform of its parent counts, whether the scene lists the parent or not."""
    for roots in ([1], [0, 1], [1, 0]):
        maker = Maker(scene=0, scenes=[{"nodes": roots}])
        maker.node("above", children=[1], translation=[5, 0, 0])
        maker.node("body", mesh=maker.mesh(TRIANGLE))
        with pytest.warns(MixseqWarning, match=r"nodes\[1\] is a root of the scene, though a child of nodes\[0\]"):
            got = made(maker)
        np.testing.assert_array_equal(got.points, np.add([TRIANGLE], [5, 0, 0]))


def test_points_that_are_not_finite(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh([[0, 0, 0], [np.inf, 0, 0], [0, 1, 0]]), scale=[0, 1, 1])
    with pytest.raises(InvalidSequenceError, match=r"made.glb: frame 0: vertex 1"):
        made(maker)


def test_channels_named_too_often(made: Callable[..., MeshSequence]) -> None:
    times = np.arange(20_000) / 24
    maker = moving(times, np.outer(times, [1, 0, 0]))
    channels = maker.json["animations"][0]["channels"]
    channels *= 500
    with pytest.raises(FormatError, match=r"animations\[0\] have .* repeats"):
        made(maker)


@pytest.fixture
def low_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small files repeat too much with fewer numbers, which are quicker to read."""
    monkeypatch.setattr("mixseq_io.gltf.document._MAX_UNSTORED_NUMBERS", 1000)


@pytest.mark.usefixtures("low_limit")
def test_skeletons_named_too_often(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["skins"] = [{"joints": [0] * 200}]
    maker.json["nodes"] += [{"mesh": 0, "skin": 0}] * 100
    with pytest.raises(FormatError, match="skeletons of all meshes together have"):
        made(maker)


@pytest.mark.usefixtures("low_limit")
def test_instances_named_too_often(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(np.arange(600).reshape(200, 3), mode=5)
    maker.json["nodes"] = [{"mesh": mesh}] * 100
    with pytest.raises(FormatError, match="meshes of all nodes together have"):
        made(maker)


def test_a_mesh_named_too_often(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(np.zeros((20_000, 3)), mode=5)
    primitives = maker.json["meshes"][mesh]["primitives"]
    primitives *= 600
    maker.node(mesh=mesh)
    with pytest.raises(FormatError, match="it is damaged, or repeats one mesh too often"):
        made(maker)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "cannot be read as glTF"),
        (b"[" * 100_000, "cannot be read as glTF"),
        (b"[1]", "is JSON, but not glTF"),
        (b"\xff\xfe", "cannot be read as glTF"),
        (b"glTF", "too few"),
        (struct.pack("<4sIIII", b"glTF", 1, 20, 0, 0), "version 1"),
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 2**31, b"JSON"), "goes beyond the end"),
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 0, b"BIN\0"), "does not begin with JSON"),
        (b'{"asset": {"version": "2.0"}, "nodes": [{"mesh": 1e999}]}', "mesh is missing or damaged"),
        (b'{"asset": {"version": "2.0"}, "x": ' + b"9" * 5000 + b"}", "cannot be read as glTF"),
    ],
)
def test_files_that_are_none(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "none.glb"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message):
        load(path)


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        load(tmp_path / "none.glb")
    with pytest.raises(FormatError, match="is a folder"):
        load(tmp_path)


def test_truncation_and_flipped_bytes_of_small_files(tmp_path: Path) -> None:
    maker = skinned([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]], JOINTS)
    maker.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": maker.add(np.ones((3, 3)))}]
    maker.animate(2, "weights", [0, 1], [0, 1])
    hammer(maker.glb(tmp_path / "small.glb"), tmp_path / "damaged.glb", 2, 120)


def hammer(path: Path, damaged: Path, percent: float, flips: int) -> None:
    """Truncate a file and flip its bytes; all must end well or in an error of ours."""
    content = path.read_bytes()
    for end in np.arange(0, 100, percent) / 100 * len(content):
        damaged.write_bytes(content[: int(end)])
        with pytest.raises(FormatError):
            load(damaged)
    rng = np.random.default_rng(5)
    text = 20 + struct.unpack_from("<I", content, 12)[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        for flip in range(flips):
            broken = bytearray(content)
            for place in rng.integers(0, text if flip % 3 else len(content), rng.integers(1, 4)):
                broken[place] = rng.integers(256) if flip % 2 else broken[place] ^ 1 << int(rng.integers(8))
            damaged.write_bytes(broken)
            try:
                load(damaged)
            except (FormatError, InvalidSequenceError):
                continue


@pytest.mark.realdata
def test_damage_to_a_real_file(data: Path, tmp_path: Path) -> None:
    hammer(data / "gltf" / "RiggedSimple.glb", tmp_path / "damaged.glb", 2, 100)


# Texture coordinates that a material transforms, in closed form

UVS = [[0.25, 0.5], [1, 0], [0, 1]]


def textured(material: dict[str, Any]) -> Maker:
    maker = Maker(materials=[material], textures=[{}])
    uvs = maker.add(UVS)
    maker.node("flag", mesh=maker.mesh(TRIANGLE, on={"TEXCOORD_0": uvs}, material=0))
    return maker


def base(texture: dict[str, Any], **transform: Any) -> dict[str, Any]:
    info = {"index": 0, **texture, "extensions": {"KHR_texture_transform": transform}}
    return {"pbrMetallicRoughness": {"baseColorTexture": info}}


def uvs(maker: Maker, folder: Path) -> list[list[float]]:
    """Return texture coordinates with v downwards, as glTF has them."""
    found = load(maker.glb(folder / "textured.glb")).surface.uvs
    assert found is not None
    downwards: list[list[float]] = np.round(found.at_corners * [1, -1] + [0, 1], 6).tolist()
    return downwards


def test_moved_and_scaled(tmp_path: Path) -> None:
    found = uvs(textured(base({}, offset=[0.5, 0], scale=[2, -1])), tmp_path)
    assert found == [[1, -0.5], [2.5, 0], [0.5, -1]]


def test_the_example_of_the_specification(tmp_path: Path) -> None:
    """It "utilizes only the lower left quadrant": u from 0 to 1/2, v, which points down, from 1/2 to 1."""
    transform = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5]}
    assert uvs(textured(base({}, **transform)), tmp_path) == [[0.25, 0.875], [0, 0.5], [0.5, 1]]


def test_textures_with_other_coordinates_do_not_matter(tmp_path: Path) -> None:
    assert uvs(textured(base({"texCoord": 1}, offset=[1, 1])), tmp_path) == UVS
    assert uvs(textured(base({}, offset=[1, 1], texCoord=1)), tmp_path) == UVS
    assert uvs(textured(base({"texCoord": 1}, offset=[1, 0], texCoord=0)), tmp_path)[0] == [1.25, 0.5]


def test_the_texture_of_the_base_colour_decides(tmp_path: Path) -> None:
    other = {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [7, 7]}}}
    assert uvs(textured({"normalTexture": other, **base({}, offset=[1, 0])}), tmp_path)[0] == [1.25, 0.5]
    assert uvs(textured({"normalTexture": other}), tmp_path)[0] == [7.25, 7.5]


@pytest.mark.parametrize("transform", [{"offset": [1]}, {"scale": "2"}, {"rotation": [1]}, {"texCoord": -1}])
def test_damage(transform: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="is missing or damaged"):
        load(textured(base({}, **transform)).glb(tmp_path / "bad.glb"))


SECOND_MESH_DAMAGES: dict[str, Callable[[dict[str, Any]], object]] = {
    "no such mesh": lambda it: it["nodes"][1].update(mesh=9),
    "no such sampler": lambda it: it["animations"][0]["channels"][1].update(sampler=9),
    "no such interpolation": lambda it: it["animations"][0]["samplers"][1].update(interpolation="QUADRATIC"),
    "no such accessor": lambda it: it["animations"][0]["samplers"][1].update(output=99),
    "channel of another width": lambda it: it["animations"][0]["channels"][1]["target"].update(path="rotation"),
    "channel of the parent": lambda it: it["animations"][0]["channels"][2].update(sampler=9),
    "no such vertex": lambda it: it["meshes"][1]["primitives"][0].update(indices=0),
}


@pytest.mark.parametrize("damage", SECOND_MESH_DAMAGES)
def test_one_damaged_mesh_is_left_out(made: Callable[..., MeshSequence], damage: str) -> None:
    """Damage to the mesh, or to an animation that moves it or its parent, leaves all other meshes as they are."""
    maker = moving()
    second = maker.node("second", mesh=maker.mesh(TRIANGLE, [0, 1, 2]))
    parent = maker.node("parent", children=[second])
    for node in (second, parent):
        maker.animate(node, "translation", [0, 1], [[0, 0, 0], [0, 0, 5]])
    assert made(maker).vertex_count == 6
    SECOND_MESH_DAMAGES[damage](maker.json)
    with pytest.warns(MixseqWarning, match="cannot be read are left out: parent/second"):
        got = made(maker)
    np.testing.assert_array_equal(got.points, made(moving()).points)
