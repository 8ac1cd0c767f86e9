"""Draw contact sheets of segmentations, transfers (source and target) and reconstructions (with the original)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.pictures.charts import Target, error_map, import_matplotlib
from mixseq.pictures.colours import part_colours, segmentation_colours
from mixseq.pictures.raster import DOTS_PER_INCH, draw_mesh
from mixseq.pictures.scene import (
    CLAY_COLOUR,
    INK_COLOUR,
    Limits,
    View,
    aspect_ratio,
    heading_between,
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
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mixseq.retargeting.transfer import Transfer
    from mixseq.retargeting.verdict import Verdict


PAGE_WIDTH = 12.0  # in inches, like all page lengths
ROW_GAP = 0.15
BOTTOM_MARGIN = 0.1
MAX_VERDICT_LETTERS = 115  # largest length of a verdict below a title
WARNING_COLOUR = "#c92a2a"


@dataclass(frozen=True, eq=False)
class Sheet:
    """A page with rows of equal panels."""

    figure: Figure  # the page
    panels: list[list[Axes]]  # panels row by row, without axis frames

    @classmethod
    def from_grid(
        cls, rows: int, columns: int, aspect: float, title: str, left: float = 0.1, right: float = 0.1
    ) -> Sheet:
        """Lay out panels with an aspect ratio clamped to 0.3..2.5; `left` and `right` are margins in inches."""
        top = 0.4 + 0.25 * len(title.splitlines()) if title else 0.3
        width = (PAGE_WIDTH - left - right) / columns
        height = width * float(np.clip(aspect, 0.3, 2.5))
        page_height = top + rows * (height + ROW_GAP) - ROW_GAP + BOTTOM_MARGIN

        size = PAGE_WIDTH, page_height
        figure: Figure = import_matplotlib("figure").Figure(figsize=size, facecolor="white")
        figure.text(0.1 / PAGE_WIDTH, 1 - 0.1 / page_height, title, fontsize=13, color=INK_COLOUR, va="top")

        def panel(row: int, column: int) -> Axes:
            x, y = left + column * width, BOTTOM_MARGIN + (rows - 1 - row) * (height + ROW_GAP)
            ax = figure.add_axes((x / PAGE_WIDTH, y / page_height, width / PAGE_WIDTH, height / page_height))
            ax.set_axis_off()
            return ax

        return cls(figure, [[panel(row, column) for column in range(columns)] for row in range(rows)])

    def label_row(self, row: int, text: str) -> None:
        """Write a label to the left of a row."""
        self.panels[row][0].annotate(
            text,
            (0, 0.5),
            (-8, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=10,
            color=INK_COLOUR,
        )

    def add_colour_bar(self, mappable: Any, label: str) -> None:
        """Add a colour bar in scientific notation to the right of the last row."""
        ticker = import_matplotlib("ticker")
        box = self.panels[-1][-1].get_position(original=True)
        x, width = box.x1 + 0.08 / PAGE_WIDTH, 0.12 / PAGE_WIDTH
        cax = self.figure.add_axes((x, box.y0 + 0.1 * box.height, width, 0.8 * box.height))
        bar = self.figure.colorbar(mappable, cax=cax, ticks=ticker.LinearLocator(3))
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")
        bar.ax.tick_params(labelsize=7, colors=INK_COLOUR, length=2)
        bar.outline.set_visible(False)
        bar.set_label(label, fontsize=7, color=INK_COLOUR)

    def save(self, target: Target) -> None:
        """Write the page as a PNG without metadata, so that equal pictures give identical files."""
        self.figure.savefig(target, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})


def draw_segmentation(
    target: Target,
    points: FloatArray,
    faces: IntArray,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    up_axis: str = "Y",
    title: str | None = None,
) -> None:
    """Write a PNG of a pose ``(V, 3)`` from two opposite sides, coloured by parts ``(F,)`` and joints ``(F,)``."""
    colours = segmentation_colours(part_of_face, joint_of_face, faces)
    views = opposite_views(points[None], up_axis)
    sheet = Sheet.from_grid(1, 2, views_aspect(views), title or "")
    for ax, (view, limits) in zip(sheet.panels[0], views[0], strict=True):
        draw_mesh(ax, points, faces, colours, up_axis, view, limits)
    sheet.save(target)


def opposite_views(poses: FloatArray, up_axis: str = "Y", view: View | None = None) -> list[list[tuple[View, Limits]]]:
    """Return two opposite views of each pose ``(n, V, 3)``, with screen rectangles of equal size."""
    view = view or three_quarter_view(poses[0], up_axis)
    views = view, View(view.azimuth + 180, view.elevation)
    boxes = [[shared_limits(pose, up_axis, side) for side in views] for pose in poses]
    corners = np.array(boxes).reshape(len(poses), 2, 2, 2)
    width, height = np.ptp(corners, axis=3).max(axis=(0, 1)) / 2
    return [
        [(side, (x - width, x + width, y - height, y + height)) for side, (x, y) in zip(views, centres, strict=True)]
        for centres in corners.mean(axis=3)
    ]


def views_aspect(views: list[list[tuple[View, Limits]]]) -> float:
    """Return the ratio of height to width of the screen rectangles of `opposite_views`."""
    return aspect_ratio(views[0][0][1])


def transfer_sheet(
    target: Target,
    transfer: Transfer,
    frames: Sequence[int],
    points: FloatArray,
    title: str | None = None,
    verdict: Verdict | None = None,
) -> None:
    """Write a PNG with frames of the source above frames of the target ``(n, V', 3)``, and rest poses on the left.

    Source and target are drawn from the same side with the same part colours, at different scales. Places that the
    verdict names are circled, in the drawn frame or at rest.
    """
    headers = source_header, target_header = transfer.source.header, transfer.header
    if points.shape != (expected := (len(frames), target_header.vertex_count, 3)):
        raise SettingsError(
            f"points have the shape {points.shape}; give a pose of the target for each frame, {expected}"
        )
    source_points = transfer.source.points[np.asarray(frames, dtype=np.int64)]
    rest_poses = transfer.source.rest, transfer.target
    poses = [np.concatenate([x[None], y]) for x, y in zip(rest_poses, (source_points, points), strict=True)]
    labels = common_parts(transfer)
    palette = part_colours(int(labels[0].max()) + 1)

    view = three_quarter_view(transfer.source.rest, source_header.up_axis)
    views = view, View(view.azimuth + heading_degrees(transfer), view.elevation)
    limits = [shared_limits(x, header.up_axis, side) for x, header, side in zip(poses, headers, views, strict=True)]
    aspect = max(map(aspect_ratio, limits))
    names = title or f"{source_header.name}: its motion on {target_header.name}"
    if verdict is not None:
        names += "\n" + shorten(verdict.text, MAX_VERDICT_LETTERS, placeholder=" ...")
    sheet = Sheet.from_grid(2, 1 + len(frames), aspect, names, left=1.25)
    for row, (label, header) in enumerate(zip(("source", "target"), headers, strict=True)):
        sheet.label_row(row, f"{label}\n{header.vertex_count:,}\nvertices")
        ground = float(to_y_up(poses[row], header.up_axis)[..., 1].min())
        options = header.up_axis, views[row], widen_to_aspect(limits[row], aspect), ground
        for ax, x in zip(sheet.panels[row], poses[row], strict=True):
            draw_mesh(ax, x, header.faces, palette[labels[row]], *options)
    titles = [f"frame {source_header.frame_number(k)}, {source_header.times[k]:.3f} s" for k in frames]
    for ax, text in zip(sheet.panels[0], ["at rest", *titles], strict=True):
        ax.set_title(text, fontsize=9, color=INK_COLOUR, pad=2)
    for finding in () if verdict is None else verdict.findings:
        if finding.vertex is not None and (finding.frame is None or finding.frame in frames):
            column = 0 if finding.frame is None else 1 + list(frames).index(finding.frame)
            place = to_y_up(poses[1][column][finding.vertex], target_header.up_axis) @ views[1].rotation.T
            sheet.panels[1][column].plot(*place[:2], "o", ms=22, mfc="none", mec=WARNING_COLOUR, mew=2, zorder=5)
    sheet.save(target)


def common_parts(transfer: Transfer) -> tuple[Index, Index]:
    """Return the part of every source triangle ``(F,)`` and of every target triangle ``(F',)``, with common numbers.

    After a transfer by gradients, the source is segmented by its motion and the parts are mapped to the target.
    """
    from mixseq.retargeting.parts import transfer_labels

    parts = transfer.method.parts
    if parts is not None:
        return parts.part_of_face
    labels = transfer.source.part_of_face()
    return labels, transfer_labels(labels, transfer.correspondence, transfer.header.faces)


def heading_degrees(transfer: Transfer) -> float:
    """Return the best-fit rotation about the up axis from source to target at rest, in degrees; 0 if undefined."""
    matched = transfer.correspondence.matched
    source = to_y_up(transfer.correspondence.interpolate(transfer.source.rest)[matched], transfer.source.header.up_axis)
    target = to_y_up(transfer.target[matched], transfer.header.up_axis)
    return heading_between(source, target)


def contact_sheet(
    target: Target,
    original: MeshSequence,
    decoded: MeshSequence,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    frames: int = 6,
    title: str | None = None,
) -> None:
    """Write a PNG with rows for the original, its parts, the reconstruction and its error.

    Columns are frames that both sequences have. An additional row shows frames of `decoded` half-way between frames of
    the original, if any.

    Parameters
    ----------
    target : path or binary file
        File to write.
    original, decoded : MeshSequence
        Sequences of the same mesh; frame times may differ.
    part_of_face, joint_of_face : (F,) int
        As in `segmentation_colours`.
    frames : int
        Number of columns.
    title : str, optional
        Title of the sheet, by default the name of `original`.

    Raises
    ------
    SettingsError
        If the faces differ, or the sequences have no time in common.
    """
    if not np.array_equal(original.faces, decoded.faces):
        raise SettingsError("original and decoded have different faces; give two sequences of the same mesh")
    original_frames, decoded_frames = common_frames(original, decoded, frames)
    between = frames_halfway(original, decoded, original_frames)
    colour_map, error_colours = _error_colours(original, decoded, original_frames, decoded_frames)
    original_columns, decoded_columns = dict(enumerate(original_frames)), dict(enumerate(decoded_frames))
    clay = [CLAY_COLOUR] * len(original_frames)
    parts = [segmentation_colours(part_of_face, joint_of_face, original.faces)] * len(original_frames)
    rows = [
        _Row("original", original, original_columns, clay, show_times=True),
        _Row("parts and\njoints", original, original_columns, parts),
        _Row("reconstruction", decoded, decoded_columns, clay),
        _Row("in between\n(new frames)", decoded, between, clay, show_times=True),
        _Row("vertex error", decoded, decoded_columns, error_colours, contrast=0.25),
    ]
    sheet = _draw_rows([row for row in rows if row.frames], title or original.name)
    sheet.add_colour_bar(colour_map, "vertex error / diagonal")
    sheet.save(target)


@dataclass(frozen=True, eq=False)
class _Row:
    """A row of a contact sheet."""

    label: str  # text on the left
    sequence: MeshSequence  # sequence to draw
    frames: dict[int, int]  # frame number by column; empty columns are missing
    colours: Sequence[ArrayLike]  # RGB of the mesh or its faces, by column
    contrast: float = 1.0  # strength of the shading
    show_times: bool = False  # whether panels are titled with their times


def _error_colours(
    original: MeshSequence, decoded: MeshSequence, original_frames: list[int], decoded_frames: list[int]
) -> tuple[Any, list[Float]]:
    """Return the colour map of vertex errors, and the face colours ``(F, 3)`` of each pair of frames."""
    offsets = decoded.points[decoded_frames].astype(np.float64) - original.points[original_frames]
    errors = np.linalg.norm(offsets, axis=2) / (original.diagonal or 1.0)
    colour_map = error_map(max(errors.max(), np.finfo(np.float64).eps))
    return colour_map, [colour_map.to_rgba(error[original.faces].mean(axis=1))[:, :3] for error in errors]


def _draw_rows(rows: list[_Row], title: str) -> Sheet:
    """Draw all rows with a common view, screen rectangle and ground height."""
    first = rows[0].sequence
    poses = np.concatenate([row.sequence.points[list(row.frames.values())] for row in rows])
    view = three_quarter_view(first.points[[0, -1]], first.up_axis)
    limits = shared_limits(poses, first.up_axis, view)
    ground = float(to_y_up(poses, first.up_axis)[..., 1].min())

    sheet = Sheet.from_grid(len(rows), len(rows[0].frames), aspect_ratio(limits), title, left=1.25, right=1.0)
    for number, row in enumerate(rows):
        sheet.label_row(number, row.label)
        for column, frame in row.frames.items():
            ax, points = sheet.panels[number][column], row.sequence.points[frame]
            options = row.colours[column], first.up_axis, view, limits, ground, row.contrast
            draw_mesh(ax, points, first.faces, *options)
            if row.show_times:
                time = float(row.sequence.times[frame])
                title_text = f"frame {format_frame(time, first.fps)}, {time:.3f} s"
                ax.set_title(title_text, fontsize=9, color=INK_COLOUR, pad=2)
    return sheet


def common_frames(original: SequenceHeader, decoded: SequenceHeader, count: int) -> tuple[list[int], list[int]]:
    """Return up to `count` evenly spaced frames of the original, and the decoded frames at the same times."""
    nearest = np.abs(decoded.times[None] - original.times[:, None]).argmin(axis=1)
    time_difference = np.abs(decoded.times[nearest] - original.times)
    common = np.flatnonzero(time_difference < 1e-3 / max(original.fps, decoded.fps))
    if not common.size:
        raise SettingsError(
            "original and decoded have no frame at the same time; decode the model at the original's times"
        )
    count = min(count, len(common))
    chosen = common[np.arange(count) * len(common) // count]  # excludes the end, as in a loop
    return chosen.tolist(), nearest[chosen].tolist()


def frames_halfway(original: SequenceHeader, decoded: SequenceHeader, frames: list[int]) -> dict[int, int]:
    """Return decoded frames about half-way between each original frame and its next frame, by index in `frames`."""
    result = {}
    for position, frame in enumerate(frames):
        start, *later = original.times[frame : frame + 2]
        for end in later:
            distance = np.abs(decoded.times - (start + end) / 2)
            if distance.min() < 0.3 * (end - start):
                result[position] = int(distance.argmin())
    return result
