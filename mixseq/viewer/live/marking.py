"""The viewer for markers: two meshes at rest, side by side, whose points are clicked in pairs.

Both ends of a pair have a ball and its number, proposals dark balls; a panel has undo, proposals, and the map.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from html import escape
from threading import Lock
from typing import Any

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import HEIGHT, Scene, SceneItem
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.suggestions import MIN_EXAMINED_MARKERS, Examination
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.types import Float, Index
from mixseq.viewer.live.controls import notify_all
from mixseq.viewer.live.stage import LiveStage
from mixseq.viewer.live.viewer import ViewSettings, add_bridge, served
from mixseq.viewer.marking import SOURCE, TARGET, Marking, MarkingSession, Pair
from mixseq.viewer.playback import Playback
from mixseq.viewer.session import Drawn, Message

RADIUS = 0.004
"""Radius of a ball, relative to the distance of the camera from its target."""

FARTHEST = 2.5 * HEIGHT
"""Distance beyond which balls shrink on the screen."""

STEP = 1.15
"""Factor of the radius at which balls are drawn again."""

CHOSEN = 1.6
"""Relative size of the ball of a chosen or begun pair."""

ABOVE = 3.0
"""Distance of a number from the surface, in radii, for visibility."""

SPARE, AWAY = 64, 1e4
"""Smallest number of balls, and the depth of unused ones below the ground."""

PROPOSED = (40, 40, 40)
"""Colour of proposals."""

GOLDEN = 0.618034
"""Step of the hue between consecutive numbers, so that neighbours differ."""


def colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a pair by its number, from 0."""
    red, green, blue = colorsys.hsv_to_rgb((0.02 + GOLDEN * number) % 1.0, 0.85, 0.9)
    return round(255 * red), round(255 * green), round(255 * blue)


@dataclass(frozen=True)
class Ball:
    """A ball on one of the meshes."""

    vertex: int  # vertex of the mesh
    text: str  # label, may be empty
    colour: tuple[int, int, int]  # its colour
    scale: float  # radius relative to the usual one


def balls(marking: Marking, proposals: Sequence[Pair], suspects: frozenset[int], side: int) -> Iterator[Ball]:
    """Yield the balls of a side: pairs with their numbers, with ``!`` for suspects."""
    for number, pair in enumerate(marking.pairs):
        text = f"{number + 1}{'!' if number in suspects else ''}"
        scale = CHOSEN if number == marking.chosen else 1.0
        yield Ball(pair.vertices[side], text, colour(number), scale)
    if marking.begun is not None and marking.begun[0] == side:
        number = len(marking.pairs)
        yield Ball(marking.begun[1], f"{number + 1} ...", colour(number), CHOSEN)
    for place, pair in enumerate(proposals):
        yield Ball(pair.vertices[side], "" if place else "?", PROPOSED, 0.7 if place else 1.2)


