"""Scenes: moving meshes with a common start and frame rate, their frame times, places, and the camera in front of them.

Frame k is shown at :math:`k / f`, with f frames per second. The *period* is that of the longest mesh: the time from its
first frame to its last, and one frame. Shorter ones wait in their last pose, and all restart when it has ended.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import remainder

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.runtime.low_memory import LargeArray, new_large_array
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, silent
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.frame_rates import exact_rate
from mixseq.sequence.header import UP_AXES, SequenceHeader
from mixseq.sequence.sequence import Frames, FrameStore, block_size, frame_store
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray, Index, Single, evenly

Limits = tuple[float, float, float, float]
"""Left, right, bottom and top of a screen rectangle, in units of the points."""

TRAVELS = 0.5
"""Displacement from the first to the last pose above which a body travels, in its diagonals."""


@dataclass(frozen=True)
class View:
    """An orthographic camera around the mesh."""

    azimuth: float = 30.0
    elevation: float = 14.0

    @property
    def rotation(self) -> Float:
        """Rotation ``(3, 3)`` from a Y-up world to the screen: right, up, towards the camera."""
        # without full turns, which are not exact in radians
        a, e = np.radians([remainder(self.azimuth, 360), self.elevation])
        around = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
        above = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return np.asarray(above @ around)


@dataclass(frozen=True, eq=False)
class Camera:
    """The view of a mesh during a film of N frames."""

    view: View  # the view of the first frame
    turn: float  # degrees by which it turns until the first frame comes again, after N
    centres: Float  # (N, 3) what it looks at, and turns about, in each frame, Y up
    ground: float  # height of the ground
    limits: Limits  # (4,) screen rectangle that holds all frames

    def at(self, frame: int) -> View:
        """Return the view in a frame."""
        return View(self.view.azimuth + frame / len(self.centres) * self.turn, self.view.elevation)

    @property
    def aspect(self) -> float:
        """Height per width of the view."""
        return aspect_ratio(self.limits)

    def fitted(self, aspect: float) -> Camera:
        """Return a camera that is widened to an aspect."""
        return replace(self, limits=widen_to_aspect(self.limits, aspect))


def front_azimuth(poses: FloatArray, up_axis: str = "Y") -> float:
    """Return the azimuth in degrees from which a body in poses ``(n, V, 3)`` is seen from the front.

    It faces its travel direction, or else the front of modellers and formats: +z with Y up (glTF 2.0, section 3.4), -y
    with Z up (Blender, Maya), where +x is to its left in both.
    """
    ends = to_y_up(poses[[0, -1]], up_axis)
    x, _, z = ends[1].mean(axis=0) - ends[0].mean(axis=0)
    if np.hypot(x, z) < TRAVELS * np.linalg.norm(np.ptp(ends[0], axis=0)) or x == z == 0:
        return -90.0 if up_axis == "Z" else 0.0
    return float(np.round(np.degrees(np.arctan2(x, z))))  # whole degrees are the same on every machine


def three_quarter_view(
    poses: FloatArray, up_axis: str = "Y", turn: float = 30.0, elevation: float = 14.0
) -> View:
    """Return a view of the front and a side of poses ``(V, 3)``, `turn` degrees from a full view of the longer one.

    Of the left and the right view, it is the one with +x more to the right, and +z more to the camera, with Y up.
    """
    poses = poses.reshape(-1, *poses.shape[-2:])
    front = front_azimuth(poses, up_axis)
    first = to_y_up(poses[0], up_axis)
    forwards = np.array([np.sin(np.radians(front)), np.cos(np.radians(front))])
    along, across = np.ptp(first[:, [0, 2]] @ np.stack([forwards, forwards[::-1] * [1, -1]], axis=1), axis=0)
    away = turn if across >= along else 90.0 - turn
    sides = [(front + side + 180) % 360 - 180 for side in (away, -away)]
    return View(min(sides, key=lambda azimuth: abs((azimuth - 45 + 180) % 360 - 180)), elevation)


def resolve_view(ends: FloatArray, up_axis: str, camera: tuple[float, float] | None) -> View:
    """Return the view at `camera` (two angles in degrees), by default a `three_quarter_view` of ends ``(2, V, 3)``."""
    if camera is None:
        return three_quarter_view(ends, up_axis)
    return View(front_azimuth(ends, up_axis) + camera[0], camera[1])


def shared_limits(
    points: FloatArray, up_axis: str = "Y", view: View | None = None, margin: float = 0.04
) -> Limits:
    """Return the screen rectangle of all poses and their shadows: points ``(..., V, 3)``."""
    world = to_y_up(points, up_axis).reshape(-1, 3)
    shadow = world * [1, 0, 1] + [0, world[:, 1].min(), 0]
    screen = np.concatenate([world, shadow]) @ (view or three_quarter_view(points, up_axis)).rotation.T
    low, high = screen[:, :2].min(axis=0), screen[:, :2].max(axis=0)
    space = margin * (float((high - low).max()) or 1.0)  # a single point still gets a rectangle
    return low[0] - space, high[0] + space, low[1] - space, high[1] + space


def aspect_ratio(limits: Limits) -> float:
    """Return the height per width of a rectangle."""
    left, right, bottom, top = limits
    return (top - bottom) / (right - left)


def widen_to_aspect(limits: Limits, aspect: float) -> Limits:
    """Widen a rectangle about its middle to a height per width."""
    left, right, bottom, top = limits
    width, height = max(right - left, (top - bottom) / aspect), max(top - bottom, (right - left) * aspect)
    x, y = (left + right) / 2, (bottom + top) / 2
    return x - width / 2, x + width / 2, y - height / 2, y + height / 2


def to_y_up(points: FloatArray, up_axis: str) -> Float:
    """Permute the axes so that Y is up, keeping right-handedness."""
    up = UP_AXES.index(up_axis)
    return np.asarray(points[..., [(up - 1) % 3, up, (up + 1) % 3]], dtype=np.float64)


STILL = 4.0
"""Duration of a film of a single pose, in seconds."""

MOST_FRAMES = 100_000
"""Largest number of frames, to catch wrong rates and durations."""


def film_times(
    headers: Sequence[SequenceHeader], fps: float | None = None, seconds: float | None = None
) -> tuple[Float, float]:
    """Return the frame times ``(N,)`` of a film since the meshes' first times, and its frames per second."""
    rate = headers[0].fps if fps is None else exact_rate(fps, headers[0].fps)
    period = max(_period(header) for header in headers)
    lasting = seconds or period or STILL
    wanted = lasting * rate
    if not 1.5 <= wanted < MOST_FRAMES:
        raise SettingsError(
            f"{lasting:g} s at {rate:g} frames per second are {wanted:.3g} frames; a film has from 2 to "
            f"{MOST_FRAMES:,}, change its duration or its rate"
        )
    elapsed = np.arange(round(wanted)) / rate
    if not period:
        return np.zeros_like(elapsed), rate
    rounds = np.floor(elapsed / period + 1e-9)
    # to nanoseconds, so that the same time is the same number in every round
    return np.maximum(np.round(elapsed - rounds * period, 9), 0.0), rate


