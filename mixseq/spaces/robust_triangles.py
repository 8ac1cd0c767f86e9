r"""Normals of faces and vertices, and triangles as invertible matrices, also where triangles have no area.

All follow a rigid motion of the vertices, but for normals of vertices that lie on one line: nothing tells how these are
turned about it. As matrices triangles are two sides, and a fourth vertex along the normal (Sumner and Popović 2004),

.. math:: D = [e_1, e_2, n / \sqrt{|n|}], \qquad n = e_1 \times e_2 .

The root makes the fourth vertex grow as the triangle does. Triangles without area, for which the papers have nothing,
get a fourth vertex too, and stand-ins with area where an inverse is needed; both are ours.
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

    Shapes: faces ``(F, 3)``; edges ``(E, 2)``.
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


def completed(rows: Float, faces: Index, edges: Index) -> Float:
    """Return matrices D ``(F, 3, 3)`` of faces: sides 01 and 02, and fourth vertices, in columns.

    The fourth vertex of a face without area is across its longest side, as the normals of its vertices say.

    Shapes: rows ``(n, 3)``; faces ``(F, 3)``; edges ``(E, 2)``.
    """
    corners = rows[faces]
    normals = face_normals(rows, faces)
    areas = np.linalg.norm(normals, axis=1)
    flat = np.flatnonzero(areas == 0)
    if flat.size:
        _, longest, length = _longest(corners[flat])
        around = vertex_normals(rows, faces, edges)[faces[flat]].sum(axis=1)
        upright = around - longest * np.sum(around * longest, axis=1, keepdims=True)
        has = np.linalg.norm(upright, axis=1) > FLAT * np.linalg.norm(around, axis=1)
        normals[flat] = np.where(has[:, None], unit(upright), across(longest))
        areas[flat] = FLAT * length**2
    fourth = unit(normals) * np.sqrt(areas)[:, None]
    return np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], fourth], axis=2)


def with_area(triangles: Float) -> Float:
    """Put equilateral triangles on the longest sides of those that have no area, with the same fourth direction.

    Triangles are given as D ``(F, 3, 3)``. Those that are points get the size that the others have on average.
    """
    first, second, fourth = (triangles[:, :, column] for column in range(3))
    corners = np.stack([np.zeros_like(first), first, second], axis=1)
    normals = face_normals(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
    flat = np.flatnonzero(~normals.any(axis=1))
    longest, along, length = _longest(corners)
    usual = length[length > 0].mean() if length.any() else 1.0
    side = np.where(length > 0, length, usual)[flat, None]
    along = np.where(along[flat].any(axis=1, keepdims=True), along[flat], [1.0, 0.0, 0.0])
    upright = np.where(fourth[flat].any(axis=1, keepdims=True), unit(fourth[flat]), across(along))

    chosen = np.arange(len(flat))
    corners = np.zeros((len(flat), 3, 3))
    corners[chosen, (longest[flat] + 1) % 3] = side * along
    corners[chosen, (longest[flat] + 2) % 3] = side * (along / 2 + np.cross(upright, along) * np.sqrt(0.75))
    result = triangles.copy()
    result[flat, :, 0] = corners[:, 1] - corners[:, 0]
    result[flat, :, 1] = corners[:, 2] - corners[:, 0]
    result[flat, :, 2] = upright * side * np.sqrt(np.sqrt(0.75))
    return result


def _longest(corners: Float) -> tuple[Index, Float, Float]:
    """Return the longest sides ``(F,)`` of triangles ``(F, 3, 3)``, directions ``(F, 3)`` and lengths ``(F,)``."""
    sides = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(sides, axis=2)
    longest = lengths.argmax(axis=1)
    chosen = np.arange(len(corners)), longest
    return longest, unit(sides[chosen]), lengths[chosen]
