"""Lengths of edges and angles of hinges with their gradients, for compiled loops: the one place where they are.

Formulas are those of `mixseq.geometry.lengths_angles`, which the tests hold them against.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixseq.compiled import compiled, inlined

Float = NDArray[np.float64]
Index = NDArray[np.int64]

TINY = 2.2250738585072014e-308
TURN = 2.0 * math.pi


@inlined
def side(x: Float, a: int, b: int) -> tuple[float, float, float]:
    """Return the vector from vertex a to vertex b."""
    return x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]


@inlined
def length(x: Float, a: int, b: int) -> float:
    """Return the length of the edge ab."""
    e0, e1, e2 = side(x, a, b)
    return math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)


@inlined
def length_gradient(x: Float, a: int, b: int, scale: float, g: Float) -> None:
    """Write the gradient of the length of the edge ab by its two vertices, times a number, to ``g[:2]``."""
    e0, e1, e2 = side(x, a, b)
    w = scale / max(math.sqrt(e0 * e0 + e1 * e1 + e2 * e2), TINY)
    g[1, 0], g[1, 1], g[1, 2] = w * e0, w * e1, w * e2
    g[0, 0], g[0, 1], g[0, 2] = -g[1, 0], -g[1, 1], -g[1, 2]


@inlined
def _normal(p0: float, p1: float, p2: float, q0: float, q1: float, q2: float) -> tuple[float, float, float]:
    """Return the cross product of p and q."""
    return p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0


@inlined
def angle(x: Float, a: int, b: int, c: int, d: int) -> float:
    """Return the dihedral angle of the hinge abcd."""
    e0, e1, e2 = side(x, a, b)
    c0, c1, c2 = side(x, a, c)
    d0, d1, d2 = side(x, a, d)
    n0, n1, n2 = _normal(e0, e1, e2, c0, c1, c2)
    m0, m1, m2 = _normal(d0, d1, d2, e0, e1, e2)
    sine = (n1 * m2 - n2 * m1) * e0 + (n2 * m0 - n0 * m2) * e1 + (n0 * m1 - n1 * m0) * e2
    cosine = (n0 * m0 + n1 * m1 + n2 * m2) * math.sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    return math.atan2(sine, cosine)


@inlined
def wrapped(off: float) -> float:
    """Return an angle wrapped to (-pi, pi]."""
    return off - TURN * math.ceil((off - math.pi) / TURN)


@inlined
def _balance(g: Float, tc: float, td: float) -> None:
    """Write the gradient by a and b, given that by c and d, whose feet on the edge ab are at the shares tc and td."""
    for i in range(3):
        g[0, i] = -(1.0 - tc) * g[2, i] - (1.0 - td) * g[3, i]
        g[1, i] = -tc * g[2, i] - td * g[3, i]


@inlined
def angle_gradient(
    x: Float, a: int, b: int, c: int, d: int, scale: float, near: float, far: float, g: Float
) -> None:
    """Write the gradient of the angle of the hinge abcd by its vertices, times a number, to g ``(4, 3)``.

    Squares of its two normals are taken to be `near` and `far`, at least.
    """
    e0, e1, e2 = side(x, a, b)
    c0, c1, c2 = side(x, a, c)
    d0, d1, d2 = side(x, a, d)
    n0, n1, n2 = _normal(e0, e1, e2, c0, c1, c2)
    m0, m1, m2 = _normal(d0, d1, d2, e0, e1, e2)
    square = max(e0 * e0 + e1 * e1 + e2 * e2, TINY)
    size = scale * math.sqrt(square)
    first = -size / max(n0 * n0 + n1 * n1 + n2 * n2, near, TINY)
    second = -size / max(m0 * m0 + m1 * m1 + m2 * m2, far, TINY)
    g[2, 0], g[2, 1], g[2, 2] = first * n0, first * n1, first * n2
    g[3, 0], g[3, 1], g[3, 2] = second * m0, second * m1, second * m2
    _balance(g, (c0 * e0 + c1 * e1 + c2 * e2) / square, (d0 * e0 + d1 * e1 + d2 * e2) / square)


@inlined
def misfit(
    x: Float,
    a: int,
    b: int,
    c: int,
    d: int,
    cosine: float,
    sine: float,
    scale: float,
    near: float,
    far: float,
    g: Float,
) -> float:
    """Return one less the cosine of how far the angle of the hinge abcd is off; its gradient is written to g.

    What it should be is told by its cosine and sine. The gradient is as in `angle_gradient`, without an angle.
    """
    e0, e1, e2 = side(x, a, b)
    c0, c1, c2 = side(x, a, c)
    d0, d1, d2 = side(x, a, d)
    n0, n1, n2 = _normal(e0, e1, e2, c0, c1, c2)
    m0, m1, m2 = _normal(d0, d1, d2, e0, e1, e2)
    square = max(e0 * e0 + e1 * e1 + e2 * e2, TINY)
    length = math.sqrt(square)
    across = ((n1 * m2 - n2 * m1) * e0 + (n2 * m0 - n0 * m2) * e1 + (n0 * m1 - n1 * m0) * e2) / length
    along = n0 * m0 + n1 * m1 + n2 * m2
    both = max(math.sqrt(across * across + along * along), TINY)
    off = (across * cosine - along * sine) / both
    even = (along * cosine + across * sine) / both
    size = scale * off * length
    first = -size / max(n0 * n0 + n1 * n1 + n2 * n2, near, TINY)
    second = -size / max(m0 * m0 + m1 * m1 + m2 * m2, far, TINY)
    g[2, 0], g[2, 1], g[2, 2] = first * n0, first * n1, first * n2
    g[3, 0], g[3, 1], g[3, 2] = second * m0, second * m1, second * m2
    _balance(g, (c0 * e0 + c1 * e1 + c2 * e2) / square, (d0 * e0 + d1 * e1 + d2 * e2) / square)
    return off * off / (1.0 + even) if even > 0.0 else 1.0 - even


@compiled
def measured(x: Float, edges: Index, hinges: Index) -> tuple[Float, Float]:
    """Return lengths ``(e,)`` and angles ``(h,)`` of edges ``(e, 2)`` and hinges ``(h, 4)``."""
    lengths, angles = np.empty(len(edges)), np.empty(len(hinges))
    for k in range(len(edges)):
        lengths[k] = length(x, edges[k, 0], edges[k, 1])
    for k in range(len(hinges)):
        angles[k] = angle(x, hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3])
    return lengths, angles