def _period(header: SequenceHeader) -> float:
    if header.frame_count < 2:
        return 0.0
    return float(header.times[-1] - header.times[0]) + 1 / header.fps


def nearest_frames(header: SequenceHeader, elapsed: Float) -> Index:
    """Return the frames ``(N,)`` nearest to times since the first one, the earlier of two."""
    middles = (header.times[1:] + header.times[:-1]) / 2 - header.times[0]
    return np.searchsorted(middles, elapsed - 1e-6 / header.fps).astype(np.int64)


def model_times(header: SequenceHeader, elapsed: Float) -> Float:
    """Return times ``(N,)`` of a model for times since its first one, clipped to its end."""
    inside = np.minimum(header.times[0] + elapsed, header.times[-1])
    # a curve has exactly the values of its knots at exactly their times
    nearest = header.times[nearest_frames(header, elapsed)]
    return np.where(np.abs(inside - nearest) < 1e-6 / header.fps, nearest, inside)


@dataclass(frozen=True)
class SceneItem:
    """A mesh of a scene; equal to others of the same name and the identical motion."""

    name: str  # what it is called; may be empty
    # What moves: a model, which is decoded at any time, or a sequence, of which the nearest frame is shown.
    motion: Model | Frames | FrameStore

    def __str__(self) -> str:
        return self.name or self.header.name

    @property
    def header(self) -> SequenceHeader:
        """Header of the sequence, without points."""
        return self.motion.header

    @property
    def elapsed(self) -> Float:
        """Times ``(T,)`` of its own frames, in seconds since the first one."""
        return np.asarray(self.header.times - self.header.times[0])

    @property
    def model(self) -> Model | None:
        """The motion, if it is a model."""
        return self.motion if isinstance(self.motion, Model) else None

    @property
    def decomposition(self) -> Decomposition | None:
        """Parts and joints, if it is a model with parts."""
        return self.model.space.segmentation if self.model is not None else None

    def with_random_access(self, progress: Progress = silent) -> SceneItem:
        """Return the item with a streaming sequence copied, for random access."""
        return self if self.model is not None else replace(self, motion=self._frames(progress))

    def pose(self, elapsed: float) -> Single:
        """Return the points ``(V, 3)`` at `elapsed` seconds after the first frame; the last pose after the end."""
        times = np.array([elapsed])
        if self.model is not None:
            return self.model(float(model_times(self.header, times)[0])).astype(np.float32)
        row = int(nearest_frames(self.header, times)[0])
        return np.asarray(self._frames().points[row : row + 1][0], dtype=np.float32)

    def exact_pose(self, elapsed: float) -> FloatArray:
        """Return the points as `pose` does, in full precision."""
        return np.asarray(next(self.poses(np.array([elapsed])))[0])

    def poses(self, elapsed: Float, workers: Executor | None = None) -> Iterator[FloatArray]:
        """Yield blocks of points ``(B, V, 3)`` at times ``(N,)`` since the first frame, in full precision."""
        if self.model is not None:
            yield from self.model.blocks(model_times(self.header, elapsed), workers=workers)
            return
        rows, size = nearest_frames(self.header, elapsed), block_size(self.header.vertex_count)
        for start in range(0, len(rows), size):
            yield self._frames().points[rows[start : start + size]]

    def decode(
        self, elapsed: Float, progress: Progress = silent, workers: Executor | None = None
    ) -> DecodedItem:
        """Return the poses of a film with frames at times ``(N,)``, each decoded once."""
        if self.model is None:
            store = self._frames(progress)
            return DecodedItem(store.header, store.points, nearest_frames(store.header, elapsed))
        needed, pose_of_frame = np.unique(model_times(self.header, elapsed), return_inverse=True)
        poses = new_large_array((len(needed), self.header.vertex_count, 3), np.float64)
        first = 0
        for block in self.model.blocks(needed, progress=progress, workers=workers):
            poses[first : first + len(block)] = block
            first += len(block)
        return DecodedItem(self.header, poses, pose_of_frame.astype(np.int64))

    def _frames(self, progress: Progress = silent) -> FrameStore:
        assert not isinstance(self.motion, Model)
        return self.motion if isinstance(self.motion, FrameStore) else frame_store(self.motion, progress)


