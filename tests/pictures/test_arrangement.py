"""Where meshes stand, and whether they are seen."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.pictures.raster import draw_mesh
from mixseq.pictures.scene import (
    FIELD_OF_VIEW_DEGREES,
    FRAMING_RATIO,
    MESH_GAP_RATIO,
    SCENE_SIZE,
    Arrangement,
    Scene,
    SceneItem,
    View,
    arrange_meshes,
    front_azimuth,
    shared_limits,
    three_quarter_view,
)
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.signals.model import Model
from mixseq.types import ByteArray, Float, FloatArray, IntArray
from tests.meshes import bar, tetrahedron, tube
from tests.pictures.conftest import LOW_RESOLUTION


def box(size: tuple[float, float, float], at: tuple[float, float, float] = (0, 0, 0)) -> MeshSequence:
    """A mesh that does not move, in a box of this size around a place."""
    points, faces = tetrahedron()
    poses = np.repeat((points / 2 * size + np.array(at))[None], 2, axis=0)
    return MeshSequence.from_arrays(poses, faces, fps=10)


def scene_of(*sequences: MeshSequence) -> Scene:
    return Scene(tuple(SceneItem(sequence.header.name, load_frames(sequence)) for sequence in sequences))


def in_scene(found: Arrangement, index: int, points: FloatArray) -> NDArray[np.float32]:
    return found.place(index, found.to_local(index, points))


def placed(scene: Scene, found: Arrangement) -> list[Float]:
    """Points (T, V, 3) of all meshes over the scene."""
    return [
        np.stack([in_scene(found, index, item.pose(scene.elapsed(frame))) for frame in range(scene.count)]).astype(
            np.float64
        )
        for index, item in enumerate(scene.items)
    ]


def across(found: Arrangement) -> Float:
    """The direction that points right in the view."""
    a = np.radians(found.view.azimuth)
    return np.array([np.cos(a), 0, -np.sin(a)])


SHOTS = {
    "one": [bar()],
    "two": [bar(), bar()],
    "moving": [bar(frames=5), bar(frames=3), bar(frames=5)],
    "unlike": [box((1, 7, 2), (50, 3, -9)), box((4, 1, 9), (-7, 0, 0)), box((0.5, 0.5, 0.5))],
    "up": [MeshSequence.from_arrays(bar().points, bar().faces, fps=10, up_axis=axis) for axis in ("X", "Y", "Z")],
}


@pytest.mark.parametrize("name", SHOTS)
def test_side_by_side(name: str) -> None:
    scene = scene_of(*SHOTS[name])
    found = arrange_meshes(scene, side_by_side=True)
    meshes = placed(scene, found)
    ends = [(float((mesh @ across(found)).min()), float((mesh @ across(found)).max())) for mesh in meshes]
    for (_, right), (left, _) in pairwise(ends):
        assert left > right
    for mesh in meshes:
        assert mesh[..., 1].min() == pytest.approx(0, abs=1e-6)  # every one on the ground


@pytest.mark.parametrize("side_by_side", [True, False])
@pytest.mark.parametrize("name", SHOTS)
def test_the_box_is_around_everything(name: str, side_by_side: bool) -> None:
    scene = scene_of(*SHOTS[name])
    found = arrange_meshes(scene, side_by_side)
    points = np.concatenate([mesh.reshape(-1, 3) for mesh in placed(scene, found)])
    np.testing.assert_allclose(points.min(axis=0), found.low, atol=1e-5)
    np.testing.assert_allclose(points.max(axis=0), found.high, atol=1e-5)
    assert (found.high - found.low).max() == pytest.approx(SCENE_SIZE)
    assert found.low[1] == pytest.approx(0)
    np.testing.assert_allclose((found.low + found.high)[[0, 2]], 0, atol=1e-12)  # around the origin


def test_two_boxes_in_closed_form() -> None:
    scene = scene_of(box((2, 4, 0.5), at=(9, 9, 9)), box((1, 1, 1), at=(-5, 0, 2)))
    found = arrange_meshes(scene, side_by_side=True)
    right = np.array([np.sqrt(3) / 2, 0, -0.5])  # seen from 30 degrees
    np.testing.assert_allclose(across(found), right, atol=1e-12)
    widths = [np.sqrt(3) + 0.25, np.sqrt(3) / 2 + 0.5]
    apart = (sum(widths) / 2 + MESH_GAP_RATIO * max(widths)) * right  # from middle to middle
    first, second = (mesh.reshape(-1, 3) for mesh in placed(scene, found))
    centres = [(mesh.min(axis=0) + mesh.max(axis=0)) / 2 for mesh in (first, second)]
    np.testing.assert_allclose((centres[1] - centres[0])[[0, 2]] / found.scale, apart[[0, 2]], rtol=1e-5, atol=1e-5)


def test_in_one_place_they_stay_where_they_are() -> None:
    scene = scene_of(box((2, 4, 1)), box((1, 1, 1), at=(0.5, 3, 0.25)))
    found = arrange_meshes(scene, side_by_side=False)
    np.testing.assert_array_equal(found.offsets[0], found.offsets[1])
    first, second = (mesh.reshape(-1, 3) for mesh in placed(scene, found))
    assert first[:, 1].min() == pytest.approx(0, abs=1e-6)
    assert second[:, 1].min() == pytest.approx(found.scale * 4.5)  # 3 - 0.5 above -2


@pytest.mark.parametrize(("axis", "order"), [("X", [2, 0, 1]), ("Y", [0, 1, 2]), ("Z", [1, 2, 0])])
def test_any_axis_may_point_up(axis: str, order: list[int]) -> None:
    points, faces = tube(5, 7)
    sequence = MeshSequence.from_arrays(points[None], faces, up_axis=axis)
    scene = scene_of(sequence)
    found = arrange_meshes(scene, side_by_side=True)
    turned = points[:, order]
    moved = in_scene(found, 0, sequence.points[0])
    spun = found.turned(0, 40.0)
    np.testing.assert_allclose(spun.to_mesh(0, in_scene(spun, 0, points)[1]), points[1], atol=1e-5)
    assert moved.dtype == np.float32
    shift = moved - found.scale * turned
    np.testing.assert_allclose(shift - shift[0], 0, atol=1e-5)
    assert moved[:, 1].min() == pytest.approx(0, abs=1e-6)


def test_names_stand_above() -> None:
    scene = scene_of(*SHOTS["unlike"])
    found = arrange_meshes(scene, side_by_side=True)
    for label, mesh in zip(found.label_positions, placed(scene, found), strict=True):
        points = mesh.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        np.testing.assert_allclose(label[[0, 2]], ((low + high) / 2)[[0, 2]], atol=1e-5)
        assert high[1] < label[1] < high[1] + 0.1 * SCENE_SIZE


def shares(found: Arrangement, aspect: float) -> Float:
    """How far from the middle of the picture to its sides the corners of the box are, (8, 2)."""
    place, centre = found.camera(aspect)
    near = (place - centre) / np.linalg.norm(place - centre)
    right = np.cross([0, 1, 0], near)
    right /= np.linalg.norm(right)
    up = np.cross(near, right)
    corners = np.array(list(product(*zip(found.low, found.high, strict=True)))) - place
    depth = -corners @ near
    assert (depth > 0).all()
    tangent = np.tan(np.radians(FIELD_OF_VIEW_DEGREES) / 2)
    seen = np.stack([corners @ right * aspect, corners @ up], axis=1) / (tangent * depth[:, None])
    return np.asarray(np.abs(seen))


@pytest.mark.parametrize("aspect", [0.3, 9 / 16, 1.0, 1.28, 2.5])
@pytest.mark.parametrize("name", SHOTS)
def test_the_camera_sees_everything(name: str, aspect: float) -> None:
    seen = shares(arrange_meshes(scene_of(*SHOTS[name]), side_by_side=True), aspect)
    assert seen.max() == pytest.approx(1 / FRAMING_RATIO)  # everything, and no farther away than that takes


@given(
    st.tuples(*3 * [st.floats(0.01, 2.0)]),
    st.tuples(*3 * [st.floats(-3.0, 3.0)]),
    st.floats(0.0, 360.0),
    st.floats(0.2, 6.0),
)
def test_the_camera_sees_any_box(size: tuple[float, ...], at: tuple[float, ...], azimuth: float, aspect: float) -> None:
    box = np.array([[at, np.add(at, size)]])
    found = Arrangement(("Y",), 1.0, box, np.zeros((1, 3)), View(azimuth), (0.0,))
    assert shares(found, aspect).max() == pytest.approx(1 / FRAMING_RATIO)
    place, centre = found.camera(aspect)
    assert place[1] > centre[1]  # from above
    toward = place - centre
    turned = np.degrees(np.arctan2(toward[0], toward[2])) - azimuth
    assert (turned + 180) % 360 - 180 == pytest.approx(0, abs=1e-6)


def test_the_camera_is_where_it_was_asked_for() -> None:
    """What stays where it is has its front towards +z; 90 degrees to its left is +x."""
    still = MeshSequence.from_arrays(bar().points[:1], bar().faces)
    place, centre = arrange_meshes(Scene((SceneItem("bar", still),)), True, (90.0, 0.0)).camera(1.0)
    np.testing.assert_allclose((place - centre) / np.linalg.norm(place - centre), [1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 90.0, 180.0, -120.0])
@pytest.mark.parametrize("name", ["two", "moving", "unlike", "up"])
def test_a_row_turns_with_the_camera(name: str, azimuth: float) -> None:
    scene = scene_of(*SHOTS[name])
    before = arrange_meshes(scene, side_by_side=True)
    found = before.seen_from(View(azimuth), np.zeros(3), 10.0)
    right = across(found)
    ends = [(float((mesh @ right).min()), float((mesh @ right).max())) for mesh in placed(scene, found)]
    assert all(left > end for (_, end), (left, _) in pairwise(ends))
    assert found.low[1] == pytest.approx(0)
    assert found.scale == before.scale


def test_what_is_looked_at_stays() -> None:
    before = arrange_meshes(scene_of(*SHOTS["two"]), side_by_side=True)
    for index, middle in enumerate(before.centres):
        found = before.seen_from(View(before.view.azimuth + 70.0), middle, 1.0)
        np.testing.assert_allclose(found.offsets[index], before.offsets[index], atol=1e-12)
        assert np.abs(found.offsets[1 - index] - before.offsets[1 - index]).max() > 0.1
    found = before.seen_from(View(before.view.azimuth + 70.0), before.centres[0], 10.0)
    np.testing.assert_allclose(found.centres.mean(axis=0), before.centres.mean(axis=0), atol=1e-12)


def test_meshes_are_stacked_where_that_shows_them_larger() -> None:
    """Long ones in a narrow picture; tall ones and wide pictures have a row."""
    long, tall = scene_of(*2 * [box((4, 1, 1))]), scene_of(*2 * [box((1, 4, 1))])
    for scene, aspect, is_stacked in ((long, 1.5, True), (long, 0.6, False), (tall, 1.5, False), (tall, 0.6, False)):
        found = arrange_meshes(scene, True, (0.0, 0.0)).fitted(aspect)
        assert found.is_stacked == is_stacked
        assert shares(found, aspect).max() == pytest.approx(1 / FRAMING_RATIO)
        direction = [0, -1, 0] if is_stacked else [1, 0, 0]
        size = 1 if is_stacked or scene is tall else 4
        apart = (1 + MESH_GAP_RATIO) * size * found.scale * np.array(direction)
        np.testing.assert_allclose(found.centres[1] - found.centres[0], apart, atol=1e-9)


@pytest.mark.parametrize("elevation", [-60.0, 0.0, 35.0, 80.0])
def test_a_stack_turns_with_the_camera(elevation: float) -> None:
    before = arrange_meshes(scene_of(*SHOTS["unlike"]), side_by_side=True).fitted(3.0)
    assert before.is_stacked
    found = before.seen_from(View(50.0, elevation), np.zeros(3), 100.0)
    heights = [points @ found.view.rotation[1] for points in placed(scene_of(*SHOTS["unlike"]), found)]
    assert all(upper.min() > lower.max() for upper, lower in pairwise(heights))


def test_a_turned_mesh_is_seen_from_another_azimuth() -> None:
    scene = scene_of(*SHOTS["unlike"])
    before = arrange_meshes(scene, side_by_side=True)
    found = before.turned(1, 40.0)
    np.testing.assert_allclose(found.centres.mean(axis=0), before.centres.mean(axis=0), atol=1e-9)
    for index, turn in enumerate((0.0, 40.0, 0.0)):
        local = found.to_local(index, scene.items[index].pose(0.0)).astype(np.float64)
        seen = (placed(scene, found)[index][0] - found.offsets[index]) @ found.view.rotation.T
        own = View(found.view.azimuth + turn, found.view.elevation)
        np.testing.assert_allclose(seen, local @ own.rotation.T, atol=1e-6)
    ends = [(mesh @ across(found)).ravel() for mesh in placed(scene, found)]
    assert all(left.max() < right.min() for left, right in pairwise(ends))
    assert found.low[1] == pytest.approx(0)


# The camera: where it stands and what it frames


@pytest.mark.parametrize("view", [View(), View(120, 40), View(-30, 0)])
def test_camera_is_a_rotation(view: View) -> None:
    assert np.allclose(view.rotation @ view.rotation.T, np.eye(3))
    assert np.linalg.det(view.rotation) == pytest.approx(1)
    assert view.rotation[1, 1] > 0


def test_camera_of_zero_degrees_looks_along_minus_z() -> None:
    assert np.allclose(View(0, 0).rotation, np.eye(3))


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0]])
def test_broadside_sees_the_longer_side(gem: MeshSequence, order: list[int]) -> None:
    points = gem.points[0][:, order]
    left, right, *_ = shared_limits(points, "Y", three_quarter_view(points))
    assert right - left > 3


@pytest.mark.parametrize(("up", "order"), [("X", [1, 2, 0]), ("Z", [2, 0, 1])])
def test_up_axis_only_renames(up: str, order: list[int]) -> None:
    points = np.random.default_rng(1).normal(size=(20, 3)) * [3, 2, 1]
    assert np.allclose(shared_limits(points, "Y", View()), shared_limits(points[:, order], up, View()))


def test_who_stays_faces_as_formats_do() -> None:
    """Towards +z with Y up, towards -y with Z up: the nose is nearer to the camera than the neck."""
    neck, nose = np.zeros(3), {"Y": [0.0, 0, 1], "Z": [0.0, -1, 0]}
    for up, tip in nose.items():
        body = np.array([neck, tip, [0.4, 0, 0], [-0.4, 0, 0]])
        near = (body[:, [0, 1, 2] if up == "Y" else [1, 2, 0]] @ View(front_azimuth(body[None], up), 0).rotation.T)[
            :, 2
        ]
        assert near[1] - near[0] == pytest.approx(1)


@pytest.mark.parametrize("heading", [0, 35, 90, 180, -90, -145])
def test_who_travels_is_seen_from_the_front_and_the_longer_side(heading: float) -> None:
    a = np.radians(heading)
    forwards = np.array([np.sin(a), 0, np.cos(a)])
    body = np.multiply.outer([-1.0, 1.0], forwards)
    view = three_quarter_view(np.stack([body, body + 3 * forwards]))
    _, _, towards = view.rotation @ forwards
    assert 0.4 < towards < 0.5  # the cosine of 60 degrees, from a little above


def test_a_step_is_no_travel() -> None:
    body = np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 1]])
    assert front_azimuth(np.stack([body, body + np.array([0.3, 0, 0])])) == 0


def test_shared_limits_hold_every_pose(gem: MeshSequence) -> None:
    left, right, bottom, top = shared_limits(gem.points, view=View())
    for pose in gem.points:
        one = shared_limits(pose, view=View(), margin=0)
        assert left <= one[0] and right >= one[1] and bottom <= one[2] and top >= one[3]


def test_limits_of_a_single_point_are_not_empty() -> None:
    left, right, bottom, top = shared_limits(np.zeros((3, 3)))
    assert left < right and bottom < top


# A mesh on a page; `test_raster.py` has the renderer


def draw(ax: Any, points: FloatArray, faces: IntArray, **options: Any) -> ByteArray:
    """Draw a mesh and return its picture."""
    draw_mesh(ax, points, faces, **options)
    (image,) = ax.images
    return np.asarray(image.get_array())


def test_both_sides_look_alike(ax: Any, gem: MeshSequence) -> None:
    front = draw(ax, gem.points[0], gem.faces[:6])
    ax.clear()
    np.testing.assert_array_equal(draw(ax, gem.points[0], gem.faces[:6, ::-1]), front)


@pytest.mark.parametrize("order", [[0, 1], [1, 0]])
def test_near_faces_hide_far_faces(ax: Any, order: list[int]) -> None:
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    faces, colours = np.array([[0, 1, 2], [3, 4, 5]])[order], np.array([[1, 0, 0], [0, 0, 1.0]])[order]
    picture = draw(ax, points, faces, colours=colours, view=View(0, 0), contrast=0)
    assert (picture == [0, 0, 255]).all(axis=2).any()
    assert not (picture == [255, 0, 0]).all(axis=2).any()


def test_flat_colours_stay_as_given(ax: Any, gem: MeshSequence) -> None:
    picture = draw(ax, gem.points[0], gem.faces, colours=(0.2, 0.4, 0.6), contrast=0)
    assert picture[tuple(np.array(picture.shape[:2]) // 2)].tolist() == [51, 102, 153]


def test_faces_above_are_brighter_than_below(ax: Any, gem: MeshSequence) -> None:
    picture = draw(ax, gem.points[0] * [1, 0.2, 1], gem.faces, view=View(0, 0)).astype(int)
    rows = np.nonzero(picture.sum(axis=2) < 3 * 255)[0]
    above, below = (picture[round(np.quantile(rows, share)), picture.shape[1] // 2].sum() for share in (0.3, 0.7))
    assert above > below


def test_a_picture_has_the_pixels_of_its_panel(ax: Any, gem: MeshSequence) -> None:
    width, low = ax.get_window_extent().width, draw(ax, gem.points[0], gem.faces)
    assert low.shape[1] == pytest.approx(width, abs=1)
    ax.clear()
    ax.figure.dpi = LOW_RESOLUTION / 2
    assert draw(ax, gem.points[0], gem.faces).shape[1] == pytest.approx(width * LOW_RESOLUTION / 100, abs=1)


def test_degenerate_triangles_are_survived(ax: Any) -> None:
    draw(ax, np.zeros((3, 3)), np.array([[0, 1, 2]]))


def test_a_flat_mesh_seen_from_its_edge_is_survived(ax: Any) -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1.0]])
    draw(ax, square, np.array([[0, 2, 1], [0, 3, 2]]), view=View(0, 0))


# What is shown when


@pytest.fixture(scope="module")
def sequence() -> MeshSequence:
    return bar(sides=3, rings=5, frames=5)  # at 10 frames per second


def test_poses_of_a_sequence_are_its_nearest_frames(sequence: MeshSequence) -> None:
    item = SceneItem("bar", load_frames(sequence))
    for elapsed, frame in ((0.0, 0), (0.04, 0), (0.06, 1), (0.4, 4), (9.0, 4)):
        pose = item.pose(elapsed)
        assert pose.dtype == np.float32
        np.testing.assert_array_equal(pose, sequence.points[frame].astype(np.float32))


def test_poses_of_a_model_are_at_any_time(bar_model: Model) -> None:
    item = SceneItem("bar", bar_model)
    for elapsed, time in ((0.0, 0.0), (0.123, 0.123), (0.3, 0.3), (9.0, 0.3)):
        np.testing.assert_array_equal(item.pose(elapsed), bar_model(time).astype(np.float32))


def test_frames_of_the_longest(sequence: MeshSequence) -> None:
    short = SceneItem("short", load_frames(bar(sides=3, rings=5, frames=2)))
    scene = Scene((short, SceneItem("long", load_frames(sequence))))
    assert (scene.count, scene.fps) == (5, 10)
    assert [scene.elapsed(frame) for frame in range(5)] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])


def test_at_another_rate(sequence: MeshSequence) -> None:
    scene = Scene((SceneItem("bar", load_frames(sequence)),), rate=30)
    assert (scene.count, scene.fps) == (15, 30)
    with pytest.raises(SettingsError, match="frames per second"):
        _ = Scene(scene.items, rate=1).count


@pytest.mark.parametrize(
    ("elapsed", "frame"), [(0.0, 0), (0.26, 3), (0.24, 2), (-1.0, 0), (7.0, 4), (1e308, 4), (-1e308, 0)]
)
def test_the_frame_at_a_time(sequence: MeshSequence, elapsed: float, frame: int) -> None:
    assert Scene((SceneItem("bar", load_frames(sequence)),)).frame_at(elapsed) == frame


def test_another_motion_of_one_of_the_meshes(sequence: MeshSequence, bar_model: Model) -> None:
    scene = Scene((SceneItem("a", load_frames(sequence)), SceneItem("b", load_frames(sequence))), rate=20)
    other = scene.with_item(1, bar_model)
    assert other.items[0] is scene.items[0]
    assert (other.items[1].name, other.items[1].motion, other.rate) == ("b", bar_model, 20)
    assert scene.items[1].motion is not bar_model


@pytest.mark.parametrize(("most", "frames"), [(1, [0]), (2, [0, 4]), (3, [0, 2, 4]), (99, [0, 1, 2, 3, 4])])
def test_frames_spread_over_a_shot(sequence: MeshSequence, most: int, frames: list[int]) -> None:
    assert list(Scene((SceneItem("bar", load_frames(sequence)),)).sample_frames(most)) == frames
