"""Compiled inner loops of `mixseq.shells.shell` and `mixseq.shells.fitting`.

They compute energies, gradients and normal equations, and solve by conjugate gradients. Tests compare
the formulas with `mixseq.mesh.measures`. Loops release the interpreter's lock and sum in a fixed order, so that results
are bit-identical for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.mesh.measure_kernels import Vector, angle, dot, length, opening, side, sides_and_normals
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index, Int32, Mask

ONE, TWO, THREE = np.uint64(1), np.uint64(2), np.uint64(3)
"""Steps of unsigned indices; sums with signed numbers would be floats."""

MIN_DOUBLE = 2.2250738585072014e-308  # least positive double with full precision
FULL_TURN = 2.0 * math.pi  # angle of a full turn in radians


@force_inlined
def length_gradient(x: Float, a: int, b: int, scale: float, g: Float) -> None:
    """Write the gradient of the length of the edge ab by its two vertices, times `scale`, to ``g[:2]``."""
    e = side(x, a, b)
    w = scale / max(math.sqrt(dot(e, e)), MIN_DOUBLE)
    g[1, 0], g[1, 1], g[1, 2] = w * e[0], w * e[1], w * e[2]
    g[0, 0], g[0, 1], g[0, 2] = -g[1, 0], -g[1, 1], -g[1, 2]


@force_inlined
def wrap_angle(angle: float) -> float:
    """Return an angle wrapped to (-pi, pi]."""
    return angle - FULL_TURN * math.ceil((angle - math.pi) / FULL_TURN)


@force_inlined
def _write_gradient(
    e: Vector, p: Vector, q: Vector, n: Vector, m: Vector, scale: float, min_c: float, min_d: float, g: Float
) -> None:
    """Write the gradient of a hinge's angle, times `scale`, in the form of `angle_gradient`."""
    square = max(dot(e, e), MIN_DOUBLE)
    size = scale * math.sqrt(square)
    first = -size / max(dot(n, n), min_c, MIN_DOUBLE)
    second = -size / max(dot(m, m), min_d, MIN_DOUBLE)
    g[2, 0], g[2, 1], g[2, 2] = first * n[0], first * n[1], first * n[2]
    g[3, 0], g[3, 1], g[3, 2] = second * m[0], second * m[1], second * m[2]
    tc, td = dot(p, e) / square, dot(q, e) / square  # positions of c and d along the edge
    for i in range(3):
        g[0, i] = -(1.0 - tc) * g[2, i] - (1.0 - td) * g[3, i]
        g[1, i] = -tc * g[2, i] - td * g[3, i]


@force_inlined
def angle_gradient(
    x: Float, a: int, b: int, c: int, d: int, scale: float, min_c: float, min_d: float, g: Float
) -> None:
    """Write the gradient ``(4, 3)`` of the angle of the hinge abcd by its vertices, times `scale`, in radians per unit.

    `min_c` and `min_d` bound the squares of the normals at c and d from below, in the fourth power of the unit of x.
    """
    e, p, q, n, m = sides_and_normals(x, a, b, c, d)
    _write_gradient(e, p, q, n, m, scale, min_c, min_d, g)


@force_inlined
def angle_misfit(
    x: Float,
    a: int,
    b: int,
    c: int,
    d: int,
    cosine: float,
    sine: float,
    scale: float,
    min_c: float,
    min_d: float,
    g: Float,
) -> float:
    """Return 1 - cos of the error of the angle of the hinge abcd, and write its gradient as `angle_gradient` does.

    The arguments `cosine` and `sine` belong to the target angle. Hinges of triangles without area have no error.
    """
    e, p, q, n, m = sides_and_normals(x, a, b, c, d)
    along, across = opening(e, n, m)
    size = max(math.sqrt(across * across + along * along), MIN_DOUBLE)
    sin_error, cos_error = (across * cosine - along * sine) / size, (along * cosine + across * sine) / size
    _write_gradient(e, p, q, n, m, scale * sin_error, min_c, min_d, g)
    if size == MIN_DOUBLE:
        return 0.0
    return sin_error * sin_error / (1.0 + cos_error) if cos_error > 0.0 else 1.0 - cos_error


