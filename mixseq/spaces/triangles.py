r"""Triangles as invertible matrices: two sides, and a fourth vertex along the normal (Sumner and Popović 2004).

.. math:: D = [e_1, e_2, n / \sqrt{|n|}], \qquad n = e_1 \times e_2 .

The root makes the fourth vertex grow as the triangle does. Triangles without area, for which the papers have nothing,
get a fourth vertex too, and stand-ins with area where an inverse is needed; both are ours.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.spaces.normals import FLAT, across, face_normals, unit, vertex_normals


def completed(rows: Float, faces: Index, edges: Index) -> Float:
    """Return matrices D ``(F, 3, 3)`` of faces: sides 01 and 02, and fourth vertices, in columns.

    The fourth vertex of a face without area is across its longest side, as the normals of its vertices say.

    Parameters
    ----------
    rows : (n, 3) float64
        Vertices.
    faces : (F, 3) int64
        Triangles.
    edges : (E, 2) int64
        Their edges.
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
