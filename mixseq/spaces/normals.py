"""Directions that every face and every vertex has, also where triangles have no area.

All follow a rigid motion of the vertices, but for those of vertices that lie on one line: nothing tells how these are
turned about it.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index

FLAT = 1e-4
"""A triangle has no area if its height is less than this part of its longest side; the value is ours.

Single precision leaves normals of flatter triangles to chance, and linear systems with them ill-conditioned.
"""

CANCELLED = 1e-6
"""A vertex has no normal if those of its faces add up to less than this part of their lengths; the value is ours."""


def unit(vectors: Float) -> Float:
    """Return vectors ``(..., 3)`` of length 1; those without a length are zero."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))


def across(directions: Float) -> Float:
    """Return a unit vector perpendicular to each of the directions ``(n, 3)``, the same one for the opposite."""
    least = np.abs(directions).argmin(axis=1)
    axis = np.eye(3)[least]
    return unit(axis - unit(directions) * np.sum(axis * unit(directions), axis=1, keepdims=True))


def face_normals(x: Float, faces: Index) -> Float:
    """Return normals ``(F, 3)`` of faces, twice as long as their areas; zero for faces without area, see `FLAT`."""
    corners = x[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    longest = np.square(np.roll(corners, -1, axis=1) - corners).sum(axis=2).max(axis=1)
    normals[np.linalg.norm(normals, axis=1) <= FLAT * longest] = 0.0
    return np.asarray(normals)


def vertex_normals(x: Float, faces: Index, edges: Index) -> Float:
    """Return unit normals ``(n, 3)`` of vertices.

    They are the sums of the normals of the faces, weighted by area. A vertex without a normal takes the mean of its
    neighbours'; if no vertex that it is connected to has one it is zero.

    Parameters
    ----------
    x : (n, 3) float64
        Vertices.
    faces : (F, 3) int64
        Triangles.
    edges : (E, 2) int64
        Their edges.
    """
    of_faces = face_normals(x, faces)
    sums = _gathered(len(x), faces.reshape(-1), np.repeat(of_faces, 3, axis=0))
    sizes = np.repeat(np.linalg.norm(of_faces, axis=1), 3)
    whole = np.bincount(faces.reshape(-1), sizes, minlength=len(x))
    normals = np.where((np.linalg.norm(sums, axis=1) > CANCELLED * whole)[:, None], unit(sums), 0.0)
    starts, ends = np.concatenate([edges, edges[:, ::-1]]).T
    missing = np.flatnonzero(~normals.any(axis=1))
    while missing.size:
        into = np.isin(starts, missing)
        found = unit(_gathered(len(x), starts[into], normals[ends[into]]))
        normals[missing] = found[missing]
        still = missing[~found[missing].any(axis=1)]
        if still.size == missing.size:
            break
        missing = still
    return normals


def _gathered(count: int, places: Index, vectors: Float) -> Float:
    """Add vectors ``(m, 3)`` at their places ``(m,)``."""
    sums = [np.bincount(places, column, minlength=count) for column in vectors.T]
    return np.stack(sums, axis=1).astype(np.float64)  # without any places they are integers
