"""Edit the models of a scene: page messages, undo history, and the editing thread.

Edits run in order. Previews follow the mouse: only the newest preview runs, after the previous preview was shown.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Annotated, Generic, Protocol, TypeVar

from msgspec import DecodeError, Meta, Struct
from msgspec.json import Decoder

from mixseq.errors import OutputError, SettingsError
from mixseq.operations.retiming import retime
from mixseq.operations.script import format_script
from mixseq.pictures.scene import Scene
from mixseq.signals.model import Model
from mixseq.viewer.playback import JobQueue, Playback

MAX_MESSAGE_POINTS = 5000
"""Largest number of points of a sketch, and of keys of a retiming."""

MAX_MESSAGE_NUMBER = 1e6
"""Largest time in seconds, and largest coordinate in diagonals."""


Number = Annotated[float, Meta(ge=-MAX_MESSAGE_NUMBER, le=MAX_MESSAGE_NUMBER)]
Point = tuple[Number, Number]
Points = Annotated[list[Point], Meta(min_length=1, max_length=MAX_MESSAGE_POINTS)]


class PageMessage(Struct, tag_field="kind", tag=str.lower, frozen=True):
    """Message of the page; further fields are ignored."""


class Drawn(PageMessage, frozen=True):
    """Confirmation that the page has drawn a frame."""


class Seek(PageMessage, frozen=True):
    """Request to show the model at a time in seconds."""

    time: Number


class Play(PageMessage, frozen=True):
    """Request to play or pause, or to set whether the section starts again at its end."""

    on: bool | None = None
    loop: bool | None = None


class Mark(PageMessage, frozen=True):
    """Section that is played and edited: times of its first and last frame in seconds."""

    start: Number
    end: Number


class Drag(PageMessage, frozen=True):
    """Drag of the time curve's point at a given time to a point of the embedding."""

    time: Number
    to: Point
    done: bool


class Sketch(PageMessage, frozen=True):
    """Curve that the user drew in the embedding."""

    points: Points


class Retime(PageMessage, frozen=True):
    """Keys of a retiming: output and source times."""

    keys: Points
    done: bool


Transport = Seek | Play | Mark
Message = Drawn | Transport | Drag | Sketch | Retime
State = TypeVar("State")

Edit = Callable[[Model], Model]

_MESSAGE_DECODER: Decoder[Message] = Decoder(Message)


def parse_message(text: str) -> Message | None:
    """Parse a message of the page; return None if it is invalid."""
    try:
        return _MESSAGE_DECODER.decode(text)
    except (DecodeError, TypeError, RecursionError):
        return None


@dataclass(frozen=True, eq=False)
class Step:
    """State of a model after an edit."""

    name: str  # name of the edit, such as "repeat"; empty for the opened model
    model: Model  # model after the edit
    keys: tuple[Point, ...] = ()  # keys of a retiming: output and source times in seconds
    edit: Edit | None = None  # operation, or `functools.partial` object of an operation, that makes the model
    _fronts: dict[str, Model] = field(default_factory=dict)  # the model with each body in front that was shown

    def of_body(self, name: str) -> Model:
        """Return the model with a body in front, the same object every time."""
        return self._fronts.setdefault(name, self.model.body(name))


@dataclass(frozen=True, eq=False)
class UndoHistory(Generic[State]):
    """Immutable list of states, with the index of the current state."""

    states: tuple[State, ...]  # all states in order, starting with the initial state
    index: int = 0

    @property
    def current(self) -> State:
        """The current state."""
        return self.states[self.index]

    def push(self, state: State) -> UndoHistory[State]:
        """Return the history with a new current state after the old one; undone states are dropped."""
        return UndoHistory((*self.states[: self.index + 1], state), self.index + 1)

    def replace(self, state: State) -> UndoHistory[State]:
        """Return the history with the current state replaced."""
        return UndoHistory((*self.states[: self.index], state, *self.states[self.index + 1 :]), self.index)

    def undo(self) -> UndoHistory[State]:
        """Return the history with the previous state as current; unchanged at the first state."""
        return UndoHistory(self.states, max(self.index - 1, 0))

    def redo(self) -> UndoHistory[State]:
        """Return the history with the next state as current; unchanged at the last state."""
        return UndoHistory(self.states, min(self.index + 1, len(self.states) - 1))


