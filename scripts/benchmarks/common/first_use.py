"""Fit and decode a small walk, twice, in a process of its own: prints the seconds of all steps as JSON."""

from __future__ import annotations

import json
import sys
import time

import mixseq
from mixseq.creature import walk_cycle


def main() -> int:
    walk = walk_cycle(frames=6)
    print(json.dumps({"first": steps(walk), "again": steps(walk)}))
    return 0


def steps(walk: mixseq.MeshSequence) -> list[float]:
    """Return the seconds of: fit, decode, decode with velocities, fit and decode in the free placement."""
    seconds = []
    for placement in ("anchored", "free"):
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
