"""Times of repeated runs: their median and their spread."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

Result = TypeVar("Result")


@dataclass(frozen=True)
class Timing:
    """Seconds of the runs of one measurement."""

    runs: tuple[float, ...]

    @property
    def median(self) -> float:
        return float(np.median(self.runs))

    def text(self, scale: float = 1.0) -> str:
        """Return the median, with the smallest and largest in brackets: ``0.12 (0.11-0.15, 5 runs)``."""
        median, low, high = (scale * s for s in (self.median, min(self.runs), max(self.runs)))
        if len(self.runs) == 1:
            return f"{median:.3g} (1 run)"
        return f"{median:.3g} ({low:.3g}-{high:.3g}, {len(self.runs)} runs)"


def repeated(
    function: Callable[[], Result], runs: int = 5, budget: float = 30.0, warm: bool = False
) -> tuple[Timing, Result]:
    """Run a function up to `runs` times, but not again once `budget` seconds are spent.

    With `warm` it runs once before, which does not count: it compiles, and analyses what is kept.
    """
    if warm:
        function()
    seconds: list[float] = []
    while not seconds or (len(seconds) < runs and sum(seconds) < budget):
        start = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - start)
    return Timing(tuple(seconds)), result
