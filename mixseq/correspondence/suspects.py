r"""Markers that do not fit the others: two that are exchanged, one that is wrong.

Both follow from leaving out (`mixseq.correspondence.thin_plate`). Sources and targets are normalised: centred, with a
root mean square distance of 1 from there. All numbers are ours; `mixseq.correspondence.checks` says how they do.
"""

from __future__ import annotations

import numpy as np

from mixseq.arrays import Float
from mixseq.correspondence.thin_plate import Bending

FEWEST_COMPARED = 8
"""Markers of which some can be compared with the others."""

EXCHANGED = 0.5
"""Exchanged, two markers are closer than this to where they should be, relative to as they are."""

STRIKING = 2.5
"""How far off exchanged markers are, in median distances of markers left out."""

FAR, SURPRISING = 0.5, 5.0
"""Distance of a wrong marker in root mean square distances from the centre, and surprise in medians of all."""

MOST_FOUND = 20
"""Exchanges, and wrong markers, that are looked for."""

NOTHING = 1e-6
"""Distance that is rounding."""


def exchanged_pairs(bending: Bending, target: Float) -> list[tuple[int, int, float, float]]:
    """Find markers whose targets seem exchanged, the most striking first.

    Parameters
    ----------
    bending : Bending
        Of the sources ``(n, 3)``, which are normalised: centred, with a root mean square distance of 1 from there.
    target : (n, 3) float64
        The targets, normalised.

    Returns
    -------
    list of (int, int, float, float)
        Two markers, and how far they are from where they should be: as they are, and exchanged.
    """
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
    """Find markers far from where the others say that they should be, the most striking first.

    Parameters
    ----------
    source, target : (n, 3) float64
        Normalised, as for `exchanged_pairs`.

    Returns
    -------
    list of (int, float, float)
        A marker, its distance, and how much energy that takes: the square root, in medians of all.
    """
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
