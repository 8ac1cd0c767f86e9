"""Meshes of a glTF file whose points are in world space, below nodes that stand elsewhere: their own nodes undo these.

So a mesh that is written anew keeps its parent and its path. The inverse of what stands above it is rounded, and where
a node above is scaled unevenly it is no translation, rotation and scale; but exporters write scales such as 0.9999999.
What nearly undoes counts as undoing: the mark in the node's ``extras`` tells our reader that its points are exactly
those in the world, as long as that is still nearly true.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float

MARK = "mixseq:world"
"""Member of the ``extras`` of a node whose points are in world space."""

_NEARLY = 1e-6  # what exporters round of turns and scales
_HERE = 1e-9  # of translations nothing but our own rounding is left


def undoing(above: NDArray[np.float64]) -> dict[str, Any] | None:
    """Return the members of a node below a matrix ``(4, 4)`` that nearly undo it; None if nothing does.

    Examples
    --------
    >>> shifted = np.eye(4)
    >>> shifted[:3, 3] = 1, 2, 3
    >>> undoing(shifted)["translation"]
    [-1.0, -2.0, -3.0]
    >>> sheared = np.eye(4)
    >>> sheared[0, 1] = 0.5
    >>> undoing(sheared) is None
    True
    """
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
    """Tell whether matrices ``(B, 4, 4)`` leave points where they are, but for what exporters round."""
    off = np.abs(world - np.eye(4))
    return bool((off[:, :3, :3] < _NEARLY).all() and (off[:, :3, 3] < _HERE).all())
