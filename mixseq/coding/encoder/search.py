"""Find the quantisation step, the kind of basis and the parts that make the fewest bytes.

The error grows with the step, the number of bytes shrinks; the step is found by secants on logarithms, because both are
nearly powers of it. With a bound on every vertex there is a choice: few residuals of an accurate basis, or many of a
coarse one; the cheapest of some steps is taken.

At the first step both kinds of basis are tried, and more and more parts as long as bytes become fewer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from mixseq.coding.bitstream.signal_graph import SignalGraph
from mixseq.coding.bitstream.spatial_basis import BasisKind, Part, parts_of, whole
from mixseq.coding.encoder.part_merging import vertex_parts
from mixseq.coding.encoder.principal_components import PrincipalComponents, principal_components
from mixseq.coding.encoder.trial import Trial, try_step
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
"""Error with which the search for a size begins, relative to the deviation."""

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

KINDS: tuple[BasisKind, ...] = ("trajectories", "shapes")


@dataclass(frozen=True, eq=False)
class Candidate:
    """Principal components of the parts of a sequence, all of one kind, and the first trial with them."""

    components: tuple[PrincipalComponents, ...]
    parts: tuple[Part, ...]
    first: Trial


class Search:
    """Trials with several steps."""

    def __init__(self, sequence: FrameStore, graph: SignalGraph, stages: Stages) -> None:
        self._sequence = sequence
        self._graph = graph
        self._stages = stages
        self._count = len(sequence.points) * sequence.points.shape[1]
        self._rounds = 0

    def _try(self, candidate: Candidate, step: float, bound: float | None = None, dry: bool = False) -> Trial:
        return self._trial(candidate.components, candidate.parts, step, bound, dry)

    def _trial(
        self,
        components: tuple[PrincipalComponents, ...],
        parts: tuple[Part, ...],
        step: float,
        bound: float | None,
        dry: bool = False,
    ) -> Trial:
        self._stages.at(1 + min(self._rounds, ROUNDS - 1))(0, 1, "choosing the step")
        self._rounds += 1
        return try_step(self._sequence, components, step, parts, self._graph, bound, dry)

    def _candidates(self, error: float, bound: float | None = None) -> list[Candidate]:
        """Try both kinds of basis, and several parts, with steps that should make an error.

        Returns
        -------
        list of Candidate
            Those that may be the best.
        """
        candidates: list[Candidate] = []
        bits = np.inf
        for kind in KINDS:
            components = (principal_components(self._sequence, kind, _least(self._sequence, kind, error)),)
            step = _guess(components, error)
            if _bits(components[0], step) < SHAPES * bits:
                parts = whole(self._graph)
                candidates.append(Candidate(components, parts, self._trial(components, parts, step, bound)))
            bits = _bits(components[0], step)

        def size(one: Candidate) -> float:
            # With a bound errors are the same, without one sizes are as they would be if errors were.
            return one.first.size * (1.0 if bound else (one.first.error / error) ** SLOPE)

        best = min(map(size, candidates))
        for several in self._several_parts(error, bound):
            candidates.append(several)
            if size(several) > best:
                break
            best = size(several)
        return [one for one in sorted(candidates, key=size)[:2] if size(one) <= NEARLY * best]

    def _several_parts(self, error: float, bound: float | None) -> Iterator[Candidate]:
        """Try more and more parts, each with trajectories of its own."""
        for labels in vertex_parts(self._sequence, PARTS).values():
            parts = parts_of(labels, self._sequence.header.faces)
            least = _least(self._sequence, "trajectories", error)
            components = tuple(
                principal_components(self._sequence, "trajectories", least, part.vertices) for part in parts
            )
            trial = self._trial(components, parts, _guess(components, error), bound)
            yield Candidate(components, parts, trial)

    def with_error(self, error: float) -> Trial:
        """Find the coarsest step whose error is below a given one (root of the sum of squares)."""
        found: list[Trial] = []
        for candidate in self._candidates(error):
            best = _closest(
                partial(self._try, candidate, dry=True),
                lambda one: error / max(one.error, 1e-9 * error),
                candidate.first,
                1.0,
            )
            if best is not None:
                found.append(best if best is candidate.first else self._try(candidate, best.step))
        if not found:  # frames were left out of the components: the residual layer makes good for them
            return self.within(error / self._count**0.5)
        return min(found, key=lambda one: one.size)

    def with_size(self, size: int, deviation: float) -> Trial:
        """Find the finest step that fits into a number of bytes; begin with an error of 0.2 % of the deviation."""
        found: list[Trial] = []
        for candidate in self._candidates(FIRST * deviation):
            best = _closest(
                partial(self._try, candidate), lambda one: size / one.size, candidate.first, -SLOPE
            )
            if best is not None:
                found.append(best)
        if not found:
            raise SettingsError(f"the signals do not fit into {size} bytes; give more")
        return min(found, key=lambda one: one.error)

    def within(self, bound: float) -> Trial:
        """Find the cheapest of some steps whose residual layer keeps a bound, in the units of the sequence."""
        candidates = self._candidates(RATIO * bound * self._count**0.5, bound)
        candidate = min(candidates, key=lambda one: one.first.size)
        best = candidate.first
        for direction in (FACTOR, 1 / FACTOR):
            found = False
            while self._rounds < ROUNDS + len(PARTS):
                other = self._try(candidate, best.step * direction, bound)
                if other.size >= best.size:
                    break
                best, found = other, True
            if found:
                break
        return best


def _closest(
    trial_with: Callable[[float], Trial], room: Callable[[Trial], float], first: Trial, slope: float
) -> Trial | None:
    """Return the trial with least room that is not below one, after some secants."""
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
        before, last = last, trial_with(last.step * float(np.clip(aim ** (1 / slope), 0.05, 20.0)))
    return best


def _least(sequence: FrameStore, kind: BasisKind, error: float) -> float:
    """Norm of components that are not worth looking at, if all of them together shall make an error."""
    rows = 3 if kind == "trajectories" else 1
    return 0.1 * error / float(np.sqrt(rows * len(sequence.points)))


def _guess(components: Sequence[PrincipalComponents], error: float) -> float:
    """Return the step whose error is about a given one: s^2 / 12 for every number above it, all of those below."""
    counts = np.repeat(
        [one.vectors.shape[1] * one.vectors.shape[2] for one in components],
        [len(one.norms) for one in components],
    )
    squares = np.square(np.concatenate([one.norms for one in components]))
    low, high = 1e-12 * error, error
    for _ in range(60):
        step = float(np.sqrt(low * high))
        expected = np.minimum(squares, counts * step**2 / 12).sum()
        low, high = (step, high) if expected < error**2 else (low, step)
    return low


def _bits(components: PrincipalComponents, step: float) -> float:
    """Return how many bits components would cost if nothing were known of them but their norms."""
    count = components.vectors.shape[1] * components.vectors.shape[2]
    return float(count * np.log2(np.maximum(components.norms / (step * count**0.5), 1.0)).sum())
