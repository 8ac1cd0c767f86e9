"""Stances of feet, and the body shift that keeps them in place."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.retargeting.contacts import Stance, anchor_offsets, fade_moves, find_stances, solve_body_shift
from tests.retargeting.walkers import CYCLE, DUTY, foot


def path(frames: int = 100, offset: float = 0.0) -> np.ndarray:
    forward, height, _ = foot(np.arange(frames) / CYCLE + offset)
    sole = np.array([[-0.025, 0.0, 0.0], [0.025, 0.0, 0.0]])
    return np.asarray(np.stack([forward, height, np.zeros(frames)], axis=1)[:, None] + sole)


def found(points: np.ndarray, axis: int = 1, fps: float = 30.0, size: float = 1.0) -> list[tuple[int, int]]:
    return [(each.start, each.stop) for each in find_stances(points / size, axis, fps)]


def test_a_walking_foot_rests_while_it_is_planted() -> None:
    down = round(DUTY * CYCLE)
    expected = [(0, down), (CYCLE, CYCLE + down), (2 * CYCLE, 100)]
    for (start, stop), (first, last) in zip(found(path()), expected, strict=True):
        assert first - 1 <= start <= first  # the last moment of landing is as good as rest
        assert last <= stop <= last + 2


def test_rate_axis_and_place_do_not_matter() -> None:
    plain = found(path())
    assert found(path()[..., [2, 0, 1]], axis=2) == plain
    assert found(path(), fps=60.0, size=2.0) == plain  # all twice as fast, in sizes
    assert found(path() + np.array([3.0, -5.0, 1.0])) == plain


def test_time_may_run_backwards() -> None:
    assert found(path()[::-1]) == [(100 - stop, 100 - start) for start, stop in reversed(found(path()))]


def test_a_foot_that_goes_back_as_on_a_treadmill_never_rests() -> None:
    assert found(path() - np.arange(100)[:, None, None] * [0.25 / CYCLE, 0.0, 0.0]) == []


def test_a_lifted_foot_does_not_rest() -> None:
    points = path(60)
    held = np.repeat(points[32:33], 20, axis=0)
    assert found(np.concatenate([points[:33], held, points[33:]])) == [
        (start + 20 * (start > 32), stop + 20 * (start > 32)) for start, stop in found(points)
    ]


def test_a_still_foot_rests_in_all_frames() -> None:
    assert found(np.zeros((9, 2, 3))) == [(0, 9)]
    assert found(np.zeros((1, 2, 3))) == [(0, 1)]
    jitter = 1e-5 * np.random.default_rng(0).normal(size=(50, 3, 3))
    assert found(jitter) == [(0, 50)]


def test_hysteresis() -> None:
    steps = np.concatenate([np.full(5, 1.0), np.full(4, 0.07), np.full(3, 0.0), np.full(4, 0.07), np.full(5, 1.0)])
    slow = np.concatenate([steps, np.full(4, 0.07), np.full(5, 1.0)])
    points = np.pad(np.cumsum(np.concatenate([[0.0], slow]))[:, None, None], ((0, 0), (0, 0), (0, 2)))
    assert found(points, size=1e-3) == [(5, 17)]  # the second slow part never comes to rest


def test_the_shortest_stance_has_two_frames() -> None:
    points = np.zeros((5, 1, 3))
    points[:, 0, 0] = [0.0, 1.0, 1.0, 2.0, 3.0]
    assert find_stances(points, 1, 10.0) == (Stance(1, 3),)


# How far a body goes along with its feet, and what is left to its limbs

FPS = 24.0
STEPS = (Stance(10, 22), Stance(40, 52))


def sliding(slope: float, frames: int = 60) -> np.ndarray:
    """A foot that slides at constant speed, (1, T, 3)."""
    path = np.zeros((1, frames, 3))
    path[0, :, 0] = slope * np.arange(frames)
    return path


def test_misses_are_from_the_mean_of_every_stance() -> None:
    missed = anchor_offsets(sliding(0.1), [STEPS])
    np.testing.assert_allclose(missed[0, 10:22, 0], 0.1 * (5.5 - np.arange(12)), atol=1e-14)
    assert not missed[0, :10].any() and not missed[0, 22:40].any()
    assert not anchor_offsets(sliding(1e-12), [STEPS]).any()


def test_feet_that_slide_evenly_carry_the_body() -> None:
    """Every stance asks for the same speed, so the body has it all the time, and limbs have nothing to do."""
    whole = (Stance(0, 31), Stance(30, 60))
    paths = np.concatenate([sliding(0.1), sliding(0.1)])
    shift, left = solve_body_shift(anchor_offsets(paths, [whole[:1], whole[1:]]), [whole[:1], whole[1:]], 1, FPS)
    np.testing.assert_allclose(shift[:, 0], 0.1 * (29.5 - np.arange(60)), atol=0.01)
    assert np.abs(left).max() < 0.01
    np.testing.assert_allclose(shift.mean(axis=0), 0.0, atol=1e-12)


def test_upwards_the_body_returns() -> None:
    """A foot that rises in every stance does not press the body into the ground."""
    missed = anchor_offsets(sliding(0.1)[..., [1, 0, 2]], [STEPS])
    shift, left = solve_body_shift(missed, [STEPS], 1, FPS)
    assert np.abs(shift[:, 1]).max() < np.abs(missed).max()
    frames = np.r_[10:22, 40:52]
    np.testing.assert_allclose(left[0, frames, 1] + shift[frames, 1], missed[0, frames, 1], atol=1e-12)


def test_shift_vanishes_without_stances() -> None:
    some = (Stance(0, 24),)
    shift, _ = solve_body_shift(anchor_offsets(sliding(0.1, 600), [some]), [some], 1, FPS)
    steps = np.abs(np.diff(shift[:, 0]))
    assert steps[5:15].min() > 0.09
    assert steps[-300:].max() < 1e-3


def test_opposite_offsets_remain_for_limbs() -> None:
    both = (Stance(0, 60),), (Stance(0, 60),)
    paths = np.concatenate([sliding(0.1), sliding(-0.1)])
    missed = anchor_offsets(paths, both)
    shift, left = solve_body_shift(missed, both, 1, FPS)
    np.testing.assert_allclose(shift, 0.0, atol=1e-9)
    np.testing.assert_allclose(left, missed, atol=1e-9)


def test_fades_meet_values_and_slopes() -> None:
    wanted = np.zeros((60, 3))
    for stance in STEPS:
        wanted[stance.frames] = np.sin(0.2 * np.arange(12))[:, None] + [0.0, 1.0, 0.0]
    moves = fade_moves(wanted, STEPS, FPS)
    for stance in STEPS:
        np.testing.assert_array_equal(moves[stance.frames], wanted[stance.frames])
    assert not moves[:4].any() and not moves[28:34].any() and not moves[58:].any()
    # No step is far from the one before: the slope goes on.
    assert np.abs(np.diff(moves, 2, axis=0)).max() < 0.35


def test_stances_that_are_near_are_joined() -> None:
    wanted = np.zeros((30, 3))
    wanted[5:12] = wanted[16:25] = 1.0
    moves = fade_moves(wanted, (Stance(5, 12), Stance(16, 25)), FPS)
    np.testing.assert_allclose(moves[5:25], 1.0, atol=1e-15)


@pytest.mark.parametrize("stance", [Stance(0, 1), Stance(0, 30), Stance(28, 30), Stance(0, 2)])
def test_fades_end_with_the_sequence(stance: Stance) -> None:
    wanted = np.zeros((30, 3))
    wanted[stance.frames] = 1.0
    moves = fade_moves(wanted, (stance,), FPS)
    assert np.isfinite(moves).all() and moves.max() == 1.0 and moves.min() >= 0.0
    np.testing.assert_array_equal(fade_moves(np.zeros((30, 3)), (), FPS), 0.0)
