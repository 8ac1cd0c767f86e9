"""Skins and morphs as glTF: what is in the file, and what readers make of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError
from mixseq.rigging.rigs import Morph, Skin, rotation_matrices
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.decoding import quarter_times, straight_blocks
from mixseq_io.gltf.new_document import size_with_frame_targets
from mixseq_io.rig_arrays import four_influences
from mixseq_io.rig_files import measure_file_between, measure_rig_file, write_measured_rig
from tests.formats.conftest import dressed, lossy
from tests.formats.gltf_files import Gltf, read, validate
from tests.formats.rig_maker import AXES, QUARTER, carried, hinge, random_skin, swelling
from tests.meshes import bar, bent, coarse_walk, rotation


def written(path: Path, rig: Skin | Morph) -> Gltf:
    mixseq.write_rig(path, rig)
    return Gltf(path)


def channels(file: Gltf) -> dict[tuple[str, str], NDArray[Any]]:
    """Return the values of every channel by the name of its node and its path."""
    (animation,) = file.json["animations"]
    assert {each["interpolation"] for each in animation["samplers"]} == {"LINEAR"}
    return {
        (file.json["nodes"][each["target"]["node"]]["name"], each["target"]["path"]): file.accessor(
            animation["samplers"][each["sampler"]]["output"]
        )
        for each in animation["channels"]
    }


# Skins ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_hinge_comes_back_as_it_bends(tmp_path: Path, suffix: str) -> None:
    skin = hinge()
    mixseq.write_rig(tmp_path / f"a{suffix}", skin)
    back = read(tmp_path / f"a{suffix}")
    expected = [bent(skin.rest, angle) for angle in np.linspace(0, QUARTER, 4)]
    np.testing.assert_allclose(back.points, expected, atol=1e-6)
    np.testing.assert_array_equal(back.times, skin.header.times)
    np.testing.assert_array_equal(back.faces, skin.header.faces)
    assert (back.name, back.fps) == ("bar", 10)


def test_of_a_hinge_only_the_hinge_is_animated(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", hinge())
    tracks = channels(file)
    assert set(tracks) == {("upper", "rotation")}
    for angle, turn in zip(np.linspace(0, QUARTER, 4), tracks["upper", "rotation"], strict=True):
        expected = rotation((angle, 0, 0)) @ rotation_matrices(AXES)
        np.testing.assert_allclose(rotation_matrices(turn), expected, atol=1e-6)
    (animation,) = file.json["animations"]
    assert (animation["name"], animation["extras"]) == ("bar", {"fps": 10.0})
    np.testing.assert_array_equal(
        file.accessor(animation["samplers"][0]["input"]), np.array([0, 0.1, 0.2, 0.3], np.float32)
    )


def test_joints_are_a_tree_with_their_names_and_axes(tmp_path: Path) -> None:
    file = written(tmp_path / "a.glb", hinge())
    nodes = file.json["nodes"]
    (skin,) = file.json["skins"]
    lower, upper = (nodes[joint] for joint in skin["joints"])
    assert [lower["name"], upper["name"]] == ["lower", "upper"]
    assert [nodes[child]["name"] for child in nodes[skin["skeleton"]]["children"]] == ["lower"]
    assert [nodes[child]["name"] for child in lower["children"]] == ["upper"]
    assert "children" not in upper
    assert upper["translation"] == [0, 0, 2]
    binds = file.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
    at_rest = np.eye(4)
    at_rest[:3, :3], at_rest[:3, 3] = rotation_matrices(AXES), [0, 0, 2]
    np.testing.assert_allclose(binds[1] @ at_rest, np.eye(4), atol=1e-6)


def test_a_child_that_leaves_its_joint_has_a_track_of_that(tmp_path: Path) -> None:
    skin = hinge()
    away = np.array(skin.translations)
    away[:, 1, 0] += [0, 0.5, 0.25, 0]
    file = written(tmp_path / "a.glb", replace(skin, translations=away))
    tracks = channels(file)
    assert set(tracks) == {("upper", "rotation"), ("upper", "translation")}
    np.testing.assert_allclose(tracks["upper", "translation"], away[:, 1], atol=1e-6)


def test_children_of_a_joint_that_moves_stand_still_in_its_axes(tmp_path: Path) -> None:
    skin = carried(hinge())
    file = written(tmp_path / "a.glb", skin)
    assert set(channels(file)) == {("lower", "rotation"), ("lower", "translation")}
    np.testing.assert_allclose(read(tmp_path / "a.glb").points, skin.points(), atol=1e-6)


def test_between_keys_bones_turn_on_arcs(tmp_path: Path) -> None:
    skin = hinge(frames=2)
    mixseq.write_rig(tmp_path / "a.glb", skin)
    half_way = read(tmp_path / "a.glb", fps=20).points[1]
    np.testing.assert_allclose(half_way, bent(skin.rest, QUARTER / 2), atol=1e-6)


def test_correctives_move_the_rest_shape_before_the_bones_do(tmp_path: Path) -> None:
    skin = hinge(targets=3)
    file = written(tmp_path / "a.glb", skin)
    np.testing.assert_allclose(read(tmp_path / "a.glb").points, skin.points(), atol=1e-6)
    weights = channels(file)["bar", "weights"].reshape(4, 3)
    np.testing.assert_array_equal([weights.min(axis=0), weights.max(axis=0)], [[0] * 3, [1] * 3])  # as sliders have
    mesh = file.json["meshes"][0]
    assert mesh["extras"]["targetNames"] == ["mode_00", "mode_01", "mode_02"]
    np.testing.assert_array_equal(np.float32(mesh["weights"]), weights[0])


def test_a_skin_of_many_objects_and_materials(tmp_path: Path) -> None:
    sequence = dressed()
    skin = random_skin(sequence)
    with lossy():
        file = written(tmp_path / "a.glb", skin)
    np.testing.assert_allclose(read(tmp_path / "a.glb", prim="/").points, skin.points(), atol=1e-5)
    assert len(file.json["skins"]) == 1
    assert [file.node(name)["skin"] for name in ("body", "coat")] == [0, 0]
    roots = file.json["scenes"][0]["nodes"]
    assert all(file.json["nodes"].index(file.node(name)) in roots for name in ("body", "coat"))
    assert [each["name"] for each in file.json["materials"]] == ["skin", "cloth"]
    assert "TEXCOORD_0" in file.primitives("coat")[0]["attributes"]


@pytest.mark.parametrize(("bones", "dtype"), [(256, np.uint8), (257, np.uint16)])
def test_numbers_of_bones_are_as_short_as_can_be(tmp_path: Path, bones: int, dtype: type) -> None:
    skin = random_skin(bar(frames=2), bones, targets=0)
    file = written(tmp_path / "a.glb", skin)
    assert file.attribute("bar", "JOINTS_0").dtype == dtype
    np.testing.assert_allclose(read(tmp_path / "a.glb").points, skin.points(), atol=1e-5)


def test_a_bone_occurs_once_per_vertex_and_weights_add_to_one() -> None:
    skin = random_skin(bar(frames=1), bones=3)
    weights = np.tile([0.2, 0.3, 0.1, 0.4], (len(skin.rest), 1))
    weights[0] = [1 / 3, 1 / 3, 1 / 3, 0]
    weights[1] = [1e-60, 1 - 1e-60, 0, 0]
    influences = np.tile([2, 1, 1, 2], (len(skin.rest), 1))
    influences[0] = [2, 1, 0, 2]
    joint, weight = four_influences(replace(skin, weights=weights, influences=influences))
    assert (joint[0].tolist(), joint[1].tolist(), joint[2].tolist()) == ([2, 1, 0, 0], [1, 0, 0, 0], [2, 1, 0, 0])
    np.testing.assert_allclose(weight[2], [0.6, 0.4, 0, 0], rtol=1e-6)
    assert np.abs(weight.sum(axis=1, dtype=np.float64) - 1).max() < 1e-7
    assert weight[1].tolist() == [1, 0, 0, 0]


def test_a_skin_stands_upright_and_in_metres(tmp_path: Path) -> None:
    skin = hinge(up_axis="Z", metres_per_unit=0.5)
    with pytest.warns(MixseqWarning, match="in 0.5 metres per unit with Z up, under a node"):
        file = written(tmp_path / "a.glb", skin)
    upright = 0.5 * skin.points()[..., [0, 2, 1]] * [1, 1, -1]
    np.testing.assert_allclose(read(tmp_path / "a.glb").points, upright, atol=1e-6)
    assert set(file.node("bar")) == {"name", "mesh", "skin"}  # its transform would be ignored
    sequence = MeshSequence.from_header(skin.header, skin.points())
    assert measure_rig_file(tmp_path / "a.glb", sequence).max_error < 1e-6
    larger = sequence.with_points(1.1 * sequence.points)
    expected = 0.1 * np.linalg.norm(sequence.points, axis=2).max() / larger.diagonal
    assert measure_rig_file(tmp_path / "a.glb", larger).max_error == pytest.approx(expected, rel=1e-5)


def test_joints_turn_on_arcs_between_keys(tmp_path: Path) -> None:
    """Points are in half metres with Z up, and distances are in these units."""
    skin = hinge(up_axis="Z", metres_per_unit=0.5)
    with pytest.warns(MixseqWarning, match="under a node"):
        written(tmp_path / "a.glb", skin)
    sequence = MeshSequence.from_header(skin.header, skin.points())
    times = quarter_times(skin.header.times)
    arcs, chords = skin.resampled(times).points(), np.concatenate(list(straight_blocks(sequence.blocks(), times)))
    expected = np.linalg.norm(arcs - chords, axis=2).max()
    assert measure_file_between(tmp_path / "a.glb", skin.header, lambda _: [arcs]) == pytest.approx(0, abs=1e-5)
    found = measure_file_between(tmp_path / "a.glb", skin.header, lambda _: [chords])
    assert found == pytest.approx(expected, rel=1e-4)


def test_a_skin_that_stands_still_has_no_animation(tmp_path: Path) -> None:
    skin = hinge(frames=2)
    still = replace(skin, rotations=skin.rotations[[1, 1]])
    file = written(tmp_path / "a.glb", still)
    assert "animations" not in file.json
    np.testing.assert_allclose(read(tmp_path / "a.glb").points[0], bent(skin.rest, QUARTER), atol=1e-6)
    assert measure_rig_file(tmp_path / "a.glb", MeshSequence.from_header(still.header, still.points())).max_error < 1e-6


@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.usdc", "a.usdz"])
def test_a_rig_that_rounding_moves_beyond_its_bound_replaces_no_file(name: str, tmp_path: Path) -> None:
    skin, file = hinge(), tmp_path / name
    sequence = MeshSequence.from_header(skin.header, skin.points())
    error = write_measured_rig(file, skin, sequence, 1e-6).max_error
    before = file.read_bytes()
    with pytest.raises(OutputError, match=f"{name}: rounding .*, more than 1e-12, so nothing is written; give a larg"):
        write_measured_rig(file, skin, sequence, 1e-12)
    assert 1e-12 < error < 1e-6
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {name: before}
    further = sequence.with_points(sequence.points + 0.1)
    assert write_measured_rig(file, skin, further, 1e-12).max_error > 0.01  # the fit had no such bound, and says so


# Morphs ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_morph_comes_back(tmp_path: Path, suffix: str) -> None:
    morph = swelling()
    file = written(tmp_path / f"a{suffix}", morph)
    back = read(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(back.points, morph.points(), atol=1e-6)
    np.testing.assert_array_equal(channels(file)["bar", "weights"], [0.5, 1, 0.5, 0])
    (target,) = file.primitives("bar")[0]["targets"]
    np.testing.assert_allclose(file.accessor(target["POSITION"]), 3 * morph.base * [1, 0, 0], atol=1e-6)


def test_targets_whose_weights_never_change_are_in_the_base(tmp_path: Path) -> None:
    morph = swelling()
    more = replace(
        morph, targets=np.repeat(morph.targets, 2, axis=0), weights=np.append(morph.weights, 0 * morph.weights, axis=1)
    )
    assert len(written(tmp_path / "a.glb", more).primitives("bar")[0]["targets"]) == 1
    held = replace(more, weights=np.append(morph.weights, 0 * morph.weights + 0.5, axis=1))
    assert len(written(tmp_path / "c.glb", held).primitives("bar")[0]["targets"]) == 1
    np.testing.assert_allclose(read(tmp_path / "c.glb").points, held.points(), atol=1e-6)
    none = replace(morph, targets=morph.targets[:0], weights=morph.weights[:, :0])
    file = written(tmp_path / "b.glb", none)
    assert "targets" not in file.primitives("bar")[0]
    assert "animations" not in file.json


def test_normals_of_targets_come_close_to_those_of_the_frames(tmp_path: Path) -> None:
    from mixseq.mesh.measures import corner_normals

    morph = swelling()
    file = written(tmp_path / "a.glb", replace(morph, weights=morph.weights * [[0], [1], [0], [0.0]]))
    truth = corner_normals(morph.points(), morph.header.polygons)
    np.testing.assert_allclose(file.attribute("bar", "NORMAL"), truth[0], atol=1e-6)
    np.testing.assert_allclose(file.played("bar", 0.1, "NORMAL"), truth[1], atol=1e-5)


def test_a_morph_of_many_objects_and_materials(tmp_path: Path) -> None:
    sequence = dressed()
    rng = np.random.default_rng(5)
    morph = Morph(sequence.header, rng.normal(size=(12, 3)), rng.normal(size=(2, 12, 3)), rng.normal(size=(5, 2)))
    with lossy():
        mixseq.write_rig(tmp_path / "a.glb", morph)
    np.testing.assert_allclose(read(tmp_path / "a.glb", prim="/").points, morph.points(), atol=1e-5)


# Both -----------------------------------------------------------------------------------------------------


def test_errors_are_those_of_the_file(tmp_path: Path) -> None:
    skin = hinge()
    mixseq.write_rig(tmp_path / "a.glb", skin)
    truth = MeshSequence.from_header(skin.header, skin.points())
    moved = np.array(truth.points)
    moved[2, 7] += [0, 0.3, 0.4]
    diagonal = np.linalg.norm(np.ptp(skin.rest, axis=0))
    found = measure_rig_file(tmp_path / "a.glb", truth.with_points(moved))
    assert found.max_error == pytest.approx(0.5 / diagonal, rel=1e-5)
    assert found.rms_error == pytest.approx(0.5 / diagonal / np.sqrt(moved.size / 3), rel=1e-4)
    spread = np.linalg.norm(moved - moved.mean(axis=1, keepdims=True))
    assert found.kg_percent == pytest.approx(50 / spread, rel=1e-4)


def test_the_size_of_all_frames_is_told_without_writing_them(tmp_path: Path) -> None:
    sequence = bar(sides=30, rings=60)
    mixseq.write(tmp_path / "a.glb", sequence)
    assert size_with_frame_targets(sequence.header) == pytest.approx((tmp_path / "a.glb").stat().st_size, rel=2e-3)


def test_pygltflib_and_trimesh_load_them(tmp_path: Path) -> None:
    import pygltflib
    import trimesh

    rigs: dict[str, Skin | Morph] = {"skin": hinge(targets=2), "morph": swelling()}
    for name, rig in rigs.items():
        mixseq.write_rig(tmp_path / f"{name}.glb", rig)
        file = pygltflib.GLTF2().load(str(tmp_path / f"{name}.glb"))
        assert len(file.animations) == 1
        assert bool(file.skins) == (name == "skin")
        (mesh,) = trimesh.load_scene(tmp_path / f"{name}.glb", process=False).geometry.values()
        assert len(mesh.faces) == len(rig.header.faces)


@pytest.mark.parametrize("name", ["a.abc", "a.h5", "a"])
def test_other_names_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=r"written as glTF or USD; end the name in \.glb, .* or \.usdz"):
        mixseq.write_rig(tmp_path / name, swelling())
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_rig_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="write_rig: rig is of type MeshSequence; Skin or Morph is expected"):
        mixseq.write_rig(tmp_path / "a.glb", bar())  # type: ignore[arg-type]


def test_too_many_bones_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"65536 bones, glTF allows 65535; fit it with fewer"):
        mixseq.write_rig(tmp_path / "a.glb", random_skin(bar(frames=1), bones=65536, targets=0))
    assert list(tmp_path.iterdir()) == []


def test_what_is_too_large_for_float32_is_refused_and_an_old_file_stays(tmp_path: Path) -> None:
    (tmp_path / "a.glb").write_bytes(b"somebody's work")
    skin, morph = hinge(targets=1), swelling()
    refused: list[tuple[Skin | Morph, str]] = [
        (replace(skin, rest=skin.rest * 1e39), "vertex 0"),
        (replace(skin, skeleton=replace(skin.skeleton, pivots=skin.pivots * 1e39)), "the pivot of bone 1"),
        (replace(skin, translations=skin.translations * 1e39), "bone 1"),
        (replace(morph, targets=1e39 * morph.targets, weights=abs(morph.weights)), "a target of vertex 0"),
        (replace(morph, header=morph.header.with_times([0, 1e6, 1e6 + 1e-3, 2e6])), "frames 1 and 2 are at"),
    ]
    for rig, words in refused:
        with pytest.raises(InvalidSequenceError, match=words):
            mixseq.write_rig(tmp_path / "a.glb", rig)
        assert [each.read_bytes() for each in tmp_path.iterdir()] == [b"somebody's work"]


def test_the_same_rig_is_the_same_file(tmp_path: Path) -> None:
    for one, other in itertools.pairwise([written(tmp_path / f"{i}.glb", hinge(targets=2)) for i in range(2)]):
        assert (one.json, one.buffer) == (other.json, other.buffer)


def test_the_validator_passes_them(tmp_path: Path) -> None:
    fox = coarse_walk(frames=3)
    rigs: dict[str, Skin | Morph] = {
        "hinge": hinge(targets=2),
        "still": hinge(frames=1),
        "dressed": random_skin(dressed()),
        "many": random_skin(bar(frames=2), 300),
        "fox": random_skin(fox),
        "swelling": swelling(),
        "upright": hinge(up_axis="Z", metres_per_unit=0.01),
        "turned": replace(hinge(), rotations=np.tile([[[0.0, 0, 1, 0], [0, 0, 0, -1]]], (4, 1, 1))),
    }
    with lossy():
        for name, rig in rigs.items():
            for suffix in (".glb", ".gltf"):
                mixseq.write_rig(tmp_path / f"{name}{suffix}", rig)
    validate(*sorted(tmp_path.iterdir()))


@pytest.mark.realdata
def test_a_real_morph_keeps_its_bound_and_passes_the_validator(tmp_path: Path, data: Path) -> None:
    wolf = mixseq.read(data / "npz" / "q_wolf_gallop.npz")
    mixseq.write_rig(tmp_path / "wolf.glb", mixseq.fit_morph(wolf, max_error=0.01))
    assert measure_rig_file(tmp_path / "wolf.glb", wolf).max_error <= 0.010001
    assert (tmp_path / "wolf.glb").stat().st_size < size_with_frame_targets(wolf.header)
    validate(tmp_path / "wolf.glb")


def test_a_turned_bone_takes_the_mesh_along(tmp_path: Path) -> None:
    """Against matrices, without any formula of skins."""
    skin = hinge(frames=1)
    turn = rotation((0.0, 0.0, np.pi))
    whole = replace(
        skin, rotations=np.array([[[0, 0, 1.0, 0], [0, 0, 1.0, 0]]]), translations=np.array([[[1.0, 2, 3], [1, 2, 5]]])
    )
    mixseq.write_rig(tmp_path / "a.glb", whole)
    np.testing.assert_allclose(read(tmp_path / "a.glb").points[0], skin.rest @ turn.T + [1, 2, 3], atol=1e-6)
