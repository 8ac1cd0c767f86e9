"""Resample a model or a rig: compute it at another frame rate, speed or direction.

A rig (joints, morph weights, transforms) is evaluated as its file defines it between keys; points of frames are fitted
by a model. The output has a frame at every multiple of ``1 / fps`` from its start to its end. With the retiming
:math:`r` (`mixseq.operations.retiming`), the frame at the output time :math:`o` shows the source at the time
:math:`r(o)`. Its velocities, per second of the output, are the velocities of the source times :math:`r'(o)`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from mixseq.choices import BetweenName
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import SettingsError
from mixseq.operations.retiming import Retiming
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.frame_rates import FRAME_ROUNDING, FRAME_TOLERANCE, snap_to_ntsc
from mixseq.sequence.header import MAX_FRAME_COUNT, SequenceHeader
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence, Rig, is_rig, join_blocks, without_velocities
from mixseq.signals.decoding import FRAMES_PER_BLOCK, Decodable
from mixseq.signals.fitting import CutChoice, as_motion, fit
from mixseq.signals.model import Model
from mixseq.types import Float


@dataclass(frozen=True, eq=False)
class Resampling:
    """The planned frames of a resampling, not yet decoded. Create it with `plan`."""

    motion: Decodable  # the source
    header: SequenceHeader  # header of the output, with the times of its frames
    retiming: Retiming  # map from output time to source time, over the duration of the output
    sources: Float  # (N,) source time of every frame, in seconds
    slopes: Float  # (N,) source seconds per output second at every frame; negative if the source runs backwards

    def blocks(
        self, size: int = FRAMES_PER_BLOCK, progress: Progress = no_progress, workers: Executor | None = None
    ) -> Iterator[Float]:
        """Yield the decoded frames in blocks of points ``(B, V, 3)`` with ``B <= size``, see `Model.blocks`."""
        return self.motion.blocks(self.sources, size, progress, workers)

    def blocks_at(self, times: Float) -> Iterator[Float]:
        """Yield points ``(B, V, 3)`` at times ``(N,)`` of the output."""
        inside = np.clip(times, self.retiming.start, self.retiming.end)
        return self.motion.blocks(self.motion.clip_times(self.retiming(inside)))

    def moving_blocks(
        self, size: int = FRAMES_PER_BLOCK, progress: Progress = no_progress, workers: Executor | None = None
    ) -> Iterator[tuple[Float, Float]]:
        """Yield blocks of points ``(B, V, 3)`` and of velocities ``(B, V, 3)`` in units per second of the output."""
        done = 0
        for points, velocities in self.motion.moving_blocks(self.sources, size, progress, workers):
            slopes = self.slopes[done : done + len(points)]
            yield points, slopes[:, None, None] * velocities
            done += len(points)


def plan(
    motion: Decodable | Rig,
    fps: float | None = None,
    start: float | None = None,
    end: float | None = None,
    speed: float = 1.0,
    reverse: bool = False,
    retiming: Retiming | None = None,
) -> Resampling:
    """Compute the frames of a resampling, with parameters and errors as in `resample`."""
    motion = as_motion(motion)
    if retiming is None:
        first, last = motion.times[[0, -1]]
        first, last = motion.clip_times([first if start is None else start, last if end is None else end])
        retiming = Retiming.section(float(first), float(last), speed, reverse)
    elif not (start is None and end is None and speed == 1.0 and not reverse):
        raise SettingsError(
            "a retiming sets the range, the speed and the direction; leave out start, end, speed and reverse"
        )
    rate = motion.header.fps if fps is None else snap_to_ntsc(float(fps), motion.header.fps)
    times = _frame_times(retiming.start, retiming.end, rate, FRAME_TOLERANCE / motion.header.fps)
    retimed = np.clip(times, retiming.start, retiming.end)
    try:
        sources = motion.clip_times(retiming(retimed))
    except SettingsError as error:
        raise SettingsError(f"the retiming goes beyond the source: {error}") from None
    header = motion.header.with_times(times, rate)
    if len(times) != len(motion.times) or np.abs(sources - motion.times).max() > FRAME_ROUNDING / motion.header.fps:
        header = replace(header, provenance=as_edited(header.provenance))
    return Resampling(motion, header, retiming, sources, retiming.slope(retimed))


def _frame_times(start: float, end: float, fps: float, slack: float) -> Float:
    """Return the multiples ``(N,)`` of ``1 / fps`` from `start` to `end`, up to `slack` seconds outside included."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    slack = min(slack, FRAME_TOLERANCE / fps)
    first, last = np.ceil((start - slack) * fps), np.floor((end + slack) * fps)
    if last < first:
        raise SettingsError(
            f"no frame of {fps:g} frames per second is from {start:g} to {end:g} s; give another range or more fps"
        )
    if last - first >= MAX_FRAME_COUNT:
        raise SettingsError(
            f"{start:g} to {end:g} s at {fps:g} frames per second are {last - first + 1:.3g} frames, more than "
            f"{MAX_FRAME_COUNT:,}; give fewer fps or more speed"
        )
    return np.asarray(np.arange(int(first), int(last) + 1) / fps)


