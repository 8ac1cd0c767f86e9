r"""The similarity between marked points (Umeyama 1991).

Wanted are the rotation R, scale s and translation t that minimise :math:`\sum_k \|s R x_k + t - y_k\|^2`. R is that of
the best rigid motion, a proper rotation, and with points about their centroids

.. math:: s = \frac{\sum_k y_k \cdot R x_k}{\sum_k \|x_k\|^2} .
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.geometry.rigid import kabsch


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * rotation x + translation``.

    Attributes
    ----------
    scale : float
    rotation : (3, 3) float64
    translation : (3,) float64
    """

    scale: float
    rotation: Float
    translation: Float

    def __call__(self, points: Float) -> Float:
        """Move points ``(..., 3)``."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)


def fit_similarity(source: Float, target: Float) -> Similarity:
    """Find the similarity that best moves points ``(n, 3)`` onto others.

    Raises
    ------
    SettingsError
        If the points of either side are all in one place.
    """
    rotation, _ = kabsch(source, target)
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    x, y = (source - from_centre) @ rotation.T, target - to_centre
    spread, shared = float(np.sum(x * x)), float(np.sum(x * y))
    if not (spread > 0 and shared > 0):
        raise SettingsError("the markers are all in one place; mark points all over the meshes")
    scale = shared / spread
    return Similarity(scale, rotation, to_centre - scale * rotation @ from_centre)
