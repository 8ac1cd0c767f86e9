"""Rigid motions: the best one between two point sets, and the registration of many sets to their mean."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.sequence import FloatArray

Float = NDArray[np.float64]


def nearest_rotations(matrices: FloatArray) -> Float:
    """Return the rotations ``(..., 3, 3)`` nearest to the given matrices in the Frobenius norm."""
    u, _, vt = np.linalg.svd(matrices)
    flip = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u = u.copy()
    u[..., :, 2] *= np.where(flip == 0, 1.0, flip)[..., None]
    return np.asarray(u @ vt, dtype=np.float64)


def kabsch(source: FloatArray, target: FloatArray, weights: FloatArray | None = None) -> tuple[Float, Float]:
    """Find the rigid motions ``x -> R x + t`` that best move a point set onto others (Kabsch 1976).

    Parameters
    ----------
    source : (..., N, 3) float
        Points to move.
    target : (..., N, 3) float
        Where they should go; leading dimensions broadcast, so that one source meets many targets.
    weights : (N,) float, optional
        Weight of every point.

    Returns
    -------
    rotation : (..., 3, 3) float64
    translation : (..., 3) float64

    Notes
    -----
    Fewer than three points, or points on a line, leave a rotation free; then the one closest to the identity
    is taken, by a term too small to matter elsewhere.

    Examples
    --------
    >>> points = np.eye(3)
    >>> rotation, translation = kabsch(points, points + [1.0, 2, 3])
    >>> rotation.round(9).tolist() == np.eye(3).tolist(), translation.round(9).tolist()
    (True, [1.0, 2.0, 3.0])
    """
    count = source.shape[-2]
    w = np.full(count, 1.0 / max(count, 1)) if weights is None else weights / weights.sum()
    source_centre = np.einsum("n,...ni->...i", w, source)
    target_centre = np.einsum("n,...ni->...i", w, target)
    s = (source - source_centre[..., None, :]) * w[:, None]
    t = target - target_centre[..., None, :]
    covariance = np.swapaxes(t, -1, -2) @ s
    values = np.linalg.svd(covariance, compute_uv=False)
    scale = values[..., 0]
    free = values[..., 1] <= 1e-10 * scale
    bias = np.where(free, np.maximum(1e-6 * scale, np.finfo(np.float64).tiny), 0.0)
    rotation = nearest_rotations(covariance + bias[..., None, None] * np.eye(3))
    translation = target_centre - np.einsum("...ij,...j->...i", rotation, source_centre)
    return rotation, translation


def transform(points: FloatArray, rotation: FloatArray, translation: FloatArray) -> Float:
    """Apply ``x -> R x + t`` to points ``(..., N, 3)``."""
    return np.asarray(points @ np.swapaxes(rotation, -1, -2) + translation[..., None, :], dtype=np.float64)


def mean_shape(points: FloatArray, sweeps: int = 50, tolerance: float = 1e-10) -> Float:
    """Register a point set over all frames and return its mean.

    This is generalised Procrustes analysis without scale.

    Parameters
    ----------
    points : (T, N, 3) float
        One point set, frame by frame.
    sweeps : int
        At most this many rounds of aligning all frames to the mean.
    tolerance : float
        Stop when the mean moves by less than this, relative to its size.

    Returns
    -------
    (N, 3) float64
        Mean shape, centred, oriented like the first frame. Aligning every frame to it minimises the squared
        differences between all pairs of aligned frames (Williams and Bennamoun 2000, for complete overlap).
    """
    centred = points - points.mean(axis=1, keepdims=True, dtype=np.float64)
    first = centred[0]
    mean = first
    for _ in range(sweeps):
        rotation, _ = kabsch(centred, mean)
        updated = (centred @ np.swapaxes(rotation, -1, -2)).mean(axis=0)
        change = np.linalg.norm(updated - mean)
        mean = updated
        if change <= tolerance * np.linalg.norm(mean):
            break
    rotation, _ = kabsch(mean, first)
    return np.asarray(mean @ rotation.T, dtype=np.float64)


def bend(first: FloatArray, second: FloatArray) -> float:
    """How far two moving bodies turn against each other.

    Parameters
    ----------
    first, second : (T, 3, 3) float
        Their rotations, frame by frame.

    Returns
    -------
    float
        Largest angle in degrees between their relative rotations in any two frames.

    Examples
    --------
    >>> quarter = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    >>> round(bend(np.stack([np.eye(3), np.eye(3)]), np.stack([np.eye(3), quarter])), 6)
    90.0
    """
    relative = np.swapaxes(first, 1, 2) @ second
    traces = np.einsum("sij,tij->st", relative, relative)
    return float(np.degrees(np.arccos(np.clip((traces.min() - 1.0) / 2.0, -1.0, 1.0))))
