"""Decoding on one thread and on two: how much faster, and that not a bit differs."""

from __future__ import annotations

import hashlib
import time

import mixseq
from scripts.benchmarks.common.animations import animation
from scripts.benchmarks.common.section import Bar, Say, Section, Table, at_least
from scripts.benchmarks.common.timing import Timing
from scripts.benchmarks.speeds.playback import RANK, play

NAMES = ("horse_gallop", "elephant_gallop")
RUNS = 7
TARGET = 1.6


def measure(say: Say) -> Section:
    """Measure all animations; runs on one and on two threads take turns, so that a slow moment hits both."""
    columns = ("sequence", "1 thread s", "2 threads s", "ratio", "equal bits")
    rows: list[tuple[str, ...]] = []
    section = Section("Threads", [Table(f"All frames, rank {RANK}, anchored.", columns, rows)])
    for name in NAMES:
        say(f"{name}: fit")
        model = mixseq.fit(animation(name), rank=RANK)
        sums = {threads: _sum(model, threads) for threads in (1, 2)}
        runs: dict[int, list[float]] = {1: [], 2: []}
        for number in range(RUNS):
            say(f"{name}: decode, run {number + 1} of {RUNS}")
            for threads, seconds in runs.items():
                start = time.perf_counter()
                play(model, threads)
                seconds.append(time.perf_counter() - start)
        one, two = (Timing(tuple(runs[threads])) for threads in (1, 2))
        ratio, same = one.median / two.median, sums[1] == sums[2]
        rows.append((name, one.text(), two.text(), f"{ratio:.3g}", "yes" if same else "NO"))
        section.targets.append(at_least(f"{name}: speed-up of 2 threads", ratio, TARGET))
        section.targets.append(at_least(f"{name}: equal bits (1 = yes)", float(same), 1))
        section.bars.append(Bar(f"{name}, 2 threads", ratio, TARGET))
        section.figures.append({"sequence": name, "seconds": runs, "sha256": sums})
    return section


def _sum(model: mixseq.Model, threads: int) -> str:
    digest = hashlib.sha256()
    for block in play(model, threads):
        digest.update(block.tobytes())
    return digest.hexdigest()
