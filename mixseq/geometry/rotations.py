"""Rotation vectors without jumps.

A rotation by the angle t about the unit axis u is stored as the rotation vector ``t u``. The logarithm has
many branches, ``(t + 2 pi k) u``; along a sequence we take, frame by frame, the branch closest to the frame
before, so that a body that turns twice has a vector of length 4 pi and linear operations make sense.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float, FloatArray

_TURN = 2.0 * np.pi


def matrices(vectors: FloatArray) -> Float:
    """Return the rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)`` (exponential map)."""
    flat = Rotation.from_rotvec(np.array(vectors, dtype=np.float64).reshape(-1, 3)).as_matrix()
    return np.asarray(flat.reshape(*vectors.shape[:-1], 3, 3), dtype=np.float64)


def vectors(rotations: FloatArray) -> Float:
    """Return the shortest rotation vectors ``(..., 3)`` of matrices ``(..., 3, 3)`` (logarithm)."""
    flat = Rotation.from_matrix(np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat.reshape(*rotations.shape[:-2], 3), dtype=np.float64)


def continuous_vectors(rotations: FloatArray, reference: FloatArray | None = None) -> Float:
    """Return rotation vectors that follow a sequence of rotations without jumps.

    Parameters
    ----------
    rotations : (T, ..., 3, 3) float
        Rotation matrices, frame by frame.
    reference : (..., 3) float, optional
        Rotation vectors that the first frame stays close to; the shortest branch without it.

    Returns
    -------
    (T, ..., 3) float64
        Rotation vectors; each is the branch of the logarithm nearest to the frame before.
    """
    return unwrap(vectors(rotations), reference)


def unwrap(shortest: FloatArray, reference: FloatArray | None = None) -> Float:
    """Return the rotation vectors ``(T, ..., 3)`` of `continuous_vectors`, from those of any branch."""
    result = np.array(shortest, dtype=np.float64)
    previous = reference
    for frame in range(len(result)):
        if previous is not None:
            result[frame] = _nearest_branch(result[frame], previous)
        previous = result[frame]
    return result


def _nearest_branch(vector: Float, previous: FloatArray) -> Float:
    """Of all ``vector + 2 pi k axis`` return the one closest to `previous`."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    previous_angle = np.linalg.norm(previous, axis=-1, keepdims=True)
    # Where the rotation is the identity its axis is free: go on along the axis of the frame before.
    fallback = np.divide(previous, previous_angle, out=np.zeros_like(vector), where=previous_angle > 0)
    axis = np.where(angle > 1e-12, vector / np.where(angle > 0, angle, 1.0), fallback)
    along = np.sum(previous * axis, axis=-1, keepdims=True)
    return np.asarray(vector + _TURN * np.round((along - angle) / _TURN) * axis, dtype=np.float64)
