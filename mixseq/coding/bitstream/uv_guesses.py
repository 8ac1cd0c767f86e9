"""Guess the texture coordinates of a node from adjacent ones.

With :math:`a, b` the corners before and after a corner x in a polygon that has it, the guesses are, in this order,

==========  =========================================================================================================
`AROUND`    the mean of :math:`a + b - z` over all polygons around the node: of a quad, *z* is the corner across; of a
            triangle, the corner before the half-edge beyond the one from *b* to *a*
`BEYOND`    the mean of :math:`2 a - e` and :math:`2 b - e`, as far as there are any: *e* is beside *a* (*b*) in the
            polygon beyond the edge of this polygon that runs into *a* (out of *b*)
`BESIDE`    the mean of *a* and *b*, or the one that is known
`ANYWHERE`  the node that was known last, (0, 0) at the start
==========  =========================================================================================================

each from known nodes (parallelograms: Touma and Gotsman 1998, *Triangle mesh compression*). Means round to the nearest
integer, halves up.

Where guesses `AROUND` overshoot, as the map is less even than the rule assumes, :math:`a + b - z` is drawn back to the
middle of *a* and *b*, by 3/8 of the way, rounded down.

Frozen: changing this breaks old files (golden: ``tests/coding/golden/uvs.npz``). numba caches compiled loops by the
text of their own file: edit `mixseq.coding.bitstream.uv_values` whenever this module changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.growing import Corners, after, before
from mixseq.compiled import compiled

COPIED, AROUND, BEYOND, BESIDE, ANYWHERE = range(5)
"""Kinds of guesses. Frozen: breaks old files."""


class Guess(NamedTuple):
    """A guess, and the facts about it used as contexts."""

    at: Index  # (2,) the guess
    back: Index  # (2,) how far it is drawn back where such guesses overshoot
    # (3,) kind (AROUND, ...); number of guesses averaged; their spread, u and v added.
    facts: Index
    low: Index  # (2,) least u and v of the guesses in the mean
    high: Index  # (2,) largest u and v of the guesses in the mean


class Known(NamedTuple):
    """Nodes known so far."""

    values: Index  # (N, 2) coordinates
    there: NDArray[np.bool_]  # (N,) whether they are known
    sizes: Index  # (N,) distance from their guess, u and v added


def no_guess() -> Guess:
    """Return an empty guess."""
    return Guess(*(np.zeros(size, dtype=np.int64) for size in (2, 2, 3, 2, 2)))


@compiled
def make_guess(corners: Corners, known: Known, corner: int, last: int, guess: Guess) -> None:
    """Guess the coordinates at a corner; `last` is the last known node, -1 for none."""
    node, twin, values, there = corners.node, corners.twin, known.values, known.there
    x = node[corner]
    for i in range(2):
        guess.at[i] = guess.back[i] = 0
    count = 0
    for place in range(corners.around_starts[x], corners.around_starts[x + 1]):
        other = corners.around[place]
        a, b = before(corners, other), after(corners, other)
        across = after(corners, b)
        size = corners.starts[corners.polygon[other] + 1] - corners.starts[corners.polygon[other]]
        if size == 3 and twin[b] >= 0:
            across = before(corners, twin[b])
        elif size != 4:
            continue
        if there[node[a]] and there[node[b]] and there[node[across]] and node[across] != x:
            for i in range(2):
                both = values[node[a], i] + values[node[b], i]
                guess.back[i] += both - values[node[across], i] - (both >> 1)
                _add(guess, i, both - values[node[across], i], count)
            count += 1
    guess.facts[0] = AROUND
    if count:
        for i in range(2):
            guess.back[i] = 3 * (guess.back[i] // count) >> 3
    else:
        guess.facts[0] = BEYOND
        a, b = before(corners, corner), after(corners, corner)
        for side in range(2):
            beside, edge = (node[a], twin[before(corners, a)]) if side == 0 else (node[b], twin[b])
            if edge < 0 or not there[beside]:
                continue
            beyond = node[before(corners, edge) if side == 0 else after(corners, after(corners, edge))]
            if there[beyond]:
                for i in range(2):
                    _add(guess, i, 2 * values[beside, i] - values[beyond, i], count)
                count += 1
        if not count:
            guess.facts[0] = BESIDE
            for beside in (node[a], node[b]):
                if there[beside]:
                    for i in range(2):
                        _add(guess, i, values[beside, i], count)
                    count += 1
        if not count:
            guess.facts[0] = ANYWHERE
            for i in range(2):
                _add(guess, i, values[last, i] if last >= 0 else 0, 0)
            count = 1
    guess.facts[1] = count
    guess.facts[2] = guess.high[0] - guess.low[0] + guess.high[1] - guess.low[1]
    for i in range(2):
        guess.at[i] = (2 * guess.at[i] + count) // (2 * count)


@compiled
def _add(guess: Guess, i: int, value: int, count: int) -> None:
    """Add one of the guesses to be averaged."""
    guess.at[i] += value
    guess.low[i] = min(guess.low[i], value) if count else value
    guess.high[i] = max(guess.high[i], value) if count else value
