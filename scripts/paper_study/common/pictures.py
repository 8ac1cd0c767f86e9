"""Pictures: rows of meshes seen by one camera, and charts of errors over the weight."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.mesh.measures import edge_lengths
from mixseq.pictures.charts import LINE_COLOURS, chart_style, new_page
from mixseq.pictures.colours import JOINT_RED, part_colours
from mixseq.pictures.raster import draw_mesh
from mixseq.pictures.scene import CLAY_COLOUR, Limits, View, shared_limits, three_quarter_view, to_y_up
from mixseq.pictures.sheets import Sheet
from mixseq.types import Float, Index
from scripts.paper_study.common.poses import Poses, between

DPI = 80
BRIGHTEST = 0.3  # length error that has the brightest colour
CLOSE = 0.13  # half the width of a close-up, in diagonals


class Panel(NamedTuple):
    """A mesh ``(V, 3)``, its title and colours, and the vertex of a close-up."""

    title: str
    points: Float
    colours: ArrayLike = CLAY_COLOUR
    close: int | None = None


def held(part_of_face: Index, rigid: NDArray[np.bool_]) -> Float:
    """Return colours ``(F, 3)`` of parts where they hold faces ``(F,)``, and of the others in red."""
    return np.where(rigid[:, None], part_colours(int(part_of_face.max()) + 1)[part_of_face], JOINT_RED)


def heat(poses: Poses, values: Float, most: float) -> Float:
    """Return colours ``(F, 3)`` of values at vertices ``(V,)``, from 0 to `most`."""
    from matplotlib import colormaps

    of_face = values[poses.sequence.faces].max(axis=1) / most
    return np.asarray(colormaps["viridis"](np.clip(of_face, 0, 1)))[:, :3]


def length_errors(poses: Poses, points: Float) -> Float:
    """Return colours ``(F, 3)`` of the largest error of the edges at every vertex, half-way, to `BRIGHTEST`."""
    lengths, _ = poses.target(between(0.5))
    worst, edges = np.zeros(len(points)), poses.topology.edges
    np.maximum.at(worst, edges, np.abs(edge_lengths(points, edges) / lengths - 1)[:, None])
    return heat(poses, worst, BRIGHTEST)


def gallery(target: Path, poses: Poses, rows: Sequence[Sequence[Panel]], title: str) -> None:
    """Draw rows of meshes with one camera, as a PNG."""
    up, faces = poses.sequence.up_axis, poses.sequence.faces
    everything = [panel for row in rows for panel in row]
    view = three_quarter_view(poses.points[0], up)
    limits = [shared_limits(panel.points, up, view) for panel in everything]
    low, high = np.array(limits)[:, ::2], np.array(limits)[:, 1::2]
    size = (high - low).max(axis=0)
    columns = max(len(row) for row in rows)
    sheet = Sheet.from_grid(len(rows), columns, float(size[1] / size[0]), title)
    for axes, row in zip(sheet.panels, rows, strict=True):
        for ax, panel in zip(axes, row, strict=False):
            window = _window(panel, poses, view, size)
            draw_mesh(ax, panel.points, faces, panel.colours, up, view, window)
            ax.set_title(panel.title, fontsize=9, pad=1)
    sheet.figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})


def _window(panel: Panel, poses: Poses, view: View, size: Float) -> Limits:
    """Return the rectangle of a panel: the whole mesh, or the surroundings of a vertex."""
    left, right, bottom, top = shared_limits(panel.points, poses.sequence.up_axis, view)
    middle, half = np.array([left + right, bottom + top]) / 2, size / 2
    if panel.close is not None:
        middle = (view.rotation @ to_y_up(panel.points[panel.close], poses.sequence.up_axis))[:2]
        half = size / size[0] * CLOSE * poses.diagonal
    (x, y), (width, height) = middle, half
    return float(x - width), float(x + width), float(y - height), float(y + height)


SIGNED_ROOT = (lambda x: np.sign(x) * np.sqrt(np.abs(x)), lambda x: np.sign(x) * np.square(x))
"""Scale of axes, and its inverse: on straight axes the inner bands could not be seen."""

Bands = Mapping[str, Any]
"""Bands of lengths and of angles, by method: ``{"lengths": (W, shares, 2), "degrees": (W, shares, 2)}``."""


def envelopes(target: Path, title: str, weights: Sequence[float], bands: Bands) -> None:
    """Draw bands of errors over the weight, a column for every method, as a PNG."""
    names = list(bands)
    rows = (
        ("lengths", "relative length error", ("all", "99.9 %", "99 %"), ("#9db8cf", LINE_COLOURS[0], "#123a57")),
        (
            "degrees",
            "dihedral error (degrees)",
            ("all", "99.99 %", "99.9 %", "99 %"),
            ("#ecd3ad", "#d6b06e", LINE_COLOURS[1], "#6e4508"),
        ),
    )
    with chart_style():
        page = new_page(2.5 * len(names) + 1.6, 5.6, title)
        panels = page.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
        for axes, (kind, label, shares, colours) in zip(panels, rows, strict=True):
            most = np.abs([bands[name][kind] for name in names]).max() or 1.0
            for ax, name in zip(axes, names, strict=True):
                values = np.asarray(bands[name][kind])
                for number, (share, colour) in enumerate(zip(shares, colours, strict=True)):
                    ax.fill_between(weights, *values[:, number].T, color=colour, linewidth=0, label=share)
                ax.set_yscale("function", functions=SIGNED_ROOT)
                ax.set_ylim(-most, most)
                ax.set_xlim(0, 1)
            axes[0].set_ylabel(label)
            axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title="share of edges", title_fontsize=8)
        for ax, name in zip(panels[0], names, strict=True):
            ax.set_title(name, fontsize=10)
        for ax in panels[1]:
            ax.set_xlabel("weight of the second pose")
        page.savefig(target, format="png", dpi=DPI, metadata={"Software": None})
