"""Draw charts of a model's signals, its parts and joints, and errors per frame and vertex, separately or on one page.

The error of a vertex is its distance from the original in diagonals, :math:`|A_{tv} - B_{tv}| / d`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import distance_transform_edt

from mixseq.choices import PICTURES, PictureKind
from mixseq.errors import SettingsError
from mixseq.pictures.charts import (
    LINE_COLOURS,
    Format,
    Target,
    chart_style,
    check_frames,
    draw_coefficients,
    draw_embedding,
    draw_singular_values,
    embedding_limits,
    error_map,
    import_matplotlib,
    log_axis,
    new_page,
    picture_format,
    save_page,
    time_axis,
)
from mixseq.pictures.colours import (
    JOINT_RED,
    check_values,
    match_original,
    part_colours,
    segmentation_colours,
    value_range,
    vertex_distances,
)
from mixseq.pictures.raster import draw_mesh, visible_labels
from mixseq.pictures.scene import INK_COLOUR, Limits, View, aspect_ratio, resolve_view, to_y_up
from mixseq.pictures.sheets import opposite_views, views_aspect
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.frame_rates import format_frame
from mixseq.sequence.sequence import MeshSequence
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, IntArray, evenly_spaced

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase


MIN_DRAWN_ERROR = 1e-17
"""Lower limit of errors on logarithmic axes, in diagonals; smaller errors are clamped to this value."""

_BLOCK_FRAMES = 8  # number of frames decoded at once


@dataclass(frozen=True, eq=False)
class VertexErrors:
    """Distances of vertices from their originals, in diagonals."""

    largest: Float  # (T,) largest error of each frame
    rms: Float  # (T,) root mean square over the vertices of each frame
    by_vertex: Float  # (V,) largest error of each vertex over all frames
    worst: int  # frame of the largest error
    by_frame: dict[int, Float]  # vertex errors (V,) in the requested frames and the worst frame


def vertex_errors(
    model: Model, original: MeshSequence, frames: Sequence[int] = (), progress: Progress = log_progress
) -> VertexErrors:
    """Compute the vertex errors of a model at the frame times of its original."""
    vertex_ids = match_original(model.header, original, "the sequence")
    diagonal = original.diagonal or 1.0
    largest, rms = np.zeros(original.frame_count), np.zeros(original.frame_count)
    by_vertex = worst_errors = np.zeros(original.vertex_count)
    by_frame: dict[int, Float] = {}
    worst = first = 0
    for block in model.blocks(original.times, _BLOCK_FRAMES, progress):
        for frame, points in enumerate(block, first):
            distances = vertex_distances(points[vertex_ids], original.points[frame], diagonal)
            largest[frame], rms[frame] = distances.max(), np.sqrt(np.mean(np.square(distances)))
            by_vertex = np.maximum(by_vertex, distances)
            if frame in frames:
                by_frame[frame] = distances
            if frame == 0 or largest[frame] > largest[worst]:
                worst, worst_errors = frame, distances
        first += len(block)
    return VertexErrors(largest, rms, by_vertex, worst, by_frame | {worst: worst_errors})


def draw_frame_errors(
    ax: Axes, errors: VertexErrors, times: Float, tolerance: float | None = None, fps: float | None = None
) -> None:
    """Draw the largest and the root mean square error of each frame over the times ``(T,)``."""
    largest, rms = (np.maximum(values, MIN_DRAWN_ERROR) for values in (errors.largest, errors.rms))
    ax.plot(times, largest, "o-", color=LINE_COLOURS[0], markersize=3.5, linewidth=1.2, label="largest")
    ax.plot(times, rms, "o-", color=LINE_COLOURS[1], markersize=3.5, linewidth=1.2, label="root mean square")
    drawn = [largest, rms]
    if tolerance is not None:
        ax.axhline(tolerance, color=INK_COLOUR, linestyle="--", linewidth=1.0, label=f"tolerance, {tolerance:g}")
        drawn.append(np.array([tolerance]))
    worst = errors.worst
    number = f"{worst}" if fps is None else format_frame(times[worst], fps)
    ring: dict[str, Any] = {"ms": 9, "mfc": "none", "mec": INK_COLOUR, "clip_on": False}
    ax.plot(times[worst], largest[worst], "o", **ring, label=f"worst frame, {number}")
    log_axis(ax, np.concatenate(drawn))
    time_axis(ax, times[0], times[-1], fps)
    ax.set(title="Error per frame", ylabel="vertex error (diagonals)")
    ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def draw_vertex_errors(
    panels: Sequence[Sequence[Axes]],
    errors: VertexErrors,
    original: MeshSequence,
    frames: Sequence[int] | None = None,
    view: View | None = None,
) -> Any:
    """Draw errors as face colours from two opposite sides: one row for the maxima over all frames, then one per frame.

    A face shows the largest error of its corners. A ring marks the vertex with the largest error of a row, if visible.
    """
    colour_map = error_map(max(errors.by_vertex.max(), MIN_DRAWN_ERROR))
    _, *single_frames = frame_of_row = drawn_frames(errors, frames)
    values = [errors.by_vertex, *(errors.by_frame[frame] for frame in single_frames)]
    titles = ["largest of all frames", *(_title(errors, original, frame) for frame in single_frames)]
    views = opposite_views(original.points[frame_of_row], original.up_axis, view)
    for axes, frame, error, title, sides in zip(panels, frame_of_row, values, titles, views, strict=True):
        points, worst_vertex = original.points[frame], int(error.argmax())
        colours = colour_map.to_rgba(error[original.faces].max(axis=1))[:, :3]
        for ax, (side, limits) in zip(axes, sides, strict=True):
            draw_mesh(ax, points, original.faces, colours, original.up_axis, side, limits, contrast=0.25)
            screen = to_y_up(points, original.up_axis) @ side.rotation.T
            if not _is_hidden(worst_vertex, screen, original.faces):
                for colour, width in (("white", 3.5), (INK_COLOUR, 1.5)):
                    ax.plot(*screen[worst_vertex, :2], "o", ms=12, mfc="none", mec=colour, mew=width, zorder=4)
        axes[0].set_title(f"Error per vertex: {title}\nmost at vertex {worst_vertex}", fontsize=10)
    return colour_map


def drawn_frames(errors: VertexErrors, frames: Sequence[int] | None) -> list[int]:
    """Return the frame whose pose `draw_vertex_errors` draws in each row."""
    return [0, *([errors.worst] if frames is None else frames)]


def _title(errors: VertexErrors, original: MeshSequence, frame: int) -> str:
    label = "worst frame, " if frame == errors.worst else "frame "
    return f"{label}{original.frame_number(frame)} at {original.times[frame]:.3f} s"


def _is_hidden(vertex: int, screen: Float, faces: IntArray) -> bool:
    """Return whether a triangle, not incident to the vertex, lies between the vertex and the camera."""
    others = screen[faces[(faces != vertex).all(axis=1)]] - screen[vertex]
    (x, y, _), (u, v, _) = (np.moveaxis(np.roll(others, -step, axis=1), 2, 0) for step in (1, 2))
    # barycentric weights, times twice the area, of the point where the line of sight meets the triangle's plane
    weights = x * v - y * u
    area = weights.sum(axis=1)
    is_crossed = ((weights * area[:, None] >= 0).all(axis=1)) & (area != 0)
    heights = np.einsum("fc,fc->f", weights[is_crossed], others[is_crossed, :, 2]) / area[is_crossed]
    return bool((heights > 0).any())


def add_error_bar(page: FigureBase, panels: Sequence[Axes], colour_map: Any) -> None:
    """Add the colour bar of `draw_vertex_errors` to the right of the panels."""
    bar = _add_colour_bar(page, panels, colour_map, "vertex error (diagonals)")
    bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:.1e}" if value else "0")


def _add_colour_bar(page: FigureBase, panels: Sequence[Axes], colour_map: Any, label: str) -> Any:
    bar = page.colorbar(colour_map, ax=panels, shrink=0.6, aspect=30, pad=0.02, label=label)
    bar.outline.set_visible(False)
    return bar


MAX_LEGEND_PARTS = 9
"""Largest number of parts listed in a legend, the largest ones; it has at most three more entries."""


def draw_parts(panels: Sequence[Axes], model: Model, points: FloatArray, view: View | None = None) -> None:
    """Draw a pose ``(V, 3)`` from two opposite sides, with coloured and numbered parts; see `segmentation_colours`."""
    parts, header = model.decomposition, model.header
    colours = segmentation_colours(parts.part_of_face, parts.joint_of_face, header.faces)
    path_effects = import_matplotlib("patheffects")
    halo = [path_effects.withStroke(linewidth=2, foreground="white")]
    views = opposite_views(points[None], header.up_axis, view)[0]
    for ax, (side, limits) in zip(panels, views, strict=True):
        draw_mesh(ax, points, header.faces, colours, header.up_axis, side, limits)
        screen = to_y_up(points, header.up_axis) @ side.rotation.T
        for part, (x, y) in _number_positions(screen, header.faces, parts.part_of_face, limits).items():
            ax.text(x, y, f"{part}", fontsize=8, ha="center", va="center", path_effects=halo, zorder=4)
    panels[0].set_title("Parts; joints paler, red where parts meet")


def draw_parts_legend(ax: Axes, parts: Decomposition, columns: int) -> None:
    """Draw a legend with the colours and vertex counts of the largest parts, and one entry for all joints."""
    patch = import_matplotlib("patches").Patch
    part_count = _part_count(parts)
    sizes = np.array([len(part) for part in parts.parts[:part_count]])
    largest, colours = np.sort(np.argsort(-sizes, kind="stable")[:MAX_LEGEND_PARTS]), part_colours(part_count)
    handles = [
        patch(color=colours[number], label=f"part {number}: {_counted(sizes[number], 'vertex', 'vertices')}")
        for number in largest.tolist()
    ]
    if part_count > MAX_LEGEND_PARTS:
        handles.append(patch(color="none", label=f"and {_counted(part_count - MAX_LEGEND_PARTS, 'smaller part')}"))
    if len(parts.parts) > part_count:
        loose_vertices = _counted(len(parts.parts[part_count]), "vertex", "vertices")
        handles.append(patch(color="none", label=f"in no triangle: {loose_vertices}"))
    if parts.joints:
        free_count = sum(int(joint.free.sum()) for joint in parts.joints)
        free_vertices = _counted(free_count, "free vertex", "free vertices")
        joints = "1 joint" if len(parts.joints) == 1 else f"{len(parts.joints)} joints"
        handles.append(patch(color=JOINT_RED, label=f"{joints}: {free_vertices}"))
    ax.legend(handles=handles, loc="upper center", ncols=columns, handlelength=1.2, borderaxespad=0)
    ax.set_axis_off()


def legend_rows(parts: Decomposition, columns: int) -> int:
    """Return the number of rows of `draw_parts_legend`."""
    return -(-(min(len(parts.parts), MAX_LEGEND_PARTS + 1) + 1) // columns)


def _part_count(parts: Decomposition) -> int:
    """Return the number of parts with faces; vertices without faces form one additional last part."""
    return int(parts.part_of_face.max()) + 1


def _counted(number: int, one: str, many: str = "") -> str:
    return f"{number:,} {one if number == 1 else many or f'{one}s'}"


def _number_positions(
    screen: Float, faces: IntArray, part_of_face: IntArray, limits: Limits
) -> dict[int, tuple[float, float]]:
    """Return the centre of each part's widest visible region, for faces ``(F, 3)`` and screen points ``(V, 3)``."""
    left, right, bottom, top = limits
    visible = visible_labels(screen, faces, part_of_face, limits, width=300)
    rows, columns = visible.shape
    positions = {}
    for part in np.unique(visible[visible >= 0]).tolist():
        distance = distance_transform_edt(np.pad(visible == part, 1))[1:-1, 1:-1]
        row, column = np.unravel_index(distance.argmax(), distance.shape)
        if distance[row, column] >= 4:  # pixels to the outline
            x, y = (column + 0.5) / columns, (row + 0.5) / rows
            positions[part] = left + x * (right - left), bottom + y * (top - bottom)
    return positions


