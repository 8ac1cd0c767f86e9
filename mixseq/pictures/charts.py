"""Draw charts of a model's signals: embedding, coordinates over time, singular values; return their data for pages.

Values are distances in the shape space in diagonals, without the placement of parts. Let :math:`C` be the centred
frames ``(T, k)`` in pose space, and :math:`G = L L^T` the Gram matrix of unit steps along its coordinates (the identity
for principal components). The *singular values* of a model are the singular values of :math:`C L`.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.operations.sketch import default_reach
from mixseq.pictures.raster import DOTS_PER_INCH
from mixseq.pictures.scene import INK_COLOUR, Limits
from mixseq.sequence.frame_rates import format_frame_range, time_to_number
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, IntArray, evenly_spaced

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MAX_CHART_POINTS = 800
"""Largest number of points of a chart line, about two per pixel."""

MAX_CHART_FRAMES = 300
"""Largest number of frames that are drawn as dots."""

HANDLE_COUNT = 13
"""Number of draggable points of the time curve, evenly spaced in time; more would crowd a small chart."""

SIGNIFICANT_DIGITS = 5
"""Significant digits of the largest chart value, sufficient for a screen of 4000 pixels."""


def chart_data(model: Model, plane: Plane | None = None) -> dict[str, Any]:
    """Return the chart data of a model as values that JSON can hold."""
    start, end = model.start, model.end
    has_motion = end > start and model.time.dim > 0
    times = dense_times(model) if end > start else np.array([start])
    times = times[evenly_spaced(len(times), MAX_CHART_POINTS)]
    frames = model.times[evenly_spaced(len(model.times), MAX_CHART_FRAMES)]
    handles = np.linspace(start, end, HANDLE_COUNT) if has_motion else np.zeros(0)
    coordinate_ids, units = largest_coordinates(model)
    lines = model.time(times)[:, coordinate_ids] * units
    keys = np.linspace(start, end, 5).tolist() if end > start else []
    path = model.embedding(times, plane)
    extent = float(np.abs(path).max(initial=0.0))
    positions = _round(model.embedding(handles, plane), extent)
    return {
        "start": start,
        "end": end,
        "fps": model.header.fps,
        "times": _round(times, end - start),
        "path": _round(path, extent),
        "frames": _round(model.embedding(frames, plane), extent),
        "frameTimes": _round(frames, end - start),
        "handles": [{"time": time, "at": at} for time, at in zip(handles.tolist(), positions, strict=True)],
        "reach": default_reach(model),
        "coefficients": [
            {"name": f"coordinate {number + 1}", "values": _round(line, float(np.abs(lines).max()))}
            for number, line in zip(coordinate_ids.tolist(), lines.T, strict=True)
        ],
        "keys": [[time, time] for time in keys],
    }


def _round(values: Float, largest: float) -> list[Any]:
    """Round values to the decimals that give `largest` `SIGNIFICANT_DIGITS` digits, and return them as lists."""
    decimals = SIGNIFICANT_DIGITS - int(np.ceil(np.log10(largest))) if largest > 0 else SIGNIFICANT_DIGITS
    rounded: list[Any] = (np.round(values, min(max(decimals, 0), 15)) + 0.0).tolist()
    return rounded


def largest_coordinates(model: Model) -> tuple[IntArray, Float]:
    """Return the 5 time-signal coordinates ``(n,)`` that move most, and their units ``(n,)`` in diagonals."""
    units = np.sqrt(np.diagonal(_step_gram(model)))
    sizes = units * np.linalg.norm(_centred(model), axis=0)
    coordinate_ids = np.sort(np.argsort(-sizes, kind="stable")[:5])
    return coordinate_ids, units[coordinate_ids]


def singular_values(model: Model) -> Float:
    """Return the singular values ``(r,)`` of a model's modes in diagonals, in descending order."""
    if not model.time.dim:
        return np.zeros(0)
    squares, directions = np.linalg.eigh(_step_gram(model))
    roots = directions * np.sqrt(np.maximum(squares, 0.0))
    sizes = np.linalg.svd(_centred(model) @ roots, compute_uv=False)
    # smaller ones are rounding errors
    return np.asarray(sizes[sizes > 1e-13 * max(sizes.max(initial=0.0), np.finfo(np.float64).tiny)])


