"""Dual quaternion skinning, compiled: vertices posed by blended dual quaternions, and back.

Arrays are of real or of complex numbers: a complex step gives derivatives (`complex_step`). Positions are in
diagonals.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined


@inlined
def _turn(w: float, p: float, q: float, r: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Turn a vector by a unit quaternion: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    a = 2.0 * (q * z - r * y)
    b = 2.0 * (r * x - p * z)
    c = 2.0 * (p * y - q * x)
    return x + w * a + q * c - r * b, y + w * b + r * a - p * c, z + w * c + p * b - q * a


@inlined
def _blend(starts: Index, parts: Index, weights: Float, duals: Float, v: int, total: Float) -> None:
    """Write the blended motion of a vertex: a unit quaternion and a translation, seven numbers."""
    first, end = starts[v], starts[v + 1]
    if end == first + 1:  # one part's motion is a unit dual quaternion already
        for i in range(8):
            total[i] = duals[parts[first], i]
    else:
        for i in range(8):
            total[i] = 0.0
        for place in range(first, end):
            for i in range(8):
                total[i] += weights[place] * duals[parts[place], i]
        square = total[0] * total[0] + total[1] * total[1] + total[2] * total[2] + total[3] * total[3]
        inverse = 1.0 / np.sqrt(square) if square.real > 0.0 else 0.0 * square  # of nothing, no motion
        for i in range(8):
            total[i] *= inverse
    w, x, y, z = total[0], total[1], total[2], total[3]
    d, a, b, c = total[4], total[5], total[6], total[7]
    # Twice the vector part of dual times conjugate.
    total[4] = 2.0 * (-d * x + a * w - b * z + c * y)
    total[5] = 2.0 * (-d * y + b * w - c * x + a * z)
    total[6] = 2.0 * (-d * z + c * w - a * y + b * x)


@compiled
def pose(starts: Index, parts: Index, weights: Float, duals: Float, unposed: Float) -> Float:
    """Move vertices ``(V, 3)`` by the blended motions of their parts.

    Shapes: starts, parts, weights ``(V + 1,)``; duals ``(p, 8)``.
    """
    x = np.empty_like(unposed)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        a, b, c = _turn(m[0], m[1], m[2], m[3], unposed[v, 0], unposed[v, 1], unposed[v, 2])
        x[v, 0], x[v, 1], x[v, 2] = a + m[4], b + m[5], c + m[6]
    return x


@compiled
def unpose(starts: Index, parts: Index, weights: Float, duals: Float, x: Float) -> Float:
    """Move vertices ``(V, 3)`` back by the blended motions of their parts: the inverse of `pose`."""
    unposed = np.empty_like(x)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        a, b, c = _turn(m[0], -m[1], -m[2], -m[3], x[v, 0] - m[4], x[v, 1] - m[5], x[v, 2] - m[6])
        unposed[v, 0], unposed[v, 1], unposed[v, 2] = a, b, c
    return unposed
