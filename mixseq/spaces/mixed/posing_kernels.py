"""Compiled inner loops that pose a mesh: agreement of poses and relations, motions of parts, and skinning.

Skinning blends dual quaternions. Quaternions are (w, x, y, z), inputs of any length, results of unit length; positions
are in diagonals. Arrays are real or complex, for derivatives by a complex step
(`mixseq.spaces.mixed.joint_projection`).
"""

from __future__ import annotations

import numpy as np

from mixseq.runtime.jit import compiled, inlined
from mixseq.shells.face_frames import multiply, multiply_by_inverse
from mixseq.types import Float, Index

AVERAGING_ROUNDS = 2
"""Rounds of rotation averaging over parts."""

SERIES_SQUARED_ANGLE = 1e-6
"""Squared length of a rotation vector below which its exponential is a power series, in squared radians."""


@inlined
def _rotate(
    w: float, p: float, q: float, r: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Rotate a vector by a unit quaternion: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    a = 2.0 * (q * z - r * y)
    b = 2.0 * (r * x - p * z)
    c = 2.0 * (p * y - q * x)
    return x + w * a + q * c - r * b, y + w * b + r * a - p * c, z + w * c + p * b - q * a


@inlined
def _rotate_into(q: Float, v: Float, r: Float) -> None:
    """Write a vector rotated by a unit quaternion to r, which must not alias it."""
    r[0], r[1], r[2] = _rotate(q[0], q[1], q[2], q[3], v[0], v[1], v[2])


@inlined
def _normalise(q: Float) -> None:
    """Scale a quaternion to unit length; zero, a blend of rotations half a turn apart, becomes the identity."""
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if square.real > 0.0:
        inverse = 1.0 / np.sqrt(square)
        for i in range(4):
            q[i] *= inverse
    else:
        q[0] += 1.0


@compiled
def reconcile_poses(
    turns: Float,
    centres: Float,
    relation_turns: Float,
    relation_points: Float,
    pairs: Index,
    pivots: Float,
    order: Index,
    before: Index,
    links: Index,
    own_turns: Float,
    turn_weights: Float,
    turn_inverse: Float,
    place_weights: Float,
    place_inverse: Float,
) -> tuple[Float, Float]:
    """Return the part poses ``(p, 4)``, ``(p, 3)``, relative to bodies, that agree best with poses and relations.

    Relations ``(n, 4), (n, 3)`` have the rotation and pivot of part j in the axes of part i; pivots ``(n, 3)`` are from
    the centre of j at rest. Children, parents and links ``(m,)`` are a tree in topological order.
    """
    count = len(turns)
    t, c = turns.copy(), centres.copy()
    for part in range(count):
        _normalise(t[part])
    step, seen = np.empty(4, t.dtype), np.empty(4, t.dtype)
    expected, off = np.empty(4, t.dtype), np.empty(4, t.dtype)
    # Start from relations, along the tree: they change less than poses, and blends of them are never far off.
    for k in range(len(order)):
        for a in range(4):
            seen[a] = relation_turns[links[k], a]
        _normalise(seen)
        multiply(t[before[k]], seen, expected)
        for a in range(4):
            t[order[k], a] = expected[a]
    right = np.empty((count, 3), t.dtype)
    for _ in range(AVERAGING_ROUNDS):
        # Misfits count by their sines, which are smooth: half a turn has no side. A blend of rotations that are far
        # apart is a short quaternion, and counts less.
        for part in range(count):
            multiply_by_inverse(turns[part], t[part], off)
            scale = 2.0 * own_turns[part] * off[0]
            for a in range(3):
                right[part, a] = scale * off[1 + a]
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            multiply(t[i], relation_turns[k], expected)
            multiply_by_inverse(expected, t[j], off)
            scale = 2.0 * turn_weights[k] * off[0]
            for a in range(3):
                right[j, a] += scale * off[1 + a]
                right[i, a] -= scale * off[1 + a]
        for part in range(count):
            step[0] = 1.0
            for a in range(3):
                step[1 + a] = 0.0
                for other in range(count):
                    step[1 + a] += 0.5 * turn_inverse[part, other] * right[other, a]
            multiply(step, t[part], expected)
            _normalise(expected)
            for a in range(4):
                t[part, a] = expected[a]
    right[:] = 0.0
    here, there = np.empty(3, t.dtype), np.empty(3, t.dtype)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        _rotate_into(t[i], relation_points[k], here)
        _rotate_into(t[j], pivots[k], there)
        for a in range(3):
            gap = place_weights[k] * (c[i, a] + here[a] - c[j, a] - there[a])
            right[j, a] += gap
            right[i, a] -= gap
    for part in range(count):
        for a in range(3):
            for other in range(count):
                c[part, a] += place_inverse[part, other] * right[other, a]
    return t, c


@compiled
def correct_poses(turns: Float, centres: Float, spins: Float, shifts: Float) -> tuple[Float, Float]:
    """Rotate poses ``(p, 4)``, ``(p, 3)`` by rotation vectors ``(p, 3)`` in their own axes, and shift centres."""
    t, c = np.empty_like(turns), centres + shifts
    step = np.empty(4, t.dtype)
    for part in range(len(t)):
        square = spins[part, 0] ** 2 + spins[part, 1] ** 2 + spins[part, 2] ** 2
        if square.real < SERIES_SQUARED_ANGLE:
            step[0] = 1.0 - square / 8.0 + square * square / 384.0
            scale = 0.5 - square / 48.0 + square * square / 3840.0
        else:
            angle = np.sqrt(square)
            step[0] = np.cos(0.5 * angle)
            scale = np.sin(0.5 * angle) / angle
        for a in range(3):
            step[1 + a] = scale * spins[part, a]
        multiply(turns[part], step, t[part])
    return t, c


@compiled
def part_motions(
    turns: Float,
    centres: Float,
    body_turns: Float,
    body_centres: Float,
    bodies: Index,
    rest_centres: Float,
    order: Index,
    before: Index,
) -> Float:
    """Return the motions of parts from the reference frame, as unit dual quaternions ``(p, 8)``.

    Part poses ``(p, 4), (p, 3)`` are relative to bodies ``(B, 4), (B, 3)``. Signs follow a tree, parents first: each
    part has that nearest to its parent, so that blends take the shorter way.
    """
    count = len(turns)
    duals = np.empty((count, 8), turns.dtype)
    frames = body_turns.copy()
    for body in range(len(frames)):
        _normalise(frames[body])
    q, point, rest = np.empty(4, turns.dtype), np.empty(3, turns.dtype), np.empty(3, turns.dtype)
    shift = np.empty(3, turns.dtype)
    for part in range(count):
        body = bodies[part]
        multiply(frames[body], turns[part], q)
        _rotate_into(frames[body], centres[part], point)
        _rotate_into(q, rest_centres[part], rest)
        for a in range(3):
            shift[a] = point[a] + body_centres[body, a] - rest[a]
        duals[part, 0], duals[part, 1], duals[part, 2], duals[part, 3] = q[0], q[1], q[2], q[3]
        duals[part, 4] = 0.5 * (-shift[0] * q[1] - shift[1] * q[2] - shift[2] * q[3])
        duals[part, 5] = 0.5 * (shift[0] * q[0] + shift[1] * q[3] - shift[2] * q[2])
        duals[part, 6] = 0.5 * (shift[1] * q[0] + shift[2] * q[1] - shift[0] * q[3])
        duals[part, 7] = 0.5 * (shift[2] * q[0] + shift[0] * q[2] - shift[1] * q[1])
    for k in range(len(order)):
        part, other = order[k], before[k]
        cosine = 0.0
        for a in range(4):
            cosine += (duals[part, a] * duals[other, a]).real
        if cosine < 0.0:
            for a in range(8):
                duals[part, a] = -duals[part, a]
    return duals


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
def skin_vertices(starts: Index, parts: Index, weights: Float, duals: Float, unposed: Float) -> Float:
    """Move vertices ``(V, 3)`` by blended motions ``(p, 8)`` of parts; `starts` ``(V + 1,)`` index the weights."""
    x = np.empty_like(unposed)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        a, b, c = _rotate(m[0], m[1], m[2], m[3], unposed[v, 0], unposed[v, 1], unposed[v, 2])
        x[v, 0], x[v, 1], x[v, 2] = a + m[4], b + m[5], c + m[6]
    return x


@compiled
def unskin_vertices(starts: Index, parts: Index, weights: Float, duals: Float, x: Float) -> Float:
    """Move vertices ``(V, 3)`` by the inverse of `pose`."""
    unposed = np.empty_like(x)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        a, b, c = _rotate(m[0], -m[1], -m[2], -m[3], x[v, 0] - m[4], x[v, 1] - m[5], x[v, 2] - m[6])
        unposed[v, 0], unposed[v, 1], unposed[v, 2] = a, b, c
    return unposed
