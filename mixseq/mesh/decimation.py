"""Decimate a mesh by half-edge collapses of least quadric error (Garland and Heckbert 1997).

A collapse moves a vertex v onto a neighbour u, so that remaining vertices are vertices of the mesh. Its cost is the
area-weighted squared distance of u from the planes of all faces that v and u stand for, plus `SPACING` times the area
that v stands for times its squared distance to u, which keeps vertices evenly spread where the surface is flat in this
frame. Collapses are refused that change the topology (the link condition), flip a face or make a sliver. Vertices of
edges with three or more faces stay; the border shrinks along itself only.

Libraries (fast-simplification, Open3D) make new vertices of least error, which are known in one frame only.

The faces of a vertex are a chain of corners ``3 f + k``; collapsing joins two chains. A heap holds half-edges
``v -> u`` with the times of the last changes around both ends: older entries are skipped. Refused collapses may be
allowed later, so passes over all half-edges are repeated until one changes nothing.
"""

from __future__ import annotations

import heapq
import math

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Mask


@compiled
def _normal(x: Float, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Return twice the area of a triangle along its normal."""
    p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    return p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0


@compiled
def _square(x: Float, a: int, b: int) -> float:
    """Return the squared distance of two vertices."""
    return float((x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2 + (x[a, 2] - x[b, 2]) ** 2)


@compiled
def _shape(x: Float, a: int, b: int, c: int) -> float:
    """Return the roundness of a triangle: 1 for an equilateral one, 0 for a line."""
    n0, n1, n2 = _normal(x, a, b, c)
    sides = _square(x, a, b) + _square(x, b, c) + _square(x, c, a)
    return 2.0 * math.sqrt(3.0 * (n0 * n0 + n1 * n1 + n2 * n2)) / max(sides, 1e-300)


@compiled
def _cost(x: Float, quadrics: Float, areas: Float, spacing: float, v: int, u: int) -> float:
    """Return the area-weighted squared distances of u from the planes of v, plus `spacing` times that of v."""
    p = np.array([x[u, 0], x[u, 1], x[u, 2], 1.0])
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += p[i] * (quadrics[v, i, j] + quadrics[u, i, j]) * p[j]
    return float(max(total, 0.0) + spacing * areas[v] * _square(x, v, u))


@compiled
def _allowed(
    x: Float, faces: Index, gone: Mask, first: Index, after: Index, border: Mask, v: int, u: int,
    turn: float, round_: float,
) -> bool:  # fmt: skip
    """Return whether v may collapse to u: the topology stays, no face flips or becomes a sliver."""
    shared = 0
    of_v = set()
    of_u = set()
    c = first[u]
    while c >= 0:
        f, k = c // 3, c % 3
        if not gone[f]:
            of_u.add(faces[f, (k + 1) % 3])
            of_u.add(faces[f, (k + 2) % 3])
        c = after[c]
    c = first[v]
    while c >= 0:
        f, k = c // 3, c % 3
        if not gone[f]:
            a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            of_v.add(a)
            of_v.add(b)
            if a == u or b == u:
                shared += 1
                # The third vertex of a face that goes must have another face.
                t = b if a == u else a
                others = 0
                d = first[t]
                while d >= 0:
                    others += not gone[d // 3]
                    d = after[d]
                if others < 2:
                    return False
        c = after[c]
    if shared == 0 or (border[v] and shared != 1):
        return False
    common = 0
    for a in of_v:
        common += a in of_u
    if common != shared:  # the link condition (Dey et al. 1999)
        return False
    c = first[v]
    while c >= 0:
        f, k = c // 3, c % 3
        a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
        if not gone[f] and a != u and b != u:
            if a in of_u and b in of_u:  # u may have a face with both already
                d = first[u]
                while d >= 0:
                    g, l = d // 3, d % 3  # noqa: E741
                    s, t = faces[g, (l + 1) % 3], faces[g, (l + 2) % 3]
                    if not gone[g] and ((s == a and t == b) or (s == b and t == a)):
                        return False
                    d = after[d]
            n0, n1, n2 = _normal(x, v, a, b)
            m0, m1, m2 = _normal(x, u, a, b)
            sizes = math.sqrt((n0 * n0 + n1 * n1 + n2 * n2) * (m0 * m0 + m1 * m1 + m2 * m2))
            if n0 * m0 + n1 * m1 + n2 * m2 < turn * sizes:
                return False
            if _shape(x, u, a, b) < min(round_, _shape(x, v, a, b)):
                return False
        c = after[c]
    return True


@compiled
def collapse(
    x: Float,
    faces: Index,
    quadrics: Float,
    areas: Float,
    locked: Mask,
    border: Mask,
    count: int,
    spacing: float,
    turn: float,
    round_: float,
) -> Mask:
    """Collapse half-edges of faces ``(m, 3)``, in place, until `count` vertices are left; mark removed faces."""
    n, m = len(x), len(faces)
    first, last = np.full(n, -1), np.full(n, -1)
    after = np.full(3 * m, -1)
    gone, alive = np.zeros(m, np.bool_), np.zeros(n, np.bool_)
    stamp = np.zeros(n, np.int64)
    for c in range(3 * m):
        v = faces[c // 3, c % 3]
        if first[v] < 0:
            first[v] = c
        else:
            after[last[v]] = c
        last[v] = c
        alive[v] = True
    left = 0
    for v in range(n):
        left += alive[v]

    changed = True
    while left > count and changed:
        changed = False
        heap = [(0.0, 0, 0, 0, 0) for _ in range(0)]
        for f in range(m):
            if not gone[f]:
                for k in range(3):
                    a, b = faces[f, k], faces[f, (k + 1) % 3]
                    for v, u in ((a, b), (b, a)):
                        if not locked[v] and v != u:
                            heap.append((_cost(x, quadrics, areas, spacing, v, u), v, u, stamp[v], stamp[u]))
        heapq.heapify(heap)
        while left > count and len(heap) > 0:
            _, v, u, old_v, old_u = heapq.heappop(heap)
            if not (alive[v] and alive[u]) or stamp[v] != old_v or stamp[u] != old_u:
                continue
            if not _allowed(x, faces, gone, first, after, border, v, u, turn, round_):
                continue
            c = first[v]
            while c >= 0:
                f, k = c // 3, c % 3
                if faces[f, (k + 1) % 3] == u or faces[f, (k + 2) % 3] == u:
                    gone[f] = True
                else:
                    faces[f, k] = u
                c = after[c]
            after[last[u]] = first[v]
            # Relink the chain without the faces that went.
            c, end, start = first[u], -1, -1
            while c >= 0:
                if not gone[c // 3]:
                    if end < 0:
                        start = c
                    else:
                        after[end] = c
                    end = c
                c = after[c]
            after[end] = -1
            first[u], last[u] = start, end
            quadrics[u] += quadrics[v]
            areas[u] += areas[v]
            alive[v] = False
            stamp[u] += 1
            left -= 1
            changed = True
            c = first[u]
            while c >= 0:
                f, k = c // 3, c % 3
                for w in (faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]):
                    if not locked[u]:
                        heapq.heappush(
                            heap, (_cost(x, quadrics, areas, spacing, u, w), u, w, stamp[u], stamp[w])
                        )
                    if not locked[w]:
                        heapq.heappush(
                            heap, (_cost(x, quadrics, areas, spacing, w, u), w, u, stamp[w], stamp[u])
                        )
                c = after[c]
    return gone


SPACING = 0.02
"""Weight of even spacing against distance from the surface."""

TURN = 0.2
"""Least cosine of the angle by which a face may rotate."""

ROUND = 0.15
"""Least roundness of a face (1: equilateral), unless it was less round before."""


def decimate(points: Float, faces: Index, count: int, keep: Index | None = None) -> tuple[Index, Index]:
    """Decimate a mesh ``(n, 3), (m, 3)`` to `count` vertices, keeping some: vertices ``(c,)``, faces ``(f, 3)``."""
    topology = Topology(faces, len(points))
    locked, border = np.zeros((2, len(points)), dtype=bool)
    border[topology.edges[topology.boundary_edges]] = True
    if keep is not None:
        locked[keep] = True
    locked[topology.edges[topology.non_manifold_edges]] = True
    locked[faces[(faces == np.roll(faces, 1, axis=1)).any(axis=1)]] = True
    x = points - points.mean(axis=0)
    areas, quadrics = _quadrics(x, topology)
    left = np.array(faces, dtype=np.int64)
    gone = collapse(x, left, quadrics, areas, locked, border, count, SPACING, TURN, ROUND)
    kept = np.unique(left[~gone])
    return kept, np.searchsorted(kept, left[~gone])


def _quadrics(x: Float, topology: Topology) -> tuple[Float, Float]:
    """Return vertex areas ``(n,)``, and quadrics ``(n, 4, 4)`` of planes; upright planes keep the border."""
    faces = topology.faces.astype(np.int64)
    a, b, c = (x[corner] for corner in faces.T)
    normals = np.cross(b - a, c - a)
    size = np.linalg.norm(normals, axis=1)
    unit = normals / np.maximum(size, np.finfo(np.float64).tiny)[:, None]
    areas = np.bincount(faces.reshape(-1), np.repeat(size / 6.0, 3), minlength=len(x))

    face_of_edge = np.empty(len(topology.edges), dtype=np.int64)
    face_of_edge[topology.face_edges] = np.arange(len(faces))[:, None]
    ends = topology.edges[topology.boundary_edges]
    along = x[ends[:, 1]] - x[ends[:, 0]]
    upright = np.cross(along, unit[face_of_edge[topology.boundary_edges]])
    length = np.linalg.norm(upright, axis=1)
    upright /= np.maximum(length, np.finfo(np.float64).tiny)[:, None]

    quadrics = np.zeros((len(x), 4, 4))
    for corners, plane, weight in (
        (faces, _planes(unit, a), size / 2.0),
        (ends, _planes(upright, x[ends[:, 0]]), length**2),
    ):
        squares = weight[:, None, None] * plane[:, :, None] * plane[:, None, :]
        for corner in corners.T:
            np.add.at(quadrics, corner, squares)
    return np.asarray(areas), quadrics


def _planes(normals: Float, points: Float) -> Float:
    """Return planes ``(m, 4)`` through points: the normal, and minus the distance from the origin."""
    return np.concatenate([normals, -np.einsum("fi,fi->f", normals, points)[:, None]], axis=1)
