"""glTF files in: closed forms, refusals, damage, and creatures whose points others have baked."""

from __future__ import annotations

import base64
import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mixseq.errors import (
    AmbiguousError,
    FormatError,
    InvalidSequenceError,
    MixseqWarning,
    SettingsError,
)
from mixseq.sequence import MeshSequence, collect
from mixseq_io.gltf.document import load_document
from mixseq_io.gltf.reader import open_gltf
from mixseq_io.gltf.welding import weld

TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


class Maker:
    """A glTF file in the making; `json` may be changed at will."""

    def __init__(self, **json: Any) -> None:
        self.binary = b""
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], **json}

    def view(self, values: NDArray[Any]) -> int:
        self.json["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes}
        )
        self.binary += values.tobytes() + bytes(-values.nbytes % 4)
        return len(self.json["bufferViews"]) - 1

    def add(self, values: Any, dtype: str = "f4", **more: Any) -> int:
        array = np.ascontiguousarray(values, "<" + dtype)
        width = 1 if array.ndim == 1 else array.shape[-1]
        accessor = {"bufferView": self.view(array), "componentType": COMPONENTS[dtype], "type": TYPES[width]}
        self.json["accessors"].append({**accessor, "count": array.size // width, **more})
        return len(self.json["accessors"]) - 1

    def mesh(self, points: Any, faces: Any | None = None, **more: Any) -> int:
        primitive: dict[str, Any] = {"attributes": {"POSITION": self.add(points)}, **more}
        primitive["attributes"].update(more.pop("on", {}))
        primitive.pop("on", None)
        if faces is not None:
            primitive["indices"] = self.add(np.ravel(faces), "u2")
        self.json.setdefault("meshes", []).append({"primitives": [primitive]})
        return len(self.json["meshes"]) - 1

    def node(self, name: str = "", **fields: Any) -> int:
        self.json.setdefault("nodes", []).append({**({"name": name} if name else {}), **fields})
        return len(self.json["nodes"]) - 1

    def animate(self, node: int, path: str, times: Any, values: Any, how: str = "", name: str = "") -> None:
        values = self.add(np.ravel(values) if path == "weights" else values)
        sampler = {"input": self.add(times), "output": values, **({"interpolation": how} if how else {})}
        animations = self.json.setdefault("animations", [])
        if not animations or name:
            animations.append({"samplers": [], "channels": [], **({"name": name} if name else {})})
        animations[-1]["samplers"].append(sampler)
        number = len(animations[-1]["samplers"]) - 1
        animations[-1]["channels"].append({"sampler": number, "target": {"node": node, "path": path}})

    def glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    def gltf(self, path: Path, uri: str | None = None) -> Path:
        data = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        self.json["buffers"] = [{"byteLength": len(self.binary), "uri": data if uri is None else uri}]
        path.write_text(json.dumps(self.json))
        return path


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., MeshSequence]:
    """Write a file and read it."""
    return lambda maker, **options: load(maker.glb(tmp_path / "made.glb"), **options)


def load(path: Path, **options: Any) -> MeshSequence:
    with open_gltf(path, **options) as reader:
        return collect(reader.header, reader.blocks(3))


def moving(times: Any = (0, 1), values: Any = ((0, 0, 0), (2, 0, 0)), how: str = "") -> Maker:
    """Return a triangle whose node moves."""
    maker = Maker()
    node = maker.node("body", mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "translation", times, values, how)
    return maker


# Interpolation.


def test_linear_translation_and_what_is_beyond_the_keys(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0.5, 1.0, 2.0], [[0, 0, 0], [2, 0, 0], [2, 4, 0]])
    other = maker.node("later", mesh=maker.mesh(TRIANGLE))
    maker.animate(other, "translation", [0, 3], [[0, 0, 0], [0, 0, 3]])
    got = made(maker)
    assert got.times.tolist() == [0, 0.5, 1, 2, 3]
    np.testing.assert_allclose(got.points[:, 0, :2], [[0, 0], [0, 0], [2, 0], [2, 4], [2, 4]])
    np.testing.assert_allclose(got.points[:, 3, 2], [0, 0.5, 1, 2, 3])


