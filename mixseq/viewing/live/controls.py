"""The right panel: playback, display, and saving."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from math import ceil, floor
from pathlib import Path
from time import monotonic
from typing import Any

from mixseq.errors import SettingsError
from mixseq.frame_numbers import frame_text, number_at, time_of
from mixseq.scene.colouring import Colouring
from mixseq.scene.colours import SceneColours
from mixseq.scene.items import Scene
from mixseq.viewing.live.stage import LiveStage
from mixseq.viewing.playback import Moment, Playback

SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
HAND = 0.5
"""Seconds for which a moved slider keeps its value, as the display lags behind."""

DIGITS = 3
"""Decimals of fractional frame numbers."""

LONGEST_NAME = 200
"""Longest file name in bytes: folders allow 255, and writers temporarily add some letters."""

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
        self._icons = _icons()
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
                    self._add_switch(gui, index, name)
            self._picked = gui.add_html(_line("Click a mesh for its vertex and part", "mixseq-picked"))
        self._colour.on_update(lambda event: self._paint(event, playback))
        wire.on_update(lambda _: stage.wire(wire.value))
        follow.on_update(lambda _: self._follow(playback, follow.value))

    def picked(self, text: str) -> None:
        """Show the picked mesh element."""
        self._picked.content = _line(text, "mixseq-picked")

    def _add_switch(self, gui: Any, index: int, name: str) -> None:
        switch = gui.add_checkbox(name, True)
        switch.on_update(lambda _: self._stage.hide(index, not switch.value))

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


def notify(client: Any, title: str, text: str, good: bool = False) -> None:
    """Show a notification on a page for some seconds."""
    client.add_notification(title, text, auto_close_seconds=6.0, color="teal" if good else "red")


def notify_all(server: Any, title: str, text: str, good: bool = False) -> None:
    """Show a notification on all pages."""
    for client in server.get_clients().values():
        notify(client, title, text, good)


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


def _icons() -> tuple[Any, Any]:
    return _icon("PLAYER_PLAY"), _icon("PLAYER_PAUSE")


def _icon(name: str) -> Any:
    from viser import Icon

    return getattr(Icon, name)
