"""Compiled inner loops of `mixseq.shells.fitting`: residuals, normal equations, conjugate gradients.

They release the interpreter's lock and add in a fixed order: results are the same bits on any number of threads.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined
from mixseq.shells.shell_kernels import angle, angle_gradient, length, length_gradient, wrapped


@compiled
def shell_residuals(
    x: Float,
    edges: Index,
    hinges: Index,
    lengths: Float,
    angles: Float,
    weights: Float,
    bending: float,
    free: Index,
    positions: Float,
    soft_weights: Float,
    residuals: Float,
) -> float:
    """Write the residuals ``(e' + h' + 3f,)`` of lengths, angles, soft constraints; return the sum of their squares.

    Vertices ``(n, 3)`` and lengths ``(e',)`` are in diagonals, angles ``(h',)`` in radians, weights ``(e',)`` per
    diagonal, `bending` per radian. Soft weights ``(f,)`` are empty without constraints.
    """
    energy = 0.0
    for k in range(len(edges)):
        r = weights[k] * (length(x, edges[k, 0], edges[k, 1]) - lengths[k])
        residuals[k] = r
        energy += r * r
    first = len(edges)
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        r = bending * wrapped(angle(x, a, b, c, d) - angles[k])
        residuals[first + k] = r
        energy += r * r
    first += len(hinges)
    for k in range(len(soft_weights)):
        for i in range(3):
            r = soft_weights[k] * (x[free[k], i] - positions[k, i])
            residuals[first + 3 * k + i] = r
            energy += r * r
    return energy


@inlined
def _couple(values: Float, places: Index, block: int, g: Float, p: int, o: int) -> None:
    """Add the product of gradient p (rows) and gradient o (columns) to a block below the diagonal."""
    for j in range(3):
        at, factor = places[block, j], g[o, j]
        values[at] += g[p, 0] * factor
        values[at + 1] += g[p, 1] * factor
        values[at + 2] += g[p, 2] * factor


@inlined
def _fold(values: Float, places: Index, block: int, g: Float, p: int, o: int) -> None:
    """Add the products of two gradients of one vertex, as of a hinge whose faces have the same vertices."""
    for j in range(3):
        for i in range(j, 3):
            values[places[block, j] + i] += g[p, i] * g[o, j] + g[o, i] * g[p, j]


@inlined
def _square(values: Float, places: Index, block: int, g: Float, p: int) -> None:
    """Add the product of gradient p with itself to a diagonal block."""
    for j in range(3):
        for i in range(j, 3):
            values[places[block, j] + i] += g[p, i] * g[p, j]


@compiled
def shell_equations(
    x: Float,
    edges: Index,
    hinges: Index,
    weights: Float,
    bending: float,
    soft_weights: Float,
    residuals: Float,
    number: Index,
    edge_blocks: Index,
    hinge_blocks: Index,
    places: Index,
    values: Float,
    gradient: Float,
) -> None:
    """Write the lower triangle ``(N,)`` of ``J^T J`` and the gradient ``J^T r`` ``(3f,)`` of half the energy.

    `number` ``(n,)`` is the place of every vertex among the free ones, -1 if fixed; blocks ``(e',), (h', 6)`` are as in
    `NormalEquations`, places ``(f + m, 3)`` as in `BlockSparsePattern`.
    """
    values[:] = 0.0
    gradient[:] = 0.0
    g = np.empty((4, 3))
    for k in range(len(edges)):
        length_gradient(x, edges[k, 0], edges[k, 1], weights[k], g)
        for p in range(2):
            v = number[edges[k, p]]
            if v >= 0:
                for i in range(3):
                    gradient[3 * v + i] += residuals[k] * g[p, i]
                _square(values, places, v, g, p)
        if edge_blocks[k] >= 0:  # both gradients are the same but for the sign, whichever is the row
            _couple(values, places, edge_blocks[k], g, 1, 0)
    first = len(edges)
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        angle_gradient(x, a, b, c, d, bending, 0.0, 0.0, g)
        r = residuals[first + k]
        pair = 0
        for p in range(4):
            v = number[hinges[k, p]]
            if v >= 0:
                for i in range(3):
                    gradient[3 * v + i] += r * g[p, i]
                _square(values, places, v, g, p)
            for o in range(p):
                block = hinge_blocks[k, pair]
                pair += 1
                if block >= 0:
                    other = number[hinges[k, o]]
                    if v > other:
                        _couple(values, places, block, g, p, o)
                    elif v < other:
                        _couple(values, places, block, g, o, p)
                    else:
                        _fold(values, places, block, g, p, o)
    first += len(hinges)
    for k in range(len(soft_weights)):
        for i in range(3):
            gradient[3 * k + i] += soft_weights[k] * residuals[first + 3 * k + i]
            values[places[k, i] + i] += soft_weights[k] * soft_weights[k]


@compiled
def conjugate_gradients(
    starts: Index,
    rows: Index,
    places: Index,
    values: Float,
    right: Float,
    tolerance: float,
    most: int,
    solution: Float,
) -> int:
    """Solve with the inverse diagonal blocks as preconditioner, into `solution` ``(n,)``; return the number of steps.

    Returns -1 after `most` steps, or where rounding makes the matrix or the preconditioner indefinite. The tolerance is
    relative to the residual of zero, in the norm of the preconditioner.
    """
    size = len(right)
    inverse = np.empty((size // 3, 6))
    if not _invert_blocks(places, values, inverse):
        return -1
    r, z, q, p = right.copy(), np.empty(size), np.empty(size), np.zeros(size)
    solution[:] = 0.0
    before = first = 0.0
    for step in range(most + 1):
        for v in range(0, size, 3):
            block = inverse[v // 3]
            z[v] = block[0] * r[v] + block[1] * r[v + 1] + block[2] * r[v + 2]
            z[v + 1] = block[1] * r[v] + block[3] * r[v + 1] + block[4] * r[v + 2]
            z[v + 2] = block[2] * r[v] + block[4] * r[v + 1] + block[5] * r[v + 2]
        now = 0.0
        for i in range(size):
            now += r[i] * z[i]
        if step == 0:
            first = now
        if now < 0.0:
            return -1
        if now <= tolerance * tolerance * first:
            return step
        ratio = now / before if step > 0 else 0.0
        before = now
        for i in range(size):
            p[i] = z[i] + ratio * p[i]
        _multiply(starts, rows, values, p, q)
        curvature = 0.0
        for i in range(size):
            curvature += p[i] * q[i]
        if not curvature > 0.0:
            return -1
        length = now / curvature
        for i in range(size):
            solution[i] += length * p[i]
            r[i] -= length * q[i]
    return -1


@inlined
def _multiply(starts: Index, rows: Index, values: Float, p: Float, q: Float) -> None:
    """Write the matrix times p to q, three columns and all their blocks at a time."""
    q[:] = 0.0
    for v in range(0, len(p), 3):
        a, b, c, end = starts[v], starts[v + 1], starts[v + 2], starts[v + 1]
        p0, p1, p2 = p[v], p[v + 1], p[v + 2]
        q0 = values[a] * p0 + values[a + 1] * p1 + values[a + 2] * p2
        q1 = values[a + 1] * p0 + values[b] * p1 + values[b + 1] * p2
        q2 = values[a + 2] * p0 + values[b + 1] * p1 + values[c] * p2
        a, b, c = a + 3, b + 2, c + 1
        while a < end:
            i = rows[a]
            x0, x1, x2 = p[i], p[i + 1], p[i + 2]
            a0, a1, a2 = values[a], values[a + 1], values[a + 2]
            b0, b1, b2 = values[b], values[b + 1], values[b + 2]
            c0, c1, c2 = values[c], values[c + 1], values[c + 2]
            q[i] += a0 * p0 + b0 * p1 + c0 * p2
            q[i + 1] += a1 * p0 + b1 * p1 + c1 * p2
            q[i + 2] += a2 * p0 + b2 * p1 + c2 * p2
            q0 += a0 * x0 + a1 * x1 + a2 * x2
            q1 += b0 * x0 + b1 * x1 + b2 * x2
            q2 += c0 * x0 + c1 * x1 + c2 * x2
            a, b, c = a + 3, b + 3, c + 3
        q[v] += q0
        q[v + 1] += q1
        q[v + 2] += q2


@inlined
def _invert_blocks(places: Index, values: Float, inverse: Float) -> bool:
    """Write upper triangles ``(n, 6)``, by rows, of inverse diagonal blocks; return whether all are definite."""
    for v in range(len(inverse)):
        a, b, c = values[places[v, 0]], values[places[v, 0] + 1], values[places[v, 0] + 2]
        d, e, f = values[places[v, 1] + 1], values[places[v, 1] + 2], values[places[v, 2] + 2]
        first, second, third = d * f - e * e, c * e - b * f, b * e - d * c
        determinant = a * first + b * second + c * third
        if not (a > 0.0 and a * d > b * b and determinant > 0.0):
            return False
        scale = 1.0 / determinant
        inverse[v, 0], inverse[v, 1], inverse[v, 2] = scale * first, scale * second, scale * third
        inverse[v, 3], inverse[v, 4] = scale * (a * f - c * c), scale * (b * c - a * e)
        inverse[v, 5] = scale * (a * d - b * b)
    return True
