"""Decimate a mesh by half-edge collapses of least quadric error (Garland and Heckbert 1997).

A collapse moves a vertex v onto a neighbour u, so that the remaining vertices are a subset of the original ones. The
cost of a collapse is the area-weighted squared distance of u from the planes of all faces that were merged into v and
u, plus `SPACING_WEIGHT` times the area of v times the squared distance of v to u. The second term keeps vertices evenly
spread where the surface is flat in this frame. Collapses that change the topology (the link condition), flip a face or
make a sliver are refused. Vertices of non-manifold edges are kept; border vertices only move along the border.

The faces of a vertex are a linked list of corners ``3 f + k``; a collapse joins two lists. A heap holds half-edges
``v -> u`` with the versions of both ends, and outdated entries are skipped. Refused collapses may become valid later,
so passes over all half-edges are repeated until a pass changes nothing.
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
    """Return the normal of a triangle, with a length of twice its area."""
    p0, p1, p2 = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    q0, q1, q2 = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    return p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0


@compiled
def _squared_length(x: Float, a: int, b: int) -> float:
    """Return the squared distance of two vertices."""
    return float((x[a, 0] - x[b, 0]) ** 2 + (x[a, 1] - x[b, 1]) ** 2 + (x[a, 2] - x[b, 2]) ** 2)


@compiled
def _roundness(x: Float, a: int, b: int, c: int) -> float:
    """Return the roundness of a triangle: 1 for an equilateral one, 0 for a line."""
    n0, n1, n2 = _normal(x, a, b, c)
    sides = _squared_length(x, a, b) + _squared_length(x, b, c) + _squared_length(x, c, a)
    return 2.0 * math.sqrt(3.0 * (n0 * n0 + n1 * n1 + n2 * n2)) / max(sides, 1e-300)


@compiled
def _cost(x: Float, quadrics: Float, areas: Float, spacing: float, v: int, u: int) -> float:
    """Return the cost of moving v onto u: area-weighted squared distances from planes, plus the spacing term."""
    p = np.array([x[u, 0], x[u, 1], x[u, 2], 1.0])
    total = 0.0
    for i in range(4):
        for j in range(4):
            total += p[i] * (quadrics[v, i, j] + quadrics[u, i, j]) * p[j]
    return float(max(total, 0.0) + spacing * areas[v] * _squared_length(x, v, u))


@compiled
def _is_valid_collapse(
    x: Float, faces: Index, removed: Mask, first: Index, following: Index, border: Mask, v: int, u: int,
    min_cosine: float, min_roundness: float,
) -> bool:  # fmt: skip
    """Return whether v may collapse onto u: the topology is kept, and no face flips or becomes a sliver."""
    shared = 0
    v_neighbours = set()
    u_neighbours = set()
    c = first[u]
    while c >= 0:
        f, k = c // 3, c % 3
        if not removed[f]:
            u_neighbours.add(faces[f, (k + 1) % 3])
            u_neighbours.add(faces[f, (k + 2) % 3])
        c = following[c]
    c = first[v]
    while c >= 0:
        f, k = c // 3, c % 3
        if not removed[f]:
            a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
            v_neighbours.add(a)
            v_neighbours.add(b)
            if a == u or b == u:
                shared += 1
                # The third vertex of a removed face must have another face.
                t = b if a == u else a
                remaining = 0
                d = first[t]
                while d >= 0:
                    remaining += not removed[d // 3]
                    d = following[d]
                if remaining < 2:
                    return False
        c = following[c]
    if shared == 0 or (border[v] and shared != 1):
        return False
    common = 0
    for a in v_neighbours:
        common += a in u_neighbours
    if common != shared:  # the link condition (Dey et al. 1999)
        return False
    c = first[v]
    while c >= 0:
        f, k = c // 3, c % 3
        a, b = faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]
        if not removed[f] and a != u and b != u:
            if a in u_neighbours and b in u_neighbours:  # u may already have a face with a and b
                d = first[u]
                while d >= 0:
                    g, l = d // 3, d % 3  # noqa: E741
                    s, t = faces[g, (l + 1) % 3], faces[g, (l + 2) % 3]
                    if not removed[g] and ((s == a and t == b) or (s == b and t == a)):
                        return False
                    d = following[d]
            n0, n1, n2 = _normal(x, v, a, b)
            m0, m1, m2 = _normal(x, u, a, b)
            sizes = math.sqrt((n0 * n0 + n1 * n1 + n2 * n2) * (m0 * m0 + m1 * m1 + m2 * m2))
            if n0 * m0 + n1 * m1 + n2 * m2 < min_cosine * sizes:
                return False
            if _roundness(x, u, a, b) < min(min_roundness, _roundness(x, v, a, b)):
                return False
        c = following[c]
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
    min_cosine: float,
    min_roundness: float,
) -> Mask:
    """Collapse half-edges of faces ``(m, 3)``, in place, until `count` vertices remain; return the removed faces."""
    n, m = len(x), len(faces)
    first, last = np.full(n, -1), np.full(n, -1)
    following = np.full(3 * m, -1)
    removed, alive = np.zeros(m, np.bool_), np.zeros(n, np.bool_)
    version = np.zeros(n, np.int64)
    for c in range(3 * m):
        v = faces[c // 3, c % 3]
        if first[v] < 0:
            first[v] = c
        else:
            following[last[v]] = c
        last[v] = c
        alive[v] = True
    remaining = 0
    for v in range(n):
        remaining += alive[v]

    changed = True
    while remaining > count and changed:
        changed = False
        heap = [(0.0, 0, 0, 0, 0) for _ in range(0)]
        for f in range(m):
            if not removed[f]:
                for k in range(3):
                    a, b = faces[f, k], faces[f, (k + 1) % 3]
                    for v, u in ((a, b), (b, a)):
                        if not locked[v] and v != u:
                            heap.append((_cost(x, quadrics, areas, spacing, v, u), v, u, version[v], version[u]))
        heapq.heapify(heap)
        while remaining > count and len(heap) > 0:
            _, v, u, v_version, u_version = heapq.heappop(heap)
            if not (alive[v] and alive[u]) or version[v] != v_version or version[u] != u_version:
                continue
            if not _is_valid_collapse(x, faces, removed, first, following, border, v, u, min_cosine, min_roundness):
                continue
            c = first[v]
            while c >= 0:
                f, k = c // 3, c % 3
                if faces[f, (k + 1) % 3] == u or faces[f, (k + 2) % 3] == u:
                    removed[f] = True
                else:
                    faces[f, k] = u
                c = following[c]
            following[last[u]] = first[v]
            # Relink the corner list of u without the removed faces.
            c, end, start = first[u], -1, -1
            while c >= 0:
                if not removed[c // 3]:
                    if end < 0:
                        start = c
                    else:
                        following[end] = c
                    end = c
                c = following[c]
            following[end] = -1
            first[u], last[u] = start, end
            quadrics[u] += quadrics[v]
            areas[u] += areas[v]
            alive[v] = False
            version[u] += 1
            remaining -= 1
            changed = True
            c = first[u]
            while c >= 0:
                f, k = c // 3, c % 3
                for w in (faces[f, (k + 1) % 3], faces[f, (k + 2) % 3]):
                    if not locked[u]:
                        heapq.heappush(heap, (_cost(x, quadrics, areas, spacing, u, w), u, w, version[u], version[w]))
                    if not locked[w]:
                        heapq.heappush(heap, (_cost(x, quadrics, areas, spacing, w, u), w, u, version[w], version[u]))
                c = following[c]
    return removed


SPACING_WEIGHT = 0.02  # weight of even spacing relative to distance from the surface
MIN_ROTATION_COSINE = 0.2  # least cosine of the angle by which a collapse rotates a face normal
MIN_ROUNDNESS = 0.15  # least `_roundness` of a face after a collapse, unless the face was less round before


def decimate(points: Float, faces: Index, count: int, keep: Index | None = None) -> tuple[Index, Index]:
    """Decimate a mesh ``(n, 3), (m, 3)`` to `count` vertices, with `keep`: vertices ``(c,)`` and faces ``(f, 3)``."""
    topology = Topology(faces, len(points))
    locked, border = np.zeros((2, len(points)), dtype=bool)
    border[topology.edges[topology.boundary_edges]] = True
    if keep is not None:
        locked[keep] = True
    locked[topology.edges[topology.non_manifold_edges]] = True
    locked[faces[(faces == np.roll(faces, 1, axis=1)).any(axis=1)]] = True
    x = points - points.mean(axis=0)
    areas, quadrics = _quadrics(x, topology)
    collapsed = np.array(faces, dtype=np.int64)
    settings = SPACING_WEIGHT, MIN_ROTATION_COSINE, MIN_ROUNDNESS
    removed = collapse(x, collapsed, quadrics, areas, locked, border, count, *settings)
    vertices = np.unique(collapsed[~removed])
    return vertices, np.searchsorted(vertices, collapsed[~removed])


def _quadrics(x: Float, topology: Topology) -> tuple[Float, Float]:
    """Return vertex areas ``(n,)`` and quadrics ``(n, 4, 4)`` of face planes and of planes upright at the border."""
    faces = topology.faces.astype(np.int64)
    a, b, c = (x[corner] for corner in faces.T)
    normals = np.cross(b - a, c - a)
    double_areas = np.linalg.norm(normals, axis=1)
    unit_normals = normals / np.maximum(double_areas, np.finfo(np.float64).tiny)[:, None]
    areas = np.bincount(faces.reshape(-1), np.repeat(double_areas / 6.0, 3), minlength=len(x))

    face_of_edge = np.empty(len(topology.edges), dtype=np.int64)
    face_of_edge[topology.face_edges] = np.arange(len(faces))[:, None]
    ends = topology.edges[topology.boundary_edges]
    along = x[ends[:, 1]] - x[ends[:, 0]]
    upright = np.cross(along, unit_normals[face_of_edge[topology.boundary_edges]])
    lengths = np.linalg.norm(upright, axis=1)
    upright /= np.maximum(lengths, np.finfo(np.float64).tiny)[:, None]

    quadrics = np.zeros((len(x), 4, 4))
    for corners, plane, weight in (
        (faces, _planes(unit_normals, a), double_areas / 2.0),
        (ends, _planes(upright, x[ends[:, 0]]), lengths**2),
    ):
        squares = weight[:, None, None] * plane[:, :, None] * plane[:, None, :]
        for corner in corners.T:
            np.add.at(quadrics, corner, squares)
    return np.asarray(areas), quadrics


def _planes(normals: Float, points: Float) -> Float:
    """Return planes ``(m, 4)`` through points: each normal, and the negative distance from the origin along it."""
    return np.concatenate([normals, -np.einsum("fi,fi->f", normals, points)[:, None]], axis=1)
