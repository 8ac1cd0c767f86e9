"""Edits, previews and files, one after the other on a thread of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event
from threading import enumerate as all_threads

import numpy as np
import pytest

from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.operations import repeat
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.signals.model import Model
from mixseq.viewer import session as module
from mixseq.viewer.playback import Playback
from mixseq.viewer.session import MOST_WRITTEN, Session
from tests.viewer.staged import PATIENCE, Stage, eventually, watched


class Told:
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.seen: list[Model] = []
        self.failures: list[tuple[str, str]] = []
        self.files: list[str] = []

    def edited(self, session: Session) -> None:
        """Remember the model."""
        self.seen.append(session.model)

    def chosen(self, session: Session) -> None:
        """Remember the history, as an edit does."""
        self.edited(session)

    def failed(self, what: str, error: Exception) -> None:
        """Remember the error."""
        self.failures.append((what, str(error)))

    def saved(self, what: str) -> None:
        """Remember the file."""
        self.files.append(what)


class Room:
    """A session with everything around it."""

    def __init__(self, *motions: Model) -> None:
        self.stage, self.told = Stage(), Told()
        self.written: list[tuple[Path, Model]] = []
        self.go_on = Event()
        items = [SceneItem(f"{k}.h5", motion) for k, motion in enumerate(motions)]
        self.playback = Playback(Scene((watched(3), *items)), self.stage, self._failed, threads=1)
        self.session = Session(self.playback, self.told, self._save)

    def close(self) -> None:
        self.session.close()
        self.playback.close()

    def _failed(self, error: Exception) -> None:
        self.told.failures.append(("show", str(error)))

    def _save(self, path: Path, model: Model, replace: bool) -> str:
        if path.name == "bad.h5":
            raise OutputError("no room")
        if path.name == "worse.h5":
            raise ZeroDivisionError("a bug")
        if path.name == "slow.h5":
            assert self.go_on.wait(PATIENCE)
        self.written.append((path, model))
        return path.name

    def shown(self, index: int = 1) -> object:
        """The motion of a mesh that is shown."""
        return self.playback.scene.items[index].motion

    def done(self, count: int) -> None:
        """Wait until so many models were seen."""
        eventually(lambda: len(self.told.seen) >= count)
        assert len(self.told.seen) == count


@pytest.fixture
def room(bar_model: Model) -> Iterator[Room]:
    made = Room(bar_model)
    yield made
    made.close()


def same(model: Model) -> Model:
    """An edit that makes another model of it, that is the same."""
    return replace(model)


def fail(model: Model) -> Model:
    raise SettingsError("it cannot be")


class Held:
    """An edit that waits."""

    def __init__(self) -> None:
        self.begun, self.go_on = Event(), Event()

    def __call__(self, model: Model) -> Model:
        self.begun.set()
        assert self.go_on.wait(PATIENCE)
        return replace(model)


def test_what_was_opened(room: Room, bar_model: Model) -> None:
    session = room.session
    assert (session.editable, session.index, session.model) == ([1], 1, bar_model)
    assert list(session.unsaved) == []


def test_without_a_model() -> None:
    room = Room()
    assert (room.session.editable, room.session.index, list(room.session.unsaved)) == ([], -1, [])
    room.close()


def test_an_edit_is_seen(room: Room, bar_model: Model) -> None:
    room.session.edit("repeat", lambda model: repeat(model, model.start, model.end))
    room.done(1)
    model = room.session.model
    assert model.end > bar_model.end
    assert room.shown() is model
    assert (room.session.history.undoes, room.told.seen) == ("repeat", [model])
    eventually(lambda: room.stage.moments and room.stage.moments[-1].scene is room.playback.scene)


def test_edits_are_done_in_order(room: Room, bar_model: Model) -> None:
    order: list[tuple[int, Model]] = []

    def edit(number: int) -> Callable[[Model], Model]:
        def edit_it(model: Model) -> Model:
            order.append((number, model))
            return replace(model)

        return edit_it

    for number in range(20):
        room.session.edit(str(number), edit(number))
    room.done(20)
    assert [number for number, _ in order] == list(range(20))
    assert [model for _, model in order] == [
        bar_model,
        *room.told.seen[:-1],
    ]  # each of what the one before made


def test_of_previews_only_the_newest_is_made(room: Room, bar_model: Model) -> None:
    session, held, tried = room.session, Held(), list[int]()

    def preview(number: int) -> Callable[[Model], Model]:
        return lambda model: tried.append(number) or replace(model)  # type: ignore[func-returns-value]

    session.edit("drag", held, preview=True)
    assert held.begun.wait(PATIENCE)
    for number in range(5):
        session.edit("drag", preview(number), preview=True)
    held.go_on.set()
    eventually(lambda: tried)
    assert tried == [4]
    eventually(lambda: room.shown() is not bar_model)
    assert session.model is bar_model  # nothing was done yet
    assert (room.told.seen, session.history.changed) == ([], False)


def test_no_preview_after_the_edit(room: Room, bar_model: Model) -> None:
    session, held, seen = room.session, Held(), list[Model]()
    session.edit("drag", held, preview=True)
    assert held.begun.wait(PATIENCE)
    session.edit("drag", fail, preview=True)
    session.edit("drag", lambda model: seen.append(model) or replace(model))  # type: ignore[func-returns-value]
    held.go_on.set()
    room.done(1)
    assert seen == [bar_model]  # edits are of the model, and not of a preview
    assert room.told.failures == []
    assert room.shown() is session.model


def test_edits_before_previews_are_kept(room: Room) -> None:
    session, held = room.session, Held()
    session.edit("first", held)
    assert held.begun.wait(PATIENCE)
    session.edit("second", same)
    session.edit("drag", fail, preview=True)
    session.edit("third", same)
    held.go_on.set()
    room.done(3)
    assert [step.name for step in session.history.steps] == ["", "first", "second", "third"]


def test_the_next_preview_waits_until_the_last_was_seen(
    room: Room, bar_model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PATIENCE", PATIENCE)
    sending, go_on, second = Event(), Event(), Held()
    assert room.playback.caught_up(PATIENCE)

    def slowly(moment: object) -> None:
        sending.set()
        assert go_on.wait(PATIENCE)

    room.stage.on_show = slowly
    room.session.edit("drag", same, preview=True)
    assert sending.wait(PATIENCE)
    room.session.edit("drag", second, preview=True)
    assert not second.begun.wait(0.02)
    go_on.set()
    assert second.begun.wait(PATIENCE)
    second.go_on.set()


def test_undo_and_redo(room: Room, bar_model: Model) -> None:
    session = room.session
    session.edit("loop", same)
    room.done(1)
    edited = session.model
    session.undo()
    room.done(2)
    assert (session.model, room.shown(), session.history.redoes) == (bar_model, bar_model, "loop")
    session.redo()
    room.done(3)
    assert (session.model, room.shown(), session.history.undoes) == (edited, edited, "loop")
    session.redo()  # there is nothing more
    room.done(4)
    assert session.model is edited


def test_undo_takes_back_what_was_asked_for_before(room: Room, bar_model: Model) -> None:
    session, held = room.session, Held()
    session.edit("slow", held)
    assert held.begun.wait(PATIENCE)
    session.undo()
    held.go_on.set()
    room.done(2)
    assert session.model is bar_model
    assert session.history.redoes == "slow"


def test_a_failed_edit_changes_nothing(room: Room, bar_model: Model) -> None:
    room.session.edit("drag", same, preview=True)
    eventually(lambda: room.shown() is not bar_model)
    room.session.edit("drag", fail)
    eventually(lambda: room.told.failures)
    assert room.told.failures == [("drag", "it cannot be")]
    assert (room.session.model, room.shown(), room.session.history.changed) == (bar_model, bar_model, False)


def test_a_warning_made_an_error_is_no_bug(room: Room, capfd: pytest.CaptureFixture[str]) -> None:
    def warn(model: Model) -> Model:
        raise MixseqWarning("beware")

    room.session.edit("loop", warn)
    eventually(lambda: room.told.failures == [("loop", "beware")])
    assert "Traceback" not in capfd.readouterr().err


def test_a_bug_does_not_end_the_session(room: Room, capfd: pytest.CaptureFixture[str]) -> None:
    def stumble(model: Model) -> Model:
        raise ZeroDivisionError("a bug")

    room.session.edit("stumble", stumble)
    eventually(lambda: room.told.failures == [("stumble", "a bug")])
    assert "ZeroDivisionError: a bug" in capfd.readouterr().err
    room.session.edit("loop", same)
    room.done(1)


def test_an_edit_that_makes_too_many_frames(room: Room, bar_model: Model) -> None:
    room.playback.rate(240.0)
    long = bar_model
    while (long.end - long.start) * 240 < 1e5:
        long = repeat(long, long.start, long.end, times=100)
    room.session.edit("repeat", lambda model: long, preview=True)  # of which nothing is told
    room.session.edit("repeat", lambda model: long)
    eventually(lambda: room.told.failures)
    assert [name for name, _ in room.told.failures] == ["repeat"]
    assert "a film has from 2 to 100,000" in room.told.failures[0][1]
    assert (room.session.model, room.shown()) == (bar_model, bar_model)
    room.session.edit("loop", same)
    room.done(1)


def test_a_failing_preview_is_not_told(room: Room, bar_model: Model) -> None:
    tried = Event()

    def failing(model: Model) -> Model:
        tried.set()
        raise SettingsError("no")

    room.session.edit("drag", failing, preview=True)
    eventually(tried.is_set)
    room.session.edit("loop", same)
    room.done(1)
    assert room.told.failures == []


def test_settling_shows_the_model_again(room: Room, bar_model: Model) -> None:
    other = same(bar_model)
    room.session.edit("drag", lambda model: other, preview=True)
    eventually(lambda: room.shown() is other)
    room.session.settle()
    eventually(lambda: room.shown() is bar_model)
    assert not room.session.history.changed


def test_keys_of_a_retiming_can_be_moved_on(room: Room, bar_model: Model) -> None:
    session, end = room.session, bar_model.end
    session.retime(np.array([[0.0, 0.0], [2.0 * end, end]]))
    session.retime(np.array([[0.0, 0.0], [3.0 * end, end]]))
    eventually(lambda: session.model.end == pytest.approx(3.0 * end))
    assert session.history.steps[session.history.now].keys == ((0.0, 0.0), (3.0 * end, end))
    assert (session.history.now, session.history.before_retiming.model) == (1, bar_model)
    session.edit("loop", same)
    session.retime(np.array([[0.0, 0.0], [end, 3.0 * end]]))  # of what came after an edit
    eventually(lambda: session.history.now == 3)
    assert session.model.end == pytest.approx(end)
    session.undo()
    session.undo()
    eventually(lambda: session.history.now == 1)
    assert session.model.end == pytest.approx(3.0 * end)


def test_save(room: Room, bar_model: Model, tmp_path: Path) -> None:
    session = room.session
    session.save(tmp_path / "opened.h5")
    eventually(lambda: room.told.files == ["opened.h5"])
    session.edit("loop", same)
    room.done(1)
    assert list(session.unsaved) == ["0.h5"]
    session.save(tmp_path / "edited.h5")
    eventually(lambda: len(room.told.files) == 2)
    assert room.written == [(tmp_path / "opened.h5", bar_model), (tmp_path / "edited.h5", session.model)]
    assert list(session.unsaved) == []


def test_many_files_at_a_time_are_refused(room: Room, tmp_path: Path) -> None:
    for _ in range(MOST_WRITTEN + 2):
        room.session.save(tmp_path / "slow.h5")
    assert [what for what, _ in room.told.failures] == ["save", "save"]
    assert "save again when one is done" in room.told.failures[0][1]
    room.go_on.set()
    eventually(lambda: len(room.told.files) == MOST_WRITTEN)
    room.session.save(tmp_path / "slow.h5")
    eventually(lambda: len(room.told.files) == MOST_WRITTEN + 1)


def test_nothing_is_written_once_it_is_closed(room: Room, tmp_path: Path) -> None:
    room.session.close()
    room.session.save(tmp_path / "late.h5")
    assert not room.session._writing
    assert not room.told.failures


def test_what_counts_as_saved(room: Room, tmp_path: Path) -> None:
    session = room.session
    session.edit("loop", same)
    room.done(1)
    session.save(tmp_path / "edited.h5")
    eventually(lambda: not session.unsaved)
    session.edit("loop", same)
    room.done(2)
    assert list(session.unsaved) == ["0.h5"]
    session.undo()
    room.done(3)
    assert list(session.unsaved) == []
    session.undo()
    room.done(4)
    assert list(session.unsaved) == []  # it is the model that was opened


@pytest.mark.parametrize(("name", "message"), [("bad.h5", "no room"), ("worse.h5", "a bug")])
def test_a_file_that_cannot_be_written(
    room: Room, tmp_path: Path, name: str, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    room.session.edit("loop", same)
    room.done(1)
    room.session.save(tmp_path / name)
    eventually(lambda: room.told.failures == [("save", message)])
    assert (room.told.files, list(room.session.unsaved)) == ([], ["0.h5"])
    assert ("Traceback" in capfd.readouterr().err) == (name == "worse.h5")


def test_another_model_is_chosen(bar_model: Model) -> None:
    other = replace(bar_model)
    room = Room(bar_model, other)
    session = room.session
    assert session.editable == [1, 2]
    session.choose(2)
    assert (session.index, session.model, room.told.seen) == (2, other, [other])
    session.edit("loop", same)
    room.done(2)
    assert (room.shown(1), room.shown(2)) == (bar_model, session.model)
    session.choose(0)  # which is no model
    session.choose(7)
    assert session.index == 2
    session.choose(1)
    assert (session.model, session.history.changed, list(session.unsaved)) == (bar_model, False, ["1.h5"])
    room.close()


def test_an_edit_is_of_the_model_that_was_chosen_then(bar_model: Model) -> None:
    other, held = replace(bar_model), Held()
    room = Room(bar_model, other)
    room.session.edit("first", held)
    assert held.begun.wait(PATIENCE)
    room.session.edit("second", same)
    room.session.choose(2)
    held.go_on.set()
    room.done(3)
    assert room.session.model is other
    room.session.choose(1)
    assert [step.name for step in room.session.history.steps] == ["", "first", "second"]
    room.close()


def test_no_thread_is_left(bar_model: Model) -> None:
    before = set(all_threads())
    room = Room(bar_model)
    room.session.edit("loop", same)
    with room.session, room.playback:
        pass
    assert not set(all_threads()) - before
