"""Pictures of a model: charts of its signals, parts and joints, errors by frame and by vertex, alone or on one page.

The error of a vertex is its distance from the original in diagonals, :math:`|A_{tv} - B_{tv}| / d`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from mixseq.choices import PICTURES, PictureKind
from mixseq.errors import SettingsError
from mixseq.pictures.charts import (
    LINE_COLOURS,
    Format,
    chart_style,
    draw_coefficients,
    draw_embedding,
    draw_singular_values,
    embedding_limits,
    existing_frames,
    log_axis,
    new_page,
    picture_format,
    save_page,
    time_axis,
)
from mixseq.pictures.colours import INK_COLOUR, JOINT_RED, distances, part_colours, segmentation_colours
from mixseq.pictures.page import Target, draw_mesh, error_map, import_matplotlib
from mixseq.pictures.scene import Limits, View, aspect_ratio, resolve_view, to_y_up
from mixseq.pictures.sheets import opposite_views, views_aspect
from mixseq.runtime.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.frame_rates import frame_text
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase


ROUNDING = 1e-17
"""Smallest error drawn on the logarithmic axis, in diagonals; smaller ones are drawn there."""

_BLOCK = 8  # frames decoded at once


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Distances of vertices from their originals, in diagonals."""

    largest: Float  # (T,) largest error in every frame
    rms: Float  # (T,) root mean square over the vertices of every frame
    by_vertex: Float  # (V,) largest error of every vertex over all frames
    worst: int  # frame of the largest error
    by_frame: dict[int, Float]  # errors (V,) in single frames: those that were asked for, and the worst one


def vertex_errors(
    model: Model, original: MeshSequence, frames: Sequence[int] = (), progress: Progress = silent
) -> VertexErrors:
    """Measure a model at the times of a sequence, in blocks of frames."""
    if not np.array_equal(model.header.faces, original.faces):
        raise SettingsError(
            f"the model has {len(model.header.faces)} triangles of {model.header.vertex_count} vertices, the sequence "
            f"{len(original.faces)} of {original.vertex_count}, or in another order; errors need one mesh"
        )
    unit = original.diagonal or 1.0
    largest, rms = np.zeros(original.frame_count), np.zeros(original.frame_count)
    by_vertex = of_worst = np.zeros(original.vertex_count)
    kept: dict[int, Float] = {}
    worst = first = 0
    for block in model.blocks(original.times, _BLOCK, progress):
        for frame, points in enumerate(block, first):
            apart = distances(points, original.points[frame], unit)
            largest[frame], rms[frame] = apart.max(), np.sqrt(np.mean(np.square(apart)))
            by_vertex = np.maximum(by_vertex, apart)
            if frame in frames:
                kept[frame] = apart
            if frame == 0 or largest[frame] > largest[worst]:
                worst, of_worst = frame, apart
        first += len(block)
    return VertexErrors(largest, rms, by_vertex, worst, kept | {worst: of_worst})


