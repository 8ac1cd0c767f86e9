"""Compiled inner loop of `mixseq.rigging.weights`: weights and rest position, vertex by vertex."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled

ROUNDS = 60  # of an active set: each adds or removes a bone
GAIN = 1e-12  # smallest decrease of the error by a bone, relative to the position's square
CANDIDATES = 12  # bones tried at a vertex besides its current ones
DAMPING = 1e-14  # share of the diagonal: two bones with the same motion share a weight
HELD = 1e-6  # pull of a rest position towards the one before, relative to one frame


@compiled
def solve(a: Float, b: Float, n: int) -> None:
    """Solve a symmetric positive system by Cholesky factors, in place; b becomes the solution."""
    for j in range(n):
        for i in range(j, n):
            s = a[i, j]
            for k in range(j):
                s -= a[i, k] * a[j, k]
            if i == j:
                a[j, j] = np.sqrt(max(s, 1e-300))
            else:
                a[i, j] = s / a[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= a[i, k] * b[k]
        b[i] = s / a[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for k in range(i + 1, n):
            s -= a[k, i] * b[k]
        b[i] = s / a[i, i]


@compiled
def _on_plane(h: Float, chosen: Index, n: int, scale: float, a: Float, z: Float) -> None:
    """Minimise z^T h z over the chosen bones with sum one, of any sign: h z is constant."""
    for i in range(n):
        for j in range(n):
            # A constant added to h changes nothing where the sum is one, and keeps h regular.
            a[i, j] = h[chosen[i], chosen[j]] + scale
        a[i, i] += DAMPING * scale
        z[i] = 1.0
    solve(a, z, n)
    total = 0.0
    for i in range(n):
        total += z[i]
    for i in range(n):
        z[i] /= total


@compiled
def _descend(h: Float, chosen: Index, n: int, w: Float, scale: float, a: Float, z: Float) -> int:
    """Minimise over the chosen bones with sum one and no weight negative, from feasible w; return the number left."""
    while True:
        _on_plane(h, chosen, n, scale, a, z)
        step, out = 1.0, -1
        for i in range(n):
            if z[i] <= 0.0 and w[i] - z[i] > 0.0 and w[i] / (w[i] - z[i]) < step:
                step, out = w[i] / (w[i] - z[i]), i
        for i in range(n):
            w[i] += step * (z[i] - w[i])
        if out < 0:
            return n
        n -= 1
        for i in range(out, n):
            chosen[i], w[i] = chosen[i + 1], w[i + 1]
        total = 0.0
        for i in range(n):
            w[i] = max(w[i], 0.0)
            total += w[i]
        for i in range(n):
            w[i] /= total


@compiled
def _value(h: Float, chosen: Index, n: int, w: Float) -> float:
    value = 0.0
    for i in range(n):
        for j in range(n):
            value += w[i] * w[j] * h[chosen[i], chosen[j]]
    return value


@compiled
def _active_set(
    h: Float, scale: float, candidates: Index, chosen: Index, w: Float, n: int, most: int, a: Float, z: Float
) -> int:
    """Minimise by Lawson and Hanson's active set on the simplex, from feasible w, with at most `most` bones."""
    for _ in range(ROUNDS):
        if n == most:
            break
        value = _value(h, chosen, n, w)
        best, lowest = -1, value - GAIN * scale
        for b in candidates:
            slope = 0.0
            for i in range(n):
                slope += h[b, chosen[i]] * w[i]
            if slope < lowest:
                known = False
                for i in range(n):
                    known = known or chosen[i] == b
                if not known:
                    best, lowest = b, slope
        if best < 0:
            break
        chosen[n], w[n] = best, 0.0
        n = _descend(h, chosen, n + 1, w, scale, a, z)
    return n


@compiled
def _sparsest(h: Float, scale: float, chosen: Index, w: Float, most: int, n: int, a: Float, z: Float) -> int:
    """Remove the bone of least loss until at most `most` are left."""
    rest, trial, best = np.empty_like(chosen), np.empty_like(w), np.empty_like(w)
    best_chosen = np.empty_like(chosen)
    while n > most:
        lowest, best_n = np.inf, 0
        for out in range(n):
            m = 0
            for i in range(n):
                if i != out:
                    rest[m], trial[m] = chosen[i], w[i]
                    m += 1
            total = 0.0
            for i in range(m):
                total += trial[i]
            for i in range(m):
                trial[i] = trial[i] / total if total > 0.0 else 1.0 / m
            m = _descend(h, rest, m, trial, scale, a, z)
            value = _value(h, rest, m, trial)
            if value < lowest:
                lowest, best_n = value, m
                for i in range(m):
                    best_chosen[i], best[i] = rest[i], trial[i]
        n = best_n
        for i in range(n):
            chosen[i], w[i] = best_chosen[i], best[i]
    return n


