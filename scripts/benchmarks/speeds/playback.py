"""Playback: the mean time to decode a frame of a fitted sequence against one iteration on the full mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import mixseq
from mixseq.runtime.parallel import thread_executor
from mixseq.shells.gauss_newton import ShellSettings
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.full_mesh import FullMesh, iterate
from scripts.benchmarks.common.section import Bar, Say, Section, Table, at_least
from scripts.benchmarks.common.timing import Timing, repeated

NAMES = {"horse_gallop": 10, "elephant_gallop": 10, "q_man_run": None}
"""How many frames should be decoded while the full mesh does one iteration; None: for information."""

RANK = 20
THREADS = (1, 2)
COLUMNS = (
    "sequence",
    "V",
    "decode ms/frame, 1 thread",
    "2 threads",
    "iteration ms, 1 thread",
    "2 threads",
    "ratio, 1 thread",
    "2 threads",
    "KG %",
    "max error/diag",
)


def measure(say: Say) -> Section:
    """Measure all animations."""
    rows: list[tuple[str, ...]] = []
    section = Section("Playback", [Table(f"Rank {RANK}, anchored; all frames in order.", COLUMNS, rows)])
    for name, target in NAMES.items():
        _measure(section, rows, name, target, say)
    section.notes.append(
        "An iteration on the full mesh is assembly, refactorisation and solution with rslab, after symbolic "
        "analysis. The ratio for two threads is relative to the faster of both columns."
    )
    return section


def _measure(section: Section, rows: list[tuple[str, ...]], name: str, target: int | None, say: Say) -> None:
    sequence = animation(name)
    say(f"{name}: fit")
    model = mixseq.fit(sequence, rank=RANK)
    error = mixseq.compare(sequence, model.sample())
    ours = {}
    for threads in THREADS:
        say(f"{name}: decode on {threads} threads")
        runs, _ = repeated(lambda: play(model, threads), 7, 20.0, warm=True)  # noqa: B023
        ours[threads] = Timing(tuple(seconds / len(sequence) for seconds in runs.runs))
    theirs = {}
    topology = model.mixed.topology
    ends = sequence.points[[0, 1]].astype(np.float64) / sequence.diagonal
    for threads in THREADS:
        say(f"{name}: an iteration on the full mesh, {threads} threads")
        mesh = FullMesh(topology, ends, threads, ShellSettings())
        mesh.prepare()
        theirs[threads], _ = repeated(lambda: iterate(mesh.problem, mesh.ends[0]), 7, 20.0)  # noqa: B023
    best = min(timing.median for timing in theirs.values())
    ratios = {1: theirs[1].median / ours[1].median, 2: best / ours[2].median}
    rows.append(
        (
            name,
            str(sequence.vertex_count),
            *(ours[threads].text(1e3) for threads in THREADS),
            *(theirs[threads].text(1e3) for threads in THREADS),
            *(f"{ratios[threads]:.3g}" for threads in THREADS),
            f"{error.kg_percent:.3g}",
            f"{error.max_error:.2g}",
        )
    )
    section.figures.append(
        {
            "sequence": name,
            "decode_seconds": {threads: timing.runs for threads, timing in ours.items()},
            "iteration_seconds": {threads: timing.runs for threads, timing in theirs.items()},
            "kg_percent": error.kg_percent,
            "max_error": error.max_error,
        }
    )
    if target is not None:
        for threads in THREADS:
            section.targets.append(
                at_least(f"{name}: frames in one full-mesh iteration, {threads} threads", ratios[threads], target)
            )
        section.bars.append(Bar(f"{name}, playback, 2 threads", ratios[2], target))


def play(model: mixseq.Model, threads: int) -> list[NDArray[np.float64]]:
    """Decode all frames."""
    return list(model.blocks(model.times, workers=thread_executor(threads)))
