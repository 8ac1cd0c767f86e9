"""Cost of numbering: connectivity and whole files of every order, at a KG error of 0.1 %. Files are verified.

"NAME scrambled" is the animation with its faces, "NAME random" also with its vertices in random order, as in many
captured meshes.

Usage: scripts/bench order [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import mixseq
from mixseq.choices import ORDERS
from mixseq_io.model_files import compressed_sizes
from scripts.benchmarks.common.harness import BROKEN, animation, print_table

COLUMNS = ("sequence", *(f"{order}, bits a triangle" for order in ORDERS), "keep, kB", *ORDERS[1:], "bounds hold")


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Compress an animation in every order."""
    stem, _, kind = name.partition(" ")
    sequence = animation(stem)
    if kind:
        sequence = shuffled(sequence, vertices=kind == "random")
    bits, sizes, holds = [], [], True
    with tempfile.TemporaryDirectory() as folder:
        for order in ORDERS:
            file = Path(folder, f"{order}.h5")
            mixseq.save(file, mixseq.compress(sequence, kg=0.1, order=order, inbetweens=False))
            found = compressed_sizes(file)
            bits.append(8 * found["connectivity"] / len(sequence.faces))
            sizes.append(found["total"])
            holds &= mixseq.verify(file, sequence).holds
    ratios = (f"{size / sizes[0]:.2f}" for size in sizes[1:])
    yield name, *(f"{each:.2f}" for each in bits), f"{sizes[0] / 1000:.1f}", *ratios, "yes" if holds else BROKEN


def shuffled(sequence: mixseq.MeshSequence, vertices: bool) -> mixseq.MeshSequence:
    """Put faces, their corners, and on demand vertices, in random order."""
    random = np.random.default_rng(0)
    numbers = np.arange(sequence.vertex_count)
    order = random.permutation(numbers) if vertices else numbers
    faces = np.argsort(order)[random.permutation(sequence.faces)]
    begin = random.integers(0, 3, len(faces))[:, None]
    faces = np.take_along_axis(faces, (np.arange(3) + begin) % 3, axis=1)
    return mixseq.MeshSequence.from_arrays(sequence.points[:, order], faces, times=sequence.times)


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows))
