"""A bar of three rigid bones."""

from __future__ import annotations

import numpy as np

from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Index
from tests.meshes import rotation, tube


def three_bones() -> tuple[MeshSequence, Index]:
    """A bar that bends at z = 4/3 about x and at z = 8/3 about y, with the bone ``(F,)`` of every face."""
    points, faces = tube(8, 41)
    z = points[:, 2]
    frames = []
    for t in np.linspace(0, 1, 6):
        x = points.copy()
        for joint, turn in ((8 / 3, rotation((0, t, 0))), (4 / 3, rotation((-0.9 * t, 0, 0)))):
            pivot = np.array([0, 0, joint])
            share = np.clip((z - joint) / 0.4 + 0.5, 0.0, 1.0)[:, None]
            x = (1 - share) * x + share * ((x - pivot) @ turn.T + pivot)
        frames.append(x)
    bones = np.searchsorted([4 / 3, 8 / 3], z[faces].mean(axis=1))
    return MeshSequence.from_arrays(np.stack(frames), faces), bones.astype(np.int64)
