"""Fit and decode a small walk, twice, in a process of its own: prints seconds and compilations as JSON.

The walk is one of float32 and one of float64: each has compiled functions of its own.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import product
from typing import Literal

import numpy as np
from numba.core.event import Event, Listener, install_listener

import mixseq
from mixseq.creature import walk_cycle

PLACEMENTS: tuple[Literal["anchored", "free"], ...] = "anchored", "free"


def main() -> int:
    walk = walk_cycle(frames=6)
    walks = [walk.with_points(walk.points.astype(precision)) for precision in (np.float32, np.float64)]
    with compilations() as compiled:
        print(json.dumps({"first": steps(walks), "again": steps(walks), "compiled": compiled}))
    return 0


@contextmanager
def compilations() -> Iterator[list[str]]:
    """Collect the names of the functions that numba compiles meanwhile; what it loads from its cache is none."""
    found: list[str] = []

    class Compilations(Listener):
        def on_start(self, event: Event) -> None:
            found.append(event.data["dispatcher"].py_func.__name__)

        def on_end(self, event: Event) -> None:
            pass

    with install_listener("numba:compile", Compilations()):
        yield found


def steps(walks: Iterable[mixseq.MeshSequence]) -> list[float]:
    """Return, walk by walk, the seconds of: fit, decode, decode with velocities; in both placements."""
    seconds = []
    for walk, placement in product(walks, PLACEMENTS):
        start = time.perf_counter()
        model = mixseq.fit(walk, placement=placement)
        fitted = time.perf_counter()
        model.sample()
        sampled = time.perf_counter()
        model.sample(velocities=True)
        seconds += [fitted - start, sampled - fitted, time.perf_counter() - sampled]
    return seconds


if __name__ == "__main__":
    sys.exit(main())
