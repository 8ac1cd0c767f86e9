"""Session of setting markers of two meshes: current state, proposals, and results of a background thread.

Slow work is queued in the background: suggestions, mirror symmetry of both bodies, and the examination of the current
pairs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from mixseq.correspondence.examination import Examination, examine
from mixseq.correspondence.markers import Markers
from mixseq.correspondence.mirroring import Mirror
from mixseq.correspondence.suggestions import suggest_markers
from mixseq.sequence import MeshSequence
from mixseq.topology import Topology
from mixseq.viewing.background import Jobs
from mixseq.viewing.marking import Marking, MarkingHistory, Pair, Places


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

        def all_set(marking: Marking) -> Marking:
            for pair in self.proposals:
                marking = marking.with_pair(pair)
            return marking

        self._step(all_set)

    def skip(self) -> None:
        """Reject the next proposal."""
        self._step(lambda marking: marking.skipping(self.proposals[0]) if self.proposals else marking)

    def delete(self) -> None:
        """Delete the chosen pair, or the begun one."""
        self._step(Marking.without_chosen)

    def undo(self) -> None:
        """Undo the last step."""
        with self._changed:
            self._history = self._history.undone()
        self._went_on()

    def redo(self) -> None:
        """Redo the last undone step."""
        with self._changed:
            self._history = self._history.redone()
        self._went_on()

    def suggest(self) -> None:
        """Suggest markers, including skipped ones."""
        self._step(lambda marking: Marking(marking.pairs, marking.begun, marking.chosen))
        self._later(self._suggest)

    def _step(self, change: Callable[[Marking], Marking]) -> None:
        with self._changed:
            self._history = self._history.done(change(self.marking))
        self._went_on()

    def _went_on(self) -> None:
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
        found = [Mirror.of(mesh.points[0], Topology(mesh.faces, mesh.vertex_count)) for mesh in self._meshes]
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
                    mirror.partner(vertex)
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
            self._examined = pairs, examine(*self._meshes, Marking(pairs).markers)
