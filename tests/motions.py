"""A smooth motion of a tube, known at any time, and constructions with cuts, holds, repeats and keys."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.types import Float
from tests.meshes import tube

MESH = tube(6, 12)
TOPOLOGY = Topology(MESH[1], len(MESH[0]))


def moving(frames: Float) -> Float:
    """Points ``(T, V, 3)`` of a tube that travels, sways and stretches, at any frame numbers ``(T,)``."""
    t, x = frames[:, None, None] / 10, MESH[0]
    phase = x[:, 2:] / np.ptp(x[:, 2])
    sway = np.concatenate([np.sin(3 * t + phase), np.cos(2 * t - phase), np.sin(1.3 * t) * phase], axis=2)
    return np.asarray(x + 0.4 * sway + t * [0.5, 0, 0.2])
