"""The inner loops of `vertex_frames` and `sides`, compiled.

A motion is seven numbers, a unit quaternion (w, x, y, z) and a translation; its rate six, a spin and a speed.
Positions are in diagonals, rates per second.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled, inlined


@inlined
def _turned(q: Float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Turn a vector by a unit quaternion: ``v + 2 w (u x v) + 2 u x (u x v)``."""
    a = 2.0 * (q[2] * z - q[3] * y)
    b = 2.0 * (q[3] * x - q[1] * z)
    c = 2.0 * (q[1] * y - q[2] * x)
    return (
        x + q[0] * a + q[2] * c - q[3] * b,
        y + q[0] * b + q[3] * a - q[1] * c,
        z + q[0] * c + q[1] * b - q[2] * a,
    )


@inlined
def _vector_of_product(p: Float, q: Float) -> tuple[float, float, float]:
    """Return the vector part of ``p conj(q)``."""
    return (
        -p[0] * q[1] + p[1] * q[0] - p[2] * q[3] + p[3] * q[2],
        -p[0] * q[2] + p[2] * q[0] - p[3] * q[1] + p[1] * q[3],
        -p[0] * q[3] + p[3] * q[0] - p[1] * q[2] + p[2] * q[1],
    )


@compiled
def blend(starts: Index, parts: Index, shares: Float, duals: Float) -> Float:
    """Blend dual quaternions of parts to motions ``(V, 7)`` of vertices.

    Parameters
    ----------
    starts, parts, shares : (V + 1,) int64, (m,) int64, (m,) float64
        Rows of a sparse matrix: parts that a vertex follows, and how much.
    duals : (p, 8) float64
        Real, then dual part of the motion of every part.
    """
    motions = np.empty((len(starts) - 1, 7))
    total = np.empty(8)
    for v in range(len(motions)):
        total[:] = 0.0
        for place in range(starts[v], starts[v + 1]):
            for i in range(8):
                total[i] += shares[place] * duals[parts[place], i]
        square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
        length = np.sqrt(square)
        for i in range(4):
            motions[v, i] = total[i] / length
        a, b, c = _vector_of_product(total[4:], total[:4])
        motions[v, 4], motions[v, 5], motions[v, 6] = 2.0 * a / square, 2.0 * b / square, 2.0 * c / square
    return motions


@compiled
def blend_moving(
    starts: Index, parts: Index, shares: Float, duals: Float, rates: Float
) -> tuple[Float, Float]:
    """Blend as `blend` does, and return the rates ``(V, 6)`` of motions too.

    Parameters
    ----------
    starts, parts, shares, duals
        As in `blend`.
    rates : (p, 8) float64
        Derivatives of the duals by time.
    """
    motions, changes = np.empty((len(starts) - 1, 7)), np.empty((len(starts) - 1, 6))
    total, change = np.empty(8), np.empty(8)
    for v in range(len(motions)):
        total[:] = 0.0
        change[:] = 0.0
        for place in range(starts[v], starts[v + 1]):
            for i in range(8):
                total[i] += shares[place] * duals[parts[place], i]
                change[i] += shares[place] * rates[parts[place], i]
        square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
        growth = total[0] * change[0] + total[1] * change[1] + total[2] * change[2] + total[3] * change[3]
        length = np.sqrt(square)
        for i in range(4):
            motions[v, i] = total[i] / length
        a, b, c = _vector_of_product(total[4:], total[:4])
        motions[v, 4], motions[v, 5], motions[v, 6] = 2.0 * a / square, 2.0 * b / square, 2.0 * c / square
        a, b, c = _vector_of_product(change[:4], total[:4])
        changes[v, 0], changes[v, 1], changes[v, 2] = 2.0 * a / square, 2.0 * b / square, 2.0 * c / square
        a, b, c = _vector_of_product(change[4:], total[:4])
        d, e, f = _vector_of_product(total[4:], change[:4])
        slower = 2.0 * growth / square
        changes[v, 3] = 2.0 * (a + d) / square - slower * motions[v, 4]
        changes[v, 4] = 2.0 * (b + e) / square - slower * motions[v, 5]
        changes[v, 5] = 2.0 * (c + f) / square - slower * motions[v, 6]
    return motions, changes


@compiled
def pose(motions: Float, unposed: Float) -> Float:
    """Move vertices ``(V, 3)`` by their motions ``(V, 7)``."""
    x = np.empty_like(unposed)
    for v in range(len(x)):
        a, b, c = _turned(motions[v], unposed[v, 0], unposed[v, 1], unposed[v, 2])
        x[v, 0], x[v, 1], x[v, 2] = a + motions[v, 4], b + motions[v, 5], c + motions[v, 6]
    return x


@compiled
def pose_moving(motions: Float, changes: Float, x: Float, rates: Float) -> Float:
    """Return the velocities ``(V, 3)`` of posed vertices.

    Parameters
    ----------
    motions, changes : (V, 7), (V, 6) float64
        Motions of the vertices, and their rates.
    x, rates : (V, 3) float64
        Posed vertices, and the rates of the unposed ones.
    """
    speeds = np.empty_like(x)
    for v in range(len(x)):
        a, b, c = _turned(motions[v], rates[v, 0], rates[v, 1], rates[v, 2])
        p, q, r = x[v, 0] - motions[v, 4], x[v, 1] - motions[v, 5], x[v, 2] - motions[v, 6]
        s = changes[v]
        speeds[v, 0] = a + s[1] * r - s[2] * q + s[3]
        speeds[v, 1] = b + s[2] * p - s[0] * r + s[4]
        speeds[v, 2] = c + s[0] * q - s[1] * p + s[5]
    return speeds


