"""Common parts of charts: style, line colours, logarithmic axes, and files as PNG or SVG."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import OutputError
from mixseq.frame_numbers import frames_between
from mixseq.plots.sheet_layout import DPI, Target, matplotlib_module
from mixseq.scene.palettes import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Format = Literal["png", "svg"]
FORMATS: tuple[Format, ...] = ("png", "svg")

LINES = ("#31688e", "#d08c2c", "#4a9d6e", "#8d5fa8", "#8a8a8a")
"""Colours of lines, different from the red of the joints."""

FAINT = "#b9b6b0"

_STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "figure.titlesize": 13,
    "grid.color": "#e6e4e0",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.labelcolor": INK,
    "svg.hashsalt": "mixseq",  # names of clip paths and the like, by chance without it
    "text.color": INK,
    "xtick.color": INK,
    "xtick.labelsize": 8,
    "ytick.color": INK,
    "ytick.labelsize": 8,
}


@contextmanager
def chart_style() -> Iterator[None]:
    """Set one style inside the block, independent of the user's matplotlib settings."""
    with matplotlib_module("style").context(["default", _STYLE]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # names may be in any script
        yield


def new_page(width: float, height: float, title: str) -> Figure:
    """Return an empty page of a size in inches, with automatic layout of panels."""
    engine = matplotlib_module("layout_engine").ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1)
    page: Figure = matplotlib_module("figure").Figure(figsize=(width, height), layout=engine)
    matplotlib_module("backends.backend_agg").FigureCanvasAgg(page)
    page.suptitle(title, x=0.1 / width, ha="left", parse_math=False)
    return page


def picture_format(target: Target, chosen: Format | None = None) -> Format:
    """Return the format of a picture: as given, or by the extension of its file; PNG for files without a name."""
    if chosen is None and not isinstance(target, str | PathLike):
        return "png"
    extension = chosen or Path(str(target)).suffix.lower().removeprefix(".")
    for known in FORMATS:
        if extension == known:
            return known
    where = f"{target}: " if chosen is None else ""
    raise OutputError(f"{where}pictures are PNG or SVG files; end the name in .png or .svg")


def save_page(page: Figure, target: Target, file_format: Format) -> None:
    """Write a page, without date and version, so that equal pictures are equal files."""
    nameless: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}
    page.savefig(target, format=file_format, dpi=DPI, metadata=nameless[file_format])


def log_axis(ax: Axes, values: Float, least_decades: int = 2) -> None:
    """Make the y axis logarithmic, in whole decades around positive values, so that ticks have labels."""
    low, high = np.floor(np.log10(values.min())), np.ceil(np.log10(values.max()))
    low = min(low, high - least_decades)
    ax.set_yscale("log")
    ax.set_ylim(10.0**low, 10.0**high)


def time_axis(ax: Axes, start: float, end: float, fps: float | None = None) -> None:
    """Set the x axis to the time from start to end, with a margin for dots; with frame numbers if a rate is given."""
    ax.set_xlabel("time (s)" if fps is None else f"time (s), {frames_between(start, end, fps)}")
    if end > start:
        ax.set_xlim(start - 0.01 * (end - start), end + 0.01 * (end - start))


def round_frames(count: int, most: int, first: int = 0) -> list[int]:
    """Choose up to `most` of `count` frames: the first, the last, and those of round numbers, counted from `first`."""
    tens = 10 ** np.arange(len(str(count)))
    step = next(step for step in np.outer(tens, [1, 2, 5, 10]).ravel().tolist() if count <= step * most)
    last = count - 1
    inner = range(-first % step or step, last, step)
    return [0, *(frame for frame in inner if frame > step // 2 and last - frame > step // 2), last][-count:]
