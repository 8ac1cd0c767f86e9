"""Pictures of a model: of one kind, or all of them on one page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import FloatArray
from mixseq.choices import PICTURES, PictureKind
from mixseq.errors import SettingsError
from mixseq.plots.charts import Format, chart_style, new_page, picture_format, save_page
from mixseq.plots.error_pictures import (
    VertexErrors,
    add_error_bar,
    draw_frame_errors,
    draw_vertex_errors,
    drawn_frames,
    vertex_errors,
)
from mixseq.plots.model_charts import (
    draw_coefficients,
    draw_embedding,
    draw_singular_values,
    embedding_limits,
    existing_frames,
)
from mixseq.plots.model_parts import draw_parts, draw_parts_legend, legend_rows
from mixseq.plots.sheet_layout import Target
from mixseq.plots.two_sides import height_per_width, two_sides
from mixseq.progress import Progress, silent
from mixseq.scene.camera import View, seen_from
from mixseq.sequence import MeshSequence
from mixseq.signals import Model

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase

MOST_ROWS = 12
"""Largest number of frames drawn with their errors."""

_HEADING = 0.4  # inches, as are all lengths here
_LEGEND = 1.75


def plot_model(
    target: Target,
    model: Model,
    kind: PictureKind | None = None,
    *,
    against: MeshSequence | None = None,
    frames: Sequence[int] | None = None,
    tolerance: float | None = None,
    camera: tuple[float, float] | None = None,
    file_format: Format | None = None,
    progress: Progress = silent,
) -> None:
    """Draw a model, as PNG or SVG.

    Parameters
    ----------
    target : path or binary file
        Where the picture goes.
    model : Model
        The model.
    kind : str, optional
        One of `PICTURES`; by default all available ones, on one page.
    against : MeshSequence, optional
        The original, for errors.
    frames : sequence of int, optional
        Frames labelled in the embedding (by default some), or drawn with the errors of their vertices (by default the
        worst one).
    tolerance : float, optional
        Value of a line in the chart of errors, in diagonals.
    camera : (float, float), optional
        View of meshes, and the opposite one: degrees from the front, to the body's left, and above the horizon; by
        default the front and a side.
    file_format : {"png", "svg"}, optional
        By default that of the extension of the target; PNG for files without a name.
    progress : callable, optional
        Called after every decoded frame.

    Raises
    ------
    SettingsError
        If the model has no parts to draw, the original is missing or another mesh, a frame does not exist, or a setting
        does not belong to the kind of picture.
    OutputError
        If the target is neither PNG nor SVG.
    MissingExtraError
        If matplotlib is not installed.
    """
    chosen = picture_format(target, file_format)
    check_settings(kind, against is not None, frames, tolerance, camera)
    with chart_style():
        content = _content(model, kind, against, frames, tolerance, camera, progress)
        title = model.header.name if kind else summary(model)
        page = new_page(content.width, content.height + _HEADING, title)
        content.draw(page)
        save_page(page, target, chosen)


def summary(model: Model) -> str:
    """Describe a model in one line."""
    header, space = model.header, model.space
    return (
        f"{header.name}: {_count(header.frame_count, 'frame')} ({header.frame_numbers}) in "
        f"{model.end - model.start:.3g} s, {_count(header.vertex_count, 'vertex', 'vertices')}; "
        f"{_count(len(model.shapes), 'key shape')} in a "
        f"{space.name} space of dimension {space.dim:,}"
    )


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def check_settings(
    kind: PictureKind | None,
    against: bool,
    frames: Sequence[object] | None,
    tolerance: float | None,
    camera: tuple[float, float] | None = None,
) -> None:
    """Raise SettingsError for contradicting settings of `plot_model`, before the work."""
    if kind is not None and kind not in PICTURES:
        raise SettingsError(f"kind is {kind!r}; one of {', '.join(PICTURES)} is expected")
    if not against and (kind in ("error-frames", "error-vertices") or tolerance is not None):
        raise SettingsError(
            f"{kind or 'tolerance'} is about errors; give the original sequence to measure them against"
        )
    uses: list[tuple[str, bool, tuple[PictureKind, ...]]] = [
        ("against", against, ("error-frames", "error-vertices")),
        ("frames", frames is not None, ("embedding", "error-vertices")),
        ("tolerance", tolerance is not None, ("error-frames",)),
        ("camera", camera is not None, ("parts", "error-vertices")),
    ]
    for name, given, kinds in uses:
        if given and kind is not None and kind not in kinds:
            raise SettingsError(f"{name} is for {' and '.join(kinds)}, not for {kind}; leave it out")
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number of diagonals is expected")
    if camera is not None and not np.all(np.isfinite(camera)):
        raise SettingsError(f"the camera is at {camera}; two numbers of degrees are expected")
    if kind == "error-vertices" and frames is not None and not 0 < len(set(frames)) <= MOST_ROWS:
        raise SettingsError(f"frames are {len(set(frames))}; errors of 1 to {MOST_ROWS} frames fit on a page")


def _content(
    model: Model,
    kind: PictureKind | None,
    against: MeshSequence | None,
    frames: Sequence[int] | None,
    tolerance: float | None,
    camera: tuple[float, float] | None,
    progress: Progress,
) -> Section:
    match kind:
        case "embedding":
            return _embedding(model, frames)
        case "coefficients":
            return _coefficients(model)
        case "singular-values":
            return _singular_values(model)
    near = seen_from(np.stack([model(model.start), model(model.end)]), model.header.up_axis, camera)
    if kind == "parts":
        return _parts(model, near)
    rows = []
    if kind is None:
        charts = stacked(_coefficients(model, 2.7), _singular_values(model, 2.7))
        rows.append(beside(_embedding(model, frames), charts))
        if model.space.decomposed:
            rows.append(_parts(model, near, 5.0))
    if against is not None:
        own = kind == "error-vertices" and frames is not None
        single = existing_frames(frames or (), against.frame_count) if own else None
        errors = vertex_errors(model, against, single or (), progress)
        by_frame = _frame_errors(errors, against, tolerance)
        if kind is None:
            rows.append(beside(by_frame, _vertex_errors(errors, against, None, near, 3.0)))
        else:
            rows.append(
                by_frame if kind == "error-frames" else _vertex_errors(errors, against, single, near, 4.5)
            )
    return stacked(*rows)


def _embedding(model: Model, frames: Sequence[int] | None) -> Section:
    left, right, bottom, top = embedding_limits(model)
    height = 4.6 * (top - bottom) / (right - left) + 1.0
    return Section(6.0, height, lambda page: draw_embedding(page.subplots(), model, frames))


def _coefficients(model: Model, height: float = 4.0) -> Section:
    return Section(7.5, height, lambda page: draw_coefficients(page.subplots(), model))


def _singular_values(model: Model, height: float = 4.0) -> Section:
    return Section(7.5, height, lambda page: draw_singular_values(page.subplots(), model))


def _parts(model: Model, near: View, width: float = 4.5) -> Section:
    parts, pose = model.decomposition, model(model.start)
    columns = int(2 * width / _LEGEND)
    picture = _picture_height(pose[None], model.header.up_axis, near, width)
    legend = 0.2 * legend_rows(parts, columns)

    def draw(page: FigureBase) -> None:
        panels = page.subplot_mosaic([["near", "far"], ["legend", "legend"]], height_ratios=[picture, legend])
        draw_parts([panels["near"], panels["far"]], model, pose, near)
        draw_parts_legend(panels["legend"], parts, columns)

    return Section(2 * width, picture + legend + 0.5, draw)


def _frame_errors(errors: VertexErrors, against: MeshSequence, tolerance: float | None) -> Section:
    def draw(page: FigureBase) -> None:
        draw_frame_errors(page.subplots(), errors, against.times, tolerance, against.fps)

    return Section(7.5, 4.0, draw)


def _vertex_errors(
    errors: VertexErrors, against: MeshSequence, frames: Sequence[int] | None, near: View, width: float
) -> Section:
    def draw(page: FigureBase) -> None:
        panels = page.subplots(len(shown), 2, squeeze=False)
        heat = draw_vertex_errors(panels.tolist(), errors, against, frames, near)
        add_error_bar(page, panels.ravel().tolist(), heat)

    shown = against.points[drawn_frames(errors, frames)]
    height = _picture_height(shown, against.up_axis, near, width)
    return Section(2 * width + 1.0, len(shown) * (height + 0.4), draw)


def _picture_height(poses: FloatArray, up_axis: str, near: View, width: float) -> float:
    """Return the height of a mesh picture of a width; tall ones are drawn smaller."""
    return width * float(np.clip(height_per_width(two_sides(poses, up_axis, near)), 0.3, 0.9))


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    width: float  # preferred width in inches
    height: float  # preferred height in inches
    draw: Callable[[FigureBase], None]  # draws it on a matplotlib Figure or SubFigure


def stacked(*sections: Section) -> Section:
    """Put sections one below the other, all as wide as the widest."""

    def draw(page: FigureBase) -> None:
        heights = [section.height for section in sections]
        rows = page.subfigures(len(sections), 1, squeeze=False, height_ratios=heights)[:, 0]
        for section, row in zip(sections, rows, strict=True):
            section.draw(row)

    width = max(section.width for section in sections)
    return Section(width, sum(section.height for section in sections), draw)


def beside(*sections: Section) -> Section:
    """Put sections side by side, all as high as the highest."""

    def draw(page: FigureBase) -> None:
        widths = [section.width for section in sections]
        columns = page.subfigures(1, len(sections), squeeze=False, width_ratios=widths)[0]
        for section, column in zip(sections, columns, strict=True):
            section.draw(column)

    height = max(section.height for section in sections)
    return Section(sum(section.width for section in sections), height, draw)