def dense_times(model: Model) -> Float:
    """Return times ``(N,)`` from the start to the end of a model, dense enough for smooth lines."""
    knots = max(len(model.times), len(model.time.times))
    return np.linspace(model.start, model.end, min(max(400, 20 * knots), 20_000))


def _centred(model: Model) -> Float:
    coordinates = model.time(model.times)
    return np.asarray(coordinates - coordinates.mean(axis=0))


def _step_gram(model: Model) -> Float:
    """Return the Gram matrix ``(k, k)`` of unit steps along the coordinates of pose space."""
    shapes, metric = model.shapes, model.space.shape_weights
    steps = model.pose.matrix @ ((shapes - shapes.mean(axis=0)) * metric)
    return np.asarray(steps @ steps.T)


Target = str | PathLike[str] | IO[bytes]


def import_matplotlib(name: str) -> Any:
    """Import a module of matplotlib when it is first needed."""
    try:
        return import_module(f"matplotlib.{name}")
    except ImportError as error:
        raise MissingExtraError("pictures need matplotlib; get it with: pip install 'mixseq[plot]'") from error


def error_map(top: float, low: float = 0.0) -> Any:
    """Return a matplotlib ScalarMappable that maps errors from 0, or values from `low`, to `top` to colours."""
    return import_matplotlib("cm").ScalarMappable(import_matplotlib("colors").Normalize(low, top), "viridis")


POINTS_PER_INCH = 72.0
LABEL_DISTANCE_POINTS = 12.0
"""Distance from a dot to the centre of its label."""

_HALF_CHARACTER_POINTS = np.array([2.6, 5.0])
"""Half the width of a character and half the height of a text line."""


def label_offsets(
    dots: Float, texts: Sequence[str], curve: Float, limits: Limits, inch: float
) -> list[tuple[float, float]]:
    """Return offsets in points of labels from dots ``(n, 2)``, to keep labels off a curve ``(N, 2)`` and each other."""
    scale = POINTS_PER_INCH / inch
    low, high = np.reshape(limits, (2, 2)).T * scale
    curve_centre = curve.mean(axis=0) * scale
    angles = np.arange(16) * np.pi / 8
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    placed: list[tuple[Float, Float]] = []  # centres and half sizes of labels
    best_offsets = []
    for dot, text in zip(dots * scale, texts, strict=True):
        size = _HALF_CHARACTER_POINTS * [len(text), 1]
        distance = LABEL_DISTANCE_POINTS
        offsets = directions * [distance + size[0] - _HALF_CHARACTER_POINTS[0], distance]
        centres = dot + offsets
        clearance = _box_distances(centres, size, curve * scale).min(axis=1)
        to_edge = np.minimum(centres - size - low, high - centres - size).min(axis=1)
        clearance = np.minimum(clearance, to_edge)
        for other, other_size in placed:
            clearance = np.minimum(clearance, _box_distances(centres, size + other_size, other[None])[:, 0])
        outward = (directions @ (dot - curve_centre)) / (np.linalg.norm(dot - curve_centre) or 1.0)
        best = int((np.minimum(clearance, 5.0) + outward).argmax())  # more clearance is not better
        placed.append((centres[best], size))
        best_offsets.append((float(offsets[best, 0]), float(offsets[best, 1])))
    return best_offsets


def _box_distances(centres: Float, half_size: Float, points: Float) -> Float:
    """Return distances ``(n, N)`` of points ``(N, 2)`` from boxes around centres ``(n, 2)``, negative inside a box."""
    distances = np.abs(points[None] - centres[:, None]) - half_size
    return np.asarray(distances.max(axis=2))


Format = Literal["png", "svg"]
FORMATS: tuple[Format, ...] = get_args(Format)

LINE_COLOURS = ("#31688e", "#d08c2c", "#4a9d6e", "#8d5fa8", "#8a8a8a")
"""Colours of lines, all different from the red of joints."""

FAINT_COLOUR = "#b9b6b0"

_CHART_STYLE = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK_COLOUR,
    "axes.grid": True,
    "axes.labelcolor": INK_COLOUR,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlecolor": INK_COLOUR,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "figure.titlesize": 13,
    "grid.color": "#e6e4e0",
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.labelcolor": INK_COLOUR,
    "svg.hashsalt": "mixseq",  # makes the names of clip paths reproducible
    "text.color": INK_COLOUR,
    "xtick.color": INK_COLOUR,
    "xtick.labelsize": 8,
    "ytick.color": INK_COLOUR,
    "ytick.labelsize": 8,
}


