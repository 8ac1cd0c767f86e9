"""The controls that edit a model: charts on the left, buttons and saving on the right."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.frame_numbers import frame_text
from mixseq.operations import cut, exaggerate, exaggerate_part, hold, loop, repeat, reverse
from mixseq.operations.dragging import default_reach
from mixseq.signals import Model
from mixseq.spaces import MixedSpace
from mixseq.viewing.live.controls import SaveControls, notify
from mixseq.viewing.live.curves_panel import Charts
from mixseq.viewing.messages import Message
from mixseq.viewing.picking import Picked
from mixseq.viewing.playback import Moment, Playback
from mixseq.viewing.session import Edit, Session

WHOLE = "whole body"

NO_HOLD = (
    "the whole body has nothing to rest against; click a part of the mesh, or choose it under Part. To stop all for a "
    "while, drag keys of the retiming"
)

SHORTEST = 1e-3
"""Smallest duration in controls, in seconds."""


class EditControls:
    """Undo, sections, parts."""

    def __init__(self, server: Any, session: Session, playback: Playback, charts: Charts) -> None:
        gui = server.gui
        self._session = session
        self._playback = playback
        self._charts = charts
        model = session.model
        with gui.add_folder("Edit"):
            if len(session.editable) > 1:
                names = {playback.scene.items[index].name: index for index in session.editable}
                which = gui.add_dropdown("Model", tuple(names))
                which.on_update(lambda _: session.choose(names[which.value]))
            self._undo = gui.add_button_group("Steps", ("Undo", "Redo"))
            self._steps = gui.add_html("")
            pen = gui.add_checkbox("Pen", False, hint="Draw a new curve (shift and drag does it, too)")
            self._seconds = gui.add_number("Draw for (s)", duration(model), min=SHORTEST, step=0.05)
            self._reach = gui.add_number(
                "Drag over (s)",
                reach_of(model),
                min=SHORTEST,
                step=0.01,
                hint="How far before and after the point the curve follows it",
            )
            self._section = gui.add_multi_slider("Section (s)", *span(model), SHORTEST, span(model))
            self._frames = gui.add_html("")
            self._times = gui.add_number("Times", 2, min=1, max=100, step=1, hint="How often Repeat shows it")
            sections = gui.add_button_group("", ("Repeat", "Cut", "Loop", "Reverse"))
            self._part = gui.add_dropdown(
                "Part", (WHOLE, *_parts(model)), hint="Click a part of the mesh to choose it"
            )
            self._gain = gui.add_number("Gain", 1.5, min=-10.0, max=10.0, step=0.1)
            parts = gui.add_button_group("", ("Exaggerate", "Hold"))
        self.edited()  # a line that came later would push all else down
        self._undo.on_click(lambda _: session.undo() if self._undo.value == "Undo" else session.redo())
        self._section.on_update(lambda _: self._tell_frames())
        pen.on_update(lambda _: charts.pen(pen.value))
        self._seconds.on_update(lambda _: charts.last(float(self._seconds.value)))
        self._reach.on_update(lambda _: charts.reach(float(self._reach.value)))
        sections.on_click(lambda _: self._edit_section(sections.value))
        parts.on_click(lambda event: self._edit_part(parts.value, event.client))
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: session.undo())
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda _: session.redo())

    def edited(self) -> None:
        """Adapt the controls to the model, and keep the choices that still fit."""
        model, history = self._session.model, self._session.history
        done = f"{history.now} of {len(history.steps) - 1} steps"
        last = f": {history.undoes}" if history.undoes else ""
        self._steps.content = (
            f'<div id="mixseq-steps" style="padding: 0 12px; font-size: 12px">{done}{last}</div>'
        )
        before, after = (self._section.min, self._section.max), span(model)
        if after != before:
            first, end = (min(max(each, after[0]), after[1]) for each in self._section.value)
            whole = self._section.value == before or first >= end
            self._section.min, self._section.max = after
            self._section.value = after if whole else (first, end)
        self._tell_frames()

    def chosen(self) -> None:
        """Reset the controls to another model."""
        model = self._session.model
        self._section.min, self._section.max = span(model)
        self._section.value = span(model)
        self._seconds.value = duration(model)
        self._reach.value = reach_of(model)
        self._part.value = WHOLE
        self._part.options = (WHOLE, *_parts(model))
        self.edited()

    def picked(self, index: int, picked: Picked) -> str:
        """Choose the part that was clicked, and describe the picked element."""
        motion = self._playback.scene.items[index].motion
        text = f"vertex {picked.vertex}, triangle {picked.face}"
        if isinstance(motion, Model) and motion.space.decomposed is not None:
            cut_up = motion.decomposition
            part, joint = int(cut_up.part_of_face[picked.face]), int(cut_up.joint_of_face[picked.face])
            if index == self._session.index:  # the root has nothing that it could move against
                self._part.value = str(part) if str(part) in self._part.options else WHOLE
            text += f", part {part}" if joint < 0 else f", joint {joint} of part {part}"
        return text

    def _edit_section(self, name: str) -> None:
        start, end = self._chosen_section
        edits: dict[str, Edit] = {
            "Repeat": partial(repeat, start=start, end=end, times=int(self._times.value)),
            "Cut": partial(cut, start=start, end=end),
            "Loop": loop,
            "Reverse": reverse,
        }
        self._session.edit(name.lower(), edits[name])

    def _edit_part(self, name: str, client: Any) -> None:
        part, gain = self._part.value, float(self._gain.value)
        if name == "Exaggerate" and part == WHOLE:
            self._session.edit("exaggerate", partial(exaggerate, gain=gain))
        elif name == "Exaggerate":
            self._session.edit("exaggerate part", partial(exaggerate_part, part=int(part), gain=gain))
        elif part == WHOLE:
            notify(client, "Hold: not done", NO_HOLD)
        else:
            start, end = self._chosen_section
            self._session.edit("hold", partial(hold, part=int(part), time=self._time, start=start, end=end))

    @property
    def _chosen_section(self) -> tuple[float, float]:
        """Start and end in seconds of the model, clipped, as the slider rounds them."""
        model = self._session.model
        first, last = (min(max(each, model.start), model.end) for each in self._section.value)
        return first, last

    def _tell_frames(self) -> None:
        fps = self._session.model.header.fps
        first, last = (frame_text(each, fps) for each in self._chosen_section)
        style = "padding: 0 12px; font-size: 12px; opacity: 0.75"
        self._frames.content = f'<div id="mixseq-section" style="{style}">frames {first} to {last}</div>'

    @property
    def _time(self) -> float:
        """Current time of the model, in seconds."""
        model, playback = self._session.model, self._playback
        return min(model.start + playback.scene.elapsed(playback.frame), model.end)


def span(model: Model) -> tuple[float, float]:
    """Return start and end of a model in seconds, at least a frame apart, rounded outwards to the slider's steps."""
    first = float(np.floor(model.start / SHORTEST + 1e-6) * SHORTEST)
    last = float(np.ceil(model.end / SHORTEST - 1e-6) * SHORTEST)
    return first, max(last, first + max(1 / model.header.fps, SHORTEST))


