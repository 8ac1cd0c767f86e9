"""Peak memory of jobs on the command line against an aim, and growth of their CPU time.

The aim is `BASE_MEGABYTES`, and `INPUT_RATIO` times points and triangles in single precision. ``torus-SIDE`` is a
torus with SIDE^2 vertices in three frames, whose thickness goes in waves, ``tube-FRAMES-VERTICES`` a tube that bends
and swells.

Usage: scripts/bench memory [SOURCE ...]   (needs no data)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mixseq.types import FloatArray, Index
from scripts.benchmarks.common.harness import MIXSEQ, print_table, run

SOURCES = (
    *("torus-250", "torus-500", "torus-1000", "tube-1-2000000"),
    *("tube-1000-200", "tube-4000-200", "tube-16000-200", "tube-20000-200"),
)
COLUMNS = ("sequence", "vertices", "frames", "job", "CPU s", "MB", "aim MB")

JOBS = {
    "encode": ("encode", "a.npz", "model.h5"),
    "encode --max-error 0.001": ("encode", "a.npz", "small.h5", "--max-error", "0.001"),
    "compare": ("compare", "a.npz", "b.npz"),
    "verify": ("verify", "small.h5", "a.npz"),
    "convert to GLB": ("convert", "a.npz", "a.glb"),
}

INPUT_RATIO, BASE_MEGABYTES = 6, 400
"""Aim of peak memory: multiple of the input in single precision, and megabytes for libraries and compiled code."""

NOISE_AMPLITUDE = 1e-4
"""Standard deviation of the vertices of the compared sequence."""


def rows(source: str) -> Iterator[tuple[str, ...]]:
    """Write a sequence and run the jobs, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        # In a process of its own too, as a new one inherits the peak of memory of the one that starts it.
        written = run(sys.executable, "-m", "scripts.benchmarks.memory", source, folder).output.split()
        frames, vertices, faces = map(int, written)
        aim = INPUT_RATIO * 12e-6 * (frames * vertices + faces) + BASE_MEGABYTES
        for job, words in JOBS.items():
            local = [str(Path(folder, word)) if word.endswith((".npz", ".h5", ".glb")) else word for word in words]
            child = run(*MIXSEQ, *local)
            yield source, str(vertices), str(frames), job, f"{child.cpu:.1f}", f"{child.megabytes:.0f}", f"{aim:.0f}"


def write(source: str, folder: str) -> None:
    """Write a sequence and a noisy copy; print the numbers of its frames, vertices and faces."""
    kind, *sizes = source.split("-")
    points, faces = torus(int(sizes[0])) if kind == "torus" else tube(*map(int, sizes))
    np.savez(Path(folder, "a.npz"), points=points, faces=faces)
    for frame, noise in zip(points, map(np.random.default_rng, range(len(points))), strict=True):
        frame += NOISE_AMPLITUDE * noise.standard_normal(frame.shape, dtype=np.float32)
    np.savez(Path(folder, "b.npz"), points=points, faces=faces)
    print(*points.shape[:2], len(faces))


def torus(side: int) -> tuple[FloatArray, Index]:
    """Bend a torus of ``side * side`` vertices, and let waves run over it."""
    u, v = np.meshgrid(*[2 * np.pi * np.arange(side) / side] * 2, indexing="ij")
    frames = []
    for frame in range(3):
        thickness = 0.3 + 0.02 * np.sin(5 * v + 2 * u + frame)
        turn, radius = u + 0.1 * frame * np.sin(u), 1 + thickness * np.cos(v)
        height = thickness * np.sin(v) + 0.1 * frame * np.cos(2 * u)
        frames.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=-1).reshape(-1, 3))
    i, j = (each.reshape(-1) for each in np.indices((side, side)))
    after, beside = (i + 1) % side, (j + 1) % side
    a, b = i * side + j, after * side + j
    c, d = after * side + beside, i * side + beside
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.array(frames, dtype=np.float32), faces.astype(np.int32)


def tube(frames: int, vertices: int) -> tuple[FloatArray, Index]:
    """Bend a tube of about this number of vertices, and let waves run along it."""
    sides = max(10, round((vertices / 4) ** 0.5)) if vertices >= 1000 else 10
    rings = vertices // sides
    along, angle = 4 * np.repeat(np.arange(rings), sides) / rings, np.tile(2 * np.pi * np.arange(sides) / sides, rings)
    phases, rates = np.split(np.random.default_rng(0).uniform([0] * 4 + [0.5] * 4, [6] * 4 + [2] * 4), 2)
    points = np.empty((frames, sides * rings, 3), dtype=np.float32)
    for frame in range(frames):
        time = frame / 24
        first = 0.21 * np.sin(rates[0] * time + phases[0]) + 0.07 * np.sin(2.7 * rates[1] * time)
        second, radius = 0.2 * np.sin(rates[2] * time + phases[2]), 0.5 + 0.03 * np.sin(3 * along + rates[3] * time)
        x, y = radius * np.cos(angle) + first * np.sin(along), radius * np.sin(angle) + second * np.cos(along)
        points[frame] = np.stack([x, y, along], axis=1)
    ring, k = np.divmod(np.arange((rings - 1) * sides), sides)
    a, b = sides * ring + k, sides * ring + (k + 1) % sides
    faces = np.stack([a, a + sides, b, b, a + sides, b + sides], axis=1).reshape(-1, 3)
    return points, faces.astype(np.int32)


if __name__ == "__main__":
    if len(sys.argv) == 3 and Path(sys.argv[-1]).is_dir():
        write(*sys.argv[1:])
    else:
        sys.exit(print_table(COLUMNS, rows, SOURCES))
