"""Names of the arrays that the code is about, so that signatures say what they hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Float", "FloatArray", "Index", "IntArray", "Mask", "Single"]

Float = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

FloatArray = NDArray[np.floating[Any]]
"""Numbers in single or double precision, as files have them."""

IntArray = NDArray[np.integer[Any]]
"""Whole numbers of any width."""
