"""Which frames are sent to the stage, and when."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Event, Thread
from threading import enumerate as all_threads
from time import monotonic

import pytest

from mixseq.errors import ReconstructionError, SettingsError
from mixseq.pictures.scene import Scene
from mixseq.viewer import playback as module
from mixseq.viewer.playback import DRAW_TIMEOUT_SECONDS, Moment, Playback
from tests.viewer import staged
from tests.viewer.staged import Stage, Standing, eventually, scene_of, watched

Make = Callable[[Scene], Playback]


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> Standing:
    standing = Standing()
    monkeypatch.setattr(module, "monotonic", standing)
    return standing


@pytest.fixture
def stage() -> Stage:
    return Stage()


@pytest.fixture
def failures() -> list[Exception]:
    return []


@pytest.fixture
def make(stage: Stage, failures: list[Exception]) -> Iterator[Make]:
    """Makes a playback on the stage, which shows the first frame, and closes it."""
    made: list[Playback] = []

    def make_it(scene: Scene) -> Playback:
        made.append(Playback(scene, stage, failures.append, threads=1))
        eventually(lambda: stage.moments)
        assert caught_up(made[0])
        return made[0]

    yield make_it
    for playback in made:
        playback.close()


def caught_up(playback: Playback) -> bool:
    return playback.wait_until_shown(staged.PATIENCE)


def test_the_first_frame_is_shown_at_once(make: Make, stage: Stage) -> None:
    a, b = watched(), watched()
    playback = make(scene_of(a, b))
    moment = stage.moments[0]
    assert (moment.scene, moment.frame, len(moment.poses)) == (playback.scene, 0, 2)
    assert not playback.is_playing
    assert stage.frames == [0]


def test_it_plays(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched(4)))
    playback.play()
    assert playback.is_playing
    for _ in range(6):
        now.pass_by(0.1, playback)
    eventually(lambda: stage.frames == [0, 1, 2, 3, 0, 1, 2])
    assert [moment.poses[0][0, 0] for moment in stage.moments] == stage.frames


def test_frames_that_nobody_could_see_are_left_out(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.play()
    now.pass_by(0.5, playback)
    now.pass_by(0.3, playback)
    eventually(lambda: stage.frames == [0, 5, 8])


def test_a_frame_that_took_long_is_late_and_none_after_it(make: Make, stage: Stage, now: Standing) -> None:
    item = watched()
    item.held[1] = Event()
    playback = make(scene_of(item))
    playback.play()
    now.pass_by(0.1, playback)
    now.pass_by(0.3, playback)
    assert stage.frames == [0]
    item.held[1].set()
    eventually(lambda: stage.frames == [0, 1, 4])


def test_a_busy_stage_is_waited_for(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    stage.is_busy = True
    playback.seek(3)
    now.pass_by(0.9 * DRAW_TIMEOUT_SECONDS, playback)
    assert stage.frames == [0]
    stage.is_busy = False
    playback.wake()
    eventually(lambda: stage.frames == [0, 3])


def test_but_not_for_ever(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    stage.is_busy = True
    playback.seek(3)
    now.pass_by(0.9 * DRAW_TIMEOUT_SECONDS, playback)
    now.pass_by(0.2 * DRAW_TIMEOUT_SECONDS, playback)
    eventually(lambda: stage.frames == [0, 3])


def test_pause_stays_at_what_is_seen(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.play()
    now.pass_by(0.2, playback)
    eventually(lambda: stage.frames == [0, 2])
    now.pass_by(0.0, playback)
    stage.is_busy = True
    now.pass_by(0.2, playback)
    assert playback.frame == 4
    playback.pause()
    assert (playback.is_playing, playback.frame) == (False, 2)
    stage.is_busy = False
    now.pass_by(1.0, playback)
    assert stage.frames == [0, 2]


def test_pause_leaves_what_stands(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    stage.is_busy = True
    playback.seek(3)
    playback.pause()  # before the stage could show it
    assert playback.frame == 3


def test_it_goes_on_from_where_it_was(make: Make, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.seek(4)
    now.pass_by(5.0, playback)
    playback.play()
    now.pass_by(0.1, playback)
    assert playback.frame == 5


def test_it_begins_again_at_the_end(make: Make) -> None:
    playback = make(scene_of(watched()))
    playback.seek(9)
    assert playback.frame == 9
    playback.play()
    assert playback.frame == 0


def test_a_section_is_played_again(make: Make, now: Standing) -> None:
    playback = make(scene_of(watched()))
    assert (playback.section, playback.is_looping) == ((0, 9), True)
    playback.set_section(3, 5)
    playback.play()  # from its start, as frame 0 is not in it
    assert playback.frame == 3
    now.pass_by(0.25, playback)
    assert playback.frame == 5
    now.pass_by(0.1, playback)
    assert playback.frame == 3
    playback.set_scene(scene_of(watched(), rate=20))
    assert playback.section == (6, 10)
    playback.set_section(0, 19)
    playback.set_scene(scene_of(watched()))
    assert playback.section == (0, 9)


def test_without_a_loop_it_stops_at_the_end(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.set_section(7, 8)
    playback.set_loop(False)
    playback.play()
    now.pass_by(0.35, playback)
    eventually(lambda: not playback.is_playing)
    assert playback.frame == 8
    eventually(lambda: stage.frames[-1] == 8)
    playback.play()
    assert playback.frame == 7


def test_seek_while_it_plays(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.play()
    playback.seek(6)
    eventually(lambda: stage.frames == [0, 6])
    now.pass_by(0.1, playback)
    eventually(lambda: stage.frames == [0, 6, 7])


def test_at_another_speed(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.play()
    playback.set_speed(2.0)
    now.pass_by(0.1, playback)
    eventually(lambda: stage.frames == [0, 2])


def test_another_shot_at_the_same_time(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.seek(4)
    assert caught_up(playback)
    other = scene_of(watched(), rate=20)
    playback.set_scene(other)
    assert caught_up(playback)
    eventually(lambda: stage.moments[-1].scene is other)
    assert (playback.scene, playback.frame, stage.moments[-1].frame) == (other, 8, 8)


def test_a_shot_that_will_not_stay_is_not_decoded_ahead(make: Make, stage: Stage) -> None:
    playback, settled, passing = make(scene_of(watched())), watched(), watched()
    playback.set_scene(scene_of(passing), decode_ahead=False)
    assert caught_up(playback)
    playback.set_scene(scene_of(settled))
    eventually(lambda: len(settled.decoded) == 10)
    assert passing.decoded == [0]


def test_at_another_rate(make: Make, stage: Stage, now: Standing) -> None:
    playback = make(scene_of(watched()))
    playback.seek(5)
    playback.set_frame_rate(30.0)
    assert caught_up(playback)
    assert (playback.scene.fps, playback.scene.count, playback.frame) == (30, 30, 15)
    with pytest.raises(SettingsError):
        playback.set_frame_rate(0.1)  # which is no frame at all
    assert (playback.scene.fps, playback.frame) == (30, 15)


def test_the_same_again(make: Make, stage: Stage) -> None:
    playback = make(scene_of(watched()))
    playback.refresh()
    eventually(lambda: stage.frames == [0, 0])
    assert caught_up(playback)
    assert stage.frames == [0, 0]


def test_the_same_again_while_it_is_sent(make: Make, stage: Stage) -> None:
    playback = make(scene_of(watched()))
    sending, go_on = Event(), Event()

    def slowly(moment: Moment) -> None:
        sending.set()
        assert go_on.wait(staged.PATIENCE)

    stage.on_show = slowly
    playback.seek(2)
    assert sending.wait(staged.PATIENCE)
    playback.refresh()  # in other colours than those that are being sent
    go_on.set()
    eventually(lambda: stage.frames == [0, 2, 2])


def test_not_caught_up_in_time(make: Make) -> None:
    item = watched()
    item.held[0] = Event()
    playback = make(scene_of(watched()))
    playback.set_scene(scene_of(item))
    assert not playback.wait_until_shown(0.01)
    item.held[0].set()
    assert caught_up(playback)


def test_a_frame_that_cannot_be_decoded(make: Make, stage: Stage, failures: list[Exception]) -> None:
    item = watched()
    item.broken.add(3)
    playback = make(scene_of(item))
    playback.seek(3)
    eventually(lambda: failures)
    assert str(failures[0]) == "frame 3 is broken"
    playback.seek(4)
    eventually(lambda: stage.frames == [0, 4])
    assert len(failures) == 1


def test_it_stops_at_a_frame_that_cannot_be_decoded(
    make: Make, stage: Stage, failures: list[Exception], now: Standing
) -> None:
    item = watched()
    item.broken.add(2)
    playback = make(scene_of(item))
    playback.play()
    now.pass_by(0.1, playback)
    now.pass_by(0.1, playback)
    eventually(lambda: failures)
    assert not playback.is_playing
    now.pass_by(5.0, playback)
    assert (stage.frames, len(failures), playback.frame) == ([0, 1], 1, 2)


@pytest.mark.parametrize("error", [ReconstructionError("no colours"), ZeroDivisionError("no colours")])
def test_a_stage_that_fails(make: Make, stage: Stage, failures: list[Exception], error: Exception) -> None:
    playback = make(scene_of(watched()))

    def fail(moment: Moment) -> None:
        stage.on_show = lambda moment: None
        raise error

    stage.on_show = fail
    playback.seek(2)
    eventually(lambda: failures)
    assert str(failures[0]) == "no colours"
    playback.seek(3)
    eventually(lambda: stage.frames == [0, 2, 3])


def test_no_thread_is_left(stage: Stage) -> None:
    before = set(all_threads())
    with Playback(scene_of(watched()), stage, lambda error: None, threads=2) as playback:
        playback.play()
        eventually(lambda: stage.moments)
    assert not set(all_threads()) - before
    assert playback.wait_until_shown(staged.PATIENCE)  # nobody waits for what never comes


def test_nobody_waits_longer_for_a_playback_that_ends(stage: Stage) -> None:
    item = watched()
    item.held[0] = Event()
    playback = Playback(scene_of(item), stage, lambda error: None)
    eventually(lambda: item.decoded)
    waiting = Thread(target=playback.wait_until_shown, args=(staged.PATIENCE,))
    waiting.start()
    begin = monotonic()
    closing = Thread(target=playback.close)
    closing.start()
    waiting.join()
    assert monotonic() - begin < staged.PATIENCE / 2
    item.held[0].set()
    closing.join()


def test_in_real_time(make: Make, stage: Stage) -> None:
    playback = make(scene_of(watched(5)))
    playback.set_speed(10.0)
    playback.play()
    eventually(lambda: len(stage.moments) > 12)  # more than two rounds of 0.05 s
    playback.pause()
    eventually(lambda: stage.frames[-1] == playback.frame)
    assert len(set(stage.frames)) > 1
