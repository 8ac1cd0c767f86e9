"""Texture coordinates that a material transforms, in closed form."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import FormatError
from tests.formats.gltf_maker import TRIANGLE, Maker, load

pytestmark = pytest.mark.slow

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
