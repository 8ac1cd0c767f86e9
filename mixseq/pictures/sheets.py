"""Contact sheets: the segmentation of a pose, source and target of a transfer, original and reconstruction by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.pictures.colours import CLAY_COLOUR, INK_COLOUR, part_colours, segmentation_colours
from mixseq.pictures.page import Sheet, Target, draw_mesh, error_map
from mixseq.pictures.scene import (
    Limits,
    View,
    aspect_ratio,
    shared_limits,
    three_quarter_view,
    to_y_up,
    widen_to_aspect,
)
from mixseq.sequence.frame_rates import format_frame
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float, FloatArray, Index, IntArray

if TYPE_CHECKING:
    from mixseq.retargeting.transfer import Transfer


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
    sides = opposite_views(points[None], up_axis)
    sheet = Sheet.from_grid(1, 2, views_aspect(sides), title or "")
    for ax, (view, limits) in zip(sheet.panels[0], sides[0], strict=True):
        draw_mesh(ax, points, faces, colours, up_axis, view, limits)
    sheet.save(target)


def opposite_views(
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


def views_aspect(sides: list[list[tuple[View, Limits]]]) -> float:
    """Return the height per width of the rectangles of `opposite_views`."""
    return aspect_ratio(sides[0][0][1])


def transfer_sheet(
    target: Target,
    transfer: Transfer,
    frames: Sequence[int],
    points: FloatArray,
    title: str | None = None,
) -> None:
    """Draw source and target one above the other, as a PNG: points of the target ``(n, V', 3)``.

    Both have the same view, each at its own scale, with the pose at rest in the first column and common part colours.
    """
    headers = here, there = transfer.source.header, transfer.header
    if points.shape != (len(frames), there.vertex_count, 3):
        raise SettingsError(
            f"points have shape {points.shape}; {(len(frames), there.vertex_count, 3)} is expected, a pose of the "
            "target for every frame"
        )
    moving = transfer.source.points[np.asarray(frames, dtype=np.int64)]
    at_rest = transfer.source.rest, transfer.target
    poses = [np.concatenate([x[None], y]) for x, y in zip(at_rest, (moving, points), strict=True)]
    labels = parts_of_both(transfer)
    palette = part_colours(int(labels[0].max()) + 1)

    near = three_quarter_view(transfer.source.rest, here.up_axis)
    views = near, View(near.azimuth + heading(transfer), near.elevation)
    limits = [
        shared_limits(x, header.up_axis, view) for x, header, view in zip(poses, headers, views, strict=True)
    ]
    aspect = max(map(aspect_ratio, limits))
    names = title or f"{here.name}: its motion on {there.name}"
    sheet = Sheet.from_grid(2, 1 + len(frames), aspect, names, left=1.25)
    for row, (what, header) in enumerate(zip(("source", "target"), headers, strict=True)):
        sheet.label_row(row, f"{what}\n{header.vertex_count:,}\nvertices")
        ground = float(to_y_up(poses[row], header.up_axis)[..., 1].min())
        look = header.up_axis, views[row], widen_to_aspect(limits[row], aspect), ground
        for ax, x in zip(sheet.panels[row], poses[row], strict=True):
            draw_mesh(ax, x, header.faces, palette[labels[row]], *look)
    columns = [
        "at rest",
        *(f"frame {here.frame_number(frame)}, {here.times[frame]:.3f} s" for frame in frames),
    ]
    for ax, text in zip(sheet.panels[0], columns, strict=True):
        ax.set_title(text, fontsize=9, color=INK_COLOUR, pad=2)
    sheet.save(target)


def parts_of_both(transfer: Transfer) -> tuple[Index, Index]:
    """Return the parts of source triangles ``(F,)``, and of the target triangles ``(F',)`` that they move.

    For transfers by gradients the parts of the source are found from its motion and mapped to the target.
    """
    from mixseq.retargeting.parts import transfer_labels

    parts = transfer.method.parts
    if parts is not None:
        return parts.part_of_face
    labels = transfer.source.part_of_face()
    return labels, transfer_labels(labels, transfer.correspondence, transfer.header.faces)


def heading(transfer: Transfer) -> float:
    """Return the best-fit turn of the target at rest from the source about the up axis, in degrees, 0 if unknown."""
    matched = transfer.correspondence.matched
    source = to_y_up(
        transfer.correspondence.interpolate(transfer.source.rest)[matched], transfer.source.header.up_axis
    )
    target = to_y_up(transfer.target[matched], transfer.header.up_axis)
    a, b = ((x - x.mean(axis=0))[:, [0, 2]] for x in (source, target))
    along, across = float((a * b).sum()), float((a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]).sum())
    return float(np.degrees(np.arctan2(across, along)))


def contact_sheet(
    target: Target,
    original: MeshSequence,
    decoded: MeshSequence,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    frames: int = 6,
    title: str | None = None,
) -> None:
    """Draw original, parts, reconstruction and error one below the other, as a PNG.

    Columns are frames that both sequences have. If `decoded` has frames half-way to the next original one, another row
    shows those.

    Parameters
    ----------
    target : path or binary file
        Where the PNG goes.
    original, decoded : MeshSequence
        The same mesh; times may differ.
    part_of_face, joint_of_face : (F,) int
        As for `segmentation_colours`.
    frames : int
        Number of columns.
    title : str, optional
        Heading, by default the name of `original`.

    Raises
    ------
    SettingsError
        If the meshes differ, or the sequences have no time in common.
    """
    if not np.array_equal(original.faces, decoded.faces):
        raise SettingsError(
            "original and decoded have different faces; a sheet compares one mesh with itself"
        )
    here, there = common_frames(original, decoded, frames)
    between = frames_between(original, decoded, here)
    heat_map, heat = _error_colours(original, decoded, here, there)
    at_here, at_there = dict(enumerate(here)), dict(enumerate(there))
    clay = [CLAY_COLOUR] * len(here)
    parts = [segmentation_colours(part_of_face, joint_of_face)] * len(here)
    rows = [
        _Row("original", original, at_here, clay, show_times=True),
        _Row("parts and\njoints", original, at_here, parts),
        _Row("reconstruction", decoded, at_there, clay),
        _Row("in between\n(new frames)", decoded, between, clay, show_times=True),
        _Row("vertex error", decoded, at_there, heat, contrast=0.25),
    ]
    sheet = _draw_rows([row for row in rows if row.frames], title or original.name)
    sheet.add_colour_bar(heat_map, "vertex error / diagonal")
    sheet.save(target)


@dataclass(frozen=True, eq=False)
class _Row:
    """A row of a contact sheet."""

    label: str  # what the row shows
    sequence: MeshSequence  # what is drawn
    frames: dict[int, int]  # its frame in every column that has one
    colours: Sequence[ArrayLike]  # rGB in every column
    contrast: float = 1.0  # strength of the shading
    show_times: bool = False  # whether times stand above the panels


def _error_colours(
    original: MeshSequence, decoded: MeshSequence, here: list[int], there: list[int]
) -> tuple[Any, list[Float]]:
    """Return a matplotlib colour map of vertex errors, and the colours ``(F, 3)`` of every pair of frames."""
    offsets = decoded.points[there].astype(np.float64) - original.points[here]
    errors = np.linalg.norm(offsets, axis=2) / (original.diagonal or 1.0)
    heat_map = error_map(max(errors.max(), np.finfo(np.float64).eps))
    return heat_map, [heat_map.to_rgba(error[original.faces].mean(axis=1))[:, :3] for error in errors]


def _draw_rows(rows: list[_Row], title: str) -> Sheet:
    """Draw all rows with one camera, one set of limits and one ground."""
    first = rows[0].sequence
    shown = np.concatenate([row.sequence.points[list(row.frames.values())] for row in rows])
    view = three_quarter_view(first.points[[0, -1]], first.up_axis)
    limits = shared_limits(shown, first.up_axis, view)
    ground = float(to_y_up(shown, first.up_axis)[..., 1].min())

    sheet = Sheet.from_grid(len(rows), len(rows[0].frames), aspect_ratio(limits), title, left=1.25, right=1.0)
    for number, row in enumerate(rows):
        sheet.label_row(number, row.label)
        for column, frame in row.frames.items():
            ax, points = sheet.panels[number][column], row.sequence.points[frame]
            look = row.colours[column], first.up_axis, view, limits, ground, row.contrast
            draw_mesh(ax, points, first.faces, *look)
            if row.show_times:
                time = float(row.sequence.times[frame])
                when = f"frame {format_frame(time, first.fps)}, {time:.3f} s"
                ax.set_title(when, fontsize=9, color=INK_COLOUR, pad=2)
    return sheet


def common_frames(
    original: SequenceHeader, decoded: SequenceHeader, count: int
) -> tuple[list[int], list[int]]:
    """Return up to `count` evenly spaced frames of the original, and the decoded ones at the same times."""
    nearest = np.abs(decoded.times[None] - original.times[:, None]).argmin(axis=1)
    gap = np.abs(decoded.times[nearest] - original.times)
    common = np.flatnonzero(gap < 1e-3 / max(original.fps, decoded.fps))
    if not common.size:
        raise SettingsError(
            "original and decoded have no frame at the same time; decode at the original's times"
        )
    count = min(count, len(common))
    chosen = common[np.arange(count) * len(common) // count]  # as of a loop: without the last one
    return chosen.tolist(), nearest[chosen].tolist()


def frames_between(original: SequenceHeader, decoded: SequenceHeader, frames: list[int]) -> dict[int, int]:
    """Return the decoded frames about half-way from original frames to the next ones."""
    result = {}
    for position, frame in enumerate(frames):
        start, *later = original.times[frame : frame + 2]
        for end in later:
            away = np.abs(decoded.times - (start + end) / 2)
            if away.min() < 0.3 * (end - start):
                result[position] = int(away.argmin())
    return result
