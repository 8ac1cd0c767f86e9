"""Resampling: keep every 2nd or 4th frame, rebuild the others, compare with cubic interpolation of vertices.

Usage: scripts/bench resample [NAME ...]   (animations of $MIXSEQ_DATA/npz; all of them by default)

Ratios are error of vertex interpolation over error of the model: above 1 the model is better. The second table
takes two far poses of one file, and blends them with weights 0.25, 0.5, 0.75: errors are against the blended
lengths, and against the blended volume.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

import mixseq
from mixseq.geometry.lengths_angles import edge_lengths
from mixseq.sequence import MeshSequence

Float = NDArray[np.float64]
PAIRS = (("lion_poses", 2, 5), ("cat_poses", 1, 3), ("horse_poses", 1, 3))
MEASURES = ("rms", "strain rms", "strain mean", "degrees rms", "volume")


def main() -> int:
    data = Path(os.environ.get("MIXSEQ_DATA", ""), "npz")
    names = sys.argv[1:] or sorted(path.stem for path in data.glob("*.npz"))
    if not names:
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    columns = ("sequence", "every", "keys", "s", *(f"{name}: vertices / model" for name in MEASURES))
    print("| " + " | ".join(columns) + " |\n|" + "---|" * len(columns))
    rows = [row for name in names for step in (2, 4) if (row := measure(data / f"{name}.npz", step))]
    for name in MEASURES:
        ratios = np.array([r for row in rows if (r := ratio(row, name)) is not None])
        if ratios.size:
            print(f"{name}: ratio median {np.median(ratios):.3f}, smallest {ratios.min():.3f}")
    if not sys.argv[1:]:
        pairs = [row for pair in PAIRS for row in blend(data / f"{pair[0]}.npz", *pair[1:])]
    Path("out").mkdir(exist_ok=True)
    Path("out/resample.json").write_text(
        json.dumps({"rows": rows, "pairs": pairs if not sys.argv[1:] else []})
    )
    return 0


def ratio(row: dict[str, Any], name: str) -> float | None:
    vertices, model = row["vertices"][name], row["model"][name]
    return None if vertices is None else float(vertices / max(model, 1e-15))


def measure(path: Path, step: int) -> dict[str, Any] | None:
    """Rebuild what is between every `step`-th frame; nothing if there are fewer than three of these."""
    sequence = mixseq.read(path)
    keys = np.arange(0, len(sequence), step)
    if len(keys) < 3:
        return None
    new = np.setdiff1d(np.arange(keys[-1]), keys)
    start = time.perf_counter()
    model = mixseq.fit(part(sequence, keys), exact=True)
    rebuilt = model.sample(sequence.times[new])
    seconds = time.perf_counter() - start
    truth = part(sequence, new)
    x = sequence.points[keys].astype(np.float64)
    spline = make_interp_spline(sequence.times[keys], x, k=min(3, len(keys) - 1))
    vertices = truth.with_points(spline(truth.times))
    row: dict[str, Any] = {
        "sequence": path.stem,
        "step": step,
        "keys": len(keys),
        "seconds": seconds,
        "vertices": errors(truth, vertices),
        "model": errors(truth, rebuilt),
    }
    cells = [f"{show(row['vertices'][name])} / {show(row['model'][name])}" for name in MEASURES]
    print(f"| {path.stem} | {step} | {len(keys)} | {seconds:.1f} | " + " | ".join(cells) + " |", flush=True)
    return row


def part(sequence: MeshSequence, frames: NDArray[np.int64]) -> MeshSequence:
    header = sequence.header.with_times(sequence.times[frames])
    return MeshSequence.from_header(header, sequence.points[frames].astype(np.float64))


def errors(truth: MeshSequence, other: MeshSequence) -> dict[str, float | None]:
    found = mixseq.compare(truth, other)
    edges = mixseq.Topology(truth.faces, truth.vertex_count).edges
    lengths = edge_lengths(truth.points, edges)
    there = lengths > 0
    strain = np.abs(edge_lengths(other.points, edges)[there] / lengths[there] - 1)
    return {
        "rms": found.rms_error,
        "strain rms": found.edge_strain.rms,
        "strain mean": float(strain.mean()),
        "degrees rms": found.dihedral_degrees.rms,
        "volume": found.volume.mean if found.volume else None,
    }


def show(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def blend(path: Path, first: int, second: int) -> list[dict[str, Any]]:
    """Blend two frames of a file; the model knows all its frames."""
    sequence = mixseq.read(path)
    model = mixseq.fit(sequence, exact=True)
    ends = sequence.points[[first, second]].astype(np.float64)
    edges = mixseq.Topology(sequence.faces, sequence.vertex_count).edges
    rows = []
    print(
        f"\n| {path.stem} {first}-{second} | strain rms | strain 99 % | volume error % |\n|---|---|---|---|"
    )
    for weight in (0.25, 0.5, 0.75):
        blended = np.array([1 - weight, weight])
        lengths = blended @ edge_lengths(ends, edges)
        volumes = blended @ np.array([volume(x, sequence.faces) for x in ends])
        vectors = blended @ model.vectors[[first, second]]
        for name, x in (
            ("vertices", np.einsum("k,kvi->vi", blended, ends)),
            ("model", model.space.decode(vectors[None])[0]),
        ):
            strain = np.abs(edge_lengths(x, edges) / lengths - 1)
            row = {
                "pair": f"{path.stem} {first}-{second}",
                "weight": weight,
                "method": name,
                "strain": float(np.sqrt(np.square(strain).mean())),
                "strain99": float(np.quantile(strain, 0.99)),
                "volume": float(100 * abs(volume(x, sequence.faces) / volumes - 1)),
            }
            rows.append(row)
            print(
                f"| w = {weight}, {name} | {row['strain']:.3g} | {row['strain99']:.3g} | {row['volume']:.2g} |",
                flush=True,
            )
    return rows


def volume(points: Float, faces: NDArray[np.int32]) -> float:
    p, q, r = (points[faces[:, corner]] - points.mean(axis=0) for corner in range(3))
    return float(np.einsum("fi,fi->", p, np.cross(q, r)) / 6)


if __name__ == "__main__":
    sys.exit(main())
