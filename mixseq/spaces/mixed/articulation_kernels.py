"""The inner loops of `articulation`, compiled: poses that agree with relations, and motions of parts.

Quaternions are (w, x, y, z), of any length where they are given, and unit where they are returned. Arrays are of real
or of complex numbers: a complex step gives derivatives (`complex_step`).
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined

ROUNDS = 2
"""Rounds of rotation averaging."""

SMALL = 1e-6
"""Squared length of a rotation vector below which its exponential is a power series, in squared radians."""


@inlined
def _product(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p q`` to r, which is neither of them."""
    r[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    r[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    r[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    r[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]


@inlined
def _product_with_inverse(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p conj(q)`` to r, which is neither of them."""
    r[0] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    r[1] = -p[0] * q[1] + p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    r[2] = -p[0] * q[2] + p[1] * q[3] + p[2] * q[0] - p[3] * q[1]
    r[3] = -p[0] * q[3] - p[1] * q[2] + p[2] * q[1] + p[3] * q[0]


@inlined
def _turn(q: Float, v: Float, r: Float) -> None:
    """Write a vector turned by a unit quaternion to r, which is not the vector."""
    a = 2.0 * (q[2] * v[2] - q[3] * v[1])
    b = 2.0 * (q[3] * v[0] - q[1] * v[2])
    c = 2.0 * (q[1] * v[1] - q[2] * v[0])
    r[0] = v[0] + q[0] * a + q[2] * c - q[3] * b
    r[1] = v[1] + q[0] * b + q[3] * a - q[1] * c
    r[2] = v[2] + q[0] * c + q[1] * b - q[2] * a


@inlined
def _normalise(q: Float) -> None:
    """Scale a quaternion to length one; zero, a blend of rotations half a turn apart, becomes no rotation."""
    square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]
    if square.real > 0.0:
        inverse = 1.0 / np.sqrt(square)
        for i in range(4):
            q[i] *= inverse
    else:
        q[0] += 1.0


@compiled
def agree(
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
    """Return the poses ``(p, 4)``, ``(p, 3)`` that agree best with poses and relations.

    Parameters
    ----------
    turns, centres : (p, 4), (p, 3)
        Poses of parts, as seen from the body: rotations since the reference frame, and centres.
    relation_turns, relation_points : (n, 4), (n, 3)
        How part j is turned as seen from part i, and where its pivot is from the centre of i.
    pairs : (n, 2) int64
        Parts i and j.
    pivots : (n, 3) float64
        The pivots, from the centre of part j in the reference frame.
    order, before, links : (m,) int64
        Parts that hang on another, each after that, that part, and the relation by which it sees them.
    own_turns : (p,) float64
        Weights of rotations of parts.
    turn_weights, place_weights : (n,) float64
        Weights of relations.
    turn_inverse, place_inverse : (p, p) float64
        Inverse matrices of both systems.
    """
    count = len(turns)
    t, c = turns.copy(), centres.copy()
    for part in range(count):
        _normalise(t[part])
    step, seen, expected, off = (
        np.empty(4, t.dtype),
        np.empty(4, t.dtype),
        np.empty(4, t.dtype),
        np.empty(4, t.dtype),
    )
    # Start from relations, along the tree: they change less than poses, and blends of them are never far off.
    for k in range(len(order)):
        for a in range(4):
            seen[a] = relation_turns[links[k], a]
        _normalise(seen)
        _product(t[before[k]], seen, expected)
        for a in range(4):
            t[order[k], a] = expected[a]
    right = np.empty((count, 3), t.dtype)
    for _ in range(ROUNDS):
        # Misfits count by their sines, which are smooth: half a turn has no side. A blend of rotations that are far
        # apart is a short quaternion, and counts less.
        for part in range(count):
            _product_with_inverse(turns[part], t[part], off)
            scale = 2.0 * own_turns[part] * off[0]
            for a in range(3):
                right[part, a] = scale * off[1 + a]
        for k in range(len(pairs)):
            i, j = pairs[k, 0], pairs[k, 1]
            _product(t[i], relation_turns[k], expected)
            _product_with_inverse(expected, t[j], off)
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
            _product(step, t[part], expected)
            _normalise(expected)
            for a in range(4):
                t[part, a] = expected[a]
    right[:] = 0.0
    here, there = np.empty(3, t.dtype), np.empty(3, t.dtype)
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        _turn(t[i], relation_points[k], here)
        _turn(t[j], pivots[k], there)
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
def correct(turns: Float, centres: Float, spins: Float, shifts: Float) -> tuple[Float, Float]:
    """Turn poses ``(p, 4)``, ``(p, 3)`` on by rotation vectors ``(p, 3)`` in their own axes, and shift centres."""
    t, c = np.empty_like(turns), centres + shifts
    step = np.empty(4, t.dtype)
    for part in range(len(t)):
        square = spins[part, 0] ** 2 + spins[part, 1] ** 2 + spins[part, 2] ** 2
        if square.real < SMALL:
            step[0] = 1.0 - square / 8.0 + square * square / 384.0
            scale = 0.5 - square / 48.0 + square * square / 3840.0
        else:
            angle = np.sqrt(square)
            step[0] = np.cos(0.5 * angle)
            scale = np.sin(0.5 * angle) / angle
        for a in range(3):
            step[1 + a] = scale * spins[part, a]
        _product(turns[part], step, t[part])
    return t, c


@compiled
def motions(
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

    Signs follow a tree: each part has that nearest to the part before it, so that blends take the shorter way.

    Parameters
    ----------
    turns, centres : (p, 4), (p, 3)
        Poses of parts as seen from their bodies, rotations of unit length.
    body_turns, body_centres : (B, 4), (B, 3)
        Poses of the bodies.
    bodies : (p,) int64
        The body of every part.
    rest_centres : (p, 3) float64
        Centres of the parts in the reference frame.
    order, before : (m,) int64
        Parts that have a part before them, and that part.
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
        _product(frames[body], turns[part], q)
        _turn(frames[body], centres[part], point)
        _turn(q, rest_centres[part], rest)
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
