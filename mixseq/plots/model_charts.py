"""Charts of a model's signals: the embedding, coordinates over time, sizes of modes.

All are in diagonals, as distances in the shape space, without the placement of parts. With :math:`C` the frames
``(T, k)`` in pose space, centred, and :math:`G = L L^T` the Gram matrix of unit steps along the coordinates of pose
space in the shape space (the identity for principal components), the *singular values* of a model are those of
:math:`C L`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mixseq.arrays import Float, IntArray
from mixseq.errors import SettingsError
from mixseq.frame_numbers import number_at
from mixseq.plots.charts import FAINT, LINES, log_axis, round_frames, time_axis
from mixseq.plots.label_places import free_places
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.scene.camera import Limits
from mixseq.scene.palettes import INK
from mixseq.signals import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Scale = tuple[Callable[[Any], Any], Callable[[Any], Any]]

MARKED = 10
"""Number of frames labelled in the embedding by default."""

SHOWN = 5
"""Number of coordinates drawn over time, the largest ones."""

_INCHES = 4.5
"""Approximate length of the embedding's longer side, in inches."""

NEGLIGIBLE = 1e-13
"""Singular values below this fraction of the largest are rounding errors."""


def draw_embedding(ax: Axes, model: Model, frames: Sequence[int] | None = None) -> None:
    """Draw the time signal in the plane that shows most of it (paper, Figure 18)."""
    count = len(model.times)
    first = round(number_at(model.times[0], model.header.fps))
    marked = round_frames(count, MARKED, first) if frames is None else existing_frames(frames, count)
    curve, dots = model.embedding(dense_times(model)), model.embedding(model.times)
    x, y = dots.T
    ax.plot(*curve.T, color=FAINT, linewidth=1.2, zorder=2)
    shown = ax.scatter(
        x, y, c=model.times, s=24, cmap="viridis", edgecolors="white", linewidths=0.5, zorder=3
    )
    for frame, marker in ((0, "o"), (count - 1, "s")):
        ax.plot(*dots[frame], marker, ms=9, mfc="none", mec=INK, mew=1.2, zorder=4)

    left, right, bottom, top = limits = embedding_limits(model)
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", anchor="N")

    ends = {0: "start", count - 1: "end"} if count > 1 else {}
    texts = [f"{model.header.frame_number(frame)} {ends.get(frame, '')}".strip() for frame in marked]
    places = free_places(dots[marked], texts, curve, limits, max(right - left, top - bottom) / _INCHES)
    for frame, text, place in zip(marked, texts, places, strict=True):
        ax.annotate(
            text, dots[frame], place, textcoords="offset points", ha="center", va="center", fontsize=8
        )
    ax.set(
        title="Time signal: MDS embedding, frames numbered",
        xlabel="principal direction 1 (diagonals)",
        ylabel="principal direction 2 (diagonals)",
    )
    if count > 1:
        bar = ax.figure.colorbar(shown, cax=ax.inset_axes((1.03, 0.0, 0.03, 1.0)), label="time (s)")
        bar.outline.set_visible(False)


def embedding_limits(model: Model) -> Limits:
    """Return the rectangle of `draw_embedding`: the curve with space for labels, of moderate aspect."""
    points = np.concatenate([model.embedding(dense_times(model)), model.embedding(model.times)])
    low, high = points.min(axis=0), points.max(axis=0)
    half = (high - low) / 2
    longer = half.max() or 1.0
    (x, y), (width, height) = (low + high) / 2, np.maximum(half + 0.2 * longer, 0.65 * longer)
    return x - width, x + width, y - height, y + height


def draw_coefficients(ax: Axes, model: Model) -> None:
    """Draw the largest coordinates of the time signal over time, its knots as dots."""
    ax.set(title="Time signal: coefficients, knots as dots", ylabel="coordinate (diagonals)")
    if not model.time.dim:
        _tell(ax, "the model has no shape modes")
        return
    chosen, units = largest_coordinates(model)
    times = dense_times(model)
    knots = model.time.times[(model.time.times >= model.start) & (model.time.times <= model.end)]
    lines, dots = model.time(times)[:, chosen] * units, model.time(knots)[:, chosen] * units
    ax.axhline(0, color=FAINT, linewidth=0.8)
    for colour, number, line, dot in zip(LINES, chosen, lines.T, dots.T, strict=False):
        ax.plot(times, line, color=colour, linewidth=1.4, label=f"coordinate {number + 1}")
        ax.plot(knots, dot, "o", color=colour, markersize=3)
    time_axis(ax, model.start, model.end, model.header.fps)
    which = "" if len(chosen) == model.time.dim else f"\nthe largest {len(chosen)} of {model.time.dim}"
    title = f"{len(model.time.times)} knots{which}"
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), title=title, title_fontsize=8, alignment="left")


