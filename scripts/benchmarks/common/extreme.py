"""Write a very long sequence, or a very large one, both made up. In a process of its own.

``long`` is a tube of 100 vertices that bends in three joints, travels and never repeats itself in 10,000 frames;
``large`` a torus of a million vertices in three frames, whose thickness goes in waves.

Usage: python -m scripts.benchmarks.common.extreme long|large FILE
"""

from __future__ import annotations

import sys

import numpy as np

from mixseq.types import Float, FloatArray, Index

FRAMES = 10_000
AROUND = 1000  # vertices of the torus, along and across
HEADS = (0.0, 0.9, 1.8, 2.7)  # where bones of the tube begin
WAVES = 3


def main() -> int:
    kind, file = sys.argv[1:]
    points, faces = long() if kind == "long" else large()
    np.savez(file, points=points, faces=faces)
    return 0


def long() -> tuple[FloatArray, Index]:
    """Bend a tube by slow random turns of its bones."""
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(0)
    angle, along = 2 * np.pi * np.arange(10) / 10, 0.4 * np.repeat(np.arange(10), 10)
    rest = np.stack([along, np.tile(0.5 * np.cos(angle), 10), np.tile(0.5 * np.sin(angle), 10)], axis=1)
    weights = np.exp(-(((rest[:, :1] - (np.array(HEADS) + 0.45)) / 0.35) ** 2))
    weights /= weights.sum(axis=1, keepdims=True)
    turns, place = np.tile(np.eye(3), (FRAMES, 1, 1)), 0.5 * _slow(random)
    points = np.zeros((FRAMES, len(rest), 3))
    for bone, head in enumerate(HEADS):
        if bone:
            place = place + turns @ [head - HEADS[bone - 1], 0, 0]
        turns = turns @ Rotation.from_rotvec(0.3 * _slow(random)).as_matrix()
        posed = np.einsum("tij,vj->tvi", turns, rest - [head, 0, 0]) + place[:, None]
        points += weights[:, bone, None] * posed
    ring, k = np.divmod(np.arange(90), 10)
    a, b = 10 * ring + k, 10 * ring + (k + 1) % 10
    faces = np.stack([a, a + 10, b, b, a + 10, b + 10], axis=1).reshape(-1, 3)
    return points.astype(np.float32), faces


def large() -> tuple[FloatArray, Index]:
    """Bend a torus, and let waves run over it."""
    u, v = np.meshgrid(*[2 * np.pi * np.arange(AROUND) / AROUND] * 2, indexing="ij")
    frames = []
    for frame in range(3):
        thickness = 0.3 + 0.02 * np.sin(5 * v + 2 * u + frame)
        turn, radius = u + 0.1 * frame * np.sin(u), 1 + thickness * np.cos(v)
        height = thickness * np.sin(v) + 0.1 * frame * np.cos(2 * u)
        place = [radius * np.cos(turn), radius * np.sin(turn), height]
        frames.append(np.stack(place, axis=-1).reshape(-1, 3))
    i, j = (each.reshape(-1) for each in np.indices((AROUND, AROUND)))
    after, beside = (i + 1) % AROUND, (j + 1) % AROUND
    a, b, c, d = i * AROUND + j, after * AROUND + j, after * AROUND + beside, i * AROUND + beside
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.array(frames, dtype=np.float32), faces.astype(np.int32)


def _slow(random: np.random.Generator) -> Float:
    """Return three slow random signals ``(T, 3)`` of about unit size."""
    periods, phases = random.uniform(24, 96, (WAVES, 3)), random.uniform(0, 2 * np.pi, (WAVES, 3))
    angles = 2 * np.pi * np.arange(FRAMES)[:, None, None] / periods + phases
    return np.asarray(np.sqrt(2 / WAVES) * np.sin(angles).sum(axis=1))


if __name__ == "__main__":
    sys.exit(main())
