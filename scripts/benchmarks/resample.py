"""Resampling: keep some frames, rebuild the others, compare with cubic interpolation of vertices.

Ratios are error of vertex interpolation over error of the model: above 1 the model is better. Constants of the method
were chosen on one half of the animations; names of the other half have a star. q_horse_gallop and q_wolf_gallop are
left out: their files have every second frame as a key, and the frames between lie on straight lines.

Usage: scripts/bench resample [NAME ...]   (animations of $MIXSEQ_DATA/npz; fourteen by default)
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.temporal import select_operator
from mixseq.types import Float, Index
from scripts.benchmarks.common.harness import animation, markdown_table, print_table

CHOSEN_ON = (
    "abc_dembones_bone", "elephant_gallop", "fox_run", "q_alpaca_gallop", "q_fox_gallopjump", "q_man_run",
    "q_trex_run", "q_wolf_attack",
)  # fmt: skip
OTHERS = (
    "fox_survey", "horse_gallop", "q_horse_eating", "q_man_swordslash", "q_woman_run", "robotexpressive_dance",
)  # fmt: skip

SHOWN = ("rms", "strain rms", "degrees rms", "max", "wrong hinges")
COLUMNS = (
    "sequence", "every", "keys", "s", *(f"{name}: spline / model" for name in SHOWN), "same operator", "acceleration",
)  # fmt: skip

LONG = 40
"""Number of frames from which on sequences are also rebuilt from every 8th frame."""

FINE = 16
"""Steps between two keys, where accelerations are measured."""

Motion = Callable[[Float], Float]
"""From times ``(N,)`` to points ``(N, V, 3)``."""

measured: list[dict[str, Any]] = []
"""What the summary is made of: errors of all motions, case by case."""


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Thin out the frames of an animation in several ways, and rebuild them."""
    sequence = animation(name)
    for every, frames in kept_frames(len(sequence)).items():
        keys = part(sequence, frames)
        truth = part(sequence, np.setdiff1d(np.arange(frames[0], frames[-1]), frames))
        start = time.perf_counter()
        model = mixseq.fit(keys, exact=True)
        rebuilt = model.sample(truth.times).points
        seconds = time.perf_counter() - start
        x = keys.points.astype(np.float64)
        spline = make_interp_spline(keys.times, x, k=min(3, len(keys) - 1))
        operator = select_operator(keys.times, x.reshape(len(x), -1))
        case: dict[str, Any] = {
            "sequence": name,
            "is dense": every in ("2", "4"),
            "spline": errors(truth, spline(truth.times)),
            "operator": errors(truth, operator.weights_at(truth.times).interpolate(x)),
            "model": errors(truth, np.asarray(rebuilt)),
            "acceleration": acceleration_ratio(keys, lambda t: np.concatenate(list(model.blocks(t))), spline),  # noqa: B023
        }
        measured.append(case)
        yield (
            name + "*" * (name in OTHERS),
            every,
            str(len(keys)),
            f"{seconds:.1f}",
            *(f"{case['spline'][each]:.3g} / {case['model'][each]:.3g}" for each in SHOWN),
            f"{case['operator']['rms'] / case['model']['rms']:.2f}",
            f"{case['acceleration']:.2f}",
        )


def kept_frames(count: int) -> dict[str, Index]:
    """Return the frames that are kept: every 2nd and 4th, every 8th of long sequences, and three of them all."""
    kept = {str(step): np.arange(0, count, step) for step in ((2, 4, 8) if count >= LONG else (2, 4))}
    half = min(count - 1, 16) // 2
    kept["3 keys"] = np.arange(0, 2 * half + 1, max(half, 1))
    return {name: frames for name, frames in kept.items() if len(frames) >= 3 and frames[1] > 1}


def part(sequence: MeshSequence, frames: Index) -> MeshSequence:
    header = sequence.header.with_times(sequence.times[frames])
    return MeshSequence.from_header(header, sequence.points[frames].astype(np.float64))


def errors(truth: MeshSequence, points: Float) -> dict[str, float | None]:
    """Measure rebuilt points ``(N, V, 3)``."""
    found = mixseq.compare(truth, truth.with_points(points))
    topology = mixseq.Topology(truth.faces, truth.vertex_count)
    lengths = edge_lengths(truth.points, topology.edges)
    there = lengths > 0
    strain = np.abs(edge_lengths(points, topology.edges)[there] / lengths[there] - 1)
    bends = (
        wrap_angles(dihedral_angles(y, topology.hinges) - dihedral_angles(x, topology.hinges))
        for x, y in zip(truth.points, points, strict=True)
    )
    return {
        "rms": found.rms_error,
        "max": found.max_error,
        "strain rms": float(np.sqrt(np.square(strain).mean())),
        "strain mean": float(strain.mean()),
        "degrees rms": found.dihedral_degrees.rms,
        "volume": found.volume.mean if found.volume else None,
        "wrong hinges": sum(int(np.count_nonzero(np.abs(each) > np.pi / 2)) for each in bends) / len(points),
    }


def acceleration_ratio(keys: MeshSequence, model: Motion, spline: Motion) -> float:
    """Return the largest second difference of the model over the spline's, on a fine grid in three intervals."""
    count = len(keys) - 1
    largest = {"model": 0.0, "spline": 0.0}
    for start in sorted({min(1, count - 1), count // 2, max(count - 2, 0)}):
        times = np.linspace(keys.times[start], keys.times[start + 1], FINE + 1)
        for name, motion in (("model", model), ("spline", spline)):
            bends = np.linalg.norm(np.diff(motion(times), 2, axis=0), axis=2)
            largest[name] = max(largest[name], float(bends.max()))
    return largest["model"] / largest["spline"]


def summary() -> str:
    """Return medians and smallest ratios by half, and by how dense the keys are."""
    groups = {
        f"{title}, {'every 2nd and 4th' if dense else '8th and three keys'}": [
            case for case in measured if case["is dense"] == dense and case["sequence"] in names
        ]
        for dense in (True, False)
        for title, names in (("chosen on", CHOSEN_ON), ("not chosen on", OTHERS))
    }
    groups = {title: cases for title, cases in groups.items() if cases}

    def ratios(name: str, cases: list[dict[str, Any]], peer: str = "spline") -> str:
        pairs = [(case[peer][name], case["model"][name]) for case in cases if case["model"][name] is not None]
        found = np.array([theirs / max(ours, 1e-15) for theirs, ours in pairs])
        return f"{np.median(found):.2f}, {found.min():.2f}" if found.size else ""

    table = [
        (name, *(ratios(name, cases) for cases in groups.values()))
        for name in ("rms", "max", "strain rms", "strain mean", "degrees rms", "volume")
    ]
    table.append(
        ("rms, spline with the same operator", *(ratios("rms", cases, "operator") for cases in groups.values()))
    )
    return markdown_table(("", *groups), table)


if __name__ == "__main__":
    code = print_table(COLUMNS, rows, sorted((*CHOSEN_ON, *OTHERS)))
    print(f"\nError of the spline over error of the model, median and smallest.\n\n{summary()}")
    sys.exit(code)
