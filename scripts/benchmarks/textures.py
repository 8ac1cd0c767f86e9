"""Vertex animation textures, plain and of low rank: bytes as PNG with 16 bits and on the card, errors, time.

Usage: scripts/bench textures [NAME ...]   (animations of $MIXSEQ_DATA/npz; `NAME xN` repeats one N times)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import mixseq
from scripts.benchmarks.common.harness import animation, cpu_timed, print_table

NAMES = ("q_man_run", "robotexpressive_dance", "abc_dembones_bone", "q_wolf_gallop x10", "horse_gallop x8")

COLUMNS = (
    "sequence", "textures", "basis vectors", "max error / diagonal", "normals, degrees", "PNG kB", "on the card, kB",
    "smaller", "seconds (processor)",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Write an animation as plain textures, and to two errors."""
    sequence = animation(name)
    plain = (0, 0)
    for error in (None, 1e-3, 1e-4):
        with tempfile.TemporaryDirectory() as folder:
            target = Path(folder) / f"{name}.vat"
            seconds, report = cpu_timed(partial(mixseq.write_vat, target, sequence, error))
        sizes = report.file_bytes, report.memory_bytes
        plain = plain if error else sizes
        yield (
            f"{name}: {sequence.vertex_count} vertices, {sequence.frame_count} frames",
            "plain" if error is None else f"low rank, {error:g}",
            f"{report.rank or ''}",
            f"{report.max_error:.2g}",
            f"{report.normal_degrees:.2g}",
            f"{sizes[0] / 1e3:.0f}",
            f"{sizes[1] / 1e3:.0f}",
            "" if error is None else f"{plain[0] / sizes[0]:.1f} x, {plain[1] / sizes[1]:.1f} x",
            f"{seconds:.1f}",
        )


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