@compiled
def shell_energy(
    x: Float,
    edges: Int32,
    hinges: Int32,
    lengths: Float,
    targets: Float,
    length_weights: Float,
    angle_weights: Float,
    min_normals: Float,
    gradient: Float,
) -> float:
    """Return half the sum of squared residuals ``w (l - l*)`` and ``2 w sin((theta - theta*) / 2)``, and its gradient.

    Vertices ``(V, 3)`` and lengths ``(E,)`` are in diagonals, targets ``(H, 2)`` are cosines and sines of target
    angles. Weights ``(E,), (H,)`` are per diagonal and radian. Lower bounds of squared normals are ``(H, 2)``.
    """
    total = 0.0
    gradient[:] = 0.0
    g = np.empty((4, 3))
    for k in range(len(edges)):
        w = length_weights[k]
        if w == 0.0:
            continue
        r = w * (length(x, edges[k, 0], edges[k, 1]) - lengths[k])
        total += r * r
        length_gradient(x, edges[k, 0], edges[k, 1], w * r, g)
        for p in range(2):
            for i in range(3):
                gradient[edges[k, p], i] += g[p, i]
    for k in range(len(hinges)):
        w = angle_weights[k]
        if w == 0.0:
            continue
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        w *= w
        cosine, sine, min_c, min_d = targets[k, 0], targets[k, 1], min_normals[k, 0], min_normals[k, 1]
        total += 2.0 * w * angle_misfit(x, a, b, c, d, cosine, sine, w, min_c, min_d, g)
        for p in range(4):
            for i in range(3):
                gradient[hinges[k, p], i] += g[p, i]
    return 0.5 * total


@force_inlined
def _is_collapsed(p: Vector, q: Vector, normal: Vector, min_height_ratio: float) -> bool:
    """Whether the height of the triangle of sides p and q is at most a ratio of its longest side."""
    opposite = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    longest = max(dot(p, p), dot(q, q), dot(opposite, opposite))
    return math.sqrt(dot(normal, normal)) <= min_height_ratio * longest


@compiled
def hinge_nearness(x: Float, hinges: Int32, targets: Float, min_height_ratio: float) -> tuple[Float, Mask]:
    """Return the squared cosines ``(H,)`` of half the angle errors of hinges: 1 without error, 0 at 180 degrees.

    Also mark the hinges ``(H,)`` of a triangle whose ratio of height to longest side is at most `min_height_ratio`.
    """
    nearness, collapsed, g = np.empty(len(hinges)), np.empty(len(hinges), np.bool_), np.empty((4, 3))
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        nearness[k] = 1.0 - 0.5 * angle_misfit(x, a, b, c, d, targets[k, 0], targets[k, 1], 0.0, 1.0, 1.0, g)
        e, p, q, n, m = sides_and_normals(x, a, b, c, d)
        collapsed[k] = _is_collapsed(e, p, n, min_height_ratio) or _is_collapsed(e, q, m, min_height_ratio)
    return nearness, collapsed


@compiled
def add_weighted_sides(edges: Index, weights: Float, sides: Float, right: Float) -> None:
    """Add weighted sides ``(S, k)`` along edges ``(S, 2)`` to the right-hand side ``(n, k)`` of a Poisson system."""
    for s in range(len(edges)):
        a, b, w = edges[s, 0], edges[s, 1], weights[s]
        for i in range(sides.shape[1]):
            change = w * sides[s, i]
            right[b, i] += change
            right[a, i] -= change


@compiled
def deform_sides(matrices: Float, matrix_ids: Index, maps: Float, sides: Float) -> None:
    """Write the columns of ``matrices[matrix_ids] @ maps`` as sides ``(3F, 3)``: ``(n, 3, 3), (F,), (F, 3, 3)``."""
    for f in range(len(matrix_ids)):
        m = matrix_ids[f]
        for k in range(3):
            x, y, z = maps[f, 0, k], maps[f, 1, k], maps[f, 2, k]
            for i in range(3):
                sides[3 * f + k, i] = matrices[m, i, 0] * x + matrices[m, i, 1] * y + matrices[m, i, 2] * z