def draw_singular_values(ax: Axes, model: Model) -> None:
    """Draw the sizes of modes, and the rest without the later ones; on the right as share of the whole."""
    ax.set(title="Singular values", xlabel="mode", ylabel="size (diagonals)")
    sizes = singular_values(model)
    if not sizes.size:
        _tell(ax, "the model has no shape modes")
        return
    numbers = np.arange(1, len(sizes) + 1)
    rest = np.sqrt(np.cumsum(np.square(sizes[::-1])))[::-1][1:]  # norm of all later modes
    ax.plot(numbers, sizes, "o-", color=LINES[0], markersize=3.5, linewidth=0.8, label="the mode")
    if rest.size:
        ax.plot(numbers[:-1], rest, color=LINES[1], linewidth=1.4, label="all later modes together")
    log_axis(ax, np.concatenate([sizes, rest]))
    ax.set_xlim(0.5, max(len(sizes), 2) + 0.5)
    ax.xaxis.set_major_locator(matplotlib_module("ticker").MaxNLocator(integer=True, min_n_ticks=1))
    whole = float(np.linalg.norm(sizes))
    scale: Scale = (lambda size: 100 * size / whole, lambda percent: percent * whole / 100)
    share = ax.secondary_yaxis("right", functions=scale)
    share.set_ylabel("share of the whole (%)")
    share.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.legend(loc="upper right")


def largest_coordinates(model: Model) -> tuple[IntArray, Float]:
    """Return the time-signal coordinates ``(n,)`` of largest movement, at most `SHOWN`, and their units ``(n,)``."""
    units = np.sqrt(np.diagonal(_step_gram(model)))
    sizes = units * np.linalg.norm(_centred(model), axis=0)
    chosen = np.sort(np.argsort(-sizes, kind="stable")[:SHOWN])
    return chosen, units[chosen]


def singular_values(model: Model) -> Float:
    """Return the sizes ``(r,)`` of a model's modes in diagonals, decreasing; see the module."""
    if not model.time.dim:
        return np.zeros(0)
    squares, directions = np.linalg.eigh(_step_gram(model))
    roots = directions * np.sqrt(np.maximum(squares, 0.0))
    sizes = np.linalg.svd(_centred(model) @ roots, compute_uv=False)
    return np.asarray(sizes[sizes > NEGLIGIBLE * max(sizes.max(initial=0.0), np.finfo(np.float64).tiny)])


def existing_frames(frames: Sequence[int], count: int) -> list[int]:
    """Return distinct frames in order; SettingsError for those outside the model."""
    for frame in frames:
        if not 0 <= frame < count:
            raise SettingsError(f"there is no frame {frame}; frames are 0 to {count - 1}")
    return sorted(set(frames))


def dense_times(model: Model) -> Float:
    """Return times ``(N,)`` from start to end, dense enough for smooth lines."""
    knots = max(len(model.times), len(model.time.times))
    return np.linspace(model.start, model.end, min(max(400, 20 * knots), 20_000))


def _centred(model: Model) -> Float:
    coordinates = model.time(model.times)
    return np.asarray(coordinates - coordinates.mean(axis=0))


def _step_gram(model: Model) -> Float:
    """Return inner products ``(k, k)`` of unit steps along the coordinates of pose space."""
    shapes, metric = model.shapes, model.space.shape_weights
    steps = model.pose.matrix @ ((shapes - shapes.mean(axis=0)) * metric)
    return np.asarray(steps @ steps.T)


def _tell(ax: Axes, text: str) -> None:
    """Write the reason for an empty chart."""
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", fontsize=9)
    ax.set(xticks=[], yticks=[])
