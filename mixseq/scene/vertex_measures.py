r"""How far a pose is from a pose at rest: a number at every vertex, that colours show.

- **strain**: mean over the edges of a vertex of :math:`|l / \bar l - 1|`, with :math:`\bar l` their lengths at rest.
- **curvature** (its change): mean over the hinges of a vertex of :math:`|\theta - \bar\theta|` in degrees, with
  :math:`\bar\theta` their dihedral angles at rest and the difference in :math:`(-\pi, \pi]`, the shorter way round. A
  hinge is of the two vertices that its edge joins: there the surface bends. The two opposite it stay in the planes
  of its faces.
- **error**: distance from the same vertex of an original, :math:`|a_v - b_v| / d`, in diagonals.

Rigid motions change neither strain nor curvature, uniform scaling by s makes the strain :math:`|s - 1|` everywhere.
On a finer mesh the same bend is shared by more hinges: curvature compares poses of one mesh, not meshes.

What has no length or no angle, an edge of two vertices at one place or a hinge of a face without area, counts as
unchanged; vertices without edges or hinges have 0.

The angles are those of `mixseq.geometry.lengths_angles`, from normals that are computed once for every face: with
:math:`n_f = (b - a) \times (c - a)`, the hinge of edge ab and faces f and g has :math:`n_1 = n_f`, and :math:`n_2 =
n_g`, or :math:`-n_g` where g has the other orientation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float, FloatArray, IntArray
from mixseq.geometry.lengths_angles import edge_lengths, wrap
from mixseq.topology import Topology

FLAT = 1e-6
"""A face lower than this, relative to its longest side, has no normal to speak of; as in `mixseq.metrics`."""

SHARE = 0.99
"""Part of the vertices that the colour scale must reach: one sliver should not darken all others. Ours."""


@dataclass(frozen=True, eq=False)
class Strain:
    """Strain against a pose.

    Examples
    --------
    >>> square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> Strain.of(square, np.array([[0, 1, 2], [0, 2, 3]]))(1.5 * square).round(9).tolist()
    [0.5, 0.5, 0.5, 0.5]
    """

    edges: IntArray  # (E, 2) edges of the mesh
    lengths: Float  # (E,) their lengths in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Strain:
        """Measure against the pose ``(V, 3)`` of triangles ``(F, 3)``."""
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
    """Change of dihedral angles against a pose.

    Examples
    --------
    >>> flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0]])
    >>> roof = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, -1], [0, -1, -1]])
    >>> Curvature.of(flat, np.array([[0, 1, 2], [1, 0, 3]]))(roof).round(9).tolist()
    [90.0, 90.0, 0.0, 0.0]
    """

    faces: IntArray  # (F, 3) triangles of the mesh
    hinges: IntArray  # (H, 2) the vertices that the edge of every hinge joins
    sides: IntArray  # (H, 2) its two faces
    signs: Float  # (H,) 1 where they have one orientation, -1 elsewhere
    angles: Float  # (H,) angles in that pose, in radians
    known: NDArray[np.bool_]  # (H,) whether both faces have area in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Curvature:
        """Measure against the pose ``(V, 3)`` of triangles ``(F, 3)``."""
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
"""By the names of their colours."""


def distances(points: FloatArray, original: FloatArray, diagonal: float) -> Float:
    """Return errors ``(V,)`` of points ``(V, 3)``, in diagonals of the original."""
    return np.asarray(np.linalg.norm(points - original, axis=1) / diagonal)


def two_digits(number: float) -> str:
    """Write the end of a colour scale.

    Examples
    --------
    >>> two_digits(0.0123), two_digits(123.4)
    ('0.012', '120')
    """
    return f"{float(f'{number:.2g}'):g}"


def _means(values: Float, ends: IntArray, count: int) -> Float:
    """Return at every vertex ``(V,)`` the mean of the values ``(n,)`` whose ends ``(n, 2)`` it is one of."""
    at = ends.ravel()
    sums = np.bincount(at, np.repeat(values, 2), count)
    return np.asarray(sums / np.maximum(np.bincount(at, minlength=count), 1))


def _angles(
    points: FloatArray, faces: IntArray, hinges: IntArray, sides: IntArray, signs: Float
) -> tuple[Float, NDArray[np.bool_]]:
    """Return the angles ``(H,)`` of all hinges, and which of them are between faces with area."""
    x = np.ascontiguousarray(points.T, dtype=np.float64)  # columns: several times faster than rows of three
    normals, low = _normals(x, faces)
    first, second = (np.take(normals, side, axis=1) for side in sides.T)
    second *= signs
    edge = np.take(x, hinges[:, 1], axis=1) - np.take(x, hinges[:, 0], axis=1)
    sine = _dot(_cross(first, second), edge)
    cosine = _dot(first, second) * np.sqrt(_dot(edge, edge))
    return np.arctan2(sine, cosine), ~(low[sides[:, 0]] | low[sides[:, 1]])


def _normals(x: Float, faces: IntArray) -> tuple[Float, NDArray[np.bool_]]:
    """Return the normals ``(3, F)`` of faces, twice as long as their areas, and which faces are flat."""
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
