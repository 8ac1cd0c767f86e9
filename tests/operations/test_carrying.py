"""Operations that tell time carry all three signals: time, placement and correction."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from mixseq.operations import (
    blend,
    concatenate,
    cut,
    loop,
    repeat,
    retime,
    reverse,
    shift,
    sketch,
    smooth,
    speed,
    transition,
)
from mixseq.signals.model import Model
from mixseq.types import Float
from tests.operations.motions import fox

RANK = 6
"""Few modes, so that the correction has something to say."""

END = 23 / 24


def unchanged(times: Float) -> Float:
    return times


Edit = Callable[[Model], Model]
Source = Callable[[Float], Float]

EDITS: dict[str, tuple[Edit, Source, list[tuple[float, float]]]] = {
    "cut": (lambda model: cut(model, 0.21, 0.73), unchanged, [(0.21, 0.73)]),
    "cut to": (lambda model: cut(model, 0.21, 0.73, at=2.0), lambda t: t - 1.79, [(2.0, 2.52)]),
    "shift": (lambda model: shift(model, 1.0), lambda t: t - 1.0, [(1.0, 1.0 + END)]),
    "speed": (lambda model: speed(model, 2.0), lambda t: 2.0 * t, [(0.0, END / 2)]),
    "reverse": (reverse, lambda t: END - t, [(0.0, END)]),
    "repeat": (
        lambda model: repeat(model, 0.25, 0.75, 3, fade=0.1),
        lambda t: t - 0.5 * np.clip(np.floor((t - 0.25) / 0.5), 0, 2),
        [(0.0, 0.65), (0.85, 1.15), (1.35, 1.95)],
    ),
    "loop": (lambda model: loop(model, fade=0.1), unchanged, [(0.1, END - 0.1)]),
    "concatenate": (lambda model: concatenate(cut(model, 0.0, 0.43), cut(model, 0.43, END)), unchanged, [(0.0, END)]),
    "transition": (lambda model: transition(model, cut(model, 0.3, END), 0.3, 0.2), unchanged, [(0.0, END)]),
    "blend": (lambda model: blend(model, model, 0.4), unchanged, [(0.0, END)]),
    "retime": (
        lambda model: retime(model, [[0.0, 0.1], [1.0, 0.8], [1.5, 0.3]], smooth=False),
        lambda t: np.interp(t, [0.0, 1.0, 1.5], [0.1, 0.8, 0.3]),
        [(0.0, 1.5)],
    ),
}
"""Edits, the time of the source that each shows, and from when to when it shows nothing else."""


@pytest.mark.parametrize("name", EDITS)
def test_all_signals_are_carried(name: str) -> None:
    model = fox(RANK)
    edit, source, sections = EDITS[name]
    edited = edit(model)
    assert np.abs(model.correction.values).max() > 1e-3
    for start, end in sections:
        times = np.linspace(start, end, 41)
        shown = source(times)
        for found, expected in zip(edited.curves, model.curves, strict=True):
            off = found(times) - expected(np.clip(shown, expected.start, expected.end))
            assert np.abs(off).max() < (2e-5 if name == "retime" else 1e-6)


def test_what_was_cut_in_two_is_whole_again() -> None:
    """Vertices too, at frames and between them."""
    model = fox(RANK)
    whole = concatenate(cut(model, 0.0, 0.43), cut(model, 0.43, END))
    times = np.linspace(0.0, END, 61)
    np.testing.assert_allclose(whole.sample(times).points, model.sample(times).points, atol=1e-9)


def test_what_is_retimed_is_the_model_at_the_time_of_the_source() -> None:
    model = fox(RANK)
    outputs, sources = [0.0, 1.0, 1.5], [0.1, 0.8, 0.3]
    retimed = retime(model, np.stack([outputs, sources], axis=1), smooth=False)
    times = np.linspace(0.0, 1.5, 46)
    found = np.stack([retimed(time) for time in times])
    expected = np.stack([model(time) for time in np.interp(times, outputs, sources)])
    np.testing.assert_allclose(found, expected, atol=2e-5 * model.space.scale)


def test_a_loop_closes_all_signals() -> None:
    closed = loop(fox(RANK))
    for curve in (closed.time, closed.correction):
        first, last = curve([closed.start, closed.end])
        np.testing.assert_allclose(last, first, atol=1e-9)


def test_a_sketch_through_frames_has_their_corrections() -> None:
    model = fox(RANK)
    frames = [3, 9, 14]
    places = model.embedding(model.times[frames])
    sketched = sketch(model, places, 1.0)
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    times = lengths / lengths[-1]
    np.testing.assert_allclose(sketched.curve(times), model.vectors[frames], atol=1e-9)


def test_smoothing_calms_the_correction() -> None:
    model = fox(RANK)
    calm = smooth(model, 0.5)
    times = np.linspace(0.0, END, 97)
    before, after = (np.abs(each.correction.derivative(times, 2)).max() for each in (model, calm))
    assert after < 0.1 * before
