"""Rate and distortion: bits per vertex and frame, without connectivity, of `mixseq.compress` and of its peers.

Everything is encoded for real and decoded again; errors are those of the decoded points. NAME is an animation of
$MIXSEQ_DATA/npz; `NAME xN` repeats it N times with variation. Ends with 1 if a coder failed.

Usage: scripts/bench compress [NAME ...] [--only CODER,CODER]
"""

from __future__ import annotations

import argparse
import re
import sys
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.creature import walk_cycle
from scripts.benchmarks.common.harness import animation, markdown_table, repeated
from scripts.benchmarks.peers.coders import ERROR_TARGETS, KG_TARGETS, Coder, Draco, Ours
from scripts.benchmarks.peers.pca import Pca

NAMES = (
    "horse_gallop", "elephant_gallop", "q_man_run", "q_wolf_gallop", "cat_poses", "fox_survey",
    "robotexpressive_dance", "q_horse_eating", "abc_dembones_bone", "horse_gallop x10", "q_wolf_gallop x10",
)  # fmt: skip

CODERS: tuple[Coder, ...] = (Ours(), Pca("trajectory"), Pca("shape"), Draco())
OURS, PEER = "ours", "trajectory"

Measure = Literal["kg_percent", "max_error"]

TIMED_AT = 0.1
"""Seconds are those of the setting whose KG error, in percent, is nearest to this."""

SLACK = 1.01
"""An error up to this many times a target counts as the target."""


@dataclass(frozen=True)
class Point:
    """A setting of a coder: bits per vertex and frame, errors (KG in percent, the largest in diagonals), seconds."""

    bits: float
    kg_percent: float
    max_error: float
    encode: float
    decode: float


