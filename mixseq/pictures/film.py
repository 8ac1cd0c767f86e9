"""Films of one or more meshes side by side, from a camera that may turn or follow a body, drawn in software.

A frame has a panel for each mesh, on a static backdrop of names and the colour bar.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from mixseq.choices import COLOURS, Colour
from mixseq.errors import SettingsError
from mixseq.pictures.colours import INK_COLOUR, Bytes, Colouring, make_colouring, two_digits
from mixseq.pictures.film_encoding import check_film, encode_film, film_format, pillow_module
from mixseq.pictures.page import import_matplotlib
from mixseq.pictures.raster import Picture, blank, render_mesh
from mixseq.pictures.scene import (
    Camera,
    DecodedItem,
    Scene,
    SceneItem,
    check_starts,
    nearest_frames,
    resolve_view,
    same_mesh,
    shared_limits,
    to_y_up,
)
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, FrameStore
from mixseq.types import Float

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont


_MEANING = {"error": ("diagonals", 1.0), "strain": ("strain", 100.0), "curvature": ("degrees", 1.0)}
"""Units of colour scales in films, and how many units of `Colouring` each is."""

SMALLEST_COLOUR_SCALE = 1e-12
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
    progress: Progress = no_progress,
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
    work = workers or thread_executor()
    items = tuple(item.with_random_access(progress) for item in shown)
    scene = Scene(items, chosen.fps, chosen.seconds)
    times, fps = scene.times, scene.fps
    check_film(form, chosen.size, fps)
    original = None
    if against is not None:
        original = SceneItem("the original", against).with_random_access(progress)
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
        if original is not None:
            _check_mesh(item, original.header)
    before = None if original is None else original.exact_pose
    return [
        make_colouring(colour, each.header, each.pose(0), own, before)
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
    top = part * settings.scale if settings.scale else part * SMALLEST_COLOUR_SCALE
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
    cameras = cameras_of(items, settings, fps)
    aspect = float(np.median([camera.aspect for camera in cameras]))
    places = panels_of(len(items), width, height, aspect, any(names), bool(meaning))
    panels = []
    for item, colouring, camera, place in zip(items, colourings, cameras, places, strict=True):
        rows, columns = place
        fitted = camera.fitted((rows.stop - rows.start) / (columns.stop - columns.start))
        panels.append(Panel(item.header, colouring.of_faces, fitted, place))
    if not meaning:
        return Layout(panels, backdrop_of(width, height, places, names))
    scale = import_matplotlib("cm").ScalarMappable(None, "viridis").get_cmap()
    palette = np.asarray(scale(np.arange(256))[:, :3], dtype=np.float64)
    backdrop = backdrop_of(width, height, places, names, palette, colourings[0].top / part, meaning)
    return Layout(panels, backdrop, palette)


SMOOTHED = 0.25
"""Time constant in seconds over which a following camera smooths the swing of a body."""


def cameras_of(items: Sequence[DecodedItem], settings: FilmSettings, fps: float) -> list[Camera]:
    """Return the cameras: a common one for meshes with the triangles of the first, one for each other."""
    groups: dict[int, list[DecodedItem]] = {}
    group_of = []
    for number, item in enumerate(items):
        same = number > 0 and np.array_equal(item.header.faces, items[0].header.faces)
        group_of.append(0 if same else number)
        groups.setdefault(group_of[-1], []).append(item)
    with one_blas_thread():
        placed = {number: _camera(group, settings, fps) for number, group in groups.items()}
    return [placed[number] for number in group_of]


def _camera(items: Sequence[DecodedItem], settings: FilmSettings, fps: float) -> Camera:
    first, frames = items[0], len(items[0].pose_of_frame)
    path = travel_path(first, fps) if settings.follow else np.zeros((frames, 3))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for item in items:
        for frame in range(frames) if settings.follow else item.shown_first.tolist():
            world = to_y_up(item.pose(frame), item.header.up_axis) - path[frame]
            low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    ground = float(low[1])
    ends = np.stack([first.pose(0), first.pose(frames - 1)])
    view = resolve_view(ends, first.header.up_axis, settings.camera)
    camera = Camera(view, settings.turn, path + (low + high) / 2, ground, (0.0, 1.0, 0.0, 1.0))
    limits = []
    for item in items:
        # while the camera turns or follows, every frame is another picture
        for frame in range(frames) if settings.turn or settings.follow else item.shown_first.tolist():
            centre = camera.centres[frame]
            world = to_y_up(item.pose(frame), item.header.up_axis) - centre
            below = np.array([[0, ground - centre[1], 0]])
            limits.append(shared_limits(np.concatenate([world, below]), "Y", camera.at(frame)))
    left, right, bottom, top = zip(*limits, strict=True)
    return replace(camera, limits=(min(left), max(right), min(bottom), max(top)))


def travel_path(item: DecodedItem, fps: float) -> Float:
    """Return the smoothed path ``(N, 3)`` of a mesh over the ground in a film, Y up, from its first place."""
    middles = np.stack(
        [
            to_y_up(item.pose(frame), item.header.up_axis).mean(axis=0)
            for frame in range(len(item.pose_of_frame))
        ]
    )
    middles = (middles - middles[0]) * [1, 0, 1]
    straight = np.linspace(0, 1, len(middles))[:, None] * middles[-1]
    return np.asarray(straight + gaussian_filter1d(middles - straight, SMOOTHED * fps, axis=0))


Rectangle = tuple[slice, slice]
"""Rows and columns of a picture."""

LETTERS = 1 / 32
"""Height of letters, as a fraction of the picture's."""

