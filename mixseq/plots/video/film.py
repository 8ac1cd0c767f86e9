"""Films of one or more meshes side by side, from a camera that may turn, drawn in software."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from mixseq.arrays import Float
from mixseq.choices import COLOURS, Colour
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore
from mixseq.mapping import Executor, on_threads
from mixseq.plots.raster import Picture
from mixseq.plots.sheet_layout import matplotlib_module
from mixseq.plots.video.backdrop import backdrop_of, panels_of
from mixseq.plots.video.cameras import Aim, cameras_of
from mixseq.plots.video.encoding import check_film, encode_film, film_format
from mixseq.plots.video.panels import Layout, Panel, draw_moment, moments
from mixseq.progress import Progress, silent
from mixseq.scene.colouring import Colouring, colouring_of
from mixseq.scene.items import DecodedItem, Scene, SceneItem, check_starts, same_mesh
from mixseq.scene.scene_times import nearest_frames
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import Frames, SequenceHeader

_MEANING = {"error": ("diagonals", 1.0), "strain": ("strain", 100.0), "curvature": ("degrees", 1.0)}
"""Units of colour scales in films, and how many units of `Colouring` each is."""

SMALLEST = 1e-12
"""Smallest end of the colour scale, above rounding."""


@dataclass(frozen=True)
class FilmSettings:
    """The settings of a film."""

    size: tuple[int, int] = (1280, 720)  # width and height in pixels
    fps: float | None = None  # frames per second, by default of the first mesh
    seconds: float | None = None  # duration, by default of the longest sequence; 4 s for still poses
    turn: float = 0.0  # rotation of the camera about the meshes during the film, in degrees
    # Degrees from the front, to the body's left, and above the horizon; by default `three_quarter_view`.
    camera: tuple[float, float] | None = None
    follow: bool = False  # whether the camera follows bodies that travel
    colour: Colour = "clay"  # the colouring
    # Error (diagonals), strain or change of angles (degrees) of the last colour, by default the largest of the film.
    scale: float | None = None

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise SettingsError(f"the colour is {self.colour!r}; one of {', '.join(COLOURS)} is expected")
        for name, value in (("fps", self.fps), ("the duration", self.seconds), ("the scale", self.scale)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"{name} is {value}; a positive number is expected")
        if not np.isfinite(self.turn):
            raise SettingsError(f"the turn is {self.turn}; a number of degrees is expected")
        if self.camera is not None and not np.all(np.isfinite(self.camera)):
            raise SettingsError(f"the camera is at {self.camera}; two numbers of degrees are expected")
        if self.scale is not None and self.colour not in _MEANING:
            raise SettingsError(
                "the scale is for the colours error, strain and curvature; leave it out, or choose one of them"
            )


def film(
    target: str | PathLike[str],
    shown: Sequence[SceneItem],
    settings: FilmSettings | None = None,
    against: Frames | FrameStore | None = None,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> None:
    """Make a film of meshes side by side, as .mp4 (by ffmpeg), .gif or .webp; the file is replaced when complete.

    Frames are drawn on several threads; the file is the same for any number. `against` is the original for the colour
    "error"; only its frames are shown then.
    """
    chosen = settings or FilmSettings()
    form = film_format(target)
    check_film(form, chosen.size, chosen.fps)
    check_shown(shown, chosen, against)
    work = workers or on_threads()
    items = tuple(item.stored(progress) for item in shown)
    scene = Scene(items, chosen.fps, chosen.seconds)
    times, fps = scene.times, scene.fps
    check_film(form, chosen.size, fps)
    original = None
    if against is not None:
        original = SceneItem("the original", against).stored(progress)
        check_starts(items, original.header)
        times = original.elapsed[nearest_frames(original.header, times)]
    decoded = [item.decode(times, progress, work) for item in items]
    colourings = _scaled(_colourings(items, decoded, chosen.colour, original), decoded, times, chosen)
    layout = _layout([item.name for item in items], decoded, colourings, chosen, fps)

    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        shown_then = moments(decoded, colourings, times, frames)
        for done, picture in enumerate(work(draw_moment, layout, shown_then), 1):
            yield picture
            progress(done, len(times), "drawing frames")

    encode_film(Path(target), form, draw, len(times), fps)


def check_shown(shown: Sequence[SceneItem], settings: FilmSettings, against: object) -> None:
    """Raise errors for items that cannot be shown, before the work."""
    if not shown:
        raise SettingsError("there is nothing to show; give a sequence or a model")
    if settings.colour == "error" and against is None:
        raise SettingsError(
            "the colour error is about errors; give the original that they are measured against"
        )
    if settings.colour != "error" and against is not None:
        raise SettingsError("the original is for the colour error; leave it out, or choose that colour")
    if settings.colour == "parts":
        _parts(shown)


def _parts(shown: Sequence[SceneItem]) -> list[Decomposition]:
    """Return the parts of each mesh: its own, or those of a model of the same triangles."""
    known = [(item.header.faces, item.decomposition) for item in shown]
    found = []
    for item in shown:
        same = (parts for faces, parts in known if parts and np.array_equal(faces, item.header.faces))
        parts = item.decomposition or next(same, None)
        if parts is None:
            raise SettingsError(
                f"{item} has no parts; show a model in the mixed space, or choose another colour"
            )
        found.append(parts)
    return found


def _colourings(
    items: Sequence[SceneItem], decoded: Sequence[DecodedItem], colour: Colour, original: SceneItem | None
) -> list[Colouring]:
    """Return the colouring of each mesh, against its first frame in the film or against the original."""
    parts = _parts(items) if colour == "parts" else [None] * len(items)
    for item in items:
        if colour == "own" and item.header.surface.colours is None:
            raise SettingsError(f"{item} has no colours of its own; choose another colour")
    before = None
    if original is not None:
        before = original.exact_pose
        for item in items:
            _check_mesh(item, original.header)
    return [
        colouring_of(colour, each.header, each.pose(0), own, before)
        for each, own in zip(decoded, parts, strict=True)
    ]


def _check_mesh(item: SceneItem, original: SequenceHeader) -> None:
    header = item.header
    if not same_mesh(header, original):
        raise SettingsError(
            f"{item} has {len(header.faces)} triangles of {header.vertex_count} vertices, the original "
            f"{len(original.faces)} of {original.vertex_count}, or in another order; errors need one mesh"
        )


def _scaled(
    colourings: list[Colouring], items: Sequence[DecodedItem], times: Float, settings: FilmSettings
) -> list[Colouring]:
    """Scale all colourings to the given end, by default the largest number of the film."""
    if settings.colour not in _MEANING:
        return colourings
    _, part = _MEANING[settings.colour]
    top = part * settings.scale if settings.scale else part * SMALLEST
    if settings.scale is None:
        for item, colouring in zip(items, colourings, strict=True):
            reached = (colouring.reached(item.pose(frame), float(time)) for frame, time in enumerate(times))
            top = max(top, *reached)
    return [colouring.scaled(top) for colouring in colourings]


def _layout(
    names: Sequence[str],
    items: Sequence[DecodedItem],
    colourings: Sequence[Colouring],
    settings: FilmSettings,
    fps: float,
) -> Layout:
    width, height = settings.size
    meaning, part = _MEANING.get(settings.colour, ("", 1.0))
    frames = len(items[0].pose_of_frame)
    cameras = cameras_of(items, Aim(settings.camera, settings.turn, settings.follow), fps)
    aspect = float(np.median([camera.aspect for camera in cameras]))
    places = panels_of(len(items), width, height, aspect, any(names), bool(meaning))
    panels = [
        Panel(
            item.header,
            colouring.of_faces,
            camera.fitted((place[0].stop - place[0].start) / (place[1].stop - place[1].start)),
            place,
        )
        for item, colouring, camera, place in zip(items, colourings, cameras, places, strict=True)
    ]
    if not meaning:
        return Layout(panels, backdrop_of(width, height, places, names), frames)
    palette = colour_scale()
    backdrop = backdrop_of(width, height, places, names, palette, colourings[0].top / part, meaning)
    return Layout(panels, backdrop, frames, palette)


def colour_scale() -> Float:
    """Return the colours ``(256, 3)`` from zero to the largest number, as in pictures of errors."""
    scale = matplotlib_module("cm").ScalarMappable(None, "viridis").get_cmap()
    return np.asarray(scale(np.arange(256))[:, :3], dtype=np.float64)
