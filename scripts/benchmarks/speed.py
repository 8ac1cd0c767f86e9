"""Fitting a sequence, beside py-dem-bones with the same number of bones, and decoding all its frames.

A fit is timed from the points to the model; of py-dem-bones only the solver is. Decoded frames have the same bits on
one thread and on two.

Usage: scripts/bench speed [NAME ...]   (animations of $MIXSEQ_DATA/npz; nothing else should run on the machine)
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

import mixseq
from mixseq.runtime.parallel import thread_executor
from mixseq.types import Float
from scripts.benchmarks.common.dembones import fit_peer
from scripts.benchmarks.common.harness import BROKEN, animation, format_runs, print_table, repeated

NAMES = ("horse_gallop", "q_man_run", "elephant_gallop")
FITS: dict[str, dict[str, Any]] = {"rank=20": {"rank": 20}, "default": {}}

COLUMNS = (
    "sequence", "V", "method", "parts or bones", "s", "KG %", "max error/diag", "decode ms/frame, 1 thread",
    "2 threads", "same bits",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Fit an animation with either setting, and decode it."""
    sequence = animation(name)
    size = str(sequence.vertex_count)
    for settings, told in FITS.items():
        seconds, model = repeated(partial(mixseq.fit, sequence, **told), 3, 40.0, warm=True)
        error = mixseq.compare(sequence, model.sample())
        parts = len(model.decomposition.parts)
        played = [repeated(partial(play, model, threads), 7, 20.0, warm=True) for threads in (1, 2)]
        same = all(map(np.array_equal, *(frames for _, frames in played)))
        yield (
            name,
            size,
            f"fit, {settings}",
            str(parts),
            format_runs(seconds),
            f"{error.kg_percent:.3g}",
            f"{error.max_error:.2g}",
            *(format_runs(runs, 1e3 / len(sequence)) for runs, _ in played),
            "yes" if same else BROKEN,
        )
    if peer := fit_peer(name, parts):
        cells = (str(peer.bones), format_runs(peer.seconds), f"{peer.kg_percent:.3g}", f"{peer.max_error:.2g}")
        yield name, size, "py-dem-bones", *cells, "", "", ""


def play(model: mixseq.Model, threads: int) -> list[Float]:
    """Decode all frames, in blocks."""
    return list(model.blocks(model.times, workers=thread_executor(threads)))


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, NAMES))
