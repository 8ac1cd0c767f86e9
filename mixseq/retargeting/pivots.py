r"""Where parts go: about the pivots of the target, with the gaps of the source.

Neighbouring parts i and j meet at a pivot c, in the middle of their boundary on the target; :math:`\bar c` is that
point on the source. With rotations :math:`R'_i = G R_i G^T` and rest centres m the centres x solve

.. math:: \min_x \sum_{ij} w_{ij}\, | x_i + R'_i (c - m_i) - x_j - R'_j (c - m_j) - g'_{ij} |^2 ,
   \qquad g_{ij} = M_i(\bar c) - M_j(\bar c)

where M is the rigid motion of a part of the source, and g' = s G g. That is the articulated body with the proportions
of the target, which opens and slides where the source's does. Where there are no loops of parts all terms vanish;
otherwise those weigh most that have the longest boundaries, by the squares of their lengths. The root moves as the
source's does, by s G. Pieces that no edge connects are linked through the vertices that hold them.

Flesh is not rigid. What gaps make up for on the source they do not with other proportions, and where a boundary is
short a small difference tears the joint. Deformation gradients tell gaps too, those of the parts as they move them
(:math:`\tilde g`): smoother ones, which lead astray over long limbs. So g' differs from theirs by what the boundary,
of radius r, can take up,

.. math:: g' = \tilde g + \frac{\delta}{\sqrt{1 + (|\delta| / \rho r)^2}} , \qquad \delta = s G g - \tilde g ,

which is the body of pivots for small differences, and changes smoothly with time. That and the weights are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.reconstruction.solvers import Factor, factorise

Float = NDArray[np.float64]
Index = NDArray[np.int64]

SHORTEST = 1e-3
"""Boundaries count as at least so long, relative to the longest."""

REACH = 1.2
r"""How far a gap goes from that of gradients at most, :math:`\rho`, in radii of its boundary. Chosen for the errors of
poses and for accelerations of three pairs of animals."""


@dataclass(frozen=True, eq=False)
class Pivots:
    """Pairs of parts that meet in a point.

    Attributes
    ----------
    parts : (n, 2) int64
        The pairs. They connect all parts.
    points : (n, 3) float64
        Their pivots on the target at rest.
    centres : (p, 3) float64
        Centres of the parts at rest.
    root : int
        The part whose place is given.
    lengths, radii : (n,) float64
        How long the boundary of every pair is, and its root mean square distance from the pivot.
    """

    parts: Index
    points: Float
    centres: Float
    root: int
    lengths: Float
    radii: Float

    @cached_property
    def _incidence(self) -> sparse.csr_array:
        """Matrix ``(n, p)``: 1 at the first part of every pair, -1 at its second."""
        number = len(self.parts)
        places = (np.repeat(np.arange(number), 2), self.parts.reshape(-1))
        values = np.tile([1.0, -1.0], number)
        return sparse.coo_array((values, places), shape=(number, len(self.centres))).tocsr()

    @cached_property
    def _others(self) -> Index:
        return np.delete(np.arange(len(self.centres)), self.root)

    @cached_property
    def _weighted(self) -> sparse.csr_array:
        """Transpose ``(p - 1, n)`` of the incidence of all parts but the root, times the weights."""
        usual = self.lengths.max(initial=0.0) or 1.0
        weights = np.square(np.maximum(self.lengths / usual, SHORTEST))
        return sparse.csr_array(self._incidence[:, self._others].T @ sparse.diags_array(weights))

    @cached_property
    def _factor(self) -> Factor:
        return factorise(sparse.csr_array(self._weighted @ self._incidence[:, self._others]))

    def within_reach(self, gaps: Float, smooth: Float) -> Float:
        """Return gaps ``(n, 3)`` that are near smooth ones, within the reach of the boundaries."""
        away = gaps - smooth
        reach = np.maximum(REACH * self.radii, np.finfo(np.float64).tiny)
        return np.asarray(smooth + away / np.hypot(1.0, np.linalg.norm(away, axis=1) / reach)[:, None])

    def gaps(self, rotations: Float, centres: Float) -> Float:
        """Return by how much the first part is away from the second at every pivot ``(n, 3)``.

        Parameters
        ----------
        rotations, centres : (p, 3, 3), (p, 3) float64
            Poses of the parts.
        """
        first, second = (
            turned(rotations[part], self.points - self.centres[part]) + centres[part] for part in self.parts.T
        )
        return np.asarray(first - second)

    def place(self, rotations: Float, gaps: Float, root: Float) -> Float:
        """Return the centres ``(p, 3)`` of all parts.

        Parameters
        ----------
        rotations : (p, 3, 3) float64
            Rotations of the parts from rest.
        gaps : (n, 3) float64
            By how much the first part is away from the second at every pivot.
        root : (3,) float64
            Centre of the root.
        """
        result = np.empty_like(self.centres)
        result[self.root] = root
        if not self._others.size:
            return result
        away = gaps - self.gaps(rotations, np.zeros_like(self.centres))
        away -= self._incidence[:, [self.root]].toarray() * root
        result[self._others] = self._factor.solve(self._weighted @ away)
        return result


def turned(matrices: Float, vectors: Float) -> Float:
    """Return vectors ``(..., 3)``, each multiplied by its matrix ``(..., 3, 3)``."""
    return np.asarray(np.einsum("...ij,...j->...i", matrices, vectors))
