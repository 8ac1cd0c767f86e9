"""How far a blend is from the blended lengths and angles: the measure of the paper (after Winkler et al. 2010).

The error of an edge is its length over the wanted one, minus 1; that of a hinge is the difference in degrees. The
*band* of a share of the edges is from the smallest to the largest error of those whose absolute error is below the
quantile of that share.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.types import Float
from scripts.benchmarks.common.harness import markdown_table
from scripts.paper_study.common.poses import APART, PATH, Poses
from scripts.paper_study.common.record import Json, Results

LENGTH_SHARES = (1.0, 0.999, 0.99)
ANGLE_SHARES = (1.0, 0.9999, 0.999, 0.99)
"""The paper draws 100, 99.9 and 99 % of the edges, and 100, 99.99 and 99.9 % of the angles."""

ROUNDING = 1e-6  # errors below this are shown as none
FOLDED = 0.6  # ratio of distances of points along a limb below which a blend counts as folded


class Errors(NamedTuple):
    """Errors of all edges ``(e,)`` and hinges ``(h,)``, in degrees, and the smallest ratio of distances along limbs."""

    strain: Float
    degrees: Float
    nearest: float = 1.0

    def at(self, share: float) -> tuple[float, float]:
        """Return the quantiles of both, absolute."""
        return float(np.quantile(np.abs(self.strain), share)), float(np.quantile(np.abs(self.degrees), share))

    def bands(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Return the bands of all shares, of lengths and of angles."""
        return [band(self.strain, s) for s in LENGTH_SHARES], [band(self.degrees, s) for s in ANGLE_SHARES]

    def summary(self) -> Json:
        """Return the quantiles at 99 %, 99.9 % and 100 % as plain data."""
        lengths, degrees = zip(*map(self.at, (0.99, 0.999, 1.0)), strict=True)
        return {"lengths": lengths, "degrees": degrees, "nearest": self.nearest}


def errors(poses: Poses, weights: Float, points: Float) -> Errors:
    """Compare a blend ``(V, 3)`` of poses with what it should be."""
    lengths, angles = poses.target(weights)
    strain = edge_lengths(points, poses.topology.edges) / lengths - 1.0
    degrees = np.degrees(wrap_angles(dihedral_angles(points, poses.topology.hinges) - angles))
    ends, shortest = poses.along_limbs
    distances = np.linalg.norm(points[ends[:, 1]] - points[ends[:, 0]], axis=1)
    return Errors(strain, degrees, float((distances / shortest).min(initial=1.0)))


def folded(summaries: Mapping[str, Json]) -> str:
    """Say which blends fold or shrink limbs, of summaries of errors by what they are of."""
    ratios = {name: found["nearest"] for name, found in summaries.items()}
    said = "; ".join(f"{name} ({ratio:.2g})" for name, ratio in ratios.items() if ratio < FOLDED)
    rest = min((ratio for ratio in ratios.values() if ratio >= FOLDED), default=1.0)
    return (
        f"Folded or shrunk limbs: {said or 'none'}. In brackets is the smallest distance of two vertices along a limb "
        f"(more than {APART:g} diagonals apart in all poses, by a path at most {PATH:g} times as long) over their "
        f"smallest distance in the poses, where it is below {FOLDED:g}; of all other blends it is at least {rest:.2g}."
    )


def band(values: Float, share: float) -> tuple[float, float]:
    """Return the smallest and the largest of a share of the values, those that are nearest to zero, or zero."""
    size = np.abs(values)
    inside = values[size <= np.quantile(size, share, method="inverted_cdf")]
    return min(float(inside.min()), 0.0), max(float(inside.max()), 0.0)


def text(values: list[float] | tuple[float, ...]) -> str:
    """Return numbers with two digits, and 0 for rounding errors: ``0 / 0.012 / 0.5``."""

    def one(value: float) -> str:
        if abs(value) < ROUNDING:
            return "0"
        return f"{value:.0f}" if abs(value) >= 99.5 else f"{value:.2g}"

    return " / ".join(map(one, values))


def error_table(head: str, summaries: Json, columns: Mapping[str, Callable[[Json], object]] | None = None) -> str:
    """Return summaries of errors as a table, with a row for each name, and further columns before the errors."""
    more = columns or {}
    rows = [
        (name, *(str(show(found)) for show in more.values()), text(found["lengths"]), text(found["degrees"]))
        for name, found in summaries.items()
    ]
    return markdown_table((head, *more, "lengths, 99 / 99.9 / 100 %", "degrees"), rows)


def sections(results: Results, picture: str, caption: str, table: Callable[[Json], str]) -> list[str]:
    """Return a heading, a picture and a table for every mesh."""
    blocks = []
    for mesh, result in results.items():
        blocks += [f"## {mesh}: {result['title']}", f"![{caption}, {mesh}]({picture}-{mesh}.png)", table(result)]
    return blocks


def folds(results: Results, of: Callable[[Json], Json] = itemgetter("methods")) -> str:
    """Say which blends fold or shrink limbs, of the summaries of errors by method of every mesh."""
    return folded({f"*{name}* on {mesh}": found for mesh, r in results.items() for name, found in of(r).items()})
