"""Parts and joints of a model: a coloured picture with numbers, and its legend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.plots.drawing import draw_mesh
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.plots.two_sides import two_sides
from mixseq.scene.camera import Limits, View, y_up
from mixseq.scene.palettes import JOINT_RED, part_colours, segmentation_colours
from mixseq.segmentation.joints import Decomposition
from mixseq.signals import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LISTED = 60
"""Largest number of parts named in a legend."""

_PIXELS = 300
"""Width of the picture in which visible parts are searched."""

_ROOM = 4.0
"""Pixels around the middle of a number that it needs."""


def draw_parts(panels: Sequence[Axes], model: Model, points: FloatArray, near: View | None = None) -> None:
    """Draw a pose ``(V, 3)`` from two opposite sides, coloured by part, joints in red, with part numbers."""
    parts, header = model.decomposition, model.header
    colours = segmentation_colours(parts.part_of_face, parts.joint_of_face)
    path_effects = matplotlib_module("patheffects")
    halo = [path_effects.withStroke(linewidth=2, foreground="white")]
    numbered = np.where(parts.joint_of_face >= 0, -1, parts.part_of_face)
    for ax, (view, limits) in zip(panels, two_sides(points[None], header.up_axis, near)[0], strict=True):
        draw_mesh(ax, points, header.faces, colours, header.up_axis, view, limits)
        ax.set_rasterization_zorder(3)  # in SVG too: thousands of triangles are better pixels
        screen = y_up(points, header.up_axis) @ view.rows.T
        for part, (x, y) in _number_places(screen, header.faces, numbered, limits).items():
            ax.text(x, y, f"{part}", fontsize=8, ha="center", va="center", path_effects=halo, zorder=4)
    panels[0].set_title("Parts and joints")


def draw_parts_legend(ax: Axes, parts: Decomposition, columns: int) -> None:
    """List parts with their colours and vertex counts, then joints."""
    patch = matplotlib_module("patches").Patch
    named = _named(parts)
    handles = [
        patch(color=colour, label=f"part {number}: {_vertices(len(part))}")
        for number, (part, colour) in enumerate(zip(parts.parts, part_colours(named), strict=False))
    ]
    if len(handles) > LISTED:
        left_out = len(handles) - LISTED
        handles = [*handles[:LISTED], patch(color="none", label=f"and {left_out} more parts")]
    if len(parts.parts) > named:
        handles.append(patch(color="none", label=f"in no triangle: {_vertices(len(parts.parts[named]))}"))
    if parts.joints:
        free = sum(int(joint.free.sum()) for joint in parts.joints)
        what = "1 joint" if len(parts.joints) == 1 else f"{len(parts.joints)} joints"
        handles.append(patch(color=JOINT_RED, label=f"{what}: {_vertices(free, 'free ')}"))
    ax.legend(handles=handles, loc="upper center", ncols=columns, handlelength=1.2, borderaxespad=0)
    ax.set_axis_off()


def legend_rows(parts: Decomposition, columns: int) -> int:
    """Return the number of rows of the legend."""
    return -(-(min(len(parts.parts), LISTED + 1) + 1) // columns)


def _named(parts: Decomposition) -> int:
    """Return the number of parts with faces, plus one for vertices without faces, if there are any."""
    return int(parts.part_of_face.max()) + 1


def _vertices(count: int, kind: str = "") -> str:
    return f"{count:,} {kind}{'vertex' if count == 1 else 'vertices'}"


def _number_places(
    screen: Float, faces: IntArray, part_of_face: IntArray, limits: Limits
) -> dict[int, tuple[float, float]]:
    """Return the middle of the widest visible spot of each part: screen ``(V, 3)``; faces ``(F, 3)``."""
    left, right, bottom, top = limits
    seen = _seen_parts(screen, faces, part_of_face, limits)
    rows, columns = seen.shape
    places = {}
    for part in np.unique(seen[seen >= 0]).tolist():
        depth = distance_transform_edt(np.pad(seen == part, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(depth.argmax(), depth.shape)
        if depth[row, column] >= _ROOM:
            x, y = (column + 0.5) / columns, (row + 0.5) / rows
            places[part] = left + x * (right - left), bottom + y * (top - bottom)
    return places


def _seen_parts(screen: Float, faces: IntArray, part_of_face: IntArray, limits: Limits) -> NDArray[np.int64]:
    """Paint part numbers from back to front: an image, lowest row first, -1 for background."""
    left, right, bottom, top = limits
    width = _PIXELS
    height = max(1, round(width * (top - bottom) / (right - left)))
    figure = matplotlib_module("figure").Figure(figsize=(width, height), dpi=1, facecolor="black")
    canvas = matplotlib_module("backends.backend_agg").FigureCanvasAgg(figure)
    ax = figure.add_axes((0, 0, 1, 1), xlim=(left, right), ylim=(bottom, top))
    ax.set_axis_off()
    order = np.argsort(screen[faces, 2].mean(axis=1), kind="stable")
    codes = (part_of_face[order, None] + 1) >> np.array([16, 8, 0]) & 255  # as red, green and blue
    ax.add_collection(
        matplotlib_module("collections").PolyCollection(
            screen[faces[order], :2], facecolors=codes / 255, edgecolors="none", antialiaseds=False
        )
    )
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(np.int64)
    return np.asarray(image @ [1 << 16, 1 << 8, 1] - 1)