@compiled
def _quadratic(p: Float, x: float, y: float, z: float) -> float:
    """Return r^T p r with r = (x, y, z, 1)."""
    value: float = (
        x * (p[0, 0] * x + p[0, 1] * y + p[0, 2] * z + p[0, 3])
        + y * (p[1, 0] * x + p[1, 1] * y + p[1, 2] * z + p[1, 3])
        + z * (p[2, 0] * x + p[2, 1] * y + p[2, 2] * z + p[2, 3])
        + (p[3, 0] * x + p[3, 1] * y + p[3, 2] * z + p[3, 3])
    )
    return value


@compiled
def _candidates(single: Float, influences: Index, weights: Float, candidates: Index) -> int:
    """Choose the bones that alone come nearest, best first, and the current ones; return their number."""
    n = 0
    for _ in range(min(CANDIDATES, len(single))):
        best = -1
        for b in range(len(single)):
            known = False
            for i in range(n):
                known = known or candidates[i] == b
            if not known and (best < 0 or single[b] < single[best]):
                best = b
        candidates[n] = best
        n += 1
    for i in range(len(influences)):
        known = weights[i] <= 0.0
        for j in range(n):
            known = known or candidates[j] == influences[i]
        if not known:
            candidates[n] = influences[i]
            n += 1
    return n


@compiled
def fit_vertices(
    rest: Float,
    squares: Float,
    products: Float,
    seen: Float,
    frames: int,
    free_rest: bool,
    influences: Index,
    weights: Float,
    errors: Float,
) -> None:
    """Fit weights, and rest positions ``(V, 3)`` if `free_rest`, of vertices, in place.

    Sums over the T `frames`: `squares` ``(V,)`` of |x_t|^2, `products` ``(B, B, 4, 4)`` of M_tb^T M_tc, `seen`
    ``(V, B, 4)`` of M_tb^T x_t. Initial and final `influences`, `weights` ``(V, 4)``; squared `errors` ``(V,)``.
    """
    bones, most = products.shape[0], influences.shape[1]
    h, a, z = np.empty((bones, bones)), np.empty((bones, bones)), np.empty(bones)
    chosen, w = np.empty(bones, dtype=np.int64), np.empty(bones)
    kept, old = np.empty(bones, dtype=np.int64), np.empty(bones)
    single, candidates = np.empty(bones), np.empty(bones, dtype=np.int64)
    near, normal, right = np.empty(bones), np.empty((3, 3)), np.empty(3)
    for v in range(len(rest)):
        x, y, q = rest[v, 0], rest[v, 1], rest[v, 2]
        for b in range(bones):
            s = seen[v, b]
            near[b] = s[0] * x + s[1] * y + s[2] * q + s[3]
        for b in range(bones):
            h[b, b] = _quadratic(products[b, b], x, y, q) - 2.0 * near[b] + squares[v]
            single[b] = h[b, b]
        n_candidates = _candidates(single, influences[v], weights[v], candidates)
        for i in range(n_candidates):
            for j in range(i):
                b, c = candidates[i], candidates[j]
                h[b, c] = h[c, b] = _quadratic(products[b, c], x, y, q) - near[b] - near[c] + squares[v]
        scale = max(squares[v], 1e-300)
        chosen[0], w[0] = candidates[0], 1.0
        n = _active_set(h, scale, candidates[:n_candidates], chosen, w, 1, bones, a, z)
        n = _sparsest(h, scale, chosen, w, most, n, a, z)
        # The weights of the round before, fitted again, are a second start: errors never grow.
        m = 0
        for i in range(most):
            if weights[v, i] > 0.0:
                kept[m], old[m] = influences[v, i], weights[v, i]
                m += 1
        if m > 0:
            m = _descend(h, kept, m, old, scale, a, z)
            m = _active_set(h, scale, candidates[:n_candidates], kept, old, m, most, a, z)
            if _value(h, kept, m, old) < _value(h, chosen, n, w):
                n = m
                for i in range(n):
                    chosen[i], w[i] = kept[i], old[i]
        for i in range(most):
            influences[v, i] = chosen[i] if i < n else chosen[0]
            weights[v, i] = w[i] if i < n else 0.0
        errors[v] = max(_value(h, chosen, n, w), 0.0)
        if free_rest:
            # Normal equations of sum_t |A_t r + b_t - x_t|^2, A_t and b_t the weighted means of the motions.
            for i in range(3):
                for j in range(3):
                    a3 = 0.0
                    for k in range(n):
                        for l in range(n):  # noqa: E741
                            a3 += w[k] * w[l] * products[chosen[k], chosen[l], i, j]
                    normal[i, j] = a3
            for i in range(3):
                total = 0.0
                for k in range(n):
                    total += w[k] * seen[v, chosen[k], i]
                    for l in range(n):  # noqa: E741
                        total -= w[k] * w[l] * products[chosen[k], chosen[l], i, 3]
                normal[i, i] += HELD * frames
                right[i] = total + HELD * frames * rest[v, i]
            solve(normal, right, 3)
            for i in range(3):
                rest[v, i] = right[i]
