"""Sampling of default models beside the cubic spline of the vertices, and writing of .usdc beside plain pxr.

Rates are per CPU second; medians of several runs, in which ours and the peers take turns. Errors are root mean squares
over left-out frames, of models and splines of every second frame, in diagonals.

Usage: scripts/bench sampling [NAME ...]   (animations of $MIXSEQ_DATA/npz)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, Vt
from scipy.interpolate import make_interp_spline

import mixseq
from mixseq.types import Float, FloatArray, IntArray
from scripts.benchmarks.common.harness import animation, cpu_timed, print_table

RUNS = 7
FRAMES_PER_FRAME = 4
"""Number of sampled frames per frame of the animation."""

WRITTEN_FRAMES = 60
COLUMNS = (
    "sequence", "V", "key shapes", "frames/s", "spline", "ratio", "error between frames", "spline",
    ".usdc MB/s, float32", "float64", "plain pxr", "ratio, float32", "float64",
)  # fmt: skip


def rows(name: str) -> Iterator[tuple[str, ...]]:
    """Sample and write an animation."""
    sequence = animation(name)
    model, spline = mixseq.fit(sequence), spline_of(sequence)
    times = np.linspace(model.start, model.end, FRAMES_PER_FRAME * (len(sequence) - 1) + 1)
    ours, theirs = medians(lambda: [block[0] for block in model.blocks(times)], lambda: [spline(t) for t in times])
    points = np.resize(sequence.points, (WRITTEN_FRAMES, *sequence.points.shape[1:])).astype(np.float32)
    header = sequence.header.with_times(np.arange(WRITTEN_FRAMES) / 24)
    repeated = mixseq.MeshSequence.from_header(header, points)
    precise = repeated.with_points(points.astype(np.float64) + 1e-9 * sequence.diagonal)
    with tempfile.TemporaryDirectory() as folder:
        file = str(Path(folder, "a.usdc"))
        writers = (lambda: mixseq.write(file, repeated), lambda: mixseq.write(file, precise))
        single, double, plain = medians(*writers, lambda: write_plainly(file, points, sequence.faces))
    rate = points.nbytes / 1e6
    yield (
        name,
        str(sequence.vertex_count),
        str(len(model.shapes)),
        f"{len(times) / ours:.0f}",
        f"{len(times) / theirs:.0f}",
        f"{theirs / ours:.3f}",
        *(f"{error:.2g}" for error in left_out_errors(sequence)),
        *(f"{rate / seconds:.0f}" for seconds in (single, double, plain)),
        *(f"{plain / seconds:.2f}" for seconds in (single, double)),
    )


def medians(*functions: Callable[[], object]) -> list[float]:
    """Return the median CPU seconds of functions that take turns, after a run of each that is not counted."""
    seconds = [[cpu_timed(function)[0] for function in functions] for _ in range(RUNS + 1)]
    return [float(median) for median in np.median(seconds[1:], axis=0)]


def spline_of(sequence: mixseq.MeshSequence) -> Callable[[Float], Float]:
    spline: Callable[[Float], Float] = make_interp_spline(sequence.times, sequence.points.astype(np.float64))
    return spline


def left_out_errors(sequence: mixseq.MeshSequence) -> tuple[float, float]:
    """Return the errors of a default model and of the spline of every second frame, at the frames between."""
    kept = np.arange(0, len(sequence), 2)
    header = sequence.header.with_times(sequence.times[kept])
    keys = mixseq.MeshSequence.from_header(header, sequence.points[kept])
    between = np.arange(1, kept[-1], 2)
    times, expected = sequence.times[between], sequence.points[between]
    found = (mixseq.fit(keys)(times), spline_of(keys)(times))
    model_error, spline_error = (
        float(np.sqrt(np.square(x - expected).sum(axis=2).mean())) / sequence.diagonal for x in found
    )
    return model_error, spline_error


def write_plainly(file: str, points: FloatArray, faces: IntArray) -> None:
    """Write points and faces with pxr alone, with the extents that it computes."""
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/mesh")
    mesh.CreateFaceVertexCountsAttr(Vt.IntArrayFromBuffer(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArrayFromBuffer(faces.astype(np.int32).reshape(-1)))
    values, extents = mesh.CreatePointsAttr(), mesh.CreateExtentAttr()
    for code, frame in enumerate(points):
        array = Vt.Vec3fArrayFromBuffer(frame)
        values.Set(array, code)
        extents.Set(UsdGeom.PointBased.ComputeExtent(array), code)
    stage.GetRootLayer().Export(file)


if __name__ == "__main__":
    sys.exit(print_table(COLUMNS, rows, ("q_man_run", "horse_gallop", "elephant_gallop")))
