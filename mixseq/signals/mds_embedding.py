r"""The main plane of a sequence: classical multidimensional scaling of its frames.

Let :math:`c_t` be the frames in pose space, :math:`C` their deviations from the mean ``(T, k)``, and :math:`u_1, u_2`
the first two principal components of their shapes, unit vectors of the shape space. With the singular values
:math:`\sigma_i` and the left singular vectors :math:`d_i` of the frames' deviations in the shape space,

.. math:: u_i = \sum_t d_{ti}\, (s_t - \bar s) / \sigma_i, \qquad p_i = C^T d_i / \sigma_i,

the place of a shape in the plane is its product with :math:`u_1` and :math:`u_2`. A step of :math:`p_i` in pose space
is the step :math:`u_i` of the shape: the smallest change by one diagonal along the axis i.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.signals.pose import PoseMap

NEGLIGIBLE = 1e-12
"""Ratio to the largest spread of frames below which a spread is a rounding error."""

FLAT = 1e-4
"""Least spread of frames along an axis, in diagonals and relative to the largest, from which steps are computed."""


class Plane(NamedTuple):
    """A plane through a pose space."""

    origin: Float  # (K,) mean weights of the key shapes
    axes: Float  # (K, 2) ``(weights - origin) @ axes`` are coordinates in the plane; zero without a spread
    directions: Float  # (k, 2) least steps in pose space by one along each axis; zero without a spread

    def checked(self, shapes: int, coordinates: int) -> Plane:
        """Return the plane if it fits numbers of key shapes and pose coordinates; else raise `SettingsError`."""
        if (len(self.origin), len(self.directions)) != (shapes, coordinates):
            raise SettingsError(
                f"the plane is of {len(self.origin)} key shapes and {len(self.directions)} coordinates of pose "
                f"space, the model has {shapes} and {coordinates}; give the plane of a model with the "
                "same pose and shape signals"
            )
        return self


def plane_of(points: Float, pose: PoseMap, shapes: Float, metric: Float) -> Plane:
    """Find the main plane of blended shapes: points ``(T, k)``; shapes ``(K, S)``; metric ``(S,)``."""
    weights = pose.weights(points)
    origin = weights.mean(axis=0)
    centred = shapes - shapes.mean(axis=0)  # weights that add up to zero do not see the mean
    gram = (centred * np.square(metric)) @ centred.T
    spread = weights - origin
    if len(points) <= shapes.shape[1]:
        sizes, frames = np.linalg.eigh(spread @ gram @ spread.T)
    else:
        sizes, frames = _of_many(spread, gram)
    axes, directions = np.zeros((len(origin), 2)), np.zeros((points.shape[1], 2))
    for column in range(min(2, len(sizes))):
        size, frame = sizes[-1 - column], frames[:, -1 - column]
        if size > NEGLIGIBLE**2 * max(sizes[-1], np.finfo(np.float64).tiny):
            frame = frame * np.sign(frame[np.abs(frame).argmax()])
            axes[:, column] = gram @ (spread.T @ frame) / np.sqrt(size)
            if size > FLAT**2 * max(sizes[-1], len(points)):
                directions[:, column] = (points - points.mean(axis=0)).T @ frame / np.sqrt(size)
    return Plane(origin, axes, directions)


def _of_many(spread: Float, gram: Float) -> tuple[Float, Float]:
    """Return `eigh` of ``(spread L)^T (spread L)`` ``(K, K)`` with ``gram = L L^T``, without a T x T matrix."""
    squares, axes = np.linalg.eigh(gram)
    placed = spread @ (axes * np.sqrt(np.maximum(squares, 0.0)))
    sizes, vectors = np.linalg.eigh(placed.T @ placed)
    lengths = np.sqrt(np.maximum(sizes, np.finfo(np.float64).tiny))
    return sizes, placed @ (vectors / lengths)
