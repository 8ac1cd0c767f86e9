"""Drawing with matplotlib: pages of equal panels, and a shaded mesh in one of them, from back to front."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from os import PathLike
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MissingExtraError
from mixseq.mesh.topology import Topology
from mixseq.pictures.colours import CLAY_COLOUR, INK_COLOUR
from mixseq.pictures.raster import area_normals, ground_shadow, shade, smooth_normals
from mixseq.pictures.scene import Limits, View, shared_limits, three_quarter_view, to_y_up
from mixseq.types import Float, FloatArray, Index, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


Target = str | PathLike[str] | IO[bytes]

DPI = 150
WIDTH = 12.0  # inches, as are all lengths here
GAP = 0.15
BOTTOM = 0.1


@dataclass(frozen=True, eq=False)
class Sheet:
    """A page with rows of equal panels."""

    figure: Figure  # the page
    panels: list[list[Axes]]  # the panels, row by row, without frames

    @classmethod
    def from_grid(
        cls, rows: int, columns: int, aspect: float, title: str, left: float = 0.1, right: float = 0.1
    ) -> Sheet:
        """Lay out a page of panels with a height per width, moderated; margins left and right in inches."""
        top = 0.65 if title else 0.3
        width = (WIDTH - left - right) / columns
        height = width * float(np.clip(aspect, 0.3, 2.5))
        page = top + rows * (height + GAP) - GAP + BOTTOM

        figure: Figure = import_matplotlib("figure").Figure(figsize=(WIDTH, page), facecolor="white")
        figure.text(0.1 / WIDTH, 1 - 0.1 / page, title, fontsize=13, color=INK_COLOUR, va="top")

        def panel(row: int, column: int) -> Axes:
            x, y = left + column * width, BOTTOM + (rows - 1 - row) * (height + GAP)
            ax = figure.add_axes((x / WIDTH, y / page, width / WIDTH, height / page))
            ax.set_axis_off()
            return ax

        return cls(figure, [[panel(row, column) for column in range(columns)] for row in range(rows)])

    def label_row(self, row: int, text: str) -> None:
        """Label a row on its left."""
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
        place = box.x1 + 0.08 / WIDTH, box.y0 + 0.1 * box.height, 0.12 / WIDTH, 0.8 * box.height
        bar = self.figure.colorbar(mappable, cax=self.figure.add_axes(place), ticks=ticker.LinearLocator(3))
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")
        bar.ax.tick_params(labelsize=7, colors=INK_COLOUR, length=2)
        bar.outline.set_visible(False)
        bar.set_label(label, fontsize=7, color=INK_COLOUR)

    def save(self, target: Target) -> None:
        """Write the PNG without date and version, so that equal pictures are equal files."""
        self.figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})


def import_matplotlib(name: str) -> Any:
    """Import a module of matplotlib on first use."""
    try:
        return import_module(f"matplotlib.{name}")
    except ImportError as error:
        raise MissingExtraError(
            "pictures need matplotlib; get it with: pip install 'mixseq[plot]'"
        ) from error


def error_map(top: float) -> Any:
    """Return the colours of errors from 0 to `top`, a matplotlib ScalarMappable."""
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
        Where to draw; its aspect becomes equal and its frame disappears.
    points : (V, 3) float
        Vertex positions.
    faces : (F, 3) int
        Triangles. Closed meshes are drawn without back faces, open ones from both sides.
    colours : (3,) or (F, 3) float
        RGB in 0..1 of the mesh or of each face.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    view : View, optional
        The camera, by default `three_quarter_view`.
    limits : (4,) float, optional
        Screen rectangle from `shared_limits`, by default that of this pose.
    ground : float, optional
        Height of the ground that takes the shadow, by default the lowest vertex.
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
    """Sort faces for painting; back faces of a closed mesh are left out."""
    corners = screen[faces]
    inside_out = np.sum((corners[:, 0] - screen.mean(axis=0)) * normals) < 0
    hidden = (normals[:, 2] >= 0) if inside_out else (normals[:, 2] <= 0)
    # at the outline of an open mesh, front faces go above the back faces next to them
    depth = corners[..., 2].mean(axis=1) - 0.03 * np.ptp(screen[:, 2]) * hidden
    order = np.argsort(depth, kind="stable")
    topology = Topology(faces, len(screen))
    loose = topology.boundary_edges, topology.non_manifold_edges, topology.inconsistent_edges
    return order if any(edges.size for edges in loose) else order[~hidden[order]]
