r"""Edge lengths and signed dihedral angles, their gradients, and angles unwrapped along time.

For a hinge with edge ``ab`` and opposite vertices ``c`` (first face) and ``d`` (second face), with
``e = b - a``, ``n1 = e x (c - a)`` and ``n2 = (d - a) x e``,

.. math:: \theta = \mathrm{atan2}\bigl((n_1 \times n_2) \cdot e / |e|,\; n_1 \cdot n_2\bigr)

in radians in (-pi, pi]: 0 where flat, positive where the surface is convex under the orientation of the first
face (a -> b -> c counter-clockwise seen from outside).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, IntArray

_TURN = 2.0 * np.pi

SHORTEST = 1e-6
"""Least length of an edge, relative to its typical length."""

NO_LENGTH = 1e-12
"""Length in diagonals below which edges have no direction, and no weight."""


def edge_lengths(points: FloatArray, edges: IntArray) -> Float:
    """Return the lengths ``(..., E)`` of edges ``(E, 2)`` for points ``(..., V, 3)``."""
    difference = points[..., edges[:, 1], :] - points[..., edges[:, 0], :]
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", difference, difference)), dtype=np.float64)


def length_weights(typical: Float) -> Float:
    """Return the weights ``(e,)`` of lengths: inverse typical ones, 0 below `NO_LENGTH`."""
    return np.divide(1.0, typical, out=np.zeros_like(typical), where=typical > NO_LENGTH)


def sound_lengths(lengths: Float, weights: Float) -> Float:
    """Raise lengths to `SHORTEST`: overshooting curves can have lengths of zero or less."""
    shortest = np.divide(SHORTEST, weights, out=np.zeros_like(weights), where=weights > 0)
    return np.maximum(lengths, shortest)


def dihedral_angles(points: FloatArray, hinges: IntArray) -> Float:
    """Return the signed dihedral angles ``(..., H)`` of hinges ``(H, 4)`` in radians; 0 at degenerate faces.

    Examples
    --------
    A roof whose sides fall away from the ridge ab is convex:

    >>> roof = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, -1], [0, -1, -1]])
    >>> np.degrees(dihedral_angles(roof, np.array([[0, 1, 2, 3]]))).round(9).tolist()
    [90.0]
    """
    a, b, c, d = (points[..., hinges[:, i], :] for i in range(4))
    e = b - a
    n1, n2 = np.cross(e, c - a), np.cross(d - a, e)
    length = np.sqrt(np.einsum("...i,...i->...", e, e))
    sine = np.einsum("...i,...i->...", np.cross(n1, n2), e)
    cosine = np.einsum("...i,...i->...", n1, n2)
    # Scaling both by |e| instead of dividing keeps an edge of length zero finite.
    return np.asarray(np.arctan2(sine, cosine * length), dtype=np.float64)


def flat_faces(points: FloatArray, faces: IntArray, height: float) -> NDArray[np.bool_]:
    """Mark the faces ``(..., F)`` that are lower than `height` times their longest side."""
    corners = points[..., faces, :]
    sides = np.roll(corners, -1, axis=-2) - corners
    longest = np.einsum("...ki,...ki->...k", sides, sides).max(axis=-1)
    double_area = np.linalg.norm(np.cross(sides[..., 0, :], sides[..., 1, :]), axis=-1)
    return np.asarray(double_area <= height * longest)


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


def wrap(angles: FloatArray) -> Float:
    """Map angles to (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angles, _TURN), dtype=np.float64)


def unwrap_angles(angles: FloatArray, reference: FloatArray | None = None) -> Float:
    """Add whole turns to angles ``(T, H)``: each is within half a turn of the frame before, or of the reference."""
    result = np.array(angles, dtype=np.float64)
    previous = reference
    for frame in result:  # one by one, so that a frame is the same in any block
        if previous is not None:
            frame -= _TURN * np.round((frame - previous) / _TURN)
        previous = frame
    return result
