"""Derivatives of lengths, angles and residuals in NumPy, against which the compiled loops are tested."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from mixseq.shells.fitting import ShellProblem
from mixseq.types import Float, FloatArray, IntArray


def length_gradients(points: FloatArray, edges: IntArray) -> Float:
    """Return the derivative ``(E, 3)`` of each length by its second vertex (by its first: the negative)."""
    difference = points[edges[:, 1]] - points[edges[:, 0]]
    length = np.sqrt(np.einsum("ei,ei->e", difference, difference))
    return np.asarray(difference / np.maximum(length, np.finfo(np.float64).tiny)[:, None], dtype=np.float64)


def dihedral_gradients(points: FloatArray, hinges: IntArray) -> Float:
    """Return the derivatives ``(H, 4, 3)`` of each dihedral angle by its vertices a, b, c, d.

    With ``e = b - a`` and ``tc = (c - a).e / |e|^2`` (``td`` likewise) the gradient of the angle is
    ``gc = -|e| n1 / |n1|^2``, ``gd = -|e| n2 / |n2|^2``, ``ga = -(1 - tc) gc - (1 - td) gd``,
    ``gb = -tc gc - td gd``.
    """
    a, b, c, d = (points[hinges[:, i]] for i in range(4))
    e = b - a
    n1, n2 = np.cross(e, c - a), np.cross(d - a, e)
    tiny = np.finfo(np.float64).tiny
    ee = np.maximum(np.einsum("hi,hi->h", e, e), tiny)
    length = np.sqrt(ee)
    gc = -(length / np.maximum(np.einsum("hi,hi->h", n1, n1), tiny))[:, None] * n1
    gd = -(length / np.maximum(np.einsum("hi,hi->h", n2, n2), tiny))[:, None] * n2
    tc = (np.einsum("hi,hi->h", c - a, e) / ee)[:, None]
    td = (np.einsum("hi,hi->h", d - a, e) / ee)[:, None]
    ga = -(1.0 - tc) * gc - (1.0 - td) * gd
    gb = -tc * gc - td * gd
    return np.asarray(np.stack([ga, gb, gc, gd], axis=1), dtype=np.float64)


def jacobian(problem: ShellProblem, points: Float) -> sparse.csr_array:
    """Derivatives of all residuals but that of the volume by the free vertices, ``(residuals, 3 free)``."""
    edges, hinges = problem.patch.equations.edges, problem.patch.equations.hinges
    length = length_gradients(points, edges) * problem.length_weights[:, None]
    stretch = np.stack([-length, length], axis=1)
    bend = problem.bending * dihedral_gradients(points, hinges)
    row = np.concatenate([np.repeat(np.arange(len(edges)), 6), len(edges) + np.repeat(np.arange(len(hinges)), 12)])
    place = problem.patch.free_index[np.concatenate([edges.reshape(-1), hinges.reshape(-1)])]
    column = (3 * place[:, None] + np.arange(3)).reshape(-1)
    value = np.concatenate([stretch.reshape(-1), bend.reshape(-1)])
    inside = np.repeat(place >= 0, 3)
    size = (len(edges) + len(hinges), 3 * len(problem.patch.free_ids))
    return sparse.coo_array((value[inside], (row[inside], column[inside])), shape=size).tocsr()