MAX_ERROR_FRAMES = 12
"""Largest number of frames drawn with vertex errors or values on a page."""

_HEADING_HEIGHT, _PAGE_WIDTH = 0.4, 13.5  # in inches, like all page lengths
_LEGEND_COLUMN_WIDTH = 1.75


def plot_model(
    target: Target,
    model: Model,
    kind: PictureKind | None = None,
    *,
    against: MeshSequence | None = None,
    frames: Sequence[int] | None = None,
    tolerance: float | None = None,
    camera: tuple[float, float] | None = None,
    values: ArrayLike | None = None,
    file_format: Format | None = None,
    progress: Progress = log_progress,
) -> None:
    """Draw a model, as PNG or SVG.

    Parameters
    ----------
    target : path or binary file
        File to write.
    model : Model
        Model to draw.
    kind : str, optional
        Kind of picture, one of `PICTURES`; by default all available kinds on one page.
    against : MeshSequence, optional
        Original of the model, required for errors.
    frames : sequence of int, optional
        Frames to label in the embedding (by default round numbers), or to draw with vertex errors (by default the worst
        frame) or values (by default the first, and if values change also the middle and the last).
    tolerance : float, optional
        Tolerance in diagonals, drawn as a line in the chart of errors.
    camera : (float, float), optional
        Azimuth from the front to the body's left, and elevation, in degrees; by default a view of the front and a side.
        Meshes are drawn in this view and the opposite view.
    values : (V,) or (T, V) array, optional
        Numbers of the vertices, constant or for every frame, to draw as colours.
    file_format : {"png", "svg"}, optional
        File format; by default the format of the target's extension, or PNG for files without a name.
    progress : callable, optional
        Function called after every decoded frame.

    Raises
    ------
    SettingsError
        If the model has no parts to draw, the original is missing or a different mesh, values are missing or not those
        of its vertices, a frame does not exist, or a setting does not belong to the kind of picture.
    OutputError
        If the target is neither PNG nor SVG.
    MissingExtraError
        If matplotlib is not installed.
    """
    resolved_format = picture_format(target, file_format)
    check_settings(kind, against is not None, frames, tolerance is not None, camera, values is not None)
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise SettingsError(f"tolerance is {tolerance}; a positive number of diagonals is expected")
    with chart_style():
        section = _page_section(model, kind, against, frames, tolerance, camera, values, progress)
        title = model.header.name if kind else summary(model)
        page = new_page(section.width, section.height + _HEADING_HEIGHT, title)
        section.draw(page)
        save_page(page, target, resolved_format)


