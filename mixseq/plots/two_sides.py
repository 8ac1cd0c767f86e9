"""The segmentation of one pose, seen from two opposite sides."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import FloatArray, IntArray
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.sheet_layout import Sheet, Target
from mixseq.scene.camera import Limits, View, shared_limits, three_quarter_view
from mixseq.scene.palettes import segmentation_colours


def draw_segmentation(
    target: Target,
    points: FloatArray,
    faces: IntArray,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    up_axis: str = "Y",
    title: str | None = None,
) -> None:
    """Draw parts and joints ``(F,)`` of a pose ``(V, 3)`` from two opposite sides, as a PNG."""
    colours = segmentation_colours(part_of_face, joint_of_face)
    sides = two_sides(points[None], up_axis)
    sheet = Sheet.of(1, 2, height_per_width(sides), title or "")
    for ax, (view, limits) in zip(sheet.panels[0], sides[0], strict=True):
        draw_mesh(ax, points, faces, colours, up_axis, view, limits)
    sheet.save(target)


def two_sides(
    poses: FloatArray, up_axis: str = "Y", near: View | None = None
) -> list[list[tuple[View, Limits]]]:
    """Return the cameras and screen rectangles of two opposite views of poses ``(n, V, 3)``."""
    near = near or three_quarter_view(poses[0], up_axis)
    views = near, View(near.azimuth + 180, near.elevation)
    boxes = [[shared_limits(pose, up_axis, view) for view in views] for pose in poses]
    corners = np.array(boxes).reshape(len(poses), 2, 2, 2)
    width, height = np.ptp(corners, axis=3).max(axis=(0, 1)) / 2
    return [
        [
            (view, (x - width, x + width, y - height, y + height))
            for view, (x, y) in zip(views, pair, strict=True)
        ]
        for pair in corners.mean(axis=3)
    ]


def height_per_width(sides: list[list[tuple[View, Limits]]]) -> float:
    """Return the height per width of the rectangles of `two_sides`."""
    left, right, bottom, top = sides[0][0][1]
    return (top - bottom) / (right - left)