Points = Mapping[str, Sequence[Point]]
"""Of all coders on one sequence, by their names."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/bench compress", description=__doc__)
    parser.add_argument("names", nargs="*", default=NAMES, metavar="NAME")
    parser.add_argument("--only", metavar="CODER,CODER", help=f"of {', '.join(coder.name for coder in CODERS)}")
    options = parser.parse_args()
    coders = [coder for coder in CODERS if not options.only or coder.name in options.only.split(",")]
    coders = [coder for coder in coders if is_installed(coder.package) and is_warm(coder)]
    failures: list[str] = []
    found: dict[str, Points] = {}
    for name in join_loops(options.names):
        sequence = animation(name)
        found[name] = measure(name, sequence, coders, failures)
        print(f"\n### {name}: {sequence.vertex_count} vertices, {len(sequence)} frames\n")
        print(sequence_table(found[name], {coder.name: coder.title for coder in coders}), flush=True)
    both = {name: points for name, points in found.items() if {OURS, PEER} <= points.keys()}
    if both:
        print(f"\nBits of ours over bits of PCA in trajectory space.\n\n{ratio_table(both)}")
    print("\n".join(failures))
    return int(bool(failures))


def measure(name: str, sequence: mixseq.MeshSequence, coders: Iterable[Coder], failures: list[str]) -> Points:
    """Run all coders with all their settings; those that fail are named, with the reason."""
    points: dict[str, list[Point]] = {}
    for coder in coders:
        try:
            points[coder.name] = [operating_point(coder, sequence, each) for each in coder.settings(sequence)]
        except Exception as error:
            traceback.print_exc()
            failures.append(f"{coder.name} failed on {name}: {type(error).__name__}: {error}")
    return points


def operating_point(coder: Coder, sequence: mixseq.MeshSequence, setting: Any) -> Point:
    """Encode, decode, and compare."""
    encoding, data = repeated(lambda: coder.encode(sequence, setting), 3, 1.0)
    # A decoder is given the faces alone: what it works out from them is part of its seconds.
    decoding, decoded = repeated(lambda: coder.decode(_mesh(sequence), data), 3, 1.0)
    bits = 8 * coder.signals(_mesh(sequence), data) / (sequence.vertex_count * len(sequence))
    found = errors(sequence.points, decoded, sequence.diagonal)
    return Point(bits, *found, float(np.median(encoding)), float(np.median(decoding)))


def errors(original: NDArray[Any], decoded: NDArray[Any], diagonal: float) -> tuple[float, float]:
    """Return the KG error in percent, and the largest error of a vertex in diagonals."""
    x = original.astype(np.float64)
    away = decoded - x
    kg = 100 * np.linalg.norm(away) / np.linalg.norm(x - x.mean(axis=1, keepdims=True))
    return float(kg), float(np.sqrt(np.square(away).sum(axis=2).max()) / diagonal)


def rate(points: Iterable[Point], measure: Measure, target: float) -> float | None:
    """Return bits per vertex and frame at an error: between points linear in its logarithm, on their lower staircase.

    With a target larger than all errors it is the rate of the cheapest point, which keeps the target; None if no point
    reaches it.
    """
    stairs: list[tuple[float, float]] = []
    for error, bits in sorted((getattr(point, measure), point.bits) for point in points):
        if not stairs or bits < stairs[-1][1]:
            stairs.append((error, bits))
    if not stairs or stairs[0][0] > SLACK * target:
        return None
    found, bits_at = np.array(stairs).T
    return float(np.interp(np.log(target), np.log(np.maximum(found, 1e-300)), bits_at))


# Tables -----------------------------------------------------------------------------------------------------

TARGETS: tuple[tuple[Measure, float, str], ...] = (
    *(("kg_percent", kg, f"KG {kg:g} %") for kg in KG_TARGETS),
    *(("max_error", error, f"max {error:g}") for error in ERROR_TARGETS),
)


def sequence_table(points: Points, titles: Mapping[str, str]) -> str:
    """Rates of all coders on one sequence, and their seconds."""
    rows = []
    for name, each in points.items():
        rates = (rate(each, kind, target) for kind, target, _ in TARGETS)
        timed = min(each, key=lambda point: abs(np.log(max(point.kg_percent, 1e-12) / TIMED_AT)))
        cells = ("-" if bits is None else f"{bits:.3g}" for bits in rates)
        rows.append((titles[name], *cells, f"{timed.encode:.3g}", f"{timed.decode:.3g}"))
    return markdown_table(("coder", *(title for *_, title in TARGETS), "encode s", "decode s"), rows)


def ratio_table(found: Mapping[str, Points]) -> str:
    """Bits of ours over those of the strongest peer at every target: NaN where the peer does not reach it."""

    def ratio(points: Points, kind: Measure, target: float) -> float:
        ours, peer = (rate(points[coder], kind, target) for coder in (OURS, PEER))
        return np.nan if peer is None else np.inf if ours is None else ours / peer

    ratios = np.array([[ratio(points, kind, target) for kind, target, _ in TARGETS] for points in found.values()])
    titles = (*found, "**median**", "largest")
    rows = np.concatenate([ratios, [np.nanmedian(ratios, axis=0), np.nanmax(ratios, axis=0)]])
    cells = [(title, *(f"{value:.2f}" for value in row)) for title, row in zip(titles, rows, strict=True)]
    return markdown_table(("sequence", *(title for *_, title in TARGETS)), cells)


# What is run ------------------------------------------------------------------------------------------------


def join_loops(words: Sequence[str]) -> list[str]:
    """Join `NAME xN`, whether that was one word or two."""
    return re.sub(r"\s+(?!x\d+\b)", "\n", " ".join(words)).split("\n")


def is_installed(package: str) -> bool:
    """Whether pip has installed a package; what needs none is there."""
    try:
        return not package or bool(distribution(package))
    except PackageNotFoundError:
        print(f"left out: pip install {package}", file=sys.stderr)
        return False


def is_warm(coder: Coder) -> bool:
    """Run a coder on something small, which compiles and imports; one that cannot even do that is left out."""
    walk = walk_cycle(frames=6)
    walk = walk.with_points(walk.points.astype("float32"))
    try:
        coder.decode(_mesh(walk), coder.encode(walk, next(iter(coder.settings(walk)))))
    except Exception as error:
        print(f"{coder.name} is left out: {type(error).__name__}: {error}", file=sys.stderr)
        return False
    return True


def _mesh(sequence: mixseq.MeshSequence) -> mixseq.Topology:
    return mixseq.Topology(sequence.faces, sequence.vertex_count)


if __name__ == "__main__":
    sys.exit(main())