def duration(model: Model) -> float:
    """Return the duration of a model in seconds, at least a frame, rounded up to the slider's steps."""
    lasts = max(model.end - model.start, 1 / model.header.fps, SHORTEST)
    return float(np.ceil(lasts / SHORTEST - 1e-6) * SHORTEST)


def reach_of(model: Model) -> float:
    """Return the default reach of dragging, in seconds."""
    return max(round(default_reach(model), 3), SHORTEST)


def _parts(model: Model) -> tuple[str, ...]:
    """Return the numbers of parts with a parent."""
    if not isinstance(model.space, MixedSpace) or model.space.placement == "free":
        return ()
    return tuple(str(part) for part in np.flatnonzero(model.space.articulation.parents >= 0))


class Editor:
    """All controls that edit."""

    def __init__(self, server: Any, session: Session, playback: Playback, folder: Path) -> None:
        self._session = session
        self._playback = playback
        model, panel = session.model, server.gui.add_panel()
        with panel.add_tab("Curves"):
            self._charts = Charts(server, session, playback, reach_of(model), duration(model))
        panel.dock_left()
        panel.set_width(360)
        self._controls = EditControls(server, session, playback, self._charts)
        self._saving = SaveControls(server, folder, self._target, session.save)

    def edited(self) -> None:
        """Show the model after an edit."""
        self._charts.draw()
        self._controls.edited()

    def chosen(self) -> None:
        """Show another model."""
        self._controls.chosen()
        self._charts.draw()
        self._saving.name(self._target)
        self._playback.refresh()

    def undone(self) -> None:
        """Draw the model again, over unfinished mouse edits of its charts."""
        self._charts.draw()

    def show(self, moment: Moment) -> None:
        """Show the current time."""
        self._charts.show(moment)

    def heard(self, message: Message) -> None:
        """Apply a mouse message of the charts."""
        self._charts.heard(message)

    def picked(self, index: int, picked: Picked) -> str:
        """Choose the picked mesh element, and describe it."""
        return self._controls.picked(index, picked)

    @property
    def _target(self) -> str:
        """Default file name of the model."""
        return f"{Path(self._playback.scene.items[self._session.index].name).stem}-edited.h5"
