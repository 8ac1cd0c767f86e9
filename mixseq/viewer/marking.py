"""Set markers, which are pairs of corresponding vertices of two meshes, with undo history and proposals.

Background jobs suggest markers, find the mirror symmetry of each body, and examine the current pairs.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from string import ascii_uppercase
from typing import Literal, Protocol

import numpy as np

from mixseq.errors import MixseqWarning
from mixseq.retargeting.correspond import Examination, examine_markers
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.proposals import Mirror, propose_markers, sample_poses
from mixseq.retargeting.report import measure_transfer
from mixseq.retargeting.transfer import TransferSettings, plan_transfer
from mixseq.retargeting.verdict import judge_transfer
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import Float
from mixseq.viewer.playback import JobQueue
from mixseq.viewer.session import UndoHistory

SOURCE, TARGET = 0, 1
"""Indices of the source and target mesh."""

COINCIDENCE_DISTANCE = 0.03
"""Distance in diagonals on either mesh below which a proposal duplicates a pair."""


Certainty = Literal["sure", "between", "unsure"]
"""Certainty of a proposal: a tip or a mirrored pair, a point between sure tips, or a best guess in spite of a doubt."""


@dataclass(frozen=True)
class Pair:
    """A vertex of the source mesh and a corresponding vertex of the target mesh."""

    vertices: tuple[int, int]  # source and target vertex
    name: str = ""  # name in the marker file, or an empty text
    certainty: Certainty = "sure"  # how sure a proposal is; pairs that are set are sure


@dataclass(frozen=True)
class Marking:
    """Immutable state of the pairs, the selection and the rejected proposals."""

    pairs: tuple[Pair, ...] = ()  # complete pairs in the order of their numbers
    started: tuple[int, int] | None = None  # mesh index and vertex of an incomplete pair
    selected: int | None = None  # index of the pair that the next click moves or `delete` removes
    skipped: frozenset[tuple[int, int]] = frozenset()  # vertices of rejected proposals

    @classmethod
    def from_markers(cls, markers: Markers) -> Marking:
        """Return the state with initial markers."""
        names = markers.names or ("",) * len(markers)
        rows = zip(markers.source.tolist(), markers.target.tolist(), names, strict=True)
        return cls(tuple(Pair((source, target), name) for source, target, name in rows))

    @property
    def markers(self) -> Markers:
        """The pairs as markers."""
        names = tuple(pair.name for pair in self.pairs)
        vertices = np.array([pair.vertices for pair in self.pairs], np.int64).reshape(-1, 2)
        return Markers.from_pairs(vertices, names if any(names) else ())

    def click(self, side: int, vertex: int) -> Marking:
        """Return the state after a click, which moves the selected pair, if any, or else starts or completes a pair."""
        if self.selected is not None:
            pair = self.pairs[self.selected]
            vertices = (vertex, pair.vertices[1]) if side == SOURCE else (pair.vertices[0], vertex)
            pairs = list(self.pairs)
            pairs[self.selected] = replace(pair, vertices=vertices)
            return replace(self, pairs=tuple(pairs), selected=None)
        if self.started is None or self.started[0] == side:
            return replace(self, started=(side, vertex))
        first = self.started[1]
        return replace(self.with_pair(Pair((vertex, first) if side == SOURCE else (first, vertex))), started=None)

    def with_pair(self, pair: Pair) -> Marking:
        """Return the state with one pair appended."""
        return replace(self, pairs=(*self.pairs, replace(pair, certainty="sure")))

    def toggle(self, number: int) -> Marking:
        """Return the state with a pair selected, or without a selection if this pair was selected."""
        return replace(self, selected=None if number == self.selected else number)

    def delete(self) -> Marking:
        """Return the state without the selected pair or, if no pair is selected, without the incomplete pair."""
        if self.selected is None:
            return replace(self, started=None)
        pairs = (*self.pairs[: self.selected], *self.pairs[self.selected + 1 :])
        return replace(self, pairs=pairs, selected=None)

    def skip(self, pair: Pair) -> Marking:
        """Return the state with a proposal added to the rejected proposals."""
        return replace(self, skipped=self.skipped | {pair.vertices})


@dataclass(frozen=True)
class Trial:
    """Verdict on a transfer with the set pairs."""

    verdict: str  # one line
    findings: tuple[tuple[str, int | None, str], ...]  # letters and vertices of the target to look at, and problems


def push_marking(history: UndoHistory[Marking], marking: Marking) -> UndoHistory[Marking]:
    """Return the history with a new state; a change of the selection alone adds no step."""
    if replace(marking, selected=None) == replace(history.current, selected=None):
        return history.replace(marking)
    return history.push(marking)


def normalize(points: Float) -> Float:
    """Scale points ``(V, 3)`` so that the diagonal of their bounding box is 1."""
    return np.asarray(points / (float(np.linalg.norm(np.ptp(points, axis=0))) or 1.0))


def filter_proposals(meshes: tuple[Float, Float], marking: Marking, candidates: Iterable[Pair]) -> tuple[Pair, ...]:
    """Return the candidates in order, without duplicates of each other, of set pairs and of rejected proposals.

    `meshes` are the normalized points of the source ``(V, 3)`` and of the target ``(V', 3)``.
    """

    def coincide(one: Pair, other: Pair) -> bool:
        return any(
            float(np.linalg.norm(points[a] - points[b])) <= COINCIDENCE_DISTANCE
            for points, a, b in zip(meshes, one.vertices, other.vertices, strict=True)
        )

    proposals: list[Pair] = []
    for candidate in candidates:
        is_duplicate = any(coincide(candidate, pair) for pair in (*marking.pairs, *proposals))
        if not is_duplicate and candidate.vertices not in marking.skipped:
            proposals.append(candidate)
    return tuple(proposals)


class MarkingListener(Protocol):
    """Callbacks of a marking session, which may be called on any thread."""

    def on_change(self) -> None:
        """Handle a change of the pairs, the proposals, the examination or the background job."""

    def on_failure(self, action: str, error: Exception) -> None:
        """Handle an error."""


class MarkingSession(JobQueue[Callable[[], None]]):
    """Sets markers of two meshes."""

    def __init__(self, source: MeshSequence, target: MeshSequence, markers: Markers, listener: MarkingListener) -> None:
        self._meshes = source, target
        self._listener = listener
        rest_poses = (np.asarray(mesh.points[0], np.float64) for mesh in self._meshes)
        source_points, target_points = map(normalize, rest_poses)
        self._normalized_points = source_points, target_points
        self._history = UndoHistory((Marking.from_markers(markers),))
        self._saved_pairs = self.marking.pairs
        self._suggestions: tuple[Pair, ...] = ()
        self.doubt = ""
        self._mirrors: tuple[Mirror, Mirror] | None = None
        self._mirrored_pairs: dict[tuple[int, int], Pair | None] = {}
        self._examinations: dict[tuple[Pair, ...], Examination] = {}
        self._trials: dict[tuple[Pair, ...], Trial] = {}
        self.work = ""
        initial_jobs = [] if len(markers) else [self._suggest]
        super().__init__(listener.on_failure, [*initial_jobs, self._find_mirrors, self._examine])

    # State ----------------------------------------------------------------------------------------------

    @property
    def marking(self) -> Marking:
        """The current state."""
        return self._history.current

    @property
    def proposals(self) -> tuple[Pair, ...]:
        """Pairs that the user may accept: mirrored pairs, newest first, then suggestions."""
        marking = self.marking
        mirrored = (self._mirrored_pairs.get(pair.vertices) for pair in reversed(marking.pairs))
        candidates = [*filter(None, mirrored), *self._suggestions]
        return filter_proposals(self._normalized_points, marking, candidates)

    @property
    def examination(self) -> Examination | None:
        """Examination of the current pairs, or None until it is computed."""
        return self._examinations.get(self.marking.pairs)

    @property
    def trial(self) -> Trial | None:
        """Trial of a transfer with the current pairs, or None if it was not tried."""
        return self._trials.get(self.marking.pairs)

    @property
    def has_changes(self) -> bool:
        """Whether the current pairs differ from the saved pairs."""
        return self.marking.pairs != self._saved_pairs

    def mark_saved(self, pairs: tuple[Pair, ...]) -> None:
        """Set the pairs that count as saved."""
        self._saved_pairs = pairs
        self._listener.on_change()

    # User actions ---------------------------------------------------------------------------------------

    def click(self, side: int, vertex: int) -> None:
        """Click a vertex, which starts or completes a pair, or moves the selected pair."""
        self._apply(lambda marking: marking.click(side, vertex))

    def click_ball(self, side: int, row: int) -> None:
        """Select the pair or accept the proposal of ball `row`, in the order: pairs, incomplete pair, proposals."""
        marking, proposals = self.marking, self.proposals
        count = len(marking.pairs)
        proposal = row - count - (marking.started is not None and marking.started[0] == side)
        if 0 <= row < count:
            self._apply(lambda current: current.toggle(row) if row < len(current.pairs) else current)
        elif 0 <= proposal < len(proposals):
            self._apply(lambda current: current.with_pair(proposals[proposal]))

    def accept(self) -> None:
        """Accept the next proposal."""
        self._apply(lambda marking: marking.with_pair(self.proposals[0]) if self.proposals else marking)

    def accept_all(self) -> None:
        """Accept all proposals that are not unsure."""
        sure = [replace(pair, certainty="sure") for pair in self.proposals if pair.certainty != "unsure"]
        self._apply(lambda marking: replace(marking, pairs=(*marking.pairs, *sure)))

    def skip(self) -> None:
        """Reject the next proposal."""
        self._apply(lambda marking: marking.skip(self.proposals[0]) if self.proposals else marking)

    def delete(self) -> None:
        """Delete the selected pair or, if no pair is selected, the incomplete pair."""
        self._apply(Marking.delete)

    def undo(self) -> None:
        """Undo the last step."""
        self._update_history(UndoHistory.undo)

    def redo(self) -> None:
        """Redo the last undone step."""
        self._update_history(UndoHistory.redo)

    def suggest(self) -> None:
        """Suggest markers again with the current pairs as known, including rejected suggestions."""
        self._apply(lambda marking: replace(marking, skipped=frozenset()))
        self._enqueue_once(self._suggest)

    def try_transfer(self) -> None:
        """Transfer the frames of the source with the current pairs, and judge the result."""
        self._enqueue_once(self._try_transfer)

    def _apply(self, change: Callable[[Marking], Marking]) -> None:
        self._update_history(lambda history: push_marking(history, change(history.current)))

    def _update_history(self, change: Callable[[UndoHistory[Marking]], UndoHistory[Marking]]) -> None:
        with self._changed:
            self._history = change(self._history)
        self._mirror_pairs()
        self._listener.on_change()
        self._enqueue_once(self._examine)

    # Background jobs ------------------------------------------------------------------------------------

    def _enqueue_once(self, job: Callable[[], None]) -> None:
        self._enqueue(job, is_obsolete=lambda waiting: waiting == job)

    def _run_job(self, job: Callable[[], None]) -> None:
        try:
            job()
        except Exception as error:
            self._report_failure("markers", error)
        self._set_work("")

    def _set_work(self, work: str) -> None:
        self.work = work
        self._listener.on_change()

    def _suggest(self) -> None:
        self._set_work("looking for markers to suggest")
        source, target = (sample_poses(mesh) for mesh in self._meshes)
        proposal = propose_markers(source, target, self.marking.markers)
        markers = Markers.from_pairs(proposal.tips) if proposal.doubt else proposal.markers
        certainties: list[Certainty] = ["unsure" if proposal.doubt else "sure"] * proposal.tip_count
        certainties += ["unsure" if proposal.doubt else "between"] * (len(markers) - proposal.tip_count)
        pairs = zip(Marking.from_markers(markers).pairs, certainties, strict=False)
        self._suggestions = tuple(replace(pair, certainty=certainty) for pair, certainty in pairs)
        self.doubt = proposal.doubt

    def _find_mirrors(self) -> None:
        self._set_work("looking for left and right")
        mirrors = [Mirror.from_poses(*sample_poses(mesh)) for mesh in self._meshes]
        if mirrors[0] is not None and mirrors[1] is not None:
            self._mirrors = mirrors[0], mirrors[1]
            self._mirror_pairs()

    def _mirror_pairs(self) -> None:
        """Compute the mirrored pair of every set pair."""
        if self._mirrors is None:
            return
        for pair in self.marking.pairs:
            if pair.vertices not in self._mirrored_pairs:
                source, target = (
                    mirror.find_partner(vertex) for mirror, vertex in zip(self._mirrors, pair.vertices, strict=True)
                )
                mirrored = None if source is None or target is None else Pair((source, target))
                self._mirrored_pairs[pair.vertices] = mirrored

    def _examine(self) -> None:
        pairs = self.marking.pairs
        if pairs and pairs not in self._examinations:
            self._set_work("finding a map")
            self._examinations[pairs] = examine_markers(*self._meshes, Marking(pairs).markers)

    def _try_transfer(self) -> None:
        self._set_work("trying a transfer")
        pairs = self.marking.pairs
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MixseqWarning)  # the verdict says what is wrong
            planned = plan_transfer(*self._meshes, TransferSettings(Marking(pairs).markers))
            verdict = judge_transfer(planned, measure_transfer(planned))
        found = []
        for letter, each in zip(ascii_uppercase, verdict.findings, strict=False):
            when = "at rest" if each.frame is None else planned.header.frame_name(each.frame)
            found.append((letter, each.vertex, each.message if each.vertex is None else f"{when}: {each.message}"))
        self._trials[pairs] = Trial(verdict.text, tuple(found))
