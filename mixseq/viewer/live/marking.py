"""Viewer for markers: the user clicks pairs of vertices on two meshes at rest, shown side by side.

Each vertex of a pair is drawn as a ball with the number of the pair; balls of proposals have the colour of their
certainty. A panel has buttons for undo and proposals, explains the colours, and shows the examination of the map.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from html import escape
from threading import Lock
from typing import Any

import numpy as np

from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.pictures.colours import SceneColours
from mixseq.pictures.scene import SCENE_SIZE, Arrangement, Scene, SceneItem, heading_between, resolve_view
from mixseq.retargeting.correspond import MIN_EXAMINED_MARKERS, Examination
from mixseq.retargeting.markers import Markers
from mixseq.sequence.sequence import MeshSequence, load_frames
from mixseq.types import Float, Index
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.live.controls import notify_all
from mixseq.viewer.live.stage import LiveStage, srgb_to_linear
from mixseq.viewer.live.viewer import add_bridge, run_server
from mixseq.viewer.marking import SOURCE, TARGET, Certainty, Marking, MarkingSession, Pair, Trial
from mixseq.viewer.playback import Playback
from mixseq.viewer.session import Drawn, Message

BALL_RADIUS_RATIO = 0.006
"""Radius of a ball, relative to the distance of the camera from its target; larger in pictures higher than wide."""

MAX_BALL_DISTANCE = 2.5 * SCENE_SIZE
"""Camera distance in scene units beyond which balls get smaller on the screen."""

RADIUS_CHANGE_RATIO = 1.15
"""Ratio of the larger to the smaller radius above which a change of the radius redraws the balls."""

SELECTED_SCALE = 1.6
"""Size of the ball of a selected or incomplete pair, relative to other balls."""

PROPOSAL_COLOURS: dict[Certainty, tuple[int, int, int]] = {
    "sure": (40, 40, 40),
    "between": (49, 104, 142),
    "unsure": (230, 120, 0),
}

PLACE_COLOUR = (201, 42, 42)
"""Colour of places to look at after a transfer is tried."""

LABEL_SIZE_RATIO = 4.0
"""Width and height of the room of a label, in radii of a ball."""

LABEL_DISTANCE_RATIO = 2.6
"""Distance of a label from its ball, in radii of a ball; multiples of it where that place is taken."""

MIN_LABEL_COSINE = -0.6
"""Cosine of the angle from the normal to the camera below which a ball has no label, as it is behind its mesh."""

MIN_ALIGNED_PAIRS = 3
"""Smallest number of pairs by which the target is turned to the side from which the source is seen."""

MAX_LABEL_TURN_DEGREES = 10.0
"""Rotation of the camera beyond which labels are placed again."""


def place_labels(points: Float, normals: Float, towards: Float, radius: float) -> Float:
    """Return label positions ``(n, 3)`` beside balls at points ``(n, 3)``, apart as seen from a direction ``(3,)``.

    A label is off the surface, or at the next free place around its ball; the balls nearest to the camera come first.
    """
    right = np.cross([0.0, 1.0, 0.0], towards)
    if np.linalg.norm(right) < 1e-3:  # from straight above
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(towards, right)])
    balls, leans = points @ axes.T, normals @ axes.T + [0.0, 0.3]  # above the ball where the surface faces the camera
    turns = np.radians([0, 45, -45, 90, -90, 135, -135, 180])
    labels = np.full_like(balls, np.inf)
    for row in np.argsort(-points @ towards, kind="stable"):
        angles = np.arctan2(leans[row, 1], leans[row, 0]) + turns
        around = LABEL_DISTANCE_RATIO * radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        places = np.concatenate([balls[row] + step * around for step in range(1, 13)])
        to_balls, to_labels = (np.abs(places[:, None] - taken).max(axis=2) for taken in (balls, labels))
        is_free = (to_balls > 1.7 * radius).all(axis=1) & (to_labels >= LABEL_SIZE_RATIO * radius).all(axis=1)
        labels[row] = places[is_free.argmax()]
    return np.asarray(points + (labels - balls) @ axes)


def pair_colour(number: int) -> tuple[int, int, int]:
    """Return the colour of a pair, given its number counted from 0."""
    hue = (0.02 + 0.618034 * number) % 1.0  # golden-ratio steps keep the first hues apart
    red, green, blue = colorsys.hsv_to_rgb(hue, 0.85, 0.9)
    return round(255 * red), round(255 * green), round(255 * blue)


@dataclass(frozen=True)
class Ball:
    """A ball on one of the meshes."""

    vertex: int
    text: str  # label, or an empty text
    colour: tuple[int, int, int]
    scale: float  # relative radius


def make_balls(
    marking: Marking, proposals: Sequence[Pair], suspects: frozenset[int], side: int, trial: Trial | None = None
) -> Iterator[Ball]:
    """Yield the balls of one mesh; numbers of suspicious pairs are marked by ``!``, places to look at by letters."""
    for number, pair in enumerate(marking.pairs):
        text = f"{number + 1}{'!' if number in suspects else ''}"
        scale = SELECTED_SCALE if number == marking.selected else 1.0
        yield Ball(pair.vertices[side], text, pair_colour(number), scale)
    if marking.started is not None and marking.started[0] == side:
        number = len(marking.pairs)
        yield Ball(marking.started[1], f"{number + 1} ...", pair_colour(number), SELECTED_SCALE)
    for place, pair in enumerate(proposals):
        colour = PROPOSAL_COLOURS[pair.certainty]
        yield Ball(pair.vertices[side], "" if place else "?", colour, 0.8 if place else 1.2)
    for letter, vertex, _ in () if trial is None or side == SOURCE else trial.findings:
        if vertex is not None:
            yield Ball(vertex, letter, PLACE_COLOUR, SELECTED_SCALE)


@dataclass(frozen=True, eq=False)
class MarkedMeshes:
    """Meshes to be marked."""

    source: MeshSequence  # source mesh, at rest in its first frame
    target: MeshSequence  # target mesh, at rest in its first frame
    names: tuple[str, str]  # names of the meshes
    markers: Markers  # initial markers
    file: str  # name of the file in which markers are saved

    @property
    def scene(self) -> Scene:
        """Both meshes at rest, scaled to the same size."""
        items = []
        for name, mesh in zip(self.names, (self.source, self.target), strict=True):
            points = np.asarray(mesh.points[:1], np.float64)
            size = float(np.linalg.norm(np.ptp(points[0], axis=0))) or 1.0
            rest = MeshSequence.from_header(mesh.header.with_times([0.0]), points / size)
            items.append(SceneItem(name, load_frames(rest)))
        return Scene(tuple(items))


class MarkingStage:
    """Balls and numbers of markers in the scene of a viser server."""

    def __init__(self, server: Any, scene: Scene, stage: LiveStage, on_click: Callable[[int, int], None]) -> None:
        from trimesh.creation import icosphere

        self._server = server
        self._on_click = on_click
        self._radius = BALL_RADIUS_RATIO * MAX_BALL_DISTANCE
        self._towards: Float = np.array([0.0, 0.0, 1.0])  # direction of the camera
        self._labels: dict[str, Any] = {}
        self._nodes: dict[int, Any] = {}
        self._stage = stage
        self._surfaces = []  # local vertices and normals of each mesh
        for side, item in enumerate(scene.items):
            points = stage.arrangement.to_local(side, item.pose(0.0)).astype(np.float64)
            topology = Topology(item.header.faces, len(points))
            self._surfaces.append((points, TriangleMesh(points, topology).vertex_normals))
        ball = icosphere(subdivisions=2, radius=1.0)
        self._ball = np.asarray(ball.vertices), np.asarray(ball.faces)

    def turn_between(self, pairs: Index) -> float:
        """Return the turn of the target in degrees that aligns it with the source by pairs ``(n, 2)``, or 0 for few."""
        if len(pairs) < MIN_ALIGNED_PAIRS:
            return 0.0
        return heading_between(*(self._surfaces[side][0][pairs[:, side]] for side in (SOURCE, TARGET)))

    def positions(self, side: int, vertices: Index, arrangement: Arrangement) -> Float:
        """Return the positions ``(n, 3)`` of vertices in the scene."""
        return arrangement.place(side, self._surfaces[side][0][vertices]).astype(np.float64)

    def set_camera(self, offset: Float, aspect: float) -> bool:
        """Adapt to the offset ``(3,)`` of the camera from its target and to the width/height of its picture.

        Returns whether balls must be redrawn.
        """
        distance = float(np.linalg.norm(offset))
        radius = BALL_RADIUS_RATIO * min(distance, MAX_BALL_DISTANCE) / min(aspect, 1.0)
        towards = offset / distance
        is_near = 1 / RADIUS_CHANGE_RATIO < radius / self._radius < RADIUS_CHANGE_RATIO
        if is_near and towards @ self._towards > np.cos(np.radians(MAX_LABEL_TURN_DEGREES)):
            return False
        self._radius, self._towards = radius, towards
        return True

    def draw(self, side: int, balls: Sequence[Ball]) -> None:
        """Draw the balls of one mesh, and remove its previous balls."""
        points, normals = self._surfaces[side]
        vertices = np.array([ball.vertex for ball in balls], np.int64)
        with self._server.atomic():
            self._draw_balls(side, balls, points[vertices])
            self._draw_labels(side, balls, points[vertices], normals[vertices])

    def _draw_balls(self, side: int, balls: Sequence[Ball], points: Float) -> None:
        """Move the balls of a mesh to points ``(n, 3)``; keep unused balls below the ground, as new balls flicker."""
        count = max(64, 1 << len(balls).bit_length())  # allocated balls
        positions = np.tile(np.array([0.0, -1e4, 0.0], np.float32), (count, 1))
        scales = np.full(count, self._radius, np.float32)
        colours = np.zeros((count, 3), np.uint8)
        linear = srgb_to_linear(np.array([ball.colour for ball in balls], np.uint8).reshape(-1, 3))
        for row, ball in enumerate(balls):
            positions[row], scales[row], colours[row] = points[row], self._radius * ball.scale, linear[row]
        node = self._nodes.get(side)
        if node is not None and len(node.batched_positions) == count:
            node.batched_positions, node.batched_scales, node.batched_colors = positions, scales, colours
            return
        node = self._nodes[side] = self._server.scene.add_batched_meshes_simple(
            f"/mesh/{side}/balls",
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
                self._on_click(side, event.instance_index)

    def _draw_labels(self, side: int, balls: Sequence[Ball], points: Float, normals: Float) -> None:
        towards = self._towards @ self._stage.arrangement.rotations[side]  # relative to the mesh
        rows = [row for row, ball in enumerate(balls) if ball.text and normals[row] @ towards > MIN_LABEL_COSINE]
        places = place_labels(points[rows], normals[rows], towards, self._radius)
        texts = {
            f"/mesh/{side}/marker/{row}": (balls[row].text, place) for row, place in zip(rows, places, strict=True)
        }
        for name in list(self._labels):
            if name.startswith(f"/mesh/{side}/") and name not in texts:
                self._labels.pop(name).remove()
        for name, (text, point) in texts.items():
            label = self._labels.get(name)
            if label is None:
                self._labels[name] = self._server.scene.add_label(
                    name, text, position=point, anchor="center-center", font_screen_scale=1.1, depth_test=False
                )
                continue
            label.position = point
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
"""Views of both meshes: azimuth from the front of the first mesh to its left, and elevation, in degrees."""


class MarkingControls:
    """Controls for undo, proposals, examination of the map, and saving."""

    def __init__(
        self,
        server: Any,
        session: MarkingSession,
        names: tuple[str, str],
        file: str,
        set_view: Callable[[tuple[float, float]], None],
        show_other_mesh: Callable[[Any], None],
        save: Callable[[], None],
    ) -> None:
        gui = server.gui
        self._session = session
        self._names = names
        self._file = file
        with gui.add_folder("Markers"):
            self._hint_line = gui.add_html("")
            steps = gui.add_button_group("Steps", ("Undo", "Redo", "Delete"))
            self._proposal_line = gui.add_html("")
            proposals = gui.add_button_group("Proposed", ("Accept", "Skip", "Accept all", "Suggest"))
        with gui.add_folder("View"):
            views = gui.add_button_group("See from", tuple(VIEWS))
            across = gui.add_button("Other mesh", hint="View the same point of the other mesh (key O)")
        with gui.add_folder("Map"):
            trying = gui.add_button("Try transfer", hint="Transfer frames of the source, and show where to look")
            self._map = gui.add_html("")
        with gui.add_folder("Save"):
            self._saved = gui.add_html("")
            button = gui.add_button("Save")
        views.on_click(lambda _: set_view(VIEWS[views.value]))
        across.on_click(lambda event: show_other_mesh(event.client))
        gui.add_command("Other mesh", hotkey="O").on_trigger(lambda event: show_other_mesh(event.client))
        for group in (steps, proposals):
            group.on_click(lambda _, by=group: self._do(by.value))
        button.on_click(lambda _: save())
        trying.on_click(lambda _: session.try_transfer())
        for label, key, modifier in (  # viser moves the camera with W, A, S, D, Q and E
            ("Undo", "Z", "cmd/ctrl"),
            ("Redo", "Z", "cmd/ctrl+shift"),
            ("Accept", "Y", None),
            ("Skip", "N", None),
            ("Delete", "X", None),
        ):
            command = gui.add_command(label, hotkey=key, modifier=modifier)
            command.on_trigger(lambda _, by=label: self._do(by))

    def _do(self, label: str) -> None:
        """Call the session's method for the label of a button or command."""
        getattr(self._session, label.lower().replace(" ", "_"))()

    def show(self) -> None:
        """Show the current markers and their examination."""
        session = self._session
        marking, proposals, examination = session.marking, session.proposals, session.examination
        self._hint_line.content = _lines("mixseq-hint", [_hint_text(marking, self._names)])
        self._proposal_line.content = _lines(
            "mixseq-proposed", [_proposal_text(proposals, session.work, session.doubt)]
        )
        trial, work = session.trial, session.work
        lines = _trial_lines(trial) if trial is not None else _map_lines(marking, examination, work)
        self._map.content = _lines("mixseq-map", lines)
        state = "unsaved changes" if session.has_changes else "no unsaved changes"
        self._saved.content = _lines("mixseq-saved", [escape(f"{self._file}: {state}")])


