"""Long, dense and large sequences on the command line: seconds and memory of every step.

``long`` is a tube of 100 vertices that bends in three joints and never repeats itself in 10,000 frames; ``large`` a
torus of a million vertices in three frames, whose thickness goes in waves; ``dense-N`` the galloping elephant with
every triangle split into four, repeated for N frames.

Usage: scripts/bench scale [SOURCE ...]   (all but the elephant need no data)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mixseq.types import Float, FloatArray, Index, IntArray
from scripts.benchmarks.common.harness import MIXSEQ, animation, print_table, run, slow_signals, subdivided

SOURCES = ("long", "dense-60", "dense-240", "large")
COLUMNS = ("sequence", "vertices", "frames", "step", "s", "CPU s", "MB")

MODEL = ("encode", "{source}", "model.h5")
STEPS = {
    "long": {"encode": MODEL, "encode --exact": (*MODEL, "--exact")},
    "dense": {"encode --rank 20": (*MODEL, "--rank", "20"), "decode to USD": ("decode", "model.h5", "again.usdc")},
    "large": {
        "encode": MODEL,
        "encode --max-error 0.001": ("encode", "{source}", "small.h5", "--max-error", "0.001"),
        "verify": ("verify", "small.h5", "{source}"),
        "convert to GLB": ("convert", "{source}", "large.glb"),
    },
}
"""What is run; a step may need a file of the one before."""

TUBE_FRAMES = 10_000
TORUS_SIDE = 1000
"""Vertices of the torus, along and across."""

BONE_HEADS = (0.0, 0.9, 1.8, 2.7)
"""Where bones of the tube begin, along its axis."""


def rows(source: str) -> Iterator[tuple[str, ...]]:
    """Write a sequence and run its steps, each in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, f"{source}.npz")
        # In a process of its own too, as a new one inherits the peak of memory of the one that starts it.
        vertices, frames = run(sys.executable, "-m", "scripts.benchmarks.scale", source, file).output.split()
        for step, words in STEPS[source.partition("-")[0]].items():
            paths = [word.format(source=file) for word in words]
            local = [str(Path(folder, word)) if word.endswith((".h5", ".glb", ".usdc")) else word for word in paths]
            found = run(*MIXSEQ, *local)
            yield source, vertices, frames, step, f"{found.seconds:.1f}", f"{found.cpu:.1f}", f"{found.megabytes:.0f}"


def write(source: str, file: str) -> None:
    """Write a sequence, and print how many vertices and frames it has."""
    kind, _, count = source.partition("-")
    points, faces = tube() if kind == "long" else torus() if kind == "large" else dense(int(count))
    np.savez(file, points=points, faces=faces)
    print(points.shape[1], len(points))


def dense(frames: int) -> tuple[FloatArray, IntArray]:
    """Repeat the frames of an elephant with four times its triangles."""
    points, faces = subdivided(animation("elephant_gallop"))
    return points[np.arange(frames) % len(points)], faces


def tube() -> tuple[FloatArray, Index]:
    """Bend a tube by slow random turns of its bones."""
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(0)

    def signals() -> Float:
        return slow_signals(random, TUBE_FRAMES, random.uniform(24, 96, (3, 3)))

    angle, along = 2 * np.pi * np.arange(10) / 10, 0.4 * np.repeat(np.arange(10), 10)
    rest = np.stack([along, np.tile(0.5 * np.cos(angle), 10), np.tile(0.5 * np.sin(angle), 10)], axis=1)
    weights = np.exp(-(((rest[:, :1] - (np.array(BONE_HEADS) + 0.45)) / 0.35) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)
    turns, place = np.tile(np.eye(3), (TUBE_FRAMES, 1, 1)), 0.5 * signals()
    points = np.zeros((TUBE_FRAMES, len(rest), 3))
    for bone, head in enumerate(BONE_HEADS):
        if bone:
            place = place + turns @ [head - BONE_HEADS[bone - 1], 0, 0]
        turns = turns @ Rotation.from_rotvec(0.3 * signals()).as_matrix()
        posed = np.einsum("tij,vj->tvi", turns, rest - [head, 0, 0]) + place[:, None]
        points += weights[:, bone, None] * posed
    ring, k = np.divmod(np.arange(90), 10)
    a, b = 10 * ring + k, 10 * ring + (k + 1) % 10
    faces = np.stack([a, a + 10, b, b, a + 10, b + 10], axis=1).reshape(-1, 3)
    return points.astype(np.float32), faces


def torus(side: int = TORUS_SIDE) -> tuple[FloatArray, Index]:
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


if __name__ == "__main__":
    if sys.argv[-1].endswith(".npz"):
        write(*sys.argv[1:])
    else:
        sys.exit(print_table(COLUMNS, rows, SOURCES))
