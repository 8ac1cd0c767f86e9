r"""Thin-plate splines through markers: where the others say that a marker should be.

The smoothest map of space that takes sources :math:`x_i` to targets :math:`y_i`, up to a little slack
:math:`\lambda`, has the bending energy (Duchon 1977; in three dimensions the kernel is :math:`-\|x\|`)

.. math::
    E = \operatorname{tr} Y^T B\, Y, \qquad B = Z (Z^T K Z)^{-1} Z^T, \qquad
    K_{ij} = -\|x_i - x_j\| + \lambda \delta_{ij},

where the columns of Z are orthogonal to all affine functions of the :math:`x_i`. Without the markers of a set S, it
takes these to where the energy is least,

.. math:: \hat y_S = y_S - (B_{SS})^{-1} (B Y)_S,

so that leaving out needs no other solution (Wahba 1990, chapter 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mixseq.arrays import Float, Index

SLACK = 0.05
"""Slack of the splines, in root mean square distances from the centre; ours. It hardly matters from 0 to 0.2."""

_NO_SUPPORT = 1e-9
"""Entries of B, relative to its mean diagonal, below which the other markers say nothing; ours."""


@dataclass(frozen=True, eq=False)
class Exchanges:
    """What exchanging the targets of two markers would change, for all pairs of markers.

    Attributes
    ----------
    first, second : (m,) int64
        The markers.
    straight, exchanged : (m,) float64
        Root mean square distance of both from where the others say that they should be: as they are, and exchanged.
    """

    first: Index
    second: Index
    straight: Float
    exchanged: Float


@dataclass(frozen=True, eq=False)
class Bending:
    """The bending energy of maps of fixed sources.

    Attributes
    ----------
    matrix : (n, n) float64
        The matrix B above.
    """

    matrix: Float

    @classmethod
    def of(cls, sources: Float, slack: float = SLACK) -> Self:
        """Prepare the energy of maps of sources ``(n, 3)``, of which there are more than four."""
        kernel = -np.linalg.norm(sources[:, None] - sources, axis=2) + slack * np.eye(len(sources))
        affine = np.column_stack([np.ones(len(sources)), sources])
        free = np.linalg.qr(affine, mode="complete")[0][:, 4:]
        return cls(np.asarray(free @ np.linalg.solve(free.T @ kernel @ free, free.T)))

    def left_out(self, targets: Float) -> tuple[Float, Float]:
        """Leave out every marker in turn.

        Parameters
        ----------
        targets : (n, 3) float64

        Returns
        -------
        distances : (n,) float64
            From where the others say that it should be.
        surprises : (n,) float64
            Square roots of the energy that this costs: distances that count less where the others are far away.
        """
        force = np.linalg.norm(self.matrix @ targets, axis=1)
        own = np.diag(self.matrix)
        known = own > _NO_SUPPORT * own.mean()
        own = np.where(known, own, 1.0)
        return np.where(known, force / own, 0.0), np.where(known, force / np.sqrt(own), 0.0)

    def exchanges(self, targets: Float) -> Exchanges:
        """Leave out all pairs of markers in turn, and exchange their targets ``(n, 3)``."""
        force, own = self.matrix @ targets, np.diag(self.matrix)
        i, j = np.triu_indices(len(targets), 1)
        both = self.matrix[i, j]
        determinant = own[i] * own[j] - both**2
        known = determinant > (_NO_SUPPORT * own.mean()) ** 2
        i, j, both, determinant = i[known], j[known], both[known, None], determinant[known, None]
        at_i = (own[j, None] * force[i] - both * force[j]) / determinant
        at_j = (own[i, None] * force[j] - both * force[i]) / determinant
        apart = targets[j] - targets[i]
        return Exchanges(i, j, _mean_size(at_i, at_j), _mean_size(at_i + apart, at_j - apart))


def _mean_size(a: Float, b: Float) -> Float:
    return np.asarray(np.sqrt(((a**2).sum(axis=1) + (b**2).sum(axis=1)) / 2))