@compiled
def shell_residuals(
    x: Float,
    edges: Index,
    hinges: Index,
    lengths: Float,
    angles: Float,
    weights: Float,
    bending: float,
    free_ids: Index,
    positions: Float,
    position_weights: Float,
    residuals: Float,
) -> float:
    """Write the residuals ``(e' + h' + 3f,)`` of lengths, angles and positions; return the sum of their squares.

    Vertices ``(n, 3)`` and lengths ``(e',)`` are in diagonals, angles ``(h',)`` in radians, weights ``(e',)`` per
    diagonal, `bending` per radian. Position weights ``(f,)`` are empty without constraints.
    """
    energy = 0.0
    for k in range(len(edges)):
        r = weights[k] * (length(x, edges[k, 0], edges[k, 1]) - lengths[k])
        residuals[k] = r
        energy += r * r
    first = len(edges)
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        r = bending * wrap_angle(angle(x, a, b, c, d) - angles[k])
        residuals[first + k] = r
        energy += r * r
    first += len(hinges)
    for k in range(len(position_weights)):
        for i in range(3):
            r = position_weights[k] * (x[free_ids[k], i] - positions[k, i])
            residuals[first + 3 * k + i] = r
            energy += r * r
    return energy


@force_inlined
def _add_coupling(values: Float, places: Index, block: int, g: Float, p: int, o: int) -> None:
    """Add the product of gradient p (rows) and gradient o (columns) to a block below the diagonal."""
    for j in range(3):
        at, factor = places[block, j], g[o, j]
        values[at] += g[p, 0] * factor
        values[at + 1] += g[p, 1] * factor
        values[at + 2] += g[p, 2] * factor


@force_inlined
def _add_same_vertex(values: Float, places: Index, block: int, g: Float, p: int, o: int) -> None:
    """Add the products of two gradients of one vertex, at a hinge between faces with the same vertices."""
    for j in range(3):
        for i in range(j, 3):
            values[places[block, j] + i] += g[p, i] * g[o, j] + g[o, i] * g[p, j]


@force_inlined
def _add_square(values: Float, places: Index, block: int, g: Float, p: int) -> None:
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
    position_weights: Float,
    residuals: Float,
    free_index: Index,
    edge_blocks: Index,
    hinge_blocks: Index,
    places: Index,
    values: Float,
    gradient: Float,
) -> None:
    """Write the lower triangle ``(N,)`` of ``J^T J`` and the gradient ``J^T r`` ``(3f,)`` of half the energy.

    `free_index` ``(n,)`` is the index of vertices among the free ones, -1 if fixed; blocks ``(e',), (h', 6)`` are as in
    `NormalEquations`, places ``(f + m, 3)`` as in `BlockPattern`.
    """
    values[:] = 0.0
    gradient[:] = 0.0
    g = np.empty((4, 3))
    for k in range(len(edges)):
        length_gradient(x, edges[k, 0], edges[k, 1], weights[k], g)
        for p in range(2):
            v = free_index[edges[k, p]]
            if v >= 0:
                for i in range(3):
                    gradient[3 * v + i] += residuals[k] * g[p, i]
                _add_square(values, places, v, g, p)
        if edge_blocks[k] >= 0:  # the two gradients are opposite, so that their order is irrelevant
            _add_coupling(values, places, edge_blocks[k], g, 1, 0)
    first = len(edges)
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        angle_gradient(x, a, b, c, d, bending, 0.0, 0.0, g)
        r = residuals[first + k]
        pair = 0
        for p in range(4):
            v = free_index[hinges[k, p]]
            if v >= 0:
                for i in range(3):
                    gradient[3 * v + i] += r * g[p, i]
                _add_square(values, places, v, g, p)
            for o in range(p):
                block = hinge_blocks[k, pair]
                pair += 1
                if block >= 0:
                    other = free_index[hinges[k, o]]
                    if v > other:
                        _add_coupling(values, places, block, g, p, o)
                    elif v < other:
                        _add_coupling(values, places, block, g, o, p)
                    else:
                        _add_same_vertex(values, places, block, g, p, o)
    first += len(hinges)
    for k in range(len(position_weights)):
        for i in range(3):
            gradient[3 * k + i] += position_weights[k] * residuals[first + 3 * k + i]
            values[places[k, i] + i] += position_weights[k] * position_weights[k]


