"""Compiled inner loops that chain rotations, reconcile part poses, compute motions of parts, and skin a mesh.

Skinning blends dual quaternions. Quaternions are (w, x, y, z), inputs of any length, results of unit length; positions
are in diagonals. Arrays are real or complex, for derivatives by a complex step
(`mixseq.spaces.mixed.joint_projection`).
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.runtime.jit import compiled, inlined
from mixseq.shells.face_frames import multiply, multiply_by_inverse, multiply_inverse_by
from mixseq.types import Float, Index, Int32

PART_AVERAGING_ROUNDS = 2  # rounds of rotation averaging over parts
SERIES_SQUARED_ANGLE = 1e-6  # squared radians below which the exponential is a power series


@inlined
def _rotate(w: float, p: float, q: float, r: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rotate a vector by a unit quaternion: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    a = 2.0 * (q * z - r * y)
    b = 2.0 * (r * x - p * z)
    c = 2.0 * (p * y - q * x)
    return x + w * a + q * c - r * b, y + w * b + r * a - p * c, z + w * c + p * b - q * a


@inlined
def _rotate_into(q: Float, v: Float, r: Float) -> None:
    """Write a vector v, rotated by a unit quaternion, to r, which must not alias v."""
    r[0], r[1], r[2] = _rotate(q[0], q[1], q[2], q[3], v[0], v[1], v[2])


@inlined
def _normalise(q: Float) -> None:
    """Scale a quaternion to unit length; zero becomes the identity."""
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if square.real > 0.0:
        inverse = 1.0 / np.sqrt(square)
        for i in range(4):
            q[i] *= inverse
    else:
        q[0] += 1.0


EXPONENT_TOLERANCE = 1e-12  # distance to 0 or 1 below which exponents of rotations are rounded


@compiled
def multiply_powers(rotations: Float, frame_ids: Index, exponents: Float, result: Float) -> None:
    """Write products ``(N, p, 4)`` of rotations ``(T, p, 4)`` and of powers ``(N, m)`` of the steps between frames."""
    step, total, product = np.empty(4), np.empty(4), np.empty(4)
    for n in range(len(frame_ids)):
        for part in range(rotations.shape[1]):
            total[:] = rotations[frame_ids[n, 0], part]
            for k in range(1, frame_ids.shape[1]):
                exponent, current = exponents[n, k], rotations[frame_ids[n, k], part]
                if abs(exponent - 1.0) < EXPONENT_TOLERANCE:
                    total[:] = current  # all preceding exponents are one, too
                elif abs(exponent) >= EXPONENT_TOLERANCE:
                    multiply_inverse_by(rotations[frame_ids[n, k - 1], part], current, step)
                    sine = math.sqrt(step[1] ** 2 + step[2] ** 2 + step[3] ** 2)
                    sign = -1.0 if step[0] <= 0.0 else 1.0  # of the quaternion with an angle of at most pi
                    angle = exponent * math.atan2(sine, sign * step[0])
                    # The ratio of the sines approaches the exponent for small angles.
                    ratio = sign * (math.sin(angle) / sine if sine > 1e-12 else exponent)
                    step[0] = math.cos(angle)
                    for i in range(1, 4):
                        step[i] *= ratio
                    multiply(total, step, product)
                    total[:] = product
            result[n, part] = total


@compiled
def reconcile_poses(
    rotations: Float,
    centres: Float,
    relation_rotations: Float,
    relation_points: Float,
    pairs: Index,
    pivots: Float,
    children: Index,
    parents: Index,
    child_relations: Index,
    part_turn_weights: Float,
    relation_turn_weights: Float,
    rotation_inverse: Float,
    relation_centre_weights: Float,
    centre_inverse: Float,
) -> tuple[Float, Float]:
    """Return the part poses ``(p, 4)``, ``(p, 3)``, relative to bodies, that fit poses and relations best.

    Relations ``(n, 4), (n, 3)`` have the rotation and pivot of part j in the axes of part i; pivots ``(n, 3)`` are from
    the centre of j at rest. Children, their parents and relations ``(m,)`` are a tree in topological order.
    """
    count = len(rotations)
    q, c = rotations.copy(), centres.copy()
    for part in range(count):
        _normalise(q[part])
    step, relation = np.empty(4, q.dtype), np.empty(4, q.dtype)
    expected, misfit = np.empty(4, q.dtype), np.empty(4, q.dtype)
    # Start from relations along the tree: relations vary less than poses, so that their blends are near the solution.
    for k in range(len(children)):
        for a in range(4):
            relation[a] = relation_rotations[child_relations[k], a]
        _normalise(relation)
        multiply(q[parents[k]], relation, expected)
        for a in range(4):
            q[children[k], a] = expected[a]
    right = np.empty((count, 3), q.dtype)
    for _ in range(PART_AVERAGING_ROUNDS):
        # Misfits are weighted by their sines, which are smooth at 180 degrees. Blends of distant rotations are short
        # quaternions, with less weight.
        for part in range(count):
            multiply_by_inverse(rotations[part], q[part], misfit)
            scale = 2.0 * part_turn_weights[part] * misfit[0]
            for a in range(3):
                right[part, a] = scale * misfit[1 + a]
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            multiply(q[i], relation_rotations[k], expected)
            multiply_by_inverse(expected, q[j], misfit)
            scale = 2.0 * relation_turn_weights[k] * misfit[0]
            for a in range(3):
                right[j, a] += scale * misfit[1 + a]
                right[i, a] -= scale * misfit[1 + a]
        for part in range(count):
            step[0] = 1.0
            for a in range(3):
                step[1 + a] = 0.0
                for other in range(count):
                    step[1 + a] += 0.5 * rotation_inverse[part, other] * right[other, a]
            multiply(step, q[part], expected)
            _normalise(expected)
            for a in range(4):
                q[part, a] = expected[a]
    right[:] = 0.0
    pivot_i, pivot_j = np.empty(3, q.dtype), np.empty(3, q.dtype)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        _rotate_into(q[i], relation_points[k], pivot_i)
        _rotate_into(q[j], pivots[k], pivot_j)
        for a in range(3):
            gap = relation_centre_weights[k] * (c[i, a] + pivot_i[a] - c[j, a] - pivot_j[a])
            right[j, a] += gap
            right[i, a] -= gap
    for part in range(count):
        for a in range(3):
            for other in range(count):
                c[part, a] += centre_inverse[part, other] * right[other, a]
    return q, c


@compiled
def correct_poses(rotations: Float, centres: Float, vectors: Float, shifts: Float) -> tuple[Float, Float]:
    """Rotate poses ``(p, 4)``, ``(p, 3)`` by rotation vectors ``(p, 3)`` in their own axes, and shift their centres."""
    q, c = np.empty_like(rotations), centres + shifts
    step = np.empty(4, q.dtype)
    for part in range(len(q)):
        square = vectors[part, 0] ** 2 + vectors[part, 1] ** 2 + vectors[part, 2] ** 2
        if square.real < SERIES_SQUARED_ANGLE:
            step[0] = 1.0 - square / 8.0 + square * square / 384.0
            scale = 0.5 - square / 48.0 + square * square / 3840.0
        else:
            angle = np.sqrt(square)
            step[0] = np.cos(0.5 * angle)
            scale = np.sin(0.5 * angle) / angle
        for a in range(3):
            step[1 + a] = scale * vectors[part, a]
        multiply(rotations[part], step, q[part])
    return q, c


@compiled
def part_motions(
    rotations: Float,
    centres: Float,
    body_rotations: Float,
    body_centres: Float,
    body_of_part: Index,
    rest_centres: Float,
    children: Index,
    parents: Index,
) -> Float:
    """Return the motions of parts from the reference frame, as unit dual quaternions ``(p, 8)``.

    Part poses ``(p, 4), (p, 3)`` are relative to bodies ``(B, 4), (B, 3)``. Signs follow a tree, parents first: each
    part gets the sign nearest to its parent's, so that blends take the shorter way.
    """
    count = len(rotations)
    duals = np.empty((count, 8), rotations.dtype)
    normalised = body_rotations.copy()
    for body in range(len(normalised)):
        _normalise(normalised[body])
    q, shift = np.empty(4, rotations.dtype), np.empty(3, rotations.dtype)
    centre, rest_centre = np.empty(3, rotations.dtype), np.empty(3, rotations.dtype)
    for part in range(count):
        body = body_of_part[part]
        multiply(normalised[body], rotations[part], q)
        _rotate_into(normalised[body], centres[part], centre)
        _rotate_into(q, rest_centres[part], rest_centre)
        for a in range(3):
            shift[a] = centre[a] + body_centres[body, a] - rest_centre[a]
        duals[part, 0], duals[part, 1], duals[part, 2], duals[part, 3] = q[0], q[1], q[2], q[3]
        duals[part, 4] = 0.5 * (-shift[0] * q[1] - shift[1] * q[2] - shift[2] * q[3])
        duals[part, 5] = 0.5 * (shift[0] * q[0] + shift[1] * q[3] - shift[2] * q[2])
        duals[part, 6] = 0.5 * (shift[1] * q[0] + shift[2] * q[1] - shift[0] * q[3])
        duals[part, 7] = 0.5 * (shift[2] * q[0] + shift[0] * q[2] - shift[1] * q[1])
    for k in range(len(children)):
        part, parent = children[k], parents[k]
        cosine = 0.0
        for a in range(4):
            cosine += (duals[part, a] * duals[parent, a]).real
        if cosine < 0.0:
            for a in range(8):
                duals[part, a] = -duals[part, a]
    return duals


@inlined
def _blend(starts: Int32, parts: Int32, weights: Float, duals: Float, v: int, motion: Float) -> None:
    """Write the blended motion of a vertex: a unit quaternion and a translation, seven numbers."""
    first, end = starts[v], starts[v + 1]
    if end == first + 1:  # the motion of a single part is a unit dual quaternion already
        for i in range(8):
            motion[i] = duals[parts[first], i]
    else:
        for i in range(8):
            motion[i] = 0.0
        for place in range(first, end):
            for i in range(8):
                motion[i] += weights[place] * duals[parts[place], i]
        square = motion[0] * motion[0] + motion[1] * motion[1] + motion[2] * motion[2] + motion[3] * motion[3]
        # A blend of opposite motions is zero.
        inverse = 1.0 / np.sqrt(square) if square.real > 0.0 else 0.0 * square
        for i in range(8):
            motion[i] *= inverse
    w, x, y, z = motion[0], motion[1], motion[2], motion[3]
    d, a, b, c = motion[4], motion[5], motion[6], motion[7]
    # The translation is twice the vector part of dual times conjugate.
    motion[4] = 2.0 * (-d * x + a * w - b * z + c * y)
    motion[5] = 2.0 * (-d * y + b * w - c * x + a * z)
    motion[6] = 2.0 * (-d * z + c * w - a * y + b * x)


@compiled
def skin_vertices(starts: Int32, parts: Int32, weights: Float, duals: Float, rest_vertices: Float) -> Float:
    """Move rest vertices ``(V, 3)`` by blended motions ``(p, 8)``; `starts` ``(V + 1,)`` index parts and weights."""
    x = np.empty_like(rest_vertices)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        u = rest_vertices[v]
        a, b, c = _rotate(m[0], m[1], m[2], m[3], u[0], u[1], u[2])
        x[v, 0], x[v, 1], x[v, 2] = a + m[4], b + m[5], c + m[6]
    return x


@compiled
def unskin_vertices(starts: Int32, parts: Int32, weights: Float, duals: Float, x: Float) -> Float:
    """Move vertices ``(V, 3)`` to rest space; the inverse of `skin_vertices`."""
    rest_vertices = np.empty_like(x)
    m = np.empty(8, duals.dtype)
    for v in range(len(x)):
        _blend(starts, parts, weights, duals, v, m)
        a, b, c = _rotate(m[0], -m[1], -m[2], -m[3], x[v, 0] - m[4], x[v, 1] - m[5], x[v, 2] - m[6])
        rest_vertices[v, 0], rest_vertices[v, 1], rest_vertices[v, 2] = a, b, c
    return rest_vertices
