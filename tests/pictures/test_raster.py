"""Pixels of a mesh: where they are, which are nearest, and that there is no gap between triangles."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.pictures.raster import blank_picture, ground_shadow, render_mesh
from mixseq.pictures.scene import Limits, View, shared_limits, three_quarter_view
from mixseq.sequence.sequence import MeshSequence
from tests.meshes import torus

FRONT = View(0, 0)
UNIT: Limits = (0.0, 1.0, 0.0, 1.0)
FAR_BELOW = -100.0
"""A ground without shadow in the picture."""

Picture = NDArray[np.uint8]


def flat(points: NDArray[np.float64], faces: NDArray[np.int64], colours: object = (0.0, 0.0, 0.0)) -> Picture:
    """Draw without light on 8 x 8 pixels."""
    picture = blank_picture(8, 8)
    render_mesh(picture, points, faces, FRONT, UNIT, np.asarray(colours), ground=FAR_BELOW, contrast=0)
    return picture


def square(left: float, right: float, bottom: float, top: float, z: float = 0.0) -> NDArray[np.float64]:
    return np.array([[left, bottom, z], [right, bottom, z], [right, top, z], [left, top, z]])


HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def test_a_square_covers_its_pixels_and_no_others() -> None:
    picture = flat(square(0.25, 0.75, 0.5, 1.0), HALVES)
    expected = blank_picture(8, 8)
    expected[:4, 2:6] = 0
    assert np.array_equal(picture, expected)


@pytest.mark.parametrize("faces", [HALVES, HALVES[:, ::-1]])
def test_both_sides_are_seen(faces: NDArray[np.int64]) -> None:
    assert (flat(square(0, 1, 0, 1), faces) == 0).all()


def test_half_covered_pixels_are_half_as_dark() -> None:
    picture = flat(square(0.0, 1 / 16, 0.0, 1.0), HALVES)
    assert (picture[:, 0] == 128).all()
    assert (picture[:, 1:] == 255).all()


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [2, 3, 0, 1]])
def test_near_triangles_hide_far_ones_in_any_order(order: list[int]) -> None:
    points = np.concatenate([square(0, 1, 0, 1, z=0), square(0, 1, 0, 1, z=1)])
    faces, colours = np.concatenate([HALVES, HALVES + 4]), np.repeat([[1, 0, 0], [0, 0, 1.0]], 2, axis=0)
    assert (flat(points, faces[order], colours[order]) == [0, 0, 255]).all()


def test_triangles_that_cross_are_cut_where_they_do() -> None:
    tilted = np.array([[0, 0, -1], [1, 0, 1], [1, 1, 1], [0, 1, -1.0]])  # x = 1/2 is at depth 0
    points = np.concatenate([square(0, 1, 0, 1), tilted])
    faces, colours = np.concatenate([HALVES, HALVES + 4]), np.repeat([[1, 0, 0], [0, 0, 1.0]], 2, axis=0)
    picture = flat(points, faces, colours)
    assert (picture[:, :4] == [255, 0, 0]).all()
    assert (picture[:, 4:] == [0, 0, 255]).all()


def test_colours_of_corners_are_blended() -> None:
    rgb = square(0, 1, 0, 1)[HALVES][:, :, [0, 0, 0]]  # as dark as x is small
    picture = flat(square(0, 1, 0, 1), HALVES, rgb).astype(float)
    assert np.allclose(picture[..., 0], 255 * (np.arange(8) + 0.5) / 8, atol=1.01)


def test_neighbours_leave_no_gaps() -> None:
    rng = np.random.default_rng(1)
    inside = rng.random((60, 2)) * 0.9 + 0.05
    from scipy.spatial import Delaunay

    plane = np.concatenate([square(-0.1, 1.1, -0.1, 1.1)[:, :2], inside])
    points = np.column_stack([plane, np.zeros(len(plane))])
    assert (flat(points, Delaunay(plane).simplices.astype(np.int64)) == 0).all()


def test_what_is_outside_the_picture_is_left_out() -> None:
    assert (flat(square(2, 3, 0, 1), HALVES) == 255).all()
    assert (flat(square(-9, 9, -9, 9), HALVES) == 0).all()


def test_light_comes_from_above() -> None:
    points, faces = torus(24, 12)
    picture = blank_picture(64, 64)
    render_mesh(picture, points[:, [0, 2, 1]] * [1, 1, -1], faces, FRONT, (-3, 3, -3, 3), ground=FAR_BELOW)
    drawn = np.flatnonzero((picture[:, 32] < 255).any(axis=1))
    assert picture[drawn[1], 32].sum() > picture[drawn[-2], 32].sum()


def test_the_shadow_is_on_the_ground_and_below(gem: MeshSequence) -> None:
    points, view = gem.points[0], View(30, 30)
    limits = shared_limits(points, "Y", view)
    without, with_shadow = blank_picture(80, 60), blank_picture(80, 60)
    render_mesh(without, points, gem.faces, view, limits, ground=FAR_BELOW)
    render_mesh(with_shadow, points, gem.faces, view, limits)
    paper = (without == 255).all(axis=2)
    darker = paper & (with_shadow < 255).any(axis=2)
    rows = np.flatnonzero(darker.any(axis=1))
    assert rows.size
    assert rows[0] > 20


def test_a_part_of_a_picture_can_be_drawn_on(gem: MeshSequence) -> None:
    points, view = gem.points[0], three_quarter_view(gem.points[0])
    limits = shared_limits(points, "Y", view)
    whole, alone = blank_picture(50, 40), blank_picture(30, 20)
    for picture in (whole[10:30, 5:35], alone):
        render_mesh(picture, points, gem.faces, view, limits)
    assert np.array_equal(whole[10:30, 5:35], alone)
    assert (whole[:10] == 255).all()
    assert (whole[:, 35:] == 255).all()


def test_degenerate_triangles_are_survived() -> None:
    assert (flat(np.full((3, 3), 0.5), np.array([[0, 1, 2]])) == 255).all()


# The shadow: where it falls and how dark it is

LIMITS = (-2.0, 2.0, -1.0, 1.0)
TILE = np.array([[-0.02, 0, -0.01], [-0.02, 0, 0.01], [0.04, 0, 0]])
FACE = np.array([[0, 1, 2]])


def alpha(points: NDArray[np.float64], floor: float = 0.0, elevation: float = 40.0) -> NDArray[np.float64]:
    return ground_shadow(points, FACE, floor, View(0, elevation), LIMITS)


def test_pixels_are_square() -> None:
    assert alpha(TILE).shape == (120, 240)


def test_shadow_lies_below_the_mesh() -> None:
    row, column = np.unravel_index(np.argmax(alpha(TILE + np.array([1, 0, 0]))), (120, 240))
    assert column == pytest.approx(180, abs=2)
    assert row == pytest.approx(60, abs=2)


def test_shadow_fades_with_height() -> None:
    near, far = alpha(TILE), alpha(TILE, floor=-0.5)
    assert 0 < far.max() < 0.6 * near.max()


def test_shadow_ends_softly_at_the_frame() -> None:
    everywhere = alpha(TILE + np.array([1.95, 0, 0]))
    assert everywhere.max() > 0
    assert not everywhere[:, [0, -1]].any() and not everywhere[[0, -1]].any()


def test_no_mesh_no_shadow() -> None:
    assert not alpha(np.zeros((3, 3)), elevation=0.0).any()
