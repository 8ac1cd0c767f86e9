r"""Find markers that do not fit the others: single wrong ones, and two, or two groups, that are exchanged.

Markers are left out, and predicted by a thin-plate spline through the others. The smoothest map of space that takes
sources :math:`x_i` to targets :math:`y_i`, up to a little slack :math:`\lambda`, has the bending energy (Duchon 1977;
in three dimensions the kernel is :math:`-\|x\|`)

.. math::
    E = \operatorname{tr} Y^T B\, Y, \qquad B = Z (Z^T K Z)^{-1} Z^T, \qquad
    K_{ij} = -\|x_i - x_j\| + \lambda \delta_{ij},

where the columns of Z are orthogonal to all affine functions of the :math:`x_i`. Without the markers of a set S, it
takes these to where the energy is least,

.. math:: \hat y_S = y_S - (B_{SS})^{-1} (B Y)_S,

so that leaving out needs no other solution (Wahba 1990, chapter 4).

Exchanging the left leg for the right one exchanges all its markers. No two of them then look wrong among the others,
but leaving both groups out predicts the side of either centre.

Sources and targets are normalised: centred, with a root mean square distance of 1. `mixseq.correspondence.checks` has
the results of the chosen numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from mixseq.arrays import Float, Index

SLACK = 0.05
"""Slack of the splines, in root mean square distances from the centre; it hardly matters from 0 to 0.2."""

_NO_SUPPORT = 1e-9
"""Entries of B, relative to its mean diagonal, below which the other markers do not support a prediction."""

FEWEST_COMPARED = 8
"""Least number of markers for a comparison."""

EXCHANGED = 0.5
"""Ratio of distances, exchanged to unchanged, below which two markers are exchanged."""

STRIKING = 2.5
"""Least distance of exchanged markers, in median distances of markers left out."""

FAR, SURPRISING = 0.5, 5.0
"""Distance of a wrong marker in root mean square distances from the centre, and surprise in medians of all."""

MOST_FOUND = 20
"""Largest number of exchanges, and of wrong markers."""

NOTHING = 1e-6
"""Distance below which it is rounding."""

LARGEST_SHARE = 0.25
"""Largest share of all markers in a group."""

ALIKE = 2.5
"""Largest ratio of the sizes of two exchanged groups."""


@dataclass(frozen=True, eq=False)
class Exchanges:
    """Fits of all pairs of markers, unchanged and with their targets exchanged."""

    first: Index  # (m,) first marker of every pair
    second: Index  # (m,) second marker of every pair
    straight: Float  # (m,) root mean square distance of both from their prediction by the others
    exchanged: Float  # (m,) the same distance with the two targets exchanged


@dataclass(frozen=True, eq=False)
class Bending:
    """The bending energy of thin-plate splines through fixed sources."""

    matrix: Float  # (n, n) the matrix B above

    @classmethod
    def of(cls, sources: Float, slack: float = SLACK) -> Self:
        """Prepare the energy of maps of more than four sources ``(n, 3)``."""
        kernel = -np.linalg.norm(sources[:, None] - sources, axis=2) + slack * np.eye(len(sources))
        affine = np.column_stack([np.ones(len(sources)), sources])
        free = np.linalg.qr(affine, mode="complete")[0][:, 4:]
        return cls(np.asarray(free @ np.linalg.solve(free.T @ kernel @ free, free.T)))

    def left_out(self, targets: Float) -> tuple[Float, Float]:
        """Leave out every marker in turn, with targets ``(n, 3)``; return distances ``(n,)`` and surprises ``(n,)``."""
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


def exchanged_pairs(bending: Bending, target: Float) -> list[tuple[int, int, float, float]]:
    """Find markers whose targets ``(n, 3)`` seem exchanged, the most striking first."""
    target, found = target.copy(), []
    for _ in range(min(len(target) // 4, MOST_FOUND)):
        pairs = bending.exchanges(target)
        typical = np.median(bending.left_out(target)[0])
        better = pairs.exchanged < EXCHANGED * pairs.straight
        better &= pairs.straight > max(STRIKING * typical, NOTHING)
        if not better.any():
            break
        ratio = pairs.exchanged / np.where(better, pairs.straight, np.inf)
        best = int(np.argmin(np.where(better, ratio, np.inf)))
        i, j = int(pairs.first[best]), int(pairs.second[best])
        found.append((i, j, float(pairs.straight[best]), float(pairs.exchanged[best])))
        target[[i, j]] = target[[j, i]]
    return found


def wrong_markers(source: Float, target: Float) -> list[tuple[int, float, float]]:
    """Find markers far from their predictions, the most striking first: source, target ``(n, 3)``."""
    kept, found = np.arange(len(source)), []
    for _ in range(min(len(source) // 4, MOST_FOUND)):
        if len(kept) < FEWEST_COMPARED:
            break
        distances, surprises = Bending.of(source[kept]).left_out(target[kept])
        surprises = surprises / max(float(np.median(surprises)), np.finfo(float).tiny)
        wrong = (distances > FAR) & (surprises > SURPRISING)
        if not wrong.any():
            break
        worst = int(np.argmax(np.where(wrong, surprises, 0)))
        found.append((int(kept[worst]), float(distances[worst]), float(surprises[worst])))
        kept = np.delete(kept, worst)
    return found


def groups(points: Float) -> list[Index]:
    """Return the clusters of two or more points ``(n, 3)``, of all sizes, nested (Ward 1963)."""
    from scipy.cluster.hierarchy import linkage

    found = [np.array([point]) for point in range(len(points))]
    for first, second in linkage(points, "ward")[:, :2].astype(int):
        found.append(np.union1d(found[first], found[second]))
    return [group for group in found if 2 <= len(group) <= LARGEST_SHARE * len(points)]


def exchanged_groups(bending: Bending, source: Float, target: Float) -> tuple[Index, Index, float, float]:
    """Find the two groups whose exchange brings them closest to their predictions: source, target ``(n, 3)``."""
    matrix, force = bending.matrix, bending.matrix @ target
    best = np.zeros(0, np.int64), np.zeros(0, np.int64), 1.0, 1.0
    clusters = groups(source)
    inside = np.zeros((len(clusters), len(source)))
    for number, group in enumerate(clusters):
        inside[number, group] = 1
    apart_from = inside @ inside.T == 0
    for number, second in enumerate(clusters):
        for first in (clusters[other] for other in np.flatnonzero(apart_from[number, :number])):
            if max(len(first), len(second)) > ALIKE * min(len(first), len(second)):
                continue
            both = np.concatenate([first, second])
            try:
                off = np.linalg.solve(matrix[np.ix_(both, both)], force[both])
            except np.linalg.LinAlgError:  # the others are in a plane, and predict nothing
                continue
            one, two = off[: len(first)].mean(axis=0), off[len(first) :].mean(axis=0)
            apart = target[second].mean(axis=0) - target[first].mean(axis=0)
            straight = float(np.sqrt((one @ one + two @ two) / 2))
            one, two = one + apart, two - apart
            exchanged = float(np.sqrt((one @ one + two @ two) / 2))
            if exchanged * best[2] < best[3] * straight:
                best = first, second, straight, exchanged
    return best
