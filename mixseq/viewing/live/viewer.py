"""The viewer: server, scene, controls, and their threads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mixseq.scene.colours import SceneColours
from mixseq.viewing.live.bridge import add_bridge
from mixseq.viewing.live.controls import PlayControls, ShowControls, notify_all
from mixseq.viewing.live.editing import Editor
from mixseq.viewing.live.server import served
from mixseq.viewing.live.stage import LiveStage
from mixseq.viewing.messages import Drawn, Message
from mixseq.viewing.picking import Picked
from mixseq.viewing.playback import Moment, Playback
from mixseq.viewing.session import Save, Session
from mixseq.warned import warnings_heard


@dataclass(frozen=True)
class ViewSettings:
    """The settings of the viewer."""

    host: str = "127.0.0.1"  # listening address; 127.0.0.1 is this machine only
    port: int | None = None  # port, by default 8080 or the next free one
    folder: Path = Path()  # folder of saved motions
    threads: int = 2  # number of decoding threads
    material: str = "standard"  # or "toon5", for machines without a graphics card
    overlaid: bool = False  # whether meshes initially stand in one place, instead of side by side
    read_only: bool = False  # whether controls for editing and saving are left out
    # Initial view: degrees from the front of the first mesh, to its left, and above the horizon.
    camera: tuple[float, float] | None = None
    following: bool = False  # whether bodies that travel initially stay in the middle


class Viewer:
    """A running viewer; make it with `viewer`."""

    def __init__(
        self,
        server: Any,
        address: str,
        colours: SceneColours,
        settings: ViewSettings,
        save: Save,
        stack: ExitStack,
    ) -> None:
        self._server = server
        self._play: PlayControls | None = None  # the first frame may be there before they are
        self._editor: Editor | None = None
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(70, 95, 120))
        gui.set_panel_label("mixseq")
        self._stage = LiveStage(
            server,
            colours,
            settings.material,
            settings.overlaid,
            self._show,
            settings.camera,
            settings.following,
        )
        self.playback = stack.enter_context(
            Playback(colours.scene, self._stage, self._failed, threads=settings.threads)
        )
        self.session = stack.enter_context(Session(self.playback, self, save))
        add_bridge(server, self._heard)
        self._play = PlayControls(server, self.playback, self._index)
        self._shown = ShowControls(server, self.playback, self._stage, colours)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(300)
        if self.session.editable and not settings.read_only:
            self._editor = Editor(server, self.session, self.playback, settings.folder)
        self._stage.on_click(self._clicked)
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._disconnected)
        self.address = address

    # What the session tells -----------------------------------------------------------------------------

    def edited(self, session: Session) -> None:
        """Show the edited model."""
        if self._editor is not None:
            self._editor.edited()

    def chosen(self, session: Session) -> None:
        """Show the chosen model."""
        if self._editor is not None:
            self._editor.chosen()

    def failed(self, what: str, error: Exception) -> None:
        """Show an error on all pages, and draw the current model."""
        notify_all(self._server, f"{what}: not done", str(error))
        if self._editor is not None:
            self._editor.undone()

    def saved(self, what: str) -> None:
        """Notify all pages of a saved file."""
        notify_all(self._server, "Saved", what, good=True)

    @property
    def _index(self) -> int:
        """The mesh of the displayed times: the edited model, or the first mesh."""
        return max(self.session.index, 0)

    # What the playback tells ----------------------------------------------------------------------------

    def _show(self, moment: Moment) -> None:
        if self._play is not None:
            self._play.show(moment, self._index)
        if self._editor is not None:
            self._editor.show(moment)

    def _failed(self, error: Exception) -> None:
        if self._play is not None:
            self._play.refresh()
        notify_all(self._server, "This frame cannot be shown", str(error))

    # What the page tells --------------------------------------------------------------------------------

    def _connected(self, client: Any) -> None:
        self._stage.welcome(client)
        self.playback.refresh()

    def _disconnected(self, client: Any) -> None:
        self._stage.forget(client)
        self.session.settle()  # a hand may have been dragging

    def _heard(self, message: Message) -> None:
        if isinstance(message, Drawn):
            self._stage.drawn()
            self.playback.drawn()
        elif self._editor is not None:
            self._editor.heard(message)

    def _clicked(self, index: int, picked: Picked) -> None:
        name = self.playback.scene.items[index].name
        what = f"vertex {picked.vertex}, triangle {picked.face}"
        if self._editor is not None:
            what = self._editor.picked(index, picked)
        self._shown.picked(f"{name}: {what}" if len(self.playback.scene.items) > 1 else what)


@contextmanager
def viewer(colours: SceneColours, settings: ViewSettings, save: Save) -> Iterator[Viewer]:
    """Run a viewer in the background, for the duration of the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(served(settings.host, settings.port))
        running = Viewer(server, address, colours, settings, save, stack)
        stack.enter_context(
            warnings_heard(lambda text: notify_all(server, "Please note", text))
        )  # of threads of ours
        yield running
