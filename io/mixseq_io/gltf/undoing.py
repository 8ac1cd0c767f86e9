"""Inverse transforms of nodes whose mesh is in world space, below transformed parents: such a mesh keeps its path.

The inverse is rounded, and unevenly scaled parents have none as translation, rotation and scale; nearly inverse
transforms are accepted, since exporters write scales such as 0.9999999. A mark in the node's ``extras`` makes the
reader take the points as world space, as long as the transforms still nearly cancel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float

MARK = "mixseq:world"
"""Member of the ``extras`` of a node whose points are in world space."""

_NEARLY = 1e-6  # rounding of rotations and scales by exporters
_HERE = 1e-9  # rounding of translations by mixseq


def undoing(above: NDArray[np.float64]) -> dict[str, Any] | None:
    """Return the transform that nearly inverts a parent's ``(4, 4)``, {} for the identity, None if there is none."""
    if np.array_equal(above, np.eye(4)):
        return {}
    if not np.isfinite(above).all() or abs(np.linalg.det(above)) < 1e-30:
        return None
    inverse = np.linalg.inv(above)
    scale = np.linalg.norm(inverse[:3, :3], axis=0)
    scale[0] = np.copysign(scale[0], np.linalg.det(inverse))
    rotation = Rotation.from_matrix(inverse[:3, :3] / scale)
    own = np.eye(4)
    own[:3, :3], own[:3, 3] = rotation.as_matrix() * scale, inverse[:3, 3]
    if not nearly_undone(above[None] @ own):
        return None
    return {
        "translation": (own[:3, 3] + 0.0).tolist(),
        "rotation": rotation.as_quat().tolist(),
        "scale": scale.tolist(),
    }


def nearly_undone(world: Float) -> bool:
    """Whether matrices ``(B, 4, 4)`` are the identity within the rounding of exporters."""
    off = np.abs(world - np.eye(4))
    return bool((off[:, :3, :3] < _NEARLY).all() and (off[:, :3, 3] < _HERE).all())
