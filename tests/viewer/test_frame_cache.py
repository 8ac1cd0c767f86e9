"""What is decoded, in which order, and what is kept."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from threading import Event, Thread
from threading import enumerate as all_threads

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mixseq.errors import ReconstructionError
from mixseq.pictures.scene import Scene
from mixseq.types import Single
from mixseq.viewer.playback import Clock, FrameCache
from tests.viewer.staged import PATIENCE, Watched, eventually, scene_of, watched

POSE = 48
"""Bytes of a pose of `watched`."""

Make = Callable[..., FrameCache]


@pytest.fixture
def make() -> Iterator[Make]:
    """Makes frames, and closes them."""
    made: list[FrameCache] = []

    def make_it(threads: int = 1, memory: int = 1 << 20, ready: Callable[[], None] = lambda: None) -> FrameCache:
        made.append(FrameCache(ready, threads, memory))
        return made[-1]

    yield make_it
    for frames in made:
        frames.close()


def wait_for(frames: FrameCache, scene: Scene, frame: int, ahead: bool = False) -> tuple[Single, ...]:
    found: list[tuple[Single, ...]] = []

    def came() -> bool:
        found.extend(filter(None, [frames.request(scene, frame, ahead)]))
        return bool(found)

    eventually(came)
    return found[0]


def test_a_frame_that_is_wanted_comes(make: Make) -> None:
    ready = Event()
    frames, a, b = make(ready=ready.set), watched(), watched()
    a.held[3] = Event()
    assert frames.request(scene_of(a, b), 3, ahead=False) is None
    assert not ready.is_set()
    a.held[3].set()
    assert ready.wait(PATIENCE)
    poses = wait_for(frames, scene_of(a, b), 3)
    assert [pose[0, 0] for pose in poses] == [3, 3]
    assert (a.decoded, b.decoded) == ([3], [3])


def test_what_is_kept_is_not_decoded_again(make: Make) -> None:
    frames, item = make(), watched()
    first = wait_for(frames, scene_of(item), 2)
    assert frames.request(scene_of(item), 2)[0] is first[0]  # type: ignore[index]  # of another scene, but the same item
    wait_for(frames, scene_of(item, watched()), 2)
    assert item.decoded.count(2) == 1


def test_the_newest_wish_wins(make: Make) -> None:
    frames, item = make(), watched()
    item.held[0] = Event()
    frames.request(scene_of(item), 0, ahead=False)
    eventually(lambda: item.decoded == [0])
    frames.request(scene_of(item), 5, ahead=False)
    frames.request(scene_of(item), 9, ahead=False)
    item.held[0].set()
    wait_for(frames, scene_of(item), 9)
    assert item.decoded == [0, 9]


def test_what_comes_next_is_decoded_ahead(make: Make) -> None:
    frames, item = make(), watched(10)
    frames.request(scene_of(item), 6, ahead=True)
    eventually(lambda: len(item.decoded) == 10)
    assert item.decoded == [6, 7, 8, 9, 0, 1, 2, 3, 4, 5]


def test_a_wish_goes_before_what_comes_next(make: Make) -> None:
    frames, item = make(), watched(10)
    item.held[1] = Event()
    frames.request(scene_of(item), 0)
    eventually(lambda: item.decoded == [0, 1])
    frames.request(scene_of(item), 7)
    item.held[1].set()
    eventually(lambda: len(item.decoded) == 10)
    assert item.decoded == [0, 1, 7, 8, 9, 2, 3, 4, 5, 6]


def test_threads_share_the_work(make: Make) -> None:
    frames, item = make(threads=2), watched(10)
    item.held.update({0: Event(), 1: Event()})
    frames.request(scene_of(item), 0)
    eventually(lambda: sorted(item.decoded) == [0, 1])  # both at once, as neither is done
    for event in item.held.values():
        event.set()
    eventually(lambda: len(item.decoded) == 10)
    assert sorted(item.decoded) == list(range(10))


@dataclass(frozen=True, eq=False)
class Counted(Watched):
    """Knows how many of its poses there are."""

    made: list[weakref.ref[Single]] = field(default_factory=list)
    alive: list[int] = field(default_factory=list)

    def pose(self, elapsed: float) -> Single:
        """Make a pose, and count those that there are."""
        made = super().pose(elapsed)
        self.alive.append(sum(pose() is not None for pose in self.made))
        self.made.append(weakref.ref(made))
        return made


def test_no_more_is_kept_than_there_is_memory(make: Make) -> None:
    item = Counted("mesh", watched(50).motion)
    frames = make(memory=4 * POSE)
    for frame in (0, 10, 20, 30, 7, 8, 49, 20, 21, 22, 23):
        wait_for(frames, scene_of(item), frame, ahead=True)
    assert max(item.alive) == 4


def test_ahead_as_far_as_there_is_memory(make: Make) -> None:
    frames, item = make(memory=8 * POSE), watched(50)
    frames.request(scene_of(item), 20)
    eventually(lambda: len(item.decoded) == 6)
    wait_for(frames, scene_of(item), 20, ahead=True)
    frames.close()
    assert item.decoded == [20, 21, 22, 23, 24, 25]


def test_one_frame_may_be_larger_than_the_memory(make: Make) -> None:
    frames, item = make(memory=1), watched()
    for frame in (3, 4, 3):
        assert wait_for(frames, scene_of(item), frame)[0][0, 0] == frame
    assert item.decoded == [3, 4, 3]


def test_what_was_used_last_is_kept(make: Make) -> None:
    frames, item = make(memory=3 * POSE), watched()
    for frame in (0, 1, 2, 0, 3):  # 1 has to go
        wait_for(frames, scene_of(item), frame)
    assert item.decoded == [0, 1, 2, 3]
    wait_for(frames, scene_of(item), 0)
    assert item.decoded == [0, 1, 2, 3]
    wait_for(frames, scene_of(item), 1)
    assert item.decoded == [0, 1, 2, 3, 1]


def test_an_error_is_raised_once_and_tried_again(make: Make) -> None:
    frames, item = make(), watched()
    scene = scene_of(item)
    item.broken.add(4)
    with pytest.raises(ReconstructionError, match="frame 4 is broken"):
        wait_for(frames, scene, 4)
    eventually(lambda: item.decoded == [4, 4])
    assert wait_for(frames, scene, 5)[0][0, 0] == 5
    item.broken.clear()
    with pytest.raises(ReconstructionError):  # of the second try
        wait_for(frames, scene, 4)
    np.testing.assert_array_equal(wait_for(frames, scene, 4)[0], np.full((4, 3), 4))


def test_an_error_ahead_is_raised_where_it_is_seen(make: Make) -> None:
    frames, item = make(), watched(4)
    item.broken.add(2)
    frames.request(scene_of(item), 0)
    eventually(lambda: item.decoded == [0, 1, 2, 3])
    assert wait_for(frames, scene_of(item), 1, ahead=True)
    with pytest.raises(ReconstructionError):
        wait_for(frames, scene_of(item), 2, ahead=True)


def test_no_thread_is_left() -> None:
    before = set(all_threads())
    item = watched()
    with FrameCache(lambda: None, threads=3) as frames:
        assert len(set(all_threads()) - before) == 3
        frames.request(scene_of(item), 0)
    assert not set(all_threads()) - before


def test_closing_waits_for_frames_at_hand_only() -> None:
    frames, item = FrameCache(lambda: None, threads=1), watched()
    item.held[0] = Event()
    frames.request(scene_of(item), 0)
    eventually(lambda: item.decoded == [0])
    closing = Thread(target=frames.close)
    closing.start()
    item.held[0].set()
    closing.join(PATIENCE)
    assert not closing.is_alive()
    assert item.decoded in ([0], [0, 1])  # the second, if it came before the end


# What frame is seen when

NOW = 1e5
"""Seconds for which a machine may have been up."""

clocks = st.builds(
    Clock, count=st.integers(1, 500), fps=st.floats(1.0, 240.0), speed=st.sampled_from([0.25, 0.5, 1.0, 2.0])
).flatmap(lambda clock: st.integers(0, clock.count - 1).map(lambda frame: clock.seek(frame, NOW)))


def test_it_stands_until_it_is_started() -> None:
    clock = Clock(10, 24.0)
    assert not clock.is_running
    assert [clock.frame_at(NOW), clock.frame_at(NOW + 100)] == [0, 0]


@pytest.mark.parametrize("speed", [0.25, 1.0, 2.0])
def test_frames_follow_each_other_at_their_rate(speed: float) -> None:
    clock = Clock(10, 24.0, speed).start(NOW)
    frame = 1 / (24.0 * speed)
    assert clock.is_running
    assert [clock.frame_at(NOW + k * frame) for k in range(12)] == [*range(10), 0, 1]
    assert [clock.frame_at(NOW + (k + 0.99) * frame) for k in range(12)] == [*range(10), 0, 1]
    assert clock.seconds_to_next_frame(NOW + 2.25 * frame) == pytest.approx(0.75 * frame, rel=1e-4)


def test_after_many_rounds() -> None:
    clock = Clock(10, 24.0).start(NOW)
    assert clock.frame_at(NOW + 1000 * 10 / 24 + 3.5 / 24) == 3


def test_stop_and_go() -> None:
    stopped = Clock(10, 10.0).start(NOW).stop(NOW + 0.55)
    assert not stopped.is_running
    assert stopped.frame_at(NOW + 77) == 5
    going = stopped.start(NOW + 80)
    assert [going.frame_at(NOW + 80.05), going.frame_at(NOW + 80.15)] == [5, 6]


def test_started_again_it_goes_on() -> None:
    clock = Clock(10, 10.0).start(NOW).start(NOW + 0.55)
    assert [clock.frame_at(NOW + 0.59), clock.frame_at(NOW + 0.61)] == [5, 6]


@pytest.mark.parametrize(("wanted", "found"), [(4, 4), (-3, 0), (10, 9), (9999, 9)])
def test_seek(wanted: int, found: int) -> None:
    standing = Clock(10, 10.0).seek(wanted, NOW)
    assert (standing.frame_at(NOW + 5), standing.is_running) == (found, False)
    running = Clock(10, 10.0).start(NOW).seek(wanted, NOW + 0.33)
    assert [running.frame_at(NOW + 0.33), running.frame_at(NOW + 0.44)] == [found, (found + 1) % 10]


def test_another_speed_goes_on_where_it_is() -> None:
    clock = Clock(100, 10.0).start(NOW).with_speed(2.0, NOW + 1.0)
    assert [clock.frame_at(NOW + 1.0), clock.frame_at(NOW + 2.0)] == [10, 30]
    standing = Clock(100, 10.0).seek(7, NOW).with_speed(0.5, NOW + 1.0)
    assert (standing.frame_at(NOW + 9), standing.is_running, standing.speed) == (7, False, 0.5)


def test_over_another_period_at_the_same_time() -> None:
    standing = Clock(10, 10.0).seek(5, NOW)  # half a second
    assert standing.with_period(20, 20.0, NOW).frame_at(NOW) == 10
    assert standing.with_period(3, 10.0, NOW).frame_at(NOW) == 2  # which is over by then
    running = standing.start(NOW).with_period(20, 20.0, NOW + 0.15)  # 0.65 s
    assert running.is_running
    assert [running.frame_at(NOW + 0.15), running.frame_at(NOW + 0.201), running.frame_at(NOW + 1.0)] == [13, 14, 10]


def test_over_a_rate_and_back() -> None:
    clock = Clock(48, 24.0).seek(17, NOW)
    assert clock.with_period(120, 60.0, NOW).with_period(48, 24.0, NOW).frame_at(NOW) == 17


@given(clocks, st.floats(0.0, 1e4))
def test_there_is_always_a_frame(clock: Clock, passed: float) -> None:
    running = clock.start(NOW)
    assert 0 <= running.frame_at(NOW + passed) < clock.count
    assert clock.frame_at(NOW + passed) == clock.frame_at(NOW)
    assert running.stop(NOW + passed).frame_at(NOW) == running.frame_at(NOW + passed)
    wait = running.seconds_to_next_frame(NOW + passed)
    assert 0 < wait <= 1 / (clock.fps * clock.speed)


@given(clocks, st.lists(st.floats(0.0, 1.0), min_size=2))
def test_within_a_round_frames_only_grow(clock: Clock, shares: list[float]) -> None:
    running = clock.start(NOW)
    left = (clock.count - clock.frame_at(NOW) - 0.01) / (clock.fps * clock.speed)
    frames = [running.frame_at(NOW + share * left) for share in sorted(shares)]
    assert frames == sorted(frames)


@given(clocks, st.floats(0.0, 100.0), st.integers(1, 500), st.floats(1.0, 240.0))
def test_over_any_period(clock: Clock, passed: float, count: int, fps: float) -> None:
    for one in (clock, clock.start(NOW)):
        other = one.with_period(count, fps, NOW + passed)
        assert other.is_running == one.is_running
        assert 0 <= other.frame_at(NOW + passed) < count
