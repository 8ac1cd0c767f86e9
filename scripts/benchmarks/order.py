"""What numbers of vertices and faces cost: connectivity, and whole files, of every order, at a KG error of 0.1 %.

Usage: scripts/bench order [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)

"NAME scrambled" is the animation with its faces, "NAME random" also with its vertices in random order: so are many
captured meshes. Every file is verified against its original.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import mixseq
from mixseq.choices import ORDERS
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.verification import compressed_sizes

KG = 0.1


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz"))
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    columns = ["sequence", *(f"{order}, bits a triangle" for order in ORDERS), "keep, kB", *ORDERS[1:]]
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    broken = [name for name in names if not measure(data, name)]
    print(f"\nbounds broken: {', '.join(broken) or 'none'} of {len(names)}")
    return 1 if broken else 0


def measure(data: Path, name: str) -> bool:
    """Print a row; return whether all files are what they say."""
    stem, _, kind = name.partition(" ")
    sequence = mixseq.read(data / f"{stem}.npz")
    if kind:
        sequence = shuffled(sequence, vertices=kind == "random")
    bits, sizes, sound = [], [], True
    with tempfile.TemporaryDirectory() as folder:
        for order in ORDERS:
            file = Path(folder, f"{order}.h5")
            mixseq.save(file, mixseq.compress(sequence, kg=KG, order=order))
            found = compressed_sizes(file)
            bits.append(8 * found["connectivity"] / len(sequence.faces))
            sizes.append(found["total"])
            sound &= mixseq.verify(file, sequence).holds
    row = [name, *(f"{each:.2f}" for each in bits), f"{sizes[0] / 1000:.1f}"]
    print("| " + " | ".join(row + [f"{each / sizes[0]:.2f}" for each in sizes[1:]]) + " |", flush=True)
    return sound


def shuffled(sequence: MeshSequence, vertices: bool) -> MeshSequence:
    """Return a sequence of triangles with faces, and vertices if told to, in random order."""
    random = np.random.default_rng(0)
    numbers = np.arange(sequence.vertex_count)
    order = random.permutation(numbers) if vertices else numbers
    faces = np.argsort(order)[random.permutation(sequence.faces)]
    begin = random.integers(0, 3, len(faces))[:, None]
    faces = np.take_along_axis(faces, (np.arange(3) + begin) % 3, axis=1)
    return MeshSequence.from_arrays(sequence.points[:, order], faces, times=sequence.times)


if __name__ == "__main__":
    sys.exit(main())