def _hint_text(marking: Marking, names: tuple[str, str]) -> str:
    count = len(marking.pairs)
    pair_count = f"{count} pair{'' if count == 1 else 's'}. "
    if marking.selected is not None:
        text = f"{_format_number(marking.selected)} is selected: click its new place, or Delete"
    elif marking.started is None:
        text = f"Click a point of {escape(names[0])} or {escape(names[1])}"
        text += "; click a ball to move or delete its pair" if count else ""
    else:
        other = names[1 - marking.started[0]]
        text = f"{_format_number(count)}: now click the same point of {escape(other)}"
    return pair_count + text


def _proposal_text(proposals: Sequence[Pair], work: str, doubt: str) -> str:
    hint = f"Not sure: {doubt}. Set two or three pairs (a hand, a foot, the nose), then Suggest" if doubt else ""
    if proposals:
        legend = "".join(
            f'<span style="margin-right: 14px; white-space: nowrap">{_dot(colour)} {count} {certainty}</span>'
            for certainty, colour in PROPOSAL_COLOURS.items()
            if (count := sum(pair.certainty == certainty for pair in proposals))
        )
        return f"{legend}<br>The next one has a ?. Click a ball to accept it. {escape(hint)}"
    if "look" in work:
        return escape(f"{work} ...")
    return escape(hint or "None: mirrored markers are proposed here")


