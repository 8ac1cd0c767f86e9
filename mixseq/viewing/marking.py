"""Markers while a person sets them: pairs, the point that was clicked first, what was skipped, and the steps back.

Everything here is a value; `mixseq.viewing.marking_session` keeps the one of now.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Float
from mixseq.correspondence.markers import Markers

SOURCE, TARGET = 0, 1
"""The two sides."""

SAME = 0.03
"""A proposal that is so near to a pair, on either side, is that pair, in diagonals; ours."""


@dataclass(frozen=True)
class Pair:
    """A vertex of the source and one of the target."""

    vertices: tuple[int, int]  # the two
    name: str = ""  # what the file calls it; may be empty


@dataclass(frozen=True)
class Marking:
    """Pairs that are set."""

    pairs: tuple[Pair, ...] = ()  # in the order in which they are numbered
    begun: tuple[int, int] | None = None  # side and vertex of a point whose partner is not clicked yet
    chosen: int | None = None  # the pair that the next click moves, or that can be deleted
    skipped: frozenset[tuple[int, int]] = frozenset()  # vertices of proposals that were not wanted

    @classmethod
    def of(cls, markers: Markers) -> Marking:
        """Begin with markers."""
        names = markers.names or ("",) * len(markers)
        rows = zip(markers.source.tolist(), markers.target.tolist(), names, strict=True)
        return cls(tuple(Pair((source, target), name) for source, target, name in rows))

    @property
    def markers(self) -> Markers:
        """The pairs that are set."""
        names = tuple(pair.name for pair in self.pairs)
        vertices = np.array([pair.vertices for pair in self.pairs], np.int64).reshape(-1, 2)
        return Markers.of(vertices, names if any(names) else ())

    def clicked(self, side: int, vertex: int) -> Marking:
        """Return what comes of a click: the chosen pair is moved there; else a pair begins, or is complete."""
        if self.chosen is not None:
            pair = self.pairs[self.chosen]
            vertices = (vertex, pair.vertices[1]) if side == SOURCE else (pair.vertices[0], vertex)
            pairs = list(self.pairs)
            pairs[self.chosen] = replace(pair, vertices=vertices)
            return replace(self, pairs=tuple(pairs), chosen=None)
        if self.begun is None or self.begun[0] == side:
            return replace(self, begun=(side, vertex))
        first = self.begun[1]
        return replace(
            self.with_pair(Pair((vertex, first) if side == SOURCE else (first, vertex))), begun=None
        )

    def with_pair(self, pair: Pair) -> Marking:
        """Return it with a pair more."""
        return replace(self, pairs=(*self.pairs, pair))

    def choosing(self, number: int) -> Marking:
        """Return it with a pair chosen; none, if that was chosen before."""
        return replace(self, chosen=None if number == self.chosen else number)

    def without_chosen(self) -> Marking:
        """Return it without the chosen pair; without the point that begins one, if none is chosen."""
        if self.chosen is None:
            return replace(self, begun=None)
        pairs = (*self.pairs[: self.chosen], *self.pairs[self.chosen + 1 :])
        return replace(self, pairs=pairs, chosen=None)

    def skipping(self, pair: Pair) -> Marking:
        """Return it with a proposal that is not wanted."""
        return replace(self, skipped=self.skipped | {pair.vertices})


@dataclass(frozen=True)
class MarkingHistory:
    """States, and which of them is seen; every change is a new history."""

    states: tuple[Marking, ...]
    now: int = 0

    @property
    def marking(self) -> Marking:
        """The state that is seen."""
        return self.states[self.now]

    def done(self, marking: Marking) -> MarkingHistory:
        """Return the history after a step; what had been undone is gone. What is merely chosen is no step."""
        if replace(marking, chosen=None) == replace(self.marking, chosen=None):
            return MarkingHistory((*self.states[: self.now], marking, *self.states[self.now + 1 :]), self.now)
        return MarkingHistory((*self.states[: self.now + 1], marking), self.now + 1)

    def undone(self) -> MarkingHistory:
        """Return the history one step back; at its begin as it is."""
        return MarkingHistory(self.states, max(self.now - 1, 0))

    def redone(self) -> MarkingHistory:
        """Return the history one step ahead; at its end as it is."""
        return MarkingHistory(self.states, min(self.now + 1, len(self.states) - 1))


@dataclass(frozen=True, eq=False)
class Places:
    """Where the vertices of both meshes are, in diagonals of each."""

    points: tuple[Float, Float]  # ((V, 3), (V', 3) source and target

    @classmethod
    def of(cls, source: Float, target: Float) -> Places:
        """Measure in diagonals of the meshes ``(V, 3)`` and ``(V', 3)``."""
        one, two = (x / (float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0) for x in (source, target))
        return cls((one, two))

    def near(self, one: Pair, other: Pair) -> bool:
        """Whether two pairs are the same on either side."""
        return any(
            float(np.linalg.norm(x[a] - x[b])) <= SAME
            for x, a, b in zip(self.points, one.vertices, other.vertices, strict=True)
        )

    def proposals(self, marking: Marking, candidates: Iterable[Pair]) -> tuple[Pair, ...]:
        """Return the candidates, in their order, that are neither set nor skipped, nor there twice."""
        found: list[Pair] = []
        for each in candidates:
            there = any(self.near(each, other) for other in (*marking.pairs, *found))
            if not there and each.vertices not in marking.skipped:
                found.append(each)
        return tuple(found)
