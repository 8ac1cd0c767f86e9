"""The plane that shows most of a sequence: classical multidimensional scaling of its frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]


def plane(weights: Float, shapes: Float, metric: Float) -> tuple[Float, Float]:
    """Find the plane of the first two principal components of blended shapes.

    Parameters
    ----------
    weights : (T, K) float64
        Affine weights of the key shapes in every frame.
    shapes : (K, S) float64
        Key shapes.
    metric : (S,) float64
        Weight of every coordinate in distances.

    Returns
    -------
    origin : (K,) float64
        Mean weights.
    axes : (K, 2) float64
        ``(weights - origin) @ axes`` are the coordinates of a shape in the plane. Columns are zero where the
        frames span less than a plane.
    """
    origin = weights.mean(axis=0)
    centred = shapes - shapes.mean(axis=0)  # weights that add up to zero do not see the mean
    gram = (centred * np.square(metric)) @ centred.T
    spread = weights - origin
    sizes, directions = np.linalg.eigh(spread @ gram @ spread.T)
    axes = np.zeros((len(origin), 2))
    for column in range(min(2, len(sizes))):
        size, direction = sizes[-1 - column], directions[:, -1 - column]
        if size > 1e-24 * max(sizes[-1], np.finfo(np.float64).tiny):
            direction = direction * np.sign(direction[np.abs(direction).argmax()])
            axes[:, column] = gram @ (spread.T @ direction) / np.sqrt(size)
    return origin, axes
