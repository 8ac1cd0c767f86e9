"""Characters keep their materials and textures through the whole chain: encode, resample, write over the original."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import mixseq
from mixseq.cli import main

pytestmark = pytest.mark.realdata


def run(*arguments: object) -> None:
    result = CliRunner().invoke(main, list(map(str, arguments)), catch_exceptions=False)
    assert result.exit_code == 0, result.output


def test_usd(data: Path, tmp_path: Path) -> None:
    """CesiumMan: a skinned, textured character in a package."""
    from pxr import Usd, UsdGeom, UsdShade

    source, target = data / "usd" / "CesiumMan.usdz", tmp_path / "slow.usdc"
    run("encode", source, tmp_path / "man.h5", "--tolerance", "1e-3", "--space", "vertex", "--quiet")
    run("decode", tmp_path / "man.h5", tmp_path / "same.usdc", "--quiet")
    run("resample", tmp_path / "man.h5", target, "--fps", "30", "--speed", "0.5", "--quiet")

    before, after = (Usd.Stage.Open(str(file)) for file in (source, target))
    path = next(prim for prim in before.Traverse() if UsdGeom.Mesh(prim)).GetPath()
    for name in ("primvars:st", "primvars:st:indices", "faceVertexIndices", "doubleSided"):
        old, new = (stage.GetPrimAtPath(path).GetAttribute(name).Get() for stage in (before, after))
        assert np.array_equal(old, new), name
    materials = [
        UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()[0] for stage in (before, after)
    ]
    assert materials[0].GetPath() == materials[1].GetPath()
    (texture,) = (
        shader.GetInput("file").Get().resolvedPath
        for prim in after.Traverse()
        if (shader := UsdShade.Shader(prim)) and shader.GetInput("file").Get()
    )
    assert texture.startswith(str(source))  # found in the package that the layer lies over

    original, slow = mixseq.read(source), mixseq.read(target)
    assert slow.fps == 30
    np.testing.assert_allclose(
        slow.times[-1] - slow.times[0], 2 * (original.times[-1] - original.times[0]), atol=1.5 / 30
    )
    same = mixseq.read(tmp_path / "same.usdc")
    assert mixseq.compare(original, same).max_error < 1.1e-3


def document(path: Path) -> tuple[dict[str, Any], bytes]:
    content = path.read_bytes()
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def images(path: Path) -> list[bytes]:
    parsed, binary = document(path)
    views = [parsed["bufferViews"][image["bufferView"]] for image in parsed["images"]]
    return [binary[view.get("byteOffset", 0) : view.get("byteOffset", 0) + view["byteLength"]] for view in views]


@pytest.mark.parametrize(("name", "animation"), [("KhronosFox", "Run"), ("CesiumMan", "0")])
def test_gltf(name: str, animation: str, data: Path, tmp_path: Path) -> None:
    source, target = data / "gltf" / f"{name}.glb", tmp_path / "slow.glb"
    model = tmp_path / "model.h5"
    run("encode", source, model, "--animation", animation, "--tolerance", "1e-3", "--space", "vertex", "--quiet")
    run("resample", model, target, "--fps", "30", "--speed", "0.5", "--quiet")

    before, after = document(source)[0], document(target)[0]
    assert before["materials"] == after["materials"]
    assert images(source) == images(target)
    (old,), (new,) = before["meshes"][0]["primitives"], after["meshes"][0]["primitives"]
    assert old["material"] == new["material"]
    assert old["attributes"]["TEXCOORD_0"] == new["attributes"]["TEXCOORD_0"] or "TEXCOORD_0" in new["attributes"]
    assert "JOINTS_0" not in new["attributes"]

    original, slow = mixseq.read(source, animation=animation), mixseq.read(target)
    assert slow.vertex_count == original.vertex_count
    np.testing.assert_array_equal(slow.faces, original.faces)
    assert original.surface.uvs is not None and slow.surface.uvs is not None
    np.testing.assert_allclose(slow.surface.uvs.at_corners, original.surface.uvs.at_corners, atol=1e-6)
    error = slow.points[0].astype(np.float64) - original.points[0]
    assert np.abs(error).max() < 2e-3 * original.diagonal
