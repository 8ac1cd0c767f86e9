"""Retiming: closed-form maps, their slopes, and models along them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import mixseq
from mixseq.choices import SpaceName
from mixseq.errors import SettingsError
from mixseq.operations import Retiming, cut, repeat, resample, retime, reverse, shift, speed
from mixseq.operations.sections import shape_norm
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from tests.meshes import seeds
from tests.operations.motions import bar_motion, spin

GRID = np.linspace(0, 1, 201)


# Maps -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("retiming", "end", "sources", "slope"),
    [
        (Retiming.section(1, 3), 3, lambda o: o, 1),
        (Retiming.section(1, 3, speed=4), 1.5, lambda o: 1 + 4 * (o - 1), 4),
        (Retiming.section(1, 3, speed=0.5), 5, lambda o: 1 + (o - 1) / 2, 0.5),
        (Retiming.section(1, 3, reverse=True), 3, lambda o: 4 - o, -1),
        (Retiming.section(1, 3, 0.5, True), 5, lambda o: 3 - (o - 1) / 2, -0.5),
        (Retiming.section(1, 1), 1, lambda o: o, 1),
        (Retiming.section(1, 1, 2, True), 1, lambda o: o, -2),
        (Retiming.hold(7, 1, 3), 3, lambda o: 7 + 0 * o, 0),
    ],
)
def test_straight_maps(retiming: Retiming, end: float, sources: object, slope: float) -> None:
    assert callable(sources)
    assert (retiming.start, retiming.end) == (1, end)
    times = 1 + (end - 1) * GRID
    assert retiming(times) == pytest.approx(sources(times), abs=1e-14)
    assert retiming.slope(times) == pytest.approx(np.full(len(times), slope))


def test_at_its_own_speed_a_section_keeps_every_bit() -> None:
    times = np.arange(7, 96) / 23.976
    assert np.array_equal(Retiming.section(times[0], times[-1])(times), times)


def test_lines_through_points() -> None:
    retiming = Retiming.through([0, 1, 3], [5, 7, 6], smooth=False)
    assert retiming([0, 0.5, 1, 2, 3]).tolist() == [5, 6, 7, 6.5, 6]
    assert retiming.slope([0, 0.5, 1, 2, 3]).tolist() == [2, 2, -0.5, -0.5, -0.5]


def test_smooth_through_two_points_is_a_line() -> None:
    retiming = Retiming.through([1, 3], [0, 1])
    assert retiming([1, 2, 2.5]) == pytest.approx([0, 0.5, 0.75])


@pytest.mark.parametrize("smooth", [True, False])
def test_retiming_passes_through_its_points(smooth: bool) -> None:
    outputs, sources = [0, 0.4, 0.5, 2], [3, 3, 1, 4]
    assert Retiming.through(outputs, sources, smooth)(outputs) == pytest.approx(sources, abs=1e-14)


@given(
    st.lists(st.floats(0.1, 1), min_size=2, max_size=6),
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.booleans(),
)
@example([1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 2.2e-311, 0.0, 0.0, 0.0], True)
def test_retiming_is_monotone_between_points(steps: list[float], changes: list[float], smooth: bool) -> None:
    outputs = np.cumsum(steps)
    sources = np.cumsum(changes)[: len(outputs)]
    retiming = Retiming.through(outputs, sources, smooth)
    for piece in range(len(outputs) - 1):
        times = outputs[piece] + (outputs[piece + 1] - outputs[piece]) * GRID
        rising = np.sign(sources[piece + 1] - sources[piece])
        assert (rising * np.diff(retiming(times)) >= -1e-12).all()


def test_the_slope_is_the_derivative_and_is_continuous() -> None:
    retiming = Retiming.through([0, 0.3, 0.7, 1], [0, 0.1, 0.8, 0.5])
    inner, step = GRID[1:-1], 1e-6
    differences = (retiming(inner + step) - retiming(inner - step)) / (2 * step)
    assert retiming.slope(inner) == pytest.approx(differences, abs=1e-5)
    for knot in (0.3, 0.7):
        before, after = retiming.slope([knot - 1e-9, knot + 1e-9])
        assert before == pytest.approx(after, abs=1e-6)


@pytest.mark.parametrize("time", [0.999, 3.001, np.nan, np.inf])
def test_times_outside(time: float) -> None:
    retiming = Retiming.section(1, 3)
    for ask in (retiming, retiming.slope):
        with pytest.raises(
            SettingsError, match=f"{time:g} s is outside the retiming, which is from 1 to 3 s of the output"
        ):
            ask([2, time])


@pytest.mark.parametrize(
    ("outputs", "sources", "message"),
    [
        ([0], [0], "has 1 output times and 1 source times; two of each"),
        ([0, 1], [0], "has 2 output times and 1 source times"),
        ([[0, 1]], [[0, 1]], "two of each"),
        ([0, 0], [0, 1], "output times increase"),
        ([1, 0], [0, 1], "output times increase"),
        ([0, np.nan], [0, 1], "must be finite"),
        ([0, 1], [0, np.inf], "must be finite"),
        ([0, 1e-320], [0, 1], "must be 1e-100 s apart or more"),
        ([0, 1], [-1e308, 1e308], "no time beyond 1e"),
    ],
)
def test_points_that_make_no_map(outputs: object, sources: object, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Retiming.through(outputs, sources)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ((2, 1), "no time between the start, 2 s, and the end, 1 s"),
        ((np.nan, 1), "no time between"),
        ((0, np.inf), "no time between"),
        ((0, 1, 0), "speed is 0; a positive number"),
        ((0, 1, -1), "speed is -1; a positive number"),
        ((0, 1, np.inf), "speed is inf"),
    ],
)
def test_sections_that_make_no_map(settings: tuple[float, ...], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        Retiming.section(*settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("settings", [(0, 2, 1), (np.nan, 0, 1), (0, 0, np.inf)])
def test_what_cannot_be_held(settings: tuple[float, float, float]) -> None:
    with pytest.raises(SettingsError, match="cannot be held"):
        Retiming.hold(*settings)


TIMES = np.linspace(0.0, 0.8, 23)
TO_AND_FRO = [[0.0, 0.0], [0.5, 0.8], [0.7, 0.8], [1.6, 0.1], [2.0, 0.6]]


def same_signals(one: Model, other: Model, atol: float = 1e-10) -> None:
    times = np.linspace(one.start, one.end, 61)
    for found, expected in zip(one.curves, other.curves, strict=True):
        np.testing.assert_allclose(found(times), expected(times), atol=atol)


@pytest.mark.parametrize("knots", [None, 2])
@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("keys", [[0.0, 0.8], [0.0, 0.21, 0.5, 0.8]])
def test_each_time_to_itself_is_the_model(knots: int | None, smooth: bool, keys: list[float]) -> None:
    model = bar_motion(knots=knots)
    same = retime(model, np.repeat(np.array(keys)[:, None], 2, axis=1), smooth)
    np.testing.assert_allclose(same.times, model.times, atol=1e-12)
    assert (same.start, same.end) == (model.start, model.end)
    same_signals(same, model)


@pytest.mark.parametrize("space", ["mixed", "vertex"])
def test_straight_maps_are_those_of_other_operations(space: SpaceName) -> None:
    model = bar_motion(space)
    same_signals(retime(model, [[0.0, 0.8], [0.8, 0.0]]), reverse(model))
    same_signals(retime(model, [[0.0, 0.0], [0.4, 0.8]]), speed(model, 2.0))
    same_signals(retime(model, [[3.0, 0.0], [3.8, 0.8]]), shift(model, 3.0))
    same_signals(retime(model, [[0.2, 0.2], [0.7, 0.7]]), cut(model, 0.2, 0.7))
    there_and_back = [[0.0, 0.0], [0.8, 0.8], [1.6, 0.0]]
    back = retime(retime(model, there_and_back, smooth=False), [[0.0, 0.0], [0.8, 0.8]])
    same_signals(back, model, atol=1e-5)


@given(seed=seeds, smooth=st.booleans(), knots=st.sampled_from([None, 2]))
@settings(max_examples=25, deadline=None)
def test_signals_are_those_of_the_source(seed: int, smooth: bool, knots: int | None) -> None:
    rng = np.random.default_rng(seed)
    model, count = bar_motion(knots=knots), rng.integers(2, 6)
    keys = np.stack([np.cumsum(rng.uniform(0.1, 1.0, count)), rng.uniform(0.0, 0.8, count)], axis=1)
    if count > 2:
        keys[1, 1] = keys[2, 1]  # stands still
    retiming = Retiming.through(*keys.T, smooth)  # type: ignore[call-arg]
    found = retime(model, keys, smooth)
    times = np.linspace(keys[0, 0], keys[-1, 0], 301)
    apart = shape_norm(model)(found.time(times) - model.time(retiming(times)))
    assert apart.max() < 5e-5
    whole, source = found.curves[1], model.curves[1]
    np.testing.assert_allclose(whole(times), source(retiming(times)), atol=3e-4)


@pytest.mark.parametrize("smooth", [True, False])
def test_frames_are_those_of_a_resampling(smooth: bool) -> None:
    model = bar_motion()
    shown = resample(model, retiming=Retiming.through(*np.transpose(TO_AND_FRO), smooth))  # type: ignore[call-arg]
    frames = retime(model, TO_AND_FRO, smooth).sample()
    np.testing.assert_allclose(frames.times, shown.times, atol=1e-12)
    apart = np.linalg.norm(frames.points - shown.points, axis=2)
    assert apart.max() < 1e-4 * bounding_diagonal(shown.points[0])


def test_velocities_follow_the_map() -> None:
    model = bar_motion()
    slow = retime(model, [[0.0, 0.0], [0.8, 0.4], [1.6, 0.6]], smooth=False)
    np.testing.assert_allclose(slow.velocity(0.41), 0.5 * model.velocity(0.205), atol=2e-2)
    np.testing.assert_allclose(slow.velocity(1.23), 0.25 * model.velocity(0.5075), atol=2e-2)


def test_a_pose_that_is_held() -> None:
    for model in (bar_motion(), bar_motion(frames=1)):
        time = model.end / 3
        held = retime(model, [[0.0, time], [1.0, time]])
        assert len(held.times) == 11
        for moment in (0.0, 0.33, 1.0):
            np.testing.assert_allclose(held(moment), model(time), atol=1e-9)


def test_a_body_that_travels_goes_back_again() -> None:
    model = spin(step=0.5)
    for moving in (model, repeat(model, 0.0, 1.0, times=2, travel=True)):
        bounce = retime(moving, [[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])
        retiming = Retiming.through([0.0, 1.0, 2.0], [0.0, 1.0, 0.0])
        assert np.linalg.norm(bounce(1.0).mean(axis=0) - bounce(0.0).mean(axis=0)) > 3.0
        for time in (0.3, 1.0, 1.4, 2.0):
            np.testing.assert_allclose(bounce(time), moving(retiming([time])[0]), atol=1e-3)


def test_frames_begin_with_the_output() -> None:
    found = retime(bar_motion(), [[0.25, 0.0], [0.78, 0.5]])
    np.testing.assert_allclose(found.times, 0.25 + np.arange(6) / 10)
    assert (found.start, found.end) == (0.25, 0.78)
    np.testing.assert_allclose(retime(bar_motion(), [[0.0, 0.0], [0.3 - 1e-9, 0.5]]).times[-1], 0.3)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ([0.0, 1.0], r"keys have shape \(2,\); \(n, 2\) is expected, pairs of a time"),
        ([[0.0, 0.0, 0.0]], r"keys have shape \(1, 3\)"),
        ([[0.0, 0.0]], "1 output times and 1 source times; two of each, or more"),
        ([[0.0, 0.0], [0.0, 0.5]], "its output times increase"),
        ([[0.0, 0.0], [1.0, np.nan]], "must be finite"),
        ([[0.0, 0.0], [1.0, 0.9]], "goes beyond the source: time 0.9 s is outside the sequence, 0 to 0.8 s"),
        ([[0.0, 0.0], [1e8, 0.8]], r"1e\+08 s at .* more than 10,000,000 frames"),
    ],
)
def test_invalid_maps_are_refused(keys: list[list[float]], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        retime(bar_motion(), keys)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["fox_run", "q_wolf_gallop"])
def test_retimed_models_equal_resampled_sequences(data: Path, name: str) -> None:
    model = fit(mixseq.read(data / "npz" / f"{name}.npz"))
    end = model.end
    keys = np.array([[0.0, 0.0], [0.5, 0.5], [1.2, 0.5], [2.0, 0.1], [2.5, 1.0]]) * end
    for smooth in (True, False):
        shown = resample(model, fps=37, retiming=Retiming.through(*keys.T, smooth))  # type: ignore[call-arg]
        points = retime(model, keys, smooth).sample(shown.times).points
        apart = np.linalg.norm(points - shown.points, axis=2).max()
        assert apart < 1e-4 * bounding_diagonal(shown.points[0])
