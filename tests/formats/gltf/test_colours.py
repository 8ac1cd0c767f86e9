"""Colours in glTF: the forms that COLOR_0 has, and the one that is written."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.choices import StillName
from mixseq.errors import MixseqWarning
from mixseq.mesh.surface import CornerValues
from mixseq.rigging.fitting import fit_skin
from mixseq.sequence.sequence import MeshSequence
from tests.formats.gltf_files import Gltf, read, validate, written
from tests.formats.gltf_maker import TRIANGLE, Maker, load
from tests.meshes import bar

pytestmark = pytest.mark.slow

RGBA = np.array([[1, 0, 0.2, 0.4], [0, 1, 0, 1], [0.6, 0.8, 1, 0]])


@pytest.mark.parametrize("width", [3, 4])
@pytest.mark.parametrize(("dtype", "largest"), [("f4", 1), ("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("told", [True, False], ids=["normalized", "not told"])
def test_forms(tmp_path: Path, width: int, dtype: str, largest: int, told: bool) -> None:
    maker = Maker()
    more: dict[str, Any] = {"normalized": True} if told and dtype != "f4" else {}
    colours = maker.add(np.rint(RGBA[:, :width] * largest) if largest > 1 else RGBA[:, :width], dtype, **more)
    maker.node("flag", mesh=maker.mesh(TRIANGLE, on={"COLOR_0": colours}))
    found = load(maker.glb(tmp_path / "a.glb")).surface.colours
    assert found is not None
    expected = RGBA if width == 4 else np.column_stack([RGBA[:, :3], np.ones(3)])
    np.testing.assert_array_equal(found.at_corners, expected.astype(np.float32))


def test_primitives_without_colours_are_white(tmp_path: Path) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE, on={"COLOR_0": maker.add(RGBA)})
    maker.json["meshes"][mesh]["primitives"].append({"attributes": {"POSITION": maker.add(TRIANGLE)}})
    maker.node("flags", mesh=mesh)
    found = load(maker.glb(tmp_path / "a.glb")).surface.colours
    assert found is not None
    np.testing.assert_array_equal(found.at_corners[3:], np.ones((3, 4)))


def test_several_sets(tmp_path: Path) -> None:
    maker = Maker()
    on = {"COLOR_0": maker.add(RGBA), "COLOR_1": maker.add(np.ones((3, 4)))}
    maker.node("flag", mesh=maker.mesh(TRIANGLE, on=on))
    path = maker.glb(tmp_path / "a.glb")
    with pytest.warns(MixseqWarning, match="several sets of colours; COLOR_0 is read"):
        found = load(path).surface.colours
    assert found is not None
    np.testing.assert_array_equal(found.at_corners, RGBA.astype(np.float32))


def test_bytes_are_written_as_bytes(tmp_path: Path) -> None:
    sequence = painted_bar()
    file = written(tmp_path / "a.glb", sequence)
    (primitive,) = file.primitives(sequence.name)
    accessor = file.json["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5121, True, "VEC4")
    floats = with_colours(sequence, lambda values: values**2)
    (primitive,) = written(tmp_path / "b.glb", floats).primitives(sequence.name)
    assert (
        Gltf(tmp_path / "b.glb").json["accessors"][primitive["attributes"]["COLOR_0"]]["componentType"]
        == 5126
    )


def with_colours(sequence: MeshSequence, change: Any) -> MeshSequence:
    colours = sequence.surface.colours
    assert colours is not None
    return replace(
        sequence,
        surface=replace(sequence.surface, colours=CornerValues(change(colours.values), colours.indices)),
    )


def painted_bar() -> MeshSequence:
    """A bending bar, painted along its length."""
    sequence = bar(5, 9, 6)
    height = sequence.points[0, :, 0]
    shade = np.rint(255 * (height - height.min()) / np.ptp(height)) / 255
    colours = np.column_stack([shade, 1 - shade, np.zeros_like(shade), np.ones_like(shade)])
    surface = replace(sequence.surface, colours=CornerValues(colours, sequence.polygons.indices))
    return replace(sequence, surface=surface)


@pytest.mark.parametrize("still", ["draco", "plain"])
def test_stills_are_painted(tmp_path: Path, still: StillName) -> None:
    sequence = painted_bar()
    mixseq.save(tmp_path / "a.glb", mixseq.compress(sequence, max_error=0.01), still=still)
    document = Gltf(tmp_path / "a.glb").json
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5121, True, "VEC4")
    validate(tmp_path / "a.glb")


def test_skins_are_painted(tmp_path: Path) -> None:
    sequence = painted_bar()
    for name in ("a.glb", "a.usdc"):
        mixseq.write_rig(tmp_path / name, fit_skin(sequence, bones=2))
        got = mixseq.read(tmp_path / name).surface.colours
        assert got is not None and sequence.surface.colours is not None
        np.testing.assert_array_equal(
            np.unique(got.values, axis=0), np.unique(sequence.surface.colours.values, axis=0)
        )


def test_vertex_animation_textures_are_painted(tmp_path: Path) -> None:
    mixseq.write_vat(tmp_path / "a.vat", painted_bar())
    document = Gltf(next((tmp_path / "a.vat").glob("*.gl*"))).json
    assert "COLOR_0" in document["meshes"][0]["primitives"][0]["attributes"]


def test_the_original_keeps_its_colours(tmp_path: Path) -> None:
    written(tmp_path / "a.glb", painted_bar())
    again = read(tmp_path / "a.glb")
    written(tmp_path / "b.glb", again.with_points(again.points + 1))
    assert Gltf(tmp_path / "b.glb").json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] is not None
    got = read(tmp_path / "b.glb").surface.colours
    assert got is not None and again.surface.colours is not None
    np.testing.assert_array_equal(got.at_corners, again.surface.colours.at_corners)


def test_the_validator_is_content(tmp_path: Path) -> None:
    beyond = with_colours(painted_bar(), lambda values: 2 * values - 0.5)
    files = [tmp_path / f"{name}.glb" for name in ("bytes", "floats", "beyond")]
    written(files[0], painted_bar())
    written(files[1], with_colours(painted_bar(), np.square))
    with pytest.warns(MixseqWarning, match="colours below 0 and above 1"):
        written(files[2], beyond)
    validate(*files)
