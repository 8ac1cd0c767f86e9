r"""Rotations as unit quaternions, rotation vectors and matrices, continuous along a sequence.

A *quaternion* :math:`q = (w, x, y, z)` with :math:`|q| = 1` is the rotation by the angle :math:`2 \arccos w` about
:math:`(x, y, z)`, and so is :math:`-q`. Along a sequence, the sign closest to the previous frame is chosen. Normalised
sums of such quaternions interpolate any number of rotations, without branches or singularities.

A *rotation vector* :math:`t u` is the rotation by the angle t about the unit axis u. The logarithm has many branches,
:math:`(t + 2 \pi k) u`; along a sequence, the branch closest to the previous frame is chosen. Then a body that rotates
twice has a vector of length :math:`4 \pi`, and vectors can be combined linearly.
"""

from __future__ import annotations

import numpy as np

from mixseq.types import Float, FloatArray


def matrix_to_quat(rotations: FloatArray) -> Float:
    """Return the unit quaternions ``(..., 4)``, w >= 0, of rotation matrices ``(..., 3, 3)``."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)).as_quat()
    signed = np.roll(flat, 1, axis=1) * np.where(flat[:, 3:] < 0, -1.0, 1.0)
    return np.asarray(signed.reshape(*rotations.shape[:-2], 4))


def quat_to_matrix(quaternions: FloatArray) -> Float:
    """Return the rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)`` of any length."""
    w, x, y, z = np.moveaxis(normalise_quat(quaternions), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def normalise_quat(quaternions: FloatArray) -> Float:
    """Normalise quaternions ``(..., 4)`` to unit length; zero stays zero."""
    norms = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    return np.asarray(quaternions / np.where(norms > 0, norms, 1.0), dtype=np.float64)


def quat_multiply(first: FloatArray, second: FloatArray) -> Float:
    """Return the products ``(..., 4)`` of quaternions: rotations by `second`, followed by rotations by `first`."""
    w, x, y, z = np.moveaxis(np.asarray(first, dtype=np.float64), -1, 0)
    a, b, c, d = np.moveaxis(np.asarray(second, dtype=np.float64), -1, 0)
    return np.stack(
        [
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        ],
        axis=-1,
    )


def quat_conjugate(quaternions: FloatArray) -> Float:
    """Return the conjugates of quaternions ``(..., 4)``, the inverse rotations of unit quaternions."""
    return np.asarray(quaternions * np.array([1.0, -1.0, -1.0, -1.0]))


def rotvec_to_quat(vectors: FloatArray) -> Float:
    """Return the quaternions ``(..., 4)`` of rotation vectors ``(..., 3)``; adding 2 pi to the angle flips the sign."""
    half = np.linalg.norm(vectors, axis=-1, keepdims=True) / 2
    return np.concatenate([np.cos(half), np.sinc(half / np.pi) / 2 * vectors], axis=-1)


def align_quat_signs(quaternions: FloatArray, reference: FloatArray | None = None) -> Float:
    """Make the signs of quaternions ``(T, ..., 4)`` continuous in time, starting from a reference ``(..., 4)``."""
    q = np.array(quaternions, dtype=np.float64)
    start = q[:1] if reference is None else np.asarray(reference)[None]
    cosines = np.einsum("t...i,t...i->t...", q, np.concatenate([start, q[:-1]]))
    return q * np.cumprod(np.where(cosines < 0, -1.0, 1.0), axis=0)[..., None]


FULL_TURN = 2.0 * np.pi


def rotvec_to_matrix(vectors: FloatArray) -> Float:
    """Return the rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)`` (exponential map)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_rotvec(np.array(vectors, dtype=np.float64).reshape(-1, 3)).as_matrix()
    return np.asarray(flat.reshape(*vectors.shape[:-1], 3, 3), dtype=np.float64)


def matrix_to_rotvec(rotations: FloatArray) -> Float:
    """Return the shortest rotation vectors ``(..., 3)`` of matrices ``(..., 3, 3)`` (logarithm)."""
    from scipy.spatial.transform import Rotation

    flat = Rotation.from_matrix(np.asarray(rotations, dtype=np.float64).reshape(-1, 3, 3)).as_rotvec()
    return np.asarray(flat.reshape(*rotations.shape[:-2], 3), dtype=np.float64)


def continuous_rotvec(rotations: FloatArray, reference: FloatArray | None = None) -> Float:
    """Return rotation vectors ``(T, ..., 3)`` of matrices, continuous in time from a reference ``(..., 3)``."""
    return unwrap_rotvec(matrix_to_rotvec(rotations), reference)


def unwrap_rotvec(vectors: FloatArray, reference: FloatArray | None = None) -> Float:
    """Make rotation vectors ``(T, ..., 3)`` of any branch continuous in time, from a reference ``(..., 3)``."""
    result = np.array(vectors, dtype=np.float64)
    previous = reference
    for frame in range(len(result)):
        if previous is not None:
            result[frame] = _nearest_branch(result[frame], previous)
        previous = result[frame]
    return result


def _nearest_branch(vector: Float, previous: FloatArray) -> Float:
    """Return the vector ``vector + 2 pi k axis``, with integer k, that is closest to `previous`."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    previous_angle = np.linalg.norm(previous, axis=-1, keepdims=True)
    # The axis of the identity is undetermined: use the axis of the previous frame.
    fallback = np.divide(previous, previous_angle, out=np.zeros_like(vector), where=previous_angle > 0)
    axis = np.where(angle > 1e-12, vector / np.where(angle > 0, angle, 1.0), fallback)
    along = np.sum(previous * axis, axis=-1, keepdims=True)
    return np.asarray(vector + FULL_TURN * np.round((along - angle) / FULL_TURN) * axis, dtype=np.float64)


def rotate_vectors(matrices: FloatArray, vectors: FloatArray) -> Float:
    """Multiply vectors ``(..., 3)`` by matrices ``(..., 3, 3)``; leading dimensions broadcast."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))
