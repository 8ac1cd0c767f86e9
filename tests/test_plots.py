"""Pictures: what is drawn, in which colours, and how sheets are laid out."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixseq.errors import MissingExtraError, SettingsError
from mixseq.plots import (
    JOINT_RED,
    View,
    broadside,
    contact_sheet,
    draw_mesh,
    draw_segmentation,
    part_colours,
    segmentation_colours,
    shared_limits,
)
from mixseq.sequence import FloatArray, IntArray, MeshSequence

matplotlib = pytest.importorskip("matplotlib")

OCTAHEDRON = np.array([[2, 0, 0], [-2, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)
FACES = np.array(
    [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]], dtype=np.int32
)
PARTS = np.array([0, 0, 1, 1, 0, 0, 1, 1])
JOINTS = np.array([0, -1, -1, 0, -1, -1, -1, -1])


def swaying(frames: int = 9, fps: float = 24.0) -> MeshSequence:
    """A stretching octahedron that lasts 8 / 24 s."""
    stretch = 1 + 0.2 * np.sin(np.linspace(0, 2, frames))[:, None, None]
    return MeshSequence.from_arrays(OCTAHEDRON * stretch, FACES, fps=fps, name="gem")


def axes() -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def png_size(data: bytes) -> tuple[int, int]:
    assert data.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", data[16:24])
    return width, height


def sheet(original: MeshSequence, decoded: MeshSequence, **options: Any) -> bytes:
    file = io.BytesIO()
    contact_sheet(file, original, decoded, PARTS, JOINTS, **{"frames": 2, **options})
    return file.getvalue()


@pytest.mark.parametrize("view", [View(), View(120, 40), View(-30, 0)])
def test_camera_is_a_rotation(view: View) -> None:
    assert np.allclose(view.rows @ view.rows.T, np.eye(3))
    assert np.linalg.det(view.rows) == pytest.approx(1)
    assert view.rows[1, 1] > 0


def test_camera_of_zero_degrees_looks_along_minus_z() -> None:
    assert np.allclose(View(0, 0).rows, np.eye(3))


def test_broadside_sees_the_longer_side() -> None:
    along_x, along_z = OCTAHEDRON, OCTAHEDRON[:, [2, 1, 0]]
    for points in (along_x, along_z):
        left, right, *_ = shared_limits(points, "Y", broadside(points))
        assert right - left > 3


@pytest.mark.parametrize(("up", "order"), [("X", [1, 2, 0]), ("Z", [2, 0, 1])])
def test_up_axis_only_renames(up: str, order: list[int]) -> None:
    points = np.random.default_rng(1).normal(size=(20, 3)) * [3, 2, 1]
    assert np.allclose(shared_limits(points, "Y"), shared_limits(points[:, order], up))


def test_shared_limits_hold_every_pose() -> None:
    poses = swaying().points
    left, right, bottom, top = shared_limits(poses, view=View())
    for pose in poses:
        one = shared_limits(pose, view=View(), margin=0)
        assert left <= one[0] and right >= one[1] and bottom <= one[2] and top >= one[3]


def drawn(points: FloatArray, faces: IntArray, **options: Any) -> Any:
    ax = axes()
    draw_mesh(ax, points, faces, **options)
    (collection,) = ax.collections
    return collection


def test_back_faces_of_a_closed_mesh_are_left_out() -> None:
    inside_out = FACES[:, ::-1]
    for faces in (FACES, inside_out):
        assert 0 < len(drawn(OCTAHEDRON, faces).get_paths()) < len(FACES)


def test_an_open_mesh_shows_both_sides() -> None:
    assert len(drawn(OCTAHEDRON, FACES[:6]).get_paths()) == 6


def test_near_faces_are_drawn_last() -> None:
    view = View(0, 0)
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1.0]])
    colours = np.array([[1, 0, 0], [0, 0, 1.0]])
    for order in ([0, 1], [1, 0]):
        faces = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)[order]
        last = drawn(points, faces, colours=colours[order], view=view, contrast=0).get_facecolor()[-1]
        assert np.allclose(last[:3], [0, 0, 1])


def test_flat_colours_stay_as_given() -> None:
    colours = drawn(OCTAHEDRON, FACES, colours=(0.2, 0.4, 0.6), contrast=0).get_facecolor()
    assert np.allclose(colours[:, :3], [0.2, 0.4, 0.6])


def test_faces_above_are_brighter_than_below() -> None:
    flat = OCTAHEDRON * [1, 0.2, 1]
    collection = drawn(flat, FACES, view=View(0, 0))
    heights = np.array([path.vertices[:3, 1].mean() for path in collection.get_paths()])
    light = collection.get_facecolor()[:, :3].sum(axis=1)
    assert light[heights > 0].min() > light[heights < 0].max()


def test_degenerate_triangles_are_survived() -> None:
    drawn(np.zeros((3, 3)), np.array([[0, 1, 2]], dtype=np.int32), limits=(-1, 1, -1, 1))


def test_part_colours_differ_and_leave_red_to_joints() -> None:
    colours = part_colours(24)
    assert colours.shape == (24, 3)
    assert colours.min() >= 0 and colours.max() <= 1
    assert np.array_equal(colours[:7], part_colours(7))
    distances = np.linalg.norm(colours[:, None] - colours, axis=2)
    assert distances[np.triu_indices(24, 1)].min() > 0.02
    assert np.diag(distances, 1).min() > 0.15
    assert np.linalg.norm(colours - JOINT_RED, axis=1).min() > 0.3


def test_segmentation_colours() -> None:
    colours = segmentation_colours(PARTS, JOINTS)
    assert np.allclose(colours[JOINTS >= 0], JOINT_RED)
    assert np.allclose(colours[1], part_colours(2)[0])
    assert np.allclose(colours[2], part_colours(2)[1])


def test_sheet_is_1800_pixels_wide_and_reproducible() -> None:
    gem = swaying()
    first = sheet(gem, gem)
    assert png_size(first)[0] == 1800
    assert first == sheet(gem, gem)


def test_sheet_goes_to_a_path(tmp_path: Path) -> None:
    contact_sheet(tmp_path / "sheet.png", swaying(), swaying(), PARTS, JOINTS, frames=2, title="two")
    assert png_size((tmp_path / "sheet.png").read_bytes())[0] == 1800


def test_new_frames_get_their_own_row() -> None:
    same, twice = sheet(swaying(), swaying()), sheet(swaying(), swaying(17, 48.0))
    assert png_size(twice)[1] > 1.15 * png_size(same)[1]


def test_sheet_of_fewer_frames_than_columns() -> None:
    assert png_size(sheet(swaying(2), swaying(2), frames=6))[0] == 1800
    assert png_size(sheet(swaying(1), swaying(1), frames=6))[0] == 1800


def test_sheet_refuses_what_cannot_be_compared() -> None:
    gem = swaying()
    later = MeshSequence.from_arrays(gem.points, FACES, times=gem.times + 0.01)
    with pytest.raises(SettingsError, match="no frame at the same time"):
        sheet(gem, later)
    with pytest.raises(SettingsError, match="different faces"):
        sheet(gem, MeshSequence.from_arrays(gem.points, FACES[:, ::-1]))


@pytest.mark.parametrize("up", ["X", "Y", "Z"])
def test_segmentation_picture(up: str) -> None:
    file = io.BytesIO()
    draw_segmentation(file, OCTAHEDRON, FACES, PARTS, JOINTS, up_axis=up, title="gem")
    assert png_size(file.getvalue())[0] == 1800


def test_without_matplotlib_the_message_names_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.split(".")[0] == "matplotlib"]:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[plot\]'"):
        sheet(swaying(), swaying())


def test_importing_plots_does_not_import_matplotlib() -> None:
    import subprocess

    code = "import sys, mixseq.plots; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
