"""The promise of a tolerance: fit to 1e-2, 1e-3 and 1e-4 of the diagonal, save, load, decode, compare.

Usage: scripts/bench tolerance [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mixseq

TOLERANCES = (1e-2, 1e-3, 1e-4)


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz"))
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    columns = (
        "sequence",
        "tolerance",
        "max error",
        "KG %",
        "frames",
        "key shapes",
        "knots time",
        "placement",
        "MB",
        "s",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    rows = [measure(data / f"{name}.npz", tolerance) for name in names for tolerance in TOLERANCES]
    Path("out").mkdir(exist_ok=True)
    Path("out/tolerance.json").write_text(json.dumps(rows, indent=1))
    broken = [f"{row['sequence']} {row['tolerance']:g}" for row in rows if row["max_error"] > row["tolerance"]]
    print(f"\npromises broken: {', '.join(broken) or 'none'} of {len(rows)}")
    return 1 if broken else 0


def measure(path: Path, tolerance: float) -> dict[str, Any]:
    sequence = mixseq.read(path)
    start = time.perf_counter()
    model = mixseq.fit(sequence, tolerance=tolerance)
    seconds = time.perf_counter() - start
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.h5")
        mixseq.save(file, model)
        size = file.stat().st_size / 1e6
        found = mixseq.compare(sequence, mixseq.load(file).sample())
    row: dict[str, Any] = {
        "sequence": path.stem,
        "tolerance": tolerance,
        "max_error": found.max_error,
        "kg": found.kg_percent,
        "frames": len(sequence),
        "keys": len(model.shapes),
        "time": len(model.time.times),
        "placement": len(model.placement.times),
        "megabytes": size,
        "seconds": seconds,
    }
    print(
        "| {sequence} | {tolerance:g} | {max_error:.2g} | {kg:.3g} | {frames} | {keys} | {time} | {placement} | "
        "{megabytes:.2f} | {seconds:.1f} |".format(**row),
        flush=True,
    )
    return row


if __name__ == "__main__":
    sys.exit(main())