SMALLEST_PANEL = 24
"""Smallest side of a panel, in pixels."""

STRIP = 2.0
"""Height of a line with its margins, in letters."""


def panels_of(
    count: int, width: int, height: int, aspect: float, named: bool, barred: bool
) -> list[Rectangle]:
    """Divide a picture into equal panels, with as many columns as make meshes of an aspect largest."""
    strip = line_height(height)
    free = height - strip * barred

    def room(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, (free / rows - strip * named) / aspect)

    columns = max(range(1, count + 1), key=room)
    rows = -(-count // columns)
    if min(width // columns, free // rows - strip * named) < SMALLEST_PANEL:
        raise SettingsError(
            f"{count} panels are too many for a picture of {width}x{height} pixels; give a larger size"
        )
    panels = []
    for row, column in (divmod(number, columns) for number in range(count)):
        left, right = column * width // columns, (column + 1) * width // columns
        upper, lower = row * free // rows + strip * named, (row + 1) * free // rows
        panels.append((slice(upper, lower), slice(left, right)))
    return panels


def line_height(height: int) -> int:
    """Return the height of a line of text in pixels, for a picture of some height."""
    return round(STRIP * _letters(height))


def _letters(height: int) -> int:
    return max(9, round(LETTERS * height))


def backdrop_of(
    width: int,
    height: int,
    panels: Sequence[Rectangle],
    names: Sequence[str],
    palette: Float | None = None,
    top: float = 0.0,
    meaning: str = "",
) -> Picture:
    """Draw names above the panels, and with a palette ``(n, 3)`` the colour bar from 0 to `top` below them."""
    image = pillow_module("Image").fromarray(blank(width, height))
    draw = pillow_module("ImageDraw").Draw(image)
    font, strip = _font(_letters(height)), line_height(height)
    for (rows, columns), name in zip(panels, names, strict=True):
        if name:
            room = columns.stop - columns.start - strip
            middle = (columns.start + columns.stop) / 2
            draw.text((middle, rows.start - strip / 2), _shortened(name, font, room), INK_COLOUR, font, "mm")
    if palette is not None:
        _draw_bar(image, draw, font, palette, top, meaning)
    return np.array(image)


def _draw_bar(
    image: Any, draw: ImageDraw, font: FreeTypeFont, palette: Float, top: float, meaning: str
) -> None:
    width, height = image.size
    strip, letters = line_height(height), _letters(height)
    long, thick = width // 4, max(4, letters // 2)
    middle, left = height - strip / 2, (width - long) // 2
    bar = palette[np.arange(long) * len(palette) // long]
    rows = np.broadcast_to(np.rint(255 * bar).astype(np.uint8), (thick, long, 3))
    upper = round(middle - thick / 2)
    image.paste(pillow_module("Image").fromarray(np.ascontiguousarray(rows)), (left, upper))
    draw.text((left - letters / 2, middle), "0", INK_COLOUR, font, "rm")
    draw.text((left + long + letters / 2, middle), f"{two_digits(top)} {meaning}", INK_COLOUR, font, "lm")


def _font(size: int) -> FreeTypeFont:
    """Return the font of the charts, from matplotlib, with equal layout on all machines."""
    folder = Path(import_matplotlib("_api").__file__).parents[1] / "mpl-data" / "fonts" / "ttf"
    fonts = pillow_module("ImageFont")
    font: FreeTypeFont = fonts.truetype(folder / "DejaVuSans.ttf", size, layout_engine=fonts.Layout.BASIC)
    return font


def _shortened(text: str, font: FreeTypeFont, room: float) -> str:
    """Return a text with its middle left out if it is too long."""
    kept = len(text)
    short = text
    while kept > 2 and font.getlength(short) > room:
        kept -= 1
        short = f"{text[: kept - kept // 2]}…{text[len(text) - kept // 2 :]}"
    return short


HEAT_CONTRAST = 0.25
"""Strength of the shading under measured colours, as on paper."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel of a film."""

    header: SequenceHeader  # the mesh
    colours: ArrayLike  # (3,) RGB in 0..1 of the mesh or of each face, where nothing is measured
    camera: Camera  # from where, in the proportions of the panel
    place: Rectangle  # where it is in the picture


@dataclass(frozen=True, eq=False)
class Layout:
    """The static data of all frames of a film."""

    panels: Sequence[Panel]  # from left to right, and down
    backdrop: Picture  # (H, W, 3) what does not change: names and the colour bar
    palette: Float | None = None  # (256, 3) colours of what is measured, RGB in 0..1


Moment = tuple[int, list[tuple[Float, Bytes | None]]]
"""A frame number, and for each mesh its points ``(V, 3)`` and, if measured, palette entries ``(V,)``."""


def moments(
    items: Sequence[DecodedItem], colourings: Sequence[Colouring], times: Float, frames: Iterable[int]
) -> Iterator[Moment]:
    """Yield the data of film frames at times ``(N,)``."""
    for frame in frames:
        seen: list[tuple[Float, Bytes | None]] = []
        for item, colouring in zip(items, colourings, strict=True):
            points = item.pose(frame)
            entries = None if colouring.constant else colouring.indices(points, float(times[frame]))
            seen.append((points, entries))
        yield frame, seen


def draw_moment(layout: Layout, moment: Moment) -> Picture:
    """Draw a frame of a film ``(H, W, 3)``."""
    frame, seen = moment
    picture = layout.backdrop.copy()
    for panel, (points, entries) in zip(layout.panels, seen, strict=True):
        faces, camera = panel.header.faces, panel.camera
        colours, contrast = panel.colours, 1.0
        if entries is not None and layout.palette is not None:
            colours, contrast = layout.palette[entries[faces]], HEAT_CONTRAST
        centre = camera.centres[frame]
        world = to_y_up(points, panel.header.up_axis) - centre
        view = camera.at(frame)
        ground = float(camera.ground - centre[1])
        render_mesh(picture[panel.place], world, faces, view, camera.limits, colours, ground, contrast)
    return picture
