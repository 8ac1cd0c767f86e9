"""The panel on the left: charts of the model that is edited, and buttons for what can be done to it."""

from __future__ import annotations

from functools import partial
from typing import Any

from mixseq.errors import SettingsError
from mixseq.operations import (
    cut,
    drag,
    exaggerate,
    exaggerate_part,
    hold,
    loop,
    repeat,
    retime,
    reverse,
    sketch,
)
from mixseq.signals import Model
from mixseq.signals.layout import Plane
from mixseq.spaces import MixedSpace
from mixseq.viewing.live.bridge import in_script
from mixseq.viewing.messages import Drag, Message, Retime, Seek, Sketch
from mixseq.viewing.picking import Picked
from mixseq.viewing.playback import Moment, Playback
from mixseq.viewing.session import Edit, Session
from mixseq.viewing.signals import signals_of

WHOLE = "whole body"


class Charts:
    """The charts, and what is done with the mouse in them."""

    def __init__(self, server: Any, session: Session, playback: Playback) -> None:
        gui = server.gui
        self._session = session
        self._playback = playback
        self._planes: dict[int, Plane] = {}
        self._version = 0
        self._pen = False
        gui.add_html('<div id="mixseq-charts" style="height: calc(100vh - 88px); min-height: 420px"></div>')
        self._signals = gui.add_html("")
        self._now = gui.add_html("")

    @property
    def _plane(self) -> Plane | None:
        """The layout that is drawn."""
        return self._planes.get(self._session.index)

    def edited(self) -> None:
        """Draw the model that is edited."""
        self._version += 1
        model = self._session.model
        # what is dragged should not turn the picture that it is dragged in
        known = self._planes.get(self._session.index)
        fits = known is not None and _same_space(model, known)
        self._planes[self._session.index] = known if fits and known is not None else model.plane
        self._signals.content = (
            f'<script type="application/json" id="mixseq-signals" data-version="{self._version}">'
            f"{in_script(signals_of(model, self._plane))}</script>"
        )

    def show(self, moment: Moment) -> None:
        """Move the point that is now."""
        model = self._session.model
        time = min(model.start + moment.shot.elapsed(moment.frame), model.end)
        pen = "true" if self._pen else "false"
        self._now.content = f'<span id="mixseq-now" data-time="{time:.6f}" data-pen="{pen}" hidden></span>'

    def pen(self, on: bool) -> None:
        """Let the mouse draw, or drag."""
        self._pen = on
        self._playback.refresh()

    def heard(self, message: Message, reach: float, seconds: float) -> None:
        """Do what was done with the mouse.

        Parameters
        ----------
        message : Message
            What the page said.
        reach : float
            Seconds to both sides over which the curve follows.
        seconds : float
            Duration of what is sketched.
        """
        session = self._session
        match message:
            case Seek(time):
                self._playback.seek(self._playback.shot.frame_at(time - session.model.start))
            case Drag(time, to, done):
                if not self._playback.plays:  # what is dragged should be seen
                    self._playback.seek(self._playback.shot.frame_at(time - session.model.start))
                edit = partial(drag, time=time, to=to.tolist(), reach=reach, plane=self._plane)
                (session.edit if done else session.preview)("drag", edit)
            case Sketch(points):
                session.edit("sketch", partial(sketch, curve=points, duration=seconds, plane=self._plane))
            case Retime(keys, done):
                (session.edit if done else session.preview)("retime", partial(retime, keys=keys))


