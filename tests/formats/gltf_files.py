"""For the tests of glTF's writer: another, small reader, a rigged and textured file, the validator."""

from __future__ import annotations

import base64
import json
import os
import shutil
import struct
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.sequence.sequence import MeshSequence, join_blocks
from mixseq_io.gltf.reader import open_gltf
from mixseq_io.gltf.writer import write_gltf

Json = dict[str, Any]
IMAGE = b"\x89PNG\r\n\x1a\n of a fox"


class Gltf:
    """A file's document, and the numbers in its buffer."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        if path.suffix == ".glb":
            _, _, length, room, kind = struct.unpack("<4sIII4s", content[:20])
            assert (length, kind) == (len(content), b"JSON")
            self.json: Json = json.loads(content[20 : 20 + room])
            size, kind = struct.unpack("<I4s", content[20 + room : 28 + room])
            assert (room % 4, size % 4, kind, 28 + room + size) == (0, 0, b"BIN\0", len(content))
            self.buffer = content[28 + room :][: self.json["buffers"][0]["byteLength"]]
        else:
            self.json = json.loads(content)
            self.buffer = base64.b64decode(self.json["buffers"][0]["uri"].partition(",")[2], validate=True)
        assert len(self.json["buffers"]) == 1
        assert len(self.buffer) == self.json["buffers"][0]["byteLength"]

    def view(self, number: int) -> bytes:
        view = self.json["bufferViews"][number]
        assert view["byteOffset"] % 4 == 0
        return self.buffer[view["byteOffset"] :][: view["byteLength"]]

    def accessor(self, number: int) -> NDArray[Any]:
        accessor = self.json["accessors"][number]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        dtype = np.dtype({5126: "<f4", 5125: "<u4", 5123: "<u2", 5121: "<u1"}[accessor["componentType"]])
        data = self.view(accessor["bufferView"])[accessor.get("byteOffset", 0) :]
        values = np.frombuffer(data, dtype, accessor["count"] * width).reshape(-1, width)
        if "min" in accessor:
            assert accessor["min"] == values.min(axis=0).tolist()
            assert accessor["max"] == values.max(axis=0).tolist()
        return values[:, 0] if width == 1 else values

    def node(self, name: str) -> Json:
        found: Json = next(each for each in self.json["nodes"] if each.get("name") == name and "mesh" in each)
        return found

    def primitives(self, name: str) -> list[Json]:
        found: list[Json] = self.json["meshes"][self.node(name)["mesh"]]["primitives"]
        return found

    def attribute(self, name: str, attribute: str, primitive: int = 0) -> NDArray[Any]:
        return self.accessor(self.primitives(name)[primitive]["attributes"][attribute])

    def triangles(self, name: str, primitive: int = 0) -> list[list[int]]:
        triangles: list[list[int]] = self.accessor(self.primitives(name)[primitive]["indices"]).reshape(-1, 3).tolist()
        return triangles

    def played(self, name: str, time: float, attribute: str = "POSITION", primitive: int = 0) -> NDArray[Any]:
        """Return an attribute at a time of the last animation, as the specification has it."""
        entry = self.primitives(name)[primitive]
        values = self.accessor(entry["attributes"][attribute]).astype(np.float64)
        animation = self.json["animations"][-1]
        index = self.json["nodes"].index(self.node(name))
        channel = next(each for each in animation["channels"] if each["target"]["node"] == index)
        sampler = animation["samplers"][channel["sampler"]]
        keys = self.accessor(sampler["input"])
        weights = self.accessor(sampler["output"]).reshape(len(keys), -1)
        for column, target in zip(weights.T, entry["targets"], strict=True):
            values = values + np.interp(time, keys, column) * self.accessor(target[attribute])
        return values


def write_glb(path: Path, document: Json, buffer: bytes, others: Sequence[Json] = ()) -> Path:
    """Write a binary file, whose document may have other buffers, too."""
    document = {**document, "buffers": [{"byteLength": len(buffer)}, *others]}
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    buffer += bytes(-len(buffer) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(buffer), b"BIN\0") + buffer
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def rigged() -> tuple[Json, bytes]:
    """Return a file with a square, split into six vertices, that a skeleton of two joints moves for a second.

    The square's node ``body`` is below ``rig``, which stands 10 to the right; below it is a camera. Another mesh,
    ``tree``, stands still. The square has a texture and tangents. Its upper edge is lifted by 0, 1, 3.
    """
    buffer = bytearray()
    views: list[Json] = []
    accessors: list[Json] = []

    def view(data: bytes) -> int:
        buffer.extend(bytes(-len(buffer) % 4))
        views.append({"buffer": 0, "byteOffset": len(buffer), "byteLength": len(data)})
        buffer.extend(data)
        return len(views) - 1

    def accessor(values: Any, dtype: str = "<f4", bounds: bool = False) -> int:
        array = np.array(values, dtype)
        kind = "SCALAR" if array.ndim == 1 else {2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}[array.shape[1]]
        component = {"<f4": 5126, "<u2": 5123, "<u1": 5121}[dtype]
        entry: Json = {"bufferView": view(array.tobytes()), "componentType": component, "count": len(array)}
        if bounds:
            columns = array.reshape(len(array), -1)
            entry.update(min=columns.min(axis=0).tolist(), max=columns.max(axis=0).tolist())
        accessors.append({**entry, "type": kind})
        return len(accessors) - 1

    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]]
    joints = [[0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]
    body = {
        "attributes": {
            "POSITION": accessor(square, bounds=True),
            "NORMAL": accessor([[0, 0, 1]] * 6),
            "TANGENT": accessor([[1, 0, 0, 1]] * 6),
            "TEXCOORD_0": accessor([[0, 1], [1, 1], [1, 0], [0, 0.5], [1, 0.5], [0, 0]]),
            "JOINTS_0": accessor(joints, "<u1"),
            "WEIGHTS_0": accessor([[1, 0, 0, 0]] * 6),
        },
        "indices": accessor([0, 1, 2, 3, 4, 5], "<u2"),
        "material": 0,
    }
    tree = {"attributes": {"POSITION": accessor([[5, 0, 0], [6, 0, 0], [5, 3, 0]], bounds=True)}}
    inverse = accessor([np.eye(4).reshape(16)] * 2)
    keys = accessor([0, 0.5, 1], bounds=True)
    lift = accessor([[0, 0, 0], [0, 0, 1], [0, 0, 3]])
    document: Json = {
        "asset": {"version": "2.0", "copyright": "nobody", "generator": "by hand"},
        "scene": 0,
        "scenes": [{"nodes": [0, 5]}],
        "nodes": [
            {"name": "rig", "translation": [10, 0, 0], "children": [1, 2]},
            {"name": "body", "mesh": 0, "skin": 0, "children": [4], "extras": {"note": "keep"}},
            {"name": "hip", "children": [3]},
            {"name": "chest"},
            {"name": "eye", "camera": 0, "translation": [0, 0, 9]},
            {"name": "tree", "mesh": 1},
        ],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}],
        "meshes": [{"name": "square", "primitives": [body]}, {"name": "trunk", "primitives": [tree]}],
        "skins": [{"joints": [2, 3], "inverseBindMatrices": inverse}],
        "materials": [{"name": "fur", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071}],
        "images": [{"name": "fox", "mimeType": "image/png", "bufferView": view(IMAGE)}],
        "animations": [
            {
                "name": "nod",
                "channels": [{"sampler": 0, "target": {"node": 3, "path": "translation"}}],
                "samplers": [{"input": keys, "output": lift}],
            }
        ],
        "accessors": accessors,
        "bufferViews": views,
    }
    return document, bytes(buffer)


def written(path: Path, sequence: MeshSequence, **options: Any) -> Gltf:
    write_gltf(path, sequence.header, [sequence.points], **options)
    return Gltf(path)


def read(path: Path, **options: Any) -> MeshSequence:
    with open_gltf(path, **options) as reader:
        return join_blocks(reader.header, reader.blocks())


def validate(*files: Path) -> None:
    """Have Khronos' validator look at files; it must find no errors, and nothing to warn of."""
    if not os.environ.get("MIXSEQ_GLTF_VALIDATOR") or not shutil.which("node"):
        pytest.skip("MIXSEQ_GLTF_VALIDATOR is not set, or there is no node")
    script = Path(__file__).parents[2] / "scripts" / "validate-gltf"
    result = subprocess.run(["node", script, *files], capture_output=True, text=True, check=False)
    assert (result.stdout, result.stderr, result.returncode) == ("", "", 0)
