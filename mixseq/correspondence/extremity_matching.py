r"""Match the extremities of two bodies in the same pose.

First the prominent ones: limbs, tail, head. Any three of one body may be any three of the other. Each guess gives a
proper similarity from one body to the other, and the cost of every pair,

.. math:: c_{ij} = \|S x_i - y_j\| + \tfrac13 \sum_{k=1}^3 |d_{i\,i_k} - d_{j\,j_k}| ,

the distance of the points, and the differences of their distances along the surface to the three, in roots of the area.
The best assignment follows (Kuhn 1955), and is measured with the similarity of all its pairs and all their distances.
A left-right exchange keeps distances, but needs a mirroring, which a proper similarity excludes.

A pair is *sure* by the additional cost of the best matching without it. Then less prominent extremities, such as ears,
are matched alike to the remaining ones, guided by the pairs found.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.correspondence.extremities import Extremities
from mixseq.correspondence.markers import Similarity, fit_similarity
from mixseq.errors import SettingsError

PROMINENT = 0.1
"""Prominence of limbs, tail and head, in roots of the area; tried bodies have 0.15 and more, ears less than 0.06."""

MOST = 8
"""Largest number of prominent extremities that are matched, as all triples are tried."""

LEFT_OUT = 0.5
"""Cost of an extremity without a partner."""

UNLIKE = 0.5
"""Largest difference of mutual distances between the triples of a guess."""

SURE = 0.1
"""Additional cost of the best matching without a sure pair."""

LARGEST_COST = 0.4
"""Largest mean cost of the pairs of two similar bodies; horse and camel have 0.26."""

SMALL_COST, CLEARER = 0.18, 1.25
"""Largest cost of a less prominent pair, and least ratio of the next best partner's cost to it."""

BLUNT = 0.08
"""Radius above which an extremity is on the right limb, but perhaps at another place of it."""

NEAR = 0.3
"""Distance below which prominent extremities guide less prominent ones."""

HEAT = 0.2
"""Weight of differences of signatures."""


@dataclass(frozen=True)
class Matched:
    """A pair of extremities, and its certainty."""

    first: int  # number of the extremity of the first body
    second: int  # number of the extremity of the second body
    margin: float  # additional cost of the best other matching


def match_extremities(first: Extremities, second: Extremities) -> list[Matched]:
    """Match the extremities of two bodies."""
    prominent = _prominent_pairs(first, second)
    if len(prominent) < 4:  # which could be turned at will
        return []
    sharp = [each for each in prominent if max(first.radii[each.first], second.radii[each.second]) <= BLUNT]
    return sharp + _other_pairs(first, second, prominent)


def _prominent_pairs(first: Extremities, second: Extremities) -> list[Matched]:
    one, two = (np.flatnonzero(each.prominences >= PROMINENT)[:MOST] for each in (first, second))
    matchings: dict[tuple[tuple[int, int], ...], float] = {}
    for guess in combinations(one.tolist(), 3):
        for other in permutations(two.tolist(), 3):
            pairs = _guessed(first, second, one, two, np.array(guess), np.array(other))
            if pairs is not None and pairs not in matchings:
                matchings[pairs] = _cost(first, second, pairs) + LEFT_OUT * (len(one) - len(pairs))
    if not matchings:
        return []
    best = min(matchings, key=lambda pairs: (matchings[pairs], pairs))
    if _cost(first, second, best) > LARGEST_COST * len(best):
        return []
    sure = []
    for pair in best:
        others = [cost for pairs, cost in matchings.items() if pair not in pairs]
        margin = min(others, default=np.inf) - matchings[best]
        if margin >= SURE:
            sure.append(Matched(*pair, float(margin)))
    return sorted(sure, key=lambda each: -each.margin)


def _guessed(
    first: Extremities, second: Extremities, one: Index, two: Index, guess: Index, other: Index
) -> tuple[tuple[int, int], ...] | None:
    """Return the matching that follows from three pairs, if these are similar."""
    from scipy.optimize import linear_sum_assignment

    apart = first.distances[np.ix_(guess, guess)] - second.distances[np.ix_(other, other)]
    if np.abs(apart).max() > UNLIKE:
        return None
    try:
        moved = fit_similarity(first.points[guess], second.points[other])(first.points[one])
    except SettingsError:  # one is upside down against the other
        return None
    away = np.linalg.norm(moved[:, None] - second.points[two], axis=2)
    along = np.abs(first.distances[np.ix_(one, guess)][:, None] - second.distances[np.ix_(two, other)]).mean(
        axis=2
    )
    rows, columns = linear_sum_assignment(away + along)
    return tuple(zip(one[rows].tolist(), two[columns].tolist(), strict=True))


def _cost(first: Extremities, second: Extremities, pairs: tuple[tuple[int, int], ...]) -> float:
    one, two = np.array(pairs).T
    try:
        moved = fit_similarity(first.points[one], second.points[two])(first.points[one])
    except SettingsError:
        return np.inf
    along = np.abs(first.distances[np.ix_(one, one)] - second.distances[np.ix_(two, two)]).mean(axis=1)
    return float((np.linalg.norm(moved - second.points[two], axis=1) + along).sum())


def _other_pairs(first: Extremities, second: Extremities, pairs: list[Matched]) -> list[Matched]:
    """Match less prominent extremities: both are each other's best by far."""
    one, two = np.array([(pair.first, pair.second) for pair in pairs]).T
    rest, left = (
        np.setdiff1d(np.arange(len(each.points)), done) for each, done in ((first, one), (second, two))
    )
    if not (len(rest) and len(left)):
        return []
    moved = _led(first, fit_similarity(first.points[one], second.points[two]), one, second.points[two])
    costs = (
        np.linalg.norm(moved[rest][:, None] - second.points[left], axis=2)
        + np.abs(first.distances[np.ix_(rest, one)][:, None] - second.distances[np.ix_(left, two)]).mean(
            axis=2
        )
        + HEAT * np.abs(first.signatures[rest][:, None] - second.signatures[left]).mean(axis=2)
    )
    found = []
    for row, column in enumerate(costs.argmin(axis=1)):
        cost = costs[row, column]
        others = np.concatenate([np.delete(costs[row], column), np.delete(costs[:, column], row)])
        next_best = others.min(initial=np.inf)
        if cost <= SMALL_COST and next_best >= CLEARER * cost:
            found.append(Matched(int(rest[row]), int(left[column]), float(next_best - cost)))
    return sorted(found, key=lambda each: -each.margin)


def _led(first: Extremities, similarity: Similarity, pairs: Index, goals: Float) -> Float:
    """Move all extremities ``(e, 3)`` by a similarity, and by its residuals at nearby pairs."""
    moved = similarity(first.points)
    weights = np.exp(-((first.distances[:, pairs] / NEAR) ** 2)) + 1e-6
    return np.asarray(moved + weights @ (goals - moved[pairs]) / weights.sum(axis=1, keepdims=True))
