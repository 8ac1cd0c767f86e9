"""Draw shaded meshes with matplotlib on pages of equal panels; faces are sorted from back to front."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from os import PathLike
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MissingExtraError
from mixseq.mesh.topology import Topology
from mixseq.pictures.raster import area_normals, ground_shadow, shade, smooth_normals
from mixseq.pictures.scene import CLAY_COLOUR, INK_COLOUR, Limits, View, shared_limits, three_quarter_view, to_y_up
from mixseq.types import Float, FloatArray, Index, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Target = str | PathLike[str] | IO[bytes]

DOTS_PER_INCH = 150
PAGE_WIDTH = 12.0  # in inches, like all page lengths
ROW_GAP = 0.15
BOTTOM_MARGIN = 0.1


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
        top = 0.65 if title else 0.3
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


def import_matplotlib(name: str) -> Any:
    """Import a module of matplotlib when it is first needed."""
    try:
        return import_module(f"matplotlib.{name}")
    except ImportError as error:
        raise MissingExtraError("pictures need matplotlib; get it with: pip install 'mixseq[plot]'") from error


def error_map(top: float) -> Any:
    """Return a matplotlib ScalarMappable that maps errors from 0 to `top` to colours."""
    return import_matplotlib("cm").ScalarMappable(import_matplotlib("colors").Normalize(0, top), "viridis")


def draw_mesh(
    ax: Axes,
    points: FloatArray,
    faces: IntArray,
    colours: ArrayLike = CLAY_COLOUR,
    up_axis: str = "Y",
    view: View | None = None,
    limits: Limits | None = None,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a shaded mesh.

    Parameters
    ----------
    ax : matplotlib Axes
        Axes to draw on. The aspect is set to equal and the frame is removed.
    points : (V, 3) float
        Vertex positions.
    faces : (F, 3) int
        Triangles. Back faces are drawn for open meshes only.
    colours : (3,) or (F, 3) float
        RGB in 0..1 of the mesh or of each face.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    view : View, optional
        The camera, by default `three_quarter_view`.
    limits : (4,) float, optional
        Screen rectangle from `shared_limits`, by default the rectangle around this pose.
    ground : float, optional
        Height of the ground, on which the shadow falls; by default the height of the lowest vertex.
    contrast : float
        Strength of the shading, from 0 (flat colours) to 1.
    """
    view = view or three_quarter_view(points, up_axis)
    limits = limits or shared_limits(points, up_axis, view)
    world = to_y_up(points, up_axis)
    floor = float(world[:, 1].min()) if ground is None else ground
    shadow = ground_shadow(world, faces, floor, view, limits)
    ax.imshow(shadow, extent=limits, origin="lower", interpolation="bilinear", zorder=1)

    screen = world @ view.rotation.T
    normals = area_normals(screen, faces)
    order = _back_to_front(screen, faces, normals)
    to_camera = np.where(normals[:, 2:] < 0, -1, 1)
    rgb = np.broadcast_to(np.asarray(colours, dtype=np.float64), (len(faces), 3))
    lit = shade(rgb, to_camera * smooth_normals(normals, faces, len(points)), contrast)[order]
    polygons = import_matplotlib("collections").PolyCollection(
        screen[faces[order], :2], facecolors=lit, edgecolors=lit, linewidths=0.25, zorder=2
    )
    ax.add_collection(polygons, autolim=False)
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
    ax.set_axis_off()


def _back_to_front(screen: Float, faces: IntArray, normals: Float) -> Index:
    """Return the indices of faces to draw, sorted from back to front; back faces of closed meshes are omitted."""
    corners = screen[faces]
    is_inside_out = np.sum((corners[:, 0] - screen.mean(axis=0)) * normals) < 0
    is_back_face = (normals[:, 2] >= 0) if is_inside_out else (normals[:, 2] <= 0)
    # shift back faces slightly backwards, behind adjacent front faces at the outline of an open mesh
    depth = corners[..., 2].mean(axis=1) - 0.03 * np.ptp(screen[:, 2]) * is_back_face
    order = np.argsort(depth, kind="stable")
    topology = Topology(faces, len(screen))
    open_edges = topology.boundary_edges, topology.non_manifold_edges, topology.inconsistent_edges
    return order if any(edges.size for edges in open_edges) else order[~is_back_face[order]]
