"""Triangles that begin with whichever corner, compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def turned(triangles: NDArray[np.integer]) -> list[tuple[int, int, int]]:
    """Let every triangle begin with the corner with which it is the smallest triple."""
    return [min((a, b, c), (b, c, a), (c, a, b)) for a, b, c in triangles.tolist()]
