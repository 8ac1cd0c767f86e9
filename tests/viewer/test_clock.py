"""What frame is seen when."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.viewer.playback import Clock

NOW = 1e5
"""Seconds for which a machine may have been up."""

clocks = st.builds(
    Clock,
    count=st.integers(1, 500),
    fps=st.floats(1.0, 240.0),
    speed=st.sampled_from([0.25, 0.5, 1.0, 2.0]),
).flatmap(lambda clock: st.integers(0, clock.count - 1).map(lambda frame: clock.sought(frame, NOW)))


def test_it_stands_until_it_is_started() -> None:
    clock = Clock(10, 24.0)
    assert not clock.runs
    assert [clock.at(NOW), clock.at(NOW + 100)] == [0, 0]


@pytest.mark.parametrize("speed", [0.25, 1.0, 2.0])
def test_frames_follow_each_other_at_their_rate(speed: float) -> None:
    clock = Clock(10, 24.0, speed).started(NOW)
    frame = 1 / (24.0 * speed)
    assert clock.runs
    assert [clock.at(NOW + k * frame) for k in range(12)] == [*range(10), 0, 1]
    assert [clock.at(NOW + (k + 0.99) * frame) for k in range(12)] == [*range(10), 0, 1]
    assert clock.next_at(NOW + 2.25 * frame) == pytest.approx(0.75 * frame, rel=1e-4)


def test_after_many_rounds() -> None:
    clock = Clock(10, 24.0).started(NOW)
    assert clock.at(NOW + 1000 * 10 / 24 + 3.5 / 24) == 3


def test_stop_and_go() -> None:
    stopped = Clock(10, 10.0).started(NOW).stopped(NOW + 0.55)
    assert not stopped.runs
    assert stopped.at(NOW + 77) == 5
    going = stopped.started(NOW + 80)
    assert [going.at(NOW + 80.05), going.at(NOW + 80.15)] == [5, 6]


def test_started_again_it_goes_on() -> None:
    clock = Clock(10, 10.0).started(NOW).started(NOW + 0.55)
    assert [clock.at(NOW + 0.59), clock.at(NOW + 0.61)] == [5, 6]


@pytest.mark.parametrize(("wanted", "found"), [(4, 4), (-3, 0), (10, 9), (9999, 9)])
def test_seek(wanted: int, found: int) -> None:
    standing = Clock(10, 10.0).sought(wanted, NOW)
    assert (standing.at(NOW + 5), standing.runs) == (found, False)
    running = Clock(10, 10.0).started(NOW).sought(wanted, NOW + 0.33)
    assert [running.at(NOW + 0.33), running.at(NOW + 0.44)] == [found, (found + 1) % 10]


def test_another_speed_goes_on_where_it_is() -> None:
    clock = Clock(100, 10.0).started(NOW).paced(2.0, NOW + 1.0)
    assert [clock.at(NOW + 1.0), clock.at(NOW + 2.0)] == [10, 30]
    standing = Clock(100, 10.0).sought(7, NOW).paced(0.5, NOW + 1.0)
    assert (standing.at(NOW + 9), standing.runs, standing.speed) == (7, False, 0.5)


def test_over_another_period_at_the_same_time() -> None:
    standing = Clock(10, 10.0).sought(5, NOW)  # half a second
    assert standing.over(20, 20.0, NOW).at(NOW) == 10
    assert standing.over(3, 10.0, NOW).at(NOW) == 2  # which is over by then
    running = standing.started(NOW).over(20, 20.0, NOW + 0.15)  # 0.65 s
    assert running.runs
    assert [running.at(NOW + 0.15), running.at(NOW + 0.201), running.at(NOW + 1.0)] == [13, 14, 10]


def test_over_a_rate_and_back() -> None:
    clock = Clock(48, 24.0).sought(17, NOW)
    assert clock.over(120, 60.0, NOW).over(48, 24.0, NOW).at(NOW) == 17


@given(clocks, st.floats(0.0, 1e4))
def test_there_is_always_a_frame(clock: Clock, passed: float) -> None:
    running = clock.started(NOW)
    assert 0 <= running.at(NOW + passed) < clock.count
    assert clock.at(NOW + passed) == clock.at(NOW)
    assert running.stopped(NOW + passed).at(NOW) == running.at(NOW + passed)
    wait = running.next_at(NOW + passed)
    assert 0 < wait <= 1 / (clock.fps * clock.speed)


@given(clocks, st.lists(st.floats(0.0, 1.0), min_size=2))
def test_within_a_round_frames_only_grow(clock: Clock, shares: list[float]) -> None:
    running = clock.started(NOW)
    left = (clock.count - clock.at(NOW) - 0.01) / (clock.fps * clock.speed)
    frames = [running.at(NOW + share * left) for share in sorted(shares)]
    assert frames == sorted(frames)


@given(clocks, st.floats(0.0, 100.0), st.integers(1, 500), st.floats(1.0, 240.0))
def test_over_any_period(clock: Clock, passed: float, count: int, fps: float) -> None:
    for one in (clock, clock.started(NOW)):
        other = one.over(count, fps, NOW + passed)
        assert other.runs == one.runs
        assert 0 <= other.at(NOW + passed) < count
