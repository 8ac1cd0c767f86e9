r"""How far the frames of a model are from those of a sequence: by frame and by vertex.

The error of a vertex is its distance from the original in diagonals, :math:`|A_{tv} - B_{tv}| / d`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.plots.charts import LINES, log_axis, time_axis
from mixseq.progress import Progress, silent
from mixseq.scene.palettes import INK
from mixseq.sequence import MeshSequence
from mixseq.signals import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ROUNDING = 1e-17
"""Errors below this, in diagonals, are drawn as this: a logarithmic axis has no zero."""

_BLOCK = 8  # frames decoded at once


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Distances of vertices from their originals, in diagonals.

    Attributes
    ----------
    largest : (T,) float64
        Largest error in every frame.
    rms : (T,) float64
        Root mean square over the vertices of every frame.
    by_vertex : (V,) float64
        Largest error of every vertex over all frames.
    worst : int
        Frame of the largest error.
    by_frame : dict
        Errors ``(V,)`` in single frames: those that were asked for, and the worst one.
    """

    largest: Float
    rms: Float
    by_vertex: Float
    worst: int
    by_frame: dict[int, Float]


def vertex_errors(
    model: Model, original: MeshSequence, frames: Sequence[int] = (), progress: Progress = silent
) -> VertexErrors:
    """Measure a model at the times of a sequence, a few frames at a time.

    Parameters
    ----------
    model : Model
        The model.
    original : MeshSequence
        What it should be like; its diagonal is the unit.
    frames : sequence of int
        Frames of the original whose errors are kept.
    progress : callable, optional
        Told about every block.

    Raises
    ------
    SettingsError
        If the meshes differ, or the sequence has times outside the model.
    """
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
            apart = np.linalg.norm(points - original.points[frame], axis=1) / unit
            largest[frame], rms[frame] = apart.max(), np.sqrt(np.mean(np.square(apart)))
            by_vertex = np.maximum(by_vertex, apart)
            if frame in frames:
                kept[frame] = apart
            if frame == 0 or largest[frame] > largest[worst]:
                worst, of_worst = frame, apart
        first += len(block)
    return VertexErrors(largest, rms, by_vertex, worst, kept | {worst: of_worst})


def draw_frame_errors(ax: Axes, errors: VertexErrors, times: Float, tolerance: float | None = None) -> None:
    """Draw the largest and the root mean square error of every frame over time.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw.
    errors : VertexErrors
        What `vertex_errors` found.
    times : (T,) float64
        Times of the frames in seconds.
    tolerance : float, optional
        Error to draw a line at, in diagonals.
    """
    largest, rms = (np.maximum(values, ROUNDING) for values in (errors.largest, errors.rms))
    ax.plot(times, largest, "o-", color=LINES[0], markersize=3.5, linewidth=1.2, label="largest")
    ax.plot(times, rms, "o-", color=LINES[1], markersize=3.5, linewidth=1.2, label="root mean square")
    shown = [largest, rms]
    if tolerance is not None:
        ax.axhline(tolerance, color=INK, linestyle="--", linewidth=1.0, label=f"tolerance, {tolerance:g}")
        shown.append(np.array([tolerance]))
    worst = errors.worst
    ax.plot(
        times[worst],
        largest[worst],
        "o",
        ms=9,
        mfc="none",
        mec=INK,
        clip_on=False,
        label=f"worst frame, {worst}",
    )
    log_axis(ax, np.concatenate(shown))
    time_axis(ax, times[0], times[-1])
    ax.set(title="Error per frame", ylabel="vertex error (diagonals)")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
