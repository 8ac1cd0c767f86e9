"""Frames between frames: which are kept, how well others are rebuilt, and how smoothly these follow each other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import make_interp_spline

import mixseq
from mixseq.mesh.measures import dihedral_angles, edge_lengths, wrap_angles
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.temporal import select_operator
from mixseq.types import Float, Index

Motion = Callable[[Float], Float]
"""From times ``(N,)`` to points ``(N, V, 3)``."""

LONG = 40
"""Sequences with so many frames are also rebuilt from every 8th of them."""

FINE = 16
"""Steps between two keys, where accelerations are measured."""


def kept_frames(count: int) -> dict[str, Index]:
    """Return the frames that are kept: every 2nd and 4th, every 8th of long sequences, and three of them all."""
    kept = {"2": np.arange(0, count, 2), "4": np.arange(0, count, 4)}
    if count >= LONG:
        kept["8"] = np.arange(0, count, 8)
    half = min(count - 1, 16) // 2
    kept["3 keys"] = np.arange(0, 2 * half + 1, max(half, 1))
    return {name: frames for name, frames in kept.items() if len(frames) >= 3 and frames[1] > 1}


def part(sequence: MeshSequence, frames: Index) -> MeshSequence:
    header = sequence.header.with_times(sequence.times[frames])
    return MeshSequence.from_header(header, sequence.points[frames].astype(np.float64))


def vertex_spline(keys: MeshSequence) -> Motion:
    """Cubic interpolation of vertices: what everybody has."""
    x = keys.points.astype(np.float64)
    spline = make_interp_spline(keys.times, x, k=min(3, len(keys) - 1))
    return lambda times: np.asarray(spline(times))


def vertex_operator(keys: MeshSequence) -> Motion:
    """Interpolation of vertices by the operator that the model chooses in time: better ends, and no more."""
    x = keys.points.astype(np.float64)
    operator = select_operator(keys.times, x.reshape(len(x), -1))
    return lambda times: operator.weights_at(times).interpolate(x)


def errors(truth: MeshSequence, points: Float) -> dict[str, float | None]:
    """Measure rebuilt points ``(N, V, 3)``."""
    other = truth.with_points(points)
    found = mixseq.compare(truth, other)
    topology = mixseq.Topology(truth.faces, truth.vertex_count)
    lengths = edge_lengths(truth.points, topology.edges)
    there = lengths > 0
    strain = np.abs(edge_lengths(points, topology.edges)[there] / lengths[there] - 1)
    wrong = 0
    for x, y in zip(truth.points, points, strict=True):
        apart = wrap_angles(dihedral_angles(y, topology.hinges) - dihedral_angles(x, topology.hinges))
        wrong += int(np.count_nonzero(np.abs(apart) > np.pi / 2))
    return {
        "rms": found.rms_error,
        "max": found.max_error,
        "strain rms": float(np.sqrt(np.square(strain).mean())),
        "strain mean": float(strain.mean()),
        "degrees rms": found.dihedral_degrees.rms,
        "volume": found.volume.mean if found.volume else None,
        "wrong hinges": wrong / len(points),
    }


def accelerations(keys: MeshSequence, model: Motion, spline: Motion) -> dict[str, float]:
    """Compare second differences on a fine grid in three intervals, in diagonals per squared interval.

    A vertex leaps where its second difference is ten times its own median, and four times what nearly all have in the
    spline.
    """
    count = len(keys) - 1
    intervals = sorted({min(1, count - 1), count // 2, max(count - 2, 0)})
    unit = float(np.linalg.norm(np.ptp(keys.points[0], axis=0)))
    found: dict[str, list[Float]] = {"model": [], "spline": []}
    for start in intervals:
        times = np.linspace(keys.times[start], keys.times[start + 1], FINE + 1)
        for name, motion in (("model", model), ("spline", spline)):
            bends = np.linalg.norm(np.diff(motion(times), 2, axis=0), axis=2) * FINE**2 / unit
            found[name].append(bends)
    ours, others = (np.concatenate(found[name]) for name in ("model", "spline"))
    usual = 4 * np.quantile(others, 0.999)
    leaping = (ours > 10 * np.median(ours, axis=0)) & (ours > usual)
    return {
        "acceleration": float(ours.max()),
        "acceleration of the spline": float(others.max()),
        "acceleration rms": float(np.sqrt(np.square(ours).mean())),
        "acceleration rms of the spline": float(np.sqrt(np.square(others).mean())),
        "leaping": float(leaping.sum() / len(ours)),
    }
