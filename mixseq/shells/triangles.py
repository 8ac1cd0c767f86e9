r"""Triangles from their lengths, and how two of them stand to each other across a hinge.

The frame of a triangle is a rotation whose columns are the direction of its side 01, the in-plane normal of that side
and the normal. It sees the hinge's edge under an angle :math:`\alpha` that lengths tell, so that the frames of both
faces of a hinge differ by a known rotation (Wang, Liu and Tong 2012)

.. math:: F_j = F_i T_{ij}, \qquad T_{ij} = R_z(\alpha_i)\, R_x(\theta)\, R_z(-\alpha_j) .
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Index, IntArray
from mixseq.shells import rotation_kernels as kernels

SHORTEST = 1e-12
"""No side is shorter, in diagonals: a triangle has a side 01 that its frame can follow."""


def flat_triangles(lengths: Float) -> Float:
    """Lay triangles with sides ``(m, 3)`` = 01, 12, 20 into the plane, as corners ``(m, 3, 2)``.

    Interpolated lengths may break the triangle inequality; such a triangle is laid flat on a line.

    Examples
    --------
    >>> flat_triangles(np.array([[3.0, 4.0, 5.0]])).tolist()
    [[[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]]
    """
    l01, l12, l20 = np.maximum(lengths, SHORTEST).T
    x = np.clip((l01**2 + l20**2 - l12**2) / (2.0 * l01), -l20, l20)
    y = np.sqrt(l20**2 - x**2)
    zero = np.zeros_like(x)
    return np.stack([zero, zero, l01, zero, x, y], axis=1).reshape(-1, 3, 2)


def frames_of(x: Float, faces: IntArray) -> Float:
    """Return the frames ``(m, 4)``, as quaternions, of triangles ``(m, 3)`` with vertices ``(n, 3)``.

    The normal of a triangle without area is any that is across its first side.

    Examples
    --------
    >>> corner = np.array([[0.0, 0, 0], [0, 2, 0], [-1, 0, 0]])
    >>> frames_of(corner, np.array([[0, 1, 2]])).round(3).tolist()
    [[0.707, 0.0, 0.0, 0.707]]
    """
    return np.asarray(kernels.frames_of(x, faces.astype(np.int64)))


@dataclass(frozen=True, eq=False)
class Hinges:
    """Hinges, as seen from the frames of their faces.

    Attributes
    ----------
    faces : (m, 3) int
        Triangles.
    hinges : (h, 4) int64
        Hinges a, b, c, d: edge ab, opposite vertices c and d.
    hinge_faces : (h, 2) int64
        Their faces.
    """

    faces: IntArray
    hinges: Index
    hinge_faces: Index

    @cached_property
    def _sides(self) -> tuple[Index, Float]:
        """Side ``(h, 2)`` of both faces that a hinge's edge is, and half a turn where it runs against the edge."""
        faces = self.faces[self.hinge_faces]  # (h, 2, 3)
        start = (faces == self.hinges[:, None, :1]).argmax(axis=2)
        end = (faces == self.hinges[:, None, 1:2]).argmax(axis=2)
        forward = (start + 1) % 3 == end
        return np.where(forward, start, end), np.where(forward, 0.0, np.pi)

    @cached_property
    def _reversed(self) -> Float:
        """Half a turn where both faces run along the edge alike: their normals are on opposite sides."""
        _, back = self._sides
        return np.where(back[:, 1] == 0.0, np.pi, 0.0)

    def turns(self, flat: Float, angles: Float) -> Float:
        """Return the rotations T ``(h, 4)`` across all hinges.

        Parameters
        ----------
        flat : (m, 3, 2) float64
            Triangles, laid into the plane.
        angles : (h,) float64
            Dihedral angles in radians.
        """
        side = np.roll(flat, -1, axis=1) - flat
        directions = np.arctan2(side[..., 1], side[..., 0])
        which, back = self._sides
        seen = directions[self.hinge_faces, which] + back
        return np.asarray(kernels.transitions(seen[:, 0], seen[:, 1], angles + self._reversed))
