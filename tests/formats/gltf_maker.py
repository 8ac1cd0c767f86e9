"""For the tests of glTF's reader: files made number by number."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.sequence.sequence import MeshSequence, join_blocks
from mixseq_io.gltf.reader import open_gltf

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
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": values.nbytes})
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


def load(path: Path, **options: Any) -> MeshSequence:
    with open_gltf(path, **options) as reader:
        return join_blocks(reader.header, reader.blocks(3))


def moving(times: Any = (0, 1), values: Any = ((0, 0, 0), (2, 0, 0)), how: str = "") -> Maker:
    """Return a triangle whose node moves."""
    maker = Maker()
    node = maker.node("body", mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "translation", times, values, how)
    return maker


def skinned(weights: Any, joints: Any, dtype: str = "f4", **more: Any) -> Maker:
    """Return a triangle on two joints; the second stands at x = 1 and turns by a quarter about z."""
    maker = Maker()
    on = {"JOINTS_0": maker.add(joints, "u1"), "WEIGHTS_0": maker.add(weights, dtype, **more)}
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 0, 3] = -1
    second = maker.node("second", translation=[1, 0, 0])
    first = maker.node("first", children=[second])
    maker.node("body", mesh=maker.mesh([[2, 0, 0], [2, 1, 0], [0, 1, 0]], on=on), skin=0, translation=[100, 0, 0])
    inverse = maker.add(binds.transpose(0, 2, 1).reshape(2, 16))
    maker.json["skins"] = [{"joints": [first, second], "inverseBindMatrices": inverse}]
    maker.animate(second, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, np.sqrt(0.5), np.sqrt(0.5)]])
    return maker


JOINTS = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]]


def morphing(**more: Any) -> Maker:
    maker = Maker()
    targets = [{"POSITION": maker.add([[0, 0, 1]] * 3)}, {"POSITION": maker.add([[0, 0, 0], [4, 0, 0], [0, 0, 0]])}]
    maker.node("face", mesh=maker.mesh(TRIANGLE, targets=targets), **more)
    return maker


def split_square(**second: Any) -> Maker:
    """Return a square of two triangles that share no vertex, one per primitive."""
    maker = Maker(materials=[{"name": "red"}, {}])
    uvs = maker.add([[0, 0], [1, 0], [1, 0.25]])
    mesh = maker.mesh([SQUARE[0], SQUARE[1], SQUARE[2]], on={"TEXCOORD_0": uvs}, material=0)
    maker.mesh([SQUARE[0], SQUARE[2], SQUARE[3]], **second)
    maker.json["meshes"][mesh]["primitives"] += maker.json["meshes"].pop()["primitives"]
    maker.node("square", mesh=mesh)
    return maker
