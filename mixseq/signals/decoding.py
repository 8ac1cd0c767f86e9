"""Decode frames and velocities of motions at any time, in blocks on any executor; measure errors between frames.

Programs interpolate what they play between its frames, each in its own way: joints by slerp, weights and points along
straight lines, compressed files by splines. The distance of what is played from the motion that it was made of is
measured at the quarters of all intervals between frames.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, repeat
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.runtime.parallel import Executor, serial_executor, thread_executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_span, hint_frame_number, snap_to_ntsc
from mixseq.sequence.header import SequenceHeader, frame_times
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import Frames, MeshSequence, Rig, is_rig
from mixseq.spaces.temporal import insert_midpoints
from mixseq.types import Float, FloatArray

Decoded = TypeVar("Decoded")
Delivery = TypeVar("Delivery")

FRAMES_PER_BLOCK = 4  # number of frames of large meshes that a thread decodes at once

MAX_FRAMES_PER_BLOCK, VERTICES_PER_BLOCK = 16, 1 << 19
"""Largest number of frames that a thread decodes at once, and of their vertices, if there are more frames than 4."""


class Decodable(ABC):
    """A motion that can be decoded at any time."""

    header: SequenceHeader
    is_serial = False  # whether blocks are decoded on the caller's thread only

    @property
    def times(self) -> Float:
        """Times ``(T,)`` of the frames in seconds."""
        times: Float = self.header.times
        return times

    @property
    def start(self) -> float:
        """First time in seconds."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Last time in seconds."""
        return float(self.times[-1])

    @abstractmethod
    def decode_points(self, times: Float) -> Float:
        """Return the points ``(N, V, 3)`` at times ``(N,)`` from start to end, on this thread."""

    @abstractmethod
    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        """Return points and velocities ``(N, V, 3)`` at times ``(N,)`` from start to end, on this thread."""

    def prepare(self, times: Float, velocities: bool, progress: Progress) -> None:  # noqa: B027
        """Compute what frames at times ``(N,)`` have in common, before threads decode them; by default nothing."""

    def __call__(self, times: ArrayLike) -> Float:
        """Return the vertex positions ``(V, 3)`` at a time in seconds, or ``(N, V, 3)`` at times ``(N,)``.

        Raises
        ------
        SettingsError
            If the time is outside the sequence, because motions are not extrapolated.
        """
        return self._like_times(times, self.blocks(times))

    def velocity(self, times: ArrayLike) -> Float:
        """Return the analytic velocities of the vertices in units per second, in the shape that `__call__` returns."""
        return self._like_times(times, (velocities for _, velocities in self.moving_blocks(times)))

    def _like_times(self, times: ArrayLike, blocks: Iterable[Float]) -> Float:
        """Join blocks ``(B, V, 3)`` of frames, and return a frame ``(V, 3)`` for a single time."""
        frames = np.concatenate([np.empty((0, self.header.vertex_count, 3)), *blocks])
        return frames if np.ndim(times) else frames[0]

    def sample(
        self,
        times: ArrayLike | None = None,
        fps: float | None = None,
        progress: Progress = log_progress,
        *,
        frames: Iterable[int] | None = None,
        velocities: bool = False,
    ) -> MeshSequence:
        """Decode frames of the motion to a mesh sequence.

        Parameters
        ----------
        times : (N,) array_like, optional
            Increasing times in seconds; by default the times of the frames.
        fps : float, optional
            Frames per second. Without `times`, the sequence is sampled at this rate from its first time. With `times`,
            only the frame rate of the result is set. 23.976 means 24000/1001, see `mixseq.sequence.frame_rates`.
        progress : callable, optional
            Called for every frame.
        frames : iterable of int, optional
            Increasing indices of frames of the sequence, given instead of `times`, such as ``range(10, 20)``.
        velocities : bool
            Also compute `MeshSequence.velocities`, for motion blur.

        Returns
        -------
        MeshSequence
            float64 points in the units of the original.

        Raises
        ------
        SettingsError
            If a time or a frame is outside the sequence, or fps is not positive.
        """
        header = self.header_at(times if frames is None else self._times_of_frames(frames, times), fps)
        if velocities:
            moving = list(self.moving_blocks(header.times, progress=progress))
            points, speeds = (np.concatenate(arrays) for arrays in zip(*moving, strict=True))
            return MeshSequence.from_header(header, points, speeds)
        points = np.concatenate(list(self.blocks(header.times, progress=progress)))
        return MeshSequence.from_header(header, points)

    def _times_of_frames(self, frames: Iterable[int], times: ArrayLike | None) -> Float:
        ids = np.fromiter(frames, dtype=np.int64)
        if times is not None:
            raise SettingsError("give either times or frames")
        is_outside = (ids < 0) | (ids >= len(self.times))
        if is_outside.any() or not ids.size:
            problem = f"there is no frame {ids[is_outside][0]}" if ids.size else "the list of frames is empty"
            raise SettingsError(f"{problem}; the sequence has frames 0 to {len(self.times) - 1}")
        return np.asarray(self.times[ids])

    def header_at(self, times: ArrayLike | None = None, fps: float | None = None) -> SequenceHeader:
        """Return the header of the sequence that `sample` returns, without decoding."""
        if fps is not None and not (np.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps is {fps}; a positive number is expected")
        fps = None if fps is None else snap_to_ntsc(fps, self.header.fps)
        if times is None and fps is not None:
            times = frame_times(self.times[0], self.times[-1], fps)
        if times is None or np.array_equal(times, self.times):
            return self.header.with_times(self.times, fps)
        header = self.header.with_times(self.clip_times(times), fps)
        return replace(header, provenance=as_edited(header.provenance))

    def blocks(
        self,
        times: ArrayLike,
        size: int = MAX_FRAMES_PER_BLOCK,
        progress: Progress = log_progress,
        workers: Executor | None = None,
    ) -> Iterator[Float]:
        """Decode frames at `times` in blocks ``(B, V, 3)``, B <= size; results do not depend on size and workers."""
        return self._decode_blocks(type(self).decode_points, times, size, progress, workers)

    def moving_blocks(
        self,
        times: ArrayLike,
        size: int = MAX_FRAMES_PER_BLOCK,
        progress: Progress = log_progress,
        workers: Executor | None = None,
    ) -> Iterator[tuple[Float, Float]]:
        """Decode blocks of points and velocities ``(B, V, 3)``, in units and units per second; see `blocks`."""
        return self._decode_blocks(type(self).decode_moving, times, size, progress, workers)

    def _decode_blocks(
        self,
        decode: Callable[[Self, Float], Decoded],
        times: ArrayLike,
        size: int,
        progress: Progress,
        workers: Executor | None,
    ) -> Iterator[Decoded]:
        """Yield results of `decode_points` or `decode_moving` at times ``(N,)`` in blocks of `size` frames."""
        clipped = self.clip_times(times)
        size = min(size, max(FRAMES_PER_BLOCK, VERTICES_PER_BLOCK // self.header.vertex_count))
        blocks = (clipped[start : start + size] for start in range(0, len(clipped), size))
        threads = thread_executor() if len(clipped) > size else serial_executor
        executor = serial_executor if self.is_serial else workers or threads
        self.prepare(clipped, decode is type(self).decode_moving, progress)
        done = 0
        for block in executor(decode, self, blocks):
            yield block
            done = min(done + size, len(clipped))
            progress(done, len(clipped), "decoding frames")

    def clip_times(self, times: ArrayLike) -> Float:
        """Clip times ``(N,)`` to the model's range; raise `SettingsError` if a time is over 0.001 frames outside."""
        result = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, last, fps = self.start, self.end, self.header.fps
        slack = FRAME_TOLERANCE / fps
        is_outside = ~((result >= first - slack) & (result <= last + slack))
        if is_outside.any():
            time = float(result[is_outside][0])
            raise SettingsError(
                f"time {time:g} s is outside the sequence, {format_span(first, last, fps)}; motions are not "
                f"extrapolated{hint_frame_number(time, first, last, fps)}"
            )
        return np.clip(result, first, last)


@dataclass(frozen=True, eq=False)
class RigMotion(Decodable):
    """The motion of an open rig, evaluated on the caller's thread, since its file has one position."""

    header: SequenceHeader
    rig: Rig
    is_serial = True

    def decode_points(self, times: Float) -> Float:
        """Return the points ``(N, V, 3)`` at times ``(N,)`` from start to end."""
        return np.concatenate(list(self.rig.blocks_at(times, len(times)))).astype(np.float64)

    def decode_moving(self, times: Float) -> tuple[Float, Float]:
        """Return points and velocities ``(N, V, 3)`` at times ``(N,)`` from start to end."""
        velocities = np.concatenate(list(self.rig.velocity_blocks_at(times, len(times))))
        return self.decode_points(times), velocities.astype(np.float64)


MAX_FRAME_FACTOR = 8  # largest number of frames of a delivery per frame of its motion
FRAME_BOUND_RATIO = 0.75  # bound at frames relative to that between them: keys take fewer bytes than accuracy


def quarter_times(times: Float) -> Float:
    """Return the times ``(3 (T - 1),)`` at the quarters of the intervals between frames at times ``(T,)``."""
    return np.delete(insert_midpoints(insert_midpoints(times)), np.s_[::4])


def played_blocks(delivery: Decodable | Frames, times: Float) -> Iterator[FloatArray]:
    """Yield points ``(B, V, 3)`` at `quarter_times`, as programs play a delivery: plain points along straight lines."""
    if isinstance(delivery, Decodable):
        return delivery.blocks(times)
    return delivery.blocks_at(times) if is_rig(delivery) else straight_blocks(delivery.blocks(), times)


def straight_blocks(blocks: Iterable[FloatArray], times: Float) -> Iterator[FloatArray]:
    """Yield points ``(3, V, 3)`` at the quarters between frames of blocks ``(B, V, 3)``; a single frame is repeated."""
    frames = chain.from_iterable(blocks)
    before = next(frames)
    is_still = True
    for after in frames:
        yield np.stack([(1 - fraction) * before + fraction * after for fraction in (0.25, 0.5, 0.75)])
        before, is_still = after, False
    if is_still:
        yield from repeat(before[None], len(times))


def largest_distance(expected: Iterable[FloatArray], played: Iterable[FloatArray]) -> float:
    """Return the largest distance of a vertex in blocks of points ``(B, V, 3)``, which may have different sizes."""
    pairs = zip(chain.from_iterable(expected), chain.from_iterable(played), strict=True)
    return max((float(np.sqrt(np.square(x - y).sum(axis=1).max())) for x, y in pairs), default=0.0)


def hold_between(
    motion: Decodable, frames: MeshSequence, bound: float, make: Callable[[MeshSequence, float], tuple[Delivery, float]]
) -> Delivery:
    """Make a delivery of more and more frames, until its error between frames is at most `bound` diagonals.

    `make` takes the frames and their bound, and returns a delivery and its error between frames.
    """
    least, factor = np.inf, 1
    while factor <= MAX_FRAME_FACTOR:
        delivery, error = make(frames, FRAME_BOUND_RATIO * bound)
        if error <= bound:
            return delivery
        least, factor = min(least, error), 2 * factor
        frames = motion.sample(insert_midpoints(frames.times), 2 * frames.fps)
    raise SettingsError(
        f"between frames, {least:.2g} diagonals can be reached with up to {MAX_FRAME_FACTOR} times the frames, not "
        f"{bound:g}; allow more (--max-error), or leave out --between-frames"
    )
