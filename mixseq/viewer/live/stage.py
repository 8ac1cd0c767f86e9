"""The scene of the page: meshes with colours, on a ground with a grid."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np

from mixseq.pictures.colours import ByteArray, Colouring, SceneColours
from mixseq.pictures.scene import FIELD_OF_VIEW_DEGREES, SCENE_SIZE, Arrangement, Scene, arrange_meshes
from mixseq.types import Float, Single
from mixseq.viewer.playback import Moment
from mixseq.viewer.session import Picked, pick

GROUND = (243, 243, 240)
GRID_COLOUR = (222, 222, 218)
MARK = (20, 20, 20)

CELL = SCENE_SIZE / 2
"""Size of the grid cells of the ground."""

WIDER = 0.02
"""Change of a window's aspect below which the camera stays."""


class LiveStage:
    """Meshes in the scene of a viser server; see `mixseq.viewer.playback.Stage`.

    `report` is called with every shown moment. `overlaid` and `following` (bodies stay in place, the ground moves) are
    initial states; `camera` as in `mixseq.pictures.scene.resolve_view`, `material` as in `ViewSettings`.
    """

    def __init__(
        self,
        server: Any,
        colours: SceneColours,
        material: str,
        overlaid: bool,
        report: Callable[[Moment], None],
        camera: tuple[float, float] | None = None,
        following: bool = False,
    ) -> None:
        self._server = server
        self._scene_colours = colours
        self._report = report
        self.overlaid = overlaid
        self._lock = Lock()
        self.busy = False  # whether the page is still drawing the last moment
        self._moment: Moment | None = None
        self._placed: dict[int, tuple[Float, float]] = {}
        self._colour = "clay"
        self._painted: list[Colouring | None] = [None] * len(colours.scene.items)
        self._camera = camera
        self.following = following
        self._arrangement = arrange_meshes(colours.scene, not overlaid, camera)
        self._furnish()
        self._meshes, self._clouds, self._labels = [], [], []
        self._marked: tuple[int, int] | None = None  # a mesh and its vertex
        self._mark = server.scene.add_icosphere(
            "/picked",
            radius=0.012 * SCENE_SIZE,
            color=MARK,
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
        )
        for index, item in enumerate(colours.scene.items):
            offset = self._arrangement.offsets[index]
            points = self._arrangement.to_scene(index, item.pose(0.0)) - offset.astype(np.float32)
            nothing = np.zeros_like(points)
            mesh = server.scene.add_mesh_simple(
                f"/mesh/{index}",
                points,
                item.header.faces,
                color=(255, 255, 255),
                material=material,
                side="double",
                position=offset,
                cast_shadow=False,
                receive_shadow=False,
            )
            cloud = server.scene.add_point_cloud(
                f"/paint/{index}", nothing, colors=nothing.astype(np.uint8), visible=False
            )
            self._meshes.append(mesh)
            self._clouds.append(cloud)
        if len(self._meshes) > 1:
            self._labels = [
                server.scene.add_label(f"/name/{index}", item.name, anchor="bottom-center", position=place)
                for index, (item, place) in enumerate(
                    zip(colours.scene.items, self._arrangement.label_positions, strict=True)
                )
            ]

    @property
    def colours(self) -> list[Colouring]:
        """Current colourings of all meshes."""
        return self._scene_colours.on_one_scale(self._colour)

    def show(self, moment: Moment) -> None:
        """Send a moment to the page."""
        with self._lock, self._server.atomic():
            self.busy = True
            self._moment = moment
            elapsed = moment.scene.elapsed(moment.frame)
            for index, (points, colours) in enumerate(zip(moment.poses, self.colours, strict=True)):
                placed, shift = self._standing(self._arrangement, index, points)
                if index == 0:
                    self._ground.position = (-shift[0] % CELL, -1e-3 * SCENE_SIZE, -shift[2] % CELL)
                self._meshes[index].vertices = placed - self._arrangement.offsets[index].astype(np.float32)
                if self._marked is not None and self._marked[0] == index:
                    self._mark.position = placed[self._marked[1]]
                if not colours.is_constant or self._painted[index] is not colours:
                    self._clouds[index].colors = linear(colours.palette)[colours.entries(points, elapsed)]
                    self._painted[index] = colours
            self._report(moment)

    def _standing(self, arrangement: Arrangement, index: int, points: Single) -> tuple[Single, Float]:
        """Return a mesh ``(V, 3)`` at its place, and the travel ``(3,)`` removed if it is followed."""
        placed = arrangement.to_scene(index, points)
        if not self.following:
            return placed, np.zeros(3)
        shift = (placed.mean(axis=0, dtype=np.float64) - arrangement.label_positions[index]) * [1, 0, 1]
        return np.asarray(placed - shift, dtype=np.float32), shift

    def colour(self, name: str) -> None:
        """Choose the colouring, from the next moment on."""
        self._colour = name

    def look(self, scene: Scene, camera: tuple[float, float]) -> None:
        """Set the view, see `mixseq.pictures.scene.resolve_view`, with meshes side by side across it."""
        self._camera = camera
        self.arrange(scene, side_by_side=True)

    def turn(self, azimuth: float, looked_at: Float, distance: float) -> None:
        """Keep meshes side by side across the current view, see `Arrangement.with_azimuth`."""
        with self._lock:
            self._arrangement = self._arrangement.with_azimuth(azimuth, looked_at, distance)
        self._place_meshes()

    @property
    def arrangement(self) -> Arrangement:
        """Current places of the meshes."""
        with self._lock:
            return self._arrangement

    def arrange(self, scene: Scene, side_by_side: bool) -> None:
        """Set meshes side by side or overlaid, from the next moment on."""
        arrangement = arrange_meshes(scene, side_by_side, self._camera)
        with self._lock:
            self._arrangement = arrangement
        self._place_meshes()
        self._place_cameras()

    def _place_meshes(self) -> None:
        with self._lock, self._server.atomic():
            for mesh, offset in zip(self._meshes, self._arrangement.offsets, strict=True):
                mesh.position = offset
            for label, place in zip(self._labels, self._arrangement.label_positions, strict=False):
                label.position = place

    def hide(self, index: int, hidden: bool) -> None:
        """Hide or show a mesh."""
        self._meshes[index].visible = not hidden
        if self._labels:
            self._labels[index].visible = not hidden

    def wire(self, on: bool) -> None:
        """Draw edges or surfaces."""
        for mesh in self._meshes:
            mesh.wireframe = on

    def on_click(self, report: Callable[[int, Picked], None], mark: bool = True) -> None:
        """Report the clicked mesh and the picked point; a ball marks it if wanted."""
        for number, mesh in enumerate(self._meshes):

            @mesh.on_click  # type: ignore[untyped-decorator]
            def _(event: Any, index: int = number) -> None:
                with self._lock:
                    moment, arrangement = self._moment, self._arrangement
                if moment is None:
                    return
                points, _ = self._standing(arrangement, index, moment.poses[index])
                found = pick(
                    points, moment.scene.items[index].header.faces, event.ray_origin, event.ray_direction
                )
                if found is not None:
                    if mark:
                        with self._lock:
                            self._marked = index, found.vertex
                            self._mark.position = points[found.vertex]
                            self._mark.visible = True
                    report(index, found)

    def _furnish(self) -> None:
        scene = self._server.scene
        scene.set_up_direction("+y")
        scene.configure_default_lights(cast_shadow=False)
        extent = float(np.abs([self._arrangement.low, self._arrangement.high]).max()) * 6
        self._ground = scene.add_grid(
            "/ground",
            extent,
            extent,
            plane="xz",
            cell_size=SCENE_SIZE / 10,
            section_size=CELL,
            cell_color=GRID_COLOUR,
            section_color=GRID_COLOUR,
            plane_color=GROUND,
            plane_opacity=0.0,
            fade_distance=6 * SCENE_SIZE,
            position=(0.0, -1e-3 * SCENE_SIZE, 0.0),
        )
        self._place_cameras()

    def welcome(self, client: Any) -> None:
        """Show everything in the camera of a new page, until the user moves it."""

        @client.camera.on_update  # type: ignore[untyped-decorator]
        def _(camera: Any) -> None:
            # the window of a page gets its shape when panels dock, after the page has come
            if client.client_id not in self._placed:
                return
            place, aspect = self._placed[client.client_id]
            first = self._server.initial_camera.position  # comes again, and late
            untouched = any(
                np.allclose(camera.position, each, rtol=1e-3, atol=1e-3) for each in (place, first)
            )
            if untouched and abs(camera.aspect / aspect - 1) > WIDER:
                self._place_camera(client)

        self._place_camera(client)

    def forget(self, client: Any) -> None:
        """Drop the state of a closed page."""
        self._placed.pop(client.client_id, None)

    def _place_camera(self, client: Any) -> None:
        aspect = client.camera.aspect
        place, centre = self._arrangement.camera(aspect)
        self._placed[client.client_id] = place, aspect
        with client.atomic():
            client.camera.fov = float(np.radians(FIELD_OF_VIEW_DEGREES))
            client.camera.position = place  # which moves what it looks at along
            client.camera.look_at = centre

    def _place_cameras(self) -> None:
        place, centre = self._arrangement.camera(aspect=1.0)
        camera = self._server.initial_camera
        camera.fov = float(np.radians(FIELD_OF_VIEW_DEGREES))
        camera.look_at, camera.position = centre, place
        for client in self._server.get_clients().values():
            self._place_camera(client)


def linear(colours: ByteArray) -> ByteArray:
    """Convert sRGB colours to linear, as three.js shades."""
    shares = colours / 255.0
    light = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * light), dtype=np.uint8)
