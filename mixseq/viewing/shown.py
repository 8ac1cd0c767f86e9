"""What is shown: meshes that move, started together, over frames at one rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, Single, evenly
from mixseq.frame_store import FrameStore
from mixseq.plots.video.timing import film_times, model_times, nearest_frames
from mixseq.sequence import SequenceHeader
from mixseq.signals import Model


@dataclass(frozen=True)
class Item:
    """A mesh that is shown; equal to others of the same name and the very same motion.

    Attributes
    ----------
    name : str
        What it is called.
    motion : Model or FrameStore
        What moves: a model, which is decoded at any time, or frames, of which the nearest is shown.
    """

    name: str
    motion: Model | FrameStore

    @property
    def header(self) -> SequenceHeader:
        """Everything but the points."""
        return self.motion.header

    def pose(self, elapsed: float) -> Single:
        """Return the points ``(V, 3)`` so many seconds after the first frame; the last ones after the end."""
        times = np.array([elapsed])
        if isinstance(self.motion, Model):
            return self.motion(float(model_times(self.header, times)[0])).astype(np.float32)
        row = int(nearest_frames(self.header, times)[0])
        return np.asarray(self.motion.points[row : row + 1][0], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Shot:
    """Everything that is shown, and when.

    Attributes
    ----------
    items : tuple of Item
        The meshes.
    rate : float, optional
        Frames per second that were asked for; by default those of the first item.
    """

    items: tuple[Item, ...]
    rate: float | None = None

    @cached_property
    def _times(self) -> tuple[Float, float]:
        return film_times([item.header for item in self.items], self.rate)

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._times[1]

    @property
    def count(self) -> int:
        """Frames."""
        return len(self._times[0])

    def checked(self) -> Shot:
        """Return the shot as it is, if there are neither too few frames at its rate nor too many.

        Raises
        ------
        SettingsError
            If there are.
        """
        film_times([item.header for item in self.items], self.rate)
        return self

    def elapsed(self, frame: int) -> float:
        """Return the time of a frame in seconds since the meshes' first ones."""
        return float(self._times[0][frame])

    def frame_at(self, elapsed: float) -> int:
        """Return the frame that is nearest to a time since the first one."""
        return round(min(max(elapsed * self.fps, 0), self.count - 1))

    def with_item(self, index: int, motion: Model) -> Shot:
        """Return the shot with another motion of one of its meshes."""
        items = list(self.items)
        items[index] = replace(items[index], motion=motion)
        return replace(self, items=tuple(items))

    def spread(self, most: int) -> Sequence[int]:
        """Return at most so many frames, evenly spaced, the first one among them."""
        return [int(frame) for frame in evenly(self.count, most)]