def test_linear_rotation_is_an_arc_the_short_way(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    third = np.array([0, 0, np.sin(np.pi / 3), np.cos(np.pi / 3)])
    maker.animate(node, "rotation", [0, 1], [[0, 0, 0, 1], -third])
    got = made(maker, fps=4)
    angles = np.linspace(0, 2 * np.pi / 3, 5)
    np.testing.assert_allclose(got.points[:, 1, :2], np.stack([np.cos(angles), np.sin(angles)], 1), atol=1e-6)


def test_step(made: Callable[..., MeshSequence]) -> None:
    got = made(moving([0, 1, 2], [[0, 0, 0], [2, 0, 0], [5, 0, 0]], "STEP"), fps=2)
    assert got.points[:, 0, 0].tolist() == [0, 0, 2, 2, 5]


def test_cubic_spline(made: Callable[..., MeshSequence]) -> None:
    """Hermite's form gives any cubic back, here (2 t)^3 over two steps of unequal length."""
    times = np.array([0, 0.5, 2.0])
    keys = np.zeros((3, 3, 3))
    keys[:, 1, 1], keys[:, 0, 1], keys[:, 2, 1] = 8 * times**3, 24 * times**2, 24 * times**2
    got = made(moving(times, keys.reshape(-1, 3), "CUBICSPLINE"), fps=8)
    np.testing.assert_allclose(got.points[:, 0, 1], 8 * got.times**3, rtol=1e-6)


def test_cubic_rotations_are_normalised(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    zero, half = [0, 0, 0, 0], np.sqrt(0.5)
    keys = [zero, [0, 0, 0, 1], zero, zero, [0, 0, half, half], zero]
    maker.animate(node, "rotation", [0, 1], keys, "CUBICSPLINE")
    got = made(maker, fps=2)
    np.testing.assert_allclose(
        got.points[1, 1], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6
    )  # by symmetry 45°


def test_normalised_rotations(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]])
    output = maker.json["animations"][0]["samplers"][0]
    output["output"] = maker.add([[0, 0, 0, 32767], [0, 0, -32767, 0]], "i2", normalized=True)
    np.testing.assert_allclose(made(maker).points[1, 1], [-1, 0, 0], atol=1e-7)


# Frames.


def test_a_single_frame_without_animation(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(TRIANGLE), translation=[1, 2, 3])
    for fps in (None, 24):
        got = made(maker, fps=fps)
        assert got.times.tolist() == [0]
        assert got.points.tolist() == [[[1, 2, 3], [2, 2, 3], [1, 3, 3]]]
    assert (got.up_axis, got.metres_per_unit) == ("Y", 1.0)


@pytest.mark.parametrize(
    ("times", "rate"),
    [
        (np.arange(5) / 24, 24),
        (np.arange(5) / 29.97, 30000 / 1001),
        (np.array([0.1, 0.3, 0.4, 0.7]), 30),
        (np.array([0, 1.25]), 24),
        (np.arange(5) / 90, 90),
        (np.array([0, 0.1, 0.1333333]), 30),
        (np.array([0, 0.1, 0.137]), 24),
    ],
)
def test_the_rate_is_that_of_the_keys(
    made: Callable[..., MeshSequence], times: NDArray[np.float64], rate: float
) -> None:
    got = made(moving(times, np.outer(times, [1, 0, 0])))
    assert got.fps == pytest.approx(rate, rel=1e-6)
    np.testing.assert_array_equal(got.times, times.astype(np.float32))


def test_times_that_nearly_coincide_count_once(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 0.1], [[0, 0, 0], [1, 0, 0]])
    maker.animate(0, "scale", [0, np.nextafter(np.float32(0.1), 1)], [[1, 1, 1], [2, 2, 2]])
    assert made(maker).frame_count == 2


def test_frames_at_a_rate(made: Callable[..., MeshSequence]) -> None:
    got = made(moving([0.25, 1.3], [[0, 0, 0], [1, 0, 0]]), fps=10)
    assert got.fps == 10
    np.testing.assert_allclose(got.times, 0.25 + np.arange(11) / 10)


def test_the_choice_of_an_animation(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], name="walk")
    maker.animate(node, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]], name="run")
    for choice in ("run", 1, "1"):
        assert made(maker, animation=choice).points[1, 0, 0] == 2
    with pytest.warns(
        MixseqWarning, match="of 2 animations the first, 'walk', is read; the option animation .* 'run'"
    ):
        assert made(maker).points[1, 0, 0] == 1
    for wrong in ("fly", 2, -1):
        with pytest.raises(SettingsError, match=r"has no animation .*; there are 'walk', 'run'"):
            made(maker, animation=wrong)


@pytest.mark.parametrize("fps", [0, -1, np.nan, np.inf])
def test_rates_that_are_none(made: Callable[..., MeshSequence], fps: float) -> None:
    with pytest.raises(SettingsError, match=r"fps is .*; a positive number"):
        made(moving(), fps=fps)


def test_too_many_frames(made: Callable[..., MeshSequence]) -> None:
    with pytest.raises(FormatError, match="too many frames"):
        made(moving([0, 1e30]), fps=24)


# Nodes.