def draw_frame_errors(
    ax: Axes,
    errors: VertexErrors,
    times: Float,
    tolerance: float | None = None,
    fps: float | None = None,
) -> None:
    """Draw the largest and the root mean square error of every frame over time: times ``(T,)``."""
    largest, rms = (np.maximum(values, ROUNDING) for values in (errors.largest, errors.rms))
    ax.plot(times, largest, "o-", color=LINE_COLOURS[0], markersize=3.5, linewidth=1.2, label="largest")
    ax.plot(times, rms, "o-", color=LINE_COLOURS[1], markersize=3.5, linewidth=1.2, label="root mean square")
    shown = [largest, rms]
    if tolerance is not None:
        ax.axhline(
            tolerance, color=INK_COLOUR, linestyle="--", linewidth=1.0, label=f"tolerance, {tolerance:g}"
        )
        shown.append(np.array([tolerance]))
    worst = errors.worst
    number = f"{worst}" if fps is None else frame_text(times[worst], fps)
    ax.plot(
        times[worst],
        largest[worst],
        "o",
        ms=9,
        mfc="none",
        mec=INK_COLOUR,
        clip_on=False,
        label=f"worst frame, {number}",
    )
    log_axis(ax, np.concatenate(shown))
    time_axis(ax, times[0], times[-1], fps)
    ax.set(title="Error per frame", ylabel="vertex error (diagonals)")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_vertex_errors(
    panels: Sequence[Sequence[Axes]],
    errors: VertexErrors,
    original: MeshSequence,
    frames: Sequence[int] | None = None,
    near: View | None = None,
) -> Any:
    """Draw errors as face colours from two opposite sides: maxima over all frames, then single frames.

    A face has the largest error of its corners. A ring marks the largest visible error of each row.
    """
    heat = error_map(max(errors.by_vertex.max(), ROUNDING))
    _, *single = rows = drawn_frames(errors, frames)
    values = [errors.by_vertex, *(errors.by_frame[frame] for frame in single)]
    titles = ["largest of all frames", *(_title(errors, original, frame) for frame in single)]
    sides = opposite_views(original.points[rows], original.up_axis, near)
    for axes, frame, error, title, pair in zip(panels, rows, values, titles, sides, strict=True):
        points, most = original.points[frame], int(error.argmax())
        colours = heat.to_rgba(error[original.faces].max(axis=1))[:, :3]
        for ax, (view, limits) in zip(axes, pair, strict=True):
            draw_mesh(ax, points, original.faces, colours, original.up_axis, view, limits, contrast=0.25)
            ax.set_rasterization_zorder(3)  # in SVG too: thousands of triangles are better pixels
            screen = to_y_up(points, original.up_axis) @ view.rotation.T
            if not _hidden(most, screen, original.faces):
                _ring(ax, screen[most])
        axes[0].set_title(f"Error per vertex: {title}\nmost at vertex {most}", fontsize=10)
    return heat


def drawn_frames(errors: VertexErrors, frames: Sequence[int] | None) -> list[int]:
    """Return the frames whose poses are drawn in the rows of `draw_vertex_errors`."""
    return [0, *([errors.worst] if frames is None else frames)]


def _title(errors: VertexErrors, original: MeshSequence, frame: int) -> str:
    which = "worst frame, " if frame == errors.worst else "frame "
    return f"{which}{original.frame_number(frame)} at {original.times[frame]:.3f} s"


def _ring(ax: Axes, place: Float) -> None:
    for colour, width in (("white", 3.5), (INK_COLOUR, 1.5)):
        ax.plot(place[0], place[1], "o", ms=12, mfc="none", mec=colour, mew=width, zorder=4)


def _hidden(vertex: int, screen: Float, faces: IntArray) -> bool:
    """Whether a triangle without the vertex is between it and the camera."""
    others = screen[faces[(faces != vertex).all(axis=1)]] - screen[vertex]
    (x, y, _), (u, v, _) = (np.moveaxis(np.roll(others, -step, axis=1), 2, 0) for step in (1, 2))
    # weights of the corners, times twice the area, of the point where the line of sight meets the plane
    weights = x * v - y * u
    area = weights.sum(axis=1)
    met = ((weights * area[:, None] >= 0).all(axis=1)) & (area != 0)
    heights = np.einsum("fc,fc->f", weights[met], others[met, :, 2]) / area[met]
    return bool((heights > 0).any())


def add_error_bar(page: FigureBase, panels: Sequence[Axes], heat: Any) -> None:
    """Add the colour bar of `draw_vertex_errors` beside panels."""
    bar = page.colorbar(heat, ax=panels, shrink=0.6, aspect=30, pad=0.02, label="vertex error (diagonals)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")
    bar.outline.set_visible(False)


LISTED = 60
"""Largest number of parts named in a legend."""

_PIXELS = 300
"""Width of the picture in which visible parts are searched."""

_ROOM = 4.0
"""Pixels around the middle of a number that it needs."""


def draw_parts(panels: Sequence[Axes], model: Model, points: FloatArray, near: View | None = None) -> None:
    """Draw a pose ``(V, 3)`` from two opposite sides, coloured by part, joints in red, with part numbers."""
    parts, header = model.decomposition, model.header
    colours = segmentation_colours(parts.part_of_face, parts.joint_of_face)
    path_effects = import_matplotlib("patheffects")
    halo = [path_effects.withStroke(linewidth=2, foreground="white")]
    numbered = np.where(parts.joint_of_face >= 0, -1, parts.part_of_face)
    for ax, (view, limits) in zip(panels, opposite_views(points[None], header.up_axis, near)[0], strict=True):
        draw_mesh(ax, points, header.faces, colours, header.up_axis, view, limits)
        ax.set_rasterization_zorder(3)  # in SVG too: thousands of triangles are better pixels
        screen = to_y_up(points, header.up_axis) @ view.rotation.T
        for part, (x, y) in _number_places(screen, header.faces, numbered, limits).items():
            ax.text(x, y, f"{part}", fontsize=8, ha="center", va="center", path_effects=halo, zorder=4)
    panels[0].set_title("Parts and joints")


