"""The search for a step, and for factors and parts, that make few bytes.

What is spoiled grows with the step, what is said shrinks; the step is found by secants on logarithms, because both are
nearly powers of it. With a bound on every vertex there is a choice: few corrections of an accurate basis, or many
of a coarse one; the cheapest of some steps is taken.

At the first step both kinds of factors are tried, and more and more parts as long as bytes become fewer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mixseq.coding.attempt import Attempt, attempt
from mixseq.coding.coded import FactorName
from mixseq.coding.factors import Factors, factor
from mixseq.coding.graph import SignalGraph
from mixseq.coding.joining import vertex_parts
from mixseq.coding.parts import Part, parts_of, whole
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore
from mixseq.progress import Stages

ROUNDS = 8
"""Steps that are tried at most."""

CLOSE = 0.01
"""An error, or a size, may be below what was asked for by this share."""

SLOPE = 0.6
"""About the power of the error with which sizes fall."""

FIRST = 0.002
"""Error with which the search for a size begins, relative to the spread."""

RATIO = 0.3
"""Error with which the search for a bound begins: root mean square, relative to the bound."""

FACTOR = 1.5
"""Ratio of the steps that are tried for a bound."""

SHAPES = 2.0
"""Shapes are tried unless they have so many more bits, unpredicted: they are predicted better, but not that much."""

NEARLY = 1.04
"""The best two are tried with several steps, if their sizes at the first step are so near."""

PARTS = (3, 6, 12)
"""So many parts are tried, one number after the other, as long as bytes become fewer."""

FACTORS: tuple[FactorName, ...] = ("trajectories", "shapes")


@dataclass(frozen=True, eq=False)
class Tried:
    """Factors of the parts of a sequence, all of one kind, and the first attempt with them."""

    factors: tuple[Factors, ...]
    parts: tuple[Part, ...]
    last: Attempt


class Search:
    """Attempts with several steps."""

    def __init__(self, sequence: FrameStore, graph: SignalGraph, stages: Stages) -> None:
        self._sequence = sequence
        self._graph = graph
        self._stages = stages
        self._count = len(sequence.points) * sequence.points.shape[1]
        self._rounds = 0

    def _try(self, tried: Tried, step: float, bound: float | None = None, dry: bool = False) -> Attempt:
        return self._attempt(tried.factors, tried.parts, step, bound, dry)

    def _attempt(
        self,
        factors: tuple[Factors, ...],
        parts: tuple[Part, ...],
        step: float,
        bound: float | None,
        dry: bool = False,
    ) -> Attempt:
        self._stages.at(1 + min(self._rounds, ROUNDS - 1))(0, 1, "choosing the step")
        self._rounds += 1
        return attempt(self._sequence, factors, step, parts, self._graph, bound, dry)

    def _first(self, error: float, bound: float | None = None) -> list[Tried]:
        """Try factors of both kinds, and of several parts, with steps that should make an error.

        Returns
        -------
        list of Tried
            Those that may be the best.
        """
        tried: list[Tried] = []
        bits = np.inf
        for name in FACTORS:
            factors = (factor(self._sequence, name, _least(self._sequence, name, error)),)
            step = _guess(factors, error)
            if _bits(factors[0], step) < SHAPES * bits:
                parts = whole(self._graph)
                tried.append(Tried(factors, parts, self._attempt(factors, parts, step, bound)))
            bits = _bits(factors[0], step)

        def size(one: Tried) -> float:
            # With corrections errors are the same, without them sizes are as they would be if errors were.
            return one.last.size * (1.0 if bound else (one.last.error / error) ** SLOPE)

        best = min(map(size, tried))
        for several in self._several(error, bound):
            tried.append(several)
            if size(several) > best:
                break
            best = size(several)
        return [one for one in sorted(tried, key=size)[:2] if size(one) <= NEARLY * best]

    def _several(self, error: float, bound: float | None) -> Iterator[Tried]:
        """Try more and more parts, each with trajectories of its own."""
        for labels in vertex_parts(self._sequence, PARTS).values():
            parts = parts_of(labels, self._sequence.header.faces)
            least = _least(self._sequence, "trajectories", error)
            factors = tuple(factor(self._sequence, "trajectories", least, part.vertices) for part in parts)
            yield Tried(factors, parts, self._attempt(factors, parts, _guess(factors, error), bound))

    def with_error(self, error: float) -> Attempt:
        """Find the coarsest step whose error is below a given one (root of the sum of squares)."""
        found: list[Attempt] = []
        for tried in self._first(error):
            best = _closest(
                partial(self._try, tried, dry=True),
                lambda one: error / max(one.error, 1e-9 * error),
                tried.last,
                1.0,
            )
            if best is not None:
                found.append(best if best is tried.last else self._try(tried, best.step))
        if not found:  # frames were left out of the factors: corrections make good for them
            return self.within(error / self._count**0.5)
        return min(found, key=lambda one: one.size)

    def with_size(self, size: int, spread: float) -> Attempt:
        """Find the finest step that fits into a number of bytes; the search begins with 0.2 % of the spread."""
        found: list[Attempt] = []
        for tried in self._first(FIRST * spread):
            best = _closest(partial(self._try, tried), lambda one: size / one.size, tried.last, -SLOPE)
            if best is not None:
                found.append(best)
        if not found:
            raise SettingsError(f"the signals do not fit into {size} bytes; give more")
        return min(found, key=lambda one: one.error)

    def within(self, bound: float) -> Attempt:
        """Find the cheapest of some steps with corrections that keep a bound, in the units of the sequence."""
        tried = min(self._first(RATIO * bound * self._count**0.5, bound), key=lambda one: one.last.size)
        best = tried.last
        for direction in (FACTOR, 1 / FACTOR):
            found = False
            while self._rounds < ROUNDS + len(PARTS):
                other = self._try(tried, best.step * direction, bound)
                if other.size >= best.size:
                    break
                best, found = other, True
            if found:
                break
        return best


def _closest(
    attempt_with: Callable[[float], Attempt], room: Callable[[Attempt], float], first: Attempt, slope: float
) -> Attempt | None:
    """Return the attempt with least room that is not below one, after some secants."""
    best, last, before = None, first, None
    for number in range(ROUNDS):
        left = room(last)
        if left >= 1 and (best is None or left < room(best)):
            best = last
        if number == ROUNDS - 1 or 1 <= left < 1 + CLOSE:
            break
        if before is not None and last.step != before.step and room(before) != left:
            measured = np.log(room(before) / left) / np.log(last.step / before.step)
            if 0.2 * abs(slope) < measured * np.sign(slope) < 5 * abs(slope):
                slope = float(measured)
        aim = left / (1 + CLOSE / 3)
        before, last = last, attempt_with(last.step * float(np.clip(aim ** (1 / slope), 0.05, 20.0)))
    return best


def _least(sequence: FrameStore, name: FactorName, error: float) -> float:
    """Norm of fields that are not worth looking at, if all of them together shall make an error."""
    rows = 3 if name == "trajectories" else 1
    return 0.1 * error / float(np.sqrt(rows * len(sequence.points)))


def _guess(factors: Sequence[Factors], error: float) -> float:
    """Return the step whose error is about a given one: s^2 / 12 for every number above it, all of those below."""
    counts = np.repeat(
        [one.fields.shape[1] * one.fields.shape[2] for one in factors], [len(one.sizes) for one in factors]
    )
    squares = np.square(np.concatenate([one.sizes for one in factors]))
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        expected = np.minimum(squares, counts * step**2 / 12).sum()
        low, high = (step, high) if expected < error**2 else (low, step)
    return low


def _bits(factors: Factors, step: float) -> float:
    """Return how many bits fields would cost if nothing were known of them but their norms."""
    count = factors.fields.shape[1] * factors.fields.shape[2]
    return float(count * np.log2(np.maximum(factors.sizes / (step * count**0.5), 1.0)).sum())
