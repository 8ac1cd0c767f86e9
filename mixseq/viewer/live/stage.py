"""3D scene of the page: coloured meshes on a ground plane with a grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from math import remainder
from threading import Lock
from time import monotonic
from typing import Any

import numpy as np

from mixseq.mesh.nearest import RayHit, intersect_ray
from mixseq.mesh.rotations import matrix_to_quat
from mixseq.pictures.colours import Colouring, SceneColours
from mixseq.pictures.scene import FIELD_OF_VIEW_DEGREES, SCENE_SIZE, Arrangement, Scene, View, arrange_meshes
from mixseq.types import ByteArray, Float, Single
from mixseq.viewer.live import ViewSettings
from mixseq.viewer.playback import Moment

GROUND_COLOUR = (243, 243, 240)
GRID_COLOUR = (222, 222, 218)
PICK_COLOUR = (20, 20, 20)
Colour = tuple[int, int, int]

ROW_STEP_DEGREES = 2.0
"""Rotation of the camera beyond which meshes are moved to stay side by side."""

GRAB_RADIUS = 0.06 * SCENE_SIZE
"""Distance from a ball within which a drag of the mesh moves the ball, in scene units."""

GRID_CELL = SCENE_SIZE / 2
"""Cell size of the ground's grid, in scene units."""

ARRIVAL_SECONDS = 5.0
"""Time after which a page has the camera that was sent; before, it may report its own or half of the sent one."""


@dataclass(eq=False)
class _Page:
    """A page with an arrangement of its own, and the camera that was sent to it; or what all pages start with."""

    owner: Any  # the client, or the server
    arrangement: Arrangement
    frames: list[Any]  # parents of the meshes
    ground: Any  # parent of the ground
    position: Float = field(default_factory=lambda: np.zeros(3))
    target: Float = field(default_factory=lambda: np.zeros(3))
    aspect: float = 1.0  # width/height of the picture
    time: float = 0.0  # when the camera was sent, in seconds
    is_there: bool = False  # whether the page has the camera; what it reports afterwards are movements of the user

    @classmethod
    def from_owner(cls, owner: Any, arrangement: Arrangement) -> _Page:
        """Add the parents of the nodes to the scene of a client or a server."""
        count = len(arrangement.offsets)
        frames = [owner.scene.add_frame(f"/mesh/{index}", show_axes=False) for index in range(count)]
        page = cls(owner, arrangement, frames, owner.scene.add_frame("/below", show_axes=False))
        page.arrange(arrangement)
        return page

    def arrange(self, arrangement: Arrangement) -> None:
        """Move the meshes."""
        self.arrangement = arrangement
        with self.owner.atomic():
            self.ground.visible = not arrangement.is_stacked
            quats = matrix_to_quat(arrangement.rotations)
            for frame, offset, quat in zip(self.frames, arrangement.offsets, quats, strict=True):
                frame.position, frame.wxyz = offset, quat


