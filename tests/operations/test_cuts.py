"""Edits of the time line keep cuts: the motion on both sides is that of the source, up to the jump."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from mixseq.choices import SpaceName
from mixseq.operations import concatenate, cut, loop, repeat, retime, reverse, shift, speed
from mixseq.operations.retiming import Retiming
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.motions import MESH, moving

BREAK = 1.05
"""Seconds; between frames 10 and 11 of 10 per second."""


@cache
def shot(space: SpaceName = "mixed") -> Model:
    points = moving(np.arange(20.0))
    points[11:] += [0, 30, 0]
    model = fit(MeshSequence.from_arrays(points, MESH[1], fps=10), exact=True, space=space)
    assert len(model.time.breaks) == 1
    return model


def check(model: Model, source: Model, times: Float, sources: Float, atol: float = 1e-6) -> None:
    found, expected = model.sample(times=times).points, source.sample(times=np.sort(sources)).points
    np.testing.assert_allclose(found[np.argsort(sources)], expected, atol=atol)


@pytest.mark.parametrize("space", ["mixed", "vertex"])
def test_sections_and_repeats(space: SpaceName) -> None:
    model = shot(space)
    near = np.array([0.95, 1.04, 1.06, 1.17])
    check(cut(model, 0.5, 1.5), model, near, near)
    check(cut(model, 0.5, BREAK - 1e-6), model, near[:2], near[:2], 1e-4)
    check(shift(model, 3.0), model, near + 3, near)
    check(speed(model, 0.5), model, 2 * near, near)
    check(reverse(model), model, 1.9 - near[::-1], near[::-1])
    again = repeat(model, 0.5, 1.6, times=3, fade=0.1)
    for number in range(3):
        check(again, model, near + 1.1 * number, near)
    assert len(again.placement.breaks if space == "mixed" else again.time.breaks) == 3


def test_loops_and_concatenations() -> None:
    model, near = shot(), np.array([0.95, 1.04, 1.06, 1.17])
    check(loop(model, fade=0.2), model, near, near)
    both = concatenate(model, shift(model, 0.0), fade=0.2)
    check(both, model, near, near)
    check(both, model, near + both.end - model.end, near)
    other = concatenate(model, shot("vertex"), fade=0.2)  # in another space: it is fitted again, with its cuts
    check(other, model, near + other.end - model.end, near, 0.05)


def test_a_fade_may_reach_beyond_a_cut() -> None:
    """What is added near the seam is smooth; so the jump at the cut stays the same."""
    model = shot()
    before, after = np.nextafter(BREAK, 0), BREAK
    jump = model(after) - model(before)
    again = repeat(model, 0.4, 1.4, times=2, fade=0.9)
    for delay in (0.0, 1.0):
        b = again.placement.breaks[int(delay)]
        placed = again.placement([np.nextafter(b, 0), b])[:, 4:]
        np.testing.assert_allclose(np.diff(placed, axis=0)[0] * model.space.scale, jump.mean(axis=0), atol=0.2)
        assert np.isfinite(again(b)).all()


@pytest.mark.parametrize("smooth", [True, False])
def test_retimings(smooth: bool) -> None:
    """Forwards, standing still, and backwards over the cut."""
    model = shot()
    keys = np.array([[0.0, 0.2], [1.0, 1.5], [1.5, 1.5], [3.0, 0.5]])
    found = retime(model, keys, smooth)
    assert len(found.placement.breaks) == 2
    retiming = Retiming.through(keys[:, 0], keys[:, 1], smooth)
    times = np.linspace(0.05, 2.95, 40)
    sources = retiming(times)
    for time, source in zip(times, sources, strict=True):
        np.testing.assert_allclose(found(time), model(source), atol=2e-4)
