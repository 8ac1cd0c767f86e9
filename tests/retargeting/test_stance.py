"""When feet are on the ground."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.retargeting.contacts import Stance, StanceSettings, axis_of, stances
from tests.retargeting.walkers import CYCLE, DUTY, foot


def path(frames: int = 100, offset: float = 0.0) -> np.ndarray:
    forward, height, _ = foot(np.arange(frames) / CYCLE + offset)
    sole = np.array([[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0]])
    return np.asarray(np.stack([forward, height, np.zeros(frames)], axis=1)[:, None] + sole)


def found(points: np.ndarray, **other: object) -> list[tuple[int, int]]:
    arguments: dict[str, object] = {"up": "Y", "fps": 30.0, "size": 2.0, **other}
    return [(each.start, each.stop) for each in stances("foot", points, **arguments)]  # type: ignore[arg-type]


def test_a_walking_foot_rests_while_it_is_planted() -> None:
    down = round(DUTY * CYCLE)
    expected = [(0, down), (CYCLE, CYCLE + down), (2 * CYCLE, 100)]
    for (start, stop), (first, last) in zip(found(path()), expected, strict=True):
        assert first - 1 <= start <= first  # the last moment of landing is as good as rest
        assert last <= stop <= last + 2


def test_scale_rate_and_axis_do_not_matter() -> None:
    plain = found(path())
    assert found(7.0 * path(), size=14.0) == plain
    assert found(path()[..., [2, 0, 1]], up="Z") == plain
    assert found(path(), fps=60.0, size=4.0) == plain  # all twice as fast, in sizes
    assert found(path() + np.array([3.0, -5.0, 1.0])) == plain


def test_time_may_run_backwards() -> None:
    assert found(path()[::-1]) == [(100 - stop, 100 - start) for start, stop in reversed(found(path()))]


def test_a_foot_that_goes_back_as_on_a_treadmill_never_rests() -> None:
    assert found(path() - np.arange(100)[:, None, None] * [0.5 / CYCLE, 0.0, 0.0]) == []


def test_a_foot_that_is_held_up_does_not_rest() -> None:
    points = path(60)
    held = np.repeat(points[32:33], 20, axis=0)
    assert found(np.concatenate([points[:33], held, points[33:]])) == [
        (start + 20 * (start > 32), stop + 20 * (start > 32)) for start, stop in found(points)
    ]


def test_what_does_not_move_rests_all_the_time() -> None:
    assert found(np.zeros((9, 2, 3))) == [(0, 9)]
    assert found(np.zeros((1, 2, 3))) == [(0, 1)]
    jitter = 1e-5 * np.random.default_rng(0).normal(size=(50, 3, 3))
    assert found(jitter) == [(0, 50)]


def test_hysteresis() -> None:
    steps = np.concatenate(
        [np.full(5, 1.0), np.full(4, 0.07), np.full(3, 0.0), np.full(4, 0.07), np.full(5, 1.0)]
    )
    slow = np.concatenate([steps, np.full(4, 0.07), np.full(5, 1.0)])
    points = np.pad(np.cumsum(np.concatenate([[0.0], slow]))[:, None, None], ((0, 0), (0, 0), (0, 2)))
    assert found(points, size=1e-3) == [(5, 17)]  # the second slow part never comes to rest


def test_the_shortest_stance_has_two_frames() -> None:
    points = np.zeros((5, 1, 3))
    points[:, 0, 0] = [0.0, 1.0, 1.0, 2.0, 3.0]
    assert stances("toe", points, "Y", 10.0, 1.0) == (Stance("toe", 1, 3),)


@pytest.mark.parametrize(
    "points", [np.zeros((0, 1, 3)), np.zeros((4, 0, 3)), np.zeros((4, 3)), np.full((4, 1, 3), np.nan)]
)
def test_refuses_what_is_no_path(points: np.ndarray) -> None:
    with pytest.raises(SettingsError, match="the path of contact 'foot' has shape"):
        found(points)


def test_refuses_settings_out_of_range() -> None:
    with pytest.raises(SettingsError, match="fps is 0 and size is 2"):
        found(path(), fps=0.0)
    with pytest.raises(SettingsError, match="the up axis is 'W'"):
        axis_of("W")
    with pytest.raises(SettingsError, match=r"thresholds of speed are 0\.5 and 0\.1"):
        StanceSettings(speed=(0.5, 0.1))
