"""The segmentation of one pose, seen from two opposite sides."""

from __future__ import annotations

import numpy as np

from mixseq.plots.camera import View, broadside, shared_limits
from mixseq.plots.colours import segmentation_colours
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.layout import Sheet, Target
from mixseq.sequence import FloatArray, IntArray


def draw_segmentation(
    target: Target,
    points: FloatArray,
    faces: IntArray,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    up_axis: str = "Y",
    title: str | None = None,
) -> None:
    """Draw the parts and joints of one pose from two opposite sides, as a PNG.

    Parameters
    ----------
    target : path or binary file
        Where the PNG goes.
    points : (V, 3) float
        The pose.
    faces : (F, 3) int
        Triangles.
    part_of_face, joint_of_face : (F,) int
        As for `segmentation_colours`.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    title : str, optional
        Heading.
    """
    colours = segmentation_colours(part_of_face, joint_of_face)
    near = broadside(points, up_axis)
    views = near, View(near.azimuth + 180, near.elevation)
    boxes = np.array([shared_limits(points, up_axis, view) for view in views]).reshape(2, 2, 2)
    # both panels get the width and height of the larger one, about their own centres
    width, height = np.ptp(boxes, axis=2).max(axis=0)
    sheet = Sheet.of(1, 2, height / width, title or "")
    for ax, view, (x, y) in zip(sheet.panels[0], views, boxes.mean(axis=2), strict=True):
        limits = x - width / 2, x + width / 2, y - height / 2, y + height / 2
        draw_mesh(ax, points, faces, colours, up_axis, view, limits)
    sheet.save(target)
