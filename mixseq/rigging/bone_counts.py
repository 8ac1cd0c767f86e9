"""Find the smallest number of bones for an error.

Rough fits of free bones, in a few rounds, give the error as a function of their number; a full fit at one number
calibrates them all. The predicted number is fitted, and then one a tenth smaller, which mostly fails. Free bones with
a clearly too large error are not built into a tree, which reduces it a little at best.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.rigging.centred import Centred
from mixseq.rigging.rigs import Skin

MOST_BONES = 128
"""Largest number of bones that is tried; constants here were chosen empirically."""

_FIRST = 8
_CLOSE = 10  # the count may be too large by 1 / _CLOSE
_CONVERGED = 0.8  # assumed ratio of errors of full to rough fits, before the first full one
_GUESSED = 4  # fits at numbers predicted by rough fits; then bisection
_NEARER = 1.2  # largest error of free bones, relative to the target, that a tree may reduce enough; 1.13 was observed
_NONE = 1e-300


def fewest_bones(
    roughly: Callable[[int], float],
    free: Callable[[int], float],
    hung: Callable[[int], tuple[Skin, float]],
    wanted: float,
    most: int,
) -> tuple[Skin, float]:
    """Return a skin with the fewest bones that reaches an error, to within a tenth, and its error."""
    few, enough, left, tries = 0, most + 1, _CONVERGED, 0
    best: tuple[Skin, float] | None = None
    tried: tuple[Skin, float] | None = None
    while few < most and (best is None or enough - few > _margin(enough)):
        last = enough - _margin(enough) if best else most
        count = min(
            last,
            max(
                _promising(roughly, few, last, wanted / max(left, _NONE)), few + (1 if best else _margin(few))
            ),
        )
        if tries >= _GUESSED:
            count = (few + enough) // 2 if best else min(2 * few, most)
        tries += 1
        error = free(count)
        tried = hung(count) if error <= _NEARER * wanted else None
        left = (tried[1] if tried else error) / max(roughly(count), _NONE)
        if tried and tried[1] <= wanted:
            best, enough = tried, count
        else:
            few = count
    return best or tried or hung(most)


def _margin(count: int) -> int:
    return 1 + count // _CLOSE


def _promising(roughly: Callable[[int], float], few: int, most: int, wanted: float) -> int:
    """Return the number of bones above `few` with a sufficient rough fit, to within a tenth; `most` if none has."""
    count = min(max(_FIRST, few + 1), most)
    while roughly(count) > wanted:
        if count == most:
            return most
        few, count = count, min(2 * count, most)
    while count - few > _margin(count):
        middle = (few + count) // 2
        if roughly(middle) <= wanted:
            count = middle
        else:
            few = middle
    return count


def errors(skin: Skin, sequence: Centred) -> tuple[float, float]:
    r"""Return the largest distance from a sequence in diagonals, and the KG error in percent.

    .. math:: KG = 100 \frac{\lVert y - x \rVert_F}{\lVert x - \bar x \rVert_F}
    """
    largest = squares = spread = 0.0
    for frame, shown in enumerate(skin.blocks(1)):
        off = np.square(shown[0] - sequence.points[frame]).sum(axis=1)
        largest, squares = max(largest, float(off.max())), squares + float(off.sum())
        spread += float(np.square(sequence.points[frame] - sequence.centres[frame]).sum())
    return float(np.sqrt(largest)) / sequence.diagonal, 100 * float(np.sqrt(squares / (spread or 1.0)))
