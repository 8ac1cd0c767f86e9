r"""What every frame of a film shows: meshes over time, started together, again and again.

Frame k of a film is shown at :math:`k / f`, with f its frames per second. The meshes are shown from their first times
on, and once more after the *period*, that of the longest of them: the time from its first frame to its last, and one
frame. Shorter ones wait in their last pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index
from mixseq.disk_array import LargeArray, new_large_array
from mixseq.errors import SettingsError
from mixseq.frame_store import FrameStore, frame_store
from mixseq.mapping import Executor
from mixseq.progress import Progress, silent
from mixseq.sequence import Frames, SequenceHeader
from mixseq.signals import Model

STILL = 4.0
"""Seconds that a film of a single pose takes."""

MOST_FRAMES = 100_000
"""More would be a slip of the rate or of the duration."""


@dataclass(frozen=True, eq=False)
class Track:
    """A mesh over the frames of a film.

    Attributes
    ----------
    header : SequenceHeader
        Everything but the points.
    poses : (n, V, 3) array, perhaps on disk, of float
        Poses that are shown.
    pose_of_frame : (N,) int
        Which of them every frame of the film shows.
    """

    header: SequenceHeader
    poses: LargeArray
    pose_of_frame: Index

    def pose(self, frame: int) -> Float:
        """Return the points ``(V, 3)`` in a frame of the film."""
        row = int(self.pose_of_frame[frame])
        return np.asarray(self.poses[row : row + 1][0], dtype=np.float64)

    @property
    def shown_first(self) -> Index:
        """The frames of the film that show a pose for the first time."""
        return np.sort(np.unique(self.pose_of_frame, return_index=True)[1]).astype(np.int64)


def film_times(
    headers: Sequence[SequenceHeader], fps: float | None = None, seconds: float | None = None
) -> tuple[Float, float]:
    """Return the times of a film's frames since the meshes' first times, and its frames per second.

    Parameters
    ----------
    headers : sequence of SequenceHeader
        The meshes.
    fps : float, optional
        Frames per second, by default those of the first mesh.
    seconds : float, optional
        Duration of the film, by default the period; `STILL` where nothing moves.

    Returns
    -------
    times : (N,) float64
        In seconds, less than the period.
    fps : float

    Raises
    ------
    SettingsError
        If there would be fewer than 2 frames or more than `MOST_FRAMES`.
    """
    rate = headers[0].fps if fps is None else fps
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


def nearest_frames(header: SequenceHeader, times: Float) -> Index:
    """Return the frames ``(N,)`` nearest to times since the first one, the earlier of two."""
    middles = (header.times[1:] + header.times[:-1]) / 2 - header.times[0]
    return np.searchsorted(middles, times - 1e-6 / header.fps).astype(np.int64)


def model_times(header: SequenceHeader, times: Float) -> Float:
    """Return the times ``(N,)`` of a model at times since its first one, and at its end after that."""
    inside = np.minimum(header.times[0] + times, header.times[-1])
    # a curve has exactly the values of its knots at exactly their times
    nearest = header.times[nearest_frames(header, times)]
    return np.where(np.abs(inside - nearest) < 1e-6 / header.fps, nearest, inside)


def track_of_sequence(sequence: Frames | FrameStore, times: Float, progress: Progress = silent) -> Track:
    """Show of a sequence the frames nearest to the film's times `film_times`; what streams is copied once."""
    whole = sequence if isinstance(sequence, FrameStore) else frame_store(sequence, progress)
    return Track(whole.header, whole.points, nearest_frames(whole.header, times))


def track_of_model(
    model: Model, times: Float, progress: Progress = silent, workers: Executor | None = None
) -> Track:
    """Decode a model at the film's times `film_times`, each of them once."""
    header = model.header
    inside = model_times(header, times)
    needed, pose_of_frame = np.unique(inside, return_inverse=True)
    poses = new_large_array((len(needed), header.vertex_count, 3), np.float64)
    first = 0
    for block in model.blocks(needed, progress=progress, workers=workers):
        poses[first : first + len(block)] = block
        first += len(block)
    return Track(model.header_at(needed), poses, pose_of_frame.astype(np.int64))
