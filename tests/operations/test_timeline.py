"""Sections, repeats and loops meet without jumps; shifts, speeds and reversals are affine maps of time."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.choices import SpaceName
from mixseq.errors import SettingsError
from mixseq.operations import concatenate, cut, loop, repeat, reverse, shift, speed, travel_of
from mixseq.signals.model import Model
from tests.operations.motions import CIRCLE, bar_motion, jets, jumps, spin, spinning, wheel, wheeling

MODELS = [("mixed", None), ("mixed", 2), ("vertex", None)]
"""Spaces, and inner knots: with few, the placement of the mixed space has none at most frames."""


def same(one: Model, other: Model, times: list[float], later: float = 0.0) -> None:
    """Assert that a model is at times what another one is later: all signals, their derivatives, and vertices."""
    at = np.unique(times)
    for curve, expected in zip(one.curves, other.curves, strict=True):
        size = np.abs(jets(expected, at)).max(axis=(1, 2), initial=1.0)[:, None, None]
        np.testing.assert_allclose(jets(curve, at + later) / size, jets(expected, at) / size, atol=1e-9)
    np.testing.assert_allclose(one.sample(at + later).points, other.sample(at).points, atol=1e-9)


# cut ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("space", "knots"), MODELS)
@pytest.mark.parametrize("end", [0.6, 0.53])
def test_a_cut_is_the_section(space: SpaceName, knots: int | None, end: float) -> None:
    model = bar_motion(space, knots)
    section = cut(model, 0.17, end)
    assert (section.start, section.end) == (0.17, end)
    np.testing.assert_array_equal(section.times, model.times[(model.times > 0.17) & (model.times <= end)])
    same(section, model, [0.17, 0.2, 0.33, 0.5, end])


def test_a_cut_may_start_at_another_time() -> None:
    model = bar_motion()
    section = cut(model, 0.2, 0.5, at=10)
    np.testing.assert_allclose(section.times, [10, 10.1, 10.2, 10.3])
    same(section, model, [0.2, 0.27, 0.5], later=9.8)


def test_a_cut_between_frames_has_its_ends_as_frames() -> None:
    section = cut(bar_motion(), 0.31, 0.38)
    np.testing.assert_allclose(section.times, [0.31, 0.38])
    same(section, bar_motion(), [0.31, 0.35, 0.38])


def test_times_may_be_rounded_as_printed() -> None:
    section = cut(spin(), 0.0833, 0.416667)  # frames 1 and 5
    np.testing.assert_array_equal(section.times, spin().times[1:6])


# repeat ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("space", "knots"), MODELS)
@pytest.mark.parametrize(("start", "end"), [(0.2, 0.6), (0.13, 0.57), (0.0, 0.8)])
def test_repeat_keeps_frames_outside_the_section(space: SpaceName, knots: int | None, start: float, end: float) -> None:
    model = bar_motion(space, knots)
    longer = repeat(model, start, end, times=3)
    length = end - start
    assert longer.end == pytest.approx(0.8 + 2 * length)
    outside = np.linspace(0, start, 3), np.linspace(end, 0.8, 3)
    same(longer, model, outside[0].tolist())
    same(longer, model, outside[1].tolist(), later=2 * length)
    # The first pass up to its window, the middle between its windows, the last one from its window on.
    quarter = 1.01 * length / 4
    same(longer, model, [start, end - quarter])
    same(longer, model, [start + quarter, end - quarter], later=length)
    same(longer, model, [start + quarter, end], later=2 * length)


@pytest.mark.parametrize(("space", "knots"), MODELS)
@pytest.mark.parametrize("fade", [None, 0.02, 0.4])
def test_repeat_is_smooth_at_the_seams(space: SpaceName, knots: int | None, fade: float | None) -> None:
    model = bar_motion(space, knots)
    longer = repeat(model, 0.2, 0.6, times=4, fade=fade)
    for curve, original in zip(longer.curves, model.curves, strict=True):
        assert (jumps(curve) < 1e-9).all()
        if fade != 0.4 and curve.dim:
            # A seam is half way between the end and the start, in value, slope and curvature.
            middle = jets(original, np.array([0.2, 0.6])).mean(axis=1)
            size = np.abs(middle).max(axis=1, keepdims=True, initial=1e-3)  # corrections may be all zeros
            for seam in (0.6, 1.0, 1.4):
                found = jets(curve, np.array([seam]))[:, 0]
                np.testing.assert_allclose(found / size, middle / size, atol=1e-8)


def test_frames_are_those_of_the_sections() -> None:
    np.testing.assert_allclose(repeat(bar_motion(), 0.2, 0.5, 3).times, np.arange(15) / 10)
    times = repeat(bar_motion(), 0.25, 0.55, 2).times
    np.testing.assert_allclose(times, [*np.arange(6) / 10, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1], atol=1e-12)
    times = repeat(bar_motion(), 0.2, 0.55, 2).times
    np.testing.assert_allclose(times, [*np.arange(6) / 10, 0.55, 0.65, 0.75, 0.85, 0.95, 1.05, 1.15])


def test_once_changes_nothing() -> None:
    model = bar_motion()
    same(repeat(model, 0.2, 0.6, times=1), model, [0, 0.1, 0.2, 0.41, 0.6, 0.77])


def test_travelling_goes_on() -> None:
    """A body that turns and goes on along x: after three turns it has gone three times as far."""
    longer = repeat(spin(0.1), 0, 1, times=3, travel=True)
    times = np.linspace(0, 3, 73)
    expected = spinning(2 * np.pi * times, 0.1)
    np.testing.assert_allclose(longer.sample(times).points, expected, atol=CIRCLE)
    back = repeat(spin(0.1), 0, 1, times=3).sample([0.75, 1.75]).points
    np.testing.assert_allclose(back[0] - back[1], 0, atol=1e-9)


def test_parts_travel_together() -> None:
    model = bar_motion()
    longer = repeat(model, 0.2, 0.6, times=2, travel=True)
    moved = longer.sample([1.1, 1.2]).points - model.sample([0.7, 0.8]).points
    np.testing.assert_allclose(moved, np.broadcast_to(moved[0, 0], moved.shape), atol=1e-9)
    first, last = travel_of(model)([0.2, 0.6])
    np.testing.assert_allclose(moved[0, 0], last - first, atol=1e-9)


def test_turns_add_up() -> None:
    """Quaternions go on: a spinning body is not wound back. After three turns the sign is the other one."""
    longer = repeat(spin(), 0, 1, times=3)
    times = np.linspace(0, 3, 73)
    np.testing.assert_allclose(longer.sample(times).points, spinning(2 * np.pi * times), atol=CIRCLE)
    first, last = longer.space.unpack_placements(longer.placement([0.0, 3.0])).rotations
    np.testing.assert_allclose(last, -first, atol=1e-9)


# loop -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("space", "knots"), MODELS)
@pytest.mark.parametrize("fade", [None, 0.05, 0.4])
def test_the_end_of_a_loop_is_its_start(space: SpaceName, knots: int | None, fade: float | None) -> None:
    model = bar_motion(space, knots)
    closed = loop(model, fade)
    assert (closed.start, closed.end) == (0, 0.8)
    np.testing.assert_allclose(closed.times, model.times, atol=1e-12)
    for curve in closed.curves:
        ends = jets(curve, np.array([0.0, 0.8]))
        size = np.abs(jets(curve, np.linspace(0, 0.8, 40))).max(axis=(1, 2), initial=0.0)[:, None]
        np.testing.assert_allclose(ends[:, 0], ends[:, 1], atol=1e-9 * (1 + size.max()))
        assert (jumps(curve) < 1e-9).all()
    points = closed.sample([0.0, 0.8]).points
    np.testing.assert_allclose(points[0], points[1], atol=1e-9)
    np.testing.assert_allclose(closed.velocity(0.0), closed.velocity(0.8), atol=1e-6)
    same(closed, model, [0.4] if fade == 0.4 else [0.15, 0.3, 0.4, 0.6])


def test_a_loop_repeats_without_a_change() -> None:
    closed = loop(bar_motion())
    longer = repeat(closed, 0, 0.8, times=2)
    same(longer, closed, [0.0, 0.1, 0.5, 0.75, 0.79])
    same(longer, closed, [0.0, 0.1, 0.5, 0.75, 0.8], later=0.8)


def test_a_spinning_body_loops_as_it_is() -> None:
    closed = loop(spin())
    times = np.linspace(0, 1, 25)
    np.testing.assert_allclose(closed.sample(times).points, spinning(2 * np.pi * times), atol=CIRCLE)


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"start": -0.1}, r"start is -0.1 s; the model is from 0 to 0.8 s"),
        ({"end": 0.9}, r"end is 0.9 s; the model is from 0 to 0.8 s"),
        ({"end": np.nan}, r"end is nan s; the model is from"),
        ({"start": 0.6}, r"no time between the start, 0.6 s, and the end, 0.6 s"),
        ({"start": 0.7}, r"no time between the start, 0.7 s, and the end, 0.6 s"),
        ({"times": 0}, r"times is 0; give 1 to 10,000 repetitions"),
        ({"times": 10**8}, r"times is 100000000; give 1 to 10,000 repetitions"),
        ({"fade": 0.0}, r"fade is 0 s; give 4e-07 to 0.4 s"),
        ({"fade": 1e-9}, r"fade is 1e-09 s; give 4e-07 to 0.4 s"),
        ({"fade": 0.5}, r"fade is 0.5 s; give 4e-07 to 0.4 s"),
        ({"fade": np.nan}, r"fade is nan s"),
    ],
)
def test_refusals(settings: dict[str, float], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        repeat(bar_motion(), **{"start": 0.2, "end": 0.6, **settings})  # type: ignore[arg-type]


def test_travel_without_placement_is_refused() -> None:
    with pytest.raises(SettingsError, match="the vertex space has no positions of bodies"):
        repeat(bar_motion("vertex"), 0.2, 0.6, travel=True)


def test_other_refusals() -> None:
    with pytest.raises(SettingsError, match=r"fade is 0.5 s; give 4e-07 to 0.4 s"):
        loop(bar_motion(), 0.5)
    with pytest.raises(SettingsError, match="no time between"):
        loop(bar_motion(frames=1))
    with pytest.raises(SettingsError, match="no time between"):
        cut(bar_motion(), 0.5, 0.3)
    with pytest.raises(SettingsError, match="seconds is inf"):
        cut(bar_motion(), 0.3, 0.5, at=np.inf)


KNOTS = [None, 2]


@pytest.mark.parametrize("knots", KNOTS)
def test_shift(knots: int | None) -> None:
    model = bar_motion(knots=knots)
    later = shift(model, 2.5)
    np.testing.assert_allclose(later.times, model.times + 2.5)
    np.testing.assert_allclose(later.sample().points, model.sample().points, atol=1e-9)
    np.testing.assert_allclose(later(2.77), model(0.27), atol=1e-9)


@pytest.mark.parametrize("knots", KNOTS)
@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_speed(knots: int | None, factor: float) -> None:
    model = cut(bar_motion(knots=knots), 0.2, 0.7)
    faster = speed(model, factor)
    assert (faster.start, faster.end) == pytest.approx((0.2, 0.2 + 0.5 / factor))
    np.testing.assert_allclose(faster.times, 0.2 + (model.times - 0.2) / factor)
    np.testing.assert_allclose(faster(0.2 + 0.33 / factor), model(0.53), atol=1e-9)
    np.testing.assert_allclose(faster.velocity(0.2 + 0.33 / factor), factor * model.velocity(0.53), atol=1e-8)


@pytest.mark.parametrize("knots", KNOTS)
def test_reverse(knots: int | None) -> None:
    model = cut(bar_motion(knots=knots), 0.2, 0.7)
    back = reverse(model)
    assert (back.start, back.end) == pytest.approx((0.2, 0.7))
    np.testing.assert_allclose(back.sample().points, model.sample().points[::-1], atol=1e-9)
    np.testing.assert_allclose(back(0.33), model(0.57), atol=1e-9)
    np.testing.assert_allclose(back.velocity(0.33), -model.velocity(0.57), atol=1e-8)
    np.testing.assert_allclose(reverse(back).curve([0.33, 0.7]), model.curve([0.33, 0.7]), atol=1e-10)


def test_one_frame() -> None:
    model = bar_motion(frames=1)
    for edited in (shift(model, 1.0), speed(model, 2.0), reverse(model)):
        np.testing.assert_allclose(edited.sample().points, model.sample().points, atol=1e-12)


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_speeds_are_positive(factor: float) -> None:
    with pytest.raises(SettingsError, match=r"factor is .*; a positive number is expected"):
        speed(bar_motion(), factor)


@pytest.mark.parametrize("seconds", [np.nan, np.inf])
def test_shifts_are_finite(seconds: float) -> None:
    with pytest.raises(SettingsError, match=r"seconds is .*; a number is expected"):
        shift(bar_motion(), seconds)


# Parts that turn by whole turns ---------------------------------------------------------------------------

OFF = 0.01
"""How far vertices of the wheel, 2 from its hub, are off next to a seam; quaternions go straight from knot to knot."""


def test_a_wheel_that_is_repeated_turns_on() -> None:
    longer = repeat(wheel(), 0.0, 1.0, 3)
    times = np.linspace(0, 3, 145)
    np.testing.assert_allclose(longer.sample(times).points, wheeling(2 * np.pi * times), atol=OFF)
    assert len(longer.shapes) == 2 * len(wheel().shapes)
    assert all((jumps(curve) < 1e-9).all() for curve in longer.curves)


@pytest.mark.parametrize("times", [1, 3])
def test_a_wheel_in_a_loop_turns_on(times: int) -> None:
    at = np.linspace(0, times, 48 * times + 1)
    for closed in (loop(repeat(wheel(), 0.0, 1.0, times)), repeat(loop(wheel()), 0.0, 1.0, times)):
        np.testing.assert_allclose(closed.sample(at).points, wheeling(2 * np.pi * at), atol=OFF)
        assert len(closed.shapes) == 2 * len(wheel().shapes)


def test_a_wheel_goes_on_as_another_one() -> None:
    """Which begins with the other sign."""
    both = concatenate(cut(wheel(), 0.0, 0.6), wheel(1.2 * np.pi))
    times = np.linspace(0, 1.6, 97)
    np.testing.assert_allclose(both.sample(times).points, wheeling(2 * np.pi * times), atol=OFF)
