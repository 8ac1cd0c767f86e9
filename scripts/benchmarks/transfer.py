"""Deformation transfer: S_m and S_f side by side, and against what others made of the same poses.

For each pair the correspondence is found once, from markers. Then both methods transfer all frames: seconds a frame,
and strains, smoothness and crossings as `mixseq.retargeting.report` defines them. Where the target has a sequence of as
many frames it is a reference, which the transfer never sees: distances (root mean square over vertices, in diagonals of
the target at rest) pose by pose, after a translation, as placed, and with the vertex in place that the reference holds
fixed, if there is one.

Markers of the pairs that end in -picked were set in the viewer (mixseq view --markers), from nothing: what it proposes
was confirmed, the rest was chosen by eye on what it shows. All were saved before anything was measured with them.

Usage: scripts/bench transfer [PAIR ...]   (animations of $MIXSEQ_DATA; pairs: see PAIRS)
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import mixseq
from mixseq.choices import TRANSFERS, TransferName
from mixseq.retargeting.correspond import correspond_and_assess
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.report import ExpectedTriangles, TransferReport, measure_transfer
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq_io.text.markers import read_markers
from scripts.benchmarks.common.harness import DATA, markdown_table

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
    shares = f"{quality.target_coverage:.1%} of the target matched, {quality.source_coverage:.1%} of the source"
    print(f"\n{name}: {len(quality.markers)} markers, {shares}, {perf_counter() - start:.1f} s\n")
    results = {method: run(source, rest, target, mapping, method) for method in TRANSFERS}
    rows = [row(method, *result) for method, result in results.items()]
    is_posed = target.frame_count == source.frame_count
    if is_posed:
        rows.append(row("the reference", results["mixed"][0], target.points.astype(np.float64)))
    columns = "method", "s / frame", "strain", "unlike the source's", "acceleration", "worst frame"
    print(markdown_table((*columns, "crossings", "turned over"), rows), flush=True)
    if is_posed:
        for method, (transfer, points, _) in results.items():
            print_distances(method, transfer, points, target.points.astype(np.float64))


def run(
    source: MeshSequence, rest: MeshSequence, target: MeshSequence, mapping: Correspondence, method: TransferName
) -> tuple[Transfer, Float, float]:
    """Transfer by a method: the plan, all frames ``(T, V, 3)``, and seconds a frame."""
    settings = TransferSettings(mapping=mapping, method=method, rest=rest)
    planned = plan_transfer(source, first(target), settings)
    next(planned.blocks())  # compiles, and factors
    start = perf_counter()
    points = np.concatenate(list(planned.blocks())).astype(np.float64)
    return planned, points, (perf_counter() - start) / len(points)


def row(name: str, transfer: Transfer, points: Float, seconds: float | None = None) -> tuple[str, ...]:
    """Return a row of the first table."""
    report: TransferReport = measure_transfer(transfer, [points])
    smooth = report.smoothness
    return (
        name,
        "" if seconds is None else f"{seconds:.2f}",
        f"{100 * report.strain.rms:.2f} %",
        f"{100 * report.excess.rms:.2f} %",
        "" if smooth is None or smooth.ratio is None else f"{smooth.ratio:.3f}",
        f"{worst_acceleration(transfer, points):.2f}",
        f"{np.mean(report.intersections.values):.0f}",
        f"{np.mean(report.turned_over.values):.1f}",
    )


def worst_acceleration(transfer: Transfer, points: Float) -> float:
    """Acceleration of all vertices relative to the source's, in the frame in which it is largest.

    Frames in which the source hardly accelerates, less than half as much as on average, are left out.
    """
    scale = ExpectedTriangles.from_transfer(transfer).gradients.alignment.scale
    carried = scale * transfer.correspondence.interpolate(transfer.source.points[:].astype(np.float64))
    own, other = (np.sqrt(np.square(np.diff(x, 2, axis=0)).sum(axis=2).mean(axis=1)) for x in (points, carried))
    much = other >= 0.5 * np.sqrt(np.square(other).mean())
    return float((own[much] / other[much]).max())


def print_distances(method: str, transfer: Transfer, points: Float, reference: Float) -> None:
    """Print how far a transfer is from the reference, mean over poses and largest."""
    diagonal = float(np.linalg.norm(np.ptp(transfer.target, axis=0)))
    moved = np.linalg.norm(reference - reference[0], axis=2).max(axis=0)
    held = int(moved.argmin())
    away = points[1:] - reference[1:]
    shifts = {"translated": away.mean(axis=1, keepdims=True), "as placed": 0.0}
    if moved[held] < 1e-6 * diagonal:
        shifts[f"vertex {held} held"] = away[:, held, None]
    for how, shift in shifts.items():
        distances = 100 * np.sqrt(np.square(away - shift).sum(axis=2).mean(axis=1)) / diagonal
        print(f"{method}, {how}: mean {distances.mean():.2f} %, largest {distances.max():.2f} %")


if __name__ == "__main__":
    sys.exit(main())
