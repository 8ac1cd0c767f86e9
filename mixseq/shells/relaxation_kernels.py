"""The inner loops of `mixseq.shells.shell`, compiled: the energy with its gradient, sides of faces."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled
from mixseq.shells.hinge_kernels import length, length_gradient, misfit


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

    Angles that are wanted are told by their cosines and sines, turns ``(H, 2)``. The gradient is written to ``gradient
    (V, 3)``; where the square of a normal is less than ``smallest (H, 2)`` it is taken to be that.
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
    """Return how little hinges are off, ``cos^2`` of half of it: 1 where they are not, 0 by half a turn ``(H,)``.

    What they should have is told by cosines and sines ``(H, 2)``.
    """
    near, g = np.empty(len(hinges)), np.empty((4, 3))
    for k in range(len(hinges)):
        a, b, c, d = hinges[k, 0], hinges[k, 1], hinges[k, 2], hinges[k, 3]
        near[k] = 1.0 - 0.5 * misfit(x, a, b, c, d, turns[k, 0], turns[k, 1], 0.0, 1.0, 1.0, g)
    return near


@compiled
def gathered(faces: Index, weights: Float, sides: Float, right: Float) -> None:
    """Add the weighted ``(F, 3)`` sides 01, 12, 20 ``(F, 3, 3)`` of faces to the right-hand side ``(V, 3)``."""
    for f in range(len(faces)):
        for k in range(3):
            a, b, w = faces[f, k], faces[f, (k + 1) % 3], weights[f, k]
            for i in range(3):
                step = w * sides[f, k, i]
                right[b, i] += step
                right[a, i] -= step


@compiled
def turned_sides(frames: Float, flat: Float) -> Float:
    """Return the sides ``(F, 3, 3)`` of flat triangles ``(F, 3, 2)`` with frames ``(F, 4)``."""
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
