r"""Find stances: when the feet of the source are on the ground.

From frame to frame every point of a contact moves at a speed v, the mean over its points. A *step* between two frames
is at rest if both its speed and its height z above the lowest are small,

.. math:: v < \max(a\, v_{95},\ a_0\, d), \qquad z - z_0 < \max(b\, (z_1 - z_0),\ b_0\, d),

where :math:`v_{95}` is the speed that 95 % of the steps stay below, :math:`z_0` and :math:`z_1` are the lowest and the
highest height, and d is the size of the body. So the thresholds follow the motion, and contacts that hardly move rest.
A run of steps is a stance if all of them are at rest by the wide thresholds and one of them by the narrow ones
(hysteresis: Canny 1986 does so along edges). It joins at least two frames.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import FloatArray, Mask
from mixseq.errors import SettingsError

FASTEST = 95.0
"""Percentile of speeds that counts as the fastest, against outliers."""


@dataclass(frozen=True)
class StanceSettings:
    """Thresholds, narrow and wide."""

    speed: tuple[float, float] = (0.05, 0.1)  # of speeds, as fractions of the contact's fast speed
    # Of speeds, in sizes of the body per second; these are at rest in any motion.
    still: tuple[float, float] = (0.01, 0.02)
    height: tuple[float, float] = (0.15, 0.3)  # of heights, as fractions of the contact's range of heights
    # Of heights, in sizes of the body; these are on the ground in any motion.
    ground: tuple[float, float] = (0.005, 0.01)

    def __post_init__(self) -> None:
        for name in ("speed", "still", "height", "ground"):
            narrow, wide = getattr(self, name)
            if not 0 <= narrow <= wide < np.inf:
                raise SettingsError(
                    f"the thresholds of {name} are {narrow:g} and {wide:g}; give two finite numbers, the narrow one "
                    "first and not negative"
                )


@dataclass(frozen=True)
class Stance:
    """A contact at rest."""

    group: str  # name of the contact
    start: int  # first frame
    stop: int  # frame after the last

    @property
    def frames(self) -> slice:
        """Slice of the frames."""
        return slice(self.start, self.stop)


def stances(
    group: str,
    trajectory: FloatArray,
    up: str,
    fps: float,
    size: float,
    settings: StanceSettings | None = None,
) -> tuple[Stance, ...]:
    """Find disjoint stances of a contact with points ``(T, k, 3)``, in order.

    `up` is the upward axis, `size` the diagonal of the body in the units of the points. A single frame, or a contact
    that never moves, is one stance.
    """
    settings = settings or StanceSettings()
    path = np.asarray(trajectory, dtype=np.float64)
    if path.ndim != 3 or path.shape[2] != 3 or 0 in path.shape or not np.isfinite(path).all():
        raise SettingsError(
            f"the path of contact '{group}' has shape {path.shape}; finite points (T, k, 3) of at least one frame and "
            "one vertex are expected"
        )
    if not (0 < fps < np.inf and 0 < size < np.inf):
        raise SettingsError(f"fps is {fps:g} and size is {size:g}; positive numbers are expected")
    if len(path) == 1:
        return (Stance(group, 0, 1),)
    speeds = fps * np.linalg.norm(np.diff(path, axis=0), axis=2).mean(axis=1)
    heights = path[:, :, axis_of(up)].mean(axis=1)
    heights = heights - heights.min()
    above = np.maximum(heights[1:], heights[:-1])  # of a step: where it is farther from the ground
    fast = np.percentile(speeds, FASTEST)

    def at_rest(which: int) -> Mask:
        slow = max(settings.speed[which] * fast, settings.still[which] * size)
        low = max(settings.height[which] * heights.max(), settings.ground[which] * size)
        return np.asarray((speeds < slow) & (above < low))

    narrow, wide = at_rest(0), at_rest(1)
    edges = np.flatnonzero(np.diff(wide, prepend=False, append=False))
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return tuple(Stance(group, first, last + 1) for first, last in runs if narrow[first:last].any())


def axis_of(up: str) -> int:
    """Return the number of an axis."""
    if up not in ("X", "Y", "Z"):
        raise SettingsError(f"the up axis is {up!r}; X, Y or Z is expected")
    return "XYZ".index(up)
