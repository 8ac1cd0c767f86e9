"""Operators of pieces: each is smooth by itself, and what is known at its ends is kept."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.choices import BETWEENS, BetweenName
from mixseq.sequence.events import Events
from mixseq.spaces.temporal import (
    HOLD_FRACTION,
    PiecewiseOperator,
    TemporalOperator,
    Timing,
    insert_midpoints,
    natural_slope,
    select_operator,
)
from mixseq.types import Float
from tests.motions import moving

TIMES = np.arange(24.0)


def values_of(frames: Float) -> Float:
    return moving(frames).reshape(len(frames), -1)


def operator_of(values: Float, events: Events, between: BetweenName = "auto", times: Float = TIMES) -> TemporalOperator:
    return Timing(events, between).select_operator(times, values, values)


def speeds(operator: TemporalOperator, values: Float, at: float) -> tuple[Float, Float]:
    """Slopes before and after a time, by one-sided differences of second order."""
    h = 1e-6
    before, after = (
        operator.weights_at(np.array([at, at + sign * h, at + 2 * sign * h])).interpolate(values) for sign in (-1, 1)
    )
    return -(4 * before[1] - 3 * before[0] - before[2]) / (2 * h), (4 * after[1] - 3 * after[0] - after[2]) / (2 * h)


EVENTS = [
    Events(cuts=(7,)),
    Events(pops=(0, 7, 22)),
    Events(cuts=(3, 4, 5), holds=((9, 14),)),
    Events(holds=((0, 3), (20, 23))),
    Events(poses=tuple(range(0, 24, 2)), frames_per_pose=2.0),
    Events(keys=(0, 4, 9, 23)),
]


@pytest.mark.parametrize("between", BETWEENS)
@pytest.mark.parametrize("events", EVENTS, ids=str)
def test_frames_are_exact_and_weights_add_up_to_one(events: Events, between: BetweenName) -> None:
    operator = operator_of(values_of(TIMES), events, between)
    weights = operator.weights_at(np.linspace(0, 23, 200))
    np.testing.assert_allclose(weights.weights.sum(axis=1), 1.0, atol=1e-9)
    assert (np.diff(weights.frame_ids, axis=1) == 1).all()
    at_frames = operator.weights_at(TIMES).interpolate(np.eye(24))
    np.testing.assert_allclose(at_frames, np.eye(24), atol=1e-13)


def test_without_events_it_is_the_smooth_operator() -> None:
    values = values_of(TIMES)
    found, expected = operator_of(values, Events()), select_operator(TIMES, values)
    assert type(found) is TemporalOperator
    assert (found.length_scale, found.cubic_shares) == (expected.length_scale, expected.cubic_shares)


def test_both_sides_of_a_cut_are_smooth_by_themselves() -> None:
    values = np.concatenate([values_of(TIMES[:10]), values_of(TIMES[10:] + 40)])
    operator = operator_of(values, Events(cuts=(9,)))
    for own in (slice(0, 10), slice(10, 24)):
        alone = select_operator(TIMES[own], values[own])
        at = insert_midpoints(TIMES[own])
        kept = alone.weights_at(at).interpolate(values[own])
        np.testing.assert_allclose(operator.weights_at(at).interpolate(values), kept, atol=1e-12)
    around = operator.weights_at(np.array([9.25, 9.499, 9.5, 9.75])).interpolate(values)
    before, after = values[9] - values[8], values[11] - values[10]
    expected = [
        values[9] + 0.25 * before,
        values[9] + 0.499 * before,
        values[10] - 0.5 * after,
        values[10] - 0.25 * after,
    ]
    np.testing.assert_allclose(around, expected, atol=1e-12)
    both = operator.weights_at(np.array([9.5, 9.5])).interpolate(values)  # given twice: both sides
    np.testing.assert_allclose(both, [values[9] + 0.5 * before, values[10] - 0.5 * after], atol=1e-12)


def test_cuts_keep_the_truth() -> None:
    """Errors of a teleport are those of the motion without it."""
    values, at = values_of(TIMES), TIMES[:-1] + 0.5
    truth, moved = values_of(at), 30.0 * (TIMES > 11)[:, None]
    alone = [np.abs(select_operator(TIMES, values).weights_at(at).interpolate(values) - truth).max()]
    cut = operator_of(values + moved, Events(cuts=(11,))).weights_at(at).interpolate(values + moved)
    smooth = select_operator(TIMES, values + moved).weights_at(at).interpolate(values + moved)
    inner = np.arange(23) != 11
    assert np.abs(cut - truth - 30.0 * (at > 11.4)[:, None])[inner].max() < 20 * alone[0] < 0.01
    assert np.abs(smooth - truth - 30.0 * (at > 11.4)[:, None])[inner].max() > 1


def test_held_frames_stay_and_are_left_suddenly_or_eased() -> None:
    for ease in (False, True):
        moments = np.maximum(TIMES - 11, 0)
        path = 1 - np.cos(moments / 4) if ease else np.sin(moments / 4)
        values = path[:, None] * np.ones((1, 3))
        operator = operator_of(values, Events(holds=((0, 11),)))
        assert isinstance(operator, PiecewiseOperator)
        held = operator.weights_at(np.linspace(0, 11, 50)).interpolate(values)
        np.testing.assert_allclose(held, 0, atol=1e-13)
        at = np.linspace(11, 13, 30)
        truth = 1 - np.cos((at - 11) / 4) if ease else np.sin((at - 11) / 4)
        np.testing.assert_allclose(operator.weights_at(at).interpolate(values)[:, 0], truth, atol=2e-3)
        before, after = speeds(operator, values, 11.0)
        np.testing.assert_allclose(before, 0, atol=1e-7)
        np.testing.assert_allclose(after, 0.0 if ease else 0.25, atol=0.02)


def test_breaks_of_speed_do_not_overshoot_and_stay_smooth() -> None:
    """A pose that is keyed again after a hundredth of a frame, and a gap."""
    for times in (np.insert(TIMES[:-1], 12, 11.01), TIMES + 50.0 * (TIMES > 11)):
        values = values_of(TIMES)
        operator = operator_of(values, Events(), times=times)
        assert isinstance(operator, PiecewiseOperator)
        at = np.linspace(times[0], times[-1], 4000)
        found = operator.weights_at(at).interpolate(values)
        k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, 22)
        near = np.stack([values[np.clip(k + offset, 0, 23)] for offset in (-1, 0, 1, 2)])
        size = np.abs(np.diff(values, axis=0)).max()
        assert max((found - near.max(axis=0)).max(), (near.min(axis=0) - found).max()) < 0.35 * size
        for edge in operator.edges:
            before, after = speeds(operator, values, edge)
            np.testing.assert_allclose(before, after, atol=1e-3 * np.abs(before).max())
        spline = TemporalOperator(times).weights_at(at).interpolate(values)
        assert max((spline - near.max(axis=0)).max(), (near.min(axis=0) - spline).max()) > size


def test_repeated_poses_wait_until_half_way() -> None:
    events = Events(poses=(0, 3, 6, 9, 12, 15, 18, 21), frames_per_pose=3.0)
    values = values_of(np.floor(TIMES / 3))
    at = np.array([2.4, 2.6, 5.49, 5.51])
    found = operator_of(values, events).weights_at(at).interpolate(values)
    np.testing.assert_allclose(found, values[[2, 3, 5, 6]], atol=1e-12)


def test_linear_and_held_motion() -> None:
    values = values_of(TIMES)
    at = np.array([3.25, 11.5, 22.9])
    k, b = np.floor(at).astype(int), (at - np.floor(at))[:, None]
    found = operator_of(values, Events(), "linear").weights_at(at).interpolate(values)
    np.testing.assert_allclose(found, (1 - b) * values[k] + b * values[k + 1], atol=1e-12)
    found = operator_of(values, Events(), "hold").weights_at(np.append(at, 4 - 1e-9)).interpolate(values)
    np.testing.assert_allclose(found, values[[*k, 4]], atol=1e-12)  # a rounded time is the frame's
    assert pytest.approx(0.999) == HOLD_FRACTION


def test_motion_has_corners_at_keys_only() -> None:
    keys = np.array([0, 4, 9, 23])
    values = np.stack([np.interp(TIMES, keys, [0.0, 2, 1, 8])] * 2, axis=1)
    operator = operator_of(values, Events(keys=tuple(keys.tolist())))
    at = np.linspace(0, 23, 100)
    expected = np.interp(at, keys, [0.0, 2, 1, 8])
    np.testing.assert_allclose(operator.weights_at(at).interpolate(values)[:, 0], expected, atol=1e-12)
    assert isinstance(operator, PiecewiseOperator)
    assert operator.edges == (4.0, 9.0)


@pytest.mark.parametrize("count", [2, 3, 5, 60])
def test_slopes_at_the_ends_are_those_of_the_natural_spline(count: int) -> None:
    from scipy.interpolate import CubicSpline

    times = np.cumsum(np.random.default_rng(count).uniform(0.5, 1.5, count))
    values = np.sin(times)
    operator, spline = TemporalOperator(times, cubic_shares=(0.0, 0.0)), CubicSpline(times, values, bc_type="natural")
    for end in (0, 1):
        slope = natural_slope(operator, end)
        assert slope.weights @ values[slope.frame_ids] == pytest.approx(spline(times[-end], nu=1), abs=1e-8)


def test_left_out_frames_are_inside_pieces() -> None:
    values = values_of(TIMES)
    left_out, weights = operator_of(values, Events(cuts=(7,), holds=((12, 15),))).leave_one_out()
    assert set(left_out) == set(range(24)) - {0, 7, 8, 12, 15, 23}
    own = weights.interpolate(np.eye(24))
    assert not own[np.arange(len(left_out)), left_out].any()
    assert not own[left_out < 8, 8:].any()
    assert len(operator_of(values, Events(), "hold").leave_one_out()[0])
