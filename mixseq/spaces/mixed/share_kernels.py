"""The inner loops of `mixseq.spaces.mixed.shares`, compiled."""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.compiled import compiled

EXCHANGES = 4


@compiled
def compare(
    some: Index,
    parts: Index,
    shares: Float,
    turns: Float,
    shifts: Float,
    reference: Float,
    x: Float,
    products: Float,
    apart: Float,
) -> None:
    """Add to sums how far the motions of parts take vertices from where they are in a frame, and from each other.

    Parameters
    ----------
    some : (n,) int64
        Vertices that are looked at.
    parts, shares : (V, k)
        Parts that every vertex may follow, -1 for none, and their shares.
    turns, shifts : (p, 3, 3), (p, 3) float64
        Motions of the parts from the reference frame, in diagonals.
    reference, x : (V, 3) float64
        The reference frame, and the frame.
    products, apart : (n, k, k), (n,) float64
        Changed in place: sums of products of errors, and of squared distances from their mean.
    """
    most = parts.shape[1]
    away = np.empty((most, 3))
    for row in range(len(some)):
        v = some[row]
        count = 0
        while count < most and parts[v, count] >= 0:
            part = parts[v, count]
            for i in range(3):
                place = shifts[part, i] - x[v, i]
                for j in range(3):
                    place += turns[part, i, j] * reference[v, j]
                away[count, i] = place
            count += 1
        for i in range(3):
            mean = 0.0
            for a in range(count):
                mean += shares[v, a] * away[a, i]
            for a in range(count):
                apart[row] += shares[v, a] * (away[a, i] - mean) ** 2
                for b in range(count):
                    products[row, a, b] += away[a, i] * away[b, i]


@compiled
def smooth_and_fit(
    some: Index,
    parts: Index,
    shares: Float,
    products: Float,
    strengths: Float,
    starts: Index,
    others: Index,
    sweeps: int,
) -> None:
    """Find shares ``(V, k)`` that are near the means of neighbours' shares and explain frames; changed in place.

    Parameters
    ----------
    some : (n,) int64
        Vertices with several parts.
    parts : (V, k) int64
        Parts that every vertex may follow, -1 for none.
    shares : (V, k) float64
        Their shares; rows add up to one.
    products, strengths : (n, k, k), (n,) float64
        Quadratic forms of what is not explained, and weights of smoothness.
    starts, others : (V + 1,), (m,) int64
        Neighbours of vertices, as rows of a sparse matrix.
    sweeps : int
        So often all vertices are visited.
    """
    most = parts.shape[1]
    wanted = np.empty(most)
    for _ in range(sweeps):
        for row in range(len(some)):
            v = some[row]
            count = 0
            while count < most and parts[v, count] >= 0:
                wanted[count] = 0.0
                count += 1
            total = 0.0
            for place in range(starts[v], starts[v + 1]):
                u = others[place]
                for b in range(most):
                    if parts[u, b] < 0:
                        break
                    for a in range(count):
                        if parts[v, a] == parts[u, b]:
                            wanted[a] += shares[u, b]
                            total += shares[u, b]
            if total == 0.0:
                continue
            mu = strengths[row]
            for a in range(count):
                wanted[a] /= total
            # Exchanges between two parts keep the sum; each is a parabola.
            for _ in range(EXCHANGES):
                for a in range(count):
                    for b in range(a):
                        slope = mu * (shares[v, a] - wanted[a] - shares[v, b] + wanted[b])
                        for c in range(count):
                            slope += (products[row, a, c] - products[row, b, c]) * shares[v, c]
                        bend = (
                            products[row, a, a] + products[row, b, b] - 2.0 * products[row, a, b] + 2.0 * mu
                        )
                        if bend > 0.0:
                            step = -slope / bend
                            step = min(max(step, -shares[v, a]), shares[v, b])
                            shares[v, a] += step
                            shares[v, b] -= step
