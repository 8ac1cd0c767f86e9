r"""Where parts go: about the pivots of the target, with the gaps of the source.

Neighbouring parts i and j meet at a pivot c, in the middle of their boundary on the target; :math:`\bar c` is that
point on the source. With the rotations R' of the target's parts (as gradients turn them, `mixseq.retargeting.mixed`)
and rest centres m the centres x solve

.. math:: \min_x \sum_{ij} w_{ij}\, | x_i + R'_i (c - m_i) - x_j - R'_j (c - m_j) - g'_{ij} |^2 ,
   \qquad g_{ij} = M_i(\bar c) - M_j(\bar c)

where M is the rigid motion of a part of the source, and g' is s G g, up to what follows (G, s:
`mixseq.retargeting.alignment`). That is the articulated body with the proportions of the target, which opens and slides
where the source's does. Where there are no loops of parts all terms vanish;
otherwise those weigh most that have the longest boundaries, by the squares of their lengths. The root moves as the
source's does, by s G. Pieces that no edge connects are linked through the vertices that hold them.

Flesh is not rigid. What gaps make up for on the source they do not with other proportions, and where a boundary is
short a small difference tears the joint. Deformation gradients tell gaps too, those of the parts as they move them
(:math:`\tilde g`): smoother ones, which lead astray over long limbs. So g' differs from theirs by what the boundary,
of radius r, can take up,

.. math:: g' = \tilde g + \frac{\rho r}{\sqrt{(\rho r)^2 + |\delta|^2}}\, \delta , \qquad \delta = s G g - \tilde g ,

which is the body of pivots for small differences, and changes smoothly with time. That and the weights are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mixseq.arrays import Float, Index
from mixseq.retargeting.linkage import Linkage
from mixseq.shells.solvers import Factor, factorise

SHORTEST = 1e-3
"""Boundaries count as at least so long, relative to the longest."""

REACH = 1.2
r"""How far a gap goes from that of gradients at most, :math:`\rho`, in radii of its boundary. Chosen for the errors of
poses and for accelerations of three pairs of animals."""


@dataclass(frozen=True, eq=False)
class Pivots:
    """Where the parts of a linkage go.

    Attributes
    ----------
    linkage : Linkage
        The parts at rest, all of them linked to the root, whose place is given.
    lengths, radii : (n,) float64
        How long the boundary at every pivot is, and its root mean square distance from the pivot.
    """

    linkage: Linkage
    lengths: Float
    radii: Float

    @cached_property
    def _incidence(self) -> sparse.csr_array:
        """Matrix ``(n, p)``: 1 at the first part of every pair, -1 at its second."""
        number = len(self.linkage.links)
        places = (np.repeat(np.arange(number), 2), self.linkage.links.reshape(-1))
        values = np.tile([1.0, -1.0], number)
        return sparse.coo_array((values, places), shape=(number, len(self.linkage.centres))).tocsr()

    @cached_property
    def _others(self) -> Index:
        return np.delete(np.arange(len(self.linkage.centres)), self.linkage.root)

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
        away, reach = gaps - smooth, REACH * self.radii
        whole = np.hypot(reach, np.linalg.norm(away, axis=1))
        share = np.divide(reach, whole, out=np.zeros_like(whole), where=whole > 0)
        return np.asarray(smooth + share[:, None] * away)

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
        result = np.empty_like(self.linkage.centres)
        result[self.linkage.root] = root
        if not self._others.size:
            return result
        away = gaps - self.linkage.gaps(rotations, np.zeros_like(self.linkage.centres))
        away -= self._incidence[:, [self.linkage.root]].toarray() * root
        result[self._others] = self._factor.solve(self._weighted @ away)
        return result