@dataclass(frozen=True, eq=False)
class DecodedItem:
    """The poses of a mesh over the frames of a film."""

    header: SequenceHeader  # everything but the points
    poses: LargeArray  # (n, V, 3) poses that are shown
    pose_of_frame: Index  # (N,) which of them every frame of the film shows

    def pose(self, frame: int) -> Float:
        """Return the points ``(V, 3)`` in a frame of the film."""
        row = int(self.pose_of_frame[frame])
        return np.asarray(self.poses[row : row + 1][0], dtype=np.float64)

    @property
    def shown_first(self) -> Index:
        """Frames of the film that first show a pose."""
        return np.sort(np.unique(self.pose_of_frame, return_index=True)[1]).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Scene:
    """The meshes shown, and their frame times."""

    items: tuple[SceneItem, ...]  # the meshes
    rate: float | None = None  # frames per second that were asked for; by default those of the first item
    seconds: float | None = None  # duration that was asked for; by default that of the longest item

    @cached_property
    def _timeline(self) -> tuple[Float, float]:
        return film_times([item.header for item in self.items], self.rate, self.seconds)

    @property
    def times(self) -> Float:
        """Times ``(N,)`` of the frames, in seconds since the meshes' first ones."""
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
        """Return the scene; SettingsError if it has too few or too many frames at its rate."""
        _ = self._timeline
        return self

    def elapsed(self, frame: int) -> float:
        """Return the time of a frame, in seconds since the meshes' first ones."""
        return float(self.times[frame])

    def frame_at(self, elapsed: float) -> int:
        """Return the frame nearest to a time since the first one."""
        return round(min(max(elapsed * self.fps, 0), self.count - 1))

    def with_item(self, index: int, motion: Model) -> Scene:
        """Return the scene with another motion of one mesh."""
        items = list(self.items)
        items[index] = replace(items[index], motion=motion)
        return replace(self, items=tuple(items))

    def sample_frames(self, max_count: int) -> Sequence[int]:
        """Return at most `most` evenly spaced frames, with the first."""
        return [int(frame) for frame in evenly(self.count, max_count)]


