"""Parts that move, frame by frame."""

from __future__ import annotations

import numpy as np

from mixseq.mesh.rotations import align_quat_signs, normalise_quat, quat_multiply
from mixseq.spaces.temporal import Poses
from mixseq.types import Float

AXIS = np.array([2.0, -1.0, 2.0]) / 3


def turns_of(angles: Float, axis: Float = AXIS) -> Float:
    """Quaternions ``(T, 1, 4)`` of turns about an axis."""
    half = np.asarray(angles)[:, None] / 2
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=1)[:, None]


def wandering(seed: int, parts: int, frames: int = 12) -> Poses:
    """Parts that turn and move about by chance, a little every frame."""
    rng = np.random.default_rng(seed)
    q = normalise_quat(rng.normal(size=(1, parts, 4)))
    path = [q[0]]
    for _ in range(frames - 1):
        path.append(quat_multiply(path[-1], normalise_quat([1.0, 0, 0, 0] + 0.3 * rng.normal(size=(parts, 4)))))
    return Poses(align_quat_signs(np.stack(path)), np.cumsum(rng.normal(scale=0.2, size=(frames, parts, 3)), axis=0))
