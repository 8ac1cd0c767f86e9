"""Films of meshes: one or more of them side by side, over time, from a camera that may turn; drawn in software."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mixseq.arrays import Float
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, frame_store
from mixseq.mapping import Executor, on_threads
from mixseq.plots.colours import CLAY, segmentation_colours
from mixseq.plots.measures import MEASURES
from mixseq.plots.raster import Picture
from mixseq.plots.video.colouring import COLOURS, SMALLEST, Change, Colour, Error, Timed, colour_scale
from mixseq.plots.video.encoding import check_film, encode_film, film_format
from mixseq.plots.video.page import page_of, panels_of
from mixseq.plots.video.scene import Actor, Scene, cameras_of, draw_moment, moments
from mixseq.plots.video.timing import Track, film_times, nearest_frames, track_of_model, track_of_sequence
from mixseq.progress import Progress, silent
from mixseq.sequence import Frames
from mixseq.signals import Model

_MEANING = {"error": "diagonals", "strain": "strain", "curvature": "degrees"}
"""What the colours with a scale are measured in."""


@dataclass(frozen=True)
class FilmSettings:
    """How a film is made.

    Parameters
    ----------
    size : (int, int)
        Width and height in pixels.
    fps : float, optional
        Frames per second, by default those of the first mesh.
    seconds : float, optional
        Duration, by default that of the longest sequence; 4 s where nothing moves.
    turn : float
        Degrees by which the camera goes around the meshes in the film.
    colour : {"clay", "parts", "error", "strain", "curvature"}
        What colours show.
    scale : float, optional
        Error (in diagonals), strain or change of angles (in degrees) that has the last colour, by default the
        largest of the film.

    Raises
    ------
    SettingsError
        If a setting is out of range, or of no use.
    """

    size: tuple[int, int] = (1280, 720)
    fps: float | None = None
    seconds: float | None = None
    turn: float = 0.0
    colour: Colour = "clay"
    scale: float | None = None

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise SettingsError(f"the colour is {self.colour!r}; one of {', '.join(COLOURS)} is expected")
        for name, value in (("fps", self.fps), ("the duration", self.seconds), ("the scale", self.scale)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"{name} is {value}; a positive number is expected")
        if not np.isfinite(self.turn):
            raise SettingsError(f"the turn is {self.turn}; a number of degrees is expected")
        if self.scale is not None and self.colour not in _MEANING:
            raise SettingsError(
                "the scale is for the colours error, strain and curvature; leave it out, or choose one of them"
            )


@dataclass(frozen=True, eq=False)
class Shown:
    """A mesh in a film.

    Attributes
    ----------
    name : str
        What stands above it; may be empty.
    motion : Model or sequence
        What moves: a model, which is decoded at the times of the film, or a sequence, of which the nearest frames are
        shown.
    """

    name: str
    motion: Model | Frames | FrameStore

    def __str__(self) -> str:
        return self.name or self.motion.header.name


def film(
    target: str | PathLike[str],
    shown: Sequence[Shown],
    settings: FilmSettings | None = None,
    against: Frames | FrameStore | None = None,
    progress: Progress = silent,
    workers: Executor | None = None,
) -> None:
    """Make a film of meshes side by side.

    Frames are drawn on several threads and encoded as they come; the file is the same whatever their number.

    Parameters
    ----------
    target : path
        The file: .mp4 (AV1), .gif or .webp.
    shown : sequence of Shown
        What is shown, from left to right.
    settings : FilmSettings, optional
        How.
    against : sequence, optional
        The original, for the colour "error"; only its frames are shown then.
    progress : callable, optional
        Told about every frame.
    workers : Executor, optional
        Who draws, by default as many threads as there are cores.

    Raises
    ------
    SettingsError
        If there is nothing to show, settings do not go with the format or with what is shown.
    OutputError
        If the target's extension is not known.
    MissingExtraError
        If Pillow, one of its encoders or matplotlib is not installed.
    """
    chosen = settings or FilmSettings()
    form = film_format(target)
    check_film(form, chosen.size, chosen.fps)
    check_shown(shown, chosen, against)
    work = workers or on_threads()
    motions = [
        item.motion if isinstance(item.motion, Model) else _stored(item.motion, progress) for item in shown
    ]
    times, fps = film_times([motion.header for motion in motions], chosen.fps, chosen.seconds)
    check_film(form, chosen.size, fps)
    original = None
    if against is not None:
        whole = _stored(against, progress)
        _check_starts(shown, whole)
        times = whole.header.times[nearest_frames(whole.header, times)] - whole.header.times[0]
        original = track_of_sequence(whole, times)
    tracks = [_track(motion, times, progress, work) for motion in motions]
    measures = _measures(shown, tracks, chosen.colour, original)
    colours: Sequence[ArrayLike] = _colours(shown) if chosen.colour == "parts" else [CLAY] * len(shown)
    actors = [
        Actor(item.name, track, rgb, measure)
        for item, track, rgb, measure in zip(shown, tracks, colours, measures, strict=True)
    ]
    scene = _scene(actors, len(times), chosen)

    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        for done, picture in enumerate(work(draw_moment, scene, moments(actors, frames)), 1):
            yield picture
            progress(done, len(times), "drawing frames")

    encode_film(Path(target), form, draw, len(times), fps)


def check_shown(shown: Sequence[Shown], settings: FilmSettings, against: object) -> None:
    """Refuse what cannot be shown, before the work.

    Raises
    ------
    SettingsError
        If nothing is shown, an original is missing or of no use, or something has no parts.
    """
    if not shown:
        raise SettingsError("there is nothing to show; give a sequence or a model")
    if settings.colour == "error" and against is None:
        raise SettingsError(
            "the colour error is about errors; give the original that they are measured against"
        )
    if settings.colour != "error" and against is not None:
        raise SettingsError("the original is for the colour error; leave it out, or choose that colour")
    if settings.colour == "parts":
        _colours(shown)


def _stored(motion: Frames | FrameStore, progress: Progress) -> FrameStore:
    return motion if isinstance(motion, FrameStore) else frame_store(motion, progress)


def _track(motion: Model | FrameStore, times: Float, progress: Progress, workers: Executor) -> Track:
    if isinstance(motion, Model):
        return track_of_model(motion, times, progress, workers)
    return track_of_sequence(motion, times)


def _check_starts(shown: Sequence[Shown], original: FrameStore) -> None:
    """Refuse to measure errors at other times."""
    start = original.header.times[0]
    for item in shown:
        if abs(item.motion.header.times[0] - start) > 1e-3 / original.header.fps:
            raise SettingsError(
                f"{item} begins at {item.motion.header.times[0]:g} s, the original at {start:g} s; errors need "
                "the same times"
            )


def _measures(
    shown: Sequence[Shown], tracks: Sequence[Track], colour: Colour, original: Track | None
) -> list[Timed | None]:
    """Return what colours measure of each mesh."""
    if colour in MEASURES:
        return [Change.of(track, colour) for track in tracks]
    if original is None:
        return [None] * len(tracks)
    return [Error.of(track, original, str(item)) for item, track in zip(shown, tracks, strict=True)]


def _colours(shown: Sequence[Shown]) -> list[Float]:
    """Return colours ``(F, 3)`` of the parts of each mesh: its own, or of a model of the same triangles."""
    models = [item.motion for item in shown if isinstance(item.motion, Model)]
    mixed = [model for model in models if model.space.decomposed]
    colours = []
    for item in shown:
        own = [model for model in mixed if model is item.motion]
        same = [model for model in mixed if np.array_equal(model.header.faces, item.motion.header.faces)]
        if not (own or same):
            raise SettingsError(
                f"{item} has no parts; show a model in the mixed space, or choose another colour"
            )
        parts = (own or same)[0].decomposition
        colours.append(segmentation_colours(parts.part_of_face, parts.joint_of_face))
    return colours


def _scene(actors: Sequence[Actor], frames: int, settings: FilmSettings) -> Scene:
    """Place panels and cameras, and find how far the colours go."""
    width, height = settings.size
    tracks = [actor.track for actor in actors]
    names = [actor.name for actor in actors]
    meaning = _MEANING.get(settings.colour, "")
    cameras = cameras_of(tracks, frames, settings.turn)
    aspect = float(np.median([camera.aspect for camera in cameras]))
    panels = panels_of(len(actors), width, height, aspect, any(names), bool(meaning))
    fitted = [
        camera.fitted((rows.stop - rows.start) / (columns.stop - columns.start))
        for camera, (rows, columns) in zip(cameras, panels, strict=True)
    ]
    if not meaning:
        return Scene(actors, fitted, panels, page_of(width, height, panels, names), frames)
    palette = colour_scale()
    top = settings.scale or _largest(actors, frames)
    page = page_of(width, height, panels, names, palette, top, meaning)
    return Scene(actors, fitted, panels, page, frames, palette, top)


def _largest(actors: Sequence[Actor], frames: int) -> float:
    """Return what the colour scale must reach in a film."""
    measures = [actor.measure for actor in actors if actor.measure is not None]
    return max(
        SMALLEST,
        *(
            measure.largest(values)
            for _, seen in moments(actors, range(frames))
            for measure, (_, values) in zip(measures, seen, strict=True)
            if values is not None
        ),
    )
