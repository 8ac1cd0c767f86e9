r"""Match the extremities of two bodies that stand in the same pose.

First the prominent ones: limbs, tail, head. Any three of one body may be any three of the other. Each such guess gives
a similarity, a proper one, that moves the one body onto the other, and with it the cost of every pair,

.. math:: c_{ij} = \|S x_i - y_j\| + \tfrac13 \sum_{k=1}^3 |d_{i\,i_k} - d_{j\,j_k}| ,

how far the points are from each other, and how much their distances along the surface to the three differ, in roots of
the area. The best assignment follows (Kuhn 1955), and is measured with the similarity of all its pairs and all their
distances. A left-right exchange keeps the distances, but is no motion: that the similarity turns, and never mirrors,
tells left from right.

How *sure* a pair is, is by how much the best of all matchings without it costs more. Then extremities that stick out
less, such as ears, are matched in the same way to those that are left, led by the pairs that are there.
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
"""Prominence of limbs, tail and head, in roots of the area; those of the pairs tried have 0.15 and more, ears less than
0.06. Ours, as all numbers here."""

MOST = 8
"""Prominent extremities that are matched; all triples of more take long."""

LEFT_OUT = 0.5
"""Cost of an extremity that has no partner."""

UNLIKE = 0.5
"""Three and three whose mutual distances differ by more are no guess."""

SURE = 0.1
"""The best matching without a pair that is sure costs so much more."""

LARGEST_COST = 0.4
"""Mean cost of the pairs of two bodies that are alike; horse and camel have 0.26."""

SMALL_COST, CLEARER = 0.18, 1.25
"""The cost of a pair that sticks out less, and how many times it costs to give one of the two another partner."""

BLUNT = 0.08
"""An extremity with a larger radius is on the right limb, but perhaps not at the same place of it."""

NEAR = 0.3
"""Prominent extremities that are nearer lead those that stick out less."""

HEAT = 0.2
"""Weight of differences of signatures."""


@dataclass(frozen=True)
class Matched:
    """A pair of extremities, and how sure it is."""

    first: int  # number of the extremity of the first body
    second: int  # number of the extremity of the second body
    margin: float  # by how much any other matching costs more


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
    """The matching that follows from three pairs, if these are alike."""
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
    """Match what sticks out less: both are each other's best by far."""
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
    """Move all extremities ``(e, 3)`` by a similarity, and with what this leaves of the pairs nearby."""
    moved = similarity(first.points)
    weights = np.exp(-((first.distances[:, pairs] / NEAR) ** 2)) + 1e-6
    return np.asarray(moved + weights @ (goals - moved[pairs]) / weights.sum(axis=1, keepdims=True))