def _map_lines(marking: Marking, examination: Examination | None, work: str) -> list[str]:
    count = len(marking.pairs)
    too_few = f"Shows how well pairs fit, from {MIN_EXAMINED_MARKERS} pairs on"
    if examination is None or "trying" in work:
        return [escape(f"{work} ...") if work else too_few]
    lines = []
    if examination.residuals is not None:
        percent = 100 * examination.residuals
        worst_ids = np.argsort(-percent, kind="stable")[:5]
        worst = ", ".join(f"{_format_number(int(k))} {percent[k]:.1f} %" for k in worst_ids)
        lines = [
            f"Error of the markers in a stiff map: {np.median(percent):.1f} % of the diagonal (median), "
            f"{percent.max():.1f} % (largest)",
            f"Largest errors: {worst}",
            f"{100 * examination.coverage:.0f} % of the target covered",
        ]
    elif examination.refusal:
        lines = [escape(examination.refusal)]
    elif count < MIN_EXAMINED_MARKERS:
        lines = [too_few]
    warnings = [f'<b style="color: #c92a2a">{escape(each.message)}</b>' for each in examination.suspicions]
    verdict = warnings or ["<b>No pair seems wrong</b>"] * (examination.residuals is not None)
    return [*verdict, *lines]


def _trial_lines(trial: Trial) -> list[str]:
    dot = _dot(PLACE_COLOUR)
    rows = ((letter, "" if vertex is None else dot, text) for letter, vertex, text in trial.findings)
    return [f"{ball}<b>{letter}</b> {escape(text)}" for letter, ball, text in rows] or [escape(trial.verdict)]