class EditControls:
    """Buttons: undo, sections, parts."""

    def __init__(self, server: Any, session: Session, playback: Playback, charts: Charts) -> None:
        gui = server.gui
        self._session = session
        self._playback = playback
        model = session.model
        with gui.add_folder("Edit"):
            if len(session.editable) > 1:
                names = {playback.shot.items[index].name: index for index in session.editable}
                which = gui.add_dropdown("Model", tuple(names))
                which.on_update(lambda _: session.choose(names[which.value]))
            self._undo = gui.add_button_group("Steps", ("Undo", "Redo"))
            self._steps = gui.add_html("")
            pen = gui.add_checkbox("Pen", False, hint="Draw a new curve (shift and drag does it, too)")
            self._seconds = gui.add_number("Draw for (s)", _duration(model), min=0.05, step=0.05)
            self._reach = gui.add_number(
                "Drag over (s)",
                round(_duration(model) / 8, 3),
                min=0.0,
                step=0.01,
                hint="How far before and after the point the curve follows it",
            )
            self._section = gui.add_multi_slider(
                "Section (s)", 0.0, _duration(model), _step(model), (0.0, _duration(model))
            )
            self._times = gui.add_number("Times", 2, min=1, max=100, step=1, hint="How often Repeat shows it")
            sections = gui.add_button_group("", ("Repeat", "Cut", "Loop", "Reverse"))
            self._part = gui.add_dropdown(
                "Part", (WHOLE, *_parts(model)), hint="Click a part of the mesh to choose it"
            )
            self._gain = gui.add_number("Gain", 1.5, min=-10.0, max=10.0, step=0.1)
            parts = gui.add_button_group("", ("Exaggerate", "Hold"))
        self._undo.on_click(lambda _: session.undo() if self._undo.value == "Undo" else session.redo())
        pen.on_update(lambda _: charts.pen(pen.value))
        sections.on_click(lambda _: self._edit_section(sections.value))
        parts.on_click(lambda _: self._edit_part(parts.value))
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: session.undo())
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda _: session.redo())

    @property
    def reach(self) -> float:
        """Seconds over which a dragged curve follows."""
        return float(self._reach.value)

    @property
    def seconds(self) -> float:
        """Duration of a sketch."""
        return float(self._seconds.value)

    def edited(self) -> None:
        """Fit what can be chosen to the model."""
        model, history = self._session.model, self._session.history
        undone = f"{history.now} of {len(history.steps) - 1} steps"
        last = f": {history.undoes}" if history.undoes else ""
        self._steps.content = (
            f'<div id="mixseq-steps" style="padding: 0 12px; font-size: 12px">{undone}{last}</div>'
        )
        self._section.max = _duration(model)
        self._section.value = (0.0, _duration(model))
        self._seconds.value = _duration(model)
        self._part.options = (WHOLE, *_parts(model))

    def picked(self, index: int, picked: Picked) -> str:
        """Choose the part that was clicked, and return what was."""
        motion = self._playback.shot.items[index].motion
        text = f"vertex {picked.vertex}, triangle {picked.face}"
        if isinstance(motion, Model) and isinstance(motion.space, MixedSpace):
            cut_up = motion.decomposition
            part, joint = int(cut_up.part_of_face[picked.face]), int(cut_up.joint_of_face[picked.face])
            if index == self._session.index:
                self._part.value = str(part)
            text += f", part {part}" if joint < 0 else f", joint {joint} of part {part}"
        return text

    def _edit_section(self, name: str) -> None:
        begin = self._session.model.start
        start, end = (begin + each for each in self._section.value)
        edits: dict[str, Edit] = {
            "Repeat": partial(repeat, start=start, end=end, times=int(self._times.value)),
            "Cut": partial(cut, start=start, end=end),
            "Loop": loop,
            "Reverse": reverse,
        }
        self._session.edit(name.lower(), edits[name])

    def _edit_part(self, name: str) -> None:
        model, part, gain = self._session.model, self._part.value, float(self._gain.value)
        if name == "Exaggerate" and part == WHOLE:
            self._session.edit("exaggerate", partial(exaggerate, gain=gain))
        elif name == "Exaggerate":
            self._session.edit("exaggerate part", partial(exaggerate_part, part=int(part), gain=gain))
        elif part == WHOLE:
            first, last = self._section.value
            self._session.edit("hold", partial(pause, time=self._time, seconds=last - first))
        else:
            start, end = (model.start + each for each in self._section.value)
            self._session.edit("hold", partial(hold, part=int(part), time=self._time, start=start, end=end))

    @property
    def _time(self) -> float:
        """The time of the model that is seen."""
        model, playback = self._session.model, self._playback
        return min(model.start + playback.shot.elapsed(playback.frame), model.end)


def pause(model: Model, time: float, seconds: float) -> Model:
    """Return the model standing still at a time, for so many seconds, and then going on.

    Raises
    ------
    SettingsError
        If the time is not in the model, or the seconds are not positive.
    """
    before = [[model.start, model.start]] if time > model.start else []
    after = [[model.end + seconds, model.end]] if time < model.end else []
    return retime(model, [*before, [time, time], [time + seconds, time], *after])


def _same_space(model: Model, plane: Plane) -> bool:
    """Whether a plane can be one of a model."""
    try:
        model.known(plane)
    except SettingsError:
        return False
    return True


def _duration(model: Model) -> float:
    return round(max(model.end - model.start, 1 / model.header.fps), 3)


def _step(model: Model) -> float:
    return round(1 / model.header.fps, 3)


def _parts(model: Model) -> tuple[str, ...]:
    """Return the numbers of the parts that can be chosen."""
    if not isinstance(model.space, MixedSpace):
        return ()
    return tuple(str(part) for part in range(int(model.decomposition.part_of_face.max()) + 1))
