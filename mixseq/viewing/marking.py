"""Immutable state of setting markers: pairs, a begun pair, skipped proposals, and the undo history.

`mixseq.viewing.marking_session` holds the current state.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Float
from mixseq.correspondence.markers import Markers

SOURCE, TARGET = 0, 1
"""Indices of the two sides."""

SAME = 0.03
"""Distance on either side below which a proposal equals a pair, in diagonals."""


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
        """Make the state of initial markers."""
        names = markers.names or ("",) * len(markers)
        rows = zip(markers.source.tolist(), markers.target.tolist(), names, strict=True)
        return cls(tuple(Pair((source, target), name) for source, target, name in rows))

    @property
    def markers(self) -> Markers:
        """The pairs as markers."""
        names = tuple(pair.name for pair in self.pairs)
        vertices = np.array([pair.vertices for pair in self.pairs], np.int64).reshape(-1, 2)
        return Markers.of(vertices, names if any(names) else ())

    def clicked(self, side: int, vertex: int) -> Marking:
        """Return the state after a click: the chosen pair is moved there; else a pair begins, or is complete."""
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
        """Return the state with another pair."""
        return replace(self, pairs=(*self.pairs, pair))

    def choosing(self, number: int) -> Marking:
        """Return the state with a pair chosen, or released if it was chosen."""
        return replace(self, chosen=None if number == self.chosen else number)

    def without_chosen(self) -> Marking:
        """Return the state without the chosen pair, or without the begun one if none is chosen."""
        if self.chosen is None:
            return replace(self, begun=None)
        pairs = (*self.pairs[: self.chosen], *self.pairs[self.chosen + 1 :])
        return replace(self, pairs=pairs, chosen=None)

    def skipping(self, pair: Pair) -> Marking:
        """Return the state with a rejected proposal."""
        return replace(self, skipped=self.skipped | {pair.vertices})


@dataclass(frozen=True)
class MarkingHistory:
    """States and the index of the current one; immutable."""

    states: tuple[Marking, ...]
    now: int = 0

    @property
    def marking(self) -> Marking:
        """The current state."""
        return self.states[self.now]

    def done(self, marking: Marking) -> MarkingHistory:
        """Return the history after a step; undone steps are dropped, and a mere choice is no step."""
        if replace(marking, chosen=None) == replace(self.marking, chosen=None):
            return MarkingHistory((*self.states[: self.now], marking, *self.states[self.now + 1 :]), self.now)
        return MarkingHistory((*self.states[: self.now + 1], marking), self.now + 1)

    def undone(self) -> MarkingHistory:
        """Return the history one step back, or unchanged at its start."""
        return MarkingHistory(self.states, max(self.now - 1, 0))

    def redone(self) -> MarkingHistory:
        """Return the history one step ahead, or unchanged at its end."""
        return MarkingHistory(self.states, min(self.now + 1, len(self.states) - 1))


@dataclass(frozen=True, eq=False)
class Places:
    """Vertices of both meshes, in diagonals of each."""

    points: tuple[Float, Float]  # ((V, 3), (V', 3) source and target

    @classmethod
    def of(cls, source: Float, target: Float) -> Places:
        """Scale points ``(V, 3)`` and ``(V', 3)`` to diagonals."""
        one, two = (x / (float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0) for x in (source, target))
        return cls((one, two))

    def near(self, one: Pair, other: Pair) -> bool:
        """Whether two pairs coincide on either side."""
        return any(
            float(np.linalg.norm(x[a] - x[b])) <= SAME
            for x, a, b in zip(self.points, one.vertices, other.vertices, strict=True)
        )

    def proposals(self, marking: Marking, candidates: Iterable[Pair]) -> tuple[Pair, ...]:
        """Return the candidates, in order, without duplicates, set pairs and skipped ones."""
        found: list[Pair] = []
        for each in candidates:
            there = any(self.near(each, other) for other in (*marking.pairs, *found))
            if not there and each.vertices not in marking.skipped:
                found.append(each)
        return tuple(found)
