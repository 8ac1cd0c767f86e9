r"""Deviation of a pose from a pose at rest: a number at every vertex, shown by colours.

- **strain**: mean over the edges of a vertex of :math:`|l / \bar l - 1|`, with :math:`\bar l` their lengths at rest.
- **curvature** (its change): mean over the hinges of a vertex of :math:`|\theta - \bar\theta|` in degrees, with
  :math:`\bar\theta` their dihedral angles at rest and the difference in :math:`(-\pi, \pi]`, the shorter way round. A
  hinge belongs to the two vertices of its edge, where the surface bends.
- **error**: distance from the same vertex of an original, :math:`|a_v - b_v| / d`, in diagonals.

Strain and curvature are invariant to rigid motions; uniform scaling by s has the strain :math:`|s - 1|` everywhere. On
a finer mesh a bend is shared by more hinges, so curvatures compare poses of one mesh only.

Edges of length zero and hinges of flat faces count as unchanged; vertices without edges or hinges have 0.

The angles are those of `mixseq.geometry.lengths_angles`, from normals that are computed once for every face: with
:math:`n_f = (b - a) \times (c - a)`, the hinge of edge ab and faces f and g has :math:`n_1 = n_f`, and
:math:`n_2 = n_g`, or :math:`-n_g` where g has the other orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.geometry.lengths_angles import edge_lengths, wrap
from mixseq.topology import Topology

FLAT = 1e-6
"""Height of a face relative to its longest side below which its normal is undefined; as in `mixseq.metrics`."""

SHARE = 0.99
"""Fraction of vertices within the colour scale, so that a single sliver does not darken all others."""


@dataclass(frozen=True, eq=False)
class Strain:
    """Strain against a pose."""

    edges: IntArray  # (E, 2) edges of the mesh
    lengths: Float  # (E,) their lengths in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Strain:
        """Make the measure against a pose ``(V, 3)`` of triangles ``(F, 3)``."""
        edges = Topology(faces, len(points)).edges
        return cls(edges, edge_lengths(np.asarray(points, dtype=np.float64), edges))

    def __call__(self, points: FloatArray) -> Float:
        """Return strains ``(V,)`` of points ``(V, 3)``."""
        now = edge_lengths(np.asarray(points, dtype=np.float64), self.edges)
        known = self.lengths > 0
        strain = np.abs(np.divide(now, self.lengths, out=np.ones_like(now), where=known) - 1)
        return _means(strain, self.edges, len(points))


@dataclass(frozen=True, eq=False)
class Curvature:
    """Change of dihedral angles against a pose."""

    faces: IntArray  # (F, 3) triangles of the mesh
    hinges: IntArray  # (H, 2) the vertices that the edge of every hinge joins
    sides: IntArray  # (H, 2) its two faces
    signs: Float  # (H,) 1 where they have one orientation, -1 elsewhere
    angles: Float  # (H,) angles in that pose, in radians
    known: NDArray[np.bool_]  # (H,) whether both faces have area in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Curvature:
        """Make the measure against a pose ``(V, 3)`` of triangles ``(F, 3)``."""
        topology = Topology(faces, len(points))
        hinges, sides = topology.hinges[:, :2], topology.hinge_faces
        # the first face goes along the edge from a to b; the second goes back, if it has the same orientation
        second = faces[sides[:, 1]]
        along = (second == hinges[:, :1]) & (np.roll(second, -1, axis=1) == hinges[:, 1:])
        signs = np.where(along.any(axis=1), -1.0, 1.0)
        return cls(faces, hinges, sides, signs, *_angles(points, faces, hinges, sides, signs))

    def __call__(self, points: FloatArray) -> Float:
        """Return changes ``(V,)`` in degrees, 0 to 180, of points ``(V, 3)``."""
        now, known = _angles(points, self.faces, self.hinges, self.sides, self.signs)
        change = np.where(known & self.known, np.abs(wrap(now - self.angles)), 0.0)
        return np.degrees(_means(change, self.hinges, len(points)))


MEASURES: dict[str, type[Strain | Curvature]] = {"strain": Strain, "curvature": Curvature}
"""Measures by the names of their colourings."""


def distances(points: FloatArray, original: FloatArray, diagonal: float) -> Float:
    """Return errors ``(V,)`` of points ``(V, 3)``, in diagonals of the original."""
    return np.asarray(np.linalg.norm(points - original, axis=1) / diagonal)


def two_digits(number: float) -> str:
    """Format the end of a colour scale with two digits: 0.0123 as "0.012", 123.4 as "120"."""
    return f"{float(f'{number:.2g}'):g}"


def _means(values: Float, ends: IntArray, count: int) -> Float:
    """Return means ``(V,)`` at vertices of the values ``(n,)`` of edges with ends ``(n, 2)``."""
    at = ends.ravel()
    sums = np.bincount(at, np.repeat(values, 2), count)
    return np.asarray(sums / np.maximum(np.bincount(at, minlength=count), 1))


def _angles(
    points: FloatArray, faces: IntArray, hinges: IntArray, sides: IntArray, signs: Float
) -> tuple[Float, NDArray[np.bool_]]:
    """Return the angles ``(H,)`` of all hinges, and a mask of those between faces with area."""
    x = np.ascontiguousarray(points.T, dtype=np.float64)  # columns: several times faster than rows of three
    normals, low = _normals(x, faces)
    first, second = (np.take(normals, side, axis=1) for side in sides.T)
    second *= signs
    edge = np.take(x, hinges[:, 1], axis=1) - np.take(x, hinges[:, 0], axis=1)
    sine = _dot(_cross(first, second), edge)
    cosine = _dot(first, second) * np.sqrt(_dot(edge, edge))
    return np.arctan2(sine, cosine), ~(low[sides[:, 0]] | low[sides[:, 1]])


def _normals(x: Float, faces: IntArray) -> tuple[Float, NDArray[np.bool_]]:
    """Return face normals ``(3, F)`` of twice the faces' areas in length, and a mask of flat faces."""
    a, b, c = (np.take(x, corner, axis=1) for corner in faces.T)
    u, v, w = b - a, c - a, c - b
    normals = _cross(u, v)
    longest = np.maximum(np.maximum(_dot(u, u), _dot(v, v)), _dot(w, w))
    return normals, _dot(normals, normals) <= (FLAT * longest) ** 2


def _cross(u: Float, v: Float) -> Float:
    """Return cross products ``(3, n)`` of columns."""
    return np.stack(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]],
    )


def _dot(u: Float, v: Float) -> Float:
    """Return scalar products ``(n,)`` of columns."""
    return np.asarray(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])