@contextmanager
def chart_style() -> Iterator[None]:
    """Use the style of charts inside the ``with`` block, independent of the user's matplotlib settings."""
    with import_matplotlib("style").context(["default", _CHART_STYLE]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)  # names in any script
        yield


def new_page(width: float, height: float, title: str) -> Figure:
    """Return an empty page of the given size in inches, with constrained layout."""
    engine = import_matplotlib("layout_engine").ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.1)
    page: Figure = import_matplotlib("figure").Figure(figsize=(width, height), layout=engine)
    page.suptitle(title, x=0.1 / width, ha="left", parse_math=False)
    return page


def picture_format(target: Target, chosen: Format | None = None) -> Format:
    """Return the chosen picture format, by default that of the file extension, or PNG for files without a name."""
    if chosen is None and not isinstance(target, str | PathLike):
        return "png"
    extension = chosen or Path(str(target)).suffix.lower().removeprefix(".")
    for known in FORMATS:
        if extension == known:
            return known
    where = f"{target}: " if chosen is None else ""
    raise OutputError(f"{where}pictures are PNG or SVG files; end the name in .png or .svg")


def save_page(page: Figure, target: Target, file_format: Format) -> None:
    """Write a page without metadata, so that equal pictures give identical files."""
    no_metadata: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}
    page.savefig(target, format=file_format, dpi=DOTS_PER_INCH, metadata=no_metadata[file_format])


def log_axis(ax: Axes, values: Float) -> None:
    """Make the y axis logarithmic over two or more whole decades around positive values, so that ticks have labels."""
    low, high = np.floor(np.log10(values.min())), np.ceil(np.log10(values.max()))
    low = min(low, high - 2)
    ax.set_yscale("log")
    ax.set_ylim(10.0**low, 10.0**high)


def time_axis(ax: Axes, start: float, end: float, fps: float | None = None) -> None:
    """Label the x axis with times, and with frame numbers if `fps` is given; leave a margin for dots."""
    ax.set_xlabel("time (s)" if fps is None else f"time (s), {format_frame_range(start, end, fps)}")
    if end > start:
        ax.set_xlim(start - 0.01 * (end - start), end + 0.01 * (end - start))


