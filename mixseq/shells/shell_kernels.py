"""Compiled inner loops of `mixseq.shells.shell`: lengths, angles, their energy, and gradients.

Formulas are those of `mixseq.geometry.lengths_angles`; tests compare both.
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined

Vector = tuple[float, float, float]

TINY = 2.2250738585072014e-308
TURN = 2.0 * math.pi


@inlined
def side(x: Float, a: int, b: int) -> Vector:
    """Return the vector from vertex a to vertex b."""
    return x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]


@inlined
def _cross(p: Vector, q: Vector) -> Vector:
    """Return the cross product of p and q."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@inlined
def _dot(p: Vector, q: Vector) -> float:
    """Return the scalar product of p and q."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@inlined
def length(x: Float, a: int, b: int) -> float:
    """Return the length of the edge ab."""
    e = side(x, a, b)
    return math.sqrt(_dot(e, e))


@inlined
def length_gradient(x: Float, a: int, b: int, scale: float, g: Float) -> None:
    """Write the gradient of the length of the edge ab by its two vertices, times `scale`, to ``g[:2]``."""
    e = side(x, a, b)
    w = scale / max(math.sqrt(_dot(e, e)), TINY)
    g[1, 0], g[1, 1], g[1, 2] = w * e[0], w * e[1], w * e[2]
    g[0, 0], g[0, 1], g[0, 2] = -g[1, 0], -g[1, 1], -g[1, 2]


@inlined
def _sides_and_normals(
    x: Float, a: int, b: int, c: int, d: int
) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Return the sides ab, ac and ad of the hinge abcd, and the normals of its faces."""
    e, p, q = side(x, a, b), side(x, a, c), side(x, a, d)
    return e, p, q, _cross(e, p), _cross(q, e)


@inlined
def _opening(e: Vector, n: Vector, m: Vector) -> tuple[float, float]:
    """Return cosine and sine of the angle between the normals n and m about e, times the lengths of all three."""
    return _dot(n, m) * math.sqrt(_dot(e, e)), _dot(_cross(n, m), e)


@inlined
def angle(x: Float, a: int, b: int, c: int, d: int) -> float:
    """Return the dihedral angle of the hinge abcd."""
    e, _, _, n, m = _sides_and_normals(x, a, b, c, d)
    cosine, sine = _opening(e, n, m)
    return math.atan2(sine, cosine)


@inlined
def wrapped(off: float) -> float:
    """Return an angle wrapped to (-pi, pi]."""
    return off - TURN * math.ceil((off - math.pi) / TURN)


@inlined
def _write_gradient(
    e: Vector, p: Vector, q: Vector, n: Vector, m: Vector, scale: float, near: float, far: float, g: Float
) -> None:
    """Write the gradient of an angle, times `scale`, as `angle_gradient` does."""
    square = max(_dot(e, e), TINY)
    size = scale * math.sqrt(square)
    first, second = -size / max(_dot(n, n), near, TINY), -size / max(_dot(m, m), far, TINY)
    g[2, 0], g[2, 1], g[2, 2] = first * n[0], first * n[1], first * n[2]
    g[3, 0], g[3, 1], g[3, 2] = second * m[0], second * m[1], second * m[2]
    tc, td = _dot(p, e) / square, _dot(q, e) / square  # where c and d stand along the edge
    for i in range(3):
        g[0, i] = -(1.0 - tc) * g[2, i] - (1.0 - td) * g[3, i]
        g[1, i] = -tc * g[2, i] - td * g[3, i]


@inlined
def angle_gradient(
    x: Float, a: int, b: int, c: int, d: int, scale: float, near: float, far: float, g: Float
) -> None:
    """Write the gradient ``(4, 3)`` of the angle of the hinge abcd by its vertices, times `scale`, in radians per unit.

    `near` and `far` are least squares of its two normals, in the fourth power of the unit of points.
    """
    e, p, q, n, m = _sides_and_normals(x, a, b, c, d)
    _write_gradient(e, p, q, n, m, scale, near, far, g)


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
    """Return 1 - cos of the error of the angle of the hinge abcd, and write its gradient as `angle_gradient` does.

    `cosine` and `sine` are of the target angle. Hinges of triangles without area have no error.
    """
    e, p, q, n, m = _sides_and_normals(x, a, b, c, d)
    along, across = _opening(e, n, m)
    size = max(math.sqrt(across * across + along * along), TINY)
    off, even = (across * cosine - along * sine) / size, (along * cosine + across * sine) / size
    _write_gradient(e, p, q, n, m, scale * off, near, far, g)
    if size == TINY:
        return 0.0
    return off * off / (1.0 + even) if even > 0.0 else 1.0 - even


@compiled
def lengths_and_angles(x: Float, edges: Index, hinges: Index) -> tuple[Float, Float]:
    """Return lengths ``(e,)`` in the unit of points ``(n, 3)``, and angles ``(h,)`` in radians."""
    lengths, angles = np.empty(len(edges)), np.empty(len(hinges))
    for k in range(len(edges)):
        lengths[k] = length(x, edges[k, 0], edges[k, 1])
    for k in range(len(hinges)):
        angles[k] = angle(x, hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3])
    return lengths, angles


@compiled
def energy(
    x: Float,
    edges: Index,
    hinges: Index,
    lengths: Float,
    turns: Float,
    stretch: Float,
    bend: Float,
    smallest: Float,
    gradient: Float,
) -> float:
    """Return half the sum of squared residuals ``stretch (l - l*)`` and ``2 bend sin((theta - theta*) / 2)``.

    Vertices ``(V, 3)`` and lengths ``(E,)`` are in diagonals; turns ``(H, 2)`` are cosines and sines of target angles;
    weights ``(E,), (H,)`` per diagonal and radian; `smallest` ``(H, 2)`` least squares of normals. Writes the gradient.
    """
    total = 0.0
    gradient[:] = 0.0
    g = np.empty((4, 3))
    for k in range(len(edges)):
        w = stretch[k]
        if w == 0.0:
            continue
        r = w * (length(x, edges[k, 0], edges[k, 1]) - lengths[k])
        total += r * r
        length_gradient(x, edges[k, 0], edges[k, 1], w * r, g)
        for p in range(2):
            for i in range(3):
                gradient[edges[k, p], i] += g[p, i]
    for k in range(len(hinges)):
        w = bend[k]
        if w == 0.0:
            continue
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        w *= w
        cosine, sine, near, far = turns[k, 0], turns[k, 1], smallest[k, 0], smallest[k, 1]
        total += 2.0 * w * misfit(x, a, b, c, d, cosine, sine, w, near, far, g)
        for p in range(4):
            for i in range(3):
                gradient[hinges[k, p], i] += g[p, i]
    return 0.5 * total


@compiled
def nearness(x: Float, hinges: Index, turns: Float) -> Float:
    """Return ``cos^2`` of half the error of hinges ``(H,)``: 1 without an error, 0 at half a turn."""
    near, g = np.empty(len(hinges)), np.empty((4, 3))
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        near[k] = 1.0 - 0.5 * misfit(x, a, b, c, d, turns[k, 0], turns[k, 1], 0.0, 1.0, 1.0, g)
    return near


@compiled
def gathered(faces: Index, weights: Float, sides: Float, right: Float) -> None:
    """Add the weighted sides ``(F, 3, 3)`` of faces to the right-hand side ``(V, 3)`` of a Poisson system."""
    for f in range(len(faces)):
        for k in range(3):
            a, b, w = faces[f, k], faces[f, (k + 1) % 3], weights[f, k]
            for i in range(3):
                step = w * sides[f, k, i]
                right[b, i] += step
                right[a, i] -= step
