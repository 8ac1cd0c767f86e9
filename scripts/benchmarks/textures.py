"""Vertex animation textures, plain and of low rank: bytes as PNG with 16 bits and on the card, errors, time.

`NAME xN` repeats an animation N times, with variation.

Usage: scripts/bench textures [NAME ...]   (some of the animations in $MIXSEQ_DATA/npz; five by default)
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import mixseq
from scripts.benchmarks.common.animations import animation

NAMES = ("q_man_run", "robotexpressive_dance", "abc_dembones_bone", "q_wolf_gallop x10", "horse_gallop x8")
ERRORS = (None, 1e-3, 1e-4)


def main() -> int:
    columns = (
        "sequence",
        "textures",
        "basis vectors",
        "max error / diagonal",
        "normals, degrees",
        "PNG kB",
        "on the card, kB",
        "smaller",
        "seconds (processor)",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    for name in sys.argv[1:] or NAMES:
        sequence = animation(name)
        plain = (0, 0)
        for error in ERRORS:
            with tempfile.TemporaryDirectory() as place:
                start = time.process_time()
                report = mixseq.write_vat(Path(place) / f"{name}.vat", sequence, error)
                seconds = time.process_time() - start
            sizes = report.file_bytes, report.memory_bytes
            plain = plain if error else sizes
            cells = (
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
            print("| " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
