"""Implement the command ``mixseq resample``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli import options
from mixseq.cli.files import Claim, between_rows, counted, each_animation, is_model, time_rows, write_sequence
from mixseq.cli.group import announce, in_diagonals, print_table, progress_bar
from mixseq.cli.options import POSITIVE_NUMBER, length, option, setting
from mixseq.errors import SettingsError
from mixseq.sequence.frame_rates import FRAME_TOLERANCE, format_rate, format_span, snap_to_ntsc

if TYPE_CHECKING:
    from mixseq.operations.resampling import Resampling
    from mixseq.runtime.parallel import Executor
    from mixseq.runtime.progress import Progress
    from mixseq.sequence.sequence import Rig
    from mixseq.signals.decoding import Decodable
    from mixseq.types import FloatArray


@options.command(
    "resample",
    "mixseq resample walk.usdc walk60.usdc --fps 60",
    "mixseq resample walk.h5 slow.usdc --speed 0.25 --start 0.5 --end 1 --velocities",
    "mixseq resample walk.npz back.npz --reverse --tolerance 0.001",
    "mixseq resample walk.h5 ramp.usdc --retime ramp.csv",
    "mixseq resample walk.usdc film.usdc --set conform=24000/1001",
    "mixseq resample walk.h5 blurred.abc --set shutter=180,5",
    rate=options.fps("Frames per second of TARGET.  [default: those of SOURCE]"),
    speed=option(
        "--speed X", "How much faster the motion is; 0.5 lasts twice as long.", type=POSITIVE_NUMBER, default=1.0
    ),
    reverse=option("--reverse", "Play backwards."),
    start=option("--start S", "Play from this second of SOURCE.  [default: the first]", type=float),
    frames=options.frames("Play only these frames of SOURCE, by their numbers, instead of --start and --end."),
    end=option("--end S", "Play to this second of SOURCE.  [default: the last]", type=float),
    retime=option(
        "--retime FILE",
        "Play by a curve instead: lines output,source (CSV), or TOML, in seconds, or in frames if the first line is "
        'unit = "frames".',
    ),
    linear=setting("--linear", "Join the points of --retime by straight lines, not smoothly."),
    tolerance=length("--tolerance X", "Fit frames only up to this fraction of the sequence's diagonal, or 0.5mm."),
    exact=option(
        "--exact", "Fit frames exactly, also those of a rig.  [default: evaluate rigs, fit other sequences exactly]"
    ),
    whole_stage=setting(
        "--whole-stage",
        "Retime everything else in the original of a USD layer, too: cameras, hair, lights, other meshes.",
    ),
)
@each_animation
def command(
    source: Path,
    target: Path,
    rate: float | None,
    speed: float,
    reverse: bool,
    start: float | None,
    frames: options.FrameChoice | None,
    end: float | None,
    retime: Path | None,
    linear: bool,
    velocities: bool,
    tolerance: float | str | None,
    exact: bool,
    sampling: dict[str, Any],
    timing: dict[str, Any],
    whole_stage: bool,
    reading: dict[str, Any],
    writing: dict[str, Any],
    workers: options.Workers,
    claim: Claim,
    quiet: bool,
) -> None:
    """Change the frame rate, speed or direction of a sequence.

    SOURCE is a model, or a sequence in any format. Rigs of glTF and USD (skeletons, morph targets, transforms) are
    evaluated at the new times, between their keys as the file says; with --exact or --tolerance their frames are baked.
    Frames of other sequences, and baked ones, are turned into a model first. TARGET's format follows from its
    extension, see "mixseq formats"; frames are written while later frames are computed.

    The first frame of TARGET shows the start; others follow 1/fps apart, up to the end. The table lists what is left
    over there.
    """
    if exact and tolerance is not None:
        raise SettingsError("--exact keeps everything and --tolerance does not; leave out one of them")
    if linear and retime is None:
        raise SettingsError("--linear is about the points of --retime; give both, or neither")
    if frames is not None and (start, end, retime) != (None, None, None):
        raise SettingsError("--frames chooses the section; leave out --start, --end and --retime")
    new_rate = sampling.pop("conform", None)
    if new_rate is not None:
        options.refuse(
            *("rate", "speed", "reverse", "start", "end", "frames", "retime", "velocities", "tolerance", "exact"),
            *(*sampling, *timing),
            why="changes or fits frames, which --conform keeps; leave out one of them",
        )
    claim(target)
    from mixseq.operations.resampling import conform_frames, plan
    from mixseq.operations.retiming import Retiming, read_retiming_keys
    from mixseq_io.reader import unzip_blocks

    if whole_stage:
        writing = writing | {"whole_stage": True}
    keys = None if retime is None else read_retiming_keys(retime)
    points: Iterator[FloatArray]
    speeds: Iterator[FloatArray] | None = None
    with workers as work, progress_bar(quiet) as progress, ExitStack() as opened:
        if new_rate is not None:
            read = mixseq.open_sequence
            own = mixseq.load(source).frames if is_model(source) else opened.enter_context(read(source, **reading))
            header, points, speeds = conform_frames(own, new_rate)
            points = counted(points, header.frame_count, "writing", progress)
            write_sequence(target, header, points, speeds, writing, own.header.times)
            rows = [*time_rows(header), ("source", f"the same frames at {format_rate(own.header.fps)}")]
        else:
            motion = _motion(source, tolerance, exact, timing, velocities, reading, progress, work, opened)
            if frames is not None:
                start, end = frames.span(motion.header)
            retiming = None
            if keys is not None:
                own_rate = motion.header.fps
                output_rate = own_rate if rate is None else snap_to_ntsc(rate, own_rate)
                outputs, sources = keys.in_seconds(output_rate, motion.header, hold=sampling.get("hold", False)).T
                retiming = Retiming.through(outputs, sources, smooth=not linear)
            planned = plan(motion, rate, start, end, speed, reverse, retiming, **sampling)
            if velocities:
                points, speeds = unzip_blocks(planned.moving_blocks(progress=progress, workers=work))
            else:
                points = planned.blocks(progress=progress, workers=work)
            write_sequence(target, planned.header, points, speeds, writing, planned.sources)
            rows = _rows(planned, "shutter" in sampling)
            if not quiet and "shutter" not in sampling:
                rows += between_rows(target, planned.header, planned.blocks_at, writing)
    if not quiet:
        print_table(rows)
    announce(target)


def _motion(
    source: Path,
    tolerance: float | str | None,
    exact: bool,
    timing: dict[str, Any],
    velocities: bool,
    reading: dict[str, Any],
    progress: Progress,
    workers: Executor,
    opened: ExitStack,
) -> Decodable | Rig:
    """Load a model, open a rig until `opened` closes, or fit a model to a sequence while reading it."""
    from mixseq.operations.resampling import vertex_motion
    from mixseq.sequence.sequence import is_rig, without_velocities

    if not is_model(source):
        reader = mixseq.open_sequence(source, **reading)
        if is_rig(reader) and tolerance is None and not exact:
            opened.enter_context(reader)
            options.refuse(*timing, why=f"is for frames, and {source} is a rig; leave it out, or give --exact")
            return reader
        with reader:
            detail = {"exact": True} if tolerance is None else {"tolerance": tolerance}
            detail = in_diagonals(detail, reader, "tolerance") | options.at_frames(timing, reader.header)
            frames = without_velocities(reader) if velocities else reader  # the model's replace them
            return mixseq.fit(frames, **detail, progress=progress, workers=workers)
    is_vertex_motion = timing == {"between": "vertices"}
    given = options.given_options("tolerance", *() if is_vertex_motion else timing)
    if given or reading:
        what = given[0] if given else "the options for reading sequences"
        raise SettingsError(f"{source} is a model already; leave out {what}")
    model = mixseq.load(source)
    return vertex_motion(model, progress) if is_vertex_motion else model


def _rows(planned: Resampling, has_samples: bool) -> list[tuple[str, str]]:
    from mixseq.signals.decoding import RigMotion

    header, retiming = planned.header, planned.retiming
    first, last = header.times[[0, -1]]
    sources = planned.sources
    begin, end, low, high = sources[0], sources[-1], sources.min(), sources.max()
    beyond = f", between {low:g} and {high:g} s" if low < min(begin, end) or high > max(begin, end) else ""
    rows = [*time_rows(header), ("source", f"{format_span(begin, end, planned.motion.header.fps)}{beyond}")]
    if isinstance(planned.motion, RigMotion):
        rows.append(("rig", "evaluated at these times; --exact fits its frames instead"))
    if has_samples:
        return rows
    left = retiming.end - retiming.start - (last - first)
    if left > FRAME_TOLERANCE / header.fps:
        rows.append(("left over", f"{left:.3g} s after the last frame; the next one would be after the end"))
    elif left < -FRAME_TOLERANCE / header.fps and header.times.size > 1:
        rows.append(("end", f"the last frame is {-left:.2g} s after it, and shows the pose there"))
    return rows