def summary(model: Model) -> str:
    """Describe a model in one line."""
    header, space = model.header, model.space
    return (
        f"{header.name}: {_counted(header.frame_count, 'frame')} ({header.frame_numbers}) in "
        f"{model.end - model.start:.3g} s, {_counted(header.vertex_count, 'vertex', 'vertices')}; "
        f"{_counted(len(model.shapes), 'key shape')} in a "
        f"{space.name} space of dimension {space.dim:,}"
    )


def check_settings(
    kind: PictureKind | None,
    against: bool,
    frames: Sequence[object] | None,
    tolerance: bool,
    camera: tuple[float, float] | None = None,
    values: bool = False,
) -> None:
    """Raise SettingsError if settings of `plot_model` contradict each other."""
    if kind is not None and kind not in PICTURES:
        raise SettingsError(f"kind is {kind!r}; one of {', '.join(PICTURES)} is expected")
    if not against and (kind in ("error-frames", "error-vertices") or tolerance):
        raise SettingsError(
            f"{kind or 'tolerance'} needs the original; give the sequence that errors are measured against"
        )
    uses: list[tuple[str, bool, tuple[PictureKind, ...]]] = [
        ("against", against, ("error-frames", "error-vertices")),
        ("frames", frames is not None, ("embedding", "error-vertices", "values")),
        ("values", values, ("values",)),
        ("tolerance", tolerance, ("error-frames",)),
        ("camera", camera is not None, ("parts", "error-vertices", "values")),
    ]
    for name, is_given, kinds in uses:
        if is_given and kind is not None and kind not in kinds:
            raise SettingsError(f"{name} is for {' and '.join(kinds)}, not for {kind}; leave it out")
    if camera is not None and not np.all(np.isfinite(camera)):
        raise SettingsError(f"the camera is at {camera}; two numbers of degrees are expected")
    if kind == "values" and not values:
        raise SettingsError("values needs numbers of the vertices; give values (--scalar)")
    if kind in ("error-vertices", "values") and frames is not None and not 0 < len(set(frames)) <= MAX_ERROR_FRAMES:
        raise SettingsError(
            f"the meshes of {len(set(frames))} frames do not fit; choose 1 to {MAX_ERROR_FRAMES} frames"
        )


