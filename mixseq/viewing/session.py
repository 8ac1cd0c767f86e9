"""Session of editing the models of a scene: the edited model, its history, and the thread that runs edits.

Edits run in order. Of previews, which follow the mouse, only the newest runs, after the one before was shown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Protocol

from mixseq.arrays import Float
from mixseq.errors import OutputError
from mixseq.operations import retime
from mixseq.scene.items import Scene
from mixseq.signals import Model
from mixseq.viewing.background import Jobs
from mixseq.viewing.history import History
from mixseq.viewing.playback import Playback

Edit = Callable[[Model], Model]


class Save(Protocol):
    """Writes a model to a file, as a model or as a sequence."""

    def __call__(self, path: Path, model: Model, replace: bool) -> str:
        """Write the file, and return a sentence about it."""


PATIENCE = 1.0
"""Seconds after which the next preview runs although the last one was not shown."""

MOST_WRITTEN = 8
"""Largest number of files written at a time."""


class SessionListener(Protocol):
    """Callbacks, called on another thread."""

    def edited(self, session: Session) -> None:
        """Handle a changed model."""

    def chosen(self, session: Session) -> None:
        """Handle another choice of the edited model."""

    def failed(self, what: str, error: Exception) -> None:
        """Handle an error."""

    def saved(self, what: str) -> None:
        """Handle a written file; `what` is its description."""


@dataclass(frozen=True, eq=False)
class _Job:
    name: str
    index: int
    change: Callable[[History], History]
    preview: bool = False


class Session(Jobs[_Job]):
    """Editing of the models of a scene."""

    def __init__(self, playback: Playback, listener: SessionListener, save: Save) -> None:
        self._playback = playback
        self._listener = listener
        self._save = save
        self._histories = {
            index: History.of(item.motion)
            for index, item in enumerate(playback.scene.items)
            if isinstance(item.motion, Model)
        }
        self._saved: dict[int, Model] = {}
        self._writing: list[Thread] = []
        self._index = min(self._histories, default=-1)
        super().__init__(listener.failed)

    def close(self) -> None:
        """End the threads, after the current edit and files."""
        super().close()
        for writing in self._writing:
            writing.join()

    @property
    def editable(self) -> list[int]:
        """Indices of the scene's items that are models."""
        return list(self._histories)

    @property
    def index(self) -> int:
        """Index of the edited item; -1 if none is a model."""
        return self._index

    @property
    def history(self) -> History:
        """History of the edited model."""
        return self._histories[self._index]

    @property
    def model(self) -> Model:
        """Current state of the edited model."""
        return self.history.model

    @property
    def unsaved(self) -> dict[str, Model]:
        """Edited models without a file, by name."""
        return {
            self._playback.scene.items[index].name: history.model
            for index, history in self._histories.items()
            if history.changed and self._saved.get(index) is not history.model
        }

    def choose(self, index: int) -> None:
        """Edit another item."""
        if index in self._histories:
            self._index = index
            self._listener.chosen(self)

    def edit(self, name: str, edit: Edit) -> None:
        """Edit the model on another thread, as a step that can be undone."""
        self._ask(_Job(name, self._index, _step(name, edit)))

    def preview(self, name: str, edit: Edit) -> None:
        """Show the result of an edit, unless a newer job replaces it."""
        self._ask(_Job(name, self._index, _step(name, edit), preview=True))

    def retime(self, keys: Float, preview: bool = False) -> None:
        """Retime the model by keys ``(n, 2)`` of output and source seconds, in place of a retiming as last step."""

        def change(history: History) -> History:
            model = retime(history.before_retiming.model, keys)
            return history.retimed(model, tuple((float(output), float(source)) for output, source in keys))

        self._ask(_Job("retime", self._index, change, preview))

    def undo(self) -> None:
        """Undo the last step, after the queued edits."""
        self._ask(_Job("undo", self._index, History.undone))

    def redo(self) -> None:
        """Redo the last undone step."""
        self._ask(_Job("redo", self._index, History.redone))

    def settle(self) -> None:
        """Show the current model in place of a preview."""
        if self._histories:
            self._ask(_Job("settle", self._index, lambda history: history))

    def save(self, path: Path, replace: bool = False) -> None:
        """Write the model to a file on its own thread, over an existing one if `replace`; ignored once closed."""
        writing = Thread(target=self._write, args=(path, self._index, self.model, replace), daemon=True)
        with self._changed:
            if self._closed:  # nobody would wait for it, and a process that ends while HDF5 writes may hang
                return
            self._writing = [thread for thread in self._writing if thread.is_alive()]
            begins = len(self._writing) < MOST_WRITTEN
            if begins:
                self._writing.append(writing)
                writing.start()
        if not begins:
            self._fail(
                "save", OutputError(f"{MOST_WRITTEN} files are being written; save again when one is done")
            )

    def _write(self, path: Path, index: int, model: Model, replace: bool) -> None:
        try:
            what = self._save(path, model, replace)
        except Exception as error:
            self._fail("save", error)
        else:
            self._saved[index] = model
            self._listener.saved(what)

    def _ask(self, job: _Job) -> None:
        self._add(job, needless=lambda waiting: waiting.preview)

    def _do(self, job: _Job) -> None:
        try:
            history = job.change(self._histories[job.index])
            scene = self._playback.scene.with_item(job.index, history.model).checked()
        except Exception as error:
            model = self._histories[job.index].model
            self._playback.change(self._playback.scene.with_item(job.index, model))
            if not job.preview:  # the mouse goes on, and what comes of the last one is reported
                self._fail(job.name, error)
        else:
            self._see(job, history, scene)

    def _see(self, job: _Job, history: History, scene: Scene) -> None:
        if job.preview:
            self._playback.change(scene, settled=False)
            self._playback.caught_up(PATIENCE)
            return
        self._histories[job.index] = history
        self._playback.change(scene)
        try:
            self._listener.edited(self)
        except Exception as error:
            self._fail("drawing charts", error)


def _step(name: str, edit: Edit) -> Callable[[History], History]:
    return lambda history: history.done(name, edit(history.model))
