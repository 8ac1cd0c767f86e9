"""Errors as colours of the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mixseq.arrays import Float, IntArray
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.errors import ROUNDING, VertexErrors
from mixseq.plots.layout import matplotlib_module
from mixseq.plots.two_sides import two_sides
from mixseq.scene.camera import y_up
from mixseq.scene.palettes import INK
from mixseq.sequence import MeshSequence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase


def draw_vertex_errors(
    panels: Sequence[Sequence[Axes]],
    errors: VertexErrors,
    original: MeshSequence,
    frames: Sequence[int] | None = None,
) -> Any:
    """Draw errors as colours of the mesh from two opposite sides: the largest of all frames, and of single ones.

    A face has the largest error of its corners. A ring marks the largest error of each row where it can be seen.

    Parameters
    ----------
    panels : rows of two matplotlib Axes
        Where to draw: a row for all frames, and one for each of `frames`.
    errors : VertexErrors
        What `vertex_errors` found.
    original : MeshSequence
        The sequence it was measured against.
    frames : sequence of int, optional
        Frames with a row, by default the worst one.

    Returns
    -------
    matplotlib ScalarMappable
        For a colour bar, in diagonals.
    """
    scale = matplotlib_module("colors").Normalize(0, max(errors.by_vertex.max(), ROUNDING))
    heat = matplotlib_module("cm").ScalarMappable(scale, "viridis")
    _, *single = rows = drawn_frames(errors, frames)
    values = [errors.by_vertex, *(errors.by_frame[frame] for frame in single)]
    titles = ["largest of all frames", *(_title(errors, original, frame) for frame in single)]
    sides = two_sides(original.points[rows], original.up_axis)
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
    """Return the frame whose pose is in each row of `draw_vertex_errors`."""
    return [0, *([errors.worst] if frames is None else frames)]


def _title(errors: VertexErrors, original: MeshSequence, frame: int) -> str:
    which = "worst frame, " if frame == errors.worst else "frame "
    return f"{which}{frame} at {original.times[frame]:.3f} s"


def _ring(ax: Axes, place: Float) -> None:
    for colour, width in (("white", 3.5), (INK, 1.5)):
        ax.plot(place[0], place[1], "o", ms=12, mfc="none", mec=colour, mew=width, zorder=4)


def _hidden(vertex: int, screen: Float, faces: IntArray) -> bool:
    """Whether a triangle, none of the vertex itself, is between it and the camera."""
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
