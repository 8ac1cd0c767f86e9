"""Error at rank r, part poses exact, beside PCA of the vertices with as many modes.

Usage: scripts/bench rank [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import mixseq

RANKS = (2, 5, 10, 20)

ROUNDING = 1e-9
"""KG errors below are rounding, at full rank."""


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz"))
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    columns = (
        "sequence",
        "frames",
        "parts",
        "rank",
        "KG % S_m",
        "KG % vertex PCA",
        "max error / diag",
        "strain",
        "s",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    rows = [row for name in names for row in measure(data / f"{name}.npz")]
    Path("out").mkdir(exist_ok=True)
    Path("out/rank.json").write_text(json.dumps(rows, indent=1))
    worse = [
        f"{row['sequence']} r={row['rank']}"
        for row in rows
        if row["mixed"] > max(row["vertex"], ROUNDING) and row["rank"] <= 10
    ]
    print(f"\nworse than vertex PCA at r <= 10: {', '.join(worse) or 'none'}")
    return 0


def measure(path: Path) -> list[dict[str, Any]]:
    sequence = mixseq.read(path)
    rows = []
    for rank in (*RANKS, None):
        if rank is not None and rank >= len(sequence) - 1:
            continue
        full: dict[str, Any] = {"exact": True} if rank is None else {"rank": rank}
        start = time.perf_counter()
        model = mixseq.fit(sequence, **full)
        mixed = mixseq.compare(sequence, model.sample())
        seconds = time.perf_counter() - start
        vertex = mixseq.compare(sequence, mixseq.fit(sequence, space="vertex", **full).sample())
        row: dict[str, Any] = {
            "sequence": path.stem,
            "frames": len(sequence),
            "parts": len(model.decomposition.parts),
            "rank": len(sequence) - 1 if rank is None else rank,
            "mixed": mixed.kg_percent,
            "vertex": vertex.kg_percent,
            "max_error": mixed.max_error,
            "strain": mixed.edge_strain.rms,
            "seconds": seconds,
        }
        rows.append(row)
        print(
            "| {sequence} | {frames} | {parts} | {rank} | {mixed:.3g} | {vertex:.3g} | {max_error:.2g} | {strain:.2g} "
            "| {seconds:.1f} |".format(**row),
            flush=True,
        )
    return rows


if __name__ == "__main__":
    sys.exit(main())