def _page_section(
    model: Model,
    kind: PictureKind | None,
    against: MeshSequence | None,
    frames: Sequence[int] | None,
    tolerance: float | None,
    camera: tuple[float, float] | None,
    values: ArrayLike | None,
    progress: Progress,
) -> Section:
    match kind:
        case "embedding":
            height = 4.6 * aspect_ratio(embedding_limits(model)) + 1.0
            return Section(6.0, height, _on_one_chart(partial(draw_embedding, frames=frames), model))
        case "coefficients":
            return Section(7.5, 4.0, _on_one_chart(draw_coefficients, model))
        case "singular-values":
            return Section(7.5, 4.0, _on_one_chart(draw_singular_values, model))
    view = resolve_view(np.stack([model(model.start), model(model.end)]), model.header.up_axis, camera)
    if kind == "parts":
        return _parts(model, view)
    rows = []
    if kind is None:
        parts = [_parts(model, view, 6.7)] if model.space.segmentation else []
        beside = bool(parts) and parts[0].width < 0.6 * _PAGE_WIDTH
        charts: list[Callable[[Axes, Model], None]] = [
            draw_coefficients,
            draw_singular_values,
            partial(draw_embedding, frames=frames),
        ]
        height = parts[0].height / len(charts) if beside else 3.6
        sections = [Section(4.5 + beside, height, _on_one_chart(draw, model)) for draw in charts]
        row = stack_sections(*sections, side_by_side=not beside)
        rows.append(stack_sections(*parts, row, side_by_side=beside))
    if against is not None:
        has_frames = kind == "error-vertices" and frames is not None
        chosen = check_frames(frames or (), against.frame_count) if has_frames else None
        errors = vertex_errors(model, against, chosen or (), progress)
        by_frame = _frame_errors(errors, against, tolerance)
        if kind is None:
            by_vertex = _vertex_errors(errors, against, None, view, 3.0)
            rows.append(stack_sections(by_frame, by_vertex, side_by_side=True))
        elif kind == "error-frames":
            rows.append(by_frame)
        else:
            rows.append(_vertex_errors(errors, against, chosen, view, 4.5))
    if values is not None:
        chosen = check_frames(frames, model.header.frame_count) if kind and frames is not None else None
        rows.append(_values(model, check_values(values, model.header), chosen, view, 4.5 if kind else 6.25))
    return stack_sections(*rows)


