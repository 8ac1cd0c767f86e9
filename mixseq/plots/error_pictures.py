"""Errors of the frames of a model against a sequence: by frame as a chart, by vertex as colours of the mesh.

The error of a vertex is its distance from the original in diagonals, :math:`|A_{tv} - B_{tv}| / d`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.frame_numbers import frame_text
from mixseq.plots.charts import LINES, log_axis, time_axis
from mixseq.progress import Progress, silent
from mixseq.scene.palettes import INK
from mixseq.scene.vertex_measures import distances
from mixseq.sequence import MeshSequence
from mixseq.signals import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

from typing import TYPE_CHECKING, Any

from mixseq.arrays import IntArray
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.plots.two_sides import two_sides
from mixseq.scene.camera import View, y_up

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase

ROUNDING = 1e-17
"""Smallest error drawn on the logarithmic axis, in diagonals; smaller ones are drawn there."""

_BLOCK = 8  # frames decoded at once


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Distances of vertices from their originals, in diagonals."""

    largest: Float  # (T,) largest error in every frame
    rms: Float  # (T,) root mean square over the vertices of every frame
    by_vertex: Float  # (V,) largest error of every vertex over all frames
    worst: int  # frame of the largest error
    by_frame: dict[int, Float]  # errors (V,) in single frames: those that were asked for, and the worst one


def vertex_errors(
    model: Model, original: MeshSequence, frames: Sequence[int] = (), progress: Progress = silent
) -> VertexErrors:
    """Measure a model at the times of a sequence, in blocks of frames."""
    if not np.array_equal(model.header.faces, original.faces):
        raise SettingsError(
            f"the model has {len(model.header.faces)} triangles of {model.header.vertex_count} vertices, the sequence "
            f"{len(original.faces)} of {original.vertex_count}, or in another order; errors need one mesh"
        )
    unit = original.diagonal or 1.0
    largest, rms = np.zeros(original.frame_count), np.zeros(original.frame_count)
    by_vertex = of_worst = np.zeros(original.vertex_count)
    kept: dict[int, Float] = {}
    worst = first = 0
    for block in model.blocks(original.times, _BLOCK, progress):
        for frame, points in enumerate(block, first):
            apart = distances(points, original.points[frame], unit)
            largest[frame], rms[frame] = apart.max(), np.sqrt(np.mean(np.square(apart)))
            by_vertex = np.maximum(by_vertex, apart)
            if frame in frames:
                kept[frame] = apart
            if frame == 0 or largest[frame] > largest[worst]:
                worst, of_worst = frame, apart
        first += len(block)
    return VertexErrors(largest, rms, by_vertex, worst, kept | {worst: of_worst})


def draw_frame_errors(
    ax: Axes,
    errors: VertexErrors,
    times: Float,
    tolerance: float | None = None,
    fps: float | None = None,
) -> None:
    """Draw the largest and the root mean square error of every frame over time: times ``(T,)``."""
    largest, rms = (np.maximum(values, ROUNDING) for values in (errors.largest, errors.rms))
    ax.plot(times, largest, "o-", color=LINES[0], markersize=3.5, linewidth=1.2, label="largest")
    ax.plot(times, rms, "o-", color=LINES[1], markersize=3.5, linewidth=1.2, label="root mean square")
    shown = [largest, rms]
    if tolerance is not None:
        ax.axhline(tolerance, color=INK, linestyle="--", linewidth=1.0, label=f"tolerance, {tolerance:g}")
        shown.append(np.array([tolerance]))
    worst = errors.worst
    number = f"{worst}" if fps is None else frame_text(times[worst], fps)
    ax.plot(
        times[worst],
        largest[worst],
        "o",
        ms=9,
        mfc="none",
        mec=INK,
        clip_on=False,
        label=f"worst frame, {number}",
    )
    log_axis(ax, np.concatenate(shown))
    time_axis(ax, times[0], times[-1], fps)
    ax.set(title="Error per frame", ylabel="vertex error (diagonals)")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_vertex_errors(
    panels: Sequence[Sequence[Axes]],
    errors: VertexErrors,
    original: MeshSequence,
    frames: Sequence[int] | None = None,
    near: View | None = None,
) -> Any:
    """Draw errors as face colours from two opposite sides: maxima over all frames, then single frames.

    A face has the largest error of its corners. A ring marks the largest visible error of each row.
    """
    scale = matplotlib_module("colors").Normalize(0, max(errors.by_vertex.max(), ROUNDING))
    heat = matplotlib_module("cm").ScalarMappable(scale, "viridis")
    _, *single = rows = drawn_frames(errors, frames)
    values = [errors.by_vertex, *(errors.by_frame[frame] for frame in single)]
    titles = ["largest of all frames", *(_title(errors, original, frame) for frame in single)]
    sides = two_sides(original.points[rows], original.up_axis, near)
    for axes, frame, error, title, pair in zip(panels, rows, values, titles, sides, strict=True):
        points, most = original.points[frame], int(error.argmax())
        colours = heat.to_rgba(error[original.faces].max(axis=1))[:, :3]
        for ax, (view, limits) in zip(axes, pair, strict=True):
            draw_mesh(ax, points, original.faces, colours, original.up_axis, view, limits, contrast=0.25)
            ax.set_rasterization_zorder(3)  # in SVG too: thousands of triangles are better pixels
            screen = y_up(points, original.up_axis) @ view.rows.T
            if not _hidden(most, screen, original.faces):
                _ring(ax, screen[most])
        axes[0].set_title(f"Error per vertex: {title}\nmost at vertex {most}", fontsize=10)
    return heat


def drawn_frames(errors: VertexErrors, frames: Sequence[int] | None) -> list[int]:
    """Return the frames whose poses are drawn in the rows of `draw_vertex_errors`."""
    return [0, *([errors.worst] if frames is None else frames)]


def _title(errors: VertexErrors, original: MeshSequence, frame: int) -> str:
    which = "worst frame, " if frame == errors.worst else "frame "
    return f"{which}{original.frame_number(frame)} at {original.times[frame]:.3f} s"


def _ring(ax: Axes, place: Float) -> None:
    for colour, width in (("white", 3.5), (INK, 1.5)):
        ax.plot(place[0], place[1], "o", ms=12, mfc="none", mec=colour, mew=width, zorder=4)


def _hidden(vertex: int, screen: Float, faces: IntArray) -> bool:
    """Whether a triangle without the vertex is between it and the camera."""
    others = screen[faces[(faces != vertex).all(axis=1)]] - screen[vertex]
    a, b, c = others[:, 0], others[:, 1], others[:, 2]
    # weights of the corners, times twice the area, of the point where the line of sight meets the plane
    weights = np.stack([_cross(b, c), _cross(c, a), _cross(a, b)], axis=1)
    area = weights.sum(axis=1)
    met = ((weights * area[:, None] >= 0).all(axis=1)) & (area != 0)
    heights = np.einsum("fc,fc->f", weights[met], others[met, :, 2]) / area[met]
    return bool((heights > 0).any())


def _cross(a: Float, b: Float) -> Float:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def add_error_bar(page: FigureBase, panels: Sequence[Axes], heat: Any) -> None:
    """Add the colour bar of `draw_vertex_errors` beside panels."""
    bar = page.colorbar(heat, ax=panels, shrink=0.6, aspect=30, pad=0.02, label="vertex error (diagonals)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")
    bar.outline.set_visible(False)