@compiled
def conjugate_gradients(
    starts: Index,
    rows: Index,
    places: Index,
    values: Float,
    right: Float,
    tolerance: float,
    max_steps: int,
    solution: Float,
) -> int:
    """Solve into `solution` ``(n,)``, with inverse diagonal blocks as preconditioner; return the number of steps.

    Return -1 after `max_steps`, or if rounding makes the matrix or the preconditioner indefinite. The tolerance is
    relative to the residual of the zero solution, in the norm of the preconditioner.
    """
    size = len(right)
    inverse = np.empty((size // 3, 6))
    if not _invert_blocks(places, values, inverse):
        return -1
    r, z, q, p = right.copy(), np.empty(size), np.empty(size), np.zeros(size)
    solution[:] = 0.0
    previous = initial = 0.0
    for step in range(max_steps + 1):
        for k in range(len(inverse)):
            v = 3 * k
            x, y, w = r[v], r[v + 1], r[v + 2]
            z[v] = inverse[k, 0] * x + inverse[k, 1] * y + inverse[k, 2] * w
            z[v + 1] = inverse[k, 1] * x + inverse[k, 3] * y + inverse[k, 4] * w
            z[v + 2] = inverse[k, 2] * x + inverse[k, 4] * y + inverse[k, 5] * w
        current = 0.0
        for i in range(size):
            current += r[i] * z[i]
        if step == 0:
            initial = current
        if current < 0.0:
            return -1
        if current <= tolerance * tolerance * initial:
            return step
        ratio = current / previous if step > 0 else 0.0
        previous = current
        for i in range(size):
            p[i] = z[i] + ratio * p[i]
        _multiply(starts, rows, values, p, q)
        curvature = 0.0
        for i in range(size):
            curvature += p[i] * q[i]
        if not curvature > 0.0:
            return -1
        length = current / curvature
        for i in range(size):
            solution[i] += length * p[i]
            r[i] -= length * q[i]
    return -1


@force_inlined
def _multiply(starts: Index, rows: Index, values: Float, p: Float, q: Float) -> None:
    """Write the product of the matrix and p to q, three columns at a time.

    Unsigned indices save the check for negative ones, a quarter of the time.
    """
    q[:] = 0.0
    for v in range(0, len(p), 3):
        a, b, c = np.uint64(starts[v]), np.uint64(starts[v + 1]), np.uint64(starts[v + 2])
        end = b
        p0, p1, p2 = p[v], p[v + 1], p[v + 2]
        q0 = values[a] * p0 + values[a + ONE] * p1 + values[a + TWO] * p2
        q1 = values[a + ONE] * p0 + values[b] * p1 + values[b + ONE] * p2
        q2 = values[a + TWO] * p0 + values[b + ONE] * p1 + values[c] * p2
        a, b, c = a + THREE, b + TWO, c + ONE
        while a < end:
            i = np.uint64(rows[a])
            x0, x1, x2 = p[i], p[i + ONE], p[i + TWO]
            a0, a1, a2 = values[a], values[a + ONE], values[a + TWO]
            b0, b1, b2 = values[b], values[b + ONE], values[b + TWO]
            c0, c1, c2 = values[c], values[c + ONE], values[c + TWO]
            q[i] += a0 * p0 + b0 * p1 + c0 * p2
            q[i + ONE] += a1 * p0 + b1 * p1 + c1 * p2
            q[i + TWO] += a2 * p0 + b2 * p1 + c2 * p2
            q0 += a0 * x0 + a1 * x1 + a2 * x2
            q1 += b0 * x0 + b1 * x1 + b2 * x2
            q2 += c0 * x0 + c1 * x1 + c2 * x2
            a, b, c = a + THREE, b + THREE, c + THREE
        q[v] += q0
        q[v + 1] += q1
        q[v + 2] += q2


@force_inlined
def _invert_blocks(places: Index, values: Float, inverse: Float) -> bool:
    """Write inverse diagonal blocks as upper triangles ``(n, 6)``, by rows; return whether all blocks are definite."""
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
