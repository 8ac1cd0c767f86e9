"""Resample a model or a rig: compute it at another frame rate, speed or direction.

A rig (joints, morph weights, transforms) is evaluated as its file defines it between keys; points of frames are fitted
by a model. The output has a frame at its start, and others ``1 / fps`` apart up to its end. With the retiming
:math:`r` (`mixseq.operations.retiming`), the frame at the output time :math:`o` shows the source at the time
:math:`r(o)`. Its velocities, per second of the output, are the velocities of the source times :math:`r'(o)`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from mixseq.choices import BetweenName
from mixseq.compression.compressed_model import CompressedModel
from mixseq.errors import SettingsError
from mixseq.operations.retiming import Retiming
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, public
from mixseq.sequence.events import CutChoice
from mixseq.sequence.frame_rates import FRAME_ROUNDING, FRAME_TOLERANCE, format_span, snap_to_ntsc
from mixseq.sequence.header import MAX_FRAME_COUNT, SequenceHeader
from mixseq.sequence.provenance import as_edited
from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence, Rig, is_rig, join_blocks, without_velocities
from mixseq.signals.decoding import MAX_FRAMES_PER_BLOCK, Decodable
from mixseq.signals.fitting import as_motion, fit
from mixseq.signals.model import Model
from mixseq.types import Float, FloatArray


@dataclass(frozen=True, eq=False)
class Resampling:
    """The planned frames of a resampling, not yet decoded. Create it with `plan`."""

    motion: Decodable  # the source
    header: SequenceHeader  # header of the output, with the times of its frames
    retiming: Retiming  # map from output time to source time, over the duration of the output
    sources: Float  # (N,) source time of every frame, in seconds
    slopes: Float  # (N,) source seconds per output second at every frame; negative if the source runs backwards

    def blocks(
        self, size: int = MAX_FRAMES_PER_BLOCK, progress: Progress = log_progress, workers: Executor | None = None
    ) -> Iterator[Float]:
        """Yield the decoded frames in blocks of points ``(B, V, 3)`` with ``B <= size``, see `Model.blocks`."""
        return self.motion.blocks(self.sources, size, progress, workers)

    def blocks_at(self, times: Float) -> Iterator[Float]:
        """Yield points ``(B, V, 3)`` at times ``(N,)`` of the output."""
        inside = np.clip(times, self.retiming.start, self.retiming.end)
        return self.motion.blocks(np.clip(self.retiming(inside), self.motion.start, self.motion.end))

    def moving_blocks(
        self, size: int = MAX_FRAMES_PER_BLOCK, progress: Progress = log_progress, workers: Executor | None = None
    ) -> Iterator[tuple[Float, Float]]:
        """Yield blocks of points ``(B, V, 3)`` and of velocities ``(B, V, 3)`` in units per second of the output."""
        done = 0
        for points, velocities in self.motion.moving_blocks(self.sources, size, progress, workers):
            slopes = self.slopes[done : done + len(points)]
            yield points, slopes[:, None, None] * velocities
            done += len(points)


END_TOLERANCE = 0.05  # largest time after the end, in frames, of a last frame with its pose, as of 24 fps at 23.976
MAX_SHUTTER_SAMPLES = 64  # largest number of samples per frame


def shutter_offsets(angle: float, samples: int) -> Float:
    """Return the times of a frame and of samples while a shutter is open around it, in frames from it."""
    if not (0 < angle <= 360 and 2 <= samples <= MAX_SHUTTER_SAMPLES):
        raise SettingsError(
            f"the shutter is {angle:g} degrees with {samples} samples; up to 360 degrees and 2 to "
            f"{MAX_SHUTTER_SAMPLES} samples are expected"
        )
    return np.union1d(np.linspace(-angle, angle, samples) / 720, 0.0)


def plan(
    motion: Decodable | Rig,
    fps: float | None = None,
    start: float | None = None,
    end: float | None = None,
    speed: float = 1.0,
    reverse: bool = False,
    retiming: Retiming | None = None,
    *,
    hold: bool = False,
    shutter: tuple[float, int] | None = None,
) -> Resampling:
    """Compute the frames of a resampling, with parameters and errors as in `resample`."""
    motion = as_motion(motion)
    low, high = -np.inf, np.inf  # output times for which the source time is known
    if retiming is None:
        bounds = np.where([start is None, end is None], motion.times[[0, -1]], [start or 0.0, end or 0.0])
        first, last = bounds if hold else motion.clip_times(bounds)
        retiming = Retiming.section(float(first), float(last), speed, reverse)
    elif not (start is None and end is None and speed == 1.0 and not reverse):
        raise SettingsError(
            "a retiming sets the range, the speed and the direction; leave out start, end, speed and reverse"
        )
    else:
        low, high = retiming.start, retiming.end
    rate = motion.header.fps if fps is None else snap_to_ntsc(float(fps), motion.header.fps)
    steps = np.arange(_frame_count(retiming.start, retiming.end, rate), dtype=np.float64)
    outputs = np.minimum(retiming.start + steps / rate, retiming.end)
    if shutter is not None:
        offsets = shutter_offsets(*shutter)
        steps, ids = np.unique((steps[:, None] + offsets).round(9), return_index=True)
        outputs = (outputs[:, None] + offsets / rate).reshape(-1)[ids]
        is_inside = (outputs >= low) & (outputs <= high)
        steps, outputs = steps[is_inside], outputs[is_inside]
    sources = np.asarray(retiming.curve(outputs), dtype=np.float64)
    slopes = np.asarray(retiming.curve(outputs, nu=1), dtype=np.float64)
    slack = FRAME_TOLERANCE / motion.header.fps
    is_outside = (sources < motion.start - slack) | (sources > motion.end + slack)
    is_sample = steps != np.rint(steps)
    if hold:
        sources, slopes = np.clip(sources, motion.start, motion.end), np.where(is_outside, 0.0, slopes)
    elif (is_outside & ~is_sample).any():
        time = float(sources[is_outside & ~is_sample][0])
        span = format_span(motion.start, motion.end, motion.header.fps)
        raise SettingsError(
            f"the retiming goes beyond the source: time {time:g} s is outside the sequence, {span}; motions are not "
            "extrapolated, but hold (--hold) shows the first or last pose there"
        )
    else:
        steps, sources, slopes = steps[~is_outside], motion.clip_times(sources[~is_outside]), slopes[~is_outside]
    number = retiming.start * rate
    whole = round(number)
    times = ((whole if abs(number - whole) <= FRAME_TOLERANCE else number) + steps) / rate
    header = motion.header.with_times(times, rate)
    if len(times) != len(motion.times) or np.abs(sources - motion.times).max() > FRAME_ROUNDING / motion.header.fps:
        header = replace(header, provenance=as_edited(header.provenance))
    return Resampling(motion, header, retiming, sources, slopes)


def _frame_count(start: float, end: float, fps: float) -> int:
    """Return the number of frames from `start` to `end`, or to `END_TOLERANCE` frames after it."""
    if not (np.isfinite(fps) and fps > 0):
        raise SettingsError(f"fps is {fps}; a positive number is expected")
    last = np.floor((end - start) * fps + END_TOLERANCE)
    if last >= MAX_FRAME_COUNT:
        raise SettingsError(
            f"{start:g} to {end:g} s at {fps:g} frames per second are {last + 1:.3g} frames, more than "
            f"{MAX_FRAME_COUNT:,}; give fewer fps or more speed"
        )
    return int(last) + 1


def conform_frames(
    frames: Frames, fps: float
) -> tuple[SequenceHeader, Iterator[FloatArray], Iterator[FloatArray] | None]:
    """Return the header, points and stored velocities of the same frames, with the same numbers, at another rate."""
    if not (np.isfinite(float(fps)) and fps > 0):
        raise SettingsError(f"conform is {fps}; a positive number of frames per second is expected")
    header, rate = frames.header, snap_to_ntsc(float(fps))
    ratio = rate / header.fps
    conformed = replace(header.with_times(header.times / ratio, rate), provenance=as_edited(header.provenance))
    stored: Iterable[FloatArray] | None
    if isinstance(frames, MeshSequence):
        stored = None if frames.velocities is None else [frames.velocities]
    else:
        stored = getattr(frames, "velocity_blocks", lambda: None)()  # of readers
    velocities = None if stored is None else (ratio * block for block in stored)
    return conformed, iter(frames.blocks()), velocities


def vertex_motion(model: Model, progress: Progress = log_progress) -> Decodable:
    """Return the motion of a model's vertices alone: splines through its frames, of compressed ones as players do."""
    if isinstance(model, CompressedModel):
        return model.playback
    frames = LazyFrames(model.header, lambda size: model.blocks(model.times, size))
    return fit(frames, exact=True, between="vertices", progress=progress)


