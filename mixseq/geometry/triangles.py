"""Triangles as arrays of corners, checked, and their unit normals: what searches among triangles begin with."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.errors import InvalidSequenceError

NO_AREA = 1e-12
"""Triangles lower than this fraction of their longest side have no area: their normals are rounding. Ours."""


def corners_of(points: FloatArray, faces: IntArray) -> Float:
    """Return the corners ``(F, 3, 3)`` of the triangles ``(F, 3)`` of points ``(V, 3)``.

    Raises
    ------
    InvalidSequenceError
        If the shapes are others, a triangle names a vertex that is not there, or one of its corners is not finite.
    """
    points, faces = np.asarray(points, dtype=np.float64), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise InvalidSequenceError(
            f"points of shape {points.shape} and faces of shape {faces.shape} are no triangle mesh; "
            "give points (V, 3) and faces (F, 3)"
        )
    missing = ((faces < 0) | (faces >= len(points))).any(axis=1)
    if missing.any():
        face = int(missing.argmax())
        raise InvalidSequenceError(
            f"triangle {face} is of vertices {faces[face].tolist()}, but there are {len(points)} points; "
            f"vertices are numbered from 0 to {len(points) - 1}"
        )
    corners = np.ascontiguousarray(points[faces], dtype=np.float64)
    broken = ~np.isfinite(corners).all(axis=(1, 2))
    if broken.any():
        raise InvalidSequenceError(
            f"triangle {int(broken.argmax())} has a corner that is not finite; give finite points"
        )
    return corners


def unit_normals(corners: Float) -> Float:
    """Return the unit normals ``(F, 3)`` of triangles ``(F, 3, 3)``; NaN where they have no area (`NO_AREA`).

    Examples
    --------
    >>> faces = np.array([[[0.0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
    >>> unit_normals(faces)[:, 2].tolist()
    [1.0, nan]
    """
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.einsum("fki,fki->fk", sides, sides).max(axis=1, initial=0.0)
    normals = np.cross(sides[:, 0], sides[:, 1])
    areas = np.sqrt(np.einsum("fi,fi->f", normals, normals))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(normals / np.where(areas > NO_AREA * longest, areas, np.nan)[:, None])