EditHistory = UndoHistory[Step]
HistoryChange = Callable[[EditHistory], EditHistory]

Save = Callable[[Path, Model | str, bool], str]
"""Function that saves a model, or the text of a script, and returns a message; its last argument permits replacing a
file."""

PREVIEW_TIMEOUT_SECONDS = 1.0
"""Time in seconds after which the next preview runs even if the previous preview was not shown."""

MAX_CONCURRENT_SAVES = 8
"""Largest number of files that are written at the same time."""


class SessionListener(Protocol):
    """Callbacks of a session, called on background threads."""

    def on_edit(self, session: Session) -> None:
        """Handle a change of the edited model."""

    def on_select(self, session: Session) -> None:
        """Handle the selection of another model."""

    def on_failure(self, action: str, error: Exception) -> None:
        """Handle an error."""

    def on_save(self, message: str) -> None:
        """Handle the message of a saved file."""


@dataclass(frozen=True, eq=False)
class _Job:
    name: str
    index: int
    change: HistoryChange
    is_preview: bool


class Session(JobQueue[_Job]):
    """Editing session for the models of a scene."""

    def __init__(self, playback: Playback, listener: SessionListener, save: Save) -> None:
        self._playback = playback
        self._listener = listener
        self._save = save
        self._histories: dict[int, EditHistory] = {}  # by the first item of every model
        self._bodies: dict[int, tuple[int, str]] = {}  # the first item of an item's model, and the body that is shown
        self._saved: dict[int, Model] = {}
        first_items: dict[int, int] = {}
        for index, item in enumerate(playback.scene.items):
            if isinstance(item.motion, Model):
                model = item.motion
                first = first_items.setdefault(model.signals_id, index) if model.body_names[1:] else index
                self._bodies[index] = first, model.header.name
                self._histories.setdefault(first, UndoHistory((Step("", model),)))
        self._save_threads: list[Thread] = []
        self._index = min(self._bodies, default=-1)
        super().__init__(listener.on_failure)

    def close(self) -> None:
        """End the background threads after the current edit and all saves."""
        super().close()
        for thread in self._save_threads:
            thread.join()

    @property
    def editable_ids(self) -> list[int]:
        """Indices of the scene's items that are models."""
        return list(self._bodies)

    @property
    def index(self) -> int:
        """Index of the edited item, or -1 if the scene has no model."""
        return self._index

    @property
    def history(self) -> EditHistory:
        """Undo history of the edited model, whose bodies share it."""
        return self._histories[self._bodies[self._index][0]]

    @property
    def model(self) -> Model:
        """Current state of the edited model, with the edited body in front."""
        return self.history.current.of_body(self._bodies[self._index][1])

    @property
    def unsaved(self) -> dict[str, Model]:
        """Models with unsaved edits, by name."""
        return {
            self._playback.scene.items[index].name: history.current.model
            for index, history in self._histories.items()
            if history.index > 0 and self._saved.get(index) is not history.current.model
        }

    def select(self, index: int) -> None:
        """Select another item for editing."""
        if index in self._bodies:
            self._index = index
            self._listener.on_select(self)

    def edit(self, name: str, edit: Edit, preview: bool = False) -> None:
        """Edit the model on the background thread; a preview is shown but not stored, and dropped if a job follows."""
        body = self._bodies[self._index][1]

        def change(history: EditHistory) -> EditHistory:
            return history.push(Step(name, edit(history.current.of_body(body)), edit=edit))

        self._enqueue_change(name, change, preview)

    def retime(self, keys: Sequence[Point], preview: bool = False) -> None:
        """Retime the model by keys, output and source seconds; replace the last step if it retimes."""

        def change(history: EditHistory) -> EditHistory:
            before = history.undo() if history.current.keys else history
            edit = partial(retime, keys=keys)
            return before.push(Step("retime", edit(before.current.model), tuple(keys), edit))

        self._enqueue_change("retime", change, preview)

    def undo(self) -> None:
        """Undo the last step after the queued edits have run."""
        self._enqueue_change("undo", UndoHistory.undo)

    def redo(self) -> None:
        """Redo the last undone step."""
        self._enqueue_change("redo", UndoHistory.redo)

    def discard_preview(self) -> None:
        """Show the current model in place of a preview."""
        if self._histories:
            self._enqueue_change("discard preview", lambda history: history)

    def save(self, path: Path, replace: bool = False) -> None:
        """Save the model, or its edits as a script (.toml), on a new thread, unless the session is closed.

        `replace` permits overwriting a file.
        """
        thread = Thread(target=self._write, args=(path, self._bodies[self._index], self.history, replace), daemon=True)
        with self._changed:
            if self._closed:  # a process may hang if it ends while HDF5 writes
                return
            self._save_threads = [running for running in self._save_threads if running.is_alive()]
            has_capacity = len(self._save_threads) < MAX_CONCURRENT_SAVES
            if has_capacity:
                self._save_threads.append(thread)
                thread.start()
        if not has_capacity:
            text = f"{MAX_CONCURRENT_SAVES} files are still being saved; try again when one is done"
            self._report_failure("save", OutputError(text))

    def _write(self, path: Path, shown: tuple[int, str], history: EditHistory, replace: bool) -> None:
        (first, body), step = shown, history.current
        try:
            is_script = path.suffix.lower() == ".toml"
            edited = _script_of(history) if is_script else step.of_body(body)
            message = self._save(path, edited, replace)
        except Exception as error:
            self._report_failure("save", error)
        else:
            self._saved[first] = step.model
            self._listener.on_save(message)

    def _enqueue_change(self, name: str, change: HistoryChange, preview: bool = False) -> None:
        job = _Job(name, self._bodies[self._index][0], change, preview)
        self._enqueue(job, is_obsolete=lambda waiting: waiting.is_preview)

    def _run_job(self, job: _Job) -> None:
        try:
            history = job.change(self._histories[job.index])
            scene = self._scene_of(job.index, history.current).validated()
        except Exception as error:
            self._playback.set_scene(self._scene_of(job.index, self._histories[job.index].current))
            if not job.is_preview:  # the edit that follows the previews reports the error
                self._report_failure(job.name, error)
        else:
            self._show(job, history, scene)

    def _scene_of(self, first: int, step: Step) -> Scene:
        """Return the scene with all bodies of a model, which is edited from its `first` item on, as after a step."""
        scene = self._playback.scene
        for index, (other, body) in self._bodies.items():
            if other == first:
                scene = scene.with_item(index, step.of_body(body))
        return scene

    def _show(self, job: _Job, history: EditHistory, scene: Scene) -> None:
        if job.is_preview:
            self._playback.set_scene(scene, decode_ahead=False)
            self._playback.wait_until_shown(PREVIEW_TIMEOUT_SECONDS)
            return
        self._histories[job.index] = history
        self._playback.set_scene(scene)
        try:
            self._listener.on_edit(self)
        except Exception as error:
            self._report_failure("drawing charts", error)


def _script_of(history: EditHistory) -> str:
    """Return the text of a script with the edits up to the current step; it names a body that is not the model's own.

    Retimings do not depend on the body.
    """
    steps = [step for step in history.states[: history.index + 1] if step.edit is not None]
    names = {step.model.header.name: None for step in steps if not step.keys}
    own = history.states[0].model.header.name
    if len(names) > 1:
        raise SettingsError(f"a script edits one body, and these edits were made on {', '.join(names)}; save a model")
    edited = "".join(f"# mixseq edit --body {json.dumps(name)}\n\n" for name in names if name != own)
    return edited + format_script([step.edit for step in steps if step.edit is not None])
