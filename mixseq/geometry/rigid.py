"""Rigid motions: the best one between two point sets, and the registration of many sets to their mean."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mixseq.arrays import Float, FloatArray

_POINTS = 1 << 12  # points per block, in all frames
_FRAMES = 256  # compared at once with all frames


def nearest_rotations(matrices: FloatArray) -> Float:
    """Return the rotations ``(..., 3, 3)`` nearest to the given matrices in the Frobenius norm."""
    return _nearest(np.asarray(matrices, dtype=np.float64), held=-1.0)


def aligning_rotations(covariances: FloatArray) -> Float:
    """Find the rotations ``(..., 3, 3)`` of best rigid motions from the covariances ``sum w t s^T`` of point sets.

    These are the nearest rotations. Where points on a line leave a rotation undetermined, the one closest to the
    identity is taken, by a term too small to matter elsewhere.
    """
    return _nearest(np.asarray(covariances, dtype=np.float64), held=1e-10)


def _nearest(matrices: Float, held: float) -> Float:
    from mixseq.geometry.rigid_kernels import nearest

    if not np.isfinite(matrices).all():
        raise np.linalg.LinAlgError("a matrix with an entry that is not finite has no nearest rotation")
    flat = np.ascontiguousarray(matrices).reshape(-1, 3, 3)
    return np.asarray(nearest(flat, held)).reshape(matrices.shape)


def kabsch(source: FloatArray, target: FloatArray, weights: FloatArray | None = None) -> tuple[Float, Float]:
    """Find rigid motions ``x -> R x + t`` of points ``(..., N, 3)``, weights ``(N,)``, onto others (Kabsch 1976)."""
    count = source.shape[-2]
    w = np.full(count, 1.0 / max(count, 1)) if weights is None else weights / weights.sum()
    source_centre = np.einsum("n,...ni->...i", w, source)
    target_centre = np.einsum("n,...ni->...i", w, target)
    s = (source - source_centre[..., None, :]) * w[:, None]
    t = target - target_centre[..., None, :]
    rotation = aligning_rotations(np.swapaxes(t, -1, -2) @ s)
    translation = target_centre - np.einsum("...ij,...j->...i", rotation, source_centre)
    return rotation, translation


def transform(points: FloatArray, rotation: FloatArray, translation: FloatArray) -> Float:
    """Apply ``x -> R x + t`` to points ``(..., N, 3)``."""
    return np.asarray(points @ np.swapaxes(rotation, -1, -2) + translation[..., None, :], dtype=np.float64)


def mean_shape(points: FloatArray, sweeps: int = 50, tolerance: float = 1e-10) -> Float:
    """Return the mean shape ``(N, 3)`` of points ``(T, N, 3)`` by generalised Procrustes analysis without scale."""
    count = points.shape[1]
    centres = points.mean(axis=1, dtype=np.float64)

    def centred() -> Iterator[tuple[slice, Float]]:
        for start in range(0, count, _POINTS):
            some = slice(start, start + _POINTS)
            yield some, (points[:, some] - centres[:, None]).swapaxes(1, 2).reshape(3 * len(points), -1)

    products = np.zeros((3 * len(points), 3 * len(points)))
    for _, block in centred():
        products += block @ block.T

    def size(sums: Float) -> float:  # of the point set that is a sum of the frames
        return float(np.sqrt(max(np.sum(sums * (products @ sums)), 0.0)))

    mean = np.eye(3 * len(points), 3)  # the first frame
    for _ in range(sweeps):
        covariances = (mean.T @ products).reshape(3, -1, 3).swapaxes(0, 1)
        updated = np.swapaxes(aligning_rotations(covariances), 1, 2).reshape(-1, 3) / len(points)
        change = size(updated - mean)
        mean = updated
        if change <= tolerance * size(mean):
            break
    mean = mean @ aligning_rotations(products[:3] @ mean).T
    shape = np.empty((count, 3))
    for some, block in centred():
        shape[some] = block.T @ mean
    return shape


def bend(first: FloatArray, second: FloatArray) -> float:
    """Return the largest relative rotation of two moving bodies ``(T, 3, 3)`` between two frames, in degrees."""
    relative = np.ascontiguousarray(np.swapaxes(first, 1, 2) @ second)
    flat = relative.reshape(-1, 9)
    # Traces of all pairs of frames, some frames at a time: there may be many.
    lowest = min((flat[start : start + _FRAMES] @ flat.T).min() for start in range(0, len(flat), _FRAMES))
    return float(np.degrees(np.arccos(np.clip((lowest - 1.0) / 2.0, -1.0, 1.0))))
