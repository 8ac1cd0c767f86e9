"""Compiled inner loops of `mixseq.shells.face_frames`: chain and average frames, quaternions (w, x, y, z)."""

from __future__ import annotations

import math

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined


@inlined
def product(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p q`` to r, which must not alias them."""
    r[0] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3]
    r[1] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2]
    r[2] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1]
    r[3] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0]


@inlined
def product_with_inverse(p: Float, q: Float, r: Float) -> None:
    """Write the product ``p conj(q)`` to r, which must not alias them."""
    r[0] = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    r[1] = -p[0] * q[1] + p[1] * q[0] - p[2] * q[3] + p[3] * q[2]
    r[2] = -p[0] * q[2] + p[1] * q[3] + p[2] * q[0] - p[3] * q[1]
    r[3] = -p[0] * q[3] - p[1] * q[2] + p[2] * q[1] + p[3] * q[0]


@compiled
def frames_of(x: Float, faces: Index) -> Float:
    """Return the frames ``(m, 4)`` of triangles ``(m, 3)`` of vertices ``(n, 3)``; arbitrary ones without area."""
    frames = np.empty((len(faces), 4))
    r = np.empty((3, 3))
    for f in range(len(faces)):
        a, b, c = faces[f]
        for i in range(3):
            r[i, 0], r[i, 1] = x[b, i] - x[a, i], x[c, i] - x[a, i]
        length = math.sqrt(r[0, 0] ** 2 + r[1, 0] ** 2 + r[2, 0] ** 2)
        if length > 0.0:
            r[:, 0] /= length
        else:
            r[0, 0], r[1, 0], r[2, 0] = 1.0, 0.0, 0.0
        # What is across the first side; of a triangle without area, across that and an axis.
        for attempt in range(4):
            if attempt:
                r[:, 1] = 0.0
                r[attempt - 1, 1] = 1.0
            along = r[0, 0] * r[0, 1] + r[1, 0] * r[1, 1] + r[2, 0] * r[2, 1]
            size = math.sqrt(r[0, 1] ** 2 + r[1, 1] ** 2 + r[2, 1] ** 2)
            for i in range(3):
                r[i, 1] -= along * r[i, 0]
            across = math.sqrt(r[0, 1] ** 2 + r[1, 1] ** 2 + r[2, 1] ** 2)
            if across > 1e-12 * size and across > 0.5 * (attempt > 0):
                r[:, 1] /= across
                break
        r[0, 2] = r[1, 0] * r[2, 1] - r[2, 0] * r[1, 1]
        r[1, 2] = r[2, 0] * r[0, 1] - r[0, 0] * r[2, 1]
        r[2, 2] = r[0, 0] * r[1, 1] - r[1, 0] * r[0, 1]
        _quaternion(r, frames[f])
    return frames


@inlined
def _quaternion(r: Float, q: Float) -> None:
    """Write the unit quaternion of a rotation matrix, from its largest component (Shepperd 1978)."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    largest = 0
    if r[0, 0] > trace:
        largest = 1
    if r[1, 1] > max(trace, r[0, 0]):
        largest = 2
    if r[2, 2] > max(trace, r[0, 0], r[1, 1]):
        largest = 3
    if largest == 0:
        q[0] = 1.0 + trace
        q[1], q[2], q[3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q[0] = r[k, j] - r[j, k]
        q[1 + i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        q[1 + j] = r[j, i] + r[i, j]
        q[1 + k] = r[k, i] + r[i, k]
    length = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    for i in range(4):
        q[i] /= length


@compiled
def transitions(first: Float, second: Float, bends: Float) -> Float:
    """Return the rotations ``R_z(first) R_x(bend) R_z(-second)`` ``(h, 4)`` across hinges ``(h,)``."""
    turns = np.empty((len(bends), 4))
    for k in range(len(bends)):
        c, s = math.cos(0.5 * bends[k]), math.sin(0.5 * bends[k])
        along, across = 0.5 * (first[k] - second[k]), 0.5 * (first[k] + second[k])
        turns[k, 0], turns[k, 3] = c * math.cos(along), c * math.sin(along)
        turns[k, 1], turns[k, 2] = s * math.cos(across), s * math.sin(across)
    return turns


@compiled
def chained(
    pairs: Index, turns: Float, weights: Float, order: Index, starts: Index, links: Index, frames: Float
) -> None:
    """Write frames ``(n, 4)`` in the order ``(k,)``, each the mean predicted by its links to earlier ones.

    The links of ``order[k]`` are ``links[starts[k] : starts[k + 1]]``: numbers of pairs ``(h, 2)``, -1 - number where
    the frame is the first of its pair. Frames outside the order are known.
    """
    seen, total = np.empty(4), np.empty(4)
    for k in range(len(order)):
        total[:] = 0.0
        for place in range(starts[k], starts[k + 1]):
            pair = links[place]
            if pair >= 0:
                product(frames[pairs[pair, 0]], turns[pair], seen)
            else:
                pair = -1 - pair
                product_with_inverse(frames[pairs[pair, 1]], turns[pair], seen)
            cosine = total[0] * seen[0] + total[1] * seen[1] + total[2] * seen[2] + total[3] * seen[3]
            square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
            # Both signs of a quaternion are the same rotation; links half a turn off the others are ignored.
            weight = weights[pair] * (cosine / math.sqrt(square) if square > 0.0 else 1.0)
            for i in range(4):
                total[i] += weight * seen[i]
        square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
        if square > 0.0:
            frames[order[k]] = total / math.sqrt(square)


@compiled
def misfits(frames: Float, pairs: Index, turns: Float, weights: Float, right: Float) -> None:
    """Write the right-hand side ``(n, 3)`` of a step of averaging: weighted axes of misfits, as long as their sines."""
    right[:] = 0.0
    expected, off = np.empty(4), np.empty(4)
    for k in range(len(pairs)):
        i, j = pairs[k]
        product(frames[i], turns[k], expected)
        product_with_inverse(expected, frames[j], off)
        scale = 2.0 * weights[k] * off[0]
        for c in range(3):
            right[j, c] += scale * off[1 + c]
            right[i, c] -= scale * off[1 + c]


@compiled
def turned_on(frames: Float, steps: Float) -> None:
    """Rotate frames ``(n, 4)`` by rotation vectors ``(n, 3)``, in place."""
    turn, result = np.empty(4), np.empty(4)
    for v in range(len(frames)):
        angle = math.sqrt(steps[v, 0] ** 2 + steps[v, 1] ** 2 + steps[v, 2] ** 2)
        scale = math.sin(0.5 * angle) / angle if angle > 1e-12 else 0.5
        turn[0] = math.cos(0.5 * angle)
        for c in range(3):
            turn[1 + c] = scale * steps[v, c]
        product(turn, frames[v], result)
        frames[v] = result / math.sqrt(result[0] ** 2 + result[1] ** 2 + result[2] ** 2 + result[3] ** 2)


@compiled
def turned_sides(frames: Float, flat: Float) -> Float:
    """Return the sides 01, 12, 20 ``(F, 3, 3)`` of flat triangles ``(F, 3, 2)`` with frames ``(F, 4)``."""
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