class MarkingStage:
    """Balls and numbers in the scene of a server."""

    def __init__(
        self, server: Any, topologies: tuple[Topology, Topology], clicked: Callable[[int, int], None]
    ) -> None:
        from trimesh.creation import icosphere

        self._server = server
        self._clicked = clicked
        self._topologies = topologies
        self._radius = RADIUS * FARTHEST
        self._placed: dict[int, tuple[Float, Float]] = {}
        self._labels: dict[str, Any] = {}
        self._nodes: dict[int, Any] = {}
        self._frames = [server.scene.add_frame(f"/markers/{side}", show_axes=False) for side in range(2)]
        ball = icosphere(subdivisions=2, radius=1.0)
        self._ball = np.asarray(ball.vertices), np.asarray(ball.faces)

    def place(self, side: int, points: Float) -> None:
        """Set the vertices ``(V, 3)`` of a mesh, relative to its place."""
        self._placed[side] = points, TriangleMesh(points, self._topologies[side]).vertex_normals

    def stand(self, offsets: Float) -> None:
        """Set the places ``(2, 3)`` of the meshes."""
        for frame, offset in zip(self._frames, offsets, strict=True):
            frame.position = offset

    def standing(self, side: int, vertices: Index) -> Float:
        """Return the places ``(n, 3)`` of vertices in the scene."""
        return np.asarray(self._placed[side][0][vertices] + self._frames[side].position)

    def resolve_view(self, distance: float) -> bool:
        """Set the distance of the camera; returns whether balls must be drawn again."""
        radius = RADIUS * min(distance, FARTHEST)
        if 1 / STEP < radius / self._radius < STEP:
            return False
        self._radius = radius
        return True

    def draw(self, side: int, drawn: Sequence[Ball]) -> None:
        """Draw exactly the given balls of a side."""
        points, normals = self._placed[side]
        vertices = np.array([ball.vertex for ball in drawn], np.int64)
        with self._server.atomic():
            self._show(side, drawn, points[vertices])
            self._write(side, drawn, points[vertices] + ABOVE * self._radius * normals[vertices])

    def _show(self, side: int, drawn: Sequence[Ball], places: Float) -> None:
        """Move the balls of a side; spare ones are kept far away, as new ones blink."""
        count = max(SPARE, 1 << len(drawn).bit_length())
        positions = np.tile(np.array([0.0, -AWAY, 0.0], np.float32), (count, 1))
        scales = np.full(count, self._radius, np.float32)
        colours = np.zeros((count, 3), np.uint8)
        for row, ball in enumerate(drawn):
            positions[row], scales[row], colours[row] = places[row], self._radius * ball.scale, ball.colour
        node = self._nodes.get(side)
        if node is not None and len(node.batched_positions) == count:
            node.batched_positions, node.batched_scales, node.batched_colors = positions, scales, colours
            return
        node = self._nodes[side] = self._server.scene.add_batched_meshes_simple(
            f"/markers/{side}/balls",
            *self._ball,
            batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            batched_positions=positions,
            batched_scales=scales,
            batched_colors=colours,
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
        )

        @node.on_click  # type: ignore[untyped-decorator]
        def _(event: Any) -> None:
            if event.instance_index is not None:
                self._clicked(side, event.instance_index)

    def _write(self, side: int, drawn: Sequence[Ball], places: Float) -> None:
        texts = {
            f"/markers/{side}/{row}": (ball.text, place)
            for row, (ball, place) in enumerate(zip(drawn, places, strict=True))
            if ball.text
        }
        for name in [each for each in self._labels if each.startswith(f"/markers/{side}/")]:
            if name not in texts:
                self._labels.pop(name).remove()
        for name, (text, place) in texts.items():
            label = self._labels.get(name)
            if label is None:
                self._labels[name] = self._server.scene.add_label(
                    name,
                    text,
                    position=place,
                    anchor="center-center",
                    font_screen_scale=1.1,
                    depth_test=True,
                )
                continue
            label.position = place
            if label.text != text:
                label.text = text


VIEWS = {
    "Front": (0.0, 5.0),
    "Left": (90.0, 5.0),
    "Right": (-90.0, 5.0),
    "Back": (180.0, 5.0),
    "Above": (90.0, 80.0),
    "Below": (90.0, -80.0),
}
"""Views of both meshes: degrees from the front of the first, to its left, and above the horizon."""

LISTED = 5
"""Number of listed markers, those of largest residuals."""


class MarkingControls:
    """Undo, proposals, examination of the map, and saving."""

    def __init__(
        self,
        server: Any,
        session: MarkingSession,
        names: tuple[str, str],
        file: str,
        look: Callable[[tuple[float, float]], None],
        other: Callable[[Any], None],
        save: Callable[[], None],
    ) -> None:
        gui = server.gui
        self._session = session
        self._names = names
        self._file = file
        with gui.add_folder("Markers"):
            self._hint = gui.add_html("")
            steps = gui.add_button_group("Steps", ("Undo", "Redo", "Delete"))
            views = gui.add_button_group("See from", tuple(VIEWS))
            across = gui.add_button("Other mesh", hint="Look at the same place of the other mesh (key O)")
        with gui.add_folder("Proposed"):
            self._proposed = gui.add_html("")
            proposals = gui.add_button_group("", ("Accept", "Skip", "Accept all"))
            again = gui.add_button("Suggest", hint="Look for tips of limbs, tail, nose and ears")
        with gui.add_folder("Map"):
            self._map = gui.add_html("")
        with gui.add_folder("Save"):
            self._saved = gui.add_html("")
            button = gui.add_button("Save")
        views.on_click(lambda _: look(VIEWS[views.value]))
        across.on_click(lambda event: other(event.client.camera))
        gui.add_command("Other mesh", hotkey="O").on_trigger(lambda event: other(event.client.camera))
        for group in (steps, proposals):
            group.on_click(lambda _, by=group: self._do(by.value))
        again.on_click(lambda _: session.suggest())
        button.on_click(lambda _: save())
        for label, key, modifier in (
            ("Undo", "Z", "cmd/ctrl"),
            ("Redo", "Z", "cmd/ctrl+shift"),
            ("Accept", "A", None),
            ("Skip", "S", None),
            ("Delete", "D", None),
        ):
            command = gui.add_command(label, hotkey=key, modifier=modifier)
            command.on_trigger(lambda _, by=label: self._do(by))

    def _do(self, label: str) -> None:
        """Call the method of the session that a button or a command is named after."""
        getattr(self._session, label.lower().replace(" ", "_"))()

    def show(self) -> None:
        """Show the current markers and their examination."""
        session = self._session
        marking, proposals, examination = session.marking, session.proposals, session.examination
        self._hint.content = _lines("mixseq-hint", [_hint(marking, self._names)])
        self._proposed.content = _lines("mixseq-proposed", [_proposed(len(proposals), session.work)])
        self._map.content = _lines("mixseq-map", _map_lines(marking, examination, session.work))
        state = "changed since it was saved" if session.unsaved else "as in the file"
        self._saved.content = _lines("mixseq-saved", [escape(f"{self._file}: {state}")])


