"""Decimate a mesh by half-edge collapses of least quadric error (Garland and Heckbert 1997).

A collapse moves a vertex v onto a neighbour u, so that remaining vertices are vertices of the mesh. Its cost is the
area-weighted squared distance of u from the planes of all faces that v and u stand for, plus `SPACING` times the area
that v stands for times its squared distance to u, which keeps vertices evenly spread where the surface is flat in this
frame. Collapses are refused that change the topology (the link condition), flip a face or make a sliver. Vertices of
edges with three or more faces stay; the border shrinks along itself only.

Libraries (fast-simplification, Open3D) make new vertices of least error, which are known in one frame only.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.topology import Topology

SPACING = 0.02
"""Weight of even spacing against distance from the surface."""

TURN = 0.2
"""Least cosine of the angle by which a face may rotate."""

ROUND = 0.15
"""Least roundness of a face (1: equilateral), unless it was less round before."""


def decimate(points: Float, faces: Index, count: int, keep: Index | None = None) -> tuple[Index, Index]:
    """Decimate a mesh ``(n, 3), (m, 3)`` to `count` vertices, keeping some: vertices ``(c,)``, faces ``(f, 3)``."""
    from mixseq.correspondence.decimation_kernels import collapse

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
