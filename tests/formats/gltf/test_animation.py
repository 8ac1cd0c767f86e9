"""glTF files in: what is between the keys of animations, and when frames are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, MixseqWarning, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import read, write
from tests.formats.gltf_maker import JOINTS, SQUARE, TRIANGLE, Maker, morphing, moving, skinned


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
    np.testing.assert_allclose(got.points[1, 1], [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-6)  # by symmetry 45°


def test_normalised_rotations(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    maker.animate(node, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]])
    output = maker.json["animations"][0]["samplers"][0]
    output["output"] = maker.add([[0, 0, 0, 32767], [0, 0, -32767, 0]], "i2", normalized=True)
    np.testing.assert_allclose(made(maker).points[-1, 1], [-1, 0, 0], atol=1e-7)


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
        (np.arange(1001, 1097) / (30 / 1.001), 30000 / 1001),
        (np.arange(1001, 1097) / (60 / 1.001), 60000 / 1001),
        (np.arange(1001, 1097) / (30 * 1.001), 30.03),  # as Blender writes a scene at 30/1.001
        (np.arange(96) / (120 / 1.001), 120000 / 1001),
        (np.arange(2) / (24 / 1.001), 24000 / 1001),
        (np.array([0, 0.1, 0.1333333]), 30),
        (np.array([0, 0.1, 0.137]), 24),
    ],
)
def test_the_rate_is_that_of_the_keys(
    made: Callable[..., MeshSequence], times: NDArray[np.float64], rate: float
) -> None:
    got = made(moving(times, np.outer(times, [1, 0, 0])))
    assert got.fps == pytest.approx(rate, rel=1e-12)
    np.testing.assert_allclose(got.times, times, rtol=1e-7, atol=2e-7)


def test_times_that_nearly_coincide_count_once(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 0.1], [[0, 0, 0], [1, 0, 0]])
    other = maker.node("other", mesh=maker.mesh(TRIANGLE))
    maker.animate(other, "translation", [0, np.nextafter(np.float32(0.1), 1)], [[0, 0, 0], [2, 2, 2]])
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
        MixseqWarning, match="of 2 animations the first, 'walk', is read; the option animation .* 1 'run'"
    ):
        assert made(maker).points[1, 0, 0] == 1
    for wrong in ("fly", 2, -1):
        with pytest.raises(SettingsError, match=r"has no animation .*; there are 0 'walk', 1 'run'"):
            made(maker, animation=wrong)


@pytest.mark.parametrize("fps", [0, -1, np.nan, np.inf])
def test_rates_that_are_none(made: Callable[..., MeshSequence], fps: float) -> None:
    with pytest.raises(SettingsError, match=r"fps is .*; a positive number"):
        made(moving(), fps=fps)


def test_too_many_frames(made: Callable[..., MeshSequence]) -> None:
    with pytest.raises(FormatError, match="too many frames"):
        made(moving([0, 1e30]), fps=24)


def test_animation_pointers_are_warned_about(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["animations"][0]["channels"].append({"sampler": 0, "target": pointer("/cameras/0/zfar")})
    with pytest.warns(MixseqWarning, match="1 channels are left out.*'/cameras/0/zfar'"):
        made(maker)


def pointer(path: str) -> dict[str, object]:
    return {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": path}}}


def test_pointers_at_nodes_are_channels(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 1], [[0, 0, 0], [0, 0, 4]])
    maker.json["animations"][0]["channels"][0]["target"] = pointer("/nodes/0/translation")
    assert made(maker, fps=4).points[:, 1].tolist() == [[1, 0, z] for z in range(5)]


@pytest.mark.parametrize(
    ("path", "own_weights"), [("/nodes/0/weights", {"weights": [0, 0]}), ("/meshes/0/weights", {})]
)
def test_pointers_at_morph_weights_are_channels(
    made: Callable[..., MeshSequence], path: str, own_weights: dict[str, list[float]]
) -> None:
    maker = morphing(**own_weights)
    maker.animate(0, "weights", [0, 1], [[0, 0], [1, 0]])
    maker.json["animations"][0]["channels"][0]["target"] = pointer(path)
    assert made(maker).points[:, :, 2].tolist() == [[0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize("owner", ["nodes", "meshes"])
def test_pointers_at_single_weights_are_channels(made: Callable[..., MeshSequence], owner: str) -> None:
    """The first weight grows in a straight line to .5 in 2 s, the second jumps from .25 to .75 at 1 s."""
    maker = morphing()
    maker.json["meshes"][0]["weights"] = [0.125, 0.25]
    maker.animate(0, "weights", [0, 2], [0, 0.5])
    maker.animate(0, "weights", [0, 1], [0.25, 0.75], "STEP")
    for number, channel in enumerate(maker.json["animations"][0]["channels"]):
        channel["target"] = pointer(f"/{owner}/0/weights/{number}")
    got = made(maker, fps=1)
    np.testing.assert_allclose(got.times, [0, 1, 2])
    np.testing.assert_allclose(got.points[:, 1], [[1 + 4 * w, 0, z] for w, z in ((0.25, 0), (0.75, 0.25), (0.75, 0.5))])
    del maker.json["animations"][0]["channels"][0]  # the first weight stays at .125
    np.testing.assert_allclose(made(maker, fps=1).points[:, 1], [[2, 0, 0.125], [4, 0, 0.125]])


def test_single_weights_of_instances_over_an_original(tmp_path: Path) -> None:
    """The animation of a mesh beside the sequence is written as channels of all its weights."""
    maker = morphing()
    maker.animate(0, "weights", [0, 1], [0, 1])
    maker.json["animations"][0]["channels"][0]["target"] = pointer("/nodes/0/weights/1")
    other = maker.node("other", mesh=0, translation=[0, 5, 0])
    maker.animate(other, "translation", [0, 1], [[0, 5, 0], [0, 6, 0]])
    original = maker.glb(tmp_path / "original.glb")
    moved = read(original, prim="other")
    write(tmp_path / "copy.glb", moved)
    np.testing.assert_allclose(read(tmp_path / "copy.glb", prim="face").points[:, 1], [[1, 0, 0], [5, 0, 0]])
    np.testing.assert_allclose(read(tmp_path / "copy.glb", prim="other").points, moved.points)


def test_a_pointer_at_a_weight_without_target_is_refused(made: Callable[..., MeshSequence]) -> None:
    maker = morphing()
    maker.animate(0, "weights", [0, 1], [0, 1])
    maker.json["animations"][0]["channels"][0]["target"] = pointer("/nodes/0/weights/2")
    with pytest.raises(FormatError, match=r"nodes\[0\] has 2 morph targets, but weight 2 is animated"):
        made(maker)


@pytest.mark.parametrize(
    ("target", "place"),
    [
        ({"node": 7, "path": "translation"}, r"animations\[0\].channels\[1\] \(translation\)"),
        ({"path": "translation"}, r"animations\[0\].channels\[1\] \(translation\)"),
        ({"node": 0, "path": "colour"}, r"animations\[0\].channels\[1\] \(colour\)"),
        (pointer("/nodes/7/translation"), "/nodes/7/translation"),
    ],
)
def test_channels_of_no_node_are_named(
    made: Callable[..., MeshSequence], target: dict[str, object], place: str
) -> None:
    maker = moving()
    maker.json["animations"][0]["channels"].append({"sampler": 0, "target": target})
    with pytest.warns(MixseqWarning, match=f"1 channels are left out.*'{place}'"):
        assert made(maker).points[1, 0].tolist() == [2, 0, 0]


def test_weights_of_a_mesh_that_no_node_uses_are_named(made: Callable[..., MeshSequence]) -> None:
    maker = morphing(weights=[0, 0])
    maker.animate(0, "weights", [0, 1], [[0, 0], [1, 0]])
    maker.json["animations"][0]["channels"][0]["target"] = pointer("/meshes/0/weights")
    with pytest.warns(MixseqWarning, match="1 channels are left out.*'/meshes/0/weights'"):
        made(maker)


def test_instances_are_meshes_below_their_node(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 1], [[0, 0, 0], [0, 0, 4]])
    half = np.sqrt(0.5)
    attributes = {
        "TRANSLATION": maker.add([[0, 0, 0], [5, 0, 0], [10, 0, 0]]),
        "ROTATION": maker.add([[0, 0, 0, 1], [0, 0, half, half], [0, 0, 0, 1]]),  # the second by a quarter about z
        "SCALE": maker.add([[1, 1, 1], [1, 1, 1], [3, 3, 3]]),
    }
    maker.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    maker.json["extensionsRequired"] = maker.json["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    got = made(maker)
    assert [each.path for each in got.objects] == [f"body/instance {k}" for k in range(3)]
    first = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 0, 0], [5, 1, 0], [4, 0, 0], [10, 0, 0], [13, 0, 0], [10, 3, 0]]
    expected = np.array(first, np.float64) + np.array([[[0, 0, 0]], [[0, 0, 4]]])
    np.testing.assert_allclose(got.points, expected, rtol=0, atol=1e-6)


def test_instances_with_attributes_of_their_own_alone(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    maker.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"_ID": maker.add([3.0, 4.0])}}}
    assert made(maker).points[1, ::3].tolist() == [[2, 0, 0], [2, 0, 0]]


def test_damaged_instances_are_left_out(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    attributes = {"TRANSLATION": maker.add([[0, 0, 0], [5, 0, 0]]), "SCALE": maker.add([[1, 1, 1]])}
    maker.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    with pytest.warns(MixseqWarning, match=r"nodes\[0\].* different counts or types.*its instances are left out"):
        assert made(maker).points[1].tolist() == [[2, 0, 0], [3, 0, 0], [2, 1, 0]]


def test_instances_and_pointers_are_written_over_their_original(tmp_path: Path) -> None:
    maker = moving([0, 1], [[0, 0, 0], [0, 0, 4]])
    maker.json["animations"][0]["channels"][0]["target"] = pointer("/nodes/0/translation")
    attributes = {"TRANSLATION": maker.add([[0, 0, 0], [5, 0, 0]])}
    maker.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    maker.json["extensionsUsed"] = ["EXT_mesh_gpu_instancing", "KHR_animation_pointer"]
    original = read(maker.glb(tmp_path / "original.glb"))
    write(tmp_path / "copy.glb", original)  # warnings are errors
    np.testing.assert_array_equal(read(tmp_path / "copy.glb").points, original.points)
    assert original.points[1, 3].tolist() == [5, 0, 4]


def test_instances_morph_together(made: Callable[..., MeshSequence]) -> None:
    maker = morphing()
    maker.animate(0, "weights", [0, 1], [[0, 0], [1, 0]])
    attributes = {"TRANSLATION": maker.add([[0, 0, 0], [0, 0, 7]])}
    maker.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    assert made(maker).points[:, ::3, 2].tolist() == [[0, 7], [1, 8]]


def test_instances_of_skins_are_named(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    attributes = {"TRANSLATION": maker.add([[0, 0, 0], [0, 0, 7]])}
    maker.json["nodes"][2]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    with pytest.warns(MixseqWarning, match=r"nodes\[2\] has a skin; its instances .* are left out"):
        assert made(maker).vertex_count == 3


def test_keys_that_are_close_within_a_channel(made: Callable[..., MeshSequence]) -> None:
    times = np.array([1, 1 + 2**-22, 2], np.float32)
    assert made(moving(times, np.outer(times, [1, 0, 0]))).times.tolist() == times.tolist()


def test_cubic_splines_that_stand_still(made: Callable[..., MeshSequence]) -> None:
    maker = moving()
    still = maker.node("still", mesh=maker.mesh(TRIANGLE))
    keys = np.zeros((2, 3, 3))
    keys[:, 1] = 5
    maker.animate(still, "translation", [0, 1], keys.reshape(-1, 3), "CUBICSPLINE")
    with pytest.warns(MixseqWarning, match="stand still are left out.*'still'"):
        assert [each.name for each in made(maker).objects] == ["body"]
    keys[0, 2, 0] = 1  # a tangent moves it between its keys
    maker.animate(still, "translation", [0, 1], keys.reshape(-1, 3), "CUBICSPLINE")
    assert made(maker).vertex_count == 6


def test_one_key_stands_still(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0.5], [[0, 0, 0], [5, 0, 0], [9, 9, 9]], "CUBICSPLINE")
    got = made(maker)
    assert (got.times.tolist(), got.points[0, 0].tolist()) == ([0.5], [5, 0, 0])


def test_steps_at_a_rate_are_on_the_beat(made: Callable[..., MeshSequence]) -> None:
    """Keys are float32, frames at a rate are not: 0.1 is before its key."""
    numbers = np.arange(11)
    got = made(moving(numbers / 10, np.outer(numbers, [1, 0, 0]), "STEP"), fps=10)
    assert got.points[:, 0, 0].tolist() == numbers.tolist()


@pytest.mark.parametrize("last", [697, 1697])
def test_the_last_frame_of_long_animations(made: Callable[..., MeshSequence], last: int) -> None:
    got = made(moving(np.array([0, last]) / 10, [[0, 0, 0], [1, 0, 0]]), fps=10)
    assert got.frame_count == last + 1


def test_late_times_count_once_if_they_are_the_next_float(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 100], [[0, 0, 0], [1, 0, 0]])
    other = maker.node("other", mesh=maker.mesh(TRIANGLE))
    maker.animate(other, "translation", [0, np.nextafter(np.float32(100), 0)], [[0, 0, 0], [2, 2, 2]])
    assert made(maker).frame_count == 2


def test_a_chosen_animation_is_not_warned_about(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    for name in ("walk", "run"):
        maker.animate(node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], name=name)
    assert made(maker, animation="walk").frame_count == 2  # warnings are errors


def turning(times: NDArray[np.float64], angles: NDArray[np.float64]) -> Maker:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    zero = np.zeros_like(angles)
    maker.animate(node, "rotation", times, np.stack([zero, zero, np.sin(angles / 2), np.cos(angles / 2)], axis=1))
    return maker


@pytest.mark.parametrize(
    ("keys", "told", "frames", "rate"),
    [
        ([0, 1], None, np.arange(25) / 24, 24),
        ([1 / 24, 2 + 1 / 24], None, np.arange(1, 50) / 24, 24),
        ([0, 0.83], None, [*np.arange(20) / 24, 0.83], 24),  # its grid of hundredths is no frame rate
        ([0, 0.5], 8, np.arange(5) / 8, 8),
        ([0.15, 1.25], 4, [0.15, 0.4, 0.65, 0.9, 1.25], 4),  # 1.15 is too close to the last key
    ],
)
def test_a_half_turn_between_two_keys_is_an_arc(
    made: Callable[..., MeshSequence], keys: list[float], told: float | None, frames: list[float], rate: float
) -> None:
    maker = turning(np.array(keys), np.array([0, np.pi]))
    maker.json["animations"][0]["extras"] = {"fps": told}
    got = made(maker)
    assert got.fps == rate
    np.testing.assert_allclose(got.times, frames, rtol=0, atol=1e-7)
    angles = np.pi * (got.times - keys[0]) / (keys[1] - keys[0])
    np.testing.assert_allclose(got.points[:, 1, :2], np.stack([np.cos(angles), np.sin(angles)], 1), atol=2e-6)


def test_gaps_are_filled_and_other_frames_stay(made: Callable[..., MeshSequence]) -> None:
    numbers = np.array([0, 1, 2, 6, 7])
    assert made(turning(numbers / 24, numbers / 4)).times.tolist() == (np.arange(8) / 24).tolist()


def test_nothing_is_added_where_points_move_straight(made: Callable[..., MeshSequence]) -> None:
    maker = moving([0, 1], [[0, 0, 0], [1, 0, 0]])
    maker.animate(0, "rotation", [0, 1], [[0, 0, 0, 1]] * 2)
    assert made(maker).times.tolist() == [0, 1]


@pytest.mark.parametrize("how", ["STEP", "CUBICSPLINE"])
def test_steps_and_splines_are_filled(made: Callable[..., MeshSequence], how: str) -> None:
    values = np.zeros((2, 3, 3))
    values[1, 1, 0] = 1
    got = made(moving([0, 1], values[:, 1] if how == "STEP" else values.reshape(-1, 3), how))
    s = got.times if how == "CUBICSPLINE" else got.times // 1
    assert got.frame_count == 25
    np.testing.assert_allclose(got.points[:, 0, 0], 3 * s**2 - 2 * s**3, atol=1e-6)


def test_not_too_many_frames_are_added(made: Callable[..., MeshSequence]) -> None:
    assert made(turning(np.array([0, 1e30]), np.array([0, 1]))).frame_count == 2


def test_times_on_the_grid_are_exact(made: Callable[..., MeshSequence]) -> None:
    times = np.append(np.arange(50) / 48, 1.03)
    got = made(moving(times, np.outer(times, [1, 0, 0])), fps=48)
    assert got.times.tolist() == (np.arange(50) / 48).tolist()
    maker = moving(times, np.outer(times, [1, 0, 0]))
    maker.json["animations"][0]["extras"] = {"fps": 48}
    got = made(maker)
    assert got.times.tolist() == [*(np.arange(50) / 48), np.float32(1.03)]
    assert got.points[:, 0, 0].tolist() == times.astype(np.float32).tolist()  # at the keys


def test_no_animation_is_the_pose_of_the_nodes(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE), translation=[0, 7, 0])
    maker.animate(node, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]], name="Walk")
    still = made(maker, animation="none")
    assert (still.frame_count, still.points[0, 0].tolist()) == (1, [0, 7, 0])
    maker.animate(node, "translation", [0, 1, 2], [[0, 0, 0], [1, 0, 0], [2, 0, 0]], name="none")
    assert made(maker, animation="none").frame_count == 3


def test_an_animation_by_the_end_of_its_name(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    node = maker.node(mesh=maker.mesh(TRIANGLE))
    for x, name in enumerate(["Rig|Walk", "Rig|Run", "Other|Run", "Run|Fast", "1"]):
        maker.animate(node, "translation", [0, 1], [[0, 0, 0], [x, 0, 0]], name=name)
    for choice, x in (("Walk", 0), ("Other|Run", 2), ("Fast", 3), ("1", 4), (1, 1)):
        assert made(maker, animation=choice).points[1, 0, 0] == x
    with pytest.raises(SettingsError, match=r"several animations 'Run'.* 1 'Rig\|Run', 2 'Other\|Run'"):
        made(maker, animation="Run")
    with pytest.raises(SettingsError, match=r"no animation 'alk'"):
        made(maker, animation="alk")


# glTF files in: nodes, their names and transforms, and which of them are read


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
    with pytest.raises(InvalidSequenceError, match="frame 13: 'body' is mirrored relative to the first frame"):
        made(maker)


def test_a_scale_of_nothing_is_none_of_that(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.animate(maker.node(mesh=maker.mesh(TRIANGLE)), "scale", [0, 1], [[1, 1, 1], [0, 0, 0]])
    assert not made(maker).points[-1].any()


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
    with pytest.warns(MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: 'room/floor'"):
        got = made(maker)
    assert (got.name, got.vertex_count, got.frame_count) == ("body", 3, 2)
    assert made(maker, prim="/").vertex_count == 7
    for prim in ("room", "/room/floor", "floor"):
        got = made(maker, prim=prim)
        assert (got.name, got.vertex_count, got.frame_count) == ("floor", 4, 1)
    assert made(maker, prim="skinny").vertex_count == 3
    with pytest.raises(FormatError, match="no mesh at or below 'cellar'; its meshes are 'body', 'room/floor'"):
        made(maker, prim="cellar")


def test_a_name_of_several_nodes_is_ambiguous(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    for parent in ("left", "right"):
        maker.node(parent, children=[maker.node("hand", mesh=maker.mesh(TRIANGLE))])
    with pytest.raises(AmbiguousError, match="'hand' is in several places, 'left/hand', 'right/hand'; give its path"):
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


def test_the_name_of_several_meshes_is_that_of_a_node(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    maker.node("pair")
    nameless = maker.node(children=[maker.node("left", mesh=mesh), maker.node("right", mesh=mesh)])
    maker.node("pair", children=[nameless])
    got = made(maker)
    assert [each.path for each in got.objects] == [
        f"pair (node 4)/node {nameless}/left",
        f"pair (node 4)/node {nameless}/right",
    ]
    assert got.name == "pair"


def test_hidden_nodes_are_read_only_if_named(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    ghost = maker.node("ghost", mesh=maker.mesh(TRIANGLE))
    maker.node("attic", children=[ghost], extensions={"KHR_node_visibility": {"visible": False}})
    assert made(maker).vertex_count == 3  # there is nothing else
    maker.node("body", mesh=maker.mesh(SQUARE, [0, 1, 2]), extensions={"KHR_node_visibility": {}})
    assert [each.name for each in made(maker).objects] == ["body"]
    assert [each.name for each in made(maker, prim="/").objects] == ["body"]
    assert [each.name for each in made(maker, prim="ghost").objects] == ["ghost"]


def test_meshes_deep_in_each_other_take_no_time(made: Callable[..., MeshSequence]) -> None:
    """What is above them is computed once, not once per mesh."""
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    for number in range(300):
        maker.node("a", mesh=mesh, translation=[1, 0, 0], children=[number + 1])
    maker.node("end")
    got = made(maker)
    assert got.points[0, ::3, 0].tolist() == list(range(1, 301))


# glTF files in: skins and morph targets


@pytest.mark.parametrize("scale", [1, 7])  # weights are made to sum to 1
def test_two_joints(made: Callable[..., MeshSequence], scale: float) -> None:
    got = made(skinned(scale * np.array([[1, 0, 0, 0], [0.5, 0.5, 0, 0], [1, 0, 0, 0]]), JOINTS))
    np.testing.assert_allclose(got.points[0], [[2, 0, 0], [2, 1, 0], [0, 1, 0]], atol=1e-6)
    # The second vertex is half way between (2, 1) and where the joint takes it, (0, 1).
    np.testing.assert_allclose(got.points[-1], [[1, 1, 0], [1, 1, 0], [0, 1, 0]], atol=1e-6)


def test_normalised_weights(made: Callable[..., MeshSequence]) -> None:
    weights = [[255, 0, 0, 0], [51, 204, 0, 0], [255, 0, 0, 0]]
    got = made(skinned(weights, JOINTS, "u1", normalized=True))
    np.testing.assert_allclose(got.points[-1, 1], [0.2 * 2 + 0.8 * 0, 1, 0], atol=1e-6)


def test_a_second_set_of_joints(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[0.25, 0, 0, 0]] * 3, np.zeros((3, 4)))
    maker.json["meshes"][0]["primitives"][0]["attributes"].update(
        JOINTS_1=maker.add([[1, 1, 1, 1]] * 3, "u2"), WEIGHTS_1=maker.add([[0.25, 0.25, 0.25, 0]] * 3)
    )
    np.testing.assert_allclose(made(maker).points[-1, 0], [0.25 * 2 + 0.75 * 1, 0.75, 0], atol=1e-6)


def test_weights_of_nothing_follow_the_first_joint(made: Callable[..., MeshSequence]) -> None:
    got = made(skinned(np.zeros((3, 4)), JOINTS))
    np.testing.assert_allclose(got.points[-1], got.points[0])


def test_a_mirroring_skeleton_keeps_faces_outwards(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, JOINTS)
    maker.json["nodes"][1]["scale"] = [1, 1, -1]
    assert made(maker).faces.tolist() == [[0, 2, 1]]


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
    np.testing.assert_allclose(got.points[:, 1], np.array([[1, 0, 10], [1 + 2 * middle, 0, 10 + middle], [3, 0, 11]]))


def test_morphs_come_before_the_skin(made: Callable[..., MeshSequence]) -> None:
    maker = skinned([[1, 0, 0, 0]] * 3, [[1, 0, 0, 0]] * 3)
    mesh = maker.json["meshes"][0]
    mesh["primitives"][0]["targets"] = [{"POSITION": maker.add([[1, 0, 0]] * 3)}]
    mesh["weights"] = [1]
    np.testing.assert_allclose(made(maker).points[-1, 0], [1, 2, 0], atol=1e-6)
