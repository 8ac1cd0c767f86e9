"""Define scenes: moving meshes with a common start and frame rate, their arrangement, and the camera.

Frame k is shown at the time :math:`k / f`, with f frames per second. The *period* of a scene is the period of its
longest mesh: the time from the first to the last frame, plus one frame. Shorter meshes hold their last pose until the
period ends, when all meshes start again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from math import remainder

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.frame_rates import snap_to_ntsc
from mixseq.sequence.header import UP_AXES, SequenceHeader
from mixseq.sequence.sequence import Frames, FrameStore, block_size, load_frames
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, Index, Single, evenly_spaced

CLAY_COLOUR = (0.80, 0.77, 0.72)
INK_COLOUR = "#3a3a3a"
"""Colours of meshes without colours, and of lines and text."""

Limits = tuple[float, float, float, float]
"""Screen rectangle: left, right, bottom and top, in units of the points."""


@dataclass(frozen=True)
class View:
    """An orthographic camera around the mesh."""

    azimuth: float = 30.0
    elevation: float = 14.0

    @property
    def rotation(self) -> Float:
        """Rotation ``(3, 3)`` from Y-up world axes to screen axes: right, up, towards the camera."""
        # remove full turns in degrees, as they are not exact in radians
        a, e = np.radians([remainder(self.azimuth, 360), self.elevation])
        azimuth_rotation = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        elevation_rotation = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return np.asarray(elevation_rotation @ azimuth_rotation)


@dataclass(frozen=True, eq=False)
class Camera:
    """The view of a mesh during a film of N frames."""

    view: View  # view of the first frame
    turn: float  # total rotation of the camera during the N frames, in degrees
    centres: Float  # (N, 3) point in each frame that the camera looks at and rotates around, Y up
    ground: float  # height of the ground
    limits: Limits  # (4,) screen rectangle around all frames

    def view_at(self, frame: int) -> View:
        """Return the view in the given frame."""
        return View(self.view.azimuth + frame / len(self.centres) * self.turn, self.view.elevation)

    @property
    def aspect(self) -> float:
        """Height divided by width of the screen rectangle."""
        return aspect_ratio(self.limits)

    def with_aspect(self, aspect: float) -> Camera:
        """Return the camera with its screen rectangle widened to a ratio of height to width."""
        return replace(self, limits=widen_to_aspect(self.limits, aspect))


def front_azimuth(poses: FloatArray, up_axis: str = "Y") -> float:
    """Return the azimuth in degrees from which a body in poses ``(n, V, 3)`` is seen from the front.

    A body that travels by half of its diagonal faces its direction of travel. Any other body faces the conventional
    front for its up axis: +z with Y up (glTF 2.0, section 3.4), -y with Z up (Blender). In both conventions +x is to
    the body's left.
    """
    ends = to_y_up(poses[[0, -1]], up_axis)
    x, _, z = ends[1].mean(axis=0) - ends[0].mean(axis=0)
    if np.hypot(x, z) < 0.5 * np.linalg.norm(np.ptp(ends[0], axis=0)) or x == z == 0:
        return -90.0 if up_axis == "Z" else 0.0
    return float(np.round(np.degrees(np.arctan2(x, z))))  # rounding gives the same view on all machines


def three_quarter_view(poses: FloatArray, up_axis: str = "Y", turn: float = 30.0, elevation: float = 14.0) -> View:
    """Return a view of the front and a side of poses ``(V, 3)`` or ``(n, V, 3)``.

    The camera is `turn` degrees away from a full view of the longer of front and side, at the azimuth nearer to 45.
    """
    poses = poses.reshape(-1, *poses.shape[-2:])
    front = front_azimuth(poses, up_axis)
    first = to_y_up(poses[0], up_axis)
    forwards = np.array([np.sin(np.radians(front)), np.cos(np.radians(front))])
    length, width = np.ptp(first[:, [0, 2]] @ np.stack([forwards, forwards[::-1] * [1, -1]], axis=1), axis=0)
    offset = turn if width >= length else 90.0 - turn
    azimuths = [(front + side + 180) % 360 - 180 for side in (offset, -offset)]
    return View(min(azimuths, key=lambda azimuth: abs((azimuth - 45 + 180) % 360 - 180)), elevation)


def resolve_view(ends: FloatArray, up_axis: str, camera: tuple[float, float] | None) -> View:
    """Return the view of poses ``(2, V, 3)`` at an azimuth from the front to the left and an elevation, in degrees."""
    if camera is None:
        return three_quarter_view(ends, up_axis)
    return View(front_azimuth(ends, up_axis) + camera[0], camera[1])


def shared_limits(points: FloatArray, up_axis: str = "Y", view: View | None = None, margin: float = 0.04) -> Limits:
    """Return the screen rectangle around all poses ``(..., V, 3)`` and their shadows."""
    world = to_y_up(points, up_axis).reshape(-1, 3)
    shadow = world * [1, 0, 1] + [0, world[:, 1].min(), 0]
    screen = np.concatenate([world, shadow]) @ (view or three_quarter_view(points, up_axis)).rotation.T
    low, high = screen[:, :2].min(axis=0), screen[:, :2].max(axis=0)
    padding = margin * (float((high - low).max()) or 1.0)  # 1 for a single point, which has no size
    return low[0] - padding, high[0] + padding, low[1] - padding, high[1] + padding


def aspect_ratio(limits: Limits) -> float:
    """Return the ratio of height to width of a screen rectangle."""
    left, right, bottom, top = limits
    return (top - bottom) / (right - left)


def widen_to_aspect(limits: Limits, aspect: float) -> Limits:
    """Widen a screen rectangle about its centre to a ratio of height to width."""
    left, right, bottom, top = limits
    width, height = max(right - left, (top - bottom) / aspect), max(top - bottom, (right - left) * aspect)
    x, y = (left + right) / 2, (bottom + top) / 2
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def to_y_up(points: FloatArray, up_axis: str) -> Float:
    """Permute the axes of points ``(..., 3)`` cyclically so that Y is up; this keeps handedness."""
    up = UP_AXES.index(up_axis)
    return np.asarray(points[..., [(up - 1) % 3, up, (up + 1) % 3]], dtype=np.float64)


def heading_between(source: Float, target: Float) -> float:
    """Return the best-fit rotation in degrees about the vertical from points ``(n, 3)`` to others, 0 if undefined."""
    a, b = ((x - x.mean(axis=0))[:, [0, 2]] for x in (source, target))
    cosine, sine = float((a * b).sum()), float((a[:, 1] * b[:, 0] - a[:, 0] * b[:, 1]).sum())
    return float(np.degrees(np.arctan2(sine, cosine)))


MAX_FRAMES = 100_000
"""Largest number of frames of a film, to catch wrong frame rates and durations."""


def film_times(
    headers: Sequence[SequenceHeader], fps: float | None = None, seconds: float | None = None
) -> tuple[Float, float]:
    """Return the frame times ``(N,)`` of a film, in seconds since the first frame of the meshes, and the frame rate."""
    rate = headers[0].fps if fps is None else snap_to_ntsc(fps, headers[0].fps)
    period = max(_period(header) for header in headers)
    duration = seconds or period or 4.0  # of a single pose
    frame_count = duration * rate
    if not 1.5 <= frame_count < MAX_FRAMES:
        raise SettingsError(
            f"{duration:g} s at {rate:g} frames per second are {frame_count:.3g} frames; a film has 2 to "
            f"{MAX_FRAMES:,}, change its duration or its frame rate"
        )
    elapsed = np.arange(round(frame_count)) / rate
    if not period:
        return np.zeros_like(elapsed), rate
    rounds = np.floor(elapsed / period + 1e-9)
    # round to nanoseconds, so that every period has exactly the same times
    return np.maximum(np.round(elapsed - rounds * period, 9), 0.0), rate


def _period(header: SequenceHeader) -> float:
    if header.frame_count < 2:
        return 0.0
    return float(header.times[-1] - header.times[0]) + 1 / header.fps


def nearest_frames(header: SequenceHeader, elapsed: Float) -> Index:
    """Return the frames nearest to elapsed times ``(N,)``; of two equally near frames, return the earlier."""
    middles = (header.times[1:] + header.times[:-1]) / 2 - header.times[0]
    return np.searchsorted(middles, elapsed - 1e-6 / header.fps).astype(np.int64)


def model_times(header: SequenceHeader, elapsed: Float) -> Float:
    """Convert elapsed times ``(N,)`` to times of a model, clamped to its end."""
    clamped = np.minimum(header.times[0] + elapsed, header.times[-1])
    # snap to frames, where curves have exactly the values of their knots
    nearest = header.times[nearest_frames(header, elapsed)]
    return np.where(np.abs(clamped - nearest) < 1e-6 / header.fps, nearest, clamped)


@dataclass(frozen=True)
class SceneItem:
    """A mesh of a scene; two items are equal if they have the same name and the same motion object."""

    name: str  # may be empty
    # A model, which is decoded at any time, or a sequence, whose nearest frame is shown.
    motion: Model | Frames | FrameStore
    values: Float | None = field(default=None, compare=False, kw_only=True)  # (V,) or (T, V) numbers to show as colours

    def __str__(self) -> str:
        return self.name or self.header.name

    @property
    def header(self) -> SequenceHeader:
        """Header of the motion."""
        return self.motion.header

    @property
    def elapsed(self) -> Float:
        """Times ``(T,)`` of the frames, in seconds since the first frame."""
        return np.asarray(self.header.times - self.header.times[0])

    @property
    def model(self) -> Model | None:
        """Model of the item; None if the motion is a sequence."""
        return self.motion if isinstance(self.motion, Model) else None

    @property
    def decomposition(self) -> Decomposition | None:
        """Parts and joints of the model; None without a model or without parts."""
        return self.model.space.segmentation if self.model is not None else None

    def of_bodies(self) -> Sequence[SceneItem]:
        """Return an item for each body of the model; the item itself without a model of several bodies."""
        model = self.model
        if model is None or not model.body_names[1:]:
            return [self]
        names = {body: f"{self.name}: {body}" if self.name else body for body in model.body_names}
        return [replace(self, name=name, motion=model.body(body)) for body, name in names.items()]

    def with_random_access(self, progress: Progress = log_progress) -> SceneItem:
        """Return the item with a streamed sequence copied to a frame store."""
        return self if self.model is not None else replace(self, motion=self._frame_store(progress))

    def pose(self, elapsed: float) -> Single:
        """Return the points ``(V, 3)`` float32 at a time in elapsed seconds; hold the last pose after the end."""
        times = np.array([elapsed])
        if self.model is not None:
            return self.model(float(model_times(self.header, times)[0])).astype(np.float32)
        frame = int(nearest_frames(self.header, times)[0])
        return np.asarray(self._frame_store().points[frame : frame + 1][0], dtype=np.float32)

    def exact_pose(self, elapsed: float) -> FloatArray:
        """Return the points ``(V, 3)`` at a time in elapsed seconds, in full precision."""
        return np.asarray(next(self.poses(np.array([elapsed])))[0])

    def poses(self, elapsed: Float, workers: Executor | None = None) -> Iterator[FloatArray]:
        """Yield blocks of points ``(B, V, 3)`` at elapsed times ``(N,)``, in full precision."""
        if self.model is not None:
            yield from self.model.blocks(model_times(self.header, elapsed), workers=workers)
            return
        frames, size = nearest_frames(self.header, elapsed), block_size(self.header.vertex_count)
        for start in range(0, len(frames), size):
            yield self._frame_store().points[frames[start : start + size]]

    def decode(self, elapsed: Float, progress: Progress = log_progress, workers: Executor | None = None) -> DecodedItem:
        """Decode the poses of a film with frames at elapsed times ``(N,)``; decode each distinct pose once."""
        if self.model is None:
            store = self._frame_store(progress)
            return DecodedItem(store.header, store.points, nearest_frames(store.header, elapsed))
        distinct_times, pose_of_frame = np.unique(model_times(self.header, elapsed), return_inverse=True)
        poses = new_large_array((len(distinct_times), self.header.vertex_count, 3), np.float64)
        start = 0
        for block in self.model.blocks(distinct_times, progress=progress, workers=workers):
            poses[start : start + len(block)] = block
            start += len(block)
        return DecodedItem(self.header, poses, pose_of_frame.astype(np.int64))

    def _frame_store(self, progress: Progress = log_progress) -> FrameStore:
        assert not isinstance(self.motion, Model)
        return self.motion if isinstance(self.motion, FrameStore) else load_frames(self.motion, progress)


@dataclass(frozen=True, eq=False)
class DecodedItem:
    """The poses of a mesh over the frames of a film."""

    header: SequenceHeader  # header of the mesh
    poses: LargeArray  # (n, V, 3) distinct poses
    pose_of_frame: Index  # (N,) index of the pose in each frame of the film

    def pose(self, frame: int) -> Float:
        """Return the points ``(V, 3)`` in a frame of the film."""
        index = int(self.pose_of_frame[frame])
        return np.asarray(self.poses[index : index + 1][0], dtype=np.float64)

    @property
    def frames_of_new_poses(self) -> Index:
        """Frames ``(n,)`` of the film in which a pose appears for the first time, in order of the poses."""
        return np.sort(np.unique(self.pose_of_frame, return_index=True)[1]).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Scene:
    """Meshes that are shown together, and their frame times."""

    items: tuple[SceneItem, ...]  # the meshes
    rate: float | None = None  # requested frames per second; by default the rate of the first item
    seconds: float | None = None  # requested duration; by default the period of the longest item

    @cached_property
    def _timeline(self) -> tuple[Float, float]:
        return film_times([item.header for item in self.items], self.rate, self.seconds)

    @property
    def times(self) -> Float:
        """Times ``(N,)`` of the frames, in seconds since the first frame of the meshes."""
        return self._timeline[0]

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._timeline[1]

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.times)

    def validated(self) -> Scene:
        """Return the scene; raise SettingsError if it has too few or too many frames at its rate."""
        _ = self._timeline
        return self

    def elapsed(self, frame: int) -> float:
        """Return the time of a frame, in seconds since the first frame."""
        return float(self.times[frame])

    def frame_at(self, elapsed: float) -> int:
        """Return the frame of the scene nearest to an elapsed time in seconds."""
        return round(min(max(elapsed * self.fps, 0), self.count - 1))

    def with_item(self, index: int, motion: Model) -> Scene:
        """Return the scene with the motion of one item replaced."""
        items = list(self.items)
        items[index] = replace(items[index], motion=motion)
        return replace(self, items=tuple(items))

    def sample_frames(self, max_count: int) -> Sequence[int]:
        """Return at most `max_count` evenly spaced frames, including the first frame."""
        return [int(frame) for frame in evenly_spaced(self.count, max_count)]


def check_start_times(items: Sequence[SceneItem], original: SequenceHeader) -> None:
    """Raise SettingsError if a mesh and the original it is compared with start at different times."""
    for item in items:
        if abs(item.header.times[0] - original.times[0]) > 1e-3 / original.fps:
            raise SettingsError(
                f"{item} starts at {item.header.times[0]:g} s, the original at {original.times[0]:g} s; give both the "
                "same start time"
            )


MESH_GAP_RATIO = 0.15
"""Distance between adjacent meshes, as a fraction of the widest mesh."""

SCENE_SIZE = 2.0
"""Longest side of the bounding box of all meshes, in scene units."""

FIELD_OF_VIEW_DEGREES = 35.0
"""Vertical field of view of the camera."""

FRAMING_RATIO = 1.15
"""Size of the picture relative to the size of the projected meshes."""


STACKING_RATIO = 0.85
"""Distance of the camera from a column of meshes, relative to a row, below which meshes are stacked."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Positions of meshes in a scene, Y up, with the ground at zero."""

    up_axes: tuple[str, ...]  # up axis of each mesh
    scale: float  # scene units per unit of the meshes
    boxes: Float  # (n, 2, 3) bounding boxes over time of meshes that are not turned, relative to the offsets
    offsets: Float  # (n, 3) origins of the meshes, in scene units
    view: View  # view of the camera
    turns: tuple[float, ...]  # azimuth of each mesh's own view, in degrees from that of the camera
    is_stacked: bool = False  # whether meshes side by side form a column in the view, not a row on the ground

    @cached_property
    def rotations(self) -> Float:
        """Rotations ``(n, 3, 3)`` of the meshes about the vertical axis."""
        return np.stack([View(turn, 0.0).rotation for turn in self.turns])

    @cached_property
    def _turned_boxes(self) -> Float:
        """Bounding boxes ``(n, 2, 3)`` of the turned boxes."""
        centres = np.einsum("nij,nj->ni", self.rotations, self.boxes.mean(axis=1))
        halves = np.einsum("nij,nj->ni", np.abs(self.rotations), np.ptp(self.boxes, axis=1) / 2)
        return np.stack([centres - halves, centres + halves], axis=1)

    @property
    def low(self) -> Float:
        """Minimum corner ``(3,)`` of the bounding box of all meshes."""
        return np.asarray((self._turned_boxes[:, 0] + self.offsets).min(axis=0))

    @property
    def high(self) -> Float:
        """Maximum corner ``(3,)`` of the bounding box of all meshes."""
        return np.asarray((self._turned_boxes[:, 1] + self.offsets).max(axis=0))

    @property
    def centres(self) -> Float:
        """Centres ``(n, 3)`` of the meshes."""
        return np.asarray(self._turned_boxes.mean(axis=1) + self.offsets)

    @property
    def label_positions(self) -> Float:
        """Positions ``(n, 3)`` of labels above the meshes."""
        tops = np.where([True, False, True], self.centres, self._turned_boxes[:, 1] + self.offsets)
        return np.asarray(tops + np.array([0, 0.04 * SCENE_SIZE, 0]))

    def to_local(self, index: int, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Scale points ``(V, 3)`` of a mesh to scene units, Y up, neither turned nor moved."""
        return np.asarray(self.scale * to_y_up(points, self.up_axes[index]), dtype=np.float32)

    def place(self, index: int, local: FloatArray) -> NDArray[np.float32]:
        """Turn and move local points ``(V, 3)`` of a mesh to scene coordinates."""
        return np.asarray(local @ self.rotations[index].T + self.offsets[index], dtype=np.float32)

    def to_mesh(self, index: int, point: Float) -> Float:
        """Transform a point ``(3,)`` in scene coordinates to those of a mesh, the inverse of `to_local` and `place`."""
        local = (point - self.offsets[index]) @ self.rotations[index]
        return np.asarray(np.roll(local / self.scale, UP_AXES.index(self.up_axes[index]) - 1))

    def camera(self, aspect: float) -> tuple[Float, Float]:
        """Return position ``(3,)`` and target ``(3,)`` of a camera that shows all meshes; `aspect` is height/width."""
        centre = (self.low + self.high) / 2
        rotation = self.view.rotation
        corners = np.array(list(product(*np.stack([self.low, self.high], axis=1)))) - centre
        right, up, forwards = rotation @ corners.T
        tangent = np.tan(np.radians(FIELD_OF_VIEW_DEGREES) / 2)
        # the smallest distance at which all corners of the bounding box are inside the picture
        distance = (forwards + FRAMING_RATIO * np.maximum(np.abs(up), np.abs(right) * aspect) / tangent).max()
        return centre + distance * rotation[2], centre

    def _distance(self, aspect: float) -> float:
        position, centre = self.camera(aspect)
        return float(np.linalg.norm(position - centre))

    def side_by_side(self, centre: Float | None = None) -> Arrangement:
        """Return the arrangement with meshes in a row or column across the view.

        The mean of their centres is `centre` ``(3,)``, by default where it was.
        """
        axis = -self.view.rotation[1] if self.is_stacked else View(self.view.azimuth, 0.0).rotation[0]
        boxes = self._turned_boxes
        sizes = np.ptp(boxes, axis=1) @ np.abs(axis)
        ends = np.cumsum(sizes + MESH_GAP_RATIO * sizes.max())
        offsets = np.outer(ends - sizes / 2, axis) - boxes.mean(axis=1)
        middle = self.centres.mean(axis=0) if centre is None else centre
        offsets += middle - (offsets + boxes.mean(axis=1)).mean(axis=0)
        if not self.is_stacked:
            offsets[:, 1] = -boxes[:, 0, 1]
        return replace(self, offsets=offsets)

    def fitted(self, aspect: float) -> Arrangement:
        """Return a row, or a column if it shows the meshes larger in a picture that is higher than wide.

        `aspect` is height/width.
        """
        row, column = (replace(self, is_stacked=is_stacked).side_by_side() for is_stacked in (False, True))
        is_larger = aspect > 1 and column._distance(aspect) < STACKING_RATIO * row._distance(aspect)
        return column if is_larger else row

    def seen_from(self, view: View, target: Float, distance: float) -> Arrangement:
        """Return the arrangement with meshes across a new view, so that no mesh hides another.

        If the camera is close, the mesh nearest to its target ``(3,)`` stays fixed, else the centre of all meshes.
        """
        moved = replace(self, view=view).side_by_side()
        if distance >= 0.7 * self._distance(aspect=1.0):
            return moved
        nearest = np.linalg.norm(self.centres - target, axis=1).argmin()
        return replace(moved, offsets=moved.offsets + (self.centres - moved.centres)[nearest])

    def turned(self, index: int, degrees: float) -> Arrangement:
        """Return the arrangement with the own view of one mesh at another azimuth."""
        turns = (*self.turns[:index], degrees, *self.turns[index + 1 :])
        return replace(self, turns=turns).side_by_side(self.centres.mean(axis=0))


def arrange_meshes(scene: Scene, side_by_side: bool, camera: tuple[float, float] | None = None) -> Arrangement:
    """Arrange the meshes of a scene side by side or overlaid, with `camera` angles as in `resolve_view`."""
    up_axes = tuple(item.header.up_axis for item in scene.items)
    boxes = []
    for item, up_axis in zip(scene.items, up_axes, strict=True):
        frames = scene.sample_frames(8)  # enough to estimate the bounds over time
        poses = [to_y_up(item.pose(scene.elapsed(frame)), up_axis) for frame in frames]
        boxes.append((np.min(poses, axis=(0, 1)), np.max(poses, axis=(0, 1))))
    bounds = np.array(boxes)
    first = scene.items[0]
    ends = np.stack([first.pose(0.0), first.pose(float(first.elapsed[-1]))])
    offsets = np.tile([0.0, -bounds[:, 0, 1].min(), 0.0], (len(bounds), 1))
    view = resolve_view(ends, up_axes[0], camera)
    unscaled = Arrangement(up_axes, 1.0, bounds, offsets, view, (0.0,) * len(bounds))
    if side_by_side:
        unscaled = unscaled.side_by_side()
    scale = SCENE_SIZE / (float((unscaled.high - unscaled.low).max()) or 1.0)
    centre = (unscaled.low + unscaled.high) / 2 * [1, 0, 1]
    return replace(unscaled, scale=scale, boxes=scale * bounds, offsets=scale * (unscaled.offsets - centre))
