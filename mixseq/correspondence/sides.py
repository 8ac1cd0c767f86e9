r"""Left for right: groups of markers that are exchanged as a whole.

A person who takes the left leg for the right one exchanges all its markers. No two of them then look wrong among the
others, which are exchanged as well, but leaving both groups out tells: a spline through the rest
(`mixseq.correspondence.thin_plate`) says on which side the centre of either should be.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.thin_plate import Bending

LARGEST_SHARE = 0.25
"""A group has at most this share of all markers; ours."""

ALIKE = 2.5
"""One of two groups has at most so many times the markers of the other; ours."""


def groups(points: Float) -> list[Index]:
    """Return the clusters of two or more points ``(n, 3)``, of all sizes, one in another (Ward 1963)."""
    from scipy.cluster.hierarchy import linkage

    found = [np.array([point]) for point in range(len(points))]
    for first, second in linkage(points, "ward")[:, :2].astype(int):
        found.append(np.union1d(found[first], found[second]))
    return [group for group in found if 2 <= len(group) <= LARGEST_SHARE * len(points)]


def exchanged_groups(bending: Bending, source: Float, target: Float) -> tuple[Index, Index, float, float]:
    """Find the two groups that exchanging brings closest to where the other markers say that they should be.

    Parameters
    ----------
    bending : Bending
        Of the sources.
    source, target : (n, 3) float64
        The markers.

    Returns
    -------
    first, second : (a,) and (b,) int64
        The groups; empty if there are no two.
    straight, exchanged : float
        Root mean square distance of both centres from where they should be, as they are and exchanged.
    """
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
            except np.linalg.LinAlgError:  # the others are in a plane, and do not say where these should be
                continue
            one, two = off[: len(first)].mean(axis=0), off[len(first) :].mean(axis=0)
            apart = target[second].mean(axis=0) - target[first].mean(axis=0)
            straight = float(np.sqrt((one @ one + two @ two) / 2))
            one, two = one + apart, two - apart
            exchanged = float(np.sqrt((one @ one + two @ two) / 2))
            if exchanged * best[2] < best[3] * straight:
                best = first, second, straight, exchanged
    return best
