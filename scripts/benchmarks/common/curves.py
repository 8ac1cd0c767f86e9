"""Rate-distortion curves: a panel for each sequence, a line for each coder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from scripts.benchmarks.common.rate_report import OURS, Measured
from scripts.benchmarks.common.rates import Measure, staircase

COLUMNS = 3
LOOKS = {
    "ours": ("#c44536", "o"),
    "trajectory": ("#2a6f97", "s"),
    "shape": ("#61a5c2", "D"),
    "differences": ("#8a817c", "v"),
    "draco": ("#6a994e", "^"),
    "bones": ("#bc6c25", "P"),
}
"""Colour and marker; what has no look, such as uncompressed caches, has one point and is not drawn."""

AXES: Mapping[Measure, tuple[str, float, float]] = {
    "kg_percent": ("KG error, %", 0.01, 3),
    "max_error": ("largest error, diagonals", 3e-5, 5e-2),
}
FILES: Mapping[Measure, str] = {"kg_percent": "compress-kg.png", "max_error": "compress-max-error.png"}


def draw_curves(sequences: Sequence[Measured], titles: Mapping[str, str], folder: Path) -> None:
    """Draw bits per vertex and frame against both errors, into two files."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import LogLocator, NullFormatter

    folder.mkdir(parents=True, exist_ok=True)
    for measure, (label, low, high) in AXES.items():
        columns = min(COLUMNS, len(sequences))
        rows = -(-len(sequences) // columns)
        figure, axes = pyplot.subplots(
            rows, columns, figsize=(4.4 * columns, 3.4 * rows + 0.6), squeeze=False, layout="constrained"
        )
        lines = {}
        for ax, each in zip(axes.flat, sequences, strict=False):
            for name in [name for name in LOOKS if each.points.get(name)]:
                colour, marker = LOOKS[name]
                points = staircase(each.points[name], measure)
                shown = [(error, bits) for error, bits in points if low <= error <= high]
                if shown:
                    bold = name == OURS
                    (lines[name],) = ax.plot(
                        *zip(*shown, strict=True),
                        color=colour,
                        marker=marker,
                        markersize=5 if bold else 3.5,
                        linewidth=2.2 if bold else 1.2,
                        zorder=3 if bold else 2,
                    )
            ax.set(xscale="log", yscale="log", xlim=(low, high), xlabel=label, ylabel="bits / vertex / frame")
            ax.set_title(f"{each.name} ({each.vertices} vertices, {each.frames} frames)", fontsize=10)
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
            if measure == "kg_percent":
                ax.xaxis.set_major_formatter("{x:g}")
            ax.grid(alpha=0.25, which="both", linewidth=0.6)
        for ax in axes.flat[len(sequences) :]:
            ax.set_axis_off()
        known = [name for name in LOOKS if name in lines]
        figure.legend(
            [lines[name] for name in known],
            [titles[name] for name in known],
            loc="outside upper center",
            ncols=min(len(known), 3),
            frameon=False,
        )
        figure.savefig(folder / FILES[measure], dpi=110)
        pyplot.close(figure)
