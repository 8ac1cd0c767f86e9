"""The camera: where it stands and what it frames."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.pictures.scene import View, facing, shared_limits, three_quarter_view
from mixseq.sequence.sequence import MeshSequence


@pytest.mark.parametrize("view", [View(), View(120, 40), View(-30, 0)])
def test_camera_is_a_rotation(view: View) -> None:
    assert np.allclose(view.rows @ view.rows.T, np.eye(3))
    assert np.linalg.det(view.rows) == pytest.approx(1)
    assert view.rows[1, 1] > 0


def test_camera_of_zero_degrees_looks_along_minus_z() -> None:
    assert np.allclose(View(0, 0).rows, np.eye(3))


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
        near = (body[:, [0, 1, 2] if up == "Y" else [1, 2, 0]] @ View(facing(body[None], up), 0).rows.T)[:, 2]
        assert near[1] - near[0] == pytest.approx(1)


@pytest.mark.parametrize("heading", [0, 35, 90, 180, -90, -145])
def test_who_travels_is_seen_from_the_front_and_the_longer_side(heading: float) -> None:
    a = np.radians(heading)
    forwards = np.array([np.sin(a), 0, np.cos(a)])
    body = np.multiply.outer([-1.0, 1.0], forwards)
    view = three_quarter_view(np.stack([body, body + 3 * forwards]))
    _, _, towards = view.rows @ forwards
    assert 0.4 < towards < 0.5  # the cosine of 60 degrees, from a little above


def test_a_step_is_no_travel() -> None:
    body = np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 1]])
    assert facing(np.stack([body, body + np.array([0.3, 0, 0])])) == 0


def test_shared_limits_hold_every_pose(gem: MeshSequence) -> None:
    left, right, bottom, top = shared_limits(gem.points, view=View())
    for pose in gem.points:
        one = shared_limits(pose, view=View(), margin=0)
        assert left <= one[0] and right >= one[1] and bottom <= one[2] and top >= one[3]


def test_limits_of_a_single_point_are_not_empty() -> None:
    left, right, bottom, top = shared_limits(np.zeros((3, 3)))
    assert left < right and bottom < top
