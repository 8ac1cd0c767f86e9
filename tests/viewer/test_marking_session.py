"""A session: suggestions at its begin, the other side of what is set, and what is known about the pairs of now."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from mixseq.retargeting.markers import Markers
from mixseq.retargeting.proposals import Proposal
from mixseq.viewer.live.marking import make_balls
from mixseq.viewer.marking import SOURCE, TARGET, MarkingSession
from tests.retargeting.foxes import on_bones, short, tall
from tests.retargeting.test_examination import MARKED, set_markers
from tests.viewer.pages import eventually

pytestmark = pytest.mark.slow

NOTHING = Markers.from_pairs(np.zeros((0, 2), np.int64))


class Listener:
    """Counts changes, and keeps what failed."""

    def __init__(self) -> None:
        self.changes = 0
        self.failures: list[Exception] = []

    def on_change(self) -> None:
        self.changes += 1

    def on_failure(self, action: str, error: Exception) -> None:
        self.failures.append(error)


@pytest.fixture
def listener() -> Iterator[Listener]:
    found = Listener()
    yield found
    assert not found.failures


def test_suggestions_are_accepted_and_skipped(listener: Listener) -> None:
    with MarkingSession(short().mesh, tall().mesh, NOTHING, listener) as session:
        eventually(lambda: len(session.proposals) >= 8, seconds=240.0)
        first, second, *others = session.proposals
        assert first.certainty == "sure"
        assert others[-1].certainty == "between"
        session.accept()
        assert session.marking.pairs == (first,)
        session.skip()
        assert second not in session.proposals
        session.accept_all()
        assert second not in session.marking.pairs
        assert not session.proposals
        assert session.has_changes
        for _ in range(3):
            session.undo()
        assert not session.marking.pairs
        assert second in session.proposals
        assert not session.has_changes
        session.redo()
        assert session.marking.pairs == (first,)
        session.mark_saved(session.marking.pairs)
        assert not session.has_changes


def test_unsure_suggestions_are_shown_apart_and_accepted_one_by_one(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    tips = np.array([[3, 5], [9, 2], [100, 700], [900, 400]])
    unsure = Proposal(NOTHING, 0, tips, (0, 0), 1.0, 0.0, "left and right could be exchanged")
    monkeypatch.setattr("mixseq.viewer.marking.propose_markers", lambda *_: unsure)
    with MarkingSession(short().mesh, tall().mesh, NOTHING, listener) as session:
        eventually(lambda: bool(session.proposals))
        assert {pair.certainty for pair in session.proposals} == {"unsure"}
        session.accept_all()
        assert not session.marking.pairs
        session.accept()
        assert [pair.certainty for pair in session.marking.pairs] == ["sure"]
        assert session.doubt


def test_the_other_side_of_a_pair_is_proposed(listener: Listener) -> None:
    with MarkingSession(short().mesh, tall().mesh, set_markers("nose"), listener) as session:
        eventually(lambda: session._mirrors is not None)
        assert not session.proposals  # a file that is continued: nothing is suggested unasked
        one, other = (int(on_bones(fox, "forearm.l")[0]) for fox in (short(), tall()))
        session.click(SOURCE, one)
        session.click(TARGET, other)
        (mirrored,) = session.proposals
        assert short().bones[mirrored.vertices[0]].startswith("fore")
        assert short().bones[mirrored.vertices[0]].endswith(".r")
        assert tall().bones[mirrored.vertices[1]].endswith(".r")
        session.click_ball(TARGET, len(session.marking.pairs))
        assert session.marking.pairs[-1] == mirrored
        assert not session.proposals


def test_a_click_on_a_ball_chooses_its_pair(listener: Listener) -> None:
    markers = set_markers("nose", "tail4")
    with MarkingSession(short().mesh, tall().mesh, markers, listener) as session:
        session.click_ball(SOURCE, 1)
        assert session.marking.selected == 1
        session.delete()
        assert len(session.marking.pairs) == 1
        session.undo()
        assert len(session.marking.pairs) == 2
        session.click_ball(TARGET, 0)
        elsewhere = int(on_bones(tall(), "ear.l")[0])
        session.click(TARGET, elsewhere)
        assert session.marking.pairs[0].vertices == (int(markers.source[0]), elsewhere)
        before = session.marking
        for row in (-1, 2, 10**9):  # balls that are not there, as a page might say
            session.click_ball(SOURCE, row)
        assert session.marking == before


def test_pairs_are_examined_from_ten_on(listener: Listener) -> None:
    markers = set_markers(*MARKED)
    with MarkingSession(short().mesh, tall().mesh, markers, listener) as session:
        found = eventually(lambda: session.examination)
        assert found.residuals is not None
        assert len(found.residuals) == len(MARKED)
        session.click_ball(SOURCE, 0)
        session.delete()
        assert session.examination is None  # of other pairs
        found = eventually(lambda: session.examination)
        assert found.residuals is not None
        assert len(found.residuals) == len(MARKED) - 1


def test_a_tried_transfer_has_a_verdict_and_places_until_pairs_change(listener: Listener) -> None:
    markers = set_markers(*MARKED)
    wrong = replace(markers, target=markers.target.copy())
    wrong.target[MARKED.index("thigh.r")] = on_bones(tall(), "neck")[0]
    with MarkingSession(short().mesh, tall().mesh, wrong, listener) as session:
        assert session.trial is None
        session.try_transfer()
        found = eventually(lambda: session.trial)
        assert found.verdict.startswith("check: the target is 1.1e+02 times as large as the source")
        (_, nowhere, _), (letter, vertex, text), *_ = found.findings
        assert nowhere is None  # the size of the whole
        assert letter == "B"
        assert vertex in wrong.target
        assert text.startswith("at rest: ")
        assert "thigh.r" in text
        ball = list(make_balls(session.marking, (), frozenset(), TARGET, found))[len(MARKED)]
        assert (ball.vertex, ball.text) == (vertex, "B")
        session.click_ball(SOURCE, 0)
        session.delete()
        assert session.trial is None


def test_what_fails_is_told_and_the_session_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise ValueError("a bug")

    monkeypatch.setattr("mixseq.viewer.marking.propose_markers", broken)
    listener = Listener()
    with MarkingSession(short().mesh, tall().mesh, NOTHING, listener) as session:
        eventually(lambda: listener.failures)
        session.click(SOURCE, 0)
        session.click(TARGET, 0)
        eventually(lambda: session.examination)
    assert [str(each) for each in listener.failures] == ["a bug"]
