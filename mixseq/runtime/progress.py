"""Progress callbacks of long work, and mixseq's warnings forwarded to a display."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from mixseq.errors import MixseqWarning

Progress = Callable[[int, int, str], None]
"""Callback of (steps done, total steps, description of the work)."""


def log_progress(done: int, total: int, what: str) -> None:
    """Log finished work to the logger ``mixseq``, at level DEBUG."""
    if done == total:
        import logging  # import mixseq stays lean

        logging.getLogger("mixseq").debug("%s: done (%d)", what, total)


@dataclass(frozen=True)
class StagedProgress:
    """A single progress report for several stages with the same number of steps."""

    progress: Progress  # callback of all stages
    count: int  # number of stages
    frames: int  # steps of every stage, usually frames

    def at(self, first: int, stages: int = 1) -> Progress:
        """Return the progress callback of stage `first`, or of several as one."""

        def report(done: int, total: int, what: str) -> None:
            self.progress(first * self.frames + stages * self.frames * done // total, self.count * self.frames, what)

        return report


@contextmanager
def forward_warnings(receive: Callable[[str], None], replace: bool = False) -> Iterator[None]:
    """Pass the text of every `MixseqWarning` to a function; with `replace`, do not show the warning as well."""
    original: Callable[..., None] = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *args: Any, **kwargs: Any) -> None:
        is_own = issubclass(category, MixseqWarning)
        if not (is_own and replace):
            original(message, category, *args, **kwargs)
        if is_own:
            receive(str(message))

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = original