def round_frames(count: int, max_count: int, first: int = 0) -> list[int]:
    """Return up to `max_count` of `count` frames: first, last, and frames with round numbers counted from `first`."""
    tens = 10 ** np.arange(len(str(count)))
    step = next(step for step in np.outer(tens, [1, 2, 5, 10]).ravel().tolist() if count <= step * max_count)
    last = count - 1
    inner = range(-first % step or step, last, step)
    return [0, *(frame for frame in inner if frame > step // 2 and last - frame > step // 2), last][-count:]


def draw_embedding(ax: Axes, model: Model, frames: Sequence[int] | None = None) -> None:
    """Draw the time signal in the plane of its first two principal directions (paper, Figure 18)."""
    count = len(model.times)
    first = round(time_to_number(model.times[0], model.header.fps))
    default = round_frames(count, 10, first)
    labelled = default if frames is None else check_frames(frames, count)
    curve, dots = model.embedding(dense_times(model)), model.embedding(model.times)
    x, y = dots.T
    ax.plot(*curve.T, color=FAINT_COLOUR, linewidth=1.2, zorder=2)
    scatter = ax.scatter(x, y, c=model.times, s=24, cmap="viridis", edgecolors="white", linewidths=0.5, zorder=3)
    for frame, marker in ((0, "o"), (count - 1, "s")):
        ax.plot(*dots[frame], marker, ms=9, mfc="none", mec=INK_COLOUR, mew=1.2, zorder=4)

    left, right, bottom, top = limits = embedding_limits(model)
    ax.update_datalim([(left, bottom), (right, top)])
    ax.set(xmargin=0, ymargin=0, aspect="equal", adjustable="datalim")

    ends = {0: "start", count - 1: "end"} if count > 1 else {}
    texts = [f"{model.header.frame_number(frame)} {ends.get(frame, '')}".strip() for frame in labelled]
    inch = max(right - left, top - bottom) / 4.5  # the longer side has about 4.5 inches
    offsets = label_offsets(dots[labelled], texts, curve, limits, inch)
    for frame, text, offset in zip(labelled, texts, offsets, strict=True):
        ax.annotate(text, dots[frame], offset, textcoords="offset points", ha="center", va="center", fontsize=8)
    ax.set(
        title="Time signal: MDS embedding, frames numbered",
        xlabel="principal direction 1 (diagonals)",
        ylabel="principal direction 2 (diagonals)",
    )
    if count > 1:
        bar = ax.figure.colorbar(scatter, cax=ax.inset_axes((1.03, 0.0, 0.03, 1.0)), label="time (s)")
        bar.outline.set_visible(False)


def embedding_limits(model: Model) -> Limits:
    """Return the axis limits of `draw_embedding`, a rectangle around the curve with space for labels."""
    points = np.concatenate([model.embedding(dense_times(model)), model.embedding(model.times)])
    low, high = points.min(axis=0), points.max(axis=0)
    half_size = (high - low) / 2
    longest = half_size.max() or 1.0
    (x, y), (width, height) = (low + high) / 2, np.maximum(half_size + 0.2 * longest, 0.65 * longest)
    return x - width, x + width, y - height, y + height


def draw_coefficients(ax: Axes, model: Model) -> None:
    """Draw the time-signal coordinates with the largest movement over time, with knots as dots."""
    ax.set(title="Time signal: coefficients, knots as dots", ylabel="coordinate (diagonals)")
    if not model.time.dim:
        _note_no_modes(ax)
        return
    coordinate_ids, units = largest_coordinates(model)
    times = dense_times(model)
    knots = model.time.times[(model.time.times >= model.start) & (model.time.times <= model.end)]
    lines, dots = model.time(times)[:, coordinate_ids] * units, model.time(knots)[:, coordinate_ids] * units
    ax.axhline(0, color=FAINT_COLOUR, linewidth=0.8)
    for colour, number, line, dot in zip(LINE_COLOURS, coordinate_ids, lines.T, dots.T, strict=False):
        ax.plot(times, line, color=colour, linewidth=1.4, label=f"coordinate {number + 1}")
        ax.plot(knots, dot, "o", color=colour, markersize=3)
    time_axis(ax, model.start, model.end, model.header.fps)
    title = f"{len(model.time.times)} knots"
    if len(coordinate_ids) < model.time.dim:
        title += f"\nthe largest {len(coordinate_ids)} of {model.time.dim}"
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title=title, title_fontsize=8, alignment="left")


def draw_singular_values(ax: Axes, model: Model) -> None:
    """Draw each singular value and the norm of all later values; the right axis is in percent of the total norm."""
    ax.set(title="Singular values", xlabel="mode", ylabel="size (diagonals)")
    sizes = singular_values(model)
    if not sizes.size:
        _note_no_modes(ax)
        return
    modes = np.arange(1, len(sizes) + 1)
    remainder = np.sqrt(np.cumsum(np.square(sizes[::-1])))[::-1][1:]
    ax.plot(modes, sizes, "o-", color=LINE_COLOURS[0], markersize=3.5, linewidth=0.8, label="the mode")
    if remainder.size:
        ax.plot(modes[:-1], remainder, color=LINE_COLOURS[1], linewidth=1.4, label="all later modes together")
    log_axis(ax, np.concatenate([sizes, remainder]))
    ax.set_xlim(0.5, max(len(sizes), 2) + 0.5)
    ax.xaxis.set_major_locator(import_matplotlib("ticker").MaxNLocator(integer=True, min_n_ticks=1))
    total = float(np.linalg.norm(sizes))
    scale: Any = (lambda size: 100 * size / total, lambda percent: percent * total / 100)
    percent_axis = ax.secondary_yaxis("right", functions=scale)
    percent_axis.set_ylabel("share of the whole (%)")
    percent_axis.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.legend(loc="upper right")


def check_frames(frames: Sequence[int], count: int) -> list[int]:
    """Return the distinct frames, sorted; raise SettingsError for frames outside the model."""
    for frame in frames:
        if not 0 <= frame < count:
            raise SettingsError(f"there is no frame {frame}; choose frames from 0 to {count - 1}")
    return sorted(set(frames))


def _note_no_modes(ax: Axes) -> None:
    ax.text(0.5, 0.5, "the model has no shape modes", transform=ax.transAxes, ha="center", va="center", fontsize=9)
    ax.set(xticks=[], yticks=[])
