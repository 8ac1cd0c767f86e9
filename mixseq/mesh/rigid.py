"""Rigid motions: nearest rotations, best motions between point sets, and mean shapes.

Only two singular triplets are needed. With the singular vectors u_1, u_2 and v_1, v_2 of the two largest singular
values, the nearest rotation is ``u_1 v_1^T + u_2 v_2^T + (u_1 x u_2) (v_1 x v_2)^T``, for any third
singular value. One-sided Jacobi rotations compute the vectors, accurately even for small singular values.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mixseq.runtime.jit import compiled
from mixseq.types import Float, FloatArray

MAX_JACOBI_SWEEPS = 30
ORTHOGONALITY_TOLERANCE = 1e-15
ROW_PAIRS = ((0, 1), (0, 2), (1, 2))


@compiled
def _orthogonalise(a: Float, v: Float) -> None:
    """Apply Jacobi rotations to the rows of both a and v until the rows of a are orthogonal."""
    for _ in range(MAX_JACOBI_SWEEPS):
        changed = False
        for pair in range(3):
            p, q = ROW_PAIRS[pair]
            pp = a[p, 0] * a[p, 0] + a[p, 1] * a[p, 1] + a[p, 2] * a[p, 2]
            qq = a[q, 0] * a[q, 0] + a[q, 1] * a[q, 1] + a[q, 2] * a[q, 2]
            pq = a[p, 0] * a[q, 0] + a[p, 1] * a[q, 1] + a[p, 2] * a[q, 2]
            if pq == 0.0 or abs(pq) <= ORTHOGONALITY_TOLERANCE * math.sqrt(pp * qq):
                continue
            changed = True
            zeta = (qq - pp) / (2.0 * pq)
            t = math.copysign(1.0 / (abs(zeta) + math.sqrt(1.0 + zeta * zeta)), zeta)
            c = 1.0 / math.sqrt(1.0 + t * t)
            s = c * t
            for i in range(3):
                x, y = a[p, i], a[q, i]
                a[p, i], a[q, i] = c * x - s * y, s * x + c * y
                x, y = v[p, i], v[q, i]
                v[p, i], v[q, i] = c * x - s * y, s * x + c * y
        if not changed:
            return


@compiled
def nearest_rotation_kernel(matrices: Float, min_ratio: float) -> Float:
    """Return nearest rotations ``(N, 3, 3)``; matrices of nearly rank 1 or 0 are first shifted towards the identity."""
    result = np.empty_like(matrices)
    a, v = np.empty((3, 3)), np.empty((3, 3))
    sizes, u, w = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(matrices)):
        scale = 0.0
        for i in range(3):
            for j in range(3):
                scale += abs(matrices[n, i, j])
        bias = 0.0
        for _ in range(2):
            for i in range(3):  # a and v store matrix columns as rows
                for j in range(3):
                    a[j, i] = matrices[n, i, j] / scale if scale > 0.0 else 0.0
                    v[j, i] = 1.0 if i == j else 0.0
            for i in range(3):
                a[i, i] += bias
            _orthogonalise(a, v)
            for p in range(3):
                sizes[p] = math.sqrt(a[p, 0] * a[p, 0] + a[p, 1] * a[p, 1] + a[p, 2] * a[p, 2])
            first = 0
            for p in range(1, 3):
                if sizes[p] > sizes[first]:
                    first = p
            second = (first + 1) % 3
            if sizes[(first + 2) % 3] > sizes[second]:
                second = (first + 2) % 3
            if bias > 0.0 or sizes[second] > min_ratio * sizes[first]:
                break
            bias = 1e-6 * sizes[first] if sizes[first] > 0.0 else 1.0
        for i in range(3):
            u[i] = a[first, i] / sizes[first] if sizes[first] > 0.0 else v[first, i]
            w[i] = a[second, i] / sizes[second] if sizes[second] > 0.0 else v[second, i]
        size = 0.0
        for _ in range(2):
            dot = w[0] * u[0] + w[1] * u[1] + w[2] * u[2]
            for i in range(3):
                w[i] -= dot * u[i]
            size = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            if size > 0.5:
                break
            for i in range(3):  # if the second singular value is zero, use any direction perpendicular to the first
                w[i] = 0.0
            w[0 if abs(u[0]) < 0.6 else 1] = 1.0
        for i in range(3):
            w[i] /= size
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            u_cross_w = u[j] * w[k] - u[k] * w[j]
            for m in range(3):
                l, o = (m + 1) % 3, (m + 2) % 3  # noqa: E741
                v_cross = v[first, l] * v[second, o] - v[first, o] * v[second, l]
                result[n, i, m] = u[i] * v[first, m] + w[i] * v[second, m] + u_cross_w * v_cross
    return result


POINTS_PER_BLOCK = 1 << 12  # points per block of `mean_shape`, in all frames
MEAN_SHAPE_TOLERANCE = 1e-10  # relative change of a mean shape at which its iteration stops
MIN_COVARIANCE_RATIO = 1e-10  # smallest ratio of singular values of covariances that are not of points on a line
FRAMES_PER_BLOCK = 256  # frames per block of `largest_rotation`, each compared with all frames


def nearest_rotations(matrices: FloatArray) -> Float:
    """Return the rotations ``(..., 3, 3)`` nearest to the given matrices in the Frobenius norm."""
    return _nearest(matrices, min_ratio=-1.0)


def aligning_rotations(covariances: FloatArray) -> Float:
    """Return the rotations ``(..., 3, 3)`` of the best rigid motions, given covariances ``sum w t s^T`` of point sets.

    Each is the rotation nearest to its covariance. For points on a line, where the angle about the line is
    undetermined, return the rotation closest to the identity.
    """
    return _nearest(covariances, MIN_COVARIANCE_RATIO)


def _nearest(matrices: FloatArray, min_ratio: float) -> Float:
    if not np.isfinite(matrices).all():
        raise np.linalg.LinAlgError("a matrix with an entry that is not finite has no nearest rotation")
    flat = np.ascontiguousarray(matrices, dtype=np.float64).reshape(-1, 3, 3)
    return np.asarray(nearest_rotation_kernel(flat, min_ratio)).reshape(matrices.shape)


def kabsch(source: FloatArray, target: FloatArray, weights: FloatArray | None = None) -> tuple[Float, Float]:
    """Fit rigid motions ``x -> R x + t`` of source to target points ``(..., N, 3)``, weights ``(N,)`` (Kabsch 1976)."""
    count = source.shape[-2]
    w = np.full(count, 1.0 / max(count, 1)) if weights is None else weights / weights.sum()
    source_centre = np.einsum("n,...ni->...i", w, source)
    target_centre = np.einsum("n,...ni->...i", w, target)
    s = (source - source_centre[..., None, :]) * w[:, None]
    t = target - target_centre[..., None, :]
    rotation = aligning_rotations(np.swapaxes(t, -1, -2) @ s)
    translation = target_centre - np.einsum("...ij,...j->...i", rotation, source_centre)
    return rotation, translation


def transform_points(points: FloatArray, rotation: FloatArray, translation: FloatArray) -> Float:
    """Apply ``x -> R x + t`` to points ``(..., N, 3)``."""
    return np.asarray(points @ np.swapaxes(rotation, -1, -2) + translation[..., None, :], dtype=np.float64)


def mean_shape(points: FloatArray, sweeps: int = 50) -> Float:
    """Return the mean shape ``(N, 3)`` of points ``(T, N, 3)`` by generalised Procrustes analysis without scale."""
    count = points.shape[1]
    centres = points.mean(axis=1, dtype=np.float64)

    def centred_blocks() -> Iterator[tuple[slice, Float]]:
        for start in range(0, count, POINTS_PER_BLOCK):
            block = slice(start, start + POINTS_PER_BLOCK)
            yield block, (points[:, block] - centres[:, None]).swapaxes(1, 2).reshape(3 * len(points), -1)

    products = np.zeros((3 * len(points), 3 * len(points)))
    for _, block in centred_blocks():
        products += block @ block.T

    def norm(coefficients: Float) -> float:  # norm of a linear combination of the frames
        return float(np.sqrt(max(np.sum(coefficients * (products @ coefficients)), 0.0)))

    mean = np.eye(3 * len(points), 3)  # start from the first frame
    for _ in range(sweeps):
        covariances = (mean.T @ products).reshape(3, -1, 3).swapaxes(0, 1)
        updated = np.swapaxes(aligning_rotations(covariances), 1, 2).reshape(-1, 3) / len(points)
        change = norm(updated - mean)
        mean = updated
        if change <= MEAN_SHAPE_TOLERANCE * norm(mean):
            break
    mean = mean @ aligning_rotations(products[:3] @ mean).T
    shape = np.empty((count, 3))
    for point_ids, block in centred_blocks():
        shape[point_ids] = block.T @ mean
    return shape


def largest_rotation(first: FloatArray, second: FloatArray) -> float:
    """Return the largest relative rotation of two bodies ``(T, 3, 3)`` between any two frames, in degrees."""
    relative = np.ascontiguousarray(np.swapaxes(first, 1, 2) @ second)
    flat = relative.reshape(-1, 9)
    # Traces are computed for all pairs of frames, in blocks to bound memory.
    blocks = np.split(flat, range(FRAMES_PER_BLOCK, len(flat), FRAMES_PER_BLOCK))
    least_trace = min((block @ flat.T).min() for block in blocks)
    return float(np.degrees(np.arccos(np.clip((least_trace - 1.0) / 2.0, -1.0, 1.0))))
