"""What all benchmarks share: animations, tables in Markdown, repeated runs, and programs in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

import mixseq
from mixseq.creature import walk_cycle
from mixseq.types import Float, FloatArray, IntArray

DATA = Path(os.environ.get("MIXSEQ_DATA", ""))

MIXSEQ = (str(Path(sys.executable).with_name("mixseq")),)
"""The command line of the environment that the benchmark runs in."""

BROKEN = "**no**"
"""The cell of a promise that does not hold."""

Result = TypeVar("Result")
Rows = Callable[[str], Iterable[Sequence[str]]]
"""Measure an animation by name: the rows of a table."""


# Tables -----------------------------------------------------------------------------------------------------


def print_table(columns: Sequence[str], rows: Rows, names: Sequence[str] = ()) -> int:
    """Print rows of the animations on the command line, or of `names`, or of all; return 1 if a cell is `BROKEN`."""
    chosen = sys.argv[1:] or names or sorted(path.stem for path in (DATA / "npz").glob("*.npz"))
    if not (DATA / "npz").is_dir():
        print("no animations: set MIXSEQ_DATA to the folder that holds npz/", file=sys.stderr)
        return 2
    print(markdown_table(columns, []))
    is_broken = False
    for name in chosen:
        for row in rows(name):
            print(f"| {' | '.join(row)} |", flush=True)
            is_broken |= BROKEN in row
    return int(is_broken)


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


# Animations -------------------------------------------------------------------------------------------------


def animation(name: str) -> mixseq.MeshSequence:
    """Read ``npz/NAME.npz`` of $MIXSEQ_DATA; `NAME xN` repeats it N times, with variation."""
    base, _, loops = name.partition(" x")
    sequence = mixseq.read(DATA / "npz" / f"{base}.npz")
    return repeat_with_variation(sequence, int(loops)) if loops else sequence


def subdivided(sequence: mixseq.MeshSequence) -> tuple[FloatArray, IntArray]:
    """Split every triangle into four at the midpoints of its sides: points ``(T, V + E, 3)``, faces ``(4 F, 3)``."""
    topology = mixseq.Topology(sequence.faces, sequence.vertex_count)
    points = sequence.points
    middles = points[:, topology.edges].mean(axis=2, dtype=np.float64).astype(points.dtype)
    a, b, c = sequence.faces.astype(np.int64).T
    ab, bc, ca = (topology.face_edges + sequence.vertex_count).T
    faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.concatenate([points, middles], axis=1), faces


def repeat_with_variation(sequence: mixseq.MeshSequence, loops: int, seed: int = 0) -> mixseq.MeshSequence:
    """Repeat a sequence, each loop turned (0.1 rad), moved (0.05 diagonals) and bent (0.01 diagonals) in another way.

    All three are sums of waves in time with random periods of 1 to 4 loops.
    """
    from scipy.spatial.transform import Rotation

    bend_count = 6
    random = np.random.default_rng(seed)
    frames, diagonal = loops * len(sequence), sequence.diagonal
    points = np.tile(sequence.points.astype(np.float64), (loops, 1, 1))
    centre = sequence.points[0].mean(axis=0, dtype=np.float64)
    x = points - centre

    waves = random.normal(size=(bend_count, 3)) * 2 / diagonal  # about a third of a wave over the mesh
    towards = random.normal(size=(bend_count, 3)) * 0.01 * diagonal / np.sqrt(bend_count)
    sizes = slow_signals(random, frames, len(sequence) * random.uniform(1, 4, (3, bend_count)))
    phases = random.uniform(0, 2 * np.pi, bend_count)
    for wave, phase, vector, size in zip(waves, phases, towards, sizes.T, strict=True):
        points += size[:, None, None] * np.sin(x @ wave + phase)[..., None] * vector

    signals = (slow_signals(random, frames, len(sequence) * random.uniform(1, 4, (3, 3))) for _ in range(2))
    turns = Rotation.from_rotvec(0.1 * next(signals)).as_matrix()
    drift = 0.05 * diagonal * next(signals)
    moved = np.einsum("tij,tvj->tvi", turns, points - centre) + (centre + drift)[:, None]
    header = sequence.header.with_times(np.arange(frames) / sequence.header.fps)
    return mixseq.MeshSequence.from_header(header, moved.astype(sequence.points.dtype))


def slow_signals(random: np.random.Generator, frames: int, periods: Float) -> Float:
    """Return random signals ``(T, n)`` of about unit size, sums of waves with periods ``(waves, n)`` in frames."""
    phases = random.uniform(0, 2 * np.pi, periods.shape)
    angles = 2 * np.pi * np.arange(frames)[:, None, None] / periods + phases
    return np.asarray(np.sqrt(2 / len(periods)) * np.sin(angles).sum(axis=1))


# Time -------------------------------------------------------------------------------------------------------


def repeated(
    function: Callable[[], Result], runs: int = 5, budget: float = 30.0, warm: bool = False
) -> tuple[tuple[float, ...], Result]:
    """Run a function up to `runs` times, but not again once `budget` seconds are spent: seconds, and the last result.

    With `warm` it runs once before, uncounted: it compiles, and analyses what is kept.
    """
    if warm:
        function()
    seconds: list[float] = []
    while not seconds or (len(seconds) < runs and sum(seconds) < budget):
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return tuple(seconds), result


def format_runs(seconds: Sequence[float], scale: float = 1.0) -> str:
    """Return the median, with the smallest and largest in brackets: ``0.12 (0.11-0.15, 5 runs)``."""
    median, low, high = (scale * float(find(seconds)) for find in (np.median, np.min, np.max))
    return f"{median:.3g} (1 run)" if len(seconds) == 1 else f"{median:.3g} ({low:.3g}-{high:.3g}, {len(seconds)} runs)"


def cpu_timed(function: Callable[[], Result]) -> tuple[float, Result]:
    """Return processor seconds and the result of a function."""
    start = time.process_time()
    result = function()
    return time.process_time() - start, result


def compile_skins() -> None:
    """Fit a small skin, so that no row has the time of the compiler in it."""
    mixseq.fit_skin(walk_cycle(frames=3), 4, rounds=2)


# Programs ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Child:
    """A program that has ended well: wall-clock seconds, peak of its resident memory in MB, what it printed, CPU s."""

    seconds: float
    megabytes: float
    output: str
    cpu: float


class ChildError(Exception):
    """A program failed; the message ends with what it printed last."""


def run(*command: object) -> Child:
    """Run a program to its end.

    The peak is that of the program or of the largest process that it started. A new process inherits the peak of the
    one that starts it, so start large programs from a small one.
    """
    words = [str(word) for word in command]
    with tempfile.TemporaryFile("w+") as output:
        start = time.perf_counter()
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)  # or it would be waited for again
        output.seek(0)
        text = output.read()
    if process.returncode:
        last = " / ".join(text.strip().splitlines()[-3:])
        raise ChildError(f"{' '.join(words[:4])} ... ended with {process.returncode}: {last}")
    # Linux counts in kilobytes of 1024.
    return Child(seconds, usage.ru_maxrss * 1024 / 1e6, text, usage.ru_utime + usage.ru_stime)
