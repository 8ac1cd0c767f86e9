"""The frames of a film: panels side by side, each with a mesh and its name, seen by cameras that may turn."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.plots.camera import Limits, View, broadside, shared_limits, y_up
from mixseq.plots.raster import Picture, render_mesh
from mixseq.plots.video.colouring import Timed
from mixseq.plots.video.timing import Track
from mixseq.threads import one_blas_thread

HEAT_CONTRAST = 0.25
"""Strength of the shading under colours that mean numbers, as on paper."""

Rectangle = tuple[slice, slice]
"""Rows and columns of a picture."""


@dataclass(frozen=True, eq=False)
class Actor:
    """What one panel shows.

    Attributes
    ----------
    name : str
        Written above it; may be empty.
    track : Track
        The mesh.
    colours : (3,) or (F, 3) float
        RGB in 0..1 of the mesh or of each face, where `measure` does not tell.
    measure : Timed, optional
        The numbers that colours show.
    """

    name: str
    track: Track
    colours: ArrayLike
    measure: Timed | None = None


@dataclass(frozen=True, eq=False)
class Camera:
    """Where a mesh is seen from, during a film of N frames.

    Attributes
    ----------
    view : View
        The view of the first frame.
    turn : float
        Degrees by which it turns until the first frame comes again, after N.
    centre : (3,) float
        What it turns about, Y up.
    ground : float
        Height of the ground.
    limits : (4,) float
        Screen rectangle that holds all frames.
    """

    view: View
    turn: float
    centre: Float
    ground: float
    limits: Limits

    def at(self, share: float) -> View:
        """Return the view after a share of the film."""
        return View(self.view.azimuth + share * self.turn, self.view.elevation)

    @property
    def aspect(self) -> float:
        """Height per width of what it sees."""
        left, right, bottom, top = self.limits
        return (top - bottom) / (right - left)

    def fitted(self, aspect: float) -> Camera:
        """Return a camera that sees more, on both sides or above and below, so that its aspect is as given."""
        left, right, bottom, top = self.limits
        width, height = max(right - left, (top - bottom) / aspect), max(top - bottom, (right - left) * aspect)
        x, y = (left + right) / 2, (bottom + top) / 2
        return replace(self, limits=(x - width / 2, x + width / 2, y - height / 2, y + height / 2))


@dataclass(frozen=True, eq=False)
class Scene:
    """All that the frames of a film have in common.

    Attributes
    ----------
    actors : sequence of Actor
        What is shown.
    cameras : sequence of Camera
        One for each of them.
    panels : sequence of pairs of slices
        Where they are in the picture; of the proportions of the cameras' limits.
    page : (H, W, 3) uint8
        What does not change: names and the colour bar.
    frames : int
        Number of frames N.
    palette : (n, 3) float, optional
        Colours of numbers from 0 to `top`, RGB in 0..1.
    top : float
        Number that has the last colour.
    """

    actors: Sequence[Actor]
    cameras: Sequence[Camera]
    panels: Sequence[Rectangle]
    page: Picture
    frames: int
    palette: Float | None = None
    top: float = 1.0


Moment = tuple[int, list[tuple[Float, Float | None]]]
"""A frame's number, and the points and numbers ``(V,)`` of each actor in it."""


def moments(actors: Sequence[Actor], frames: Iterable[int]) -> Iterator[Moment]:
    """Yield what frames of a film show."""
    for frame in frames:
        seen = []
        for actor in actors:
            points = actor.track.pose(frame)
            seen.append((points, actor.measure(points, frame) if actor.measure else None))
        yield frame, seen


def draw_moment(scene: Scene, moment: Moment) -> Picture:
    """Draw a frame of a film ``(H, W, 3)``."""
    frame, seen = moment
    picture = scene.page.copy()
    for actor, camera, panel, (points, values) in zip(
        scene.actors, scene.cameras, scene.panels, seen, strict=True
    ):
        header = actor.track.header
        colours, contrast = actor.colours, 1.0
        if values is not None and scene.palette is not None:
            last = len(scene.palette) - 1
            steps = np.clip(np.rint(values / scene.top * last), 0, last).astype(np.int64)
            colours, contrast = scene.palette[steps[header.faces]], HEAT_CONTRAST
        world = y_up(points, header.up_axis) - camera.centre
        view = camera.at(frame / scene.frames)
        ground = camera.ground - camera.centre[1]
        render_mesh(
            picture[panel], world, header.faces, view, camera.limits, colours, float(ground), contrast
        )
    return picture


def cameras_of(tracks: Sequence[Track], frames: int, turn: float) -> list[Camera]:
    """Place the cameras: the same for all that have the triangles of the first, one of its own for each of the others.

    Parameters
    ----------
    tracks : sequence of Track
        What is shown.
    frames : int
        Number of frames of the film.
    turn : float
        Degrees by which the cameras turn.
    """
    groups: dict[int, list[Track]] = {}
    group_of = []
    for number, track in enumerate(tracks):
        same = number > 0 and np.array_equal(track.header.faces, tracks[0].header.faces)
        group_of.append(0 if same else number)
        groups.setdefault(group_of[-1], []).append(track)
    with one_blas_thread():
        placed = {number: _camera(group, frames, turn) for number, group in groups.items()}
    return [placed[number] for number in group_of]


def _camera(tracks: Sequence[Track], frames: int, turn: float) -> Camera:
    """Place the camera of meshes that are seen alike."""
    boxes = []
    for track in tracks:
        for frame in track.shown_first.tolist():
            world = y_up(track.pose(frame), track.header.up_axis)
            boxes.append((world.min(axis=0), world.max(axis=0)))
    low, high = np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)
    centre, ground = (low + high) / 2, float(low[1])
    first = tracks[0]
    camera = Camera(
        broadside(first.pose(0), first.header.up_axis), turn, centre, ground, (0.0, 1.0, 0.0, 1.0)
    )
    below = np.array([[0, ground - centre[1], 0]])
    limits = []
    for track in tracks:
        # while the camera turns, every frame is another picture
        for frame in range(frames) if turn else track.shown_first.tolist():
            world = y_up(track.pose(frame), track.header.up_axis) - centre
            limits.append(shared_limits(np.concatenate([world, below]), "Y", camera.at(frame / frames)))
    left, right, bottom, top = zip(*limits, strict=True)
    return Camera(camera.view, turn, centre, ground, (min(left), max(right), min(bottom), max(top)))
