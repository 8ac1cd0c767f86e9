"""glTF, writing over an original: what else of it moves goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from tests.formats.conftest import lossy
from tests.formats.gltf_files import Gltf, read, validate, written
from tests.formats.gltf_maker import TRIANGLE, Maker

QUARTER = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]


def scene(held: bool = False) -> Maker:
    """A triangle that moves for a second, and a camera that pans; the camera may be held by the triangle's parent."""
    maker = Maker(cameras=[{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}])
    body = maker.node("body", mesh=maker.mesh(TRIANGLE))
    camera = maker.node("camera", camera=0)
    rig = maker.node("rig", children=[body, camera] if held else [body])
    maker.json["scenes"] = [{"nodes": [rig] if held else [rig, camera]}]
    maker.animate(rig, "translation", [0, 1], [[0, 0, 0], [4, 0, 0]])
    maker.animate(camera, "rotation", [0, 1], [[0, 0, 0, 1], QUARTER])
    maker.animate(camera, "scale", [0, 0.5], [[1, 1, 1], [2, 2, 2]], "STEP")
    return maker


def at(sequence: MeshSequence, start: float, end: float, frames: int = 5) -> MeshSequence:
    """Return its first frame at so many times."""
    times = np.linspace(start, end, frames)
    points = np.repeat(sequence.points[:1], frames, axis=0)
    return replace(sequence, points=points, times=times, fps=(frames - 1) / (end - start))


def played(file: Gltf, name: str, path: str) -> tuple[list[float], NDArray[Any], str]:
    """Return keys, values and interpolation of a channel."""
    (animation,) = file.json["animations"]
    nodes = file.json["nodes"]
    (channel,) = [
        each
        for each in animation["channels"]
        if nodes[each["target"]["node"]].get("name") == name and each["target"]["path"] == path
    ]
    sampler = animation["samplers"][channel["sampler"]]
    values = file.accessor(sampler["output"])
    return file.accessor(sampler["input"]).tolist(), values, sampler["interpolation"]


def test_a_camera_goes_on_while_its_walker_is_written_anew(tmp_path: Path) -> None:
    sequence = read(scene().glb(tmp_path / "shot.glb"))
    file = written(tmp_path / "new.glb", at(sequence, 0, 1), onto=tmp_path / "shot.glb")
    keys, turns, how = played(file, "camera", "rotation")
    assert (keys, how) == ([0, 0.25, 0.5, 0.75, 1], "LINEAR")
    angles = np.pi / 8 * np.arange(5)
    np.testing.assert_allclose(turns[:, 2:], np.stack([np.sin(angles / 2), np.cos(angles / 2)], axis=1), atol=1e-6)
    _, sizes, how = played(file, "camera", "scale")
    assert (sizes[:, 0].tolist(), how) == ([1, 1, 2, 2, 2], "STEP")
    targets = [each["target"]["path"] for each in file.json["animations"][0]["channels"]]
    assert sorted(targets) == ["rotation", "scale", "weights"]  # the rig carries nothing else that is seen


def test_sections_of_sections_keep_the_time_of_the_shot(tmp_path: Path) -> None:
    sequence = read(scene().glb(tmp_path / "shot.glb"))
    written(tmp_path / "half.glb", at(sequence, 0.5, 1), onto=tmp_path / "shot.glb")
    half = read(tmp_path / "half.glb", prim="body")
    assert half.times[0] == 0.5
    late = at(half, 0.75, 1, 2)
    for original in ("shot.glb", "half.glb"):
        keys, turns, _ = played(written(tmp_path / "late.glb", late, onto=tmp_path / original), "camera", "rotation")
        assert keys == [0, 0.25]
        np.testing.assert_allclose(2 * np.arctan2(turns[:, 2], turns[:, 3]), [3 * np.pi / 8, np.pi / 2], atol=1e-6)


def test_what_stands_still_at_the_end_is_named(tmp_path: Path) -> None:
    sequence = read(scene().glb(tmp_path / "shot.glb"))
    with pytest.warns(MixseqWarning, match=r"keeps its own times, 0 to 1 s, and is not retimed: 'camera'$"):
        file = written(tmp_path / "slow.glb", at(sequence, 0, 4), onto=tmp_path / "shot.glb")
    np.testing.assert_allclose(played(file, "camera", "rotation")[1][1:], [QUARTER] * 4, atol=1e-6)


def test_what_keeps_its_own_speed_is_named(tmp_path: Path) -> None:
    sequence = at(read(scene().glb(tmp_path / "shot.glb")), 0, 1)
    written(tmp_path / "same.glb", sequence, sources=sequence.times)
    with pytest.warns(MixseqWarning, match="not retimed: 'camera'$"):
        written(tmp_path / "back.glb", sequence, sources=sequence.times[::-1])


def test_a_parent_moves_what_else_it_carries_and_not_the_mesh(tmp_path: Path) -> None:
    sequence = read(scene(held=True).glb(tmp_path / "shot.glb"))
    file = written(tmp_path / "new.glb", sequence)
    assert played(file, "rig", "translation")[1].tolist() == [[0, 0, 0], [4, 0, 0]]
    np.testing.assert_array_equal(read(tmp_path / "new.glb").points, sequence.points)


def test_what_hangs_on_the_mesh_moves_with_its_old_node(tmp_path: Path) -> None:
    maker = scene()
    body, camera, rig = (
        next(i for i, each in enumerate(maker.json["nodes"]) if each["name"] == name)
        for name in ("body", "camera", "rig")
    )
    maker.json["nodes"][body]["children"] = [camera]
    maker.json["scenes"] = [{"nodes": [rig]}]
    maker.animate(body, "scale", [0, 1], [[1, 1, 1], [3, 3, 3]])
    sequence = read(maker.glb(tmp_path / "shot.glb"))
    file = written(tmp_path / "new.glb", sequence)
    (channel,) = [
        each["target"]["node"]
        for each in file.json["animations"][0]["channels"]
        if each["target"]["path"] == "scale" and each["target"]["node"] != camera
    ]
    assert file.json["nodes"][channel]["children"] == [camera]
    np.testing.assert_array_equal(read(tmp_path / "new.glb").points, sequence.points)


def test_of_several_animations_nothing_else_moves(tmp_path: Path) -> None:
    maker = scene()
    maker.animate(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], name="dolly")
    maker.glb(tmp_path / "shot.glb")
    with lossy():
        file = written(tmp_path / "new.glb", read(tmp_path / "shot.glb"))
    assert [each["target"]["path"] for each in file.json["animations"][0]["channels"]] == ["weights"]


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
def test_the_validator_passes_what_goes_on(tmp_path: Path, held: bool) -> None:
    written(tmp_path / "new.glb", read(scene(held).glb(tmp_path / "shot.glb")))
    validate(tmp_path / "new.glb")