def _format_number(number: int) -> str:
    return f"{_dot(pair_colour(number))}<b>{number + 1}</b>"


def _dot(colour: tuple[int, int, int]) -> str:
    """Return a disc in a colour of balls; text in it would often be too pale."""
    return f'<span aria-hidden="true" style="color: rgb{colour}">&#9679;</span>'


def _lines(name: str, lines: list[str]) -> str:
    inside = "".join(f"<div>{line}</div>" for line in lines)
    return f'<div id="{name}" style="padding: 2px 12px; font-size: 12px">{inside}</div>'


SaveMarkers = Callable[[Markers], str]
"""Function that saves markers to the file passed at start, and returns a message."""


class MarkingViewer:
    """A running viewer for markers, started by `run_marking_viewer`."""

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
        self._is_aligned = False  # whether the target was turned to the side of the source
        self._controls: MarkingControls | None = None  # the session may report changes before the controls exist
        scene = meshes.scene
        camera = settings.camera or VIEWS["Left"]
        self._stage = LiveStage(server, SceneColours(scene), replace(settings, camera=camera), lambda _: None)
        self._balls = MarkingStage(server, scene, self._stage, lambda side, row: self.session.click_ball(side, row))
        self._stage.on_turn = self.on_change
        playback = Playback(scene, self._stage, self._on_playback_failure, threads=1)
        self._playback = stack.enter_context(playback)
        self.session = stack.enter_context(MarkingSession(meshes.source, meshes.target, meshes.markers, self))
        add_bridge(server, self._on_message)
        self._controls = MarkingControls(
            server, self.session, meshes.names, meshes.file, self._set_view, self._show_other_mesh, self.save
        )
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(320)
        self._stage.on_click(lambda side, hit: self.session.click(side, hit.vertex), mark=False)
        server.on_client_connect(self._on_connect)
        server.on_client_disconnect(self._stage.remove_client)
        self._set_view(camera)

    # Callbacks of the session ---------------------------------------------------------------------------

    def on_change(self) -> None:
        """Draw the current markers."""
        controls = self._controls
        if controls is None:  # during construction
            return
        if not self._is_aligned and len(self._sure_pairs) >= MIN_ALIGNED_PAIRS:
            self._is_aligned = True
            self._stage.turn(TARGET, self._balls.turn_between(self._sure_pairs))
        with self._lock:
            session = self.session
            examination = session.examination
            suspects = frozenset() if examination is None else examination.suspects
            for side in (SOURCE, TARGET):
                self._balls.draw(
                    side, list(make_balls(session.marking, session.proposals, suspects, side, session.trial))
                )
            controls.show()

    def on_failure(self, action: str, error: Exception) -> None:
        """Show an error on all pages."""
        notify_all(self._server, f"{action}: not done", str(error))

    def save(self) -> None:
        """Write the markers to the file."""
        marking = self.session.marking
        try:
            message = self._save(marking.markers)
        except Exception as error:
            self.on_failure("save", error)
        else:
            self.session.mark_saved(marking.pairs)
            notify_all(self._server, "Saved", message, is_success=True)

    # Callbacks of the playback and the page -------------------------------------------------------------

    def _on_playback_failure(self, error: Exception) -> None:
        notify_all(self._server, "The meshes cannot be shown", str(error))

    def _set_view(self, camera: tuple[float, float]) -> None:
        """See the source from an azimuth and elevation, and the target from the same side by their sure pairs."""
        source = self._playback.scene.items[SOURCE]
        view = resolve_view(source.pose(0.0)[None], source.header.up_axis, camera)
        self._stage.set_view(view, (0.0, self._balls.turn_between(self._sure_pairs)))
        self.on_change()

    @property
    def _sure_pairs(self) -> Index:
        """Vertices ``(n, 2)`` of the set pairs and the sure proposals."""
        pairs = (*self.session.marking.pairs, *self.session.proposals)
        return np.array([pair.vertices for pair in pairs if pair.certainty == "sure"], np.int64).reshape(-1, 2)

    def _on_camera(self, camera: Any) -> None:
        """Keep the size of balls on the screen constant, while the camera of a page moves."""
        if self._balls.set_camera(camera.position - camera.look_at, camera.aspect):
            self.on_change()

    def _show_other_mesh(self, client: Any) -> None:
        """Move the camera to the point of the other mesh that corresponds by the nearest marker."""
        camera, arrangement = client.camera, self._stage.arrangement_of(client.client_id)
        centres = arrangement.centres
        side_in_view = int(np.linalg.norm(centres - camera.look_at, axis=1).argmin())
        pairs = np.array([pair.vertices for pair in (*self.session.marking.pairs, *self.session.proposals)], np.int64)
        anchors = [
            np.concatenate([centres[[side]], self._balls.positions(side, pairs.reshape(-1, 2)[:, side], arrangement)])
            for side in (side_in_view, 1 - side_in_view)
        ]
        nearest = int(np.linalg.norm(anchors[0] - camera.look_at, axis=1).argmin())
        offset = camera.look_at - anchors[0][nearest]
        if np.linalg.norm(offset) > 0.25 * np.linalg.norm(centres[1] - centres[0]):
            offset = np.zeros(3)  # the target is between the meshes
        # viser moves the target with the position
        camera.position = camera.position + anchors[1][nearest] + offset - camera.look_at

    def _on_connect(self, client: Any) -> None:
        self._stage.add_client(client)
        client.camera.on_update(self._on_camera)
        self._playback.refresh()

    def _on_message(self, message: Message) -> None:
        if isinstance(message, Drawn):
            self._stage.is_busy = False
            self._playback.wake()


@contextmanager
def run_marking_viewer(meshes: MarkedMeshes, settings: ViewSettings, save: SaveMarkers) -> Iterator[MarkingViewer]:
    """Run a viewer for markers in the background during the context."""
    with ExitStack() as stack:
        server, address = stack.enter_context(run_server(settings.host, settings.port))
        yield MarkingViewer(server, address, meshes, settings, save, stack)
