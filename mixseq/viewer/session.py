r"""Session of editing the models of a scene: messages of the page, picking, undo, chart data, and the thread for edits.

Edits run in order. Of previews, which follow the mouse, only the newest runs, after the one before was shown.

Picking finds the first triangle that a ray from the pointer meets (Möller & Trumbore 1997). A point of the ray is
:math:`o + t\,d`, one of the triangle :math:`a + u\,(b - a) + v\,(c - a)`; they meet where :math:`t > 0`,
:math:`u, v \ge 0` and :math:`u + v \le 1`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import OutputError
from mixseq.operations import retime
from mixseq.operations.sketch import default_reach
from mixseq.pictures.charts import dense_times, largest_coordinates
from mixseq.pictures.scene import Scene
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.types import Float, IntArray, evenly
from mixseq.viewer.playback import Jobs, Playback

MOST_POINTS = 5000
"""Largest number of points of a stroke, or keys of a retiming."""


LARGEST = 1e6
"""Largest time in seconds, and largest coordinate in diagonals."""


@dataclass(frozen=True)
class Drawn:
    """The page has drawn a frame."""


@dataclass(frozen=True)
class Seek:
    """Go to a time of the model, in seconds."""

    time: float


@dataclass(frozen=True, eq=False)
class Drag:
    """A drag of the time curve at a time to a place ``(2,)`` of the embedding; `done` at its end."""

    time: float
    to: Float
    done: bool


@dataclass(frozen=True, eq=False)
class Sketch:
    """A curve ``(N, 2)`` drawn in the embedding."""

    points: Float


@dataclass(frozen=True, eq=False)
class Retime:
    """Keys ``(n, 2)`` of a retiming, output and source times; `done` at the end of a drag."""

    keys: Float
    done: bool


Message = Drawn | Seek | Drag | Sketch | Retime


def message_of(text: str) -> Message | None:
    """Parse a message, None if it is not valid."""
    try:
        said = json.loads(text)
        match said:
            case {"kind": "drawn"}:
                return Drawn()
            case {"kind": "seek", "time": time}:
                return Seek(_number(time))
            case {"kind": "drag", "time": time, "to": to, "done": bool(done)}:
                return Drag(_number(time), _pairs([to])[0], done)
            case {"kind": "sketch", "points": points}:
                return Sketch(_pairs(points))
            case {"kind": "retime", "keys": keys, "done": bool(done)}:
                return Retime(_pairs(keys), done)
    except (ValueError, TypeError, RecursionError):
        return None
    return None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise ValueError
    return float(value)


def _pairs(rows: Any) -> Float:
    if not isinstance(rows, list) or not 0 < len(rows) <= MOST_POINTS:
        raise ValueError
    if any(not isinstance(row, list) or len(row) != 2 for row in rows):
        raise ValueError
    return np.array([[_number(value) for value in row] for row in rows])


class Picked(NamedTuple):
    """The first intersection of a ray."""

    face: int  # the triangle
    vertex: int  # the nearest of its corners
    distance: float  # how far along the ray, in lengths of its direction


def pick(
    points: NDArray[np.floating], faces: IntArray, origin: ArrayLike, direction: ArrayLike
) -> Picked | None:
    """Return the first triangle on a ray ``(3,)``, from either side, or None: points ``(V, 3)``; faces ``(F, 3)``."""
    start, along = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    corners = np.asarray(points, dtype=np.float64)[faces]
    a, b, c = np.moveaxis(corners, 1, 0)
    first, second = b - a, c - a
    across = np.cross(along, second)
    volume = np.einsum("fi,fi->f", first, across)
    with np.errstate(
        divide="ignore", over="ignore", invalid="ignore"
    ):  # triangles seen edge on, no direction
        offset = start - a
        u = np.einsum("fi,fi->f", offset, across) / volume
        turned = np.cross(offset, first)
        v = turned @ along / volume
        t = np.einsum("fi,fi->f", second, turned) / volume
        met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & np.isfinite(t)
    if not met.any():
        return None
    face = int(np.where(met, t, np.inf).argmin())
    nearest = np.linalg.norm(corners[face] - (start + t[face] * along), axis=1).argmin()
    return Picked(face, int(faces[face, nearest]), float(t[face]))


@dataclass(frozen=True, eq=False)
class Step:
    """A model and the edit that made it."""

    name: str  # what was done, such as repeat; that of the first step is empty
    model: Model  # what came of it
    # Of a retiming, its keys: times of the output and of the source, in seconds.
    keys: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class History:
    """Steps and the index of the current one; immutable."""

    steps: tuple[Step, ...]  # the first is the model as it was opened
    now: int = 0  # which of them is seen

    @classmethod
    def of(cls, model: Model) -> History:
        """Make the history of an unedited model."""
        return cls((Step("", model),))

    @property
    def model(self) -> Model:
        """The current model."""
        return self.steps[self.now].model

    @property
    def changed(self) -> bool:
        """Whether the current model is edited."""
        return self.now > 0

    def done(self, name: str, model: Model, keys: tuple[tuple[float, float], ...] = ()) -> History:
        """Return the history after an edit; undone steps are dropped."""
        return History((*self.steps[: self.now + 1], Step(name, model, keys)), self.now + 1)

    @property
    def before_retiming(self) -> History:
        """The history without its last step if that is a retiming, so that its keys can be moved."""
        return self.undone() if self.steps[self.now].keys else self

    def retimed(self, model: Model, keys: tuple[tuple[float, float], ...]) -> History:
        """Return the history with a retiming of `before_retiming` as its last step."""
        return self.before_retiming.done("retime", model, keys)

    @property
    def undoes(self) -> str | None:
        """Name of the edit that `undone` undoes, if any."""
        return self.steps[self.now].name if self.now else None

    @property
    def redoes(self) -> str | None:
        """Name of the edit that `redone` redoes, if any."""
        return self.steps[self.now + 1].name if self.now + 1 < len(self.steps) else None

    def undone(self) -> History:
        """Return the history one step back, or unchanged at its start."""
        return History(self.steps, max(self.now - 1, 0))

    def redone(self) -> History:
        """Return the history one step ahead, or unchanged at its end."""
        return History(self.steps, min(self.now + 1, len(self.steps) - 1))


POINTS = 800
"""Points of a line, about two for every pixel of a chart."""

FRAMES = 300
"""Largest number of dots."""

HANDLES = 13
"""Draggable points of the curve, evenly spaced in time, distinguishable on a small chart."""

KEYS = 5
"""Initial number of keys of the retiming."""

DIGITS = 5
"""Digits of the largest number, enough for a screen of 4000 pixels."""


def signals_of(model: Model, plane: Plane | None = None) -> dict[str, Any]:
    """Return the chart data of a model, ready for JSON."""
    start, end = model.start, model.end
    moves = end > start and model.time.dim > 0
    times = dense_times(model) if end > start else np.array([start])
    times = times[evenly(len(times), POINTS)]
    frames = model.times[evenly(len(model.times), FRAMES)]
    handles = np.linspace(start, end, HANDLES) if moves else np.zeros(0)
    chosen, units = largest_coordinates(model)
    lines = model.time(times)[:, chosen] * units
    keys = np.linspace(start, end, KEYS).tolist() if end > start else []
    path = model.embedding(times, plane)
    step = float(np.abs(path).max(initial=0.0))
    places = _rounded(model.embedding(handles, plane), step)
    return {
        "start": start,
        "end": end,
        "fps": model.header.fps,
        "times": _rounded(times, end - start),
        "path": _rounded(path, step),
        "frames": _rounded(model.embedding(frames, plane), step),
        "frameTimes": _rounded(frames, end - start),
        "handles": [{"time": time, "at": at} for time, at in zip(handles.tolist(), places, strict=True)],
        "reach": default_reach(model),
        "coefficients": [
            {"name": f"coordinate {number + 1}", "values": _rounded(line, float(np.abs(lines).max()))}
            for number, line in zip(chosen.tolist(), lines.T, strict=True)
        ],
        "keys": [[time, time] for time in keys],
    }


def _rounded(values: Float, largest: float) -> list[Any]:
    """Return values as lists, rounded to `DIGITS` digits of the largest."""
    decimals = DIGITS - int(np.ceil(np.log10(largest))) if largest > 0 else DIGITS
    rounded: list[Any] = (np.round(values, min(max(decimals, 0), 15)) + 0.0).tolist()
    return rounded


Edit = Callable[[Model], Model]


Save = Callable[[Path, Model, bool], str]
"""Writes a model to a file, also over an existing one if that is true, and returns a sentence about it."""

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
    preview: bool


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

    def edit(self, name: str, edit: Edit, preview: bool = False) -> None:
        """Edit the model on another thread, as a step that can be undone; a preview is shown, unless a newer job is."""
        self._ask(name, lambda history: history.done(name, edit(history.model)), preview)

    def retime(self, keys: Float, preview: bool = False) -> None:
        """Retime the model by keys ``(n, 2)`` of output and source seconds, in place of a retiming as last step."""

        def change(history: History) -> History:
            model = retime(history.before_retiming.model, keys)
            return history.retimed(model, tuple((float(output), float(source)) for output, source in keys))

        self._ask("retime", change, preview)

    def undo(self) -> None:
        """Undo the last step, after the queued edits."""
        self._ask("undo", History.undone)

    def redo(self) -> None:
        """Redo the last undone step."""
        self._ask("redo", History.redone)

    def settle(self) -> None:
        """Show the current model in place of a preview."""
        if self._histories:
            self._ask("settle", lambda history: history)

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

    def _ask(self, name: str, change: Callable[[History], History], preview: bool = False) -> None:
        self._add(_Job(name, self._index, change, preview), needless=lambda waiting: waiting.preview)

    def _do(self, job: _Job) -> None:
        try:
            history = job.change(self._histories[job.index])
            scene = self._playback.scene.with_item(job.index, history.model).validated()
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
