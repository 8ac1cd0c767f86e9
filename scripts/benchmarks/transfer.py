"""Deformation transfer: S_m and S_f side by side, and against what others made of the same poses.

Usage: scripts/bench transfer [PAIR ...]   (animations of $MIXSEQ_DATA; pairs: see PAIRS)

For each pair the correspondence is found once, from markers. Then both methods transfer all frames: seconds a frame,
and strains, smoothness and crossings as `mixseq.retargeting.report` defines them. Where the target has a sequence of as
many frames it is a reference, which the transfer never sees: distances (root mean square over vertices, in diagonals of
the target at rest) pose by pose, after a translation, as placed, and with the vertex in place that the reference holds
fixed, if there is one.

Markers of the pairs that end in -picked were set in the viewer (mixseq view --markers), from nothing: what it proposes
was confirmed, the rest was chosen by eye on what it shows. All were saved before anything was measured with them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.choices import TRANSFERS, TransferName
from mixseq.retargeting.correspond import correspond_and_assess
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.matching import CorrespondenceQuality
from mixseq.retargeting.report import TransferReport, measure_transfer
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.text.markers import read_markers

Float = NDArray[np.floating]

DATA = Path(os.environ.get("MIXSEQ_DATA", "."))
OWN = Path(__file__).parent / "markers"
REST = {"animation": "none"}


@dataclass(frozen=True)
class Pair:
    """A source, what it is at rest (a file, or its first frame), a target, and their markers."""

    source: str
    target: str
    markers: Path
    rest: str = ""
    reading: tuple[tuple[str, Any], ...] = ()

    def read(self) -> tuple[MeshSequence, MeshSequence, MeshSequence]:
        """Read source, rest and target."""
        source = mixseq.read(DATA / self.source, **dict(self.reading))
        rest = first(_still(self.rest)) if self.rest else first(source)
        return source, rest, _still(self.target)


def _still(name: str) -> MeshSequence:
    return mixseq.read(DATA / name, **(REST if name.endswith(".glb") else {}))


def first(sequence: MeshSequence) -> MeshSequence:
    """Take the first frame."""
    return MeshSequence.from_header(sequence.header.with_times([0.0]), sequence.points[:1])


GALLOP = (("animation", "Gallop"), ("fps", 24.0))

PAIRS = {
    "horse-camel": Pair("npz/horse_poses.npz", "npz/camel_poses.npz", DATA / "markers/golevka_horse_camel.cons"),
    "horse-camel-picked": Pair("npz/horse_poses.npz", "npz/camel_poses.npz", OWN / "horse_camel_picked.txt"),
    "cat-lion": Pair("npz/cat_poses.npz", "npz/lion_poses.npz", DATA / "markers/markers-cat-lion.yml"),
    "cat-lion-picked": Pair("npz/cat_poses.npz", "npz/lion_poses.npz", OWN / "cat_lion_picked.txt"),
    "gallop-camel": Pair(
        "npz/horse_gallop.npz",
        "npz/camel_poses.npz",
        DATA / "markers/golevka_horse_camel.cons",
        rest="npz/horse_poses.npz",
    ),
    "wolf-horse": Pair("gltf/Wolf.glb", "gltf/Horse.glb", OWN / "wolf_horse.txt", "gltf/Wolf.glb", GALLOP),
    "man-woman": Pair("npz/q_man_run.npz", "npz/q_woman_run.npz", OWN / "man_woman.txt"),
}


def main() -> int:
    for name in sys.argv[1:] or PAIRS:
        compare(name, PAIRS[name])
    return 0


def compare(name: str, pair: Pair) -> None:
    """Print the tables of a pair."""
    source, rest, target = pair.read()
    start = perf_counter()
    mapping, quality = correspond_and_assess(rest, first(target), read_markers(pair.markers))
    print(f"\n{name}: {_quality(quality)}, {perf_counter() - start:.1f} s\n")
    columns = "method", "s / frame", "strain", "unlike the source's", "acceleration", "worst frame"
    print("| " + " | ".join((*columns, "crossings", "turned over")) + " |\n|" + "---|" * 8)
    posed = target.frame_count == source.frame_count
    results = {method: run(source, rest, target, mapping, method) for method in TRANSFERS}
    if posed:
        row(
            "the reference",
            None,
            measure_transfer(results["mixed"][0], [target.points]),
            results["mixed"][0],
            target.points,
        )
    if posed:
        for method, (transfer, points) in results.items():
            distances(method, transfer, points, target.points.astype(np.float64))


def run(
    source: MeshSequence,
    rest: MeshSequence,
    target: MeshSequence,
    mapping: Correspondence,
    method: TransferName,
) -> tuple[Transfer, Float]:
    """Transfer by a method, and print its row."""
    settings = TransferSettings(mapping=mapping, method=method, rest=rest)
    planned = plan_transfer(source, first(target), settings)
    next(planned.blocks())  # compiles, and factors
    start = perf_counter()
    points = np.concatenate(list(planned.blocks()))
    seconds = (perf_counter() - start) / len(points)
    row(method, seconds, measure_transfer(planned, [points]), planned, points)
    return planned, points


def row(name: str, seconds: float | None, report: TransferReport, transfer: Transfer, points: Float) -> None:
    """Print a row of the first table."""
    smooth = report.smoothness
    cells = (
        name,
        "" if seconds is None else f"{seconds:.2f}",
        f"{100 * report.strain.rms:.2f} %",
        f"{100 * report.excess.rms:.2f} %",
        "" if smooth is None or smooth.ratio is None else f"{smooth.ratio:.3f}",
        f"{worst_acceleration(transfer, points):.2f}",
        f"{np.mean(report.intersections.values):.0f}",
        f"{np.mean(report.turned_over.values):.1f}",
    )
    print("| " + " | ".join(cells) + " |", flush=True)


def worst_acceleration(transfer: Transfer, points: Float) -> float:
    """Acceleration of all vertices relative to the source's, in the frame in which it is largest.

    Frames in which the source hardly accelerates, less than half as much as on average, are left out.
    """
    from mixseq.retargeting.report import ExpectedTriangles

    scale = ExpectedTriangles.from_transfer(transfer).gradients.alignment.scale
    carried = scale * transfer.correspondence.interpolate(transfer.source.points[:].astype(np.float64))
    own, other = (np.sqrt(np.square(np.diff(x, 2, axis=0)).sum(axis=2).mean(axis=1)) for x in (points, carried))
    much = other >= 0.5 * np.sqrt(np.square(other).mean())
    return float((own[much] / other[much]).max())


def distances(method: str, transfer: Transfer, points: Float, reference: Float) -> None:
    """Print how far a transfer is from the reference, pose by pose."""
    diagonal = float(np.linalg.norm(np.ptp(transfer.target, axis=0)))
    moved = np.linalg.norm(reference - reference[0], axis=2).max(axis=0)
    held = int(moved.argmin())
    rows = {"translated": [], "as placed": []}  # type: dict[str, list[float]]
    if moved[held] < 1e-6 * diagonal:
        rows[f"vertex {held} held"] = []
    for x, y in zip(points[1:], reference[1:], strict=True):
        away = x - y
        for how, shift in zip(rows, (away.mean(axis=0), 0.0, away[held]), strict=False):
            rows[how].append(100 * float(np.sqrt(np.square(away - shift).sum(axis=1).mean())) / diagonal)
    for how, values in rows.items():
        print(f"{method}, {how}: {_listed(values)} %; mean {np.mean(values):.2f} %, largest {max(values):.2f} %")


def _listed(values: Sequence[float]) -> str:
    return " ".join(f"{value:.2f}" for value in values)


def _quality(quality: CorrespondenceQuality) -> str:
    return (
        f"{len(quality.markers)} markers, {100 * quality.target_coverage:.1f} % of the target matched, "
        f"{100 * quality.source_coverage:.1f} % of the source, "
        f"{100 * quality.mean_distance:.2f} % of the diagonal away on average, {quality.flipped_count} flipped"
    )


if __name__ == "__main__":
    sys.exit(main())