@public
def resample(
    source: FileOr[Frames | Model],
    fps: float | None = None,
    start: float | None = None,
    end: float | None = None,
    speed: float = 1.0,
    reverse: bool = False,
    retiming: FileOr[Retiming] | None = None,
    *,
    conform: float | None = None,
    hold: bool = False,
    shutter: float | None = None,
    shutter_samples: int = 3,
    velocities: bool = False,
    between: BetweenName = "auto",
    cuts: CutChoice = "auto",
    progress: Progress = log_progress,
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
    conform : float, optional
        Frames per second at which the frames of the source are played, with their numbers; nothing is interpolated.
        Excludes all other settings but `progress`.
    hold : bool
        Hold the first and the last pose where times are outside the source.
    shutter : float, optional
        Angle of a shutter in degrees, up to 360: the output also has samples while it is open, around every frame.
    shutter_samples : int
        Number of samples per frame.
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
        Frames from the start of the output to its end, ``1 / fps`` apart, with float64 points in the units of the
        source.

    Raises
    ------
    InvalidSequenceError
        If the source is neither a model nor a mesh sequence.
    SettingsError
        If a time is outside the model, a setting is out of range, or settings contradict each other.

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
    source = cast("Frames | Model", source)
    retiming = cast("Retiming | None", retiming)
    if conform is not None:
        others = (fps, start, end, speed, reverse, retiming, hold, shutter, velocities, between, cuts)
        if others != (None, None, None, 1.0, False, None, False, None, False, "auto", "auto"):
            raise SettingsError("conform keeps all frames as they are; leave out the other settings")
        frames = source.frames if isinstance(source, Model) else source
        header, blocks, speeds = conform_frames(frames, conform)
        points = np.concatenate(list(blocks))
        return MeshSequence.from_header(header, points, None if speeds is None else np.concatenate(list(speeds)))
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
    samples = None if shutter is None else (shutter, shutter_samples)
    planned = plan(motion, fps, start, end, speed, reverse, retiming, hold=hold, shutter=samples)
    if not velocities:
        return join_blocks(planned.header, planned.blocks(progress=progress))
    moved, rates = zip(*planned.moving_blocks(progress=progress), strict=True)
    return MeshSequence.from_header(planned.header, np.concatenate(moved), np.concatenate(rates))
