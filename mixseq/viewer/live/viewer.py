"""The viewer: a guarded viser server with a scene, controls and threads, and scripts of ours in its page.

viser's ``add_html`` does not run scripts, but the document of an ``iframe`` does, and can add them to the page. They
send messages through a hidden text input, whose callback runs in order on viser's event loop.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from dataclasses import dataclass
from html import escape
from io import StringIO
from pathlib import Path
from typing import Any

from mixseq.errors import MissingExtraError, SettingsError
from mixseq.pictures.colours import SceneColours
from mixseq.runtime.progress import forward_warnings
from mixseq.viewer.export import chart_scripts, script, script_json
from mixseq.viewer.live.controls import Editor, PlayControls, ShowControls, notify_all
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.playback import Moment, Playback
from mixseq.viewer.session import Drawn, Message, Picked, Save, Session, message_of


def add_bridge(server: Any, heard: Callable[[Message], None]) -> None:
    """Add the scripts to the page of a server, at the current position of its controls."""
    line = server.gui.add_text("mixseq", "", visible=False)

    @line.on_update  # type: ignore[untyped-decorator]
    async def _(event: Any) -> None:
        message = message_of(line.value)
        if message is not None:
            heard(message)

    source = "\n".join([chart_scripts(), script("live_window.js"), script("live.js")])
    start = f"""<script>
const text = {script_json(source)};
if (!parent.mixseqLive) {{
  const script = parent.document.createElement("script");
  script.textContent = text;
  parent.document.head.append(script);
}}
parent.mixseqLive.connect({script_json(line._impl.uuid)});
</script>"""
    server.gui.add_html(f'<iframe style="display: none" title="mixseq" srcdoc="{escape(start)}"></iframe>')


def check_viser() -> None:
    """Raise MissingExtraError without viser."""
    try:
        import viser  # noqa: F401
    except ImportError:
        raise MissingExtraError(
            "the viewer needs viser, which is not installed; run: pip install 'mixseq[viewer]'"
        ) from None


@contextmanager
def served(host: str, wanted: int | None) -> Iterator[tuple[Any, str]]:
    """Run a server for the duration of the context; yields it, and its address with the token."""
    check_viser()
    import viser

    from mixseq.viewer.live.guard import Access, Guard

    port = free_port(host, wanted)
    guard = Guard(Access(host))
    with ExitStack() as stack:
        with redirect_stdout(StringIO()), guard.posted():  # viser has a greeting
            server = viser.ViserServer(host, port, label="mixseq", verbose=False)
            stack.callback(_stop, server)
        guard.unhook(server)
        server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(70, 95, 120))
        server.gui.set_panel_label("mixseq")
        yield server, guard.access.address


def _stop(server: Any) -> None:
    with redirect_stdout(StringIO()):
        server.stop()


FIRST_PORT, PORTS = 8080, 100
"""Range of ports in which a free one is searched."""


def free_port(host: str, wanted: int | None) -> int:
    """Return the wanted port, or by default the first free one."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in [wanted] if wanted is not None else range(FIRST_PORT, FIRST_PORT + PORTS):
        try:
            with socket.create_server((host, port), family=family):
                return port
        except OSError as error:
            if wanted is None and error.errno == errno.EADDRINUSE:
                continue
            why = str(error.strerror or error).partition(" (")[0]
            cure = (
                "give another --port"
                if error.errno in (errno.EADDRINUSE, errno.EACCES)
                else "give another --host"
            )
            raise SettingsError(f"cannot listen at {host}:{port}: {why}; {cure}") from None
    raise SettingsError(f"the ports {FIRST_PORT} to {FIRST_PORT + PORTS - 1} are all taken; give a --port")


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
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(300)
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
            self._editor.charts.draw()

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
            self._editor.charts.show(moment)

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
            self._stage.busy = False
            self.playback.drawn()
        elif self._editor is not None:
            self._editor.charts.heard(message)

    def _clicked(self, index: int, picked: Picked) -> None:
        items = self.playback.scene.items
        what = f"vertex {picked.vertex}, triangle {picked.face}"
        if self._editor is not None:
            what += self._editor.picked(index, picked)
        self._shown.picked(f"{items[index].name}: {what}" if len(items) > 1 else what)


@contextmanager
def run_viewer(colours: SceneColours, settings: ViewSettings, save: Save) -> Iterator[Viewer]:
    """Run a viewer in the background, for the duration of the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(served(settings.host, settings.port))
        running = Viewer(server, address, colours, settings, save, stack)
        # of threads of ours
        stack.enter_context(forward_warnings(lambda text: notify_all(server, "Please note", text)))
        yield running
