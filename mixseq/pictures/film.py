"""Draw films of meshes side by side, with a camera that can rotate around the meshes or follow a body.

A frame has one panel per mesh, on a static backdrop with names and the colour bar.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter1d

from mixseq.choices import COLOURS, Colour
from mixseq.errors import SettingsError
from mixseq.pictures.charts import import_matplotlib
from mixseq.pictures.colours import Colouring, ReferencePose, format_two_digits, make_colouring, match_original
from mixseq.pictures.film_encoding import check_film, encode_film, film_format, import_pillow
from mixseq.pictures.raster import Picture, blank_picture, render_mesh
from mixseq.pictures.scene import (
    INK_COLOUR,
    Camera,
    DecodedItem,
    Scene,
    SceneItem,
    check_start_times,
    nearest_frames,
    resolve_view,
    shared_limits,
    to_y_up,
)
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.sequence import Frames, FrameStore
from mixseq.types import ByteArray, Float

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont


_SCALE_UNITS = {"error": ("diagonals", 1.0), "strain": ("strain", 100.0), "curvature": ("degrees", 1.0)}
"""Units of colour scales in film settings, each with its factor to the unit of the `Colouring`."""


@dataclass(frozen=True)
class FilmSettings:
    """Settings of a film."""

    size: tuple[int, int] = (1280, 720)  # width and height in pixels
    fps: float | None = None  # frames per second; by default the rate of the first mesh
    seconds: float | None = None  # duration; by default that of the longest sequence, or 4 s for single poses
    turn: float = 0.0  # rotation of the camera about the meshes during the film, in degrees
    # Azimuth from the front to the body's left and elevation, in degrees; by default `three_quarter_view`.
    camera: tuple[float, float] | None = None
    follow: bool = False  # whether the camera follows bodies that travel
    colour: Colour = "clay"  # colouring of the meshes
    # End of the colour scale in `_SCALE_UNITS`; by default the largest value in the film.
    scale: float | None = None

    def __post_init__(self) -> None:
        if self.colour not in COLOURS:
            raise SettingsError(f"the colour is {self.colour!r}; choose one of {', '.join(COLOURS)}")
        for name, value in (("fps", self.fps), ("the duration", self.seconds), ("the scale", self.scale)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SettingsError(f"{name} is {value}; a positive number is expected")
        if not np.isfinite(self.turn):
            raise SettingsError(f"the turn is {self.turn}; a number of degrees is expected")
        if self.camera is not None and not np.all(np.isfinite(self.camera)):
            raise SettingsError(f"the camera is at {self.camera}; two numbers of degrees are expected")
        if self.scale is not None and self.colour not in _SCALE_UNITS:
            raise SettingsError(
                "only the colours error, strain and curvature have a scale; choose one of them, or leave the scale out"
            )


def film(
    target: str | PathLike[str],
    shown: Sequence[SceneItem],
    settings: FilmSettings | None = None,
    against: Frames | FrameStore | None = None,
    progress: Progress = log_progress,
    workers: Executor | None = None,
) -> None:
    """Make a film of meshes side by side, as .mp4 (by ffmpeg), .gif or .webp; an old file is replaced at the end.

    Frames are drawn on several threads; the file does not depend on their number. `against` is the original for the
    colour "error"; if it is given, poses are shown only at the times of its frames.
    """
    settings = settings or FilmSettings()
    file_format = film_format(target)
    check_film(file_format, settings.size, settings.fps)
    check_shown(shown, settings, against)
    executor = workers or thread_executor()
    items = tuple(item.with_random_access(progress) for item in shown)
    scene = Scene(items, settings.fps, settings.seconds)
    times, fps = scene.times, scene.fps
    check_film(file_format, settings.size, fps)
    original = None
    if against is not None:
        original = SceneItem("the original", against).with_random_access(progress)
        check_start_times(items, original.header)
        times = original.elapsed[nearest_frames(original.header, times)]
    decoded = [item.decode(times, progress, executor) for item in items]
    colourings = _colourings(items, decoded, settings.colour, original)
    colourings = _with_common_scale(colourings, decoded, times, settings)
    layout = _make_layout([item.name for item in items], decoded, colourings, settings, times, fps)

    def draw(frames: Iterable[int]) -> Iterator[Picture]:
        for drawn_count, picture in enumerate(executor(draw_frame, layout, frames), 1):
            yield picture
            progress(drawn_count, len(times), "drawing frames")

    encode_film(Path(target), file_format, draw, len(times), fps)


def check_shown(shown: Sequence[SceneItem], settings: FilmSettings, against: object) -> None:
    """Raise SettingsError if the items cannot be shown with the settings."""
    if not shown:
        raise SettingsError("there is no mesh to show; give a sequence or a model")
    if settings.colour == "error" and against is None:
        raise SettingsError("the colour error needs the original; give the sequence that errors are measured against")
    if settings.colour != "error" and against is not None:
        raise SettingsError("only the colour error needs the original; leave it out, or choose that colour")
    if settings.colour == "values" and any(item.values is None for item in shown):
        raise SettingsError("the colour values needs numbers of the vertices; give --scalar, or values of the items")
    if settings.colour == "parts":
        _parts(shown)


def _parts(shown: Sequence[SceneItem]) -> list[Decomposition]:
    """Return the parts of each item; an item without parts uses parts of an item with the same triangles."""
    known = [(item.header.faces, item.decomposition) for item in shown]
    result = []
    for item in shown:
        same_faces = (parts for faces, parts in known if parts and np.array_equal(faces, item.header.faces))
        parts = item.decomposition or next(same_faces, None)
        if parts is None:
            raise SettingsError(f"{item} has no parts; give a model in the mixed space, or choose another colour")
        result.append(parts)
    return result


def _colourings(
    items: Sequence[SceneItem], decoded: Sequence[DecodedItem], colour: Colour, original: SceneItem | None
) -> list[Colouring]:
    """Return the colouring of each item; values are relative to its first frame or to the original."""
    parts = _parts(items) if colour == "parts" else [None] * len(items)
    for item in items:
        if colour == "own" and item.header.surface.colours is None:
            raise SettingsError(f"{item} has no vertex colours; choose another colour")
    references = [None if original is None else _reference_pose(item, original) for item in items]
    diagonal = original.motion.diagonal if original and isinstance(original.motion, FrameStore) else None
    return [
        make_colouring(colour, item.header, pose.pose(0), item_parts, reference, diagonal, item.values)
        for item, pose, item_parts, reference in zip(items, decoded, parts, references, strict=True)
    ]


def _reference_pose(item: SceneItem, original: SceneItem) -> ReferencePose:
    """Return the pose of the original in the numbers of an item; raise SettingsError if it is another mesh."""
    vertex_ids = match_original(original.header, item.header, str(item))
    return lambda elapsed: original.exact_pose(elapsed)[vertex_ids]


def _with_common_scale(
    colourings: list[Colouring], items: Sequence[DecodedItem], times: Float, settings: FilmSettings
) -> list[Colouring]:
    """Return the colourings with one scale, which ends at `settings.scale` or at the largest value in the film."""
    if settings.colour not in _SCALE_UNITS:
        return colourings
    _, unit = _SCALE_UNITS[settings.colour]
    top = unit * settings.scale if settings.scale else 1e-12 * unit  # above rounding errors
    if settings.scale is None:
        for item, colouring in zip(items, colourings, strict=True):
            ends = (colouring.scale_end(item.pose(frame), float(time)) for frame, time in enumerate(times))
            top = max(top, *ends)
    return [colouring.with_top(top) for colouring in colourings]


def _make_layout(
    names: Sequence[str],
    items: Sequence[DecodedItem],
    colourings: Sequence[Colouring],
    settings: FilmSettings,
    times: Float,
    fps: float,
) -> Layout:
    width, height = settings.size
    unit, unit_size = _SCALE_UNITS.get(settings.colour, ("", 1.0))
    has_bar = not colourings[0].is_constant
    cameras = make_cameras(items, settings, fps)
    aspect = float(np.median([camera.aspect for camera in cameras]))
    rectangles = divide_picture(len(items), width, height, aspect, any(names), has_bar)
    panels = []
    for item, colouring, camera, rectangle in zip(items, colourings, cameras, rectangles, strict=True):
        rows, columns = rectangle
        panel_camera = camera.with_aspect((rows.stop - rows.start) / (columns.stop - columns.start))
        panels.append(Panel(item, colouring, panel_camera, rectangle))
    low, top = colourings[0].low / unit_size, colourings[0].top / unit_size
    bar = (colourings[0].palette, low, top, unit) if has_bar else ()
    return Layout(panels, draw_backdrop(width, height, rectangles, names, *bar), times)


def make_cameras(items: Sequence[DecodedItem], settings: FilmSettings, fps: float) -> list[Camera]:
    """Return the camera of each item; items with the same faces as the first item share a camera."""
    groups: dict[int, list[DecodedItem]] = {}
    group_of = []
    for number, item in enumerate(items):
        is_same = number > 0 and np.array_equal(item.header.faces, items[0].header.faces)
        group_of.append(0 if is_same else number)
        groups.setdefault(group_of[-1], []).append(item)
    with one_blas_thread():
        cameras = {number: _make_camera(group, settings, fps) for number, group in groups.items()}
    return [cameras[number] for number in group_of]


def _make_camera(items: Sequence[DecodedItem], settings: FilmSettings, fps: float) -> Camera:
    first_item, frame_count = items[0], len(items[0].pose_of_frame)
    path = travel_path(first_item, fps) if settings.follow else np.zeros((frame_count, 3))
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for item in items:
        for frame in range(frame_count) if settings.follow else item.frames_of_new_poses.tolist():
            world = to_y_up(item.pose(frame), item.header.up_axis) - path[frame]
            low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    ground = float(low[1])
    ends = np.stack([first_item.pose(0), first_item.pose(frame_count - 1)])
    view = resolve_view(ends, first_item.header.up_axis, settings.camera)
    camera = Camera(view, settings.turn, path + (low + high) / 2, ground, (0.0, 1.0, 0.0, 1.0))
    limits = []
    for item in items:
        is_moving = settings.turn or settings.follow
        for frame in range(frame_count) if is_moving else item.frames_of_new_poses.tolist():
            centre = camera.centres[frame]
            world = to_y_up(item.pose(frame), item.header.up_axis) - centre
            ground_point = np.array([[0, ground - centre[1], 0]])
            limits.append(shared_limits(np.concatenate([world, ground_point]), "Y", camera.view_at(frame)))
    left, right, bottom, top = zip(*limits, strict=True)
    return replace(camera, limits=(min(left), max(right), min(bottom), max(top)))


def travel_path(item: DecodedItem, fps: float) -> Float:
    """Return the ground path ``(N, 3)`` of a mesh, Y up, from its first position, smoothed over 0.25 s."""
    centroids = np.stack(
        [to_y_up(item.pose(frame), item.header.up_axis).mean(axis=0) for frame in range(len(item.pose_of_frame))]
    )
    centroids = (centroids - centroids[0]) * [1, 0, 1]
    line = np.linspace(0, 1, len(centroids))[:, None] * centroids[-1]
    return np.asarray(line + gaussian_filter1d(centroids - line, 0.25 * fps, axis=0))


Rectangle = tuple[slice, slice]
"""Row slice and column slice of a rectangle in a picture."""


def divide_picture(
    count: int, width: int, height: int, aspect: float, has_names: bool, has_colour_bar: bool
) -> list[Rectangle]:
    """Divide a picture into equal panels; choose the number of columns that maximizes the size of the meshes."""
    line = line_height(height)
    panels_height = height - line * has_colour_bar

    def mesh_width(columns: int) -> float:
        rows = -(-count // columns)
        return min(width / columns, (panels_height / rows - line * has_names) / aspect)

    columns = max(range(1, count + 1), key=mesh_width)
    rows = -(-count // columns)
    if min(width // columns, panels_height // rows - line * has_names) < 24:
        raise SettingsError(f"{count} panels do not fit in {width}x{height} pixels; give a larger size")
    panels = []
    for row, column in (divmod(number, columns) for number in range(count)):
        left, right = column * width // columns, (column + 1) * width // columns
        upper, lower = row * panels_height // rows + line * has_names, (row + 1) * panels_height // rows
        panels.append((slice(upper, lower), slice(left, right)))
    return panels


def line_height(height: int) -> int:
    """Return the height of a text line with margins, in pixels, in a picture of the given height."""
    return 2 * _font_size(height)


def _font_size(height: int) -> int:
    return max(9, round(height / 32))


def draw_backdrop(
    width: int,
    height: int,
    panels: Sequence[Rectangle],
    names: Sequence[str],
    palette: ByteArray | None = None,
    low: float = 0.0,
    top: float = 0.0,
    unit: str = "",
) -> Picture:
    """Draw names above the panels, and below the panels a colour bar of a palette ``(n, 3)`` from `low` to `top`."""
    image = import_pillow("Image").fromarray(blank_picture(width, height))
    draw = import_pillow("ImageDraw").Draw(image)
    font, line = _font(_font_size(height)), line_height(height)
    for (rows, columns), name in zip(panels, names, strict=True):
        if name:
            text = _shorten(name, font, columns.stop - columns.start - line)
            centre = (columns.start + columns.stop) / 2
            draw.text((centre, rows.start - line / 2), text, INK_COLOUR, font, "mm")
    if palette is not None:
        _draw_colour_bar(image, draw, font, palette, (low, top), unit)
    return np.array(image)


def _draw_colour_bar(
    image: Any, draw: ImageDraw, font: FreeTypeFont, palette: ByteArray, ends: tuple[float, float], unit: str
) -> None:
    width, height = image.size
    line, font_size = line_height(height), _font_size(height)
    low, top = map(format_two_digits, ends)
    bar_width, bar_height = width // 4, max(4, font_size // 2)
    centre, left = height - line / 2, (width - bar_width) // 2
    bar = palette[np.arange(bar_width) * len(palette) // bar_width]
    pixels = np.broadcast_to(bar, (bar_height, bar_width, 3))
    upper = round(centre - bar_height / 2)
    image.paste(import_pillow("Image").fromarray(np.ascontiguousarray(pixels)), (left, upper))
    draw.text((left - font_size / 2, centre), low, INK_COLOUR, font, "rm")
    end, label = left + bar_width + font_size / 2, f"{top} {unit}"
    draw.text((end, centre), label, INK_COLOUR, font, "lm")


def _font(size: int) -> FreeTypeFont:
    """Return matplotlib's default font, with the same text layout on all machines."""
    folder = Path(import_matplotlib("_api").__file__).parents[1] / "mpl-data" / "fonts" / "ttf"
    fonts = import_pillow("ImageFont")
    font: FreeTypeFont = fonts.truetype(folder / "DejaVuSans.ttf", size, layout_engine=fonts.Layout.BASIC)
    return font


