r"""The volume term of discrete shells (Froehlich and Botsch 2011): a surface holds as much as it should.

With :math:`c` the mean of a piece's vertices the signed volume over its faces is

.. math:: V(x) = \tfrac16 \sum_{ijk} \det(x_i - c,\; x_j - c,\; x_k - c) .

Of a closed surface this is the volume, whatever c is; of an open one it is that of the cone from its centre, which a
rigid motion does not change either. The term is one residual :math:`w\,(V - V^*) / \bar V`, with :math:`\bar V` the
volume of the reference. Faces of opposite orientations cancel, so that sheets have hardly any volume; where
:math:`|\bar V|` is below `FLAT` times area to the 3/2 there is no term.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, IntArray

FLAT = 1e-3
"""Volume over area to the 3/2 below which a surface is a sheet; that of a sphere is 0.094. The number is ours."""


def volume(points: FloatArray, faces: IntArray) -> float:
    """Return the signed volume of points ``(n, 3)`` about their mean, over faces ``(m, 3)``.

    Examples
    --------
    >>> corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    >>> round(6 * volume(corner, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])), 9)
    1.0
    """
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def volume_gradient(points: FloatArray, faces: IntArray) -> Float:
    """Return the derivatives ``(n, 3)`` of `volume`; they add up to zero, as moving all vertices changes nothing."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    pulls = np.concatenate([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0
    corners = faces.T.reshape(-1)
    gradient = np.stack([np.bincount(corners, pull, minlength=len(x)) for pull in pulls.T], axis=1)
    return np.asarray(gradient - gradient.mean(axis=0))


def surface_area(points: FloatArray, faces: IntArray) -> float:
    """Return the area of points ``(n, 3)`` over faces ``(m, 3)``."""
    a, b, c = (points[corner] for corner in faces.T)
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def is_sheet(points: FloatArray, faces: IntArray) -> bool:
    """Say whether a surface holds too little to be told by its volume; see the module."""
    return bool(abs(volume(points, faces)) <= FLAT * surface_area(points, faces) ** 1.5)


@dataclass(frozen=True, eq=False)
class VolumeTerm:
    """The residual of a volume, a `DenseTerm` of `mixseq.shells.fitting`.

    Attributes
    ----------
    faces : (m, 3) int64
        Triangles of the surface.
    target : float
        Volume that is wanted.
    weight : float
        Weight of the term over the volume of the reference, so that the residual counts relative changes.
    """

    faces: NDArray[np.int64]
    target: float
    weight: float

    def residual(self, points: Float) -> float:
        """Implement `DenseTerm.residual`."""
        return self.weight * (volume(points, self.faces) - self.target)

    def gradient(self, points: Float) -> Float:
        """Implement `DenseTerm.gradient`."""
        return self.weight * volume_gradient(points, self.faces)
