"""The viewer for markers: two meshes at rest, side by side, whose points are clicked in pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from mixseq.correspondence.markers import Markers
from mixseq.frame_store import frame_store
from mixseq.scene.colours import SceneColours
from mixseq.scene.items import Scene, SceneItem
from mixseq.sequence import MeshSequence
from mixseq.topology import Topology
from mixseq.viewing.live.bridge import add_bridge
from mixseq.viewing.live.controls import notify_all
from mixseq.viewing.live.marking_controls import VIEWS, MarkingControls
from mixseq.viewing.live.marking_stage import MarkingStage, balls
from mixseq.viewing.live.server import served
from mixseq.viewing.live.stage import LiveStage
from mixseq.viewing.live.viewer import ViewSettings
from mixseq.viewing.marking import SOURCE, TARGET
from mixseq.viewing.marking_session import MarkingSession
from mixseq.viewing.messages import Drawn, Message
from mixseq.viewing.playback import Playback

TURNED = 2.0
"""Degrees of camera rotation after which the meshes follow."""

BETWEEN = 0.25
"""Distance of the target from a mesh beyond which none is looked at, relative to the distance of both."""

STEEP = 0.05
"""Tangent of the angle to the vertical below which the azimuth of the view is undefined."""

SaveMarkers = Callable[[Markers], str]
"""Writes markers to the file given at start, and returns a sentence about it."""


@dataclass(frozen=True, eq=False)
class MarkedMeshes:
    """The meshes to be marked."""

    source: MeshSequence  # source at rest, in its first frame
    target: MeshSequence  # target at rest, in its first frame
    names: tuple[str, str]  # names of the meshes
    markers: Markers  # initial markers
    file: str  # name of the file to save to

    @property
    def scene(self) -> Scene:
        """Both meshes at rest, scaled to one size."""
        items = []
        for name, mesh in zip(self.names, (self.source, self.target), strict=True):
            points = np.asarray(mesh.points[:1], np.float64)
            size = float(np.linalg.norm(np.ptp(points[0], axis=0))) or 1.0
            still = MeshSequence.from_header(mesh.header.with_times([0.0]), points / size)
            items.append(SceneItem(name, frame_store(still)))
        return Scene(tuple(items))


class MarkingViewer:
    """A running viewer for markers; make it with `marking_viewer`."""

    def __init__(
        self,
        server: Any,
        address: str,
        meshes: MarkedMeshes,
        settings: ViewSettings,
        save: SaveMarkers,
        stack: ExitStack,
    ) -> None:
        self.address = address
        self._server = server
        self._save = save
        self._lock = Lock()
        self._controls: MarkingControls | None = None  # the session may have news before they are there
        gui, scene = server.gui, meshes.scene
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(70, 95, 120))
        gui.set_panel_label("mixseq")
        topologies = [Topology(each.faces, each.vertex_count) for each in (meshes.source, meshes.target)]
        self._balls = MarkingStage(
            server, (topologies[0], topologies[1]), lambda side, row: self.session.click_ball(side, row)
        )
        camera = settings.camera or VIEWS["Left"]
        self._stage = LiveStage(server, SceneColours(scene), settings.material, False, lambda _: None, camera)
        self._playback = stack.enter_context(Playback(scene, self._stage, self._failed, threads=1))
        self.session = stack.enter_context(MarkingSession(meshes.source, meshes.target, meshes.markers, self))
        add_bridge(server, self._heard)
        self._controls = MarkingControls(
            server, self.session, meshes.names, meshes.file, self._look, self._other, self.save
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(320)
        self._stage.on_click(lambda side, picked: self.session.click(side, picked.vertex), mark=False)
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._stage.forget)
        self._place()

    # What the session tells -----------------------------------------------------------------------------

    def changed(self) -> None:
        """Draw the current markers."""
        controls = self._controls
        if controls is None:  # not all is there yet
            return
        with self._lock:
            session = self.session
            examination = session.examination
            suspects = frozenset() if examination is None else examination.suspects
            for side in (SOURCE, TARGET):
                self._balls.draw(side, list(balls(session.marking, session.proposals, suspects, side)))
            controls.show()

    def failed(self, what: str, error: Exception) -> None:
        """Show an error on all pages."""
        notify_all(self._server, f"{what}: not done", str(error))

    def save(self) -> None:
        """Write the markers to the file."""
        marking = self.session.marking
        try:
            what = self._save(marking.markers)
        except Exception as error:
            self.failed("save", error)
        else:
            self.session.kept(marking.pairs)
            notify_all(self._server, "Saved", what, good=True)

    # What the playback and the page tell ----------------------------------------------------------------

    def _failed(self, error: Exception) -> None:
        notify_all(self._server, "The meshes cannot be shown", str(error))

    def _look(self, camera: tuple[float, float]) -> None:
        self._stage.look(self._playback.scene, camera)
        self._playback.refresh()
        self._place()

    def _place(self) -> None:
        """Move balls to the current places of the meshes."""
        arrangement = self._stage.arrangement
        for side, item in enumerate(self._playback.scene.items):
            points = arrangement.placed(side, item.pose(0.0)).astype(np.float64)
            self._balls.place(side, points - arrangement.offsets[side])
        self._balls.stand(arrangement.offsets)
        self.changed()

    def _moved(self, camera: Any) -> None:
        """Keep meshes side by side, and balls small, while the camera of a page moves."""
        toward = camera.position - camera.look_at
        azimuth, distance = float(np.degrees(np.arctan2(toward[0], toward[2]))), float(np.linalg.norm(toward))
        turned = abs((azimuth - self._stage.arrangement.view.azimuth + 180) % 360 - 180)
        if turned > TURNED and np.hypot(toward[0], toward[2]) > STEEP * abs(toward[1]):
            self._stage.turn(azimuth, camera.look_at, distance)
            self._balls.stand(self._stage.arrangement.offsets)
        if self._balls.seen_from(distance):
            self.changed()

    def _other(self, camera: Any) -> None:
        """Look at the corresponding place of the other mesh, by the nearest marker."""
        middles = self._stage.arrangement.middles
        here = int(np.linalg.norm(middles - camera.look_at, axis=1).argmin())
        pairs = np.array(
            [each.vertices for each in (*self.session.marking.pairs, *self.session.proposals)], np.int64
        )
        ends = [
            np.concatenate([middles[[side]], self._balls.standing(side, pairs.reshape(-1, 2)[:, side])])
            for side in (here, 1 - here)
        ]
        nearest = int(np.linalg.norm(ends[0] - camera.look_at, axis=1).argmin())
        beside = camera.look_at - ends[0][nearest]
        if np.linalg.norm(beside) > BETWEEN * np.linalg.norm(middles[1] - middles[0]):
            beside = np.zeros(3)  # it looks at neither
        # it takes along what it looks at
        camera.position = camera.position + ends[1][nearest] + beside - camera.look_at

    def _connected(self, client: Any) -> None:
        self._stage.welcome(client)
        client.camera.on_update(self._moved)
        self._playback.refresh()

    def _heard(self, message: Message) -> None:
        if isinstance(message, Drawn):
            self._stage.drawn()
            self._playback.drawn()


@contextmanager
def marking_viewer(
    meshes: MarkedMeshes, settings: ViewSettings, save: SaveMarkers
) -> Iterator[MarkingViewer]:
    """Run a viewer for markers in the background, for the duration of the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(served(settings.host, settings.port))
        yield MarkingViewer(server, address, meshes, settings, save, stack)
