"""Compiled inner loops of segmentations: clusters of rigid motion, growing regions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Single

Table = NDArray[np.int32]


@compiled
def move_elements(
    elements: Index, source: Index, target: Index, corners: Table, weights: Float, rows: Float, tallies: Float
) -> None:
    """Move elements ``(n,)`` between clusters ``(E,)`` (-1: no cluster), and update tallies ``(K, 4, D)`` in place.

    A vertex with weight w (an area in squared diagonals) and row y ``(D,)`` of `Trajectories`, which ends with
    ``h = (rest position, 1)``, adds ``w h y^T`` to the tally. Corners ``(E, 4)`` are padded with V.
    """
    width = rows.shape[1]
    for e in elements:
        k, l = target[e], source[e]  # noqa: E741
        for corner in corners[e]:
            if corner == len(rows):
                continue
            row = rows[corner]
            for i in range(4):
                factor = weights[e] * row[width - 4 + i]
                target_tally = tallies[k, i]
                for j in range(width):
                    target_tally[j] += factor * row[j]
                if l >= 0:
                    source_tally = tallies[l, i]
                    for j in range(width):
                        source_tally[j] -= factor * row[j]


@compiled
def squared_distances(posed: Single, rest: Single, motions: Single, result: Single) -> None:
    """Write mean squared distances ``(V, K)`` of ``(3T, V)`` from rest ``(3, V)`` moved by motions ``(K, 3T, 4)``."""
    chunk = 512  # vertices per chunk, so that inner loops fit into the cache
    sums = np.empty(chunk, dtype=np.float32)
    count = np.float32(len(posed) // 3)
    for start in range(0, posed.shape[1], chunk):
        end = min(start + chunk, posed.shape[1])
        h0, h1, h2 = rest[0, start:end], rest[1, start:end], rest[2, start:end]
        for k in range(len(motions)):
            m = motions[k]
            sums[:] = 0.0
            for i in range(0, len(posed), 3):
                a0, b0, c0, d0 = m[i, 0], m[i, 1], m[i, 2], m[i, 3]
                a1, b1, c1, d1 = m[i + 1, 0], m[i + 1, 1], m[i + 1, 2], m[i + 1, 3]
                a2, b2, c2, d2 = m[i + 2, 0], m[i + 2, 1], m[i + 2, 2], m[i + 2, 3]
                x, y, z = posed[i, start:end], posed[i + 1, start:end], posed[i + 2, start:end]
                for v in range(end - start):
                    p = x[v] - (a0 * h0[v] + b0 * h1[v] + c0 * h2[v] + d0)
                    q = y[v] - (a1 * h0[v] + b1 * h1[v] + c1 * h2[v] + d1)
                    r = z[v] - (a2 * h0[v] + b2 * h1[v] + c2 * h2[v] + d2)
                    sums[v] += p * p + q * q + r * r
            for v in range(end - start):
                result[start + v, k] = sums[v] / count


@compiled
def average_members(values: Single, members: Table, factors: Single, result: Single) -> None:
    """Write the means ``(E, K)`` of values ``(n, K)`` over each element's members ``(E, m)``; padding has value 0."""
    for e in range(len(members)):
        a, b = values[members[e, 0]], values[members[e, 1]]
        c, d = values[members[e, 2]], values[members[e, 3]]
        mean, factor = result[e], factors[e]
        for k in range(len(mean)):  # four members at once, as faces have three neighbours
            mean[k] = (a[k] + b[k] + c[k] + d[k]) * factor
        for i in range(4, members.shape[1]):
            a = values[members[e, i]]
            for k in range(len(mean)):
                mean[k] += a[k] * factor


@compiled
def partition_cells(starts: Table, neighbours: Table, owner: Table) -> Index:
    """Partition vertices into cells of a centre and unassigned neighbours; write owners ``(V,)``, return centres."""
    centres = np.empty(len(owner), dtype=np.int64)
    count = 0
    for v in range(len(owner)):
        if owner[v] < 0:
            owner[v] = count
            for i in range(starts[v], starts[v + 1]):
                if owner[neighbours[i]] < 0:
                    owner[neighbours[i]] = count
            centres[count] = v
            count += 1
    return centres[:count].copy()


@compiled
def kruskal(ends: Index, heights: Float, bottoms: Float, areas: Float) -> tuple[Index, Float, Float]:
    """Join nodes by edges ``(m, 2)`` in order of height; return tree edges with their areas and depths ``(k,)``."""
    parent = np.arange(len(areas))
    tree = np.empty(len(areas), dtype=np.int64)
    area, depth = np.empty(len(areas)), np.empty(len(areas))
    count = 0
    for edge in range(len(ends)):
        a, b = ends[edge]
        while parent[a] != a:
            parent[a] = parent[parent[a]]
            a = parent[a]
        while parent[b] != b:
            parent[b] = parent[parent[b]]
            b = parent[b]
        if a == b:
            continue
        tree[count] = edge
        area[count] = min(areas[a], areas[b])
        depth[count] = heights[edge] - max(bottoms[a], bottoms[b])
        count += 1
        if areas[a] < areas[b]:
            a, b = b, a
        parent[b] = a
        areas[a] += areas[b]
        bottoms[a] = min(bottoms[a], bottoms[b])
    return tree[:count], area[:count], depth[:count]
