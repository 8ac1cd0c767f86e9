"""What shaders make of vertex animation textures, in single precision."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.formats.gltf_files import Gltf
from tests.formats.vat.test_images import unpacked

Json = dict[str, Any]


def told(folder: Path) -> Json:
    found: Json = json.loads((folder / "vat.json").read_text())
    return found


def numbers(folder: Path, name: str) -> NDArray[np.float32]:
    """What a shader makes of the pixels of a texture, in single precision."""
    texture = told(folder)["textures"][name]
    pixels = unpacked((folder / texture["file"]).read_bytes())
    assert pixels.shape[:2] == (texture["height"], texture["width"])
    offset, scale = (np.array(texture[key], np.float32) for key in ("offset", "scale"))
    return np.asarray(offset + scale * (pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)))


def looked_up(folder: Path, name: str, frame: int) -> NDArray[np.float32]:
    """Do what the shaders do, texel by texel: points or normals ``(n, 3)`` of the vertices of the mesh."""
    vat, mesh = told(folder), Gltf(folder / "mesh.glb")
    lookup = np.concatenate(
        [
            mesh.accessor(primitive["attributes"]["TEXCOORD_1"])
            for each in mesh.json["meshes"]
            for primitive in each["primitives"]
        ]
    )
    x, y = np.floor(lookup * [vat["width"], vat["height"]]).astype(int).T
    texels = numbers(folder, name)
    if vat["kind"] == "plain":
        return np.asarray(texels[y + frame * vat["rows"], x])
    parts = unpacked((folder / "points.png").read_bytes())[y, x, 0].astype(int)
    above = 1 if name == "points" else 0
    basis = np.concatenate([texels[y + (j + above) * vat["rows"], x] for j in range(vat["layers"])], axis=1)
    coarse = unpacked((folder / "coefficients.png").read_bytes()).astype(np.float32)
    table = vat["textures"]["coefficients"]
    levels, offset, scale = map(np.float32, (65535, table["offset"], table["scale"]))
    shares = (coarse[frame] + coarse[vat["frames"] + frame] / levels) / levels
    coefficients = (offset + scale * shares).reshape(-1, 4 * vat["layers"], 3)
    return np.asarray(np.einsum("nk,nki->ni", basis, coefficients[parts]))


def vertices_of(folder: Path) -> NDArray[np.int64]:
    mesh = Gltf(folder / "mesh.glb")
    primitives = [primitive for each in mesh.json["meshes"] for primitive in each["primitives"]]
    return np.concatenate([mesh.accessor(each["attributes"]["_VERTEX"]) for each in primitives]).astype(int)
