"""Round trip of every animation: fit without loss, save, load, sample at the frames, compare.

Usage: scripts/bench roundtrip [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mixseq

LIMIT = 1e-6


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz"))
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    print(f"{platform.platform()}, {os.cpu_count()} cores, Python {platform.python_version()}\n")
    columns = (
        "sequence",
        "placement",
        "V",
        "T",
        "parts",
        "joints",
        "dim",
        "S_e/S_m",
        "paper's count",
        "fit s",
        "sample s",
        "MB",
        "max error/diag",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    rows = [measure(data / f"{name}.npz", placement) for name in names for placement in ("anchored", "free")]
    out = Path("out")
    out.mkdir(exist_ok=True)
    (out / "roundtrip.json").write_text(json.dumps(rows, indent=1))
    worst = max(row["max_error"] for row in rows)
    print(f"\nworst error {worst:.1e} of the diagonal ({'below' if worst <= LIMIT else 'ABOVE'} {LIMIT:g})")
    return 0 if worst <= LIMIT else 1


def measure(path: Path, placement: Any) -> dict[str, Any]:
    sequence = mixseq.read(path)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "model.h5")
        start = time.perf_counter()
        model = mixseq.fit(sequence, exact=True, placement=placement)
        fitted = time.perf_counter()
        mixseq.save(file, model)
        loaded = mixseq.load(file)
        ready = time.perf_counter()
        sampled = loaded.sample()
        done = time.perf_counter()
        size = file.stat().st_size
    edge_space = 2 * len(model.mixed.topology.edges) + 6
    row = {
        "sequence": path.stem,
        "placement": placement,
        "vertices": sequence.vertex_count,
        "frames": len(sequence),
        "parts": len(model.decomposition.parts),
        "joints": len(model.decomposition.joints),
        "dim": model.space.dim,
        "ratio": edge_space / model.space.dim,
        "paper_ratio": edge_space / model.decomposition.paper_dimension,
        "fit_seconds": fitted - start,
        "sample_seconds": done - ready,
        "megabytes": size / 1e6,
        "max_error": mixseq.compare(sequence, sampled).max_error,
    }
    print(
        "| {sequence} | {placement} | {vertices} | {frames} | {parts} | {joints} | {dim} | {ratio:.3f} | "
        "{paper_ratio:.3f} | {fit_seconds:.1f} | {sample_seconds:.1f} | {megabytes:.1f} | {max_error:.1e} |".format(
            **row
        ),
        flush=True,
    )
    return row


if __name__ == "__main__":
    sys.exit(main())
