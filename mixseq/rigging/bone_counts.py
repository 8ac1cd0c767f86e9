"""As few bones as an error asks for.

Rough fits of free bones, in a few rounds, tell how the error falls with their number, and what is found at one number
how far all of them are off. So the number that should do is fitted, and then the one that is a tenth less: mostly it
does not do. Free bones that are clearly too far off are not hung into a tree, which takes them a little nearer at best.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.rigging.centred import Centred
from mixseq.rigging.rigs import Skin

MOST_BONES = 128
"""What more bones are tried for seldom ends; values here are ours."""

_FIRST = 8
_CLOSE = 10  # one in so many bones may be too many
_CONVERGED = 0.8  # of the error of a rough fit is left when it is done, until one is
_GUESSED = 4  # numbers are tried that rough fits tell; then those in the middle
_NEARER = 1.2  # free bones are hung if they are so many times too far off: up to 1.13 has been seen to become enough
_NONE = 1e-300


def fewest_bones(
    roughly: Callable[[int], float],
    free: Callable[[int], float],
    hung: Callable[[int], tuple[Skin, float]],
    wanted: float,
    most: int,
) -> tuple[Skin, float]:
    """Return a skin with the fewest bones that reaches an error, to within a tenth, and the error that it has."""
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
    """Return the number of bones above `few` whose rough fit is good enough, to within a tenth; `most` if none is."""
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
