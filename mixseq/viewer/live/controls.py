"""The panels beside the scene: playback, display, edits and saving on the right, charts of a model on the left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape
from math import ceil, floor
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any

import numpy as np

from mixseq.errors import SettingsError
from mixseq.operations import cut, drag, exaggerate, exaggerate_part, hold, loop, repeat, reverse, sketch
from mixseq.operations.sketch import default_reach
from mixseq.pictures.colours import Colouring, SceneColours
from mixseq.pictures.scene import Scene
from mixseq.sequence.frame_rates import frame_text, number_at, time_of
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.viewer.export import script_json
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.playback import Moment, Playback
from mixseq.viewer.session import Drag, Edit, Message, Picked, Retime, Seek, Session, Sketch, signals_of

SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
HAND = 0.5
"""Seconds for which a moved slider keeps its value, as the display lags behind."""

DIGITS = 3
"""Decimals of fractional frame numbers."""

ROW, PLACE = "side by side", "in one place"


@dataclass(frozen=True)
class TimeBase:
    """The displayed times: seconds and frame numbers of one mesh of a scene."""

    start: float  # time of the mesh's first frame, in seconds
    fps: float  # frames per second of the mesh
    last: float  # time of the scene's last frame since its first one, in seconds
    rate: float  # frames per second of the scene

    @classmethod
    def of(cls, scene: Scene, index: int) -> TimeBase:
        """Make the time base of a mesh."""
        header = scene.items[index].header
        return cls(float(header.times[0]), header.fps, scene.elapsed(scene.count - 1), scene.fps)

    def number(self, elapsed: float) -> float:
        """Return the frame number at a time since the first frame."""
        return number_at(self.start + elapsed, self.fps)

    def elapsed(self, number: float) -> float:
        """Return the time since the first frame of a frame number."""
        return time_of(number, self.fps) - self.start

    @property
    def slider(self) -> tuple[float, float, float, int]:
        """Smallest and largest number, the step between frames, and their decimals."""
        low, high, step = self.number(0.0), self.number(self.last), self.fps / self.rate
        digits = 0 if all(each == round(each) for each in (low, high, step)) else DIGITS
        scale = 10.0**digits  # what is rounded must not be outside
        return floor(low * scale + 1e-6) / scale, ceil(high * scale - 1e-6) / scale, step, digits

    def text(self, elapsed: float) -> str:
        """Format a time."""
        number, end = frame_text(self.start + elapsed, self.fps), frame_text(self.start + self.last, self.fps)
        return f"frame {number} of {end}, {self.start + elapsed:.3f} of {self.start + self.last:.3f} s"


class PlayControls:
    """Playback, scrubbing, and frame rate."""

    def __init__(self, server: Any, playback: Playback, index: int) -> None:
        gui = server.gui
        self._playback = playback
        self._base = TimeBase.of(playback.scene, index)
        low, high, step, digits = self._base.slider
        self._icons = _icon("PLAYER_PLAY"), _icon("PLAYER_PAUSE")
        self._hand = -HAND
        self._button = gui.add_button("Play", icon=self._icons[0], hint="Play or pause (P)")
        self._slider = gui.add_slider("Frame", low, high, step, low)
        self._slider.precision = digits
        self._text = gui.add_html("")
        speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
        self._rate = gui.add_number(
            "Frames/s", playback.scene.fps, min=1e-3, max=1e4, hint="Models are decoded at any rate"
        )
        self._button.on_click(lambda _: self.toggle())
        self._slider.on_update(self._scrub)
        speed.on_update(lambda _: playback.pace(SPEEDS[speed.value]))
        self._rate.on_update(self._set_rate)
        for label, key, step in (("Next frame", "]", 1), ("Previous frame", "[", -1)):
            gui.add_command(label, hotkey=key).on_trigger(lambda _, by=step: self._step(by))
        gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: self.toggle())

    def toggle(self) -> None:
        """Play or pause."""
        if self._playback.plays:
            self._playback.pause()
        else:
            self._playback.play()
        self.refresh()

    def refresh(self) -> None:
        """Show the state of playback."""
        plays = self._playback.plays
        self._button.label = "Pause" if plays else "Play"
        self._button.icon = self._icons[plays]

    def show(self, moment: Moment, index: int) -> None:
        """Show the current time, in the time base of a mesh."""
        base, elapsed = TimeBase.of(moment.scene, index), moment.scene.elapsed(moment.frame)
        if base != self._base:
            self._base = base
            slider = self._slider
            slider.min, slider.max, slider.step, slider.precision = base.slider
        if monotonic() > self._hand + HAND:
            self._slider.value = base.number(elapsed)
        self._text.content = _line(base.text(elapsed), "mixseq-time")

    def _step(self, by: int) -> None:
        self._playback.pause()
        self._playback.seek((self._playback.frame + by) % self._playback.scene.count)
        self.refresh()

    def _scrub(self, event: Any) -> None:
        if event.client is not None:  # a hand, and not `show`
            self._hand = monotonic()
            self._playback.seek(self._playback.scene.frame_at(self._base.elapsed(self._slider.value)))

    def _set_rate(self, event: Any) -> None:
        if event.client is None:
            return
        try:
            self._playback.rate(float(self._rate.value))
        except SettingsError:  # half-typed numbers come here, too
            self._text.content = _line(
                f"not at {self._rate.value:g} frames/s: too few, or too many", "mixseq-time"
            )


class ShowControls:
    """Colours, arrangement, and visibility of meshes."""

    def __init__(self, server: Any, playback: Playback, stage: LiveStage, colours: SceneColours) -> None:
        gui, names = server.gui, [item.name for item in playback.scene.items]
        self._stage = stage
        with gui.add_folder("Show"):
            self._colour = gui.add_dropdown("Colour", colours.names, initial_value="clay")
            self._legend = gui.add_html("")
            wire = gui.add_checkbox("Wireframe", False)
            follow = gui.add_checkbox(
                "Follow", stage.following, hint="Bodies that travel stay in the middle, and the ground moves"
            )
            if len(names) > 1:
                places = gui.add_dropdown(
                    "Meshes", (ROW, PLACE), initial_value=PLACE if stage.overlaid else ROW
                )
                places.on_update(lambda _: self._arrange(playback, places.value == ROW))
                for index, name in enumerate(names):
                    switch = gui.add_checkbox(name, True)
                    switch.on_update(lambda _, of=index, switch=switch: stage.hide(of, not switch.value))
            self._picked = gui.add_html(_line("Click a mesh for its vertex and part", "mixseq-picked"))
        self._colour.on_update(lambda event: self._paint(event, playback))
        wire.on_update(lambda _: stage.wire(wire.value))
        follow.on_update(lambda _: self._follow(playback, follow.value))

    def picked(self, text: str) -> None:
        """Show the picked mesh element."""
        self._picked.content = _line(text, "mixseq-picked")

    def _follow(self, playback: Playback, on: bool) -> None:
        self._stage.following = on
        playback.refresh()

    def _arrange(self, playback: Playback, side_by_side: bool) -> None:
        self._stage.arrange(playback.scene, side_by_side)
        playback.refresh()

    def _paint(self, event: Any, playback: Playback) -> None:
        if event.client is not None:
            self._stage.colour(self._colour.value)
            self._legend.content = _legend(self._stage.colours)
            playback.refresh()


def _legend(colourings: list[Colouring]) -> str:
    """Return the colour scale as a bar with its ends."""
    shown = next((each for each in colourings if not each.constant), None)
    if shown is None:
        return ""
    stops = ", ".join(f"rgb({r} {g} {b})" for r, g, b in shown.palette[::15])
    bar = f'<div style="height: 10px; border-radius: 3px; background: linear-gradient(to right, {stops})"></div>'
    ends = (
        f'<div style="display: flex; justify-content: space-between"><span>0</span><span>{shown.top:.3g} '
        f"{escape(shown.unit)}</span></div>"
    )
    return f'<div id="mixseq-legend" style="padding: 2px 12px; font-size: 12px">{bar}{ends}</div>'


def _line(text: str, name: str) -> str:
    return f'<div id="{name}" style="padding: 0 12px; font-size: 12px; opacity: 0.75">{escape(text)}</div>'


def _icon(name: str) -> Any:
    from viser import Icon

    return getattr(Icon, name)


def notify(client: Any, title: str, text: str, good: bool = False) -> None:
    """Show a notification on a page for some seconds."""
    client.add_notification(title, text, auto_close_seconds=6.0, color="teal" if good else "red")


def notify_all(server: Any, title: str, text: str, good: bool = False) -> None:
    """Show a notification on all pages."""
    for client in server.get_clients().values():
        notify(client, title, text, good)


LONGEST_NAME = 200
"""Longest file name in bytes: folders allow 255, and writers temporarily add some letters."""


class SaveControls:
    """Save edits under a name in the folder where the viewer was started."""

    def __init__(self, server: Any, folder: Path, name: str, save: Callable[[Path, bool], None]) -> None:
        gui = server.gui
        self._folder = folder
        self._save = save
        with gui.add_folder("Save"):
            self._name = gui.add_text(
                "File", name, hint=f"A model (.h5), or a sequence in any format, in {folder}"
            )
            self._replace = gui.add_checkbox("Replace", False, hint="Whether a file of this name is replaced")
            self._button = gui.add_button("Save", icon=_icon("DEVICE_FLOPPY"))
        self._button.on_click(self._clicked)

    def name(self, name: str) -> None:
        """Propose another name."""
        self._name.value = name

    def _clicked(self, event: Any) -> None:
        name = self._name.value.strip()
        path = self._folder / name
        # whoever can reach the page should not write anywhere
        if not _is_file_name(name):
            notify(
                event.client,
                "Not saved",
                f"{name!r}: only the name of a file is expected, which goes to {self._folder}",
            )
        else:
            self._save(path, bool(self._replace.value))


def _is_file_name(name: str) -> bool:
    """Whether a text is a plain file name on any system, without a path."""
    plain = name not in ("", ".", "..") and not any(each in name for each in "/\\:")
    return plain and name.isprintable() and len(name.encode(errors="replace")) <= LONGEST_NAME


class Charts:
    """The time curve, coefficients, and keys of a retiming."""

    def __init__(
        self, server: Any, session: Session, playback: Playback, reach: float, seconds: float
    ) -> None:
        gui = server.gui
        self._session = session
        self._playback = playback
        self._lock = Lock()
        self._planes: dict[int, Plane] = {}
        self._version = 0
        self._pen = False
        self._reach = reach
        self._seconds = seconds
        gui.add_html('<div id="mixseq-charts" style="height: calc(100vh - 88px); min-height: 420px"></div>')
        self._signals = gui.add_html("")
        self._now = gui.add_html("")
        self.draw()

    def draw(self) -> None:
        """Draw the edited model."""
        with self._lock:  # the newest model is drawn last, whoever asks
            self._version += 1
            history = self._session.history
            signals = signals_of(history.model, self._plane) | {"reach": self._reach}
            if keys := history.steps[history.now].keys:  # which can be moved on
                before = history.before_retiming.model
                signals |= {"keys": keys, "source": [before.start, before.end]}
            self._signals.content = (
                f'<script type="application/json" id="mixseq-signals" data-version="{self._version}">'
                f"{script_json(signals)}</script>"
            )

    def show(self, moment: Moment) -> None:
        """Move the point of the current time."""
        model = self._session.model
        time = min(model.start + moment.scene.elapsed(moment.frame), model.end)
        pen = "true" if self._pen else "false"
        self._now.content = f'<span id="mixseq-now" data-time="{time:.6f}" data-pen="{pen}" hidden></span>'

    def pen(self, on: bool) -> None:
        """Set the mouse to drawing or dragging."""
        self._pen = on
        self._playback.refresh()

    def reach(self, seconds: float) -> None:
        """Set the reach of dragging, in seconds."""
        self._reach = seconds
        self.draw()

    def last(self, seconds: float) -> None:
        """Set the duration of drawn curves."""
        self._seconds = seconds

    def heard(self, message: Message) -> None:
        """Apply a mouse message of the charts."""
        session, scene = self._session, self._playback.scene
        match message:
            case Seek(time):
                self._playback.seek(scene.frame_at(time - session.model.start))
            case Drag(time, to, done):
                if not self._playback.plays:  # what is dragged should be seen
                    self._playback.seek(scene.frame_at(time - session.model.start))
                edit = partial(drag, time=time, to=to.tolist(), reach=self._reach, plane=self._plane)
                session.edit("drag", edit, preview=not done)
            case Sketch(points):
                session.edit(
                    "sketch", partial(sketch, curve=points, duration=self._seconds, plane=self._plane)
                )
            case Retime(keys, done):
                session.retime(keys, preview=not done)

    @property
    def _plane(self) -> Plane:
        """The drawn embedding, which is kept while dragging so that the picture stays."""
        model, index = self._session.model, self._session.index
        if index not in self._planes or not _fits(model, self._planes[index]):
            self._planes[index] = model.plane
        return self._planes[index]


def _fits(model: Model, plane: Plane) -> bool:
    try:
        model.check_plane(plane)
    except SettingsError:
        return False
    return True


WHOLE = "whole body"

NO_HOLD = (
    "the whole body has nothing to rest against; click a part of the mesh, or choose it under Part. To stop all for a "
    "while, drag keys of the retiming"
)

SHORTEST = 1e-3
"""Smallest duration in controls, in seconds."""


class Editor:
    """All controls that edit: charts, undo, sections, parts and saving."""

    def __init__(self, server: Any, session: Session, playback: Playback, folder: Path) -> None:
        gui, model = server.gui, session.model
        self._session = session
        self._playback = playback
        panel = gui.add_panel()
        with panel.add_tab("Curves"):
            self.charts = charts = Charts(server, session, playback, reach_of(model), duration(model))
        panel.dock_left()
        panel.set_width(360)
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
        self._show_steps()  # a line that came later would push all else down
        self._saving = SaveControls(server, folder, self._target, session.save)
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
        """Show the model after an edit, and keep the choices that still fit."""
        self.charts.draw()
        self._show_steps()

    def _show_steps(self) -> None:
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
        """Show another model."""
        model = self._session.model
        self._section.min, self._section.max = span(model)
        self._section.value = span(model)
        self._seconds.value = duration(model)
        self._reach.value = reach_of(model)
        self._part.value = WHOLE
        self._part.options = (WHOLE, *_parts(model))
        self._saving.name(self._target)
        self.edited()
        self._playback.refresh()

    def picked(self, index: int, picked: Picked) -> str:
        """Choose the part that was clicked, and return its description, empty for meshes without parts."""
        cut_up = self._playback.scene.items[index].decomposition
        if cut_up is None:
            return ""
        part, joint = int(cut_up.part_of_face[picked.face]), int(cut_up.joint_of_face[picked.face])
        if index == self._session.index:  # the root has nothing that it could move against
            self._part.value = str(part) if str(part) in self._part.options else WHOLE
        return f", part {part}" if joint < 0 else f", joint {joint} of part {part}"

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
        self._frames.content = _line(f"frames {first} to {last}", "mixseq-section")

    @property
    def _time(self) -> float:
        """Current time of the model, in seconds."""
        model, playback = self._session.model, self._playback
        return min(model.start + playback.scene.elapsed(playback.frame), model.end)

    @property
    def _target(self) -> str:
        """Default file name of the model."""
        return f"{Path(self._playback.scene.items[self._session.index].name).stem}-edited.h5"


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
