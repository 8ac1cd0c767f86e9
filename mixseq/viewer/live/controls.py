"""Panels beside the scene: playback, display, editing and saving on the right, charts of a model on the left."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from html import escape
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from mixseq.errors import SettingsError
from mixseq.mesh.nearest import RayHit
from mixseq.operations.filters import exaggerate
from mixseq.operations.limbs import exaggerate_part, hold
from mixseq.operations.sketch import default_reach, drag, sketch
from mixseq.operations.timeline import cut, loop, repeat, reverse
from mixseq.pictures.charts import chart_data
from mixseq.pictures.colours import Colouring, SceneColours
from mixseq.pictures.scene import model_times
from mixseq.signals.model import Model
from mixseq.signals.pose import Plane
from mixseq.spaces.mixed.mixed_space import MixedSpace
from mixseq.types import Float
from mixseq.viewer.live.stage import PICK_COLOUR, LiveStage
from mixseq.viewer.page import script_json
from mixseq.viewer.playback import Moment, Playback
from mixseq.viewer.posing import PoseTool
from mixseq.viewer.session import Drag, Edit, Mark, Message, Play, Retime, Seek, Session, Sketch, Transport

SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}

SIDE_BY_SIDE, OVERLAID = "side by side", "in one place"


class PlayControls:
    """The time line of the page, speed and frame rate."""

    def __init__(self, server: Any, playback: Playback, index: int) -> None:
        gui = server.gui
        self._playback = playback
        self._start = float(playback.scene.items[index].header.times[0])  # of the mesh whose times are shown
        self._line = gui.add_html("")
        with gui.add_folder("Play"):
            speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
            self._rate = gui.add_number("Frames/s", playback.scene.fps, min=1e-3, max=1e4, hint="Playback frame rate")
        speed.on_update(lambda _: playback.set_speed(SPEEDS[speed.value]))
        self._rate.on_update(self._set_rate)
        for label, key, step in (("Next frame", "]", 1), ("Previous frame", "[", -1)):
            gui.add_command(label, hotkey=key).on_trigger(lambda _, by=step: self._step(by))
        gui.add_command("Play or pause", hotkey="P").on_trigger(lambda _: self.handle(Play(on=not playback.is_playing)))

    def handle(self, message: Transport) -> None:
        """Follow the time line of a page."""
        playback, frame_at = self._playback, self._playback.scene.frame_at
        match message:
            case Seek(time):
                playback.seek(frame_at(time - self._start))
            case Mark(start, end):
                playback.set_section(*sorted(frame_at(time - self._start) for time in (start, end)))
            case Play(on, loop):
                if loop is not None:
                    playback.set_loop(loop)
                if on is not None:
                    (playback.play if on else playback.pause)()
        playback.refresh()

    def show(self, moment: Moment, index: int, pen: bool) -> None:
        """Show the time of a moment in the times of the mesh `index`, and whether the mouse draws curves."""
        scene, header = moment.scene, moment.scene.items[index].header
        self._start = start = float(header.times[0])
        state = {
            "start": start,
            "end": start + scene.elapsed(scene.count - 1),
            "fps": header.fps,
            "rate": scene.fps,
            "time": start + scene.elapsed(moment.frame),
            "section": [start + scene.elapsed(min(frame, scene.count - 1)) for frame in self._playback.section],
            "playing": self._playback.is_playing,
            "loop": self._playback.is_looping,
            "pen": pen,
        }
        self._line.content = f'<span id="mixseq-now" data-state="{escape(script_json(state))}" hidden></span>'

    def _step(self, by: int) -> None:
        self._playback.pause()
        self._playback.seek((self._playback.frame + by) % self._playback.scene.count)

    def _set_rate(self, event: Any) -> None:
        if event.client is None:
            return
        try:
            self._playback.set_frame_rate(float(self._rate.value))
        except SettingsError:  # also raised for incompletely typed numbers
            notify(event.client, "Frames/s", f"{self._rate.value:g} is out of range; enter another frame rate")


class DisplayControls:
    """Controls of colours, arrangement and visibility of meshes."""

    def __init__(self, server: Any, playback: Playback, stage: LiveStage, colours: SceneColours) -> None:
        gui, names = server.gui, [item.name for item in playback.scene.items]
        self._stage = stage
        with gui.add_folder("Show"):
            self._colour = gui.add_dropdown("Colour", colours.names)
            self._legend = gui.add_html(_legend(stage.colours))
            wireframe = gui.add_checkbox("Wireframe", False)
            follow = gui.add_checkbox("Follow", stage.following, hint="Follow bodies that travel")
            if len(names) > 1:
                initial = OVERLAID if stage.overlaid else SIDE_BY_SIDE
                arrangement = gui.add_dropdown("Meshes", (SIDE_BY_SIDE, OVERLAID), initial_value=initial)
                arrangement.on_update(lambda _: self._arrange(playback, arrangement.value == SIDE_BY_SIDE))
                for index, name in enumerate(names):
                    box = gui.add_checkbox(name, True)
                    box.on_update(lambda _, index=index, box=box: stage.set_visible(index, box.value))
            self._picked = gui.add_html(_text_line("Click a mesh for its vertex and part", "mixseq-picked"))
        self._colour.on_update(lambda event: self._set_colour(event, playback))
        wireframe.on_update(lambda _: stage.set_wireframe(wireframe.value))
        follow.on_update(lambda _: self._follow(playback, follow.value))

    def show_picked(self, text: str) -> None:
        """Show a text that describes the picked mesh element."""
        self._picked.content = _text_line(text, "mixseq-picked")

    def _follow(self, playback: Playback, on: bool) -> None:
        self._stage.following = on
        playback.refresh()

    def _arrange(self, playback: Playback, side_by_side: bool) -> None:
        self._stage.arrange(playback.scene, side_by_side)
        playback.refresh()

    def _set_colour(self, event: Any, playback: Playback) -> None:
        if event.client is not None:
            self._stage.set_colour(self._colour.value)
            self._legend.content = _legend(self._stage.colours)
            playback.refresh()


def _legend(colourings: list[Colouring]) -> str:
    """Return the colour scale in HTML, as a bar labelled with the values at its ends."""
    measured = next((colouring for colouring in colourings if not colouring.is_constant), None)
    if measured is None:
        return ""
    stops = ", ".join(f"rgb({r} {g} {b})" for r, g, b in measured.palette[::15])
    bar = f'<div style="height: 10px; border-radius: 3px; background: linear-gradient(to right, {stops})"></div>'
    low, top = f"<span>{measured.low:.3g}</span>", f"<span>{measured.top:.3g} {escape(measured.unit)}</span>"
    ends = f'<div style="display: flex; justify-content: space-between">{low}{top}</div>'
    return f'<div id="mixseq-legend" style="padding: 2px 12px; font-size: 12px">{bar}{ends}</div>'


def _text_line(text: str, name: str) -> str:
    return f'<div id="{name}" style="padding: 0 12px; font-size: 12px; opacity: 0.75">{escape(text)}</div>'


def notify(client: Any, title: str, text: str, is_success: bool = False) -> None:
    """Show a notification on a page for a few seconds."""
    client.add_notification(title, text, auto_close_seconds=6.0, color="teal" if is_success else "red")


def notify_all(server: Any, title: str, text: str, is_success: bool = False) -> None:
    """Show a notification on all pages."""
    for client in server.get_clients().values():
        notify(client, title, text, is_success)


class SaveControls:
    """Controls that save edits in the folder where the viewer was started."""

    def __init__(self, server: Any, folder: Path, name: str, save: Callable[[Path, bool], None]) -> None:
        gui = server.gui
        self._folder = folder
        self._save = save
        with gui.add_folder("Save"):
            self._name = gui.add_text(
                "File",
                name,
                hint=f"A model (.h5), a sequence in any format, or a script of the edits (.toml), in {folder}",
            )
            self._replace = gui.add_checkbox("Replace", False, hint="Replace an existing file")
            self._button = gui.add_button("Save")
        self._button.on_click(self._clicked)

    def set_name(self, name: str) -> None:
        """Set the proposed file name."""
        self._name.value = name

    def _clicked(self, event: Any) -> None:
        name = self._name.value.strip()
        path = self._folder / name
        # pages must not write outside the folder
        if not _is_file_name(name):
            notify(
                event.client,
                "Not saved",
                f"{name!r} is not a plain file name; enter a name without folders, it is saved in {self._folder}",
            )
        else:
            self._save(path, bool(self._replace.value))


def _is_file_name(name: str) -> bool:
    """Whether a text is a valid file name without folders on all operating systems."""
    has_no_path = name not in ("", ".", "..") and not any(separator in name for separator in "/\\:")
    # file systems allow 255 bytes, and writers temporarily add a suffix
    return has_no_path and name.isprintable() and len(name.encode(errors="replace")) <= 200


class Charts:
    """Charts of the time curve, its coefficients, and the keys of a retiming."""

    def __init__(self, server: Any, session: Session, playback: Playback, reach: float, seconds: float) -> None:
        gui = server.gui
        self._session = session
        self._playback = playback
        self._lock = Lock()
        self._planes: dict[int, Plane] = {}
        self._version = 0
        self.is_drawing = False  # whether the mouse draws new curves
        self._reach = reach
        self._seconds = seconds
        height = "height: calc(100vh - 88px - var(--timeline, 0px)); min-height: 420px"
        gui.add_html(f'<div id="mixseq-charts" style="{height}"></div>')
        self._signals = gui.add_html("")
        self.draw()

    def draw(self) -> None:
        """Send the chart data of the edited model to the page."""
        with self._lock:  # so that the newest model is sent last
            self._version += 1
            history = self._session.history
            data = chart_data(self._session.model, self._plane) | {"reach": self._reach}
            if keys := history.current.keys:  # the keys can still be moved
                source = history.undo().current.model
                data |= {"keys": keys, "source": [source.start, source.end]}
            self._signals.content = (
                f'<script type="application/json" id="mixseq-signals" data-version="{self._version}">'
                f"{script_json(data)}</script>"
            )

    def set_pen(self, on: bool) -> None:
        """Set whether the mouse draws new curves (`on`) or drags existing curves."""
        self.is_drawing = on
        self._playback.refresh()

    def set_reach(self, seconds: float) -> None:
        """Set the reach of drags, in seconds."""
        self._reach = seconds
        self.draw()

    def set_duration(self, seconds: float) -> None:
        """Set the duration of drawn curves."""
        self._seconds = seconds

    def handle(self, message: Message) -> None:
        """Apply a user action that the charts sent as a message."""
        session, scene = self._session, self._playback.scene
        match message:
            case Drag(time, to, done):
                if not self._playback.is_playing:  # show the dragged frame
                    self._playback.seek(scene.frame_at(time - session.model.start))
                edit = partial(drag, time=time, to=to, reach=self._reach, plane=self._plane)
                session.edit("drag", edit, preview=not done)
            case Sketch(points):
                edit = partial(sketch, curve=points, duration=self._seconds, plane=self._plane)
                session.edit("sketch", edit)
            case Retime(keys, done):
                session.retime(keys, preview=not done)

    @property
    def _plane(self) -> Plane:
        """Plane of the drawn embedding, kept after an edit if possible, so that the chart does not rotate."""
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


HANDLE_COLOUR = (230, 120, 0)


class PoseControls:
    """Controls that pose the edited model by dragging its mesh."""

    def __init__(
        self, server: Any, session: Session, playback: Playback, stage: LiveStage, fade: Callable[[], float]
    ) -> None:
        gui = server.gui
        self._server, self._session, self._playback, self._stage, self._fade = server, session, playback, stage, fade
        self._tool = PoseTool(session)
        self._on = gui.add_checkbox("Pose", False, hint="Drag points of the mesh; a click pins one. Enter applies")
        self._exact = gui.add_checkbox("Exact", False, visible=False, hint="Deform the mesh where poses do not reach")
        self._buttons = gui.add_button_group("Pose", ("Apply", "Cancel"), visible=False)
        self._text = gui.add_html("", visible=False)
        self.is_on = False  # whether the mouse poses the mesh
        self._on.on_update(lambda _: self.set_on(bool(self._on.value)))
        self._exact.on_update(lambda _: self._tool.set_exact(self._exact.value))
        self._buttons.on_click(lambda _: self._apply() if self._buttons.value == "Apply" else self.cancel())
        gui.add_command("Apply pose", hotkey="enter").on_trigger(lambda _: self._apply())
        gui.add_command("Cancel pose", hotkey="escape").on_trigger(lambda _: self.cancel())

    def set_on(self, is_on: bool) -> None:
        """Pose the mesh by dragging (`is_on`), or turn the camera, and cancel the pose."""
        if is_on == self.is_on:
            return
        if is_on:
            try:
                self._tool.check()
            except SettingsError as error:
                self._on.value = False
                notify_all(self._server, "Pose: not done", str(error))
                return
        self._on.value = self.is_on = is_on
        self.cancel()
        for control in (self._exact, self._buttons, self._text):
            control.visible = is_on
        self._stage.set_dragging(self._drag if is_on else None)

    def click(self, vertex: int) -> None:
        """Pin a vertex, or remove its pin or handle."""
        self._tool.toggle(vertex)
        self._show_handles()

    def cancel(self) -> bool:
        """Remove all handles and pins; return False if there are none."""
        is_pending = self._tool.cancel()
        self._show_handles()
        return is_pending

    def show(self) -> None:
        """Show the pending pose again, after the session has shown something else."""
        self._tool.show()

    def _apply(self) -> None:
        self._tool.apply(self._fade())
        self._show_handles()

    def _drag(self, index: int, vertex: int, target: Float) -> bool:
        if index != self._session.index:
            return False
        self._playback.pause()
        elapsed = np.array([self._playback.scene.elapsed(self._playback.frame)])
        try:
            self._tool.drag(vertex, target, float(model_times(self._session.model.header, elapsed)[0]))
        except SettingsError as error:
            notify_all(self._server, "Pose: not done", str(error))
            return False
        self._show_handles()
        return True

    def _show_handles(self) -> None:
        pending = self._tool.pending
        self._text.content = _text_line(f"{pending}" or "Drag the mesh, or click it to pin a point", "mixseq-pose")
        colours = {
            vertex: PICK_COLOUR if target is None else HANDLE_COLOUR for vertex, target in pending.targets.items()
        }
        self._stage.set_handles(self._session.index, colours, self.click)


WHOLE_BODY = "whole body"

MIN_DURATION = 1e-3
"""Smallest duration that controls allow, in seconds."""


class Editor:
    """Editing controls: charts, undo, sections, parts and saving."""

    def __init__(self, server: Any, session: Session, playback: Playback, stage: LiveStage, folder: Path) -> None:
        gui, model = server.gui, session.model
        self._session = session
        self._playback = playback
        panel = gui.add_panel()
        with panel.add_tab("Curves"):
            self.charts = charts = Charts(server, session, playback, reach_of(model), duration(model))
        panel.dock_left()
        panel.set_width(360)
        with gui.add_folder("Edit"):
            if len(session.editable_ids) > 1:
                names = {playback.scene.items[index].name: index for index in session.editable_ids}
                which = gui.add_dropdown("Model", tuple(names))
                which.on_update(lambda _: self._select(names[which.value]))
            self._undo = gui.add_button_group("Steps", ("Undo", "Redo"))
            self._steps = gui.add_html("")
            pen = gui.add_checkbox("Pen", False, hint="Draw a new curve (or drag with shift)")
            self.posing = PoseControls(server, session, playback, stage, lambda: float(self._reach.value))
            self._seconds = gui.add_number("Draw for (s)", duration(model), min=MIN_DURATION, step=0.05)
            self._reach = gui.add_number(
                "Drag over (s)",
                reach_of(model),
                min=MIN_DURATION,
                step=0.01,
                hint="Time before and after the point within which the curve follows it, and poses fade",
            )
            self._times = gui.add_number(
                "Times", 2, min=1, max=100, step=1, hint="Repetitions of the section between the marks in and out"
            )
            sections = gui.add_button_group("", ("Repeat", "Cut", "Loop", "Reverse"))
            self._part = gui.add_dropdown("Part", (WHOLE_BODY, *_parts(model)), hint="Or click a part of the mesh")
            self._gain = gui.add_number("Gain", 1.5, min=-10.0, max=10.0, step=0.1)
            parts = gui.add_button_group("", ("Exaggerate", "Hold"))
        self._show_steps()  # a line that is added later would move the controls below it
        self._save_controls = SaveControls(server, folder, self._default_name, session.save)
        self._undo.on_click(lambda _: self._undo_step() if self._undo.value == "Undo" else session.redo())
        pen.on_update(lambda _: charts.set_pen(pen.value))
        self._seconds.on_update(lambda _: charts.set_duration(float(self._seconds.value)))
        self._reach.on_update(lambda _: charts.set_reach(float(self._reach.value)))
        sections.on_click(lambda _: self._edit_section(sections.value))
        parts.on_click(lambda event: self._edit_part(parts.value, event.client))
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda _: self._undo_step())
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda _: session.redo())

    def show_edit(self) -> None:
        """Show the model after an edit, and keep the settings that are still valid."""
        self.charts.draw()
        self._show_steps()
        self.posing.show()

    def _select(self, index: int) -> None:
        self.posing.set_on(False)
        self._session.select(index)

    def _undo_step(self) -> None:
        """Undo the pose that is not applied yet, or the last step."""
        if not self.posing.cancel():
            self._session.undo()

    def _show_steps(self) -> None:
        history = self._session.history
        position = f"{history.index} of {len(history.states) - 1} steps"
        last = f": {history.current.name}" if history.index else ""
        self._steps.content = f'<div id="mixseq-steps" style="padding: 0 12px; font-size: 12px">{position}{last}</div>'

    def show_selected(self) -> None:
        """Show the controls of another model."""
        model = self._session.model
        self._seconds.value = duration(model)
        self._reach.value = reach_of(model)
        self._part.value = WHOLE_BODY
        self._part.options = (WHOLE_BODY, *_parts(model))
        self._save_controls.set_name(self._default_name)
        self.show_edit()
        self._playback.refresh()

    def select_part(self, index: int, hit: RayHit) -> str:
        """Select the clicked part, and return its description, which is empty for a mesh without parts."""
        decomposition = self._playback.scene.items[index].decomposition
        if decomposition is None:
            return ""
        part, joint = int(decomposition.part_of_face[hit.face]), int(decomposition.joint_of_face[hit.face])
        if index == self._session.index:  # the root part has no parent and cannot be selected
            self._part.value = str(part) if str(part) in self._part.options else WHOLE_BODY
        return f", part {part}" if joint < 0 else f", joint {joint} of part {part}"

    def _edit_section(self, name: str) -> None:
        start, end = self._section_times
        edits: dict[str, Edit] = {
            "Repeat": partial(repeat, start=start, end=end, times=int(self._times.value)),
            "Cut": partial(cut, start=start, end=end),
            "Loop": loop,
            "Reverse": reverse,
        }
        self._session.edit(name.lower(), edits[name])

    def _edit_part(self, name: str, client: Any) -> None:
        part, gain = self._part.value, float(self._gain.value)
        if name == "Exaggerate" and part == WHOLE_BODY:
            self._session.edit("exaggerate", partial(exaggerate, gain=gain))
        elif name == "Exaggerate":
            self._session.edit("exaggerate part", partial(exaggerate_part, part=int(part), gain=gain))
        elif part == WHOLE_BODY:
            text = (
                "the whole body cannot be held; click a part of the mesh, or choose one under Part. To freeze the "
                "whole body, drag keys of the retiming"
            )
            notify(client, "Hold: not done", text)
        else:
            start, end = self._section_times
            model, playback = self._session.model, self._playback
            time = min(model.start + playback.scene.elapsed(playback.frame), model.end)
            self._session.edit("hold", partial(hold, part=int(part), time=time, start=start, end=end))

    @property
    def _section_times(self) -> tuple[float, float]:
        """Start and end of the section in seconds of the model."""
        model, playback = self._session.model, self._playback
        scene, (first, last) = playback.scene, playback.section
        end = model.end if last == scene.count - 1 else min(model.start + scene.elapsed(last), model.end)
        return min(model.start + scene.elapsed(first), model.end), end

    @property
    def _default_name(self) -> str:
        """Default file name of the model."""
        return f"{Path(self._playback.scene.items[self._session.index].name).stem}-edited.h5"


def duration(model: Model) -> float:
    """Return the duration of a model in seconds, at least one frame, rounded up to steps of the controls."""
    seconds = max(model.end - model.start, 1 / model.header.fps, MIN_DURATION)
    return float(np.ceil(seconds / MIN_DURATION - 1e-6) * MIN_DURATION)


def reach_of(model: Model) -> float:
    """Return the default reach of drags, in seconds."""
    return max(round(default_reach(model), 3), MIN_DURATION)


def _parts(model: Model) -> tuple[str, ...]:
    """Return the numbers of the parts that can be edited individually, which are those with a parent."""
    if not isinstance(model.space, MixedSpace) or model.space.placement == "free":
        return ()
    return tuple(str(part) for part in np.flatnonzero(model.space.articulation.parents >= 0))
