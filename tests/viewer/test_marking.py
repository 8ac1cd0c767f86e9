"""Pairs are set by clicks, moved, deleted, and steps taken back; proposals are what is neither set nor skipped."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.retargeting.markers import Markers
from mixseq.viewer.marking import (
    COINCIDENCE_DISTANCE,
    SOURCE,
    TARGET,
    Marking,
    Pair,
    filter_proposals,
    normalize,
    push_marking,
)
from mixseq.viewer.session import UndoHistory

TWO = Marking((Pair((1, 10), "nose"), Pair((2, 20))))


def test_two_clicks_are_a_pair_in_either_order() -> None:
    for clicks in (((SOURCE, 3), (TARGET, 30)), ((TARGET, 30), (SOURCE, 3))):
        marking = TWO
        for side, vertex in clicks:
            marking = marking.click(side, vertex)
        assert marking.pairs[2] == Pair((3, 30))
        assert marking.started is None


def test_a_second_click_on_the_same_side_moves_the_first() -> None:
    marking = TWO.click(SOURCE, 3).click(SOURCE, 4)
    assert marking.started == (SOURCE, 4)
    assert marking.pairs == TWO.pairs


def test_a_chosen_pair_is_moved_on_either_side_and_keeps_its_name() -> None:
    assert TWO.toggle(0).click(SOURCE, 5).pairs[0] == Pair((5, 10), "nose")
    moved = TWO.toggle(0).click(TARGET, 50)
    assert moved.pairs == (Pair((1, 50), "nose"), Pair((2, 20)))
    assert moved.selected is None


def test_choosing_twice_is_choosing_none() -> None:
    assert TWO.toggle(1).toggle(1) == TWO
    assert TWO.toggle(1).toggle(0).selected == 0


def test_deleting() -> None:
    assert TWO.toggle(0).delete() == Marking((Pair((2, 20)),))
    assert TWO.click(SOURCE, 3).delete() == TWO
    assert TWO.delete() == TWO


def test_markers_and_back() -> None:
    markers = Markers.from_pairs([[1, 10], [2, 20]], ("nose", ""))
    assert Marking.from_markers(markers) == TWO
    again = TWO.markers
    assert (again.source.tolist(), again.target.tolist(), again.names) == ([1, 2], [10, 20], ("nose", ""))
    assert len(Marking().markers) == 0
    assert Marking((Pair((1, 2)),)).markers.names == ()


def test_a_selection_is_no_step() -> None:
    history = push_marking(push_marking(UndoHistory((Marking(),)), TWO), TWO.toggle(1))
    assert history.current.selected == 1
    assert history.undo().current == Marking()


def test_proposals_are_new() -> None:
    marking = Marking((Pair((100, 100)),)).skip(Pair((300, 300)))
    near = int(1000 * COINCIDENCE_DISTANCE)
    candidates = [
        Pair((100 + near - 1, 900)),  # near on the source
        Pair((900, 100 - near + 1)),  # near on the target
        Pair((300, 300)),  # skipped
        Pair((500, 500)),
        Pair((500 + near - 1, 800)),  # as one before
        Pair((300, 301)),
    ]
    line = np.linspace(0, 1, 1001)[:, None] * np.ones(3)
    assert filter_proposals((normalize(line), normalize(10 * line)), marking, candidates) == (
        Pair((500, 500)),
        Pair((300, 301)),
    )


def test_labels_do_not_collide() -> None:
    """Seen along z: off the surface, else above the ball; of two at one place, the one behind is below on the left."""
    pytest.importorskip("viser", reason="the extra viewer is not installed")
    from mixseq.viewer.live.marking import LABEL_DISTANCE_RATIO, LABEL_SIZE_RATIO, place_labels

    towards = np.array([0.0, 0, 1])
    points = np.array([[0.0, 0, 0], [0, 0, 5], [30, 0, 0]])
    normals = np.array([[0.0, 0, 1], [0, 0, 1], [4, -0.3, 0]])
    placed = place_labels(points, normals, towards, 1.0)
    np.testing.assert_allclose(placed[1:] - points[1:], LABEL_DISTANCE_RATIO * np.eye(3)[[1, 0]], atol=1e-12)
    np.testing.assert_allclose(placed[0], LABEL_DISTANCE_RATIO * np.array([-1, -1, 0]) / np.sqrt(2), atol=1e-12)
    crowd = np.random.default_rng(0).uniform(-5, 5, (30, 3))
    flat = place_labels(crowd, crowd, towards, 1.0)[:, :2]
    distances = np.abs(flat[:, None] - flat).max(axis=2)
    assert distances[np.triu_indices(30, 1)].min() >= LABEL_SIZE_RATIO
    above = place_labels(crowd, crowd, np.array([0.0, 1, 0]), 1.0)
    np.testing.assert_allclose(above[:, 1], crowd[:, 1], atol=1e-12)
