"""Resampling: keep some frames, rebuild the others, compare with cubic interpolation of vertices.

Usage: scripts/bench resample [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)

Ratios are error of vertex interpolation over error of the model: above 1 the model is better. Constants of the method
were chosen on one half of the animations, so that medians are told for each half.
"""

from __future__ import annotations

import json
import os
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import mixseq
from mixseq.signals.model import Model
from mixseq.types import Float
from scripts.benchmarks.common.inbetween import (
    accelerations,
    errors,
    kept_frames,
    part,
    vertex_operator,
    vertex_spline,
)

CHOSEN_ON = {
    "abc_dembones_bone", "elephant_gallop", "fox_run", "q_alpaca_gallop", "q_fox_gallopjump", "q_man_run", "q_trex_run",
    "q_wolf_attack",
}  # fmt: skip
OTHERS = {
    "fox_survey", "horse_gallop", "q_horse_eating", "q_horse_gallop", "q_man_swordslash", "q_wolf_gallop",
    "q_woman_run", "robotexpressive_dance",
}  # fmt: skip
MEASURES = ("rms", "max", "strain rms", "strain mean", "degrees rms", "volume")
SHOWN = ("rms", "strain rms", "degrees rms", "max", "wrong hinges")


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz") if path.stem in CHOSEN_ON | OTHERS)
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    columns = (
        "sequence",
        "every",
        "keys",
        "s",
        *(f"{name}: spline / model" for name in SHOWN),
        "same operator",
    )
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    rows = [row for name in names for row in measured(data / f"{name}.npz")]
    for half, chosen in (("chosen on", CHOSEN_ON), ("not chosen on", OTHERS)):
        mine = [row for row in rows if row["sequence"] in chosen]
        report(f"{half}, every 2nd and 4th", [row for row in mine if row["every"] in "24"])
        report(f"{half}, every 8th and three keys", [row for row in mine if row["every"] not in "24"])
    Path("out").mkdir(exist_ok=True)
    Path("out/resample.json").write_text(json.dumps(rows, indent=1))
    return 0


def measured(path: Path) -> list[dict[str, Any]]:
    """Measure one animation, however its frames are thinned out."""
    sequence = mixseq.read(path)
    rows = []
    for every, frames in kept_frames(len(sequence)).items():
        keys = part(sequence, frames)
        new = np.setdiff1d(np.arange(frames[0], frames[-1]), frames)
        truth = part(sequence, new)
        start = time.perf_counter()
        model = mixseq.fit(keys, exact=True)
        rebuilt = model.sample(truth.times).points
        seconds = time.perf_counter() - start
        spline, operator = vertex_spline(keys), vertex_operator(keys)
        row: dict[str, Any] = {
            "sequence": path.stem,
            "every": every,
            "keys": len(keys),
            "seconds": seconds,
            "spline": errors(truth, spline(truth.times)),
            "operator": errors(truth, operator(truth.times)),
            "model": errors(truth, np.asarray(rebuilt)),
            **accelerations(keys, partial(_sampled, model), spline),
        }
        cells = [f"{row['spline'][name]:.3g} / {row['model'][name]:.3g}" for name in SHOWN]
        ratio = row["operator"]["rms"] / row["model"]["rms"]
        line = [path.stem, every, str(len(keys)), f"{seconds:.1f}", *cells, f"{ratio:.2f}"]
        print("| " + " | ".join(line) + " |", flush=True)
        rows.append(row)
    return rows


def _sampled(model: Model, times: Float) -> Float:
    return np.concatenate(list(model.blocks(times)))


def report(half: str, rows: list[dict[str, Any]]) -> None:
    """Print medians and smallest ratios of some rows."""
    if not rows:
        return
    print(f"\n{half}: {len(rows)} cases")
    for name in MEASURES:
        pairs = [(row["spline"][name], row["model"][name]) for row in rows if row["model"][name] is not None]
        ratios = np.array([spline / max(model, 1e-15) for spline, model in pairs])
        if ratios.size:
            print(f"  {name}: median {np.median(ratios):.3f}, smallest {ratios.min():.3f}")
    same = np.array([row["operator"]["rms"] / max(row["model"]["rms"], 1e-15) for row in rows])
    print(f"  rms against the spline with the same operator: median {np.median(same):.3f}, smallest {same.min():.3f}")
    wrong = [sum(row[of]["wrong hinges"] for row in rows) for of in ("spline", "model")]
    print(f"  hinges wrong by more than 90 degrees, in sum over cases: spline {wrong[0]:.1f}, model {wrong[1]:.1f}")
    more = max(row["acceleration"] / row["acceleration of the spline"] for row in rows)
    usual = np.median([row["acceleration rms"] / row["acceleration rms of the spline"] for row in rows])
    leaping = max(row["leaping"] for row in rows)
    print(f"  acceleration: at most {more:.2f} of the spline's, rms {usual:.2f} in the median; leaping {leaping:.3g}")


if __name__ == "__main__":
    sys.exit(main())
