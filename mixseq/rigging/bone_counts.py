"""As few bones as an error asks for: their number is doubled until they reach it, and then what is between halved."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mixseq.rigging.centred import Centred
from mixseq.rigging.rigs import Skin

MOST_BONES = 128
"""What more bones are tried for seldom ends; values here are ours."""

_FIRST = 8
_CLOSE = 10  # one in so many bones may be too many


def fewest_bones(fit: Callable[[int], Skin], reaches: Callable[[Skin], bool], most: int) -> Skin:
    """Return a skin with the fewest bones that reaches what is asked, to within a tenth.

    Parameters
    ----------
    fit : callable
        Fits a skin of at most so many bones.
    reaches : callable
        Tells whether a skin is good enough.
    most : int
        Number of bones at most; a skin of so many is returned if none is good enough.
    """
    too_few, count = 0, min(_FIRST, most)
    skin = fit(count)
    while not reaches(skin) and count < most:
        too_few, count = count, min(2 * count, most)
        skin = fit(count)
    if not reaches(skin):
        return skin
    while count - too_few > 1 + count // _CLOSE:
        middle = (too_few + count) // 2
        tried = fit(middle)
        if reaches(tried):
            skin, count = tried, middle
        else:
            too_few = middle
    return skin


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
