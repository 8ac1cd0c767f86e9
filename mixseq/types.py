"""Types of arrays and paths, evenly spaced indices, and masks of indices."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Int32 = NDArray[np.int32]
Mask = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]

FloatArray = NDArray[np.floating[Any]]
"""Floating-point arrays of any precision, such as points from files."""

IntArray = NDArray[np.integer[Any]]
"""Integer arrays of any width."""

PathLike = str | os.PathLike[str]
"""Path of a file."""


def evenly_spaced(count: int, max_count: int) -> Index:
    """Return at most `max_count` evenly spaced indices below `count`, with the first and the last."""
    return np.unique(np.linspace(0, count - 1, min(count, max_count)).round().astype(np.int64))


def index_mask(indices: IntArray, count: int) -> Mask:
    """Return the mask ``(count,)`` that is true at indices of any shape."""
    mask = np.zeros(count, dtype=bool)
    mask[indices] = True
    return mask
