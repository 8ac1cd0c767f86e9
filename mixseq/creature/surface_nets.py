"""A triangle mesh of an implicit surface: naive surface nets, then relaxation on the surface.

Surface nets (Gibson 1998) put one vertex into every grid cell that the surface crosses, and one quad around every grid
edge that it crosses. The result is closed and oriented; it is manifold if the shape is smooth at the scale of a cell.
Relaxation evens the triangles out on the surface.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array

from mixseq.arrays import Float, Index

Implicit = Callable[[Float], Float]


def polygonise(
    implicit: Implicit, low: Float, high: Float, cell: float, rounds: int = 6
) -> tuple[Float, Index]:
    """Mesh the zero set of a function: implicit ``(..., 3)``; low, high ``(3,)``; result ``(V, 3)``, ``(F, 3)``."""
    shape = np.ceil((high - low) / cell).astype(int) + 1
    origin = (low + high - (shape - 1) * cell) / 2  # centred: a symmetric shape gets a symmetric mesh
    lattice = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    points, quads = surface_nets(implicit(origin + cell * lattice))
    points = relax(origin + cell * points, quads, implicit, rounds)
    faces = triangulate(points, quads)
    return relax(points, faces, implicit, rounds), faces


def surface_nets(values: Float) -> tuple[Float, Index]:
    """Return quads of the zero set of grid values: values ``(X, Y, Z)``; result ``(V, 3)``, ``(Q, 4)``."""
    cuts, rings = [], []
    for axis in range(3):
        u, v = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        count = values.shape[axis] - 1
        start = np.take(values, np.arange(count), axis=axis)
        end = np.take(values, np.arange(1, count + 1), axis=axis)
        crossed = (start < 0) != (end < 0)
        node = np.argwhere(crossed)
        entry, leave = start[crossed], end[crossed]
        # the four cells around the edge, counter-clockwise seen from its end; outwards is from - to +
        ring = np.stack([node, node - u, node - u - v, node - v], axis=1)
        rings.append(np.where((entry < 0)[:, None, None], ring, ring[:, ::-1]))
        cuts.append(node + (entry / (entry - leave))[:, None] * np.eye(3)[axis])
    corners = np.concatenate(rings)
    cells, vertex = np.unique(
        np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), values.shape), return_inverse=True
    )
    quads = vertex.reshape(-1, 4).astype(np.int64)
    points = np.zeros((len(cells), 3))
    np.add.at(points, quads, np.concatenate(cuts)[:, None])
    return points / np.bincount(quads.ravel())[:, None], quads


def triangulate(points: Float, quads: Index) -> Index:
    """Cut each quad ``(Q, 4)`` along its shorter diagonal into triangles ``(2Q, 3)``."""
    a, b, c, d = np.moveaxis(points[quads], 1, 0)
    first = np.linalg.norm(a - c, axis=1) <= np.linalg.norm(b - d, axis=1)
    halves = np.where(first[:, None], quads[:, [0, 1, 2, 0, 2, 3]], quads[:, [1, 2, 3, 1, 3, 0]])
    return halves.reshape(-1, 3)


def neighbour_mean(faces: Index, vertex_count: int) -> csr_array:
    """Return the matrix ``(V, V)`` that averages the values of a vertex's neighbours.

    The mesh must be closed and oriented: then each neighbour follows the vertex in exactly one face.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    degree = np.bincount(start, minlength=vertex_count)
    return csr_array((1 / degree[start], (start, end)), shape=(vertex_count, vertex_count))


def relax(points: Float, faces: Index, implicit: Implicit, rounds: int) -> Float:
    """Slide vertices ``(V, 3)`` towards the mean of their neighbours, along the surface."""
    mean = neighbour_mean(faces, len(points))
    for _ in range(rounds):
        value, slope = _linearise(implicit, points)
        step = 0.6 * (mean @ points - points)
        # the step that is closest to the wish and satisfies value + slope . step = 0
        excess = (value + np.sum(slope * step, axis=1)) / np.sum(slope**2, axis=1)
        points = points + step - excess[:, None] * slope
    return points


def _linearise(implicit: Implicit, points: Float, reach: float = 1e-5) -> tuple[Float, Float]:
    """Return value ``(V,)`` and gradient ``(V, 3)`` of the function, by central differences."""
    ahead, behind = (implicit(points[:, None] + sign * reach * np.eye(3)) for sign in (1, -1))
    return (ahead + behind).mean(axis=1) / 2, (ahead - behind) / (2 * reach)