def draw_parts_legend(ax: Axes, parts: Decomposition, columns: int) -> None:
    """List parts with their colours and vertex counts, then joints."""
    patch = import_matplotlib("patches").Patch
    named = _named(parts)
    handles = [
        patch(color=colour, label=f"part {number}: {_count(len(part), 'vertex', 'vertices')}")
        for number, (part, colour) in enumerate(zip(parts.parts, part_colours(named), strict=False))
    ]
    if len(handles) > LISTED:
        left_out = len(handles) - LISTED
        handles = [*handles[:LISTED], patch(color="none", label=f"and {left_out} more parts")]
    if len(parts.parts) > named:
        handles.append(
            patch(
                color="none", label=f"in no triangle: {_count(len(parts.parts[named]), 'vertex', 'vertices')}"
            )
        )
    if parts.joints:
        free = _count(sum(int(joint.free.sum()) for joint in parts.joints), "free vertex", "free vertices")
        what = "1 joint" if len(parts.joints) == 1 else f"{len(parts.joints)} joints"
        handles.append(patch(color=JOINT_RED, label=f"{what}: {free}"))
    ax.legend(handles=handles, loc="upper center", ncols=columns, handlelength=1.2, borderaxespad=0)
    ax.set_axis_off()


def legend_rows(parts: Decomposition, columns: int) -> int:
    """Return the number of rows of the legend."""
    return -(-(min(len(parts.parts), LISTED + 1) + 1) // columns)


def _named(parts: Decomposition) -> int:
    """Return the number of parts with faces, plus one for vertices without faces, if there are any."""
    return int(parts.part_of_face.max()) + 1


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def _number_places(
    screen: Float, faces: IntArray, part_of_face: IntArray, limits: Limits
) -> dict[int, tuple[float, float]]:
    """Return the middle of the widest visible spot of each part: screen ``(V, 3)``; faces ``(F, 3)``."""
    left, right, bottom, top = limits
    seen = _seen_parts(screen, faces, part_of_face, limits)
    rows, columns = seen.shape
    places = {}
    for part in np.unique(seen[seen >= 0]).tolist():
        depth = distance_transform_edt(np.pad(seen == part, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(depth.argmax(), depth.shape)
        if depth[row, column] >= _ROOM:
            x, y = (column + 0.5) / columns, (row + 0.5) / rows
            places[part] = left + x * (right - left), bottom + y * (top - bottom)
    return places


def _seen_parts(screen: Float, faces: IntArray, part_of_face: IntArray, limits: Limits) -> NDArray[np.int64]:
    """Paint part numbers from back to front: an image, lowest row first, -1 for background."""
    size = _PIXELS, max(1, round(_PIXELS * aspect_ratio(limits)))
    figure = import_matplotlib("figure").Figure(figsize=size, dpi=1, facecolor="black")
    canvas = import_matplotlib("backends.backend_agg").FigureCanvasAgg(figure)
    ax = figure.add_axes((0, 0, 1, 1), xlim=limits[:2], ylim=limits[2:])
    ax.set_axis_off()
    order = np.argsort(screen[faces, 2].mean(axis=1), kind="stable")
    codes = (part_of_face[order, None] + 1) >> np.array([16, 8, 0]) & 255  # as red, green and blue
    ax.add_collection(
        import_matplotlib("collections").PolyCollection(
            screen[faces[order], :2], facecolors=codes / 255, edgecolors="none", antialiaseds=False
        )
    )
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(np.int64)
    return np.asarray(image @ [1 << 16, 1 << 8, 1] - 1)


MOST_ROWS = 12
"""Largest number of frames drawn with their errors."""

_HEADING = 0.4  # inches, as are all lengths here
_LEGEND = 1.75


def plot_model(
    target: Target,
    model: Model,
    kind: PictureKind | None = None,
    *,
    against: MeshSequence | None = None,
    frames: Sequence[int] | None = None,
    tolerance: float | None = None,
    camera: tuple[float, float] | None = None,
    file_format: Format | None = None,
    progress: Progress = silent,
) -> None:
    """Draw a model, as PNG or SVG.

    Parameters
    ----------
    target : path or binary file
        Where the picture goes.
    model : Model
        The model.
    kind : str, optional
        One of `PICTURES`; by default all available ones, on one page.
    against : MeshSequence, optional
        The original, for errors.
    frames : sequence of int, optional
        Frames labelled in the embedding (by default some), or drawn with the errors of their vertices (by default the
        worst one).
    tolerance : float, optional
        Value of a line in the chart of errors, in diagonals.
    camera : (float, float), optional
        View of meshes, and the opposite one: degrees from the front, to the body's left, and above the horizon; by
        default the front and a side.
    file_format : {"png", "svg"}, optional
        By default that of the extension of the target; PNG for files without a name.
    progress : callable, optional
        Called after every decoded frame.

    Raises
    ------
    SettingsError
        If the model has no parts to draw, the original is missing or another mesh, a frame does not exist, or a setting
        does not belong to the kind of picture.
    OutputError
        If the target is neither PNG nor SVG.
    MissingExtraError
        If matplotlib is not installed.
    """
    chosen = picture_format(target, file_format)
    check_settings(kind, against is not None, frames, tolerance, camera)
    with chart_style():
        content = _content(model, kind, against, frames, tolerance, camera, progress)
        title = model.header.name if kind else summary(model)
        page = new_page(content.width, content.height + _HEADING, title)
        content.draw(page)
        save_page(page, target, chosen)


def summary(model: Model) -> str:
    """Describe a model in one line."""
    header, space = model.header, model.space
    return (
        f"{header.name}: {_count(header.frame_count, 'frame')} ({header.frame_numbers}) in "
        f"{model.end - model.start:.3g} s, {_count(header.vertex_count, 'vertex', 'vertices')}; "
        f"{_count(len(model.shapes), 'key shape')} in a "
        f"{space.name} space of dimension {space.dim:,}"
    )


def check_settings(
    kind: PictureKind | None,
    against: bool,
    frames: Sequence[object] | None,
    tolerance: float | None,
    camera: tuple[float, float] | None = None,
) -> None:
    """Raise SettingsError for contradicting settings of `plot_model`, before the work."""
    if kind is not None and kind not in PICTURES:
        raise SettingsError(f"kind is {kind!r}; one of {', '.join(PICTURES)} is expected")
    if not against and (kind in ("error-frames", "error-vertices") or tolerance is not None):
        raise SettingsError(
            f"{kind or 'tolerance'} is about errors; give the original sequence to measure them against"
        )
    uses: list[tuple[str, bool, tuple[PictureKind, ...]]] = [
        ("against", against, ("error-frames", "error-vertices")),
        ("frames", frames is not None, ("embedding", "error-vertices")),
        ("tolerance", tolerance is not None, ("error-frames",)),
        ("camera", camera is not None, ("parts", "error-vertices")),
    ]
    for name, given, kinds in uses:
        if given and kind is not None and kind not in kinds:
            raise SettingsError(f"{name} is for {' and '.join(kinds)}, not for {kind}; leave it out")
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number of diagonals is expected")
    if camera is not None and not np.all(np.isfinite(camera)):
        raise SettingsError(f"the camera is at {camera}; two numbers of degrees are expected")
    if kind == "error-vertices" and frames is not None and not 0 < len(set(frames)) <= MOST_ROWS:
        raise SettingsError(f"frames are {len(set(frames))}; errors of 1 to {MOST_ROWS} frames fit on a page")


def _content(
    model: Model,
    kind: PictureKind | None,
    against: MeshSequence | None,
    frames: Sequence[int] | None,
    tolerance: float | None,
    camera: tuple[float, float] | None,
    progress: Progress,
) -> Section:
    match kind:
        case "embedding":
            return _embedding(model, frames)
        case "coefficients":
            return _coefficients(model)
        case "singular-values":
            return _singular_values(model)
    near = resolve_view(np.stack([model(model.start), model(model.end)]), model.header.up_axis, camera)
    if kind == "parts":
        return _parts(model, near)
    rows = []
    if kind is None:
        charts = arranged(_coefficients(model, 2.7), _singular_values(model, 2.7))
        rows.append(arranged(_embedding(model, frames), charts, beside=True))
        if model.space.segmentation:
            rows.append(_parts(model, near, 5.0))
    if against is not None:
        own = kind == "error-vertices" and frames is not None
        single = existing_frames(frames or (), against.frame_count) if own else None
        errors = vertex_errors(model, against, single or (), progress)
        by_frame = _frame_errors(errors, against, tolerance)
        if kind is None:
            by_vertex = _vertex_errors(errors, against, None, near, 3.0)
            rows.append(arranged(by_frame, by_vertex, beside=True))
        elif kind == "error-frames":
            rows.append(by_frame)
        else:
            rows.append(_vertex_errors(errors, against, single, near, 4.5))
    return arranged(*rows)


def _embedding(model: Model, frames: Sequence[int] | None) -> Section:
    height = 4.6 * aspect_ratio(embedding_limits(model)) + 1.0
    return Section(6.0, height, lambda page: draw_embedding(page.subplots(), model, frames))


def _coefficients(model: Model, height: float = 4.0) -> Section:
    return Section(7.5, height, lambda page: draw_coefficients(page.subplots(), model))


def _singular_values(model: Model, height: float = 4.0) -> Section:
    return Section(7.5, height, lambda page: draw_singular_values(page.subplots(), model))


def _parts(model: Model, near: View, width: float = 4.5) -> Section:
    parts, pose = model.decomposition, model(model.start)
    columns = int(2 * width / _LEGEND)
    picture = _picture_height(pose[None], model.header.up_axis, near, width)
    legend = 0.2 * legend_rows(parts, columns)

    def draw(page: FigureBase) -> None:
        panels = page.subplot_mosaic([["near", "far"], ["legend", "legend"]], height_ratios=[picture, legend])
        draw_parts([panels["near"], panels["far"]], model, pose, near)
        draw_parts_legend(panels["legend"], parts, columns)

    return Section(2 * width, picture + legend + 0.5, draw)


def _frame_errors(errors: VertexErrors, against: MeshSequence, tolerance: float | None) -> Section:
    def draw(page: FigureBase) -> None:
        draw_frame_errors(page.subplots(), errors, against.times, tolerance, against.fps)

    return Section(7.5, 4.0, draw)


def _vertex_errors(
    errors: VertexErrors, against: MeshSequence, frames: Sequence[int] | None, near: View, width: float
) -> Section:
    def draw(page: FigureBase) -> None:
        panels = page.subplots(len(shown), 2, squeeze=False)
        heat = draw_vertex_errors(panels.tolist(), errors, against, frames, near)
        add_error_bar(page, panels.ravel().tolist(), heat)

    shown = against.points[drawn_frames(errors, frames)]
    height = _picture_height(shown, against.up_axis, near, width)
    return Section(2 * width + 1.0, len(shown) * (height + 0.4), draw)


def _picture_height(poses: FloatArray, up_axis: str, near: View, width: float) -> float:
    """Return the height of a mesh picture of a width; tall ones are drawn smaller."""
    return width * float(np.clip(views_aspect(opposite_views(poses, up_axis, near)), 0.3, 0.9))


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    width: float  # preferred width in inches
    height: float  # preferred height in inches
    draw: Callable[[FigureBase], None]  # draws it on a matplotlib Figure or SubFigure


def arranged(*sections: Section, beside: bool = False) -> Section:
    """Put sections side by side, all as high as the highest, or one below the other, all as wide as the widest."""
    widths, heights = [each.width for each in sections], [each.height for each in sections]
    count = len(sections)

    def draw(page: FigureBase) -> None:
        if beside:
            pages = page.subfigures(1, count, squeeze=False, width_ratios=widths)
        else:
            pages = page.subfigures(count, 1, squeeze=False, height_ratios=heights)
        for section, part in zip(sections, pages.flat, strict=True):
            section.draw(part)

    if beside:
        return Section(sum(widths), max(heights), draw)
    return Section(max(widths), sum(heights), draw)
