r"""Picking: the first triangle that a ray from the pointer meets (Möller & Trumbore 1997).

A point of the ray is :math:`o + t\,d`, one of the triangle :math:`a + u\,(b - a) + v\,(c - a)`; they meet where
:math:`t > 0`, :math:`u, v \ge 0` and :math:`u + v \le 1`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import IntArray


class Picked(NamedTuple):
    """The first intersection of a ray."""

    face: int  # the triangle
    vertex: int  # the nearest of its corners
    distance: float  # how far along the ray, in lengths of its direction


def pick(
    points: NDArray[np.floating], faces: IntArray, origin: ArrayLike, direction: ArrayLike
) -> Picked | None:
    """Return the first triangle on a ray ``(3,)``, from either side, or None: points ``(V, 3)``; faces ``(F, 3)``."""
    start, along = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    a, b, c = np.moveaxis(np.asarray(points, dtype=np.float64)[faces], 1, 0)
    first, second = b - a, c - a
    across = np.cross(along, second)
    volume = np.einsum("fi,fi->f", first, across)
    with np.errstate(
        divide="ignore", over="ignore", invalid="ignore"
    ):  # triangles seen edge on, no direction
        offset = start - a
        u = np.einsum("fi,fi->f", offset, across) / volume
        turned = np.cross(offset, first)
        v = turned @ along / volume
        t = np.einsum("fi,fi->f", second, turned) / volume
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & np.isfinite(t)
    if not met.any():
        return None
    face = int(np.where(met, t, np.inf).argmin())
    corners = faces[face]
    place = start + t[face] * along
    nearest = np.linalg.norm(np.asarray(points, dtype=np.float64)[corners] - place, axis=1).argmin()
    return Picked(face, int(corners[nearest]), float(t[face]))
