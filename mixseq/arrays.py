"""Names of the arrays that the code is about, so that signatures say what they hold, and a choice of their rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Float", "FloatArray", "Index", "IntArray", "Mask", "Single", "evenly"]

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

FloatArray = NDArray[np.floating[Any]]
"""Numbers in single or double precision, as files have them."""

IntArray = NDArray[np.integer[Any]]
"""Whole numbers of any width."""


def evenly(count: int, at_most: int) -> Index:
    """Choose numbers from 0 to below a count, evenly spread: all, or so many with the first and the last.

    Examples
    --------
    >>> evenly(3, 5).tolist(), evenly(10, 4).tolist()
    ([0, 1, 2], [0, 3, 6, 9])
    """
    return np.unique(np.linspace(0, count - 1, min(count, at_most)).round().astype(np.int64))
