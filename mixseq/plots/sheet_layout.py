"""Sheets of panels: layout of the page, and output as PNG."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from os import PathLike
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from mixseq.errors import MissingExtraError
from mixseq.scene.palettes import INK

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
    def of(
        cls, rows: int, columns: int, aspect: float, title: str, left: float = 0.1, right: float = 0.1
    ) -> Sheet:
        """Lay out a page of panels with a height per width, moderated; margins left and right in inches."""
        top = 0.65 if title else 0.3
        width = (WIDTH - left - right) / columns
        height = width * float(np.clip(aspect, 0.3, 2.5))
        page = top + rows * (height + GAP) - GAP + BOTTOM

        figure: Figure = matplotlib_module("figure").Figure(figsize=(WIDTH, page), facecolor="white")
        matplotlib_module("backends.backend_agg").FigureCanvasAgg(figure)
        figure.text(0.1 / WIDTH, 1 - 0.1 / page, title, fontsize=13, color=INK, va="top")

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
            color=INK,
        )

    def add_colour_bar(self, mappable: Any, label: str) -> None:
        """Add a colour bar in scientific notation to the right of the last row."""
        ticker = matplotlib_module("ticker")
        box = self.panels[-1][-1].get_position(original=True)
        place = box.x1 + 0.08 / WIDTH, box.y0 + 0.1 * box.height, 0.12 / WIDTH, 0.8 * box.height
        bar = self.figure.colorbar(mappable, cax=self.figure.add_axes(place), ticks=ticker.LinearLocator(3))
        bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")
        bar.ax.tick_params(labelsize=7, colors=INK, length=2)
        bar.outline.set_visible(False)
        bar.set_label(label, fontsize=7, color=INK)

    def save(self, target: Target) -> None:
        """Write the PNG without date and version, so that equal pictures are equal files."""
        self.figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})


def matplotlib_module(name: str) -> Any:
    """Import a module of matplotlib on first use."""
    try:
        return import_module(f"matplotlib.{name}")
    except ImportError as error:
        raise MissingExtraError(
            "pictures need matplotlib; get it with: pip install 'mixseq[plot]'"
        ) from error
