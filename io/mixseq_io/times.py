"""Times of frames that files hold in single precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_EARLY = 2.0  # seconds; exporters compute earlier times from later ones


def on_grid(times: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return times ``(T,)``, those that are ``k / fps`` but for float32 rounding as exactly that.

    Rounding is up to two steps of float32 at the time, at 2 s where it is earlier. Times that do not fall on the grid
    stay as they are, and all do where two would become one.

    Examples
    --------
    >>> rounded = np.array([0, 1 / 24, 49 / 48, 1.05], np.float32).astype(np.float64)
    >>> on_grid(rounded, 48).tolist() == [0, 1 / 24, 49 / 48, rounded[3]]
    True
    """
    with np.errstate(all="ignore"):  # what is not finite is told where the times are used
        nearest = np.rint(times * fps) / fps
        rounding = 2 * np.spacing(np.maximum(np.abs(times), _EARLY).astype(np.float32)).astype(np.float64)
        snapped = np.where(np.abs(nearest - times) <= rounding, nearest, times)
        return snapped if (np.diff(snapped) > 0).all() else times
