"""What there is where something can be edited: charts on the left, buttons and saving on the right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mixseq.viewing.live.charts import Charts
from mixseq.viewing.live.controls import SaveControls
from mixseq.viewing.live.editing import EditControls, duration, reach_of
from mixseq.viewing.messages import Message
from mixseq.viewing.picking import Picked
from mixseq.viewing.playback import Moment, Playback
from mixseq.viewing.session import Session


class Editor:
    """All controls that edit.

    Parameters
    ----------
    server : viser.ViserServer
        Where they are added.
    session : Session
        What is edited; it has a model.
    playback : Playback
        What is shown.
    folder : Path
        Where edited motions are saved.
    """

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
        """Show the model that came of an edit."""
        self._charts.draw()
        self._controls.edited()

    def chosen(self) -> None:
        """Show another model."""
        self._controls.chosen()
        self._charts.draw()
        self._saving.name(self._target)
        self._playback.refresh()

    def undone(self) -> None:
        """Draw the model again, over what a hand has done to its charts."""
        self._charts.draw()

    def show(self, moment: Moment) -> None:
        """Show what moment is seen."""
        self._charts.show(moment)

    def heard(self, message: Message) -> None:
        """Do what was done with the mouse in the charts."""
        self._charts.heard(message)

    def picked(self, index: int, picked: Picked) -> str:
        """Choose what was clicked, and tell in words what it was."""
        return self._controls.picked(index, picked)

    @property
    def _target(self) -> str:
        """Under which name the model is saved, if no other is typed."""
        return f"{Path(self._playback.scene.items[self._session.index].name).stem}-edited.h5"
