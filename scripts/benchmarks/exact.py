"""Decode compressed sequences on machines that calculate a little otherwise: exact or refused, never other points.

A machine is simulated by noise on the weights of predictions, every time that they are found; its relative size is
from 1e-16 to 1e-3, evenly in its logarithm. That is harsher than any machine: weights are rounded, which true
differences do not survive. A decoding is *exact* if every number of it has the same bits as without noise, *refused* if
it ends in an error of mixseq, and *silent* if neither: then this ends with 1.

Usage: scripts/bench exact [NAME ...] [--count 1000] [--seed 0]   (NAME is an animation of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, decode_basis, decode_coefficients
from mixseq.compression.bitstream.predictor import Predictor
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.creature import walk_cycle
from mixseq.errors import FormatError
from mixseq.types import Float
from scripts.benchmarks.common.harness import animation, markdown_table

NAMES = (
    "abc_dembones_bone", "cat_poses", "fox_survey", "horse_gallop", "q_horse_eating", "q_man_run", "q_wolf_gallop",
    "robotexpressive_dance",
)  # fmt: skip

BINS = (1e-16, 1e-13, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3)
"""Sizes of noise between which decodings are counted together."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(NAMES))
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    files = [mixseq.compress(animation(name), kg=0.5, inbetweens=False) for name in options.names]
    files.append(mixseq.compress(walk_cycle(frames=8), kg=0.5, inbetweens=False))
    known = [_decoded(file) for file in files]
    found: Counter[tuple[int, str]] = Counter()
    for number in range(options.count):
        size = 10.0 ** rng.uniform(np.log10(BINS[0]), np.log10(BINS[-1]))
        place = number % len(files)
        with _noise(size, rng):
            found[int(np.searchsorted(BINS, size)), _outcome(files[place], known[place])] += 1
    kinds = ("exact", "refused", "silent")
    counts = [
        (f"{BINS[place - 1]:g} to {BINS[place]:g}", *(str(found[place, kind]) for kind in kinds))
        for place in range(1, len(BINS))
    ]
    print(markdown_table(("noise, relative", *kinds), counts))
    silent = sum(count for (_, kind), count in found.items() if kind == "silent")
    print(f"\n{sum(found.values())} decodings of {len(files)} files, {silent} silent")
    return 1 if silent else 0


def _decoded(file: CompressedSequence) -> list[Float]:
    basis = decode_basis(file, mesh_graph(file.header.faces, file.header.vertex_count))
    chunks = [decode_coefficients(file, chunk, basis) for chunk in file.chunks]
    return [*(block.vectors for block in basis.part_bases), *chunks]


def _outcome(file: CompressedSequence, known: list[Float]) -> str:
    try:
        found = _decoded(file)
    except FormatError:
        return "refused"
    same = len(found) == len(known) and all(map(np.array_equal, found, known))
    return "exact" if same else "silent"


@contextmanager
def _noise(size: float, rng: np.random.Generator) -> Iterator[None]:
    """Let all predictors have weights that are off, relatively, by about so much."""
    renew = Predictor._update_weights

    def renewed(self: Predictor) -> None:
        renew(self)
        self.weights *= 1.0 + size * rng.normal(size=self.weights.shape)

    Predictor._update_weights = renewed  # type: ignore[method-assign]
    try:
        yield
    finally:
        Predictor._update_weights = renew  # type: ignore[method-assign]


if __name__ == "__main__":
    sys.exit(main())
