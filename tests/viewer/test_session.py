"""Edits, previews and files, one after the other on a thread of their own."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Event
from threading import enumerate as all_threads
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import asdict

from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.encoder.compress import compress
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.operations import key_poses, repeat, reverse, with_body
from mixseq.pictures.charts import HANDLE_COUNT, MAX_CHART_FRAMES, MAX_CHART_POINTS, chart_data
from mixseq.pictures.scene import Scene, SceneItem
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.fitting import fit
from mixseq.signals.model import Model
from mixseq.viewer import session as module
from mixseq.viewer.playback import Playback
from mixseq.viewer.session import (
    MAX_CONCURRENT_SAVES,
    MAX_MESSAGE_NUMBER,
    MAX_MESSAGE_POINTS,
    Drag,
    Drawn,
    Mark,
    Message,
    Play,
    Retime,
    Seek,
    Session,
    Sketch,
    UndoHistory,
    parse_message,
)
from tests.viewer.staged import PATIENCE, Stage, eventually, watched


class Told:
    """Remembers what it is told."""

    def __init__(self) -> None:
        self.seen: list[Model] = []
        self.failures: list[tuple[str, str]] = []
        self.files: list[str] = []

    def on_edit(self, session: Session) -> None:
        """Remember the model."""
        self.seen.append(session.model)

    def on_select(self, session: Session) -> None:
        """Remember the history, as an edit does."""
        self.on_edit(session)

    def on_failure(self, action: str, error: Exception) -> None:
        """Remember the error."""
        self.failures.append((action, str(error)))

    def on_save(self, message: str) -> None:
        """Remember the file."""
        self.files.append(message)


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

    def _save(self, path: Path, model: Any, replace: bool) -> str:
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
        self.started, self.go_on = Event(), Event()

    def __call__(self, model: Model) -> Model:
        self.started.set()
        assert self.go_on.wait(PATIENCE)
        return replace(model)


def test_what_was_opened(room: Room, bar_model: Model) -> None:
    session = room.session
    assert (session.editable_ids, session.index, session.model) == ([1], 1, bar_model)
    assert list(session.unsaved) == []


def test_without_a_model() -> None:
    room = Room()
    assert (room.session.editable_ids, room.session.index, list(room.session.unsaved)) == ([], -1, [])
    room.close()


def test_an_edit_is_seen(room: Room, bar_model: Model) -> None:
    room.session.edit("repeat", lambda model: repeat(model, model.start, model.end))
    room.done(1)
    model = room.session.model
    assert model.end > bar_model.end
    assert room.shown() is model
    assert (room.session.history.current.name, room.told.seen) == ("repeat", [model])
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
    assert [model for _, model in order] == [bar_model, *room.told.seen[:-1]]  # each of what the one before made


def test_of_previews_only_the_newest_is_made(room: Room, bar_model: Model) -> None:
    session, held, tried = room.session, Held(), list[int]()

    def preview(number: int) -> Callable[[Model], Model]:
        return lambda model: tried.append(number) or replace(model)  # type: ignore[func-returns-value]

    session.edit("drag", held, preview=True)
    assert held.started.wait(PATIENCE)
    for number in range(5):
        session.edit("drag", preview(number), preview=True)
    held.go_on.set()
    eventually(lambda: tried)
    assert tried == [4]
    eventually(lambda: room.shown() is not bar_model)
    assert session.model is bar_model  # nothing was done yet
    assert (room.told.seen, session.history.index) == ([], 0)


def test_no_preview_after_the_edit(room: Room, bar_model: Model) -> None:
    session, held, seen = room.session, Held(), list[Model]()
    session.edit("drag", held, preview=True)
    assert held.started.wait(PATIENCE)
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
    assert held.started.wait(PATIENCE)
    session.edit("second", same)
    session.edit("drag", fail, preview=True)
    session.edit("third", same)
    held.go_on.set()
    room.done(3)
    assert [step.name for step in session.history.states] == ["", "first", "second", "third"]


def test_the_next_preview_waits_until_the_last_was_seen(
    room: Room, bar_model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PREVIEW_TIMEOUT_SECONDS", PATIENCE)
    sending, go_on, second = Event(), Event(), Held()
    assert room.playback.wait_until_shown(PATIENCE)

    def slowly(moment: object) -> None:
        sending.set()
        assert go_on.wait(PATIENCE)

    room.stage.on_show = slowly
    room.session.edit("drag", same, preview=True)
    assert sending.wait(PATIENCE)
    room.session.edit("drag", second, preview=True)
    assert not second.started.wait(0.02)
    go_on.set()
    assert second.started.wait(PATIENCE)
    second.go_on.set()


def test_undo_and_redo(room: Room, bar_model: Model) -> None:
    session = room.session
    session.edit("loop", same)
    room.done(1)
    edited = session.model
    session.undo()
    room.done(2)
    assert (session.model, room.shown(), session.history.redo().current.name) == (bar_model, bar_model, "loop")
    session.redo()
    room.done(3)
    assert (session.model, room.shown(), session.history.current.name) == (edited, edited, "loop")
    session.redo()  # there is nothing more
    room.done(4)
    assert session.model is edited


def test_undo_takes_back_what_was_asked_for_before(room: Room, bar_model: Model) -> None:
    session, held = room.session, Held()
    session.edit("slow", held)
    assert held.started.wait(PATIENCE)
    session.undo()
    held.go_on.set()
    room.done(2)
    assert session.model is bar_model
    assert session.history.redo().current.name == "slow"


def test_a_failed_edit_changes_nothing(room: Room, bar_model: Model) -> None:
    room.session.edit("drag", same, preview=True)
    eventually(lambda: room.shown() is not bar_model)
    room.session.edit("drag", fail)
    eventually(lambda: room.told.failures)
    assert room.told.failures == [("drag", "it cannot be")]
    assert (room.session.model, room.shown(), room.session.history.index) == (bar_model, bar_model, 0)


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
    room.playback.set_frame_rate(240.0)
    long = bar_model
    while (long.end - long.start) * 240 < 1e5:
        long = repeat(long, long.start, long.end, times=100)
    room.session.edit("repeat", lambda model: long, preview=True)  # of which nothing is told
    room.session.edit("repeat", lambda model: long)
    eventually(lambda: room.told.failures)
    assert [name for name, _ in room.told.failures] == ["repeat"]
    assert "a film has 2 to 100,000" in room.told.failures[0][1]
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
    room.session.discard_preview()
    eventually(lambda: room.shown() is bar_model)
    assert not room.session.history.index


def test_keys_of_a_retiming_can_be_moved_on(room: Room, bar_model: Model) -> None:
    session, end = room.session, bar_model.end
    session.retime([(0.0, 0.0), (2.0 * end, end)])
    session.retime([(0.0, 0.0), (3.0 * end, end)])
    eventually(lambda: session.model.end == pytest.approx(3.0 * end))
    assert session.history.current.keys == ((0.0, 0.0), (3.0 * end, end))
    assert (session.history.index, session.history.undo().current.model) == (1, bar_model)
    session.edit("loop", same)
    session.retime([(0.0, 0.0), (end, 3.0 * end)])  # of what came after an edit
    eventually(lambda: session.history.index == 3)
    assert session.model.end == pytest.approx(end)
    session.undo()
    session.undo()
    eventually(lambda: session.history.index == 1)
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
    for _ in range(MAX_CONCURRENT_SAVES + 2):
        room.session.save(tmp_path / "slow.h5")
    assert [what for what, _ in room.told.failures] == ["save", "save"]
    assert "try again when one is done" in room.told.failures[0][1]
    room.go_on.set()
    eventually(lambda: len(room.told.files) == MAX_CONCURRENT_SAVES)
    room.session.save(tmp_path / "slow.h5")
    eventually(lambda: len(room.told.files) == MAX_CONCURRENT_SAVES + 1)


def test_nothing_is_written_once_it_is_closed(room: Room, tmp_path: Path) -> None:
    room.session.close()
    room.session.save(tmp_path / "late.h5")
    assert not room.session._save_threads
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
    assert session.editable_ids == [1, 2]
    session.select(2)
    assert (session.index, session.model, room.told.seen) == (2, other, [other])
    session.edit("loop", same)
    room.done(2)
    assert (room.shown(1), room.shown(2)) == (bar_model, session.model)
    session.select(0)  # which is no model
    session.select(7)
    assert session.index == 2
    session.select(1)
    assert (session.model, session.history.index, list(session.unsaved)) == (bar_model, 0, ["1.h5"])
    room.close()


def test_an_edit_is_of_the_model_that_was_chosen_then(bar_model: Model) -> None:
    other, held = replace(bar_model), Held()
    room = Room(bar_model, other)
    room.session.edit("first", held)
    assert held.started.wait(PATIENCE)
    room.session.edit("second", same)
    room.session.select(2)
    held.go_on.set()
    room.done(3)
    assert room.session.model is other
    room.session.select(1)
    assert [step.name for step in room.session.history.states] == ["", "first", "second"]
    room.close()


def test_no_thread_is_left(bar_model: Model) -> None:
    before = set(all_threads())
    room = Room(bar_model)
    room.session.edit("loop", same)
    with room.session, room.playback:
        pass
    assert not set(all_threads()) - before


# What was done, undone, and done again


@given(st.lists(st.sampled_from(["push", "replace", "undo", "redo"]), max_size=30))
def test_a_history_is_two_stacks(actions: list[str]) -> None:
    history, undo, redo = UndoHistory((0,)), [0], list[int]()
    for number, action in enumerate(actions, 1):
        before = history
        if action == "push":
            undo.append(number)
            redo.clear()
            history = history.push(number)
        elif action == "replace":
            undo[-1] = number
            history = history.replace(number)
        elif action == "undo":
            if len(undo) > 1:
                redo.append(undo.pop())
            history = history.undo()
        else:
            if redo:
                undo.append(redo.pop())
            history = history.redo()
        assert history.current == undo[-1]
        assert history.states == (*undo, *redo[::-1])
        assert history.index == len(undo) - 1
        assert before.states[before.index] == before.current  # unchanged


# What charts draw of a model


@pytest.fixture(scope="module")
def line() -> MeshSequence:
    """A triangle whose tip moves by 0, 2, 4, 6 fifths of its diagonal, at 2 frames per second from 1 s on."""
    points = np.repeat([[[0, 0, 0], [3, 0, 0], [0, 4, 0.0]]], 4, axis=0)
    points[:, 2, 2] = [0, 2, 4, 6]
    return MeshSequence.from_arrays(points, [[0, 1, 2]], times=np.array([1, 1.5, 2, 2.5]), fps=2)


@pytest.fixture(scope="module")
def still(line: MeshSequence) -> Model:
    return fit(line.with_points(np.repeat(line.points[:1], 4, axis=0)), exact=True, space="vertex")


def test_a_line(line: MeshSequence) -> None:
    signals = chart_data(fit(line, exact=True, space="vertex"))
    assert json.loads(json.dumps(signals)) == signals
    assert (signals["start"], signals["end"]) == (1.0, 2.5)
    path, times = np.array(signals["path"]), np.array(signals["times"])
    assert times[0] == 1.0 and times[-1] == 2.5 and len(times) == len(path)
    speed = 6 / 1.5 / line.diagonal
    np.testing.assert_allclose(np.abs(path[:, 0] - path[0, 0]), speed * (times - 1), atol=1e-4)
    np.testing.assert_allclose(path[:, 1], 0, atol=1e-12)
    assert signals["frameTimes"] == [1, 1.5, 2, 2.5]
    np.testing.assert_allclose(np.array(signals["frames"])[:, 0], np.linspace(path[0, 0], path[-1, 0], 4), atol=1e-4)


def test_handles_are_on_the_path(line: MeshSequence) -> None:
    model = fit(line, exact=True, space="vertex")
    handles = chart_data(model)["handles"]
    times = [handle["time"] for handle in handles]
    np.testing.assert_allclose(times, np.linspace(1, 2.5, HANDLE_COUNT))
    np.testing.assert_allclose([handle["at"] for handle in handles], model.embedding(times), atol=1e-5)


def test_coefficients_are_in_diagonals(line: MeshSequence) -> None:
    (only,) = chart_data(fit(line, exact=True, space="vertex"))["coefficients"]
    assert only["name"] == "coordinate 1"
    assert abs(only["values"][-1] - only["values"][0]) == pytest.approx(6 / line.diagonal, rel=1e-4)


def test_the_largest_coefficients(bar_model: Model) -> None:
    coefficients = chart_data(bar_model)["coefficients"]
    numbers = [int(each["name"].removeprefix("coordinate ")) for each in coefficients]
    assert numbers == sorted(numbers) and 1 in numbers and len(numbers) <= 5


def test_keys_leave_all_as_it_is(bar_model: Model) -> None:
    keys = chart_data(bar_model)["keys"]
    assert len(keys) == 5 and all(output == source for output, source in keys)
    assert keys[0][0] == bar_model.start and keys[-1][0] == bar_model.end


def test_a_model_that_does_not_move(still: Model) -> None:
    signals = chart_data(still)
    assert signals["coefficients"] == signals["handles"] == []
    assert not np.any(signals["path"]) and len(signals["keys"]) == 5


def test_a_single_frame(line: MeshSequence) -> None:
    single = MeshSequence.from_arrays(line.points[:1], line.faces, times=line.times[:1], fps=2)
    signals = chart_data(fit(single, exact=True, space="vertex"))
    assert signals["start"] == signals["end"] == 1.0 and signals["times"] == signals["frameTimes"] == [1.0]
    assert signals["path"] == signals["frames"] == [[0, 0]]
    assert signals["handles"] == signals["keys"] == []


def test_long_models_are_thinned(line: MeshSequence) -> None:
    count = 1001
    points = np.repeat(line.points[:1], count, axis=0).astype(np.float64)
    points[:, 2, 2] = np.sin(np.arange(count) / 40)
    long = MeshSequence.from_arrays(points, line.faces, fps=25)
    signals = chart_data(fit(long, knots=20, rank=1, space="vertex"))
    assert len(signals["times"]) == len(signals["path"]) <= MAX_CHART_POINTS
    assert len(signals["frames"]) == MAX_CHART_FRAMES and signals["frameTimes"][-1] == 40.0
    assert len(json.dumps(signals)) < 60_000


def test_numbers_are_no_longer_than_a_screen_needs(bar_model: Model) -> None:
    signals = chart_data(replace(bar_model))
    assert max(len(str(abs(value))) for point in signals["path"] for value in point) <= 8


# What pages say is believed where it makes sense, and harmless where it does not

numbers = st.floats(-MAX_MESSAGE_NUMBER, MAX_MESSAGE_NUMBER) | st.integers(
    -int(MAX_MESSAGE_NUMBER), int(MAX_MESSAGE_NUMBER)
)
pairs = st.tuples(numbers, numbers).map(list)
scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)
names = ("time", "to", "done", "points", "keys", "frame", "from")
nearly = st.fixed_dictionaries(
    {"kind": st.sampled_from(["drawn", "seek", "play", "mark", "drag", "sketch", "retime"]) | scalars},
    optional={name: values | pairs | st.lists(pairs, max_size=3) for name in names},
)
"""Objects that may, or may not, be messages."""


def arrays(message: Message) -> list[Any]:
    """Every number of a message; what it leaves out is None."""
    return [np.asarray(value) for value in asdict(message).values() if value is not None]


@given(numbers)
def test_seek(time: float) -> None:
    said = parse_message(json.dumps({"kind": "seek", "time": time}))
    assert isinstance(said, Seek)
    assert said.time == time


@pytest.mark.parametrize("time", [1.001 * MAX_MESSAGE_NUMBER, -1e308, 10**400])
def test_nothing_is_so_far_away(time: float) -> None:
    assert parse_message(json.dumps({"kind": "seek", "time": time})) is None


@given(numbers, pairs, st.booleans())
def test_drag(time: float, to: list[float], done: bool) -> None:
    said = parse_message(json.dumps({"kind": "drag", "time": time, "to": to, "done": done}))
    assert isinstance(said, Drag)
    assert (said.time, list(said.to), said.done) == (time, to, done)


@given(st.lists(pairs, min_size=1))
def test_sketch(points: list[list[float]]) -> None:
    said = parse_message(json.dumps({"kind": "sketch", "points": points}))
    assert isinstance(said, Sketch)
    assert list(map(list, said.points)) == points


@given(st.lists(pairs, min_size=1), st.booleans())
def test_retime(keys: list[list[float]], done: bool) -> None:
    said = parse_message(json.dumps({"kind": "retime", "keys": keys, "done": done}))
    assert isinstance(said, Retime)
    assert (list(map(list, said.keys)), said.done) == (keys, done)


def test_drawn_and_what_else_the_page_adds() -> None:
    assert parse_message('{"kind": "drawn", "frame": 3}') == Drawn()
    assert parse_message('{"kind": "seek", "time": 2, "from": "ab12", "number": 7}') == Seek(2.0)
    assert parse_message('{"kind": "play", "on": true, "loop": false}') == Play(on=True, loop=False)
    assert parse_message('{"kind": "play"}') == Play()
    assert parse_message('{"kind": "mark", "start": 1, "end": 2}') == Mark(1.0, 2.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "drawn",
        "null",
        "[]",
        "7",
        '"drawn"',
        "{}",
        '{"kind": "explode"}',
        '{"kind": ["drawn"]}',
        '{"kind": "seek"}',
        '{"kind": "seek", "time": null}',
        '{"kind": "seek", "time": true}',
        '{"kind": "seek", "time": "1"}',
        '{"kind": "seek", "time": NaN}',
        '{"kind": "seek", "time": -Infinity}',
        '{"kind": "seek", "time": 1e999}',
        f'{{"kind": "seek", "time": {10**400}}}',
        f'{{"kind": "seek", "time": {"1" * 10_000}}}',
        '{"kind": "drag", "time": 1, "to": [1, 2]}',
        '{"kind": "drag", "time": 1, "to": [1, 2], "done": 1}',
        '{"kind": "drag", "time": 1, "to": [1, 2, 3], "done": true}',
        '{"kind": "drag", "time": 1, "to": [[1, 2]], "done": true}',
        '{"kind": "drag", "time": 1, "to": [1, NaN], "done": true}',
        '{"kind": "drag", "time": NaN, "to": [1, 2], "done": true}',
        '{"kind": "drag", "time": 1, "to": {"0": 1, "1": 2}, "done": true}',
        '{"kind": "sketch", "points": []}',
        '{"kind": "sketch", "points": [1, 2]}',
        '{"kind": "sketch", "points": [[1, 2], [3]]}',
        '{"kind": "sketch", "points": [[1, 2], [3, false]]}',
        '{"kind": "sketch", "points": "12"}',
        '{"kind": "retime", "keys": [[1, 2]], "done": null}',
        '{"kind": "retime", "keys": [[1, Infinity]], "done": true}',
        "[" * 100_000,
        '{"kind": ' * 50_000,
    ],
    ids=lambda text: text[:40],
)
def test_nonsense(text: str) -> None:
    assert parse_message(text) is None


@pytest.mark.parametrize("value", [None, 7, ["drawn"], b"\xff"])
def test_no_text_at_all(value: Any) -> None:
    assert parse_message(value) is None


@pytest.mark.parametrize(("kind", "name"), [("sketch", "points"), ("retime", "keys")])
def test_limits(kind: str, name: str) -> None:
    said = {"kind": kind, "done": True}
    assert parse_message(json.dumps({**said, name: MAX_MESSAGE_POINTS * [[1, 2]]})) is not None
    assert parse_message(json.dumps({**said, name: (MAX_MESSAGE_POINTS + 1) * [[1, 2]]})) is None


@given(st.text() | values.map(json.dumps) | nearly.map(json.dumps))
def test_whatever_is_said(text: str) -> None:
    said = parse_message(text)
    assert said is None or isinstance(said, Message)
    for numbers in arrays(said) if said is not None else []:
        assert numbers.dtype.kind in "fb"
        assert np.isfinite(numbers).all()


@pytest.mark.filterwarnings("ignore:.*own key poses give the motion back within")
@pytest.mark.parametrize("is_compressed", [False, True])
def test_an_edit_of_one_body_is_shown_on_all(bar_model: Model, is_compressed: bool) -> None:
    """They share the history; each is edited as it is, and the file that is saved has the edited one in front."""
    keys = key_poses(bar_model)
    herd = with_body(bar_model, keys.with_points(2 * keys.points), "large")
    if is_compressed:
        herd = CompressedModel.from_sequence(compress(herd, max_error=1e-3))
    items = SceneItem("herd.h5", herd).of_bodies()
    assert [item.name for item in items] == [f"herd.h5: {herd.header.name}", "herd.h5: large"]
    room = Room(*(item.motion for item in items if isinstance(item.motion, Model)))
    session, start = room.session, bar_model.start
    assert session.editable_ids == [1, 2]
    session.select(2)
    assert session.model.header.name == "large"
    session.edit("repeat", lambda model: repeat(model, model.start, model.end))
    room.done(2)
    shown = [room.shown(1), room.shown(2)]
    assert [each.header.name for each in shown if isinstance(each, Model)] == [herd.header.name, "large"]
    assert room.shown(2) is session.model
    assert all(isinstance(each, Model) and each.end > herd.end and each.start == start for each in shown)
    assert list(session.unsaved) == ["0.h5"]
    session.save(Path("herd.h5"))
    eventually(lambda: room.told.files == ["herd.h5"])
    assert room.written[0][1].body_names == ("large", herd.header.name)
    assert not session.unsaved
    session.select(1)
    session.edit("reverse", reverse)
    room.done(4)
    session.save(Path("edits.toml"))
    eventually(lambda: ["one body" in text for _, text in room.told.failures] == [True])
    session.undo()
    session.undo()
    room.done(6)
    assert session.history.index == 0
    assert room.shown(1) is session.model
    session.select(2)
    session.edit("reverse", reverse)
    room.done(8)
    session.save(Path("edits.toml"))
    eventually(lambda: len(room.written) == 2)
    assert str(room.written[1][1]) == '# mixseq edit --body "large"\n\n[[edit]]\noperation = "reverse"\n'
    room.close()