def _on_one_chart(draw: Callable[[Axes, Model], None], model: Model) -> Callable[[FigureBase], None]:
    return lambda page: draw(page.subplots(), model)


def _parts(model: Model, view: View, width: float = 4.5) -> Section:
    parts, pose = model.decomposition, model(model.start)
    width, mesh_height = _picture_size(pose[None], model.header.up_axis, view, width)
    columns = int(2 * width / _LEGEND_COLUMN_WIDTH)
    legend_height = 0.2 * legend_rows(parts, columns)

    def draw(page: FigureBase) -> None:
        panels = page.subplot_mosaic(
            [["near", "far"], ["legend", "legend"]], height_ratios=[mesh_height, legend_height]
        )
        draw_parts([panels["near"], panels["far"]], model, pose, view)
        draw_parts_legend(panels["legend"], parts, columns)

    return Section(2 * width, mesh_height + legend_height + 0.5, draw)


def _frame_errors(errors: VertexErrors, against: MeshSequence, tolerance: float | None) -> Section:
    def draw(page: FigureBase) -> None:
        draw_frame_errors(page.subplots(), errors, against.times, tolerance, against.fps)

    return Section(7.5, 4.0, draw)


def _vertex_errors(
    errors: VertexErrors, against: MeshSequence, frames: Sequence[int] | None, view: View, width: float
) -> Section:
    def draw(page: FigureBase) -> None:
        panels = page.subplots(len(poses), 2, squeeze=False)
        colour_map = draw_vertex_errors(panels.tolist(), errors, against, frames, view)
        add_error_bar(page, panels.ravel().tolist(), colour_map)

    poses = against.points[drawn_frames(errors, frames)]
    width, height = _picture_size(poses, against.up_axis, view, width)
    return Section(2 * width + 1.0, len(poses) * (height + 0.4), draw)


