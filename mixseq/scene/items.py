"""Items of a scene: moving meshes with a common start and frame rate, for films, pages and the viewer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, Single, evenly
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, block_size, frame_store
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.scene.scene_times import film_times, model_times, nearest_frames
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import Frames, SequenceHeader
from mixseq.signals import Model


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
        return self.model.space.decomposed if self.model is not None else None

    def stored(self, progress: Progress = silent) -> SceneItem:
        """Return the item with a streaming sequence copied, for random access."""
        return self if self.model is not None else replace(self, motion=self._frames(progress))

    def pose(self, elapsed: float) -> Single:
        """Return the points ``(V, 3)`` at `elapsed` seconds after the first frame; the last pose after the end."""
        times = np.array([elapsed])
        if self.model is not None:
            return self.model(float(model_times(self.header, times)[0])).astype(np.float32)
        row = int(nearest_frames(self.header, times)[0])
        return np.asarray(self._frames().points[row : row + 1][0], dtype=np.float32)

    @property
    def ends(self) -> Single:
        """Points ``(2, V, 3)`` of the first and the last frame."""
        return np.stack([self.pose(0.0), self.pose(float(self.elapsed[-1]))])

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

    def checked(self) -> Scene:
        """Return the scene; SettingsError if it has too few or too many frames at its rate."""
        film_times([item.header for item in self.items], self.rate, self.seconds)
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

    def samples(self, most: int) -> Sequence[int]:
        """Return at most `most` evenly spaced frames, with the first."""
        return [int(frame) for frame in evenly(self.count, most)]


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
