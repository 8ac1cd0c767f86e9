r"""A sequence as a matrix of rank K: coefficients in time times basis vectors over the mesh.

A sequence about its mean point is a matrix; with the singular vectors :math:`U` of what is left of it without its mean,
A sequence about its mean point is a matrix; with the singular vectors :math:`U` of the rest without the row means,

- *shape space* (Alexa and Mueller 2000): ``(T, 3V)``; a vector is a shape, the mean shape is one more of them
- *trajectory space* (as in CoDDyAC, Vasa and Skala 2007): ``(3T, V)``; a vector is one number a vertex, the mean is a
  number for each row
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from mixseq.types import Float, FloatArray

Space = Literal["shape", "trajectory"]


class Components(NamedTuple):
    """Mean of the rows ``(R,)``, coefficients ``(R, K)`` as long as their singular values, basis vectors ``(K, N)``."""

    mean: Float
    coefficients: Float
    vectors: Float


def components(points: FloatArray, space: Space) -> Components:
    """Return all components of points ``(T, V, 3)``, those with the largest singular values first."""
    matrix = to_matrix(points.astype(np.float64), space)
    if space == "shape":
        mean, shape = np.zeros(len(matrix)), matrix.mean(axis=0)
        rest = matrix - shape
    else:
        mean = matrix.mean(axis=1)
        rest = matrix - mean[:, None]
    _, eigenvectors = np.linalg.eigh(rest @ rest.T)
    eigenvectors = eigenvectors[:, ::-1]
    vectors = eigenvectors.T @ rest
    if space == "shape":
        constant = np.full((len(matrix), 1), len(matrix) ** -0.5)
        eigenvectors = np.concatenate([constant, eigenvectors], axis=1)
        vectors = np.concatenate([shape[None] * len(matrix) ** 0.5, vectors])
    return Components(mean, eigenvectors * np.linalg.norm(vectors, axis=1), vectors)


def to_matrix(points: Float, space: Space) -> Float:
    """Lay out points ``(T, V, 3)`` as a matrix of a space."""
    if space == "shape":
        return points.transpose(0, 2, 1).reshape(len(points), -1)
    return points.transpose(2, 0, 1).reshape(3 * len(points), -1)


def to_points(matrix: Float, space: Space, frames: int) -> Float:
    """Undo `to_matrix`."""
    if space == "shape":
        return matrix.reshape(frames, 3, -1).transpose(0, 2, 1)
    return matrix.reshape(3, frames, -1).transpose(1, 2, 0)
