"""Edits of real animations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.operations import into, loop, repeat, transition
from mixseq.sequence.sequence import MeshSequence
from tests.operations.motions import first_frames, jumps

pytestmark = pytest.mark.realdata


@pytest.fixture(scope="module")
def gallop(data: Path) -> MeshSequence:
    return mixseq.read(data / "npz" / "q_horse_gallop.npz")


def test_repeat_leaves_frames_outside_untouched(gallop: MeshSequence) -> None:
    """Also those that are between the knots of the placement."""
    model = mixseq.fit(gallop, rank=8, knots=12)
    start, end = model.times[[9, 19]]
    longer = repeat(model, start, end, times=3)
    assert all((jumps(curve) < 1e-9).all() for curve in longer.curves)
    before, after = np.array([7, 8, 9]), np.array([19, 20, 21])
    times = np.concatenate([model.times[before], model.times[after] + 2 * (end - start)])
    expected = model.sample(model.times[np.concatenate([before, after])]).points
    np.testing.assert_allclose(longer.sample(times).points, expected, atol=1e-9 * gallop.diagonal)


def test_from_a_gallop_to_the_grass(gallop: MeshSequence, data: Path) -> None:
    eating = first_frames(mixseq.read(data / "npz" / "q_horse_eating.npz"), 25)
    model = loop(mixseq.fit(gallop, rank=10))
    eats = into(mixseq.fit(eating, exact=True), model.space)
    size = 1e-9 * gallop.diagonal
    np.testing.assert_allclose(eats.sample(eats.times[::8]).points, eating.points[::8], atol=size)
    at, duration = float(model.times[12]), 0.25
    over = transition(model, eats, at, duration)
    assert over.end == pytest.approx(at + eats.end)
    found = over.sample([at, at + duration, over.end]).points
    expected = [model(at), eats(duration), eating.points[-1]]
    np.testing.assert_allclose(found, expected, atol=size)
    # No vertex moves faster on the way than in both motions together.
    middle = over.sample(np.linspace(at, at + duration, 9)).points
    fastest = [np.abs(np.diff(sequence.points, axis=0)).max() * sequence.fps for sequence in (gallop, eating)]
    assert np.abs(np.diff(middle, axis=0)).max() / (duration / 8) < sum(fastest)
