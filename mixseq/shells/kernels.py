"""Compiled inner loops of `mixseq.shells.shell` and `mixseq.shells.fitting`.

They compute energies, gradients and normal equations, and solve by conjugate gradients. Tests compare
the formulas with `mixseq.mesh.measures`. Loops release the interpreter's lock and sum in a fixed order, so that results
are bit-identical for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.measure_kernels import Vector, angle, dot, length, opening, side, sides_and_normals
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Float, Index, Int32, Mask

Rows = NDArray[np.uint64]
"""Unsigned indices, which save the check for negative ones."""

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
    residuals: Float,
) -> float:
    """Write the residuals ``(e' + h',)`` of lengths and angles; return the sum of their squares.

    Vertices ``(n, 3)`` and lengths ``(e',)`` are in diagonals, angles ``(h',)`` in radians, weights ``(e',)`` per
    diagonal, `bending` per radian.
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


MAX_DAMPING = 1e12
"""Largest damping; if it yields no step that lowers the energy, the energy is not smooth or not finite."""

MAX_CONVERGED_DAMPING = 1e-2
"""Largest damping with which short steps indicate convergence."""

LEVEL_ENERGY_RATIO = 0.1
"""Ratio of new to old energy below which the energy has not levelled off, as near an exact fit."""

MAX_DECAY = 0.1
"""Largest ratio of successive gains by which the next step is predicted, and not computed if it is short."""

CONJUGATE_GRADIENT_TOLERANCE = 0.03
"""Relative residual at which conjugate gradients stop; the next Gauss-Newton step corrects the error."""

MAX_CONJUGATE_GRADIENT_STEPS = 100
"""Largest number of conjugate gradient steps; the solution descends after any number."""


@compiled
def fit_near(
    x: Float,
    edges: Index,
    hinges: Index,
    lengths: Float,
    angles: Float,
    weights: Float,
    bending: float,
    free_ids: Index,
    free_index: Index,
    position_weights: Float,
    iterations: int,
    tolerance: float,
    exact: float,
    accuracy: float,
) -> float:
    """Move the free vertices of a patch ``(n, 3)`` to lengths and angles, near their positions; return the energy.

    Arguments are those of `shell_residuals` and `shell_equations`, weights of positions ``(f,)`` per diagonal, and the
    limits of `ShellSettings`. Vertices stay where they are if the energy is not finite.
    """
    count, first = len(free_ids), len(edges)
    edge_rows, hinge_rows = np.empty((first, 2), np.uint64), np.empty((len(hinges), 4), np.uint64)
    for elements, element_rows in ((edges, edge_rows), (hinges, hinge_rows)):
        for k in range(len(elements)):
            for p in range(elements.shape[1]):
                row = free_index[elements[k, p]]
                element_rows[k, p] = row if row >= 0 else count  # fixed vertices share a last row without effect
    edge_slopes, hinge_slopes = np.empty((first, 2, 3)), np.empty((len(hinges), 4, 3))
    system = edge_rows, hinge_rows, edge_slopes, hinge_slopes
    residuals, squares = np.empty(first + len(hinges)), np.square(position_weights)
    gradient, step, offsets = np.empty((count + 1, 3)), np.empty((count + 1, 3)), np.zeros((count, 3))
    blocks, work = np.empty((count + 1, 6)), np.empty((4, count + 1, 3))
    energy = shell_residuals(x, edges, hinges, lengths, angles, weights, bending, residuals)
    damping, previous_gain = 1e-6, 0.0
    for _ in range(iterations):
        if not exact * exact < energy < np.inf:
            break
        gradient[:] = 0.0
        blocks[:] = 0.0
        for k in range(first):
            length_gradient(x, edges[k, 0], edges[k, 1], weights[k], edge_slopes[k])
            for p in range(2):
                _add_row(edge_slopes[k, p], residuals[k], edge_rows[k, p], gradient, blocks)
        for k in range(len(hinges)):
            angle_gradient(
                x, hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3], bending, 0.0, 0.0, hinge_slopes[k]
            )
            for p in range(4):
                _add_row(hinge_slopes[k, p], residuals[first + k], hinge_rows[k, p], gradient, blocks)
        for v in range(count):
            for i in range(3):
                gradient[v, i] += squares[v] * offsets[v, i]
                blocks[v, i * (7 - i) // 2] += squares[v]
        while True:
            _solve_near(system, squares, blocks, damping, gradient, work, step)
            gain, longest, new_energy = 0.0, 0.0, 0.0
            for v in range(count):
                for i in range(3):
                    gain -= gradient[v, i] * step[v, i]
                    longest = max(longest, abs(step[v, i]))
                    x[free_ids[v], i] += step[v, i]
                    new_energy += squares[v] * (offsets[v, i] + step[v, i]) ** 2
            new_energy += shell_residuals(x, edges, hinges, lengths, angles, weights, bending, residuals)
            if new_energy < energy:
                break
            for v in range(count):
                for i in range(3):
                    x[free_ids[v], i] -= step[v, i]
            if gain <= tolerance * energy or damping >= MAX_DAMPING:
                return energy
            damping *= 10.0
        for v in range(count):
            for i in range(3):
                offsets[v, i] += step[v, i]
        gain_ratio, has_levelled = (energy - new_energy) / gain, new_energy > LEVEL_ENERGY_RATIO * energy
        energy, decay, previous_gain = new_energy, gain / previous_gain, gain
        is_fast = decay <= MAX_DECAY and longest * math.sqrt(decay) <= accuracy  # then the next step is predicted
        if gain * (decay if is_fast else 1.0) <= tolerance * energy:
            break
        if has_levelled and damping <= MAX_CONVERGED_DAMPING and longest <= accuracy:
            break
        damping = max(damping * (0.2 if gain_ratio > 0.75 else 1.0 if gain_ratio > 0.25 else 4.0), 1e-10)
    return energy


@force_inlined
def _add_row(slope: Float, residual: float, row: int, gradient: Float, blocks: Float) -> None:
    """Add the slope ``(3,)`` of a residual by a vertex to gradient and diagonal block of the vertex."""
    x, y, z = slope[0], slope[1], slope[2]
    gradient[row, 0] += residual * x
    gradient[row, 1] += residual * y
    gradient[row, 2] += residual * z
    blocks[row, 0] += x * x
    blocks[row, 1] += x * y
    blocks[row, 2] += x * z
    blocks[row, 3] += y * y
    blocks[row, 4] += y * z
    blocks[row, 5] += z * z


@compiled
def _solve_near(
    system: tuple[Rows, Rows, Float, Float],
    squares: Float,
    blocks: Float,
    damping: float,
    gradient: Float,
    work: Float,
    solution: Float,
) -> None:
    """Solve the damped normal equations by conjugate gradients, with inverse diagonal blocks as preconditioner.

    The tolerance is relative to the residual of the zero solution, in the norm of the preconditioner.
    """
    count = len(squares)
    r, z, q, p = work[0], work[1], work[2], work[3]
    largest = 0.0
    for v in range(count):
        for i in range(3):
            largest = max(largest, blocks[v, i * (7 - i) // 2])
    inverse, added = np.empty((count, 6)), np.empty((count, 3))
    for v in range(count):
        for i in range(3):
            added[v, i] = damping * blocks[v, i * (7 - i) // 2] + 1e-12 * largest
            r[v, i] = -gradient[v, i]
        _invert_block(blocks[v], added[v], inverse[v])
    solution[:] = 0.0
    p[:] = 0.0
    previous = initial = 0.0
    for _ in range(MAX_CONJUGATE_GRADIENT_STEPS):
        current = 0.0
        for v in range(count):
            x, y, w, m = r[v, 0], r[v, 1], r[v, 2], inverse[v]
            z[v, 0] = m[0] * x + m[1] * y + m[2] * w
            z[v, 1] = m[1] * x + m[3] * y + m[4] * w
            z[v, 2] = m[2] * x + m[4] * y + m[5] * w
            current += x * z[v, 0] + y * z[v, 1] + w * z[v, 2]
        if previous == 0.0:
            initial = current
        if not current > CONJUGATE_GRADIENT_TOLERANCE * CONJUGATE_GRADIENT_TOLERANCE * initial:
            return
        ratio = current / previous if previous > 0.0 else 0.0
        previous = current
        for v in range(count):
            for i in range(3):
                p[v, i] = z[v, i] + ratio * p[v, i]
                q[v, i] = (squares[v] + added[v, i]) * p[v, i]
        _add_product(system, p, q)
        curvature = 0.0
        for v in range(count):
            for i in range(3):
                curvature += p[v, i] * q[v, i]
        if not curvature > 0.0:
            return
        length = current / curvature
        for v in range(count):
            for i in range(3):
                solution[v, i] += length * p[v, i]
                r[v, i] -= length * q[v, i]


@force_inlined
def _add_product(system: tuple[Rows, Rows, Float, Float], p: Float, q: Float) -> None:
    """Add the product of ``J^T J`` and p to q."""
    edge_rows, hinge_rows, edge_slopes, hinge_slopes = system
    for k in range(len(edge_rows)):
        a, b, g = edge_rows[k, 0], edge_rows[k, 1], edge_slopes[k, 1]
        x, y, z = g[0], g[1], g[2]
        s = x * (p[b, 0] - p[a, 0]) + y * (p[b, 1] - p[a, 1]) + z * (p[b, 2] - p[a, 2])
        q[a, 0] -= s * x
        q[a, 1] -= s * y
        q[a, 2] -= s * z
        q[b, 0] += s * x
        q[b, 1] += s * y
        q[b, 2] += s * z
    for k in range(len(hinge_rows)):
        g, rows = hinge_slopes[k], hinge_rows[k]
        s = 0.0
        for o in range(4):
            s += g[o, 0] * p[rows[o], 0] + g[o, 1] * p[rows[o], 1] + g[o, 2] * p[rows[o], 2]
        for o in range(4):
            for i in range(3):
                q[rows[o], i] += s * g[o, i]


@force_inlined
def _invert_block(block: Float, added: Float, inverse: Float) -> None:
    """Write the inverse of a symmetric block ``(6,)`` with numbers ``(3,)`` added to its diagonal, or of its diagonal.

    The latter if rounding makes the block indefinite.
    """
    a, b, c = block[0] + added[0], block[1], block[2]
    d, e, f = block[3] + added[1], block[4], block[5] + added[2]
    first, second, third = d * f - e * e, c * e - b * f, b * e - d * c
    determinant = a * first + b * second + c * third
    if not (a * d > b * b and determinant > 0.0):
        b, c, e = 0.0, 0.0, 0.0
        first, second, third, determinant = d * f, 0.0, 0.0, a * d * f
    scale = 1.0 / determinant
    inverse[0], inverse[1], inverse[2] = scale * first, scale * second, scale * third
    inverse[3], inverse[4], inverse[5] = scale * (a * f - c * c), scale * (b * c - a * e), scale * (a * d - b * b)
