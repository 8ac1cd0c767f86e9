"""The energy of lengths and angles with its gradient, compiled; formulas as in `mixseq.geometry.lengths_angles`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixseq.compiled import compiled

Float = NDArray[np.float64]
Index = NDArray[np.int64]

TINY = 2.2250738585072014e-308
TURN = 2.0 * math.pi


@compiled
def energy(
    x: Float,
    edges: Index,
    hinges: Index,
    lengths: Float,
    angles: Float,
    stretch: Float,
    bend: Float,
    smallest: Float,
    gradient: Float,
) -> float:
    """Return half the sum of squared residuals ``stretch (l - l*)`` and ``bend wrap(theta - theta*)``.

    Its gradient is written to ``gradient (V, 3)``; where the square of a normal is less than ``smallest (H, 2)`` it is
    taken to be that.
    """
    total = 0.0
    gradient[:] = 0.0
    for k in range(len(edges)):
        w = stretch[k]
        if w == 0.0:
            continue
        a, b = edges[k, 0], edges[k, 1]
        e0, e1, e2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        length = math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        r = w * (length - lengths[k])
        total += r * r
        s = w * r / max(length, TINY)
        gradient[b, 0] += s * e0
        gradient[b, 1] += s * e1
        gradient[b, 2] += s * e2
        gradient[a, 0] -= s * e0
        gradient[a, 1] -= s * e1
        gradient[a, 2] -= s * e2
    for k in range(len(hinges)):
        w = bend[k]
        if w == 0.0:
            continue
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        e0, e1, e2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        c0, c1, c2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        d0, d1, d2 = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
        n0, n1, n2 = e1 * c2 - e2 * c1, e2 * c0 - e0 * c2, e0 * c1 - e1 * c0
        m0, m1, m2 = d1 * e2 - d2 * e1, d2 * e0 - d0 * e2, d0 * e1 - d1 * e0
        square = max(e0 * e0 + e1 * e1 + e2 * e2, TINY)
        length = math.sqrt(square)
        sine = (n1 * m2 - n2 * m1) * e0 + (n2 * m0 - n0 * m2) * e1 + (n0 * m1 - n1 * m0) * e2
        cosine = (n0 * m0 + n1 * m1 + n2 * m2) * length
        off = math.atan2(sine, cosine) - angles[k]
        off -= TURN * math.ceil((off - math.pi) / TURN)  # wrapped to (-pi, pi]
        total += (w * off) ** 2
        s = w * w * off * length
        near = -s / max(n0 * n0 + n1 * n1 + n2 * n2, smallest[k, 0], TINY)
        far = -s / max(m0 * m0 + m1 * m1 + m2 * m2, smallest[k, 1], TINY)
        tc = (c0 * e0 + c1 * e1 + c2 * e2) / square
        td = (d0 * e0 + d1 * e1 + d2 * e2) / square
        p0, p1, p2 = near * n0, near * n1, near * n2
        q0, q1, q2 = far * m0, far * m1, far * m2
        gradient[c, 0] += p0
        gradient[c, 1] += p1
        gradient[c, 2] += p2
        gradient[d, 0] += q0
        gradient[d, 1] += q1
        gradient[d, 2] += q2
        gradient[a, 0] -= (1.0 - tc) * p0 + (1.0 - td) * q0
        gradient[a, 1] -= (1.0 - tc) * p1 + (1.0 - td) * q1
        gradient[a, 2] -= (1.0 - tc) * p2 + (1.0 - td) * q2
        gradient[b, 0] -= tc * p0 + td * q0
        gradient[b, 1] -= tc * p1 + td * q1
        gradient[b, 2] -= tc * p2 + td * q2
    return 0.5 * total


@compiled
def measured(x: Float, edges: Index, hinges: Index) -> tuple[Float, Float]:
    """Return lengths ``(e,)`` and angles ``(h,)`` of edges ``(e, 2)`` and hinges ``(h, 4)``."""
    lengths, angles = np.empty(len(edges)), np.empty(len(hinges))
    for k in range(len(edges)):
        a, b = edges[k, 0], edges[k, 1]
        lengths[k] = math.sqrt((x[b, 0] - x[a, 0]) ** 2 + (x[b, 1] - x[a, 1]) ** 2 + (x[b, 2] - x[a, 2]) ** 2)
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        e0, e1, e2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
        c0, c1, c2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
        d0, d1, d2 = x[d, 0] - x[a, 0], x[d, 1] - x[a, 1], x[d, 2] - x[a, 2]
        n0, n1, n2 = e1 * c2 - e2 * c1, e2 * c0 - e0 * c2, e0 * c1 - e1 * c0
        m0, m1, m2 = d1 * e2 - d2 * e1, d2 * e0 - d0 * e2, d0 * e1 - d1 * e0
        sine = (n1 * m2 - n2 * m1) * e0 + (n2 * m0 - n0 * m2) * e1 + (n0 * m1 - n1 * m0) * e2
        cosine = (n0 * m0 + n1 * m1 + n2 * m2) * math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
        angles[k] = math.atan2(sine, cosine)
    return lengths, angles


@compiled
def gathered(faces: Index, weights: Float, sides: Float, right: Float) -> None:
    """Add the weighted ``(F, 3)`` sides 01, 12, 20 ``(F, 3, 3)`` of faces to the right-hand side ``(V, 3)``."""
    for f in range(len(faces)):
        for k in range(3):
            a, b, w = faces[f, k], faces[f, (k + 1) % 3], weights[f, k]
            for i in range(3):
                step = w * sides[f, k, i]
                right[b, i] += step
                right[a, i] -= step


@compiled
def turned_sides(frames: Float, flat: Float) -> Float:
    """Return the sides ``(F, 3, 3)`` of flat triangles ``(F, 3, 2)`` with frames ``(F, 4)``."""
    sides = np.empty((len(flat), 3, 3))
    for f in range(len(flat)):
        w, x, y, z = frames[f]
        a0, a1, a2 = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)
        b0, b1, b2 = 2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)
        for k in range(3):
            n = (k + 1) % 3
            u, v = flat[f, n, 0] - flat[f, k, 0], flat[f, n, 1] - flat[f, k, 1]
            sides[f, k, 0] = a0 * u + b0 * v
            sides[f, k, 1] = a1 * u + b1 * v
            sides[f, k, 2] = a2 * u + b2 * v
    return sides
