"""Progress callbacks of long work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[int, int, str], None]
"""Called with (steps done, total steps, description of the work)."""


def silent(done: int, total: int, what: str) -> None:
    """Ignore progress."""


@dataclass(frozen=True)
class Stages:
    """Progress of several stages as one."""

    progress: Progress  # called for all of them
    count: int  # number of stages
    frames: int  # steps of every stage

    def at(self, first: int, stages: int = 1) -> Progress:
        """Return the progress callback of one stage, or of several."""

        def tell(done: int, total: int, what: str) -> None:
            self.progress(
                first * self.frames + stages * self.frames * done // total, self.count * self.frames, what
            )

        return tell
