"""Compiled inner loop of `mixseq.geometry.rigid`: the rotations nearest to matrices.

A nearest rotation needs two singular triplets only: with u_1, u_2 and v_1, v_2 those of the two largest singular
values, it is ``u_1 v_1^T + u_2 v_2^T + (u_1 x u_2) (v_1 x v_2)^T``, for any size and sign of the third one. They
come from one-sided Jacobi rotations, which are accurate also for small singular values.
"""

from __future__ import annotations

import math

import numpy as np

from mixseq.arrays import Float
from mixseq.compiled import compiled

SWEEPS = 30
ORTHOGONAL = 1e-15
PAIRS = ((0, 1), (0, 2), (1, 2))


@compiled
def _orthogonalise(a: Float, v: Float) -> None:
    """Rotate the rows of a, and those of v with them, until they are orthogonal."""
    for _ in range(SWEEPS):
        turned = False
        for pair in range(3):
            p, q = PAIRS[pair]
            pp = a[p, 0] * a[p, 0] + a[p, 1] * a[p, 1] + a[p, 2] * a[p, 2]
            qq = a[q, 0] * a[q, 0] + a[q, 1] * a[q, 1] + a[q, 2] * a[q, 2]
            pq = a[p, 0] * a[q, 0] + a[p, 1] * a[q, 1] + a[p, 2] * a[q, 2]
            if pq == 0.0 or abs(pq) <= ORTHOGONAL * math.sqrt(pp * qq):
                continue
            turned = True
            zeta = (qq - pp) / (2.0 * pq)
            t = math.copysign(1.0 / (abs(zeta) + math.sqrt(1.0 + zeta * zeta)), zeta)
            c = 1.0 / math.sqrt(1.0 + t * t)
            s = c * t
            for i in range(3):
                x, y = a[p, i], a[q, i]
                a[p, i], a[q, i] = c * x - s * y, s * x + c * y
                x, y = v[p, i], v[q, i]
                v[p, i], v[q, i] = c * x - s * y, s * x + c * y
        if not turned:
            return


@compiled
def nearest(matrices: Float, held: float) -> Float:
    """Return the rotations ``(N, 3, 3)`` nearest to matrices."""
    result = np.empty_like(matrices)
    a, v = np.empty((3, 3)), np.empty((3, 3))
    sizes, u, w = np.empty(3), np.empty(3), np.empty(3)
    for n in range(len(matrices)):
        scale = 0.0
        for i in range(3):
            for j in range(3):
                scale += abs(matrices[n, i, j])
        bias = 0.0
        for _ in range(2):
            for i in range(3):  # columns of a and v are the rows here
                for j in range(3):
                    a[j, i] = matrices[n, i, j] / scale if scale > 0.0 else 0.0
                    v[j, i] = 1.0 if i == j else 0.0
            for i in range(3):
                a[i, i] += bias
            _orthogonalise(a, v)
            for p in range(3):
                sizes[p] = math.sqrt(a[p, 0] * a[p, 0] + a[p, 1] * a[p, 1] + a[p, 2] * a[p, 2])
            first = 0
            for p in range(1, 3):
                if sizes[p] > sizes[first]:
                    first = p
            second = (first + 1) % 3
            if sizes[(first + 2) % 3] > sizes[second]:
                second = (first + 2) % 3
            if bias > 0.0 or sizes[second] > held * sizes[first]:
                break
            bias = 1e-6 * sizes[first] if sizes[first] > 0.0 else 1.0
        for i in range(3):
            u[i] = a[first, i] / sizes[first] if sizes[first] > 0.0 else v[first, i]
            w[i] = a[second, i] / sizes[second] if sizes[second] > 0.0 else v[second, i]
        size = 0.0
        for _ in range(2):
            dot = w[0] * u[0] + w[1] * u[1] + w[2] * u[2]
            for i in range(3):
                w[i] -= dot * u[i]
            size = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
            if size > 0.5:
                break
            for i in range(3):  # a second value of zero: any direction across the first
                w[i] = 0.0
            w[0 if abs(u[0]) < 0.6 else 1] = 1.0
        for i in range(3):
            w[i] /= size
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            across = u[j] * w[k] - u[k] * w[j]
            for m in range(3):
                l, o = (m + 1) % 3, (m + 2) % 3  # noqa: E741
                turned_across = v[first, l] * v[second, o] - v[first, o] * v[second, l]
                result[n, i, m] = u[i] * v[first, m] + w[i] * v[second, m] + across * turned_across
    return result
