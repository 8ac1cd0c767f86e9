"""One interpolated frame, w = 0.5 between two far poses: MixIT against full-mesh Gauss-Newton."""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np

import mixseq
from mixseq.errors import MissingExtraError
from mixseq.operations.interpolation import PoseInterpolator
from mixseq.shells.gauss_newton import ShellReport, ShellSettings
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.envelope import envelope
from scripts.benchmarks.common.full_mesh import FullMesh, iterate
from scripts.benchmarks.common.section import Bar, Say, Section, Table, at_least, at_most
from scripts.benchmarks.common.timing import Timing, repeated

PAIRS = (
    ("lion_poses", 2, 5, 10),
    ("lion_poses", 4, 6, 10),
    ("cat_poses", 1, 3, 10),
    ("cat_poses", 4, 6, 10),
    ("horse_poses", 1, 3, 10),
    ("horse_poses", 6, 10, 10),
    ("elephant_gallop", 0, 12, 20),
    ("elephant_gallop", 0, 5, 20),
)
"""Animation, its two frames, how many times faster MixIT should be. The second pair of each is the farthest."""

SPACES: dict[str, dict[str, Any]] = {"MixIT": {}, "MixIT, free": {"placement": "free"}}
"""What `mixseq.interpolate` is told."""

WEIGHTS = (0.25, 0.5, 0.75)
"""Weights of the second pose at which errors are compared with those of the full mesh."""

LENGTHS, ANGLES, SHARE = 1.0, 1.15, 0.6
"""How many times the full mesh's errors they should be at most, lengths at 99.9 %, angles at 99 %; and how much of the
time of one of its iterations a blend should take."""

ONCE = 10.0
"""A full-mesh solve that takes more seconds than this is not repeated."""

COLUMNS = ("pair", "method", "s", "iterations", "converged", "full mesh / this", "relative length", "degrees")


def measure(say: Say) -> Section:
    """Measure all pairs.

    Raises
    ------
    MissingExtraError
        If rslab, which solves both sides, is not installed.
    """
    if not find_spec("rslab"):
        raise MissingExtraError("rslab is not installed, get it with: pip install 'mixseq[fast]'")
    rows: list[tuple[str, ...]] = []
    section = Section(
        "One interpolated frame",
        [Table("Errors against the means of the two frames, at 99 % / 99.9 % / max.", COLUMNS, rows)],
    )
    for name, first, second, factor in PAIRS:
        _measure_pair(section, rows, name, first, second, factor, say)
    section.notes.append(
        "`MixIT` is what `mixseq.interpolate` does: poses are reconciled with the relations of neighbours, then "
        "lengths and angles with each other. `MixIT, free` is the paper's placement. Both take a fixed number of "
        "steps with constant matrices. "
        "`vertex means` are the plain means of the vertices, as a reference without a method. "
        "`full mesh` is Gauss-Newton on all lengths and angles with the kernels, the solver and the criteria of the "
        "joints, from the mean of the vertices or from the linear start, on one thread and on two; the fastest is "
        "the reference. Symbolic analysis and compilation are not timed. `capped`: stopped at the largest number of "
        "iterations; `held back`: the last steps were damped without finding a better point."
    )
    return section


def _measure_pair(
    section: Section, rows: list[tuple[str, ...]], name: str, first: int, second: int, factor: float, say: Say
) -> None:
    sequence = animation(name)
    pair = f"{name} {first}-{second}"
    ends = sequence.points[[first, second]].astype(np.float64) / sequence.diagonal
    topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
    solved: list[tuple[str, Timing, list[ShellReport], Any, int]] = []

    blends: dict[str, PoseInterpolator] = {}
    for method, told in SPACES.items():
        say(f"{pair}: {method}")
        blends[method] = PoseInterpolator.from_poses(sequence, pose_ids=[first, second], **told)
        blends[method].space.precompute()
        timing, points = repeated(partial(blends[method].blend, [0.5, 0.5]), 7, 20.0, warm=True)
        solved.append((method, timing, [], points / sequence.diagonal, 1))
    settings = ShellSettings()

    for threads in (1, 2):
        mesh = FullMesh(topology, ends, threads, settings)
        mesh.prepare()
        starts = {"vertices": mesh.from_vertices}
        if topology.component_count == 1:
            starts["linear start"] = mesh.from_frames
        for start, solve in starts.items():
            say(f"{pair}: full mesh from {start}, {threads} threads")
            timing, (points, report) = repeated(solve, 3, ONCE)
            solved.append((f"full mesh, {start}, {threads} thr.", timing, [report], points, threads))

    one = min(_iteration(topology, ends, threads, settings) for threads in (1, 2))
    fastest = min(timing.median for method, timing, *_ in solved if method.startswith("full"))
    means = envelope(topology, ends.mean(axis=0), mesh.lengths, mesh.angles)
    rows.append((pair, "vertex means", "-", "-", "-", "", *means.texts()))
    section.figures.append({"pair": pair, "method": "vertex means", "lengths": means.lengths, "degrees": means.degrees})
    for method, timing, reports_, points, threads in solved:
        errors = envelope(topology, points, mesh.lengths, mesh.angles)
        ratio = fastest / timing.median
        ours = method.startswith("MixIT")
        rows.append(
            (
                pair,
                method,
                timing.text(),
                ", ".join(str(report.iterations) for report in reports_) or "-",
                _state(reports_, settings.iterations),
                f"{ratio:.3g}" if ours else "",
                *errors.texts(),
            )
        )
        section.figures.append(
            {
                "pair": pair,
                "method": method,
                "threads": threads,
                "seconds": timing.runs,
                "iterations": [report.iterations for report in reports_],
                "converged": [report.converged for report in reports_],
                "lengths": errors.lengths,
                "degrees": errors.degrees,
            }
        )
        if ours:
            section.targets.append(at_least(f"{pair}, {method}: times faster than full mesh", ratio, factor))
            section.targets.append(at_most(f"{pair}, {method}: of one iteration", timing.median / one, SHARE))
            section.bars.append(Bar(f"{pair}, {method}", ratio, factor))

    for weight in WEIGHTS:
        say(f"{pair}: errors at {weight}")
        whole = FullMesh(topology, ends, 2, settings, weight)
        solve = whole.from_frames if topology.component_count == 1 else whole.from_vertices
        theirs = envelope(topology, solve()[0], whole.lengths, whole.angles)
        for method, interpolator in blends.items():
            points = interpolator.blend([1.0 - weight, weight]) / sequence.diagonal
            mine = envelope(topology, points, whole.lengths, whole.angles)
            what = f"{pair}, {method}, w = {weight}"
            lengths, angles = mine.lengths[1] / theirs.lengths[1], mine.degrees[0] / theirs.degrees[0]
            section.targets.append(at_most(f"{what}: lengths at 99.9 %, over the full mesh's", lengths, LENGTHS))
            section.targets.append(at_most(f"{what}: angles at 99 %, over the full mesh's", angles, ANGLES))


def _iteration(topology: mixseq.Topology, ends: Any, threads: int, settings: ShellSettings) -> float:
    """Seconds of one iteration of Gauss-Newton on the whole mesh."""
    mesh = FullMesh(topology, ends, threads, settings)
    mesh.prepare()
    return repeated(partial(iterate, mesh.problem, ends[0]), 7, ONCE, warm=True)[0].median


def _state(reports: list[ShellReport], most: int) -> str:
    if not reports:
        return "-"
    if reports[0].converged:
        return "yes"
    return "capped" if reports[0].iterations >= most else "held back"
