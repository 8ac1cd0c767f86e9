"""Normals of corners, with authored hard edges.

Normals are computed for every frame: the normal ``n_g`` of a group ``g`` of corners sums over its corners ``c`` the
normals of their polygons, weighted by the polygons' areas,

    n_g = normalised sum over c in g of m_p(c),    m_p = 1/2 sum over the polygon's corners of x_i × x_(i+1),

where ``m_p`` is the vector area of polygon ``p``, of an n-gon too, planar or not. Groups of corners with a common
normal belong to the surface (`mixseq.surface.Surface.hard_edges`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray, IntArray
from mixseq.polygons import Polygons


def vector_areas(points: FloatArray, polygons: Polygons) -> NDArray[np.float64]:
    """Return the vector areas ``(T, P, 3)`` of the polygons in frames of points ``(T, V, 3)``."""
    starts = np.cumsum(polygons.counts) - polygons.counts
    first = np.repeat(starts, polygons.counts)
    step = np.arange(polygons.indices.size) - first
    following = first + (step + 1) % np.repeat(polygons.counts, polygons.counts)
    # About the polygon's first corner, not the origin: far from it the products would cancel.
    centre = points[:, polygons.indices[first]].astype(np.float64)
    here = points[:, polygons.indices] - centre
    there = points[:, polygons.indices[following]] - centre
    return np.add.reduceat(np.cross(here, there), starts, axis=1) / 2


def shared_normals(
    points: FloatArray, polygons: Polygons, groups: IntArray | None = None
) -> NDArray[np.float32]:
    """Return one normal ``(T, G, 3)`` per group ``(sum of counts,)`` of corners: points ``(T, V, 3)``."""
    of_corner = polygons.indices if groups is None else groups
    count = points.shape[1] if groups is None else int(of_corner.max(initial=-1)) + 1
    areas = (_of_triangles if polygons.only_triangles else vector_areas)(points, polygons)
    of_polygon = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    sums = np.zeros((len(points), count, 3))
    for frame, total in enumerate(sums):
        for axis in range(3):
            total[:, axis] = np.bincount(of_corner, areas[frame, of_polygon, axis], minlength=count)
    lengths = np.linalg.norm(sums, axis=2, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(lengths > 0, sums / lengths, up).astype(np.float32)


def _of_triangles(points: FloatArray, polygons: Polygons) -> NDArray[np.float64]:
    """Return `vector_areas` of triangles, except for the signs of zeros: of three products two are zero."""
    a, b, c = polygons.triangles.T
    origin = points[:, a].astype(np.float64)
    return np.asarray(np.cross(points[:, b] - origin, points[:, c] - origin) / 2)


def hard_edges_of_normals(polygons: Polygons, normals: FloatArray) -> NDArray[np.int32] | None:
    """Group corners of each vertex by equal authored normals ``(sum of counts, 3)``: groups ``(sum of counts,)``."""
    # To three digits: exporters recompute normals of one vertex face by face.
    keys = np.column_stack([polygons.indices, np.rint(normals * 1e3).astype(np.int64)])
    groups = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    if groups.max(initial=-1) + 1 == np.unique(polygons.indices).size:
        return None
    return groups.astype(np.int32)
