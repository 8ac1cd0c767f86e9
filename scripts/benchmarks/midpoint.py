"""Midpoints of two poses: how far lengths and angles are from the means of the two, at 99 % / 99.9 % / max.

Usage: scripts/bench midpoint [NAME:FIRST:SECOND ...]   (two frames of an animation of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, unwrap_angles, wrap_angles
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.types import Float
from scripts.benchmarks.common.harness import animation, print_table

PAIRS = (
    "lion_poses:2:5", "lion_poses:4:6", "cat_poses:1:3", "cat_poses:4:6", "horse_poses:1:3", "horse_poses:6:10",
    "horse_gallop:0:12", "elephant_gallop:0:12", "elephant_gallop:0:5",
)  # fmt: skip

METHODS: dict[str, dict[str, Any]] = {
    "interpolate": {},
    "interpolate, free": {"placement": "free"},
    "interpolate, edge": {"space": "edge"},
    "interpolate, edge, DSO": {"space": "edge", "projection": "dso"},
}
"""What `mixseq.interpolate` is told."""

COLUMNS = ("sequence", "method", "s", "steps", "relative length", "degrees")


def rows(pair: str) -> Iterator[tuple[str, ...]]:
    """Blend two poses by every method."""
    name, *frames = pair.split(":")
    sequence, ids = animation(name), [int(frame) for frame in frames]
    ends = sequence.points[ids].astype(np.float64)
    topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
    lengths = edge_lengths(ends, topology.edges).mean(axis=0)
    angles = unwrap_angles(dihedral_angles(ends, topology.hinges)).mean(axis=0)

    def row(method: str, points: Float, seconds: float, steps: str) -> tuple[str, ...]:
        strain = np.abs(edge_lengths(points, topology.edges) / lengths - 1.0)
        bend = np.abs(np.degrees(wrap_angles(dihedral_angles(points, topology.hinges) - angles)))
        errors = (" / ".join(f"{e:.2g}" for e in (*np.quantile(x, [0.99, 0.999]), x.max())) for x in (strain, bend))
        return f"{name} {'-'.join(frames)}", method, f"{seconds:.2f}", steps or "-", *errors

    yield row("vertices", ends.mean(axis=0), 0.0, "")
    for method, settings in METHODS.items():
        interpolator = PoseInterpolator.from_poses(sequence, pose_ids=ids, **settings)
        start = time.perf_counter()
        points, reports = interpolator.blend_with_reports([0.5, 0.5])
        seconds = time.perf_counter() - start
        steps = (f"{each.iterations}{'' if each.converged else ', not converged'}" for each in reports)
        yield row(method, points, seconds, ", ".join(steps))


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, PAIRS))
