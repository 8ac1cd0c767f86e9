"""Types of arrays and paths for signatures, and evenly spaced row numbers."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Float", "FloatArray", "Index", "IntArray", "Mask", "PathLike", "Single", "evenly"]

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

FloatArray = NDArray[np.floating[Any]]
"""Numbers in single or double precision, as files have them."""

IntArray = NDArray[np.integer[Any]]
"""Whole numbers of any width."""

PathLike = str | os.PathLike[str]
"""A file, as text or as a path."""


def evenly(count: int, at_most: int) -> Index:
    """Choose numbers from 0 to below a count, evenly spread: all, or so many with the first and the last.

    Examples
    --------
    >>> evenly(3, 5).tolist(), evenly(10, 4).tolist()
    ([0, 1, 2], [0, 3, 6, 9])
    """
    return np.unique(np.linspace(0, count - 1, min(count, at_most)).round().astype(np.int64))
