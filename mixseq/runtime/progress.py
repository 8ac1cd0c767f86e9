"""Progress callbacks of long work, and mixseq's warnings forwarded to a display."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mixseq.errors import MixseqWarning

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


@contextmanager
def warnings_heard(hear: Callable[[str], None], instead: bool = False) -> Iterator[None]:
    """Call a function with the text of every `MixseqWarning`."""
    usual: Callable[..., None] = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        ours = issubclass(category, MixseqWarning)
        if not (ours and instead):
            usual(message, category, *where, **more)
        if ours:
            hear(str(message))

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual
