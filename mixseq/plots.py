"""Pictures of mesh sequences, drawn in software with matplotlib (the extra ``plot``).

A mesh is one collection of shaded polygons, sorted by depth: no graphics card, no global pyplot state. All
panels of a sheet share one camera and one set of limits, so that they can be compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import IO, TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from mixseq.errors import MissingExtraError, SettingsError
from mixseq.sequence import UP_AXES, FloatArray, IntArray, MeshSequence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Limits = tuple[float, float, float, float]
Target = str | PathLike[str] | IO[bytes]

DPI = 150
CLAY = (0.80, 0.77, 0.72)
JOINT_RED = (0.85, 0.20, 0.13)
INK = "#3a3a3a"


@dataclass(frozen=True)
class View:
    """An orthographic camera that circles the mesh.

    Parameters
    ----------
    azimuth : float
        Degrees around the up axis. With Y up, 0 looks along -z at a mesh whose +x points right.
    elevation : float
        Degrees above the horizon.
    """

    azimuth: float = 30.0
    elevation: float = 14.0

    @property
    def rows(self) -> Array:
        """Rotation ``(3, 3)`` from a Y-up world to the screen: right, up, towards the camera."""
        a, e = np.radians([self.azimuth, self.elevation])
        around = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        above = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return np.asarray(above @ around)


def broadside(points: FloatArray, up_axis: str = "Y", turn: float = 30.0, elevation: float = 14.0) -> View:
    """Return a three-quarter view: ``turn`` degrees away from seeing the longer horizontal side.

    Parameters
    ----------
    points : (..., V, 3) float
        One pose, or all poses of a sequence.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    turn, elevation : float
        Degrees.
    """
    sides = np.ptp(_y_up(points, up_axis).reshape(-1, 3), axis=0)
    return View(turn if sides[0] >= sides[2] else 90.0 - turn, elevation)


def shared_limits(
    points: FloatArray, up_axis: str = "Y", view: View | None = None, margin: float = 0.04
) -> Limits:
    """Return the screen rectangle that holds all poses and their shadows.

    Parameters
    ----------
    points : (..., V, 3) float
        One pose or many.
    up_axis, view
        As for `draw_mesh`.
    margin : float
        Space around, as a share of the larger side.

    Returns
    -------
    left, right, bottom, top : float
        In units of the points.
    """
    world = _y_up(points, up_axis).reshape(-1, 3)
    shadow = world * [1, 0, 1] + [0, world[:, 1].min(), 0]
    screen = np.concatenate([world, shadow]) @ (view or broadside(points, up_axis)).rows.T
    low, high = screen.min(axis=0), screen.max(axis=0)
    space = margin * float(max(high[0] - low[0], high[1] - low[1]))
    return low[0] - space, high[0] + space, low[1] - space, high[1] + space


def draw_mesh(
    ax: Axes,
    points: FloatArray,
    faces: IntArray,
    colours: ArrayLike | None = None,
    up_axis: str = "Y",
    view: View | None = None,
    limits: Limits | None = None,
    ground: float | None = None,
    contrast: float = 1.0,
) -> None:
    """Draw a shaded mesh.

    Parameters
    ----------
    ax : matplotlib Axes
        Where to draw; its aspect becomes equal and its frame disappears.
    points : (V, 3) float
        Vertex positions.
    faces : (F, 3) int
        Triangles. Back faces of a closed mesh are left out, an open mesh is shown from both sides.
    colours : (3,) or (F, 3) float, optional
        RGB in 0..1 of the mesh or of each face.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    view : View, optional
        The camera, by default `broadside`.
    limits : (4,) float, optional
        Screen rectangle from `shared_limits`, by default that of this pose.
    ground : float, optional
        Height of the ground that takes the shadow, by default the lowest vertex.
    contrast : float
        Strength of the shading, from 0 (flat colours) to 1.
    """
    PolyCollection = _plotting("collections").PolyCollection  # noqa: N806
    view = view or broadside(points, up_axis)
    limits = limits or shared_limits(points, up_axis, view)
    world = _y_up(points, up_axis)
    screen = world @ view.rows.T
    corners = screen[faces]

    towards = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside_out = np.sum((corners[:, 0] - screen.mean(axis=0)) * towards) < 0
    hidden = (towards[:, 2] >= 0) if inside_out else (towards[:, 2] <= 0)
    depth = corners[..., 2].mean(axis=1)
    # where the back faces of an open mesh are shown, front faces next to them at the outline go on top
    depth = np.where(hidden, depth - 0.03 * np.ptp(screen[:, 2]), depth)
    order = np.argsort(depth, kind="stable")
    if _is_closed(faces):
        order = order[~hidden[order]]

    rgb = np.broadcast_to(np.asarray(CLAY if colours is None else colours, dtype=np.float64), (len(faces), 3))
    normals = np.where(towards[:, 2:] < 0, -1, 1) * _smooth_normals(towards, faces, len(points))
    lit = _shade(rgb, normals, contrast)[order]
    floor = float(world[:, 1].min()) if ground is None else ground
    _draw_shadow(ax, world, faces, floor, view, limits)
    ax.add_collection(
        PolyCollection(corners[order, :, :2], facecolors=lit, edgecolors=lit, linewidths=0.25, zorder=2),
        autolim=False,
    )
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
    ax.set_axis_off()


def part_colours(count: int) -> Array:
    """Return muted, well-distinguishable colours ``(count, 3)``, never as red as the joints.

    Hues advance by the golden angle, so that parts with near numbers look different.
    """
    index = np.arange(count)
    hue = 65 + 275 * np.asarray(index * 0.61803 % 1.0, dtype=np.float64)
    return _oklch(np.choose(index % 3, [0.78, 0.68, 0.85]), 0.085, hue)


def segmentation_colours(part_of_face: IntArray, joint_of_face: IntArray) -> Array:
    """Return a colour ``(F, 3)`` for each face: its part's, or a warm red where it bends.

    Parameters
    ----------
    part_of_face : (F,) int
        Rigid part of each face.
    joint_of_face : (F,) int
        Joint of each face; -1 where the face is rigid.
    """
    parts = np.asarray(part_of_face)
    colours = part_colours(max(int(parts.max(initial=-1)) + 1, 1))[np.maximum(parts, 0)]
    colours[np.asarray(joint_of_face) >= 0] = JOINT_RED
    return colours


def contact_sheet(
    target: Target,
    original: MeshSequence,
    decoded: MeshSequence,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    frames: int = 6,
    title: str | None = None,
) -> None:
    """Draw original, parts, reconstruction and error side by side, as a PNG.

    Columns are frames that both sequences have. If `decoded` also has frames half-way to the next original
    one, an additional row shows those.

    Parameters
    ----------
    target : path or binary file
        Where the PNG goes.
    original, decoded : MeshSequence
        The same mesh; times may differ.
    part_of_face, joint_of_face : (F,) int
        As for `segmentation_colours`.
    frames : int
        Number of columns.
    title : str, optional
        Heading, by default the name of `original`.

    Raises
    ------
    SettingsError
        If the meshes differ, or the sequences have no time in common.
    """
    if not np.array_equal(original.faces, decoded.faces):
        raise SettingsError(
            "original and decoded have different faces; a sheet compares one mesh with itself"
        )
    here, there = _common_frames(original, decoded, frames)
    between = [_frame_between(original, decoded, frame) for frame in here]

    errors = np.linalg.norm(decoded.points[there].astype(np.float64) - original.points[here], axis=2)
    errors /= max(original.diagonal, 1e-300)
    scale = _plotting("colors").Normalize(0, max(float(errors.max()), float(np.finfo(np.float64).eps)))
    heat_map = _plotting("cm").ScalarMappable(scale, "viridis")
    heat = [heat_map.to_rgba(error[original.faces].mean(axis=1))[:, :3] for error in errors]

    parts = segmentation_colours(part_of_face, joint_of_face)
    count = len(here)
    rows: list[_Row] = [
        _Row("original", original, here, [None] * count),
        _Row("parts and\njoints", original, here, [parts] * count),
        _Row("reconstruction", decoded, there, [None] * count),
        _Row("vertex error", decoded, there, heat, contrast=0.25),
    ]
    if any(frame is not None for frame in between):
        rows.insert(3, _Row("in between\n(new frames)", decoded, between, [None] * count, show_times=True))

    view = broadside(original.points[0], original.up_axis)
    shown = np.concatenate(
        [original.points[here], decoded.points[[f for f in [*there, *between] if f is not None]]]
    )
    ground = float(_y_up(shown, original.up_axis)[..., 1].min())
    limits = shared_limits(shown, original.up_axis, view)
    figure, panels, bar = _sheet(len(rows), count, limits, f"{title or original.name}")
    for row, axes in zip(rows, panels, strict=True):
        for frame, colours, ax in zip(row.frames, row.colours, axes, strict=True):
            ax.set_axis_off()
            if frame is None:
                continue
            draw_mesh(
                ax,
                row.sequence.points[frame],
                original.faces,
                colours,
                original.up_axis,
                view,
                limits,
                ground,
                row.contrast,
            )
            if row.show_times or row is rows[0]:
                ax.set_title(f"{row.sequence.times[frame]:.3f} s", fontsize=9, color=INK, pad=2)
        axes[0].annotate(
            row.label,
            (0, 0.5),
            (-8, 0),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=10,
            color=INK,
        )
    _colour_bar(figure, heat_map, bar)
    _save(figure, target)


def draw_segmentation(
    target: Target,
    points: FloatArray,
    faces: IntArray,
    part_of_face: IntArray,
    joint_of_face: IntArray,
    up_axis: str = "Y",
    title: str | None = None,
) -> None:
    """Draw the parts and joints of one pose from two opposite sides, as a PNG.

    Parameters
    ----------
    target : path or binary file
        Where the PNG goes.
    points : (V, 3) float
        The pose.
    faces : (F, 3) int
        Triangles.
    part_of_face, joint_of_face : (F,) int
        As for `segmentation_colours`.
    up_axis : {"X", "Y", "Z"}
        Axis that points up.
    title : str, optional
        Heading.
    """
    colours = segmentation_colours(part_of_face, joint_of_face)
    near = broadside(points, up_axis)
    views = near, View(near.azimuth + 180, near.elevation)
    boxes = np.array([shared_limits(points, up_axis, view) for view in views])
    # both panels get the width and height of the larger one, about their own centres
    size = (boxes[:, 1::2] - boxes[:, ::2]).max(axis=0)
    centres = (boxes[:, 1::2] + boxes[:, ::2]) / 2
    figure, panels, _ = _sheet(1, 2, (0.0, size[0], 0.0, size[1]), title or "", left=0.1, right=0.1)
    for ax, view, centre in zip(panels[0], views, centres, strict=True):
        low, high = centre - size / 2, centre + size / 2
        draw_mesh(ax, points, faces, colours, up_axis, view, (low[0], high[0], low[1], high[1]))
    _save(figure, target)


# ---- sheets --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Row:
    """A row of a contact sheet: which frames of which sequence, and in which colours."""

    label: str
    sequence: MeshSequence
    frames: Sequence[int | None]
    colours: Sequence[Array | None]
    contrast: float = 1.0
    show_times: bool = False


def _common_frames(original: MeshSequence, decoded: MeshSequence, count: int) -> tuple[list[int], list[int]]:
    """Pick up to ``count`` evenly spread frames of the original, and the decoded ones at the same times."""
    nearest = np.abs(decoded.times[None] - original.times[:, None]).argmin(axis=1)
    gap = np.abs(decoded.times[nearest] - original.times)
    common = np.flatnonzero(gap < 1e-3 / max(original.fps, decoded.fps))
    if not common.size:
        raise SettingsError(
            "original and decoded have no frame at the same time; decode at the original's times"
        )
    # all, or as of a loop: evenly, without the last one
    chosen = common if len(common) <= count else common[np.arange(count) * len(common) // count]
    return chosen.tolist(), nearest[chosen].tolist()


def _frame_between(original: MeshSequence, decoded: MeshSequence, frame: int) -> int | None:
    """Return the decoded frame about half-way from an original frame to the next, if there is one."""
    if frame + 1 >= original.frame_count:
        return None
    start, end = original.times[frame : frame + 2]
    nearest = int(np.abs(decoded.times - (start + end) / 2).argmin())
    inside = abs(decoded.times[nearest] - (start + end) / 2) < 0.3 * (end - start)
    return nearest if inside else None


def _sheet(
    rows: int, columns: int, limits: Limits, title: str, left: float = 1.25, right: float = 1.0
) -> tuple[Figure, list[list[Axes]], tuple[float, float, float, float]]:
    """Lay out a figure 12 inches wide whose panels have the shape of ``limits``.

    Returns the figure, its panels by row, and the place for a colour bar beside the last row.
    """
    inches = 12.0
    top, gap, bottom = (0.65 if title else 0.3), 0.15, 0.1
    width = (inches - left - right) / columns
    height = width * float(np.clip((limits[3] - limits[2]) / max(limits[1] - limits[0], 1e-300), 0.3, 2.5))
    tall = top + rows * height + (rows - 1) * gap + bottom

    figure: Figure = _plotting("figure").Figure(figsize=(inches, tall), facecolor="white")
    _plotting("backends.backend_agg").FigureCanvasAgg(figure)
    if title:
        figure.text(0.1 / inches, 1 - 0.1 / tall, title, fontsize=13, color=INK, va="top")

    def place(row: int, x: float, w: float, shrink: float = 1.0) -> tuple[float, float, float, float]:
        y = tall - top - (row + 1) * height - row * gap + height * (1 - shrink) / 2
        return x / inches, y / tall, w / inches, height * shrink / tall

    panels = [
        [figure.add_axes(place(row, left + column * width, width)) for column in range(columns)]
        for row in range(rows)
    ]
    return figure, panels, place(rows - 1, inches - right + 0.08, 0.12, 0.8)


def _colour_bar(figure: Figure, mappable: Any, place: tuple[float, float, float, float]) -> None:
    """Add a colour bar of errors in scientific notation."""
    ticker = _plotting("ticker")
    bar = figure.colorbar(mappable, cax=figure.add_axes(place), ticks=ticker.LinearLocator(3))
    bar.ax.yaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:.1e}" if value else "0"))
    bar.ax.tick_params(labelsize=7, colors=INK, length=2)
    bar.outline.set_visible(False)
    bar.set_label("vertex error / diagonal", fontsize=7, color=INK)


def _save(figure: Figure, target: Target) -> None:
    """Write the PNG; without a date or version, so that equal pictures are equal files."""
    figure.savefig(target, format="png", dpi=DPI, metadata={"Software": None})


# ---- the camera and the light --------------------------------------------------------------------


def _y_up(points: FloatArray, up_axis: str) -> Array:
    """Rename the axes so that Y is up; right-handed stays right-handed."""
    up = UP_AXES.index(up_axis)
    return np.asarray(points[..., [(up - 1) % 3, up, (up + 1) % 3]], dtype=np.float64)


def _is_closed(faces: IntArray) -> bool:
    """Whether every directed edge of the triangles has exactly one opposite."""
    start, end = (
        np.asarray(faces, dtype=np.int64).ravel(),
        np.roll(faces, -1, axis=1).ravel().astype(np.int64),
    )
    base = int(faces.max()) + 1
    there, back = np.sort(start * base + end), np.sort(end * base + start)
    return bool(np.array_equal(there, back) and np.all(np.diff(there) > 0))


def _smooth_normals(area_normals: Array, faces: IntArray, vertex_count: int) -> Array:
    """Unit normals ``(F, 3)``: the mean of the vertex normals, which hides the facets."""
    sums = [np.bincount(faces.ravel(), np.repeat(column, 3), vertex_count) for column in area_normals.T]
    at_vertex = np.stack(sums, axis=1, dtype=np.float64)
    return _unit(_unit(at_vertex)[faces].mean(axis=1))


def _unit(vectors: Array) -> Array:
    """Scale vectors ``(N, 3)`` to length one; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def _shade(rgb: Array, normals: Array, contrast: float) -> Array:
    """Light colours ``(F, 3)`` by a key light from the upper left and a soft fill from above."""
    key = np.array([-0.45, 0.62, 0.64])
    light = 0.50 + 0.14 * normals[:, 1] + 0.52 * np.maximum(normals @ key, 0) + 0.06 * normals[:, 2]
    light = 1 + contrast * (light - 1)
    # shadows cool a little, as under an open sky
    tint = 1 - 0.10 * contrast * np.clip(1 - light, 0, 1)[:, None] * np.array([1.0, 0.6, 0.0])
    return np.asarray(np.clip(rgb * light[:, None] * tint, 0, 1))


def _draw_shadow(ax: Axes, world: Array, faces: IntArray, floor: float, view: View, limits: Limits) -> None:
    """Darken the ground beneath the mesh: the more, the closer the mesh is to it."""
    corners = world[faces]
    area = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1]) / 4
    centre = corners.mean(axis=1)
    size = max(float(np.ptp(world[:, 1])), 1e-300)
    weight = area * (0.25 + np.exp(-(centre[:, 1] - floor) / (0.10 * size)))
    centre[:, 1] = floor
    spot = centre @ view.rows.T

    left, right, bottom, top = limits
    bottom = min(bottom, float(spot[:, 1].min()) - 0.1 * size)
    pixel = (right - left) / 240
    if not pixel > 0:
        return
    bins = (max(int((top - bottom) / pixel), 1), 240)
    cover, *_ = np.histogram2d(
        spot[:, 1],
        spot[:, 0],
        bins=bins,
        range=[[bottom, bottom + bins[0] * pixel], [left, right]],
        weights=weight,
    )
    squash = max(np.sin(np.radians(view.elevation)), 0.05)
    blur = 0.035 * size / pixel
    cover = gaussian_filter(cover / (pixel**2 * squash), (max(blur * squash, 1), blur))
    shadow = np.zeros((*bins, 4))
    shadow[..., :3] = 0.25, 0.24, 0.28
    feather = np.clip(
        np.minimum(np.arange(240), 239 - np.arange(240)) / 16, 0, 1
    )  # no hard edge at the frame
    shadow[..., 3] = 0.42 * (1 - np.exp(-0.9 * cover)) * feather
    ax.imshow(
        shadow,
        extent=(left, right, bottom, bottom + bins[0] * pixel),
        origin="lower",
        interpolation="bilinear",
        zorder=1,
    )


def _oklch(lightness: Array, chroma: float, hue: Array) -> Array:
    """Convert OKLCH (Ottosson 2020; hue in degrees) to sRGB ``(N, 3)``."""
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    to_lms = np.array(
        [
            [1, 0.3963377774, 0.2158037573],
            [1, -0.1055613458, -0.0638541728],
            [1, -0.0894841775, -1.2914855480],
        ]
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip((np.stack([lightness, a, b], axis=-1) @ to_lms.T) ** 3 @ to_rgb.T, 0, 1)
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


def _plotting(module: str) -> Any:
    """Import a module of matplotlib when it is needed."""
    from importlib import import_module

    try:
        return import_module(f"matplotlib.{module}")
    except ImportError as error:
        raise MissingExtraError(
            "pictures need matplotlib; get it with: pip install 'mixseq[plot]'"
        ) from error
