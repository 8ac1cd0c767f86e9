"""Long sequences from short ones: loops of an animation, none of which is like another.

The motion is repeated, and so is no new information; a slow random variation goes on top of it, so that it is: a rigid
motion of the whole and a smooth bending of the space around it. Both are sums of a few waves in time with random
periods of 1 to 4 loops.
"""

from __future__ import annotations

import numpy as np

import mixseq
from mixseq.types import Float

WAVES = 3
BENDS = 6
TURN = 0.1  # radians
DRIFT = 0.05  # diagonals
BEND = 0.01  # diagonals


def varied(sequence: mixseq.MeshSequence, loops: int, seed: int = 0) -> mixseq.MeshSequence:
    """Repeat a sequence so often, with variation."""
    from scipy.spatial.transform import Rotation

    random = np.random.default_rng(seed)
    frames, diagonal = loops * len(sequence), sequence.diagonal
    points = np.tile(sequence.points.astype(np.float64), (loops, 1, 1))
    centre = sequence.points[0].mean(axis=0, dtype=np.float64)
    x = points - centre

    waves = random.normal(size=(BENDS, 3)) * 2 / diagonal  # about a third of a wave over the mesh
    towards = random.normal(size=(BENDS, 3)) * BEND * diagonal / np.sqrt(BENDS)
    sizes = _slow(random, frames, len(sequence), BENDS)
    for wave, phase, vector, size in zip(waves, random.uniform(0, 2 * np.pi, BENDS), towards, sizes.T, strict=True):
        points += size[:, None, None] * np.sin(x @ wave + phase)[..., None] * vector

    turns = Rotation.from_rotvec(TURN * _slow(random, frames, len(sequence), 3)).as_matrix()
    drift = DRIFT * diagonal * _slow(random, frames, len(sequence), 3)
    moved = np.einsum("tij,tvj->tvi", turns, points - centre) + (centre + drift)[:, None]
    header = sequence.header.with_times(np.arange(frames) / sequence.header.fps)
    return mixseq.MeshSequence.from_header(header, moved.astype(sequence.points.dtype))


def _slow(random: np.random.Generator, frames: int, loop: int, count: int) -> Float:
    """Return random signals ``(T, count)`` of about unit size."""
    periods = loop * random.uniform(1, 4, (WAVES, count))
    phases = random.uniform(0, 2 * np.pi, (WAVES, count))
    angle = 2 * np.pi * np.arange(frames)[:, None, None] / periods + phases
    return np.asarray(np.sqrt(2 / WAVES) * np.sin(angle).sum(axis=1))
