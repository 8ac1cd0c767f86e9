"""Random access to compressed sequences: one frame out of many, and the promise on every file.

Usage: scripts/bench access [NAME | NAME xN ...]   (animations of $MIXSEQ_DATA/npz, repeated N times with variation)

Every sequence is compressed with a bound of 1e-3 diagonals, saved, and its file is verified against the original. Then:
seconds to open the file and decode the frame in the middle, to decode that frame of a model that is open, and to open
the file and decode all frames.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import mixseq
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.timing import repeated

BOUND = 1e-3
NAMES = ("abc_dembones_bone", "horse_gallop x16", "q_wolf_gallop x15")


def main() -> int:
    columns = (
        "sequence",
        "frames",
        "open",
        "open + one frame",
        "one frame",
        "open + all",
        "all / one",
        "holds",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    broken = [name for name in sys.argv[1:] or NAMES if not measure(name)]
    return 1 if broken else 0


def measure(name: str) -> bool:
    """Print a row; return whether the bound holds."""
    sequence = animation(name)
    time = float(sequence.times[len(sequence) // 2])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.h5")
        mixseq.save(file, mixseq.compress(sequence, max_error=BOUND))
        opening, model = repeated(lambda: mixseq.load(file), warm=True)
        one, _ = repeated(lambda: mixseq.load(file)(time))
        again, _ = repeated(lambda: model(time))
        everything, _ = repeated(lambda: mixseq.load(file).sample())
        holds = mixseq.verify(file, sequence).holds
    cells = (
        name,
        str(len(sequence)),
        *(f"{timing.median:.3g} s" for timing in (opening, one, again, everything)),
        f"{everything.median / one.median:.2g}",
        "yes" if holds else "NO",
    )
    print("| " + " | ".join(cells) + " |", flush=True)
    return holds


if __name__ == "__main__":
    sys.exit(main())