def _shorten(text: str, font: FreeTypeFont, max_width: float) -> str:
    """Replace the middle of a text by an ellipsis if the text is wider than `max_width` pixels."""
    length = len(text)
    shortened = text
    while length > 2 and font.getlength(shortened) > max_width:
        length -= 1
        shortened = f"{text[: length - length // 2]}…{text[len(text) - length // 2 :]}"
    return shortened


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel of a film."""

    item: DecodedItem  # poses of the mesh
    colouring: Colouring  # colours of the mesh
    camera: Camera  # camera with the aspect ratio of the panel
    rectangle: Rectangle  # position in the picture


@dataclass(frozen=True, eq=False)
class Layout:
    """Data that all frames of a film share."""

    panels: Sequence[Panel]  # panels row by row, from left to right
    backdrop: Picture  # (H, W, 3) picture of names and colour bar
    times: Float  # (N,) times of the frames


def draw_frame(layout: Layout, frame: int) -> Picture:
    """Draw a frame of a film as a picture ``(H, W, 3)``."""
    picture = layout.backdrop.copy()
    for panel in layout.panels:
        camera, colouring, header = panel.camera, panel.colouring, panel.item.header
        points, centre = panel.item.pose(frame), camera.centres[frame]
        colours, contrast = colouring.face_colours, 1.0
        if not colouring.is_constant:
            entries = colouring.entries(points, float(layout.times[frame]))
            colours, contrast = (colouring.palette / 255)[entries[header.faces]], 0.25  # colours stay readable
        world = to_y_up(points, header.up_axis) - centre
        view, ground = camera.view_at(frame), float(camera.ground - centre[1])
        render_mesh(picture[panel.rectangle], world, header.faces, view, camera.limits, colours, ground, contrast)
    return picture