@compiled
def unpose(motions: Float, x: Float) -> Float:
    """Move vertices ``(V, 3)`` back by their motions ``(V, 7)``: the inverse of `pose`."""
    unposed = np.empty_like(x)
    back = np.empty(4)
    for v in range(len(x)):
        back[0] = motions[v, 0]
        for i in range(1, 4):
            back[i] = -motions[v, i]
        a, b, c = _turned(back, x[v, 0] - motions[v, 4], x[v, 1] - motions[v, 5], x[v, 2] - motions[v, 6])
        unposed[v, 0], unposed[v, 1], unposed[v, 2] = a, b, c
    return unposed


@compiled
def face_frames(motions: Float, faces: Index) -> Float:
    """Return the mean rotations ``(f, 4)`` of the corners of faces ``(f, 3)``, unit quaternions."""
    frames = np.empty((len(faces), 4))
    for f in range(len(faces)):
        for i in range(4):
            frames[f, i] = motions[faces[f, 0], i] + motions[faces[f, 1], i] + motions[faces[f, 2], i]
        length = np.sqrt(frames[f, 0] ** 2 + frames[f, 1] ** 2 + frames[f, 2] ** 2 + frames[f, 3] ** 2)
        for i in range(4):
            frames[f, i] /= length
    return frames


@compiled
def face_spins(motions: Float, changes: Float, faces: Index) -> Float:
    """Return the spins ``(f, 3)`` of `face_frames`, in radians per second.

    Parameters
    ----------
    motions, changes, faces : (V, 7) float64, (V, 6) float64, (f, 3) int64
        Motions of the vertices, their rates, and the corners of faces.
    """
    spins = np.empty((len(faces), 3))
    total, change = np.empty(4), np.empty(4)
    for f in range(len(faces)):
        total[:] = 0.0
        change[:] = 0.0
        for corner in range(3):
            q, s = motions[faces[f, corner]], changes[faces[f, corner]]
            for i in range(4):
                total[i] += q[i]
            change[0] -= 0.5 * (s[0] * q[1] + s[1] * q[2] + s[2] * q[3])
            change[1] += 0.5 * (s[0] * q[0] + s[1] * q[3] - s[2] * q[2])
            change[2] += 0.5 * (s[1] * q[0] + s[2] * q[1] - s[0] * q[3])
            change[3] += 0.5 * (s[2] * q[0] + s[0] * q[2] - s[1] * q[1])
        square = total[0] ** 2 + total[1] ** 2 + total[2] ** 2 + total[3] ** 2
        a, b, c = _vector_of_product(change, total)
        spins[f, 0], spins[f, 1], spins[f, 2] = 2.0 * a / square, 2.0 * b / square, 2.0 * c / square
    return spins


@compiled
def turn_sides(frames: Float, sides: Float, back: bool) -> Float:
    """Turn sides ``(f, 2, 3)`` by the rotations of their faces, or back.

    Parameters
    ----------
    frames, sides : (f, 4), (f, 2, 3) float64
        Rotations, and the sides 01 and 02.
    back : bool
        Whether they are turned back.
    """
    turned = np.empty_like(sides)
    q = np.empty(4)
    for f in range(len(sides)):
        q[0] = frames[f, 0]
        for i in range(1, 4):
            q[i] = -frames[f, i] if back else frames[f, i]
        for k in range(2):
            a, b, c = _turned(q, sides[f, k, 0], sides[f, k, 1], sides[f, k, 2])
            turned[f, k, 0], turned[f, k, 1], turned[f, k, 2] = a, b, c
    return turned


@compiled
def right_hand_side(
    faces: Index, weights: Float, number: Index, sides: Float, x: Float, posed_weight: float, vertices: Index
) -> Float:
    """Return the right-hand side ``(n, 3)`` of the system of `Sides`.

    Parameters
    ----------
    faces : (f, 3) int64
        Faces, as vertices.
    weights : (f, 3) float64
        Weights of their sides 01, 12, 20.
    number : (V,) int64
        Place of every vertex among the unknown ones, -1 for others.
    sides : (f, 2, 3) float64
        What the sides 01 and 02 should be.
    x : (V, 3) float64
        Where vertices are, or are expected.
    posed_weight : float
        Weight of that for unknown vertices.
    vertices : (n,) int64
        The unknown ones.
    """
    right = np.empty((len(vertices), 3))
    for n in range(len(vertices)):
        for i in range(3):
            right[n, i] = posed_weight * x[vertices[n], i]
    for f in range(len(faces)):
        for side in range(3):
            a, b = faces[f, side], faces[f, (side + 1) % 3]
            p, q = number[a], number[b]
            w = weights[f, side]
            for i in range(3):
                if side == 0:
                    s = sides[f, 0, i]
                elif side == 1:
                    s = sides[f, 1, i] - sides[f, 0, i]
                else:
                    s = -sides[f, 1, i]
                if q >= 0:
                    right[q, i] += w * s
                    if p < 0:
                        right[q, i] += w * x[a, i]
                if p >= 0:
                    right[p, i] -= w * s
                    if q < 0:
                        right[p, i] += w * x[b, i]
    return right
