"""Models of animations: without loss in both placements, of rank 10 beside PCA of the vertices, and to 1e-3.

Every model is saved, loaded, sampled at its frames and compared with the original. Ends with 1 if a vertex is off by
more than 1e-6 diagonals without loss, or by more than the tolerance.

Usage: scripts/bench fit [NAME ...]   (animations of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import mixseq
from mixseq.metrics import Comparison
from scripts.benchmarks.common.harness import BROKEN, animation, print_table

NAMES = (
    "fox_run", "fox_survey", "q_wolf_gallop", "q_trex_run", "q_horse_eating", "q_man_run", "lion_poses", "cat_poses",
    "horse_gallop", "robotexpressive_dance",
)  # fmt: skip

RANK = 10
TOLERANCE = 1e-3
LOSSLESS_ERROR = 1e-6
"""Largest errors, in diagonals of the first frame's bounding box."""

COLUMNS = (
    "sequence", "V", "T", "parts", "S_e/S_m", "free: S_e/S_m", "lossless, max error", "free: max error",
    f"rank {RANK}: KG % S_m", "vertex PCA", f"{TOLERANCE:g}: max error", "KG %", "key shapes", "MB", "fit s",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Fit an animation in all ways."""
    sequence = animation(name)
    anchored = mixseq.fit(sequence, exact=True)
    free = mixseq.fit(sequence, exact=True, placement="free")
    start = time.perf_counter()
    tolerant = mixseq.fit(sequence, tolerance=TOLERANCE)
    seconds = time.perf_counter() - start
    lossless = [_after_saving(sequence, model)[0].max_error for model in (anchored, free)]
    found, megabytes = _after_saving(sequence, tolerant)
    edge_space = 2 * len(anchored.mixed.topology.edges) + 6
    rank = min(RANK, len(sequence) - 1)
    of_rank = [mixseq.fit(sequence, rank=rank), mixseq.fit(sequence, rank=rank, space="vertex")]
    yield (
        name,
        str(sequence.vertex_count),
        str(len(sequence)),
        str(len(anchored.decomposition.parts)),
        *(f"{edge_space / model.space.dim:.3f}" for model in (anchored, free)),
        *(f"{error:.1e}" if error <= LOSSLESS_ERROR else BROKEN for error in lossless),
        *(f"{mixseq.compare(sequence, model.sample()).kg_percent:.3g}" for model in of_rank),
        f"{found.max_error:.2g}" if found.max_error <= TOLERANCE else BROKEN,
        f"{found.kg_percent:.3g}",
        str(len(tolerant.shapes)),
        f"{megabytes:.2f}",
        f"{seconds:.1f}",
    )


def _after_saving(sequence: mixseq.MeshSequence, model: mixseq.Model) -> tuple[Comparison, float]:
    """Save and load a model: its errors, and the size of its file in MB."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.h5")
        mixseq.save(file, model)
        return mixseq.compare(sequence, mixseq.load(file).sample()), file.stat().st_size / 1e6


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
