"""Midpoints of two poses: how far lengths and angles are from the means of the two.

Usage: scripts/bench midpoint [NAME FIRST SECOND]
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles, wrap_angles
from mixseq.operations.interpolation import PoseInterpolator

PAIRS = (
    ("lion_poses", 2, 5),
    ("lion_poses", 4, 6),
    ("cat_poses", 1, 3),
    ("cat_poses", 4, 6),
    ("horse_poses", 1, 3),
    ("horse_poses", 6, 10),
    ("horse_gallop", 0, 12),
    ("elephant_gallop", 0, 12),
    ("elephant_gallop", 0, 5),
)


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    pairs = PAIRS if len(sys.argv) < 4 else ((sys.argv[1], int(sys.argv[2]), int(sys.argv[3])),)
    columns = ("sequence", "method", "s", "steps", "relative length", "degrees")
    print("Errors at 99 % / 99.9 % / max.\n\n| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for name, first, second in pairs:
        measure(data / f"{name}.npz", first, second)
    return 0


def measure(path: Path, first: int, second: int) -> None:
    sequence = mixseq.read(path)
    ends = sequence.points[[first, second]].astype(np.float64)
    topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
    lengths = edge_lengths(ends, topology.edges).mean(axis=0)
    angles = unwrap_angles(dihedral_angles(ends, topology.hinges)).mean(axis=0)

    def show(method: str, points: Any, seconds: float, reports: Any) -> None:
        strain = np.abs(edge_lengths(points, topology.edges) / lengths - 1.0)
        bend = np.abs(np.degrees(wrap_angles(dihedral_angles(points, topology.hinges) - angles)))
        print(
            f"| {path.stem} {first}-{second} | {method} | {seconds:.2f} | "
            f"{solved(reports)} | "
            f"{envelope(strain)} | {envelope(bend)} |",
            flush=True,
        )

    show("vertices", ends.mean(axis=0), 0.0, [])
    spaces: tuple[tuple[str, dict[str, Any]], ...] = (
        ("interpolate", {}),
        ("interpolate, free", {"placement": "free"}),
        ("interpolate, edge", {"space": "edge"}),
        ("interpolate, edge, DSO", {"space": "edge", "projection": "dso"}),
    )
    for method, told in spaces:
        interpolator = PoseInterpolator.from_poses(sequence, pose_ids=[first, second], **told)
        interpolator.space.precompute()
        start = time.perf_counter()
        point, report = interpolator.blend_with_reports([0.5, 0.5])
        show(method, point, time.perf_counter() - start, report)


def solved(reports: Any) -> str:
    """Return how many steps were taken; the mixed space always takes as many."""
    return ", ".join(f"{r.iterations}{'' if r.converged else ', not converged'}" for r in reports) or "-"


def envelope(errors: Any) -> str:
    return " / ".join(f"{value:.2g}" for value in (*np.quantile(errors, [0.99, 0.999]), errors.max()))


if __name__ == "__main__":
    sys.exit(main())