class LiveStage:
    """Meshes in the scene of a viser server, a `mixseq.viewer.playback.Stage`.

    `on_show` is called with every shown moment. To follow is to fix bodies and move the ground. Every page has its own
    arrangement of the meshes, by its camera and window; they are turned in all.
    """

    def __init__(
        self, server: Any, colours: SceneColours, settings: ViewSettings, on_show: Callable[[Moment], None]
    ) -> None:
        self._server = server
        self._scene_colours = colours
        self._on_show = on_show
        self.overlaid, self.following = settings.overlaid, settings.following
        self._lock = Lock()
        self.is_busy = False  # whether a page is still drawing the last moment
        self._moment: Moment | None = None
        self._colour = colours.names[0]
        self._sent_colourings: list[Colouring | None] = [None] * len(colours.scene.items)
        self._camera = settings.camera
        self.on_turn: Callable[[], None] = lambda: None  # called when meshes have turned
        arrangement = arrange_meshes(colours.scene, not settings.overlaid, settings.camera)
        self._start = _Page.from_owner(server, arrangement)
        self._pages: dict[int, _Page] = {}
        self._add_ground()
        self._meshes, self._colour_clouds, self._labels = [], [], []
        self._picked: tuple[int, int] | None = None  # indices of mesh and vertex
        self._pick_balls = [self._add_ball(f"/mesh/{index}/picked", 0.012) for index in range(len(colours.scene.items))]
        self._handles: tuple[int, Mapping[int, Colour]] = (0, {})  # index of a mesh, and colours by vertex
        self._handle_balls: list[Any] = []
        self._grabs: dict[int, tuple[int, Float]] = {}  # by page: dragged vertex, and its offset from the pointer
        self._on_drag: Callable[[int, int, Float], bool] | None = None
        self._drags = [self._drag_callback(index, None) for index in range(len(colours.scene.items))]
        for index, item in enumerate(colours.scene.items):
            points = arrangement.to_local(index, item.pose(0.0))
            zeros = np.zeros_like(points)
            mesh = server.scene.add_mesh_simple(
                f"/mesh/{index}/surface",
                points,
                item.header.faces,
                color=(255, 255, 255),
                material=settings.material,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            cloud = server.scene.add_point_cloud(f"/paint/{index}", zeros, colors=zeros.astype(np.uint8), visible=False)
            self._meshes.append(mesh)
            if len(colours.scene.items) > 1:
                self._turn_by_drags(index, mesh)
            self._colour_clouds.append(cloud)
        if len(self._meshes) > 1:
            self._labels = [
                server.scene.add_label(f"/mesh/{index}/name", item.name, anchor="bottom-center")
                for index, item in enumerate(colours.scene.items)
            ]
        self._place_labels()

    @property
    def colours(self) -> list[Colouring]:
        """Current colouring of every mesh."""
        return self._scene_colours.on_one_scale(self._colour)

    def show(self, moment: Moment) -> None:
        """Send a moment to the page."""
        with self._lock, self._server.atomic():
            self.is_busy = True
            self._moment = moment
            elapsed = moment.scene.elapsed(moment.frame)
            for index, (points, colours) in enumerate(zip(moment.poses, self.colours, strict=True)):
                local, shift = self._local_points(index, points)
                if index == 0:
                    x, _, z = -self._start.arrangement.rotations[0] @ shift % GRID_CELL
                    self._ground.position = (x, -1e-3 * SCENE_SIZE, z)
                self._meshes[index].vertices = local
                if not colours.is_constant or self._sent_colourings[index] is not colours:
                    entries = colours.entries(points, elapsed)
                    self._colour_clouds[index].colors = srgb_to_linear(colours.palette)[entries]
                    self._sent_colourings[index] = colours
            self._place_balls()
            self._on_show(moment)

    def _local_points(self, index: int, points: Single) -> tuple[Single, Float]:
        """Return local points ``(V, 3)`` of a mesh, and the displacement ``(3,)`` removed to follow the mesh."""
        arrangement = self._start.arrangement
        local = arrangement.to_local(index, points)
        if not self.following:
            return local, np.zeros(3)
        shift = (local.mean(axis=0, dtype=np.float64) - arrangement.boxes[index].mean(axis=0)) * [1, 0, 1]
        return np.asarray(local - shift, dtype=np.float32), shift

    def _place_balls(self) -> None:
        """Move the balls to the picked vertex and to those of handles."""
        index, colours = self._handles
        balls = [(index, vertex, ball) for vertex, ball in zip(colours, self._handle_balls, strict=False)]
        balls += [(*self._picked, self._pick_balls[self._picked[0]])] if self._picked is not None else []
        if self._moment is None:
            return
        placed = {index: self._local_points(index, self._moment.poses[index])[0] for index, _, _ in balls}
        for index, vertex, ball in balls:
            ball.position = placed[index][vertex]

    def _place_labels(self) -> None:
        """Move the labels above the meshes, which may have turned."""
        arrangement = self._start.arrangement
        above = np.einsum("nji,nj->ni", arrangement.rotations, arrangement.label_positions - arrangement.offsets)
        for label, position in zip(self._labels, above, strict=False):
            label.position = position

    def _placed_points(self, arrangement: Arrangement, index: int, moment: Moment) -> tuple[Single, Float]:
        """Return a mesh ``(V, 3)`` in the scene, and the displacement ``(3,)`` removed there to follow the mesh."""
        local, shift = self._local_points(index, moment.poses[index])
        return arrangement.place(index, local), arrangement.rotations[index] @ shift

    def set_colour(self, name: str) -> None:
        """Set the colouring of the moments shown from now on."""
        self._colour = name

    def set_view(self, view: View, turns: tuple[float, ...]) -> None:
        """Set the view of the camera, and the turn of each mesh."""
        self._rearrange(
            lambda before: replace(before, view=view, turns=turns).side_by_side(before.centres.mean(axis=0))
        )
        self._update_cameras()

    def _follow_camera(self, page: _Page, camera: Any) -> None:
        """Keep meshes side by side while the camera of a page turns; see `Arrangement.seen_from`."""
        x, y, z = offset = camera.position - camera.look_at
        across = float(np.hypot(x, z))
        before, view = page.arrangement.view, View(*np.degrees([np.arctan2(x, z), np.arctan2(y, across)]).tolist())
        rotation = abs(remainder(view.azimuth - before.azimuth, 360)), abs(view.elevation - before.elevation)
        is_defined = across > 0.05 * abs(y)  # from straight above, there is no azimuth
        if len(self._meshes) > 1 and is_defined and max(rotation) > ROW_STEP_DEGREES:
            with self._lock:
                distance = float(np.linalg.norm(offset))
                page.arrange(page.arrangement.seen_from(view, camera.look_at, distance))

    def turn(self, index: int, degrees: float) -> None:
        """Turn one mesh: it is seen from an azimuth of its own, in degrees from that of the camera."""
        self._rearrange(lambda arrangement: arrangement.turned(index, degrees))

    def _rearrange(self, change: Callable[[Arrangement], Arrangement]) -> None:
        """Change the arrangement of all pages."""
        turns = self.arrangement.turns
        with self._lock, self._server.atomic():
            for page in (self._start, *self._pages.values()):
                page.arrange(change(page.arrangement))
            self._place_labels()
            self._place_balls()
        if turns != self.arrangement.turns:
            self.on_turn()

    @property
    def arrangement(self) -> Arrangement:
        """Arrangement of the meshes with which pages start."""
        return self._start.arrangement

    def arrangement_of(self, client_id: int) -> Arrangement:
        """Return the current arrangement of the meshes of a page."""
        return self._pages.get(client_id, self._start).arrangement

    def arrange(self, scene: Scene, side_by_side: bool) -> None:
        """Arrange the meshes side by side or overlaid."""
        arrangement = arrange_meshes(scene, side_by_side, self._camera)
        self.overlaid = not side_by_side
        self._rearrange(lambda _: arrangement)
        self._update_cameras()

    def set_visible(self, index: int, is_visible: bool) -> None:
        """Show or hide a mesh."""
        self._meshes[index].visible = is_visible
        if self._labels:
            self._labels[index].visible = is_visible

    def set_wireframe(self, on: bool) -> None:
        """Draw meshes as wireframes or surfaces."""
        for mesh in self._meshes:
            mesh.wireframe = on

    def on_click(self, callback: Callable[[int, RayHit], None], mark: bool = True) -> None:
        """Set the function called with a clicked mesh and the hit; if `mark` is true, mark the vertex with a ball.

        While the mesh is dragged, only its handles are marked.
        """
        for number, mesh in enumerate(self._meshes):

            @mesh.on_click  # type: ignore[untyped-decorator]
            def _(event: Any, index: int = number) -> None:
                with self._lock:
                    moment, arrangement = self._moment, self.arrangement_of(event.client_id)
                if moment is None:
                    return
                points, _ = self._placed_points(arrangement, index, moment)
                hit = intersect_ray(
                    points, moment.scene.items[index].header.faces, event.ray_origin, event.ray_direction
                )
                if hit is not None:
                    if mark and self._on_drag is None:
                        with self._lock:
                            self._mark((index, hit.vertex))
                    callback(index, hit)

    def _mark(self, picked: tuple[int, int] | None) -> None:
        """Mark a vertex of a mesh with a ball, or none."""
        self._picked = picked
        self._place_balls()
        for index, ball in enumerate(self._pick_balls):
            ball.visible = picked is not None and picked[0] == index

    def _turn_by_drags(self, index: int, mesh: Any) -> None:
        """Turn a mesh on its own while it is dragged with shift."""
        start = 0.0, 0.0  # turn, and place of the pointer as a share of the width

        @mesh.on_drag("left", modifier="shift")  # type: ignore[untyped-decorator]
        async def _(event: Any) -> None:
            nonlocal start
            place = event.end_screen_pos[0]
            if event.phase == "start":
                start = self.arrangement.turns[index], place
            elif not self.overlaid:
                self.turn(index, start[0] - 360 * (place - start[1]))

    def _add_ball(self, name: str, radius: float) -> Any:
        return self._server.scene.add_icosphere(
            name, radius=radius * SCENE_SIZE, color=PICK_COLOUR, visible=False, cast_shadow=False, receive_shadow=False
        )

    def set_handles(self, index: int, colours: Mapping[int, Colour], on_click: Callable[[int], None]) -> None:
        """Mark vertices of a mesh with balls, in colours by vertex, and set the function called with a clicked one."""
        with self._lock, self._server.atomic():
            if index != self._handles[0]:
                for ball in self._handle_balls:
                    ball.remove()
                self._handle_balls.clear()
            self._handles = index, dict(colours)
            while len(self._handle_balls) < len(colours):
                number = len(self._handle_balls)
                ball = self._add_ball(f"/mesh/{index}/handle/{number}", 0.018)
                ball.on_click(lambda _, number=number: on_click(list(self._handles[1])[number]))
                ball.on_drag(self._drag_callback(None, number))
                self._handle_balls.append(ball)
            for ball, colour in zip_longest(self._handle_balls, colours.values()):
                ball.visible, ball.color = colour is not None, colour or PICK_COLOUR
            self._place_balls()

    def set_dragging(self, callback: Callable[[int, int, Float], bool] | None) -> None:
        """Set the function called with a dragged mesh, a vertex and its target ``(3,)``; None to turn the camera.

        It returns False to refuse the drag, until the next one begins.
        """
        self._on_drag = callback
        with self._lock:
            self._mark(None)
        for mesh, drag in zip(self._meshes, self._drags, strict=True):
            mesh.remove_drag_callback(drag)
            if callback is not None:
                mesh.on_drag(drag)

    def _drag_callback(self, mesh: int | None, number: int | None) -> Callable[[Any], Any]:
        """Return the callback of a mesh, whose vertex nearest to the pointer is dragged, or of a ball."""

        async def drag(event: Any) -> None:  # in order: on the event loop
            index = self._handles[0] if mesh is None else mesh
            with self._lock:
                moment, arrangement = self._moment, self.arrangement_of(event.client_id)
                handles = list(self._handles[1]) if index == self._handles[0] else []
            if moment is None or self._on_drag is None:
                return
            if event.phase == "start":
                points, shift = self._placed_points(arrangement, index, moment)
                place = np.array(event.start_position)
                distances = np.linalg.norm(points - place, axis=1)
                vertex = int(distances.argmin()) if number is None else handles[number]
                nearest = min(handles, key=lambda each: distances[each], default=vertex)
                if number is None and distances[nearest] < GRAB_RADIUS:
                    vertex = nearest
                self._grabs[event.client_id] = vertex, points[vertex] - place + shift
            if event.client_id in self._grabs:
                vertex, offset = self._grabs[event.client_id]
                target = arrangement.to_mesh(index, np.array(event.end_position) + offset)
                if not self._on_drag(index, vertex, target) or event.phase == "end":
                    del self._grabs[event.client_id]

        return drag

    def _add_ground(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+y")
        scene.configure_default_lights(cast_shadow=False)
        extent = 12 * SCENE_SIZE  # up to where it fades, in front and behind
        self._ground = scene.add_grid(
            "/below/ground",
            extent,
            extent,
            plane="xz",
            cell_size=SCENE_SIZE / 10,
            section_size=GRID_CELL,
            cell_color=GRID_COLOUR,
            section_color=GRID_COLOUR,
            plane_color=GROUND_COLOUR,
            plane_opacity=0.0,
            fade_distance=6 * SCENE_SIZE,
            position=(0.0, -1e-3 * SCENE_SIZE, 0.0),
        )
        self._update_cameras()

    def add_client(self, client: Any) -> None:
        """Fit the camera of a new page to all meshes, until the user moves it."""
        page = self._pages[client.client_id] = _Page.from_owner(client, self.arrangement)

        @client.camera.on_update  # type: ignore[untyped-decorator]
        def _(camera: Any) -> None:
            page.is_there |= monotonic() > page.time + ARRIVAL_SECONDS
            initial, seen = self._server.initial_camera, (camera.position, camera.look_at)
            known = (page.position, page.target), (initial.position, initial.look_at)  # a page may return to the latter
            is_unmoved = any(np.allclose(seen, each, rtol=1e-3, atol=1e-3) for each in known)
            # A page connects before its panels dock, which changes the aspect ratio of the viewport.
            if (is_unmoved or not page.is_there) and abs(camera.aspect / page.aspect - 1) > 0.02:
                self._update_camera(page)
            elif is_unmoved:
                page.is_there = True
            elif page.is_there and not self.overlaid:
                self._follow_camera(page, camera)

        self._update_camera(page)

    def remove_client(self, client: Any) -> None:
        """Remove the state of a closed page."""
        self._pages.pop(client.client_id, None)
        self._grabs.pop(client.client_id, None)

    def _update_camera(self, page: _Page) -> None:
        camera = page.owner.camera
        page.aspect, page.time, page.is_there = camera.aspect, monotonic(), False
        with self._lock:
            if len(self._meshes) > 1 and not self.overlaid:
                page.arrange(page.arrangement.fitted(1 / page.aspect))
            page.position, page.target = page.arrangement.camera(1 / page.aspect)
        with page.owner.atomic():
            camera.fov = float(np.radians(FIELD_OF_VIEW_DEGREES))
            camera.position = page.position  # viser also moves the target
            camera.look_at = page.target

    def _update_cameras(self) -> None:
        position, centre = self.arrangement.camera(aspect=1.0)
        camera = self._server.initial_camera
        camera.fov = float(np.radians(FIELD_OF_VIEW_DEGREES))
        camera.look_at, camera.position = centre, position
        for page in list(self._pages.values()):
            self._update_camera(page)


def srgb_to_linear(colours: ByteArray) -> ByteArray:
    """Convert sRGB colours to linear colours, which three.js expects."""
    srgb = colours / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * linear), dtype=np.uint8)
