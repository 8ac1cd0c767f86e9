"""How far a body goes along with its feet, and what is left to its limbs."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.retargeting.contacts import Stance, body_shift, faded, misses

FPS = 24.0
STEPS = (Stance("foot", 10, 22), Stance("foot", 40, 52))


def sliding(slope: float, frames: int = 60) -> np.ndarray:
    """A foot that slides at constant speed, (1, T, 3)."""
    path = np.zeros((1, frames, 3))
    path[0, :, 0] = slope * np.arange(frames)
    return path


def test_misses_are_from_the_mean_of_every_stance() -> None:
    missed = misses(sliding(0.1), [STEPS], 1e-9)
    np.testing.assert_allclose(missed[0, 10:22, 0], 0.1 * (5.5 - np.arange(12)), atol=1e-14)
    assert not missed[0, :10].any() and not missed[0, 22:40].any()
    assert not misses(sliding(1e-12), [STEPS], 1e-9).any()


def test_feet_that_slide_evenly_carry_the_body() -> None:
    """Every stance asks for the same speed, so the body has it all the time, and limbs have nothing to do."""
    whole = (Stance("left", 0, 31), Stance("right", 30, 60))
    paths = np.concatenate([sliding(0.1), sliding(0.1)])
    shift, left = body_shift(misses(paths, [whole[:1], whole[1:]], 1e-9), [whole[:1], whole[1:]], 1, FPS)
    np.testing.assert_allclose(shift[:, 0], 0.1 * (29.5 - np.arange(60)), atol=0.01)
    assert np.abs(left).max() < 0.01
    np.testing.assert_allclose(shift.mean(axis=0), 0.0, atol=1e-12)


def test_upwards_the_body_returns() -> None:
    """A foot that rises in every stance does not press the body into the ground."""
    missed = misses(sliding(0.1)[..., [1, 0, 2]], [STEPS], 1e-9)
    shift, left = body_shift(missed, [STEPS], 1, FPS)
    assert np.abs(shift[:, 1]).max() < np.abs(missed).max()
    frames = np.r_[10:22, 40:52]
    np.testing.assert_allclose(left[0, frames, 1] + shift[frames, 1], missed[0, frames, 1], atol=1e-12)


def test_the_shift_ends_where_no_foot_asks_for_it() -> None:
    some = (Stance("foot", 0, 24),)
    shift, _ = body_shift(misses(sliding(0.1, 600), [some], 1e-9), [some], 1, FPS)
    steps = np.abs(np.diff(shift[:, 0]))
    assert steps[5:15].min() > 0.09
    assert steps[-300:].max() < 1e-3


def test_what_feet_disagree_on_is_left_to_limbs() -> None:
    both = (Stance("left", 0, 60),), (Stance("right", 0, 60),)
    paths = np.concatenate([sliding(0.1), sliding(-0.1)])
    missed = misses(paths, both, 1e-9)
    shift, left = body_shift(missed, both, 1, FPS)
    np.testing.assert_allclose(shift, 0.0, atol=1e-9)
    np.testing.assert_allclose(left, missed, atol=1e-9)


def test_fades_meet_values_and_slopes() -> None:
    wanted = np.zeros((60, 3))
    for stance in STEPS:
        wanted[stance.frames] = np.sin(0.2 * np.arange(12))[:, None] + [0.0, 1.0, 0.0]
    moves = faded(wanted, STEPS, FPS)
    for stance in STEPS:
        np.testing.assert_array_equal(moves[stance.frames], wanted[stance.frames])
    assert not moves[:4].any() and not moves[28:34].any() and not moves[58:].any()
    # No step is far from the one before: the slope goes on.
    assert np.abs(np.diff(moves, 2, axis=0)).max() < 0.35


def test_stances_that_are_near_are_joined() -> None:
    wanted = np.zeros((30, 3))
    wanted[5:12] = wanted[16:25] = 1.0
    moves = faded(wanted, (Stance("a", 5, 12), Stance("a", 16, 25)), FPS)
    np.testing.assert_allclose(moves[5:25], 1.0, atol=1e-15)


@pytest.mark.parametrize(
    "stance", [Stance("a", 0, 1), Stance("a", 0, 30), Stance("a", 28, 30), Stance("a", 0, 2)]
)
def test_fades_end_with_the_sequence(stance: Stance) -> None:
    wanted = np.zeros((30, 3))
    wanted[stance.frames] = 1.0
    moves = faded(wanted, (stance,), FPS)
    assert np.isfinite(moves).all() and moves.max() == 1.0 and moves.min() >= 0.0
    np.testing.assert_array_equal(faded(np.zeros((30, 3)), (), FPS), 0.0)
