"""Session of setting markers of two meshes: pairs, undo, proposals, and results of a background thread.

Slow work is queued in the background: suggestions, mirror symmetry of both bodies, and the examination of the current
pairs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.mirroring import Mirror
from mixseq.retargeting.suggestions import Examination, examine_markers, suggest_markers
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq.viewer.playback import Jobs

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
        return Markers.from_pairs(vertices, names if any(names) else ())

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


class MarkingListener(Protocol):
    """Callbacks, called on any thread."""

    def changed(self) -> None:
        """Handle changed pairs, proposals or examinations."""

    def failed(self, what: str, error: Exception) -> None:
        """Handle an error."""


class MarkingSession(Jobs[Callable[[], None]]):
    """Markers of two meshes while they are set."""

    def __init__(
        self, source: MeshSequence, target: MeshSequence, markers: Markers, listener: MarkingListener
    ) -> None:
        self._meshes = source, target
        self._listener = listener
        self._places = Places.of(*(np.asarray(mesh.points[0], np.float64) for mesh in self._meshes))
        self._history = MarkingHistory((Marking.of(markers),))
        self._saved = self.marking.pairs
        self._suggested: tuple[Pair, ...] = ()
        self._mirrors: tuple[Mirror, Mirror] | None = None
        self._mirrored: dict[tuple[int, int], Pair | None] = {}
        self._examined: tuple[tuple[Pair, ...], Examination] | None = None
        self.work = ""
        first = [] if len(markers) else [self._suggest]
        super().__init__(listener.failed, [*first, self._find_mirrors, self._examine])

    # What there is --------------------------------------------------------------------------------------

    @property
    def marking(self) -> Marking:
        """The current state."""
        return self._history.marking

    @property
    def proposals(self) -> tuple[Pair, ...]:
        """Pairs to confirm, the next one first: mirrored ones of the newest pairs, then suggestions."""
        marking = self.marking
        mirrored = (self._mirrored.get(pair.vertices) for pair in reversed(marking.pairs))
        return self._places.proposals(marking, [*filter(None, mirrored), *self._suggested])

    @property
    def examination(self) -> Examination | None:
        """Examination of the current pairs, None until it is computed."""
        found = self._examined
        return found[1] if found is not None and found[0] == self.marking.pairs else None

    @property
    def unsaved(self) -> bool:
        """Whether the pairs differ from those in the file."""
        return self.marking.pairs != self._saved

    def kept(self, pairs: tuple[Pair, ...]) -> None:
        """Mark pairs as saved."""
        self._saved = pairs
        self._listener.changed()

    # What a person does ---------------------------------------------------------------------------------

    def click(self, side: int, vertex: int) -> None:
        """Set a point: a pair begins, is complete, or the chosen one is moved there."""
        self._step(lambda marking: marking.clicked(side, vertex))

    def click_ball(self, side: int, row: int) -> None:
        """Choose the pair, or accept the proposal, whose ball was clicked: pairs come first, then the begun one."""
        marking, proposals = self.marking, self.proposals
        count = len(marking.pairs)
        proposed = row - count - (marking.begun is not None and marking.begun[0] == side)
        if 0 <= row < count:
            self._step(lambda now: now.choosing(row) if row < len(now.pairs) else now)
        elif 0 <= proposed < len(proposals):
            self._step(lambda now: now.with_pair(proposals[proposed]))

    def accept(self) -> None:
        """Set the next proposal."""
        self._step(lambda marking: marking.with_pair(self.proposals[0]) if self.proposals else marking)

    def accept_all(self) -> None:
        """Set all proposals."""
        self._step(lambda marking: replace(marking, pairs=(*marking.pairs, *self.proposals)))

    def skip(self) -> None:
        """Reject the next proposal."""
        self._step(lambda marking: marking.skipping(self.proposals[0]) if self.proposals else marking)

    def delete(self) -> None:
        """Delete the chosen pair, or the begun one."""
        self._step(Marking.without_chosen)

    def undo(self) -> None:
        """Undo the last step."""
        self._go(MarkingHistory.undone)

    def redo(self) -> None:
        """Redo the last undone step."""
        self._go(MarkingHistory.redone)

    def suggest(self) -> None:
        """Suggest markers, including skipped ones."""
        self._step(lambda marking: replace(marking, skipped=frozenset()))
        self._later(self._suggest)

    def _step(self, change: Callable[[Marking], Marking]) -> None:
        self._go(lambda history: history.done(change(history.marking)))

    def _go(self, change: Callable[[MarkingHistory], MarkingHistory]) -> None:
        with self._changed:
            self._history = change(self._history)
        self._mirror_pairs()
        self._listener.changed()
        self._later(self._examine)

    # What is done beside --------------------------------------------------------------------------------

    def _later(self, job: Callable[[], None]) -> None:
        self._add(job, needless=lambda waiting: waiting == job)

    def _do(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Exception as error:
            self._fail("markers", error)
        self._tell("")

    def _tell(self, what: str) -> None:
        self.work = what
        self._listener.changed()

    def _suggest(self) -> None:
        self._tell("looking for markers to suggest")
        found = suggest_markers(*self._meshes)
        self._suggested = Marking.of(found).pairs

    def _find_mirrors(self) -> None:
        self._tell("looking for left and right")
        found = [
            Mirror.from_mesh(mesh.points[0], Topology(mesh.faces, mesh.vertex_count)) for mesh in self._meshes
        ]
        if found[0] is not None and found[1] is not None:
            self._mirrors = found[0], found[1]
            self._mirror_pairs()

    def _mirror_pairs(self) -> None:
        """Find the mirrored pairs of those that are set."""
        if self._mirrors is None:
            return
        for pair in self.marking.pairs:
            if pair.vertices not in self._mirrored:
                source, target = (
                    mirror.find_partner(vertex)
                    for mirror, vertex in zip(self._mirrors, pair.vertices, strict=True)
                )
                both = None if source is None or target is None else Pair((source, target))
                self._mirrored[pair.vertices] = both

    def _examine(self) -> None:
        pairs = self.marking.pairs
        if self._examined is not None and self._examined[0] == pairs:
            return
        if pairs:
            self._tell("finding a map")
            self._examined = pairs, examine_markers(*self._meshes, Marking(pairs).markers)