def _hint(marking: Marking, names: tuple[str, str]) -> str:
    count = len(marking.pairs)
    done = f"{count} pair{'' if count == 1 else 's'}. "
    if marking.chosen is not None:
        text = f"{_number(marking.chosen)} is chosen: click where it should be on either mesh, or Delete"
    elif marking.begun is None:
        text = (
            f"Click a point of {escape(names[0])} or {escape(names[1])}; click a number to move or delete it"
        )
    else:
        other = names[1 - marking.begun[0]]
        text = f"{_number(count)}: now click the same point of {escape(other)}"
    return done + text


def _proposed(count: int, work: str) -> str:
    if count:
        return f"{count} to confirm, dark in the picture: the next one has a ?. Click one to accept it"
    if "look" in work:
        return escape(f"{work} ...")
    return "Nothing: the other side of what you set is proposed here"


def _map_lines(marking: Marking, examination: Examination | None, work: str) -> list[str]:
    count = len(marking.pairs)
    if examination is None:
        return [escape(f"{work} ...") if work else ""]
    lines = []
    if examination.residuals is not None:
        percent = 100 * examination.residuals
        worst = np.argsort(-percent, kind="stable")[:LISTED]
        listed = ", ".join(f"{_number(int(number))} {percent[number]:.1f} %" for number in worst)
        lines = [
            f"markers are off by {np.median(percent):.1f} % of the diagonal (median) where a stiff map takes them, "
            f"{percent.max():.1f} % at most",
            f"most: {listed}",
            f"{100 * examination.coverage:.0f} % of the target covered",
        ]
    elif examination.refusal:
        lines = [escape(examination.refusal)]
    elif count < MIN_EXAMINED_MARKERS:
        lines = [f"tells how well pairs fit, from {MIN_EXAMINED_MARKERS} on"]
    suspects = [
        f'<span style="color: #c92a2a">{escape(each.message)}</span>' for each in examination.suspicions
    ]
    return lines + suspects


def _number(number: int) -> str:
    red, green, blue = colour(number)
    return f'<b style="color: rgb({red} {green} {blue})">{number + 1}</b>'


def _lines(name: str, lines: list[str]) -> str:
    inside = "".join(f"<div>{line}</div>" for line in lines)
    return f'<div id="{name}" style="padding: 2px 12px; font-size: 12px">{inside}</div>'


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
            items.append(SceneItem(name, load_frames(still)))
        return Scene(tuple(items))


class MarkingViewer:
    """A running viewer for markers; make it with `run_marking_viewer`."""

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
        scene = meshes.scene
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
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(320)
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
        if self._balls.resolve_view(distance):
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
            self._stage.busy = False
            self._playback.drawn()


@contextmanager
def run_marking_viewer(
    meshes: MarkedMeshes, settings: ViewSettings, save: SaveMarkers
) -> Iterator[MarkingViewer]:
    """Run a viewer for markers in the background, for the duration of the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(served(settings.host, settings.port))
        yield MarkingViewer(server, address, meshes, settings, save, stack)
