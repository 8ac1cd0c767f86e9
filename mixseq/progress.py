"""How long work tells how far it is: a callback, so that the core prints nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[int, int, str], None]
"""Called with (steps done, steps in all, what is being done)."""


def silent(done: int, total: int, what: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True)
class Stages:
    """Progress of several stages as one."""

    progress: Progress  # told about all of them
    count: int  # number of stages
    frames: int  # steps of every stage

    def at(self, first: int, stages: int = 1) -> Progress:
        """Return what tells how far one stage is, or several of them."""

        def tell(done: int, total: int, what: str) -> None:
            self.progress(
                first * self.frames + stages * self.frames * done // total, self.count * self.frames, what
            )

        return tell
