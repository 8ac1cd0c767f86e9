"""Run the viewer: a guarded viser server with a scene, controls, background threads and scripts added to its page.

viser's ``add_html`` does not run scripts, so an ``iframe`` runs a script that adds the other scripts to the page. The
scripts send messages through a hidden text input, whose callback runs in order on viser's event loop.
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from html import escape
from io import StringIO
from typing import Any

from mixseq.errors import SettingsError
from mixseq.mesh.nearest import RayHit
from mixseq.pictures.colours import SceneColours
from mixseq.runtime.progress import forward_warnings
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.controls import DisplayControls, Editor, PlayControls, notify_all
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.page import chart_scripts, read_script, script_json
from mixseq.viewer.playback import Moment, Playback
from mixseq.viewer.session import Drawn, Message, Save, Session, Transport, parse_message


def add_bridge(server: Any, on_message: Callable[[Message], None]) -> None:
    """Add the scripts to the page of a server, and set the function that is called with their messages."""
    text_input = server.gui.add_text("mixseq", "", visible=False)

    @text_input.on_update  # type: ignore[untyped-decorator]
    async def _(event: Any) -> None:
        message = parse_message(text_input.value)
        if message is not None:
            on_message(message)

    source = "\n".join([chart_scripts(), *map(read_script, ("timeline.js", "live_window.js", "live.js"))])
    document = f"""<script>
const text = {script_json(source)};
if (!parent.mixseqLive) {{
  const script = parent.document.createElement("script");
  script.textContent = text;
  parent.document.head.append(script);
}}
parent.mixseqLive.connect({script_json(text_input._impl.uuid)});
</script>"""
    server.gui.add_html(f'<iframe style="display: none" title="mixseq" srcdoc="{escape(document)}"></iframe>')


@contextmanager
def run_server(host: str, requested_port: int | None) -> Iterator[tuple[Any, str]]:
    """Run a server during the context; yield the server and its address, which contains the token."""
    import viser

    from mixseq.viewer.live.guard import Access, Guard

    port = find_port(host, requested_port)
    guard = Guard(Access(host))
    with ExitStack() as stack:
        with redirect_stdout(StringIO()), guard.guard_new_server():  # viser prints a greeting
            server = viser.ViserServer(host, port, label="mixseq", verbose=False)
            stack.callback(_stop, server)
        guard.attach(server)
        server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(40, 82, 112))
        server.gui.set_panel_label("mixseq")
        yield server, guard.access.address


def _stop(server: Any) -> None:
    with redirect_stdout(StringIO()):
        server.stop()


def find_port(host: str, requested: int | None) -> int:
    """Return the requested port, by default the first free port; raise SettingsError if the port cannot be used."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in [requested] if requested is not None else range(8080, 8180):
        try:
            with socket.create_server((host, port), family=family):
                return port
        except OSError as error:
            if requested is None and error.errno == errno.EADDRINUSE:
                continue
            reason = str(error.strerror or error).partition(" (")[0]
            cure = "give another --port" if error.errno in (errno.EADDRINUSE, errno.EACCES) else "give another --host"
            raise SettingsError(f"cannot listen at {host}:{port}: {reason}; {cure}") from None
    raise SettingsError("the ports 8080 to 8179 are all taken; give a --port")


class Viewer:
    """A running viewer, started by `run_viewer`."""

    def __init__(
        self, server: Any, address: str, colours: SceneColours, settings: ViewSettings, save: Save, stack: ExitStack
    ) -> None:
        self._server = server
        self._play: PlayControls | None = None  # a frame may be shown before the controls exist
        self._editor: Editor | None = None
        self._stage = LiveStage(server, colours, settings, self._on_show)
        self.playback = stack.enter_context(
            Playback(colours.scene, self._stage, self._on_playback_failure, threads=settings.threads)
        )
        self.session = stack.enter_context(Session(self.playback, self, save))
        add_bridge(server, self._on_message)
        self._play = PlayControls(server, self.playback, self._index)
        self._display = DisplayControls(server, self.playback, self._stage, colours)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(300)
        if self.session.editable_ids and not settings.read_only:
            self._editor = Editor(server, self.session, self.playback, self._stage, settings.folder)
        self._stage.on_click(self._on_click)
        server.on_client_connect(self._on_connect)
        server.on_client_disconnect(self._on_disconnect)
        self.address = address

    # Callbacks of the session ---------------------------------------------------------------------------

    def on_edit(self, session: Session) -> None:
        """Show the edited model."""
        if self._editor is not None:
            self._editor.show_edit()

    def on_select(self, session: Session) -> None:
        """Show the selected model."""
        if self._editor is not None:
            self._editor.show_selected()

    def on_failure(self, action: str, error: Exception) -> None:
        """Show an error on all pages, and the charts of the current model."""
        notify_all(self._server, f"{action}: not done", str(error))
        if self._editor is not None:
            self._editor.charts.draw()
            self._editor.posing.show()

    def on_save(self, message: str) -> None:
        """Notify all pages of a saved file."""
        notify_all(self._server, "Saved", message, is_success=True)

    @property
    def _index(self) -> int:
        """Index of the mesh whose times are displayed: the edited model, or the first mesh."""
        return max(self.session.index, 0)

    # Callbacks of the playback --------------------------------------------------------------------------

    def _on_show(self, moment: Moment) -> None:
        if self._play is not None:
            self._play.show(moment, self._index, self._editor is not None and self._editor.charts.is_drawing)

    def _on_playback_failure(self, error: Exception) -> None:
        notify_all(self._server, "This frame cannot be shown", str(error))

    # Callbacks of the page ------------------------------------------------------------------------------

    def _on_connect(self, client: Any) -> None:
        self._stage.add_client(client)
        self.playback.refresh()

    def _on_disconnect(self, client: Any) -> None:
        self._stage.remove_client(client)
        self.session.discard_preview()  # the page cannot end its drag any more
        if self._editor is not None:
            self._editor.posing.show()

    def _on_message(self, message: Message) -> None:
        if isinstance(message, Drawn):
            self._stage.is_busy = False
            self.playback.wake()
        elif isinstance(message, Transport):
            assert self._play is not None  # made before a page is connected
            self._play.handle(message)
        elif self._editor is not None:
            self._editor.charts.handle(message)

    def _on_click(self, index: int, hit: RayHit) -> None:
        items = self.playback.scene.items
        text = f"vertex {hit.vertex}, triangle {hit.face}"
        if self._editor is not None and self._editor.posing.is_on and index == self.session.index:
            self._editor.posing.click(hit.vertex)
        elif self._editor is not None:
            text += self._editor.select_part(index, hit)
        self._display.show_picked(f"{items[index].name}: {text}" if len(items) > 1 else text)


@contextmanager
def run_viewer(colours: SceneColours, settings: ViewSettings, save: Save) -> Iterator[Viewer]:
    """Run a viewer in the background during the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(run_server(settings.host, settings.port))
        running = Viewer(server, address, colours, settings, save, stack)
        # warnings of background threads
        stack.enter_context(forward_warnings(lambda text: notify_all(server, "Warning", text)))
        yield running
