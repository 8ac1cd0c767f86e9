"""A tube of three bones whose joints bend by known angles."""

from __future__ import annotations

from functools import cache

import numpy as np

from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float, Index
from tests.meshes import bent, rotation, tube

JOINTS = (2.0, 3.4)
"""Heights of the joints; the first bone is the longest."""

BLEND = 0.3
"""Length of a bend."""

MESH = tube(8, 51, length=5.0)
TIMES = np.arange(9) / 10.0


def angles(times: Float) -> Float:
    """Angles ``(T, 2)`` of both joints in radians."""
    return np.stack([0.5 + 0.4 * np.sin(5.0 * times), -0.3 + 0.5 * np.cos(4.0 * times)], axis=1)


def posed(first: float, second: float, time: float) -> Float:
    """The tube with its joints bent, which turns and wanders off with time."""
    points = bent(MESH[0], second, middle=JOINTS[1], blend=BLEND)
    points = bent(points, first, middle=JOINTS[0], blend=BLEND) if first else points
    return np.asarray(points @ rotation((0.2 * time, 0.9 * time, -0.4 * time)).T + np.array([time, 2.0 * time, -time]))


def frames(bends: Float) -> Float:
    """Points ``(9, V, 3)`` with angles ``(9, 2)``."""
    return np.stack([posed(first, second, time) for (first, second), time in zip(bends, TIMES, strict=True)])


def labels(order: tuple[int, ...] = (0, 1, 2)) -> Index:
    """The bone of every face, numbered in some order from the bottom."""
    height = MESH[0][MESH[1]][:, :, 2].mean(axis=1)
    return np.asarray(np.array(order)[np.searchsorted(JOINTS, height)])


@cache
def chain(order: tuple[int, ...] = (0, 1, 2)) -> Model:
    """The tube in the mixed space, exact; its bones are the parts."""
    sequence = MeshSequence.from_arrays(frames(angles(TIMES)), MESH[1], fps=10, name="chain")
    return fit(sequence, exact=True, parts=labels(order))


def bone(number: int) -> Index:
    """Vertices of a bone that are far from its joints."""
    height = MESH[0][:, 2]
    ends = (-1.0, *JOINTS, 9.0)
    return np.flatnonzero((height > ends[number] + 0.5) & (height < ends[number + 1] - 0.5))
