"""For the tests of compressed glTF: a tube that bends, and what other programs made of it.

``packed/tube.glb`` is made by ``python -m tests.formats.gltf.packed_files``; `MADE` has the commands that made the
others of it, with gltfpack 1.3 and gltf-transform 4.5.1.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from tests.formats.gltf_maker import Maker

FOLDER = Path(__file__).with_name("packed")
MADE = {
    "gltfpack-ext": "gltfpack -i tube.glb -o gltfpack-ext.glb -c -ce ext -kn",
    "gltfpack-khr": "gltfpack -i tube.glb -o gltfpack-khr.glb -cc -ce khr -kn",
    "gltfpack-floats": "gltfpack -i tube.glb -o gltfpack-floats.glb -c -ce ext -kn -vpf -vtf -vnf",
    "meshopt": "gltf-transform meshopt tube.glb meshopt.glb",
    "quantized": "gltf-transform quantize tube.glb quantized.glb",
    "draco": "gltf-transform draco tube.glb draco.glb",
}
_RINGS, _SIDES = 9, 12


def tube() -> Maker:
    """Return a tube along y on two joints, with colours, and texture coordinates from 0 to 3."""
    ring, side = np.meshgrid(np.arange(_RINGS), np.arange(_SIDES + 1), indexing="ij")
    angle = 2 * np.pi * (side % _SIDES) / _SIDES
    height = ring / (_RINGS - 1)
    points = np.stack([np.cos(angle), 4 * height, np.sin(angle)], axis=2).reshape(-1, 3)
    normals = points * [1, 0, 1]
    corner = np.arange(_RINGS * (_SIDES + 1)).reshape(_RINGS, _SIDES + 1)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3)
    upper = height.reshape(-1)
    maker = Maker()
    image = np.frombuffer(_png(), np.uint8)
    maker.json["images"] = [{"mimeType": "image/png", "bufferView": maker.view(image)}]
    maker.json["textures"] = [{"source": 0}]
    maker.json["materials"] = [{"name": "skin", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    on = {
        "NORMAL": maker.add(normals),
        "TEXCOORD_0": maker.add(np.stack([3 * side / _SIDES, height], axis=2).reshape(-1, 2)),
        "COLOR_0": maker.add(np.stack([upper, 1 - upper, 0.5 + 0 * upper], axis=1)),
        "JOINTS_0": maker.add(np.tile([0, 1, 0, 0], (len(points), 1)), "u1"),
        "WEIGHTS_0": maker.add(np.stack([1 - upper, upper, 0 * upper, 0 * upper], axis=1)),
    }
    mesh = maker.mesh(points, faces, on=on, material=0)
    position = maker.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    maker.json["accessors"][position].update(min=points.min(axis=0).tolist(), max=points.max(axis=0).tolist())
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -2
    second = maker.node("second", translation=[0, 2, 0])
    first = maker.node("first", children=[second])
    body = maker.node("tube", mesh=mesh, skin=0)
    inverse = maker.add(binds.transpose(0, 2, 1).reshape(2, 16))
    maker.json["skins"] = [{"joints": [first, second], "inverseBindMatrices": inverse}]
    turn = np.pi / 4 * np.linspace(0, 1, 5)
    quaternions = np.stack([0 * turn, 0 * turn, np.sin(turn / 2), np.cos(turn / 2)], axis=1)
    times = np.arange(5) / 4
    maker.animate(second, "rotation", times, quaternions)
    keys = maker.json["animations"][0]["samplers"][0]["input"]
    maker.json["accessors"][keys].update(min=[0], max=[1])
    maker.json.update(scene=0, scenes=[{"nodes": [first, body]}])
    return maker


def _png() -> bytes:
    """Return a picture of one white pixel."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")

    header = (1).to_bytes(4, "big") * 2 + bytes([8, 0, 0, 0, 0])
    pixel = zlib.compress(b"\0\xff")
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixel) + chunk(b"IEND", b"")


if __name__ == "__main__":
    tube().glb(FOLDER / "tube.glb")