def _values(model: Model, values: Float, frames: Sequence[int] | None, view: View, width: float) -> Section:
    header, is_constant = model.header, (values == values[0]).all()
    drawn = frames or evenly_spaced(1 if is_constant else len(values), 3).tolist()
    poses, (low, top) = np.stack([model(header.times[frame]) for frame in drawn]), value_range(values)
    width, height = _picture_size(poses, header.up_axis, view, width)

    def draw(page: FigureBase) -> None:
        panels = page.subplots(len(poses), 2, squeeze=False)
        colour_map = error_map(top, low)
        for axes, frame, pose in zip(panels, drawn, poses, strict=True):
            colours = colour_map.to_rgba(values[frame][header.faces].mean(axis=1))[:, :3]
            for ax, (side, limits) in zip(axes, opposite_views(pose[None], header.up_axis, view)[0], strict=True):
                draw_mesh(ax, pose, header.faces, colours, header.up_axis, side, limits, contrast=0.25)
            axes[0].set_title(f"Values, frame {header.frame_number(frame)} at {header.times[frame]:.3f} s", fontsize=10)
        _add_colour_bar(page, panels.ravel().tolist(), colour_map, "value")

    return Section(2 * width + 1.0, len(poses) * (height + 0.4), draw)


def _picture_size(poses: FloatArray, up_axis: str, view: View, width: float) -> tuple[float, float]:
    """Return the width and height of mesh pictures, which are narrower for tall meshes."""
    aspect = max(views_aspect(opposite_views(poses, up_axis, view)), 0.3)
    narrow = max(width * min(1, 0.9 / aspect), _LEGEND_COLUMN_WIDTH)
    return narrow, narrow * aspect


@dataclass(frozen=True)
class Section:
    """A section of a page."""

    width: float  # preferred width in inches
    height: float  # preferred height in inches
    draw: Callable[[FigureBase], None]  # draws the section on a Figure or SubFigure


def stack_sections(*sections: Section, side_by_side: bool = False) -> Section:
    """Combine sections from top to bottom, with the largest width, or side by side, with the largest height."""
    widths, heights = zip(*((section.width, section.height) for section in sections), strict=True)
    count = len(sections)

    def draw(page: FigureBase) -> None:
        if side_by_side:
            pages = page.subfigures(1, count, squeeze=False, width_ratios=widths)
        else:
            pages = page.subfigures(count, 1, squeeze=False, height_ratios=heights)
        for section, part in zip(sections, pages.flat, strict=True):
            section.draw(part)

    if side_by_side:
        return Section(sum(widths), max(heights), draw)
    return Section(max(widths), sum(heights), draw)
