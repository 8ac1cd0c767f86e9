"""Decoding motions at any time: frames, velocities, blocks of them on any executor."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.runtime.parallel import Executor, serial_executor, thread_executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.frame_rates import format_span, hint_frame_number, snap_to_ntsc
from mixseq.sequence.header import SequenceHeader, frame_times
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.base import ShapeSpace
from mixseq.types import Float

Decoded = TypeVar("Decoded")

FRAMES_PER_BLOCK = 4
"""Frames decoded at once, per thread."""


class ResidualLayer(Protocol):
    """Displacements of vertices over time that are added to decoded frames, in the units of the sequence."""

    def at(self, times: Float) -> Float:
        """Return displacements ``(N, V, 3)`` at times ``(N,)`` in seconds."""

    def rates(self, times: Float) -> Float:
        """Return their derivatives ``(N, V, 3)`` by time, per second."""


class Decodable(ABC):
    """A motion that can be decoded at any time: vectors of a shape space over time, and a residual layer."""

    header: SequenceHeader
    space: ShapeSpace
    residual_layer: ResidualLayer | None

    @property
    def times(self) -> Float:
        """Times ``(T,)`` of the frames in seconds."""
        times: Float = self.header.times
        return times

    @property
    @abstractmethod
    def start(self) -> float:
        """First time in seconds."""

    @property
    @abstractmethod
    def end(self) -> float:
        """Last time in seconds."""

    @abstractmethod
    def curve(self, times: ArrayLike) -> Float:
        """Return the vectors ``(N, D)`` of the space at times ``(N,)`` in seconds."""

    @abstractmethod
    def rates(self, times: ArrayLike) -> Float:
        """Return the derivatives ``(N, D)`` of `curve` by time, per second."""

    def __call__(self, time: float) -> Float:
        """Return the vertex positions ``(V, 3)`` at a time in seconds.

        Raises
        ------
        SettingsError
            If the time is outside the sequence: models do not extrapolate.
        """
        frame: Float = next(self.blocks([time]))[0]
        return frame

    def velocity(self, time: float) -> Float:
        """Return the analytic velocities ``(V, 3)`` of the vertices in units per second."""
        frame: Float = next(self.moving_blocks([time]))[1][0]
        return frame

    def sample(
        self,
        times: ArrayLike | None = None,
        fps: float | None = None,
        progress: Progress = no_progress,
        *,
        frames: Iterable[int] | None = None,
        velocities: bool = False,
    ) -> MeshSequence:
        """Decode frames.

        Parameters
        ----------
        times : (N,) array_like, optional
            Times in seconds, increasing; by default those of the sequence.
        fps : float, optional
            Frames per second: without `times` the rate at which the sequence is sampled from its first time on; with
            `times` their time line only. 23.976 means 24000/1001, see `mixseq.sequence.frame_rates`.
        progress : callable, optional
            Called for every frame.
        frames : iterable of int, optional
            Numbers of the sequence's own frames, increasing, instead of times: ``range(10, 20)``.
        velocities : bool
            Also find `MeshSequence.velocities`, for motion blur.

        Returns
        -------
        MeshSequence
            float64 points in the units of the original.

        Raises
        ------
        SettingsError
            If a time is outside the sequence, there is no such frame, or fps is not positive.
        """
        header = self.header_at(times if frames is None else self._times_of_frames(frames, times), fps)
        if velocities:
            moving = list(self.moving_blocks(header.times, progress=progress))
            points, speeds = (np.concatenate(arrays) for arrays in zip(*moving, strict=True))
            return MeshSequence.from_header(header, points, speeds)
        points = np.concatenate(list(self.blocks(header.times, progress=progress)))
        return MeshSequence.from_header(header, points)

    def _times_of_frames(self, frames: Iterable[int], times: ArrayLike | None) -> Float:
        numbers = np.fromiter(frames, dtype=np.int64)
        if times is not None:
            raise SettingsError("give either times or frames")
        outside = (numbers < 0) | (numbers >= len(self.times))
        if outside.any() or not numbers.size:
            which = f"there is no frame {numbers[outside][0]}" if numbers.size else "no frame is asked for"
            raise SettingsError(f"{which}; the sequence has frames 0 to {len(self.times) - 1}")
        return np.asarray(self.times[numbers])

    def header_at(self, times: ArrayLike | None = None, fps: float | None = None) -> SequenceHeader:
        """Return the header of the result of `sample`, without decoding."""
        if fps is not None and not (np.isfinite(fps) and fps > 0):
            raise SettingsError(f"fps is {fps}; a positive number is expected")
        fps = None if fps is None else snap_to_ntsc(fps, self.header.fps)
        if times is None and fps is not None:
            times = frame_times(self.times[0], self.times[-1], fps)
        return self.header.with_times(self.times if times is None else self.clip_times(times), fps)

    def blocks(
        self,
        times: ArrayLike,
        size: int = FRAMES_PER_BLOCK,
        progress: Progress = no_progress,
        workers: Executor | None = None,
    ) -> Iterator[Float]:
        """Decode frames at `times` in blocks ``(B, V, 3)``, B <= size; the same bits for any blocks and workers."""
        return _decode_blocks(_decode_points, self, self.clip_times(times), size, progress, workers)

    def moving_blocks(
        self,
        times: ArrayLike,
        size: int = FRAMES_PER_BLOCK,
        progress: Progress = no_progress,
        workers: Executor | None = None,
    ) -> Iterator[tuple[Float, Float]]:
        """Decode frames in blocks of points and velocities, in units per second, ``(B, V, 3)`` each."""
        return _decode_blocks(
            _decode_points_and_velocities, self, self.clip_times(times), size, progress, workers
        )

    def clip_times(self, times: ArrayLike) -> Float:
        """Return times ``(N,)``, rounded to the ends, or raise `SettingsError` if one is outside the model."""
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        first, last = self.start, self.end
        slack = 1e-3 / self.header.fps  # times are typed and printed with a few digits
        outside = ~((wanted >= first - slack) & (wanted <= last + slack))
        if outside.any():
            raise SettingsError(
                f"time {wanted[outside][0]:g} s is outside the sequence, "
                f"{format_span(first, last, self.header.fps)}; models do not extrapolate"
                f"{hint_frame_number(float(wanted[outside][0]), first, last, self.header.fps)}"
            )
        return np.clip(wanted, first, last)


def _decode_blocks(
    decode: Callable[[Decodable, Float], Decoded],
    model: Decodable,
    times: Float,
    size: int,
    progress: Progress,
    workers: Executor | None,
) -> Iterator[Decoded]:
    """Yield results of `decode` (`_points` or `_moving_points`) at times ``(N,)`` in blocks of `size` frames."""
    some = (times[start : start + size] for start in range(0, len(times), size))
    work = workers or (thread_executor() if len(times) > size else serial_executor)
    model.space.precompute()
    done = 0
    for block in work(decode, model, some):
        yield block
        done = min(done + size, len(times))
        progress(done, len(times), "decoding frames")


def _decode_points(model: Decodable, times: Float) -> Float:
    """Return the points ``(N, V, 3)`` at times ``(N,)``."""
    points = model.space.decode(model.curve(times))
    return points if model.residual_layer is None else points + model.residual_layer.at(times)


def _decode_points_and_velocities(model: Decodable, times: Float) -> tuple[Float, Float]:
    """Return points and velocities ``(N, V, 3)`` at times ``(N,)``."""
    points, speeds = model.space.decode_with_velocities(model.curve(times), model.rates(times))
    if model.residual_layer is None:
        return points, speeds
    return points + model.residual_layer.at(times), speeds + model.residual_layer.rates(times)
