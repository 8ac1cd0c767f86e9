"""``mixseq decode``."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.console import announce, print_table, progress_bar
from mixseq.cli.decode_rig import RigSettings, rows
from mixseq.cli.decode_textures import check_textures, texture_rows
from mixseq.cli.files import (
    MODEL_EXTENSIONS,
    VAT,
    check_origin,
    is_model,
    read_sequence,
    write_frames,
)
from mixseq.cli.frames import FrameChoice, frames_option, time_rows
from mixseq.cli.options import FILE, examples, quiet_option, workers_options, writer_options
from mixseq.cli.overwriting import Claim, overwrite_option
from mixseq.cli.settings import CommandWithSettings, setting
from mixseq.errors import SettingsError
from mixseq.frame_rates import exact_rate

if TYPE_CHECKING:
    from mixseq.mapping import Executor
    from mixseq.progress import Progress
    from mixseq.sequence import MeshSequence, SequenceHeader
    from mixseq.signals import Model
    from mixseq_io.vat.writer import TextureName


def _as_seconds(
    context: click.Context, option: click.Parameter, value: str | None
) -> tuple[float, ...] | None:
    if value is None:
        return None
    try:
        return tuple(float(item) for item in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not a list of seconds such as 0,0.5,1.25") from None


@click.command(
    "decode",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq decode walk.h5 walk48.usdc --fps 48",
        "mixseq decode walk.h5 still.obj --times 0.73",
        "mixseq decode shot.h5 part.usdc --frames 1005-1010",
        "mixseq decode walk.h5 slow.usdc --fps 240 --start 0.5 --end 1 --velocities",
        "mixseq decode walk.h5 again.usdc --cluster tcp://host:8786",
        "mixseq decode walk.h5 walk.glb --as skin --bones 30",
        "mixseq decode walk.abc walk.glb --as skin --skeleton character.glb",
        "mixseq decode walk.abc walk.glb --as morph --max-error 0.001",
        "mixseq decode walk.h5 walk.vat --max-error 0.001",
    ),
)
@click.argument("source", metavar="MODEL", type=FILE)
@click.argument("target", type=FILE)
@click.option(
    "--fps",
    type=click.FloatRange(min=0, min_open=True, max=1_000_000),
    metavar="N",
    help="Frames per second.  [default: the original frames]",
)
@click.option(
    "--times", callback=_as_seconds, metavar="S,S,...", help="Decode exactly these times, in seconds."
)
@frames_option(
    "Only these frames of the model, by their numbers; with --fps from the first to the last of them."
)
@click.option("--start", type=float, metavar="S", help="First time in seconds.  [default: that of the model]")
@click.option("--end", type=float, metavar="S", help="Last time in seconds.  [default: that of the model]")
@click.option(
    "--velocities/--no-velocities",
    default=False,
    show_default=True,
    help="Also write the velocities of all vertices, for motion blur.",
)
@click.option(
    "--as",
    "kind",
    type=click.Choice(["skin", "morph"]),
    help="Write glTF or USD for engines: a skin over moving bones, or a mesh with few morph targets.",
)
@setting("--bones", type=click.IntRange(min=1), metavar="N", help="Number of bones of a skin.")
@setting("--skeleton", type=FILE, metavar="FILE", help="glTF or USD file with the bones of a skin.")
@click.option(
    "--kg",
    type=click.FloatRange(min=0, min_open=True),
    metavar="P",
    help="Give a skin as few bones as reach this KG error, in percent.",
)
@setting(
    "--correctives",
    type=click.FloatRange(min=0, min_open=True),
    metavar="E",
    help="Correct a skin by morph targets, up to this largest error in diagonals.",
)
@click.option(
    "--max-error",
    type=click.FloatRange(min=0, min_open=True),
    metavar="E",
    help="Largest error of a skin's bones, of a morph or of textures, in diagonals; a morph without it is exact.",
)
@setting(
    "--texture",
    type=click.Choice(["png16", "exr"]),
    help="Of vertex animation textures (TARGET is a folder .vat): PNG with 16 bits, or EXR.  [default: png16]",
)
@setting("--max-targets", type=click.IntRange(min=0), metavar="N", help="Number of morph targets at most.")
@writer_options
@workers_options
@overwrite_option
@quiet_option
def command(
    source: Path,
    target: Path,
    fps: float | None,
    times: tuple[float, ...] | None,
    frames: FrameChoice | None,
    start: float | None,
    end: float | None,
    velocities: bool,
    kind: str | None,
    bones: int | None,
    skeleton: Path | None,
    kg: float | None,
    correctives: float | None,
    max_error: float | None,
    max_targets: int | None,
    texture: TextureName | None,
    writing: dict[str, Any],
    workers: AbstractContextManager[Executor],
    claim: Claim,
    quiet: bool,
) -> None:
    """Turn a model back into a sequence, at any frame rate.

    TARGET's format follows from its extension, see "mixseq formats". It is written while frames are decoded.

    Where TARGET is a folder .vat, frames become textures that graphics cards look up: a texel for every vertex and
    frame, or with --max-error low-rank textures, which are much smaller.

    With --as, TARGET is a .glb or .gltf that engines play, or USD with a skeleton; it is fitted to all frames, read
    back, and compared with them. MODEL may then be a sequence, too.
    """
    chosen = Chosen(times, frames, fps, start, end)
    settings = RigSettings(kind, bones, skeleton, correctives, max_error, kg, max_targets)
    textures = target.suffix.lower() == VAT
    if textures:
        of_rigs = {name: value for name, value in vars(settings).items() if name not in ("kind", "max_error")}
        check_textures({"as": kind, "velocities": velocities, **of_rigs, **writing})
    else:
        settings.check(velocities, writing, texture)
    claim(target)
    if textures:
        from mixseq_io.vat.writer import check_vat_target

        check_vat_target(target)
    elif kind is not None:
        from mixseq_io.rig_files import check_rig_target

        check_rig_target(target)
    with workers as work, progress_bar(quiet) as progress:
        if kind is None and not textures:
            model = mixseq.load(source)
            header = chosen.of(model)
            write_frames(target, model, header, velocities, writing, progress, work)
            table = time_rows(header)
        else:
            sequence = _sequence(source, chosen, progress, work)
            check_origin(target, sequence)
            if textures:
                report = mixseq.write_vat(target, sequence, max_error, texture or "png16", progress)
                table = texture_rows(report)
            else:
                rig = settings.fit(sequence, progress)
                mixseq.write_rig(target, rig)
                table = [] if quiet else rows(target, rig, sequence)
    if not quiet:
        print_table(table)
    announce(target)


def _sequence(
    source: Path,
    chosen: Chosen,
    progress: Progress,
    workers: Executor,
) -> MeshSequence:
    """Decode the chosen frames of a model into memory, or read a sequence."""
    from mixseq.sequence import collect

    named_as_model = source.suffix.lower() in MODEL_EXTENSIONS and not source.is_file()
    if not (is_model(source) or named_as_model):
        if chosen != Chosen():
            raise SettingsError(
                f"{source} is a sequence, whose frames are fitted as they are; leave out --fps, --times, --frames, "
                "--start and --end, or turn it into a model first, with mixseq encode"
            )
        return read_sequence(source, {}, progress)
    model = mixseq.load(source)
    header = chosen.of(model)
    return collect(header, model.blocks(header.times, progress=progress, workers=workers))


@dataclass(frozen=True)
class Chosen:
    """Frames to decode, by the options; by default those of the model."""

    times: tuple[float, ...] | None = None
    frames: FrameChoice | None = None
    fps: float | None = None
    start: float | None = None
    end: float | None = None

    def of(self, model: Model) -> SequenceHeader:
        """Return the header of the decoded frames."""
        if self.frames is not None:
            for name in ("times", "start", "end"):
                if getattr(self, name) is not None:
                    raise SettingsError(f"--frames tells all frames; leave out --{name}")
            if self.fps is not None:
                return _range(model, self.fps, *self.frames.span(model.header))
            return model.header_at(model.times[self.frames.indices(model.header)])
        if self.times is None:
            return _range(model, self.fps, self.start, self.end)
        if self.start is None and self.end is None:
            return model.header_at(self.times, self.fps)
        raise SettingsError("--times tells all times; leave out --start and --end")


def _range(model: Model, fps: float | None, start: float | None, end: float | None) -> SequenceHeader:
    """Choose frames from `start` to `end`: at the rate `fps` from the start on, else the original ones."""
    import numpy as np

    from mixseq.sequence_header import frame_times

    first = float(model.times[0]) if start is None else start
    last = float(model.times[-1]) if end is None else end
    if not (np.isfinite(first) and np.isfinite(last) and first <= last):
        raise SettingsError(f"there is no time between the start, {first:g} s, and the end, {last:g} s")
    slack = 1e-6 / (fps or model.header.fps)
    if start is None and end is None:
        return model.header_at(fps=fps)
    if fps is not None:
        for time in (first, last):
            model.header_at([time], fps)  # raises an error if frames cannot be counted
        rate = exact_rate(fps, model.header.fps)
        return model.header_at(frame_times(first, last, rate), rate)
    model.inside([first, last])
    times = model.times[(model.times >= first - slack) & (model.times <= last + slack)]
    if not times.size:
        raise SettingsError(
            f"the model has no frame from {first:g} to {last:g} s; give --fps to make new ones"
        )
    return model.header_at(times)
