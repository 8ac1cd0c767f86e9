"""Pairs are set by clicks, moved, deleted, and steps taken back; proposals are what is neither set nor skipped."""

from __future__ import annotations

import numpy as np

from mixseq.retargeting.markers import Markers
from mixseq.viewer.marking import SAME, SOURCE, TARGET, Marking, MarkingHistory, Pair, Places

TWO = Marking((Pair((1, 10), "nose"), Pair((2, 20))))


def test_two_clicks_are_a_pair_in_either_order() -> None:
    for clicks in (((SOURCE, 3), (TARGET, 30)), ((TARGET, 30), (SOURCE, 3))):
        marking = TWO
        for side, vertex in clicks:
            marking = marking.clicked(side, vertex)
        assert marking.pairs[2] == Pair((3, 30))
        assert marking.begun is None


def test_a_second_click_on_the_same_side_moves_the_first() -> None:
    marking = TWO.clicked(SOURCE, 3).clicked(SOURCE, 4)
    assert marking.begun == (SOURCE, 4)
    assert marking.pairs == TWO.pairs


def test_a_chosen_pair_is_moved_on_either_side_and_keeps_its_name() -> None:
    assert TWO.choosing(0).clicked(SOURCE, 5).pairs[0] == Pair((5, 10), "nose")
    moved = TWO.choosing(0).clicked(TARGET, 50)
    assert moved.pairs == (Pair((1, 50), "nose"), Pair((2, 20)))
    assert moved.chosen is None


def test_choosing_twice_is_choosing_none() -> None:
    assert TWO.choosing(1).choosing(1) == TWO
    assert TWO.choosing(1).choosing(0).chosen == 0


def test_deleting() -> None:
    assert TWO.choosing(0).without_chosen() == Marking((Pair((2, 20)),))
    assert TWO.clicked(SOURCE, 3).without_chosen() == TWO
    assert TWO.without_chosen() == TWO


def test_markers_and_back() -> None:
    markers = Markers.from_pairs([[1, 10], [2, 20]], ("nose", ""))
    assert Marking.of(markers) == TWO
    again = TWO.markers
    assert (again.source.tolist(), again.target.tolist(), again.names) == ([1, 2], [10, 20], ("nose", ""))
    assert len(Marking().markers) == 0
    assert Marking((Pair((1, 2)),)).markers.names == ()


def test_steps_back_and_ahead() -> None:
    history = MarkingHistory((Marking(),))
    first, second = Marking().clicked(SOURCE, 1), Marking().clicked(SOURCE, 1).clicked(TARGET, 2)
    history = history.done(first).done(second)
    assert history.undone().marking == first
    assert history.undone().undone().undone().marking == Marking()
    assert history.undone().redone().redone().marking == second
    assert history.undone().done(TWO).redone().marking == TWO


def test_what_is_chosen_is_no_step() -> None:
    history = MarkingHistory((Marking(),)).done(TWO).done(TWO.choosing(1))
    assert history.marking.chosen == 1
    assert history.undone().marking == Marking()


def places() -> Places:
    """Vertices along a diagonal of length 1, and the same on the target, ten times as large."""
    line = np.linspace(0, 1, 1001)[:, None] * np.ones(3) / np.sqrt(3)
    return Places.of(line, 10 * line)


def test_proposals_are_new() -> None:
    marking = Marking((Pair((100, 100)),)).skipping(Pair((300, 300)))
    near = int(1000 * SAME)
    candidates = [
        Pair((100 + near - 1, 900)),  # near on the source
        Pair((900, 100 - near + 1)),  # near on the target
        Pair((300, 300)),  # skipped
        Pair((500, 500)),
        Pair((500 + near - 1, 800)),  # as one before
        Pair((300, 301)),
    ]
    assert places().proposals(marking, candidates) == (Pair((500, 500)), Pair((300, 301)))