def test_transforms_above_a_mesh(made: Callable[..., MeshSequence]) -> None:
    """Scale, then rotate, then translate, then the parent's matrix, which is column by column."""
    maker = Maker()
    child = maker.node(
        "child",
        mesh=maker.mesh(TRIANGLE),
        scale=[2, 3, 1],
        rotation=[0, 0, np.sqrt(0.5), np.sqrt(0.5)],
        translation=[0, 0, 5],
    )
    maker.node("parent", children=[child], matrix=[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 20, 30, 1])
    maker.animate(1 - child, "translation", [0], [[0, 0, 0]])
    del maker.json["animations"]
    got = made(maker)
    np.testing.assert_allclose(got.points[0], [[10, 20, 35], [10, 22, 35], [7, 20, 35]], atol=1e-6)
    assert got.objects[0].path == "parent/child"


def test_a_mirroring_node_keeps_faces_outwards(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    uvs = maker.add([[0, 0], [1, 0], [0, 1]])
    maker.node(mesh=maker.mesh(TRIANGLE, on={"TEXCOORD_0": uvs}), scale=[-1, 1, 1])
    got = made(maker)
    assert got.faces.tolist() == [[0, 2, 1]]
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == [[0, 1], [0, 0], [1, 1]]


def test_mirroring_that_changes_is_refused(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node("body", mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "scale", [0, 1], [[1, 1, 1], [-1, 1, 1]])
    with pytest.raises(InvalidSequenceError, match="frame 1: 'body' is mirrored relative to the first frame"):
        made(maker)


def test_a_scale_of_nothing_is_none_of_that(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.animate(maker.node(mesh=maker.mesh(TRIANGLE)), "scale", [0, 1], [[1, 1, 1], [0, 0, 0]])
    assert not made(maker).points[1].any()


def test_instances_are_objects_of_their_own(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    first, second = maker.node("leaf", mesh=mesh), maker.node("leaf", mesh=mesh, translation=[5, 0, 0])
    maker.node("tree", children=[first, second])
    got = made(maker)
    assert [each.path for each in got.objects] == ["tree/leaf", f"tree/leaf (node {second})"]
    assert got.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert got.points[0, 3:, 0].tolist() == [5, 6, 5]
    assert got.name == "tree"
    assert made(maker, prim=f"tree/leaf (node {second})").vertex_count == 3


def test_what_stands_still_is_left_out_unless_named(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["meshes"][0]["name"] = "skinny"
    floor = maker.node("floor", mesh=maker.mesh(SQUARE, [0, 1, 2]))
    maker.node("room", children=[floor])
    with pytest.warns(MixseqWarning, match=r"1 meshes stand still .*'room/floor'; prim='/' takes them"):
        got = made(maker)
    assert (got.name, got.vertex_count, got.frame_count) == ("body", 3, 2)
    assert made(maker, prim="/").vertex_count == 7
    for prim in ("room", "/room/floor", "floor"):
        got = made(maker, prim=prim)
        assert (got.name, got.vertex_count, got.frame_count) == ("floor", 4, 1)
    assert made(maker, prim="skinny").vertex_count == 3
    with pytest.raises(FormatError, match="has no mesh at 'cellar'; there are 'body', 'room/floor'"):
        made(maker, prim="cellar")


def test_a_name_of_several_nodes_is_ambiguous(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    for parent in ("left", "right"):
        maker.node(parent, children=[maker.node("hand", mesh=maker.mesh(TRIANGLE))])
    with pytest.raises(
        AmbiguousError, match="'hand' is the name of 2 nodes; give a path: 'left/hand', 'right/hand'"
    ):
        made(maker, prim="hand")
    assert made(maker, prim="right/hand").vertex_count == 3


def test_only_the_default_scene_is_read(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    shown, _ = (
        maker.node("shown", mesh=maker.mesh(TRIANGLE)),
        maker.node("hidden", mesh=maker.mesh(SQUARE, [0, 1, 2])),
    )
    maker.json.update(scenes=[{"nodes": []}, {"nodes": [shown]}], scene=1)
    assert [each.name for each in made(maker).objects] == ["shown"]


# Skins and morph targets.


def skinned(weights: Any, joints: Any, dtype: str = "f4", **more: Any) -> Maker:
    """Return a triangle on two joints; the second stands at x = 1 and turns by a quarter about z."""
    maker = Maker()
    on = {"JOINTS_0": maker.add(joints, "u1"), "WEIGHTS_0": maker.add(weights, dtype, **more)}
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 0, 3] = -1
    second = maker.node("second", translation=[1, 0, 0])
    first = maker.node("first", children=[second])
    maker.node(
        "body", mesh=maker.mesh([[2, 0, 0], [2, 1, 0], [0, 1, 0]], on=on), skin=0, translation=[100, 0, 0]
    )
    inverse = maker.add(binds.transpose(0, 2, 1).reshape(2, 16))
    maker.json["skins"] = [{"joints": [first, second], "inverseBindMatrices": inverse}]
    maker.animate(second, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    return maker


JOINTS = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]]


@pytest.mark.parametrize("scale", [1, 7])  # weights are made to sum to 1
def test_two_joints(made: Callable[..., MeshSequence], scale: float) -> None:
    got = made(skinned(scale * np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]]), JOINTS))
    np.testing.assert_allclose(got.points[0], [[2, 0, 0], [2, 1, 0], [0, 1, 0]], atol=1e-6)
    # The second vertex is half way between (2, 1) and where the joint takes it, (0, 1).
    np.testing.assert_allclose(got.points[1], [[1, 1, 0], [1, 1, 0], [0, 1, 0]], atol=1e-6)


def test_normalised_weights(made: Callable[..., MeshSequence]) -> None:
    weights = [[255, 0, 0, 0], [51, 204, 0, 0], [255, 0, 0, 0]]
    got = made(skinned(weights, JOINTS, "u1", normalized=True))
    np.testing.assert_allclose(got.points[1, 1], [0.2 * 2 + 0.8 * 0, 1, 0], atol=1e-6)


def test_a_second_set_of_joints(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[0.25, 0, 0, 0]] * 3, np.zeros((3, 4)))
    maker.json["meshes"][0]["primitives"][0]["attributes"].update(
        JOINTS_1=maker.add([[1, 1, 1, 1]] * 3, "u2"), WEIGHTS_1=maker.add([[0.25, 0.25, 0.25, 0]] * 3)
    )
    np.testing.assert_allclose(made(maker).points[1, 0], [0.25 * 2 + 0.75 * 1, 0.75, 0], atol=1e-6)


def test_weights_of_nothing_follow_the_first_joint(made: Callable[..., MeshSequence]) -> None:
    got = made(skinned(np.zeros((3, 4)), JOINTS))
    np.testing.assert_allclose(got.points[1], got.points[0])


def test_a_mirroring_skeleton_keeps_faces_outwards(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["nodes"][1]["scale"] = [1, 1, -1]
    assert made(maker).faces.tolist() == [[0, 2, 1]]


def morphing(**more: Any) -> Maker:
    maker = Maker()
    targets = [
        {"POSITION": maker.add([[0, 0, 1]] * 3)},
        {"POSITION": maker.add([[0, 0, 0], [4, 0, 0], [0, 0, 0]])},
    ]
    maker.node("face", mesh=maker.mesh(TRIANGLE, targets=targets), **more)
    return maker


def test_morph_targets_that_stand_still(made: Callable[..., MeshSequence]) -> None:
    maker = morphing()
    assert made(maker).points[0].tolist() == TRIANGLE
    maker.json["meshes"][0]["weights"] = [0.5, 0.25]
    assert made(maker).points[0].tolist() == [[0, 0, 0.5], [2, 0, 0.5], [0, 1, 0.5]]
    maker.json["nodes"][0]["weights"] = [2, 0]
    assert made(maker).points[0].tolist() == [[0, 0, 2], [1, 0, 2], [0, 1, 2]]


@pytest.mark.parametrize("how", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_animated_morph_targets(made: Callable[..., MeshSequence], how: str) -> None:
    maker = morphing(translation=[0, 0, 10])
    keys, flat = np.array([[0, 0], [1, 0.5]]), np.zeros((2, 2))
    if how == "CUBICSPLINE":  # per key tangents, values, tangents
        keys = np.stack([flat, keys, flat], axis=1)
    maker.animate(0, "weights", [0, 1], keys, how)
    got = made(maker, fps=2)
    middle = 0.0 if how == "STEP" else 0.5
    np.testing.assert_allclose(
        got.points[:, 1], np.array([[1, 0, 10], [1 + 2 * middle, 0, 10 + middle], [3, 0, 11]])
    )


def test_morphs_come_before_the_skin(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    mesh = maker.json["meshes"][0]
    mesh["primitives"][0]["targets"] = [{"POSITION": maker.add([[1, 0, 0]] * 3)}]
    mesh["weights"] = [1]
    np.testing.assert_allclose(made(maker).points[1, 0], [1, 2, 0], atol=1e-6)


# Accessors.


def accessor(tmp_path: Path, maker: Maker, index: int) -> NDArray[Any]:
    return load_document(maker.glb(tmp_path / "numbers.glb")).accessor(index)


def test_sparse_accessors(tmp_path: Path) -> None:
    maker = Maker()
    base = maker.add(np.arange(12).reshape(4, 3))
    sparse = {
        "count": 2,
        "indices": {"bufferView": maker.view(np.array([1, 3], "<u2")), "componentType": 5123},
        "values": {"bufferView": maker.view(np.array([[-1, -2, -3], [-4, -5, -6]], "<f4"))},
    }
    maker.json["accessors"][base]["sparse"] = sparse
    maker.json["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 4, "sparse": sparse})
    assert accessor(tmp_path, maker, 0).tolist() == [[0, 1, 2], [-1, -2, -3], [6, 7, 8], [-4, -5, -6]]
    assert accessor(tmp_path, maker, 1).tolist() == [[0, 0, 0], [-1, -2, -3], [0, 0, 0], [-4, -5, -6]]


@pytest.mark.parametrize(
    ("dtype", "stored", "values"),
    [
        ("i1", [-128, -127, 0, 127], [-1, -1, 0, 1]),
        ("u1", [0, 51, 255], [0, 0.2, 1]),
        ("i2", [-32768, 32767], [-1, 1]),
        ("u2", [0, 13107, 65535], [0, 0.2, 1]),
    ],
)
def test_normalised_accessors(tmp_path: Path, dtype: str, stored: list[int], values: list[float]) -> None:
    maker = Maker()
    maker.add(stored, dtype, normalized=True)
    np.testing.assert_array_equal(accessor(tmp_path, maker, 0), np.array(values, np.float32))


def test_interleaved_accessors(tmp_path: Path) -> None:
    maker = Maker()
    both = np.arange(10, dtype="<f4").reshape(2, 5)
    view = maker.view(both)
    maker.json["bufferViews"][view]["byteStride"] = 20
    for offset, kind in ((0, "VEC3"), (12, "VEC2")):
        maker.json["accessors"].append(
            {"bufferView": view, "byteOffset": offset, "componentType": 5126, "type": kind, "count": 2}
        )
    assert accessor(tmp_path, maker, 0).tolist() == [[0, 1, 2], [5, 6, 7]]
    assert accessor(tmp_path, maker, 1).tolist() == [[3, 4], [8, 9]]


@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions(made: Callable[..., MeshSequence], normalized: bool) -> None:
    maker = Maker(extensionsRequired=["KHR_mesh_quantization"])
    mesh = maker.mesh(TRIANGLE)
    stored = np.array([[0, 0, 0], [32767, 0, 0], [0, 32767, 0]])
    maker.json["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"] = maker.add(
        np.pad(stored, [(0, 0), (0, 0)]), "i2", normalized=normalized
    )
    maker.node(mesh=mesh, scale=[1 if normalized else 1 / 32767] * 3)
    np.testing.assert_allclose(made(maker).points[0], TRIANGLE, atol=1e-7)


# Primitives, welding, surface.


@pytest.mark.parametrize(
    ("mode", "faces"),
    [(5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])],
    ids=["strip", "fan"],
)
@pytest.mark.parametrize("indexed", [False, True])
def test_strips_and_fans(
    made: Callable[..., MeshSequence], mode: int, faces: list[list[int]], indexed: bool
) -> None:
    maker = Maker()
    points = np.arange(15).reshape(5, 3) ** 2
    maker.node(mesh=maker.mesh(points, range(5) if indexed else None, mode=mode))
    assert made(maker).faces.tolist() == faces


def test_points_and_lines_are_left_out(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    maker.json["meshes"][mesh]["primitives"] += [
        {"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1)
    ]
    maker.node(mesh=mesh)
    with pytest.warns(MixseqWarning, match="primitives 1, 2 are points, lines or empty"):
        assert made(maker).vertex_count == 3
    del maker.json["meshes"][mesh]["primitives"][0]
    with pytest.warns(MixseqWarning), pytest.raises(FormatError, match="no triangles"):
        made(maker)


def split_square(**second: Any) -> Maker:
    """Return a square of two triangles that share no vertex, one per primitive."""
    maker = Maker(materials=[{"name": "red"}, {}])
    uvs = maker.add([[0, 0], [1, 0], [1, 0.25]])
    mesh = maker.mesh([SQUARE[0], SQUARE[1], SQUARE[2]], on={"TEXCOORD_0": uvs}, material=0)
    maker.mesh([SQUARE[0], SQUARE[2], SQUARE[3]], **second)
    maker.json["meshes"][mesh]["primitives"] += maker.json["meshes"].pop()["primitives"]
    maker.node("square", mesh=mesh)
    return maker


def test_vertices_are_welded_across_primitives(made: Callable[..., MeshSequence], tmp_path: Path) -> None:
    got = made(split_square(material=1))
    assert got.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert got.points[0].tolist() == SQUARE
    assert [(each.name, each.material, each.polygons.tolist()) for each in got.surface.face_sets] == [
        ("red", "red", [0]),
        ("material 1", "material 1", [1]),
    ]
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == [[0, 1], [1, 1], [1, 0.75], [0, 0], [0, 0], [0, 0]]
    assert got.surface.origin is not None
    assert (got.surface.origin.format, got.surface.origin.path) == ("glTF", str(tmp_path / "made.glb"))
    found = weld(load_document(tmp_path / "made.glb"), 0)
    assert [each.tolist() for each in found.of_primitive] == [[0, 1, 2], [0, 2, 3]]
    assert found.representatives.tolist() == [0, 1, 2, 5]


def test_without_a_material(made: Callable[..., MeshSequence]) -> None:
    last = made(split_square()).surface.face_sets[1]
    assert (last.name, last.material) == ("primitive 1", "")


def test_what_moves_apart_is_not_welded(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["targets"] = [{"POSITION": maker.add(np.zeros((3, 3)))}]
    two["targets"] = [{"POSITION": maker.add([[0, 0, 0], [0, 0, 1], [0, 0, 0]])}]
    assert made(maker).faces.tolist() == [[0, 1, 2], [0, 3, 4]]
    maker = split_square()
    joints = maker.add([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]], "u1"), maker.add(np.zeros((3, 4)), "u1")
    weights = maker.add([[0.5, 0.5, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]), maker.add([[1, 0, 0, 0]] * 3)
    for primitive, joint, weight in zip(maker.json["meshes"][0]["primitives"], joints, weights, strict=True):
        primitive["attributes"].update(JOINTS_0=joint, WEIGHTS_0=weight)
    assert made(maker).faces.tolist() == [[0, 1, 2], [3, 2, 4]]


def test_vertex_numbers_tell_without_welding(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["attributes"]["_VERTEX"] = maker.add([4, 1, 3])
    two["attributes"]["_VERTEX"] = maker.add([4, 0, 2])  # two vertices at one place
    assert made(maker).faces.tolist() == [[4, 1, 3], [4, 0, 2]]
    two["attributes"]["_VERTEX"] = maker.add([4, 1, 2])  # of someone else: positions differ
    assert made(maker).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_creases_follow_normals(made: Callable[..., MeshSequence]) -> None:
    up, side = [0, 0, 1], [1, 0, 0]
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["attributes"]["NORMAL"], two["attributes"]["NORMAL"] = maker.add([up] * 3), maker.add([up, side, up])
    creases = made(maker).surface.creases
    assert creases is not None
    same = creases[:, None] == creases
    assert same[0, 3] and not same[2, 4] and len(np.unique(creases)) == 5
    two["attributes"]["NORMAL"] = one["attributes"]["NORMAL"]
    assert made(maker).surface.creases is None


def test_without_normals_faces_are_flat(made: Callable[..., MeshSequence]) -> None:
    creases = made(split_square()).surface.creases
    assert creases is not None and len(np.unique(creases)) == 6


def test_further_texture_coordinates_are_warned_about(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    attributes = maker.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = attributes["TEXCOORD_0"]
    with pytest.warns(MixseqWarning, match="several sets of texture coordinates; TEXCOORD_0 is read"):
        made(maker)


# Files.


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
        ("data:;base64,a!", "not base64"),
        ("data:;base64,AAAA", "has 3 bytes of .*truncated"),
    ],
)
def test_buffers_that_are_not_there(tmp_path: Path, uri: str, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        load(moving().gltf(tmp_path / "file.gltf", uri))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("KHR_draco_mesh_compression", r"compressed with Draco \(KHR_draco.*gltf-transform cp made.glb"),
        ("EXT_meshopt_compression", "compressed with meshopt"),
        ("ACME_teapots", "requires the extension ACME_teapots"),
    ],
)
def test_extensions_that_are_not_read(made: Callable[..., MeshSequence], name: str, message: str) -> None:
    maker = moving()
    maker.json["extensionsRequired"] = [name]
    with pytest.raises(FormatError, match=message):
        made(maker)


def test_draco_without_a_fallback(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {}}
    made(maker)
    del maker.json["accessors"][0]["bufferView"]
    with pytest.raises(FormatError, match="compressed with Draco"):
        made(maker)


@pytest.mark.parametrize("name", ["KHR_materials_unlit", "KHR_texture_transform", "KHR_node_visibility"])
def test_extensions_that_do_not_matter(made: Callable[..., MeshSequence], name: str) -> None:
    maker = moving()
    maker.json["extensionsRequired"] = [name]
    assert made(maker).frame_count == 2


def test_animation_pointers_are_warned_about(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["animations"][0]["channels"].append({"sampler": 0, "target": {"path": "pointer"}})
    with pytest.warns(MixseqWarning, match="1 channels of KHR_animation_pointer are left out"):
        made(maker)


DAMAGES: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "cycle": (lambda it: it["nodes"].append({"children": [1]}), r"nodes\[1\] is below itself"),
    "cycle of two": (
        lambda it: it["nodes"].extend([{"children": [2]}, {"children": [1]}]),
        "is below itself",
    ),
    "two parents": (lambda it: it["nodes"].extend([{"children": [0]}] * 2), "child of two nodes, 1 and 2"),
    "no such child": (lambda it: it["nodes"].append({"children": [9]}), r"nodes\[9\] is referred to"),
    "no such mesh": (lambda it: it["nodes"][0].update(mesh=3), r"meshes\[3\] is referred to"),
    "negative mesh": (lambda it: it["nodes"][0].update(mesh=-1), r"nodes\[0\].mesh is missing or damaged"),
    "no such skin": (lambda it: it["nodes"][0].update(skin=0), r"skins\[0\] is referred to"),
    "no joints": (
        lambda it: it.update(skins=[{"joints": []}]) or it["nodes"][0].update(skin=0),
        "has no joints",
    ),
    "no weights": (
        lambda it: it.update(skins=[{"joints": [0]}]) or it["nodes"][0].update(skin=0),
        "has no JOINTS_0 and WEIGHTS_0",
    ),
    "no such joint": (
        lambda it: it.update(skins=[{"joints": [5]}]) or it["nodes"][0].update(skin=0),
        r"nodes\[5\] is referred to",
    ),
    "root below": (
        lambda it: it["nodes"].append({"children": [0]}) or it.update(scenes=[{"nodes": [0]}]),
        r"has nodes\[0\] as a root",
    ),
    "no such scene": (lambda it: it.update(scene=4, scenes=[{}]), r"scenes\[4\]"),
    "count": (
        lambda it: it["accessors"][0].update(count=2**40),
        r"accessors\[0\] has .* more than its 36 bytes",
    ),
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
            sparse={
                "count": 1,
                "indices": {"bufferView": 0, "byteOffset": 12, "componentType": 5125},
                "values": {},
            }
        ),
        "indices go up to 1065353216, but there are 3",
    ),
    "indices": (lambda it: it["meshes"][0]["primitives"][0].update(indices=1), "integers are expected"),
    "mode": (lambda it: it["meshes"][0]["primitives"][0].update(mode="fan"), "mode is missing or damaged"),
    "sampler": (lambda it: it["animations"][0]["channels"][0].update(sampler=5), "has sampler 5 of 1"),
    "interpolation": (
        lambda it: it["animations"][0]["samplers"][0].update(interpolation="BEZIER"),
        "'BEZIER'",
    ),
    "keys": (lambda it: it["accessors"][2].update(count=1), "has 6 values for 1 keys of translation"),
    "times": (lambda it: it["animations"][0]["samplers"][0].update(input=1), "times that do not increase"),
    "matrix": (
        lambda it: it["nodes"][0].update(matrix=np.eye(4).ravel().tolist()),
        "its translation is animated",
    ),
    "short matrix": (lambda it: it["nodes"][0].update(matrix=[1]), "a list of 16 finite numbers"),
    "buffer": (
        lambda it: it.update(bufferViews=[{"buffer": 7, "byteLength": 1}] * 3),
        r"buffers\[7\] is referred",
    ),
    "version": (lambda it: it["asset"].update(version="1.0"), "version 1.0; version 2 is read"),
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


def test_points_that_are_not_finite(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh([[0, 0, 0], [np.inf, 0, 0], [0, 1, 0]]), scale=[0, 1, 1])
    with pytest.raises(InvalidSequenceError, match=r"made.glb: frame 0: vertex 1"):
        made(maker)


def test_keys_that_are_close_within_a_channel(made: Callable[..., MeshSequence]) -> None:
    times = np.array([1, 1 + 2**-22, 2], np.float32)
    assert made(moving(times, np.outer(times, [1, 0, 0]))).times.tolist() == times.tolist()


def test_channels_named_too_often(made: Callable[..., MeshSequence]) -> None:
    times = np.arange(20_000) / 24
    maker = moving(times, np.outer(times, [1, 0, 0]))
    channels = maker.json["animations"][0]["channels"]
    channels *= 500
    with pytest.raises(FormatError, match=r"animations\[0\] have .* repeats"):
        made(maker)


def test_skeletons_named_too_often(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["skins"] = [{"joints": [0] * 2000}]
    maker.json["nodes"] += [{"mesh": 0, "skin": 0}] * 1000
    with pytest.raises(FormatError, match="skeletons of all meshes together have"):
        made(maker)


def test_instances_named_too_often(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(np.arange(6000).reshape(2000, 3), mode=5)
    maker.json["nodes"] = [{"mesh": mesh}] * 2000
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
        (struct.pack("<4sIII4s", b"glTF", 2, 20, 0, b"BIN\0"), "no JSON"),
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


# Creatures whose points others have baked.


def like(baked: NDArray[np.float32], got: MeshSequence) -> NDArray[np.intp]:
    """Return the vertex of `got` at every baked vertex of frame 0."""
    nearest = np.asarray(KDTree(got.points[0]).query(baked[0])[1], dtype=np.intp)
    assert np.unique(nearest).size == got.vertex_count
    return nearest


def sorted_faces(faces: NDArray[np.integer[Any]]) -> list[list[int]]:
    """Return faces that have an area, each from its smallest vertex on, in order."""
    whole = [face for face in faces.tolist() if len(set(face)) == 3]
    return sorted(face[face.index(min(face)) :] + face[: face.index(min(face))] for face in whole)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "animation", "fps", "baked"),
    [
        ("KhronosFox", "Survey", None, "fox_survey"),
        ("KhronosFox", "Run", 48, "fox_run"),
        ("Horse", "AnimalArmature|Gallop", 48, "q_horse_gallop"),
        ("Horse", "AnimalArmature|Eating", 12, "q_horse_eating"),
        ("Wolf", "AnimalArmature|Gallop", 48, "q_wolf_gallop"),
        ("Wolf", "AnimalArmature|Attack", 30, "q_wolf_attack"),
        ("Trex", "Armature|TRex_Run", 30, "q_trex_run"),
        ("RobotExpressive", "Dance", None, "robotexpressive_dance"),
    ],
)
def test_creatures_are_as_others_have_baked_them(
    data: Path, file: str, animation: str, fps: float | None, baked: str
) -> None:
    got = load(data / "gltf" / f"{file}.glb", animation=animation, fps=fps, prim="/")
    with np.load(data / "npz" / f"{baked}.npz") as arrays:
        points, faces = arrays["points"], arrays["faces"]
    assert got.vertex_count == points.shape[1]
    nearest = like(points, got)
    assert sorted_faces(nearest[faces]) == sorted_faces(got.faces)
    # Where the last key is between two frames, others have one more, which holds the last key.
    assert len(points) - got.frame_count in (0, 1)
    diagonal = np.linalg.norm(np.ptp(points[0], axis=0))
    errors = np.linalg.norm(got.points[:, nearest] - points[: got.frame_count], axis=2) / diagonal
    assert errors.max() < 1e-6
    if len(points) > got.frame_count:
        last = load(data / "gltf" / f"{file}.glb", animation=animation).points[-1, nearest]
        assert np.abs(last - points[-1]).max() / diagonal < 1e-6


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "vertices", "frames", "objects"),
    [
        ("CesiumMan", 2338, 49, ["node 0/node 1"]),
        ("RiggedFigure", 130, 2, ["node 0/node 1"]),
        ("RiggedSimple", 96, 3, ["node 0/node 1"]),
    ],
)
def test_other_characters(data: Path, file: str, vertices: int, frames: int, objects: list[str]) -> None:
    got = load(data / "gltf" / f"{file}.glb")
    assert (got.vertex_count, got.frame_count) == (vertices, frames)
    assert [each.path for each in got.objects] == objects
    assert np.linalg.norm(np.ptp(got.points, axis=0), axis=1).max() > 0.01


@pytest.mark.realdata
def test_horns_that_hang_on_a_bone(data: Path) -> None:
    got = load(data / "gltf" / "Stag.glb", animation=0)
    assert [(each.name, each.vertex_count) for each in got.objects] == [("Stag_Horns", 818), ("Stag", 1027)]
    assert got.name == "RootNode"
    # The horns touch the head in all frames.
    horns, body = got.points[:, :818], got.points[:, 818:]
    gaps = [np.linalg.norm(one[:, None] - two, axis=2).min() for one, two in zip(horns, body, strict=True)]
    assert max(gaps) < 0.1


@pytest.mark.realdata
@pytest.mark.parametrize("file", ["RiggedSimple", "RiggedFigure"])
def test_damage_to_real_files(data: Path, tmp_path: Path, file: str) -> None:
    hammer(data / "gltf" / f"{file}.glb", tmp_path / "damaged.glb", 2, 100)
