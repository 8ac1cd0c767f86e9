"""The contact sheet: original, parts, reconstruction and error of a sequence, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float, IntArray
from mixseq.errors import SettingsError
from mixseq.frame_numbers import frame_text
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.sheet_layout import Sheet, Target, matplotlib_module
from mixseq.scene.camera import shared_limits, three_quarter_view, y_up
from mixseq.scene.palettes import CLAY, INK, segmentation_colours
from mixseq.sequence import MeshSequence, SequenceHeader


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
    clay = [CLAY] * len(here)
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
    scale = matplotlib_module("colors").Normalize(0, max(errors.max(), np.finfo(np.float64).eps))
    heat_map = matplotlib_module("cm").ScalarMappable(scale, "viridis")
    return heat_map, [heat_map.to_rgba(error[original.faces].mean(axis=1))[:, :3] for error in errors]


def _draw_rows(rows: list[_Row], title: str) -> Sheet:
    """Draw all rows with one camera, one set of limits and one ground."""
    first = rows[0].sequence
    shown = np.concatenate([row.sequence.points[list(row.frames.values())] for row in rows])
    view = three_quarter_view(first.points[[0, -1]], first.up_axis)
    limits = shared_limits(shown, first.up_axis, view)
    ground = float(y_up(shown, first.up_axis)[..., 1].min())

    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    sheet = Sheet.of(len(rows), len(rows[0].frames), aspect, title, left=1.25, right=1.0)
    for number, row in enumerate(rows):
        sheet.label_row(number, row.label)
        for column, frame in row.frames.items():
            ax, points, colours = (
                sheet.panels[number][column],
                row.sequence.points[frame],
                row.colours[column],
            )
            draw_mesh(ax, points, first.faces, colours, first.up_axis, view, limits, ground, row.contrast)
            if row.show_times:
                time = float(row.sequence.times[frame])
                when = f"frame {frame_text(time, first.fps)}, {time:.3f} s"
                ax.set_title(when, fontsize=9, color=INK, pad=2)
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
