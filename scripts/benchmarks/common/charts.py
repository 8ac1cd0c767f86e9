"""The plot of the measurements: cost of a vertex against their number, and ratios with their targets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scripts.benchmarks.common.section import Bar, Line, Section

MET, MISSED, WANTED = "#2a6f97", "#c44536", "#222222"


def draw(sections: Sequence[Section], path: Path) -> None:
    """Draw both side by side; what was not measured is left out."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    lines = [line for section in sections for line in section.lines]
    bars = [bar for section in sections for bar in section.bars]
    figure, (left, right) = pyplot.subplots(
        1, 2, figsize=(13, 1.5 + max(3.5, 0.28 * len(bars))), width_ratios=(1, 1.3), layout="constrained"
    )
    panels: tuple[tuple[Any, Any, Any], ...] = ((left, lines, _costs), (right, bars, _ratios))
    for axes, what, plot in panels:
        if what:
            plot(axes, what)
        else:
            axes.set_axis_off()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def _costs(ax: Any, lines: Sequence[Line]) -> None:
    for line, marker in zip(lines, "os^v", strict=False):
        x, y = zip(*line.points, strict=True)
        ax.plot(x, y, marker=marker, label=line.label)
    ax.set(xscale="log", yscale="log", xlabel="vertices", ylabel="microseconds per vertex and frame")
    ax.set_title("Cost per vertex; level = linear")
    ax.grid(alpha=0.3, which="both")
    ax.legend(frameon=False)


def _ratios(ax: Any, bars: Sequence[Bar]) -> None:
    places = range(len(bars))
    colours = [MET if bar.value >= bar.target else MISSED for bar in bars]
    ax.barh(places, [bar.value for bar in bars], color=colours, height=0.7)
    for place, bar in zip(places, bars, strict=True):
        ax.plot([bar.target] * 2, [place - 0.45, place + 0.45], color=WANTED, linewidth=2)
        ax.annotate(f" {bar.value:.3g}", (bar.value, place), va="center", fontsize=8)
    ax.set_yticks(places, [bar.label for bar in bars], fontsize=8)
    ax.invert_yaxis()
    ax.set(xscale="log", xlabel="times faster")
    ax.set_title("Ratios; the black line is the target")
    ax.margins(x=0.12)