def vertex_motion(model: Model, progress: Progress = no_progress) -> Decodable:
    """Return the motion of a model's vertices alone: splines through its frames, of compressed ones as players do."""
    if isinstance(model, CompressedModel):
        return model.playback
    frames = LazyFrames(model.header, lambda size: model.blocks(model.times, size))
    return fit(frames, exact=True, between="vertices", progress=progress)


@public
def resample(
    source: FileOr[Model | Frames],
    fps: float | None = None,
    start: float | None = None,
    end: float | None = None,
    speed: float = 1.0,
    reverse: bool = False,
    retiming: FileOr[Retiming] | None = None,
    *,
    velocities: bool = False,
    between: BetweenName = "auto",
    cuts: CutChoice = "auto",
    progress: Progress = no_progress,
) -> MeshSequence:
    """Sample a motion at another rate, speed or direction.

    Parameters
    ----------
    source : Model, MeshSequence or SequenceReader
        The motion. A rig of an open glTF or USD file is evaluated at the times asked for, between its keys as the file
        says; so are such files given by their paths. Other sequences are fitted exactly, also those of `mixseq.read`,
        in which rigs are baked to points of frames.
    fps : float, optional
        Frames per second of the output, by default of the source.
    start, end : float, optional
        Section of the source, in seconds; by default from its first to its last frame. The output also begins at the
        time `start`.
    speed : float
        Playback speed of the source: 0.5 is slow motion of twice the duration.
    reverse : bool
        Play the section backwards.
    retiming : Retiming, optional
        Map from output time to source time that replaces `start`, `end`, `speed` and `reverse`.
    velocities : bool
        Also compute velocities, in units per second of the output; those of rigs by central differences.
    between, cuts
        Motion between frames, and cuts, of a sequence that is fitted; see `mixseq.fit`. Of a model, "vertices" moves
        vertices along splines through its frames; in a compressed one, these are the splines of players.
    progress : callable, optional
        Function called after every block of frames.

    Returns
    -------
    MeshSequence
        Frames at multiples of ``1 / fps``, with float64 points in the units of the source.

    Raises
    ------
    InvalidSequenceError
        If the source is neither a model nor a mesh sequence.
    SettingsError
        If a time is outside the model, a setting is out of range, settings contradict each other, or the range has no
        frame.

    Examples
    --------
    >>> import mixseq
    >>> triangle = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    >>> points = triangle + np.arange(5.0)[:, None, None]  # one unit per frame, 24 units per second
    >>> model = mixseq.fit(mixseq.MeshSequence.from_arrays(points, [[0, 1, 2]]), exact=True, space="vertex")
    >>> slow = resample(model, speed=0.5, velocities=True)
    >>> slow.frame_count, slow.points[1, 0].round(9).tolist(), slow.velocities[1, 0].round(6).tolist()
    (9, [0.5, 0.5, 0.5], [12.0, 12.0, 12.0])
    """
    source = cast("Model | Frames", source)
    retiming = cast("Retiming | None", retiming)
    motion: Decodable
    if isinstance(source, Model) and (between, cuts) == ("vertices", "auto"):
        motion = vertex_motion(source, progress)
    elif isinstance(source, Model) or is_rig(source):
        if (between, cuts) != ("auto", "auto"):
            raise SettingsError("between and cuts are for frames; give them to mixseq.fit, and resample its model")
        motion = as_motion(source)
    else:
        frames = without_velocities(source) if velocities else source  # the model's replace them
        motion = fit(frames, exact=True, between=between, cuts=cuts, progress=progress)
    planned = plan(motion, fps, start, end, speed, reverse, retiming)
    if not velocities:
        return join_blocks(planned.header, planned.blocks(progress=progress))
    points, rates = zip(*planned.moving_blocks(progress=progress), strict=True)
    return MeshSequence.from_header(planned.header, np.concatenate(points), np.concatenate(rates))
