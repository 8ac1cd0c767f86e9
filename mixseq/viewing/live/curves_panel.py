"""The left panel: charts of the edited model, with dragging, drawing and retiming by mouse."""

from __future__ import annotations

from functools import partial
from threading import Lock
from typing import Any

from mixseq.errors import SettingsError
from mixseq.operations import drag, sketch
from mixseq.signals import Model
from mixseq.signals.mds_embedding import Plane
from mixseq.viewing.chart_data import signals_of
from mixseq.viewing.messages import Drag, Message, Retime, Seek, Sketch
from mixseq.viewing.playback import Moment, Playback
from mixseq.viewing.session import Session
from mixseq.viewing.template import script_json


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
                (session.edit if done else session.preview)("drag", edit)
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
        model.known(plane)
    except SettingsError:
        return False
    return True