def same_mesh(one: SequenceHeader, other: SequenceHeader) -> bool:
    """Whether two headers have the same vertices and triangles, in the same order."""
    return one.vertex_count == other.vertex_count and np.array_equal(one.faces, other.faces)


def check_starts(items: Sequence[SceneItem], original: SequenceHeader) -> None:
    """Raise SettingsError for errors of meshes that start at another time than their original."""
    for item in items:
        if abs(item.header.times[0] - original.times[0]) > 1e-3 / original.fps:
            raise SettingsError(
                f"{item} begins at {item.header.times[0]:g} s, the original at {original.times[0]:g} s; errors need "
                "the same times"
            )


SAMPLES = 8
"""Number of frames from which the space of a mesh is measured."""

GAP = 0.15
"""Space between meshes, as a fraction of the widest."""

HEIGHT = 2.0
"""Longest side of the whole arrangement, in units of the scene."""

FIELD = 35.0
"""Vertical field of view of the camera, in degrees."""

NEAR = 0.7
"""Fraction of the camera distance that shows all meshes, below which the camera looks at a single one."""

MARGIN = 1.15
"""Width and height of the picture, relative to the projected meshes."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Places of meshes in the scene, Y up, ground at zero."""

    up_axes: tuple[str, ...]  # axis of each mesh that points up
    scale: float  # units of the scene per unit of the meshes
    boxes: Float  # (n, 2, 3) bounding boxes over time, relative to the origins, in units of the scene
    offsets: Float  # (n, 3) origins of the meshes, in units of the scene
    view: View  # the view of the camera

    @property
    def low(self) -> Float:
        """Minimum corner ``(3,)`` of the box around all meshes."""
        return np.asarray((self.boxes[:, 0] + self.offsets).min(axis=0))

    @property
    def high(self) -> Float:
        """Maximum corner ``(3,)`` of the box around all meshes."""
        return np.asarray((self.boxes[:, 1] + self.offsets).max(axis=0))

    @property
    def middles(self) -> Float:
        """Centres ``(n, 3)`` of the meshes."""
        return np.asarray(self.boxes.mean(axis=1) + self.offsets)

    @property
    def labels(self) -> Float:
        """Label places ``(n, 3)`` above the meshes."""
        tops = np.where([True, False, True], self.middles, self.boxes[:, 1] + self.offsets)
        return np.asarray(tops + np.array([0, 0.04 * HEIGHT, 0]))

    def placed(self, index: int, points: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return points ``(V, 3)`` of a mesh in scene coordinates."""
        placed = self.scale * to_y_up(points, self.up_axes[index]) + self.offsets[index]
        return np.asarray(placed, dtype=np.float32)

    def camera(self, aspect: float) -> tuple[Float, Float]:
        """Return the camera position and its target, ``(3,)`` each, for a picture of the given width per height."""
        centre = (self.low + self.high) / 2
        rotation = self.view.rotation
        corners = np.array(list(product(*np.stack([self.low, self.high], axis=1)))) - centre
        right, up, near = rotation @ corners.T
        tangent = np.tan(np.radians(FIELD) / 2)
        # what is at most so far to the side, or above, as the picture reaches where it is
        distance = (near + MARGIN * np.maximum(np.abs(up), np.abs(right) / aspect) / tangent).max()
        return centre + distance * rotation[2], centre

    def turned(self, azimuth: float, looked_at: Float, distance: float) -> Arrangement:
        """Return the meshes in a row across another view, so that none hides another.

        The nearest mesh to the target `looked_at` ``(3,)`` stays in place if the camera is near, else the middle of the
        row.
        """
        offsets = _row(self.boxes, azimuth)
        moved = (self.offsets - offsets) * [1, 0, 1]
        place, centre = self.camera(aspect=1.0)
        if distance < NEAR * np.linalg.norm(place - centre):
            shift = moved[np.linalg.norm(self.middles - looked_at, axis=1).argmin()]
        else:
            shift = moved.mean(axis=0)
        return replace(self, offsets=offsets + shift, view=View(azimuth, self.view.elevation))


def arranged(scene: Scene, side_by_side: bool, camera: tuple[float, float] | None = None) -> Arrangement:
    """Place the meshes of a scene, without overlap if side by side; `camera` as in `resolve_view`."""
    up_axes = tuple(item.header.up_axis for item in scene.items)
    boxes = []
    for item, up in zip(scene.items, up_axes, strict=True):
        poses = [to_y_up(item.pose(scene.elapsed(frame)), up) for frame in scene.sample_frames(SAMPLES)]
        boxes.append((np.min(poses, axis=(0, 1)), np.max(poses, axis=(0, 1))))
    spans = np.array(boxes)
    first = scene.items[0]
    ends = np.stack([first.pose(0.0), first.pose(float(first.elapsed[-1]))])
    view = resolve_view(ends, up_axes[0], camera)
    ground = float(spans[:, 0, 1].min())
    offsets = _row(spans, view.azimuth) if side_by_side else np.tile([0.0, -ground, 0.0], (len(spans), 1))
    low, high = (spans[:, 0] + offsets).min(axis=0), (spans[:, 1] + offsets).max(axis=0)
    scale = HEIGHT / (float((high - low).max()) or 1.0)
    centre = (low + high) / 2 * [1, 0, 1]
    return Arrangement(up_axes, scale, scale * spans, scale * (offsets - centre), view)


def _row(boxes: Float, azimuth: float) -> Float:
    """Return offsets ``(n, 3)`` of a row across the view, on the ground."""
    a = np.radians(azimuth)
    right = np.array([np.cos(a), 0.0, -np.sin(a)])
    sizes = [np.abs(right) @ (high - low) for low, high in boxes]
    gap = GAP * max(sizes)
    offsets, place = [], 0.0
    for (low, high), size in zip(boxes, sizes, strict=True):
        centre = (low + high) / 2
        offsets.append((place + size / 2) * right - [centre[0], low[1], centre[2]])
        place += size + gap
    return np.array(offsets)
