"""``mixseq decode``.

Skins and morphs on the command line: fit and write them, and measure the written file.

Vertex animation textures on the command line.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.files import (
    MODEL_EXTENSIONS,
    VAT,
    Claim,
    check_origin,
    is_model,
    overwrite_option,
    read_sequence,
    write_frames,
)
from mixseq.cli.group import announce, print_table, progress_bar
from mixseq.cli.options import (
    FILE,
    CommandWithSettings,
    FrameChoice,
    examples,
    frames_option,
    quiet_option,
    setting,
    time_rows,
    workers_options,
    writer_options,
)
from mixseq.errors import MixseqWarning, NoMeshError, SettingsError
from mixseq.sequence.frame_rates import exact_rate, rate_text

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Morph, Skin
    from mixseq.runtime.parallel import Executor
    from mixseq.runtime.progress import Progress
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import MeshSequence
    from mixseq.signals.model import Model
    from mixseq_io.vat.writer import TextureName, VatReport


_ONLY_FOR = {
    "bones": "skin",
    "skeleton": "skin",
    "kg": "skin",
    "correctives": "skin",
    "max_error": "skin or morph (or a target .vat)",
    "max_targets": "skin or morph",
}
_BONES = ("bones", "skeleton", "max_error", "kg")
_USELESS = {"velocities": "velocities", "onto": "other files to build on", "clips": "clips"}


@dataclass(frozen=True)
class RigSettings:
    """Settings of a skin or a morph; None is the default of the fit."""

    kind: str | None  # kind of the rig; None for a sequence
    bones: int | None  # number of bones
    skeleton: Path | None  # a file with the bones, and mostly with the mesh on them
    correctives: float | None  # largest error of a vertex with a skin's correctives, in diagonals
    max_error: float | None  # largest error of a vertex with a skin's bones alone, or a morph, in diagonals
    kg: float | None  # KG error of a skin's bones, in percent
    max_targets: int | None  # number of morph targets at most

    def check(self, velocities: bool, writing: Mapping[str, Any], texture: str | None = None) -> None:
        """Raise an error for options that exclude each other."""
        if texture is not None:
            raise SettingsError(
                "texture is for vertex animation textures; leave it out, or end the target in .vat"
            )
        for name, kinds in _ONLY_FOR.items():
            if getattr(self, name) is not None and (self.kind is None or self.kind not in kinds):
                raise SettingsError(f"{_option(name)} is for --as {kinds}; leave it out, or give both")
        telling = [_option(name) for name in _BONES if getattr(self, name) is not None]
        if self.kind == "skin" and len(telling) > 1:
            raise SettingsError(
                f"{telling[0]} and {telling[1]} both tell which bones there are; give one of them"
            )
        if self.kind is not None:
            for name in ["velocities"] * velocities + list(writing):
                if name in _USELESS:
                    raise SettingsError(
                        f"a {self.kind} has no place for {_USELESS[name]}; leave out --{name}, or --as"
                    )

    def fit(self, sequence: MeshSequence, progress: Progress) -> Skin | Morph:
        """Fit the rig to a sequence; a mesh on the skeleton with the same vertices is the bind pose."""
        targets = {} if self.max_targets is None else {"max_targets": self.max_targets}
        if self.kind == "morph":
            return mixseq.fit_morph(sequence, self.max_error, **targets, progress=progress)
        skeleton = bind_pose = None
        if self.skeleton is not None:
            skeleton = mixseq.read_skeleton(self.skeleton)
            bind_pose = _bind_pose(self.skeleton, sequence)
        return mixseq.fit_skin(
            sequence,
            self.bones,
            self.correctives,
            **targets,
            progress=progress,
            skeleton=skeleton,
            bind_pose=bind_pose,
            max_error=self.max_error,
            kg=self.kg,
        )


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _bind_pose(path: Path, sequence: MeshSequence) -> MeshSequence | None:
    """Return the mesh on the skeleton of a file, None if there is none, or if it differs from that of a sequence."""
    try:
        found = mixseq.read_bind_pose(path)
    except NoMeshError:  # a skeleton alone
        return None
    if found.vertex_count == sequence.vertex_count:
        return found
    more = sequence.vertex_count > found.vertex_count
    cure = (
        "; if the sequence has other meshes as well, encode that one alone (mixseq encode --prim)"
        if more
        else ""
    )
    warnings.warn(
        f"{path}: the mesh on the skeleton has {found.vertex_count} vertices, that of the sequence has "
        f"{sequence.vertex_count}; it is left out, and the skeleton is taken as it would stand in the first frame"
        + cure,
        MixseqWarning,
        stacklevel=2,
    )
    return None


def rows(path: Path, rig: Skin | Morph, sequence: MeshSequence) -> list[tuple[str, str]]:
    """Return table rows of a written file's contents and its distance from the sequence."""
    from mixseq.cli.group import format_bytes
    from mixseq.rigging.rigs import Skin
    from mixseq_io.rig_files import GLTF
    from mixseq_io.rig_measuring import measure, size_as_frames

    found = measure(path, sequence)
    first, last = rig.header.times[[0, -1]]
    frames = f"{rig.header.frame_count:,} from {first:g} to {last:g} s at {rate_text(rig.header.fps)} frames per second"
    table = [
        ("keys", frames),
        *([("bones", f"{rig.bone_count}")] if isinstance(rig, Skin) else []),
        ("morph targets", f"{len(rig.targets)}"),
        ("max error", f"{found.max_error:.4g} diagonals"),
        ("rms error", f"{found.rms_error:.4g} diagonals"),
        ("KG error", f"{found.kg_percent:.4g} %"),
    ]
    if path.suffix.lower() in GLTF:
        size = format_bytes(size_as_frames(sequence.header))
        table.append(("every frame", f"would be {size} as a morph target each"))
    return table


def check_textures(others: Mapping[str, Any]) -> None:
    """Raise an error for options, by name, that textures do not support; None and False are not given."""
    for name, value in others.items():
        if value is not None and value is not False:
            option = f"--{name.replace('_', '-')}"
            raise SettingsError(f"vertex animation textures (.vat) have no place for {option}; leave it out")


def texture_rows(report: VatReport) -> list[tuple[str, str]]:
    """Return table rows of the textures' sizes and errors."""
    from mixseq.cli.group import format_bytes

    kind = report.kind if not report.rank else f"{report.kind}, {report.rank} basis vectors"
    return [
        (
            "textures",
            f"{kind}: {format_bytes(report.file_bytes)}, in memory {format_bytes(report.memory_bytes)}",
        ),
        ("max error", f"{report.max_error:.4g} diagonals"),
        ("rms error", f"{report.rms_error:.4g} diagonals"),
        ("normals", f"off by {report.normal_degrees:.3g} degrees (root mean square)"),
    ]


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
    from mixseq.sequence.sequence import collect

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

    from mixseq.sequence.header import frame_times

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
