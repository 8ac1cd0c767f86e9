"""``mixseq decode``: write models as sequences, vertex animation textures, or skins and morphs with measured errors."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli import files, options
from mixseq.cli.group import announce, format_bytes, in_diagonals, length_text, print_table, progress_bar
from mixseq.cli.options import (
    NON_NEGATIVE_INTEGER,
    POSITIVE_INTEGER,
    POSITIVE_NUMBER,
    Group,
    Setting,
    argument,
    flag,
    length,
    option,
    setting,
)
from mixseq.errors import MixseqError, MixseqWarning, NoMeshError, SettingsError
from mixseq.sequence.frame_rates import format_rate, snap_to_ntsc

if TYPE_CHECKING:
    from mixseq.choices import BetweenName
    from mixseq.rigging.rigs import Morph, Skin
    from mixseq.runtime.parallel import Executor
    from mixseq.runtime.progress import Progress
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import Frames, MeshSequence
    from mixseq.signals.decoding import Decodable
    from mixseq_io.rig_files import RigErrors
    from mixseq_io.vat.writer import TextureName, VatReport


_KINDS_BY_OPTION = {
    "bones": "skin",
    "skeleton": "skin",
    "kg": "skin",
    "correctives": "skin",
    "max_error": "skin or morph (or a target .vat)",
    "between_frames": "skin or morph (or a target .vat)",
    "max_targets": "skin or morph",
}
_UNSUPPORTED_BY_RIGS = {"velocities": "velocities", "onto": "other files to build on", "clips": "clips"}


def _check_rig(kind: str | None) -> None:
    """Raise an error for options that exclude each other; `kind` is None if a sequence is written."""
    options.refuse("texture", why="is for vertex animation textures; leave it out, or end the target in .vat")
    for name, kinds in _KINDS_BY_OPTION.items():
        if kind is None or kind not in kinds:
            options.refuse(name, why=f"is for --as {kinds}; leave it out, or give both")
    choices = options.given_options("bones", "skeleton", "max_error", "kg")
    if kind == "skin" and len(choices) > 1:
        raise SettingsError(f"{choices[0]} and {choices[1]} both choose the bones; give one of them")
    for name, what in _UNSUPPORTED_BY_RIGS.items() if kind else ():
        for spelling in options.given_options(name):
            raise SettingsError(f"a {kind} has no place for {what}; leave out {spelling}, or --as")


def _fit_rig(
    kind: str, sequence: MeshSequence, progress: Progress, skeleton: Path | None = None, **settings: Any
) -> Skin | Morph:
    """Fit a skin or a morph to a sequence; the bind pose is the skeleton's mesh if it has the same vertices."""
    if kind == "morph":
        return mixseq.fit_morph(sequence, progress=progress, **settings)
    if skeleton is not None:
        settings["bind_pose"] = _bind_pose(skeleton, sequence)
        settings["skeleton"] = mixseq.read_skeleton(skeleton)
    return mixseq.fit_skin(sequence, progress=progress, **settings)


def _hold_rig_between(
    kind: str, sequence: MeshSequence, motion: Decodable, progress: Progress, max_error: float, **settings: Any
) -> tuple[Skin | Morph, MeshSequence]:
    """Fit a rig to as many frames of a motion as keep the bound between them; also return these frames."""
    from mixseq.signals.decoding import hold_between, largest_distance, quarter_times

    def fit(frames: MeshSequence, bound: float) -> tuple[tuple[Skin | Morph, MeshSequence], float]:
        rig, times = _fit_rig(kind, frames, progress, max_error=bound, **settings), quarter_times(frames.times)
        distance = largest_distance(motion.blocks(times), rig.resampled(times).blocks())
        return (rig, frames), distance / (frames.diagonal or 1.0)

    return hold_between(motion, sequence, max_error, fit)


def _motion_of(frames: Decodable | Frames, progress: Progress, is_needed: bool) -> Decodable | None:
    """Return the motion of frames at any time; None with a warning if no model fits them, unless it is needed."""
    from mixseq.signals.fitting import as_motion

    try:
        return as_motion(frames, progress)
    except MixseqError as error:
        if is_needed:
            raise
        reason = f"errors between frames are not measured, as no model fits the frames: {error}"
        warnings.warn(reason, MixseqWarning, stacklevel=2)
        return None


def _bind_pose(path: Path, sequence: MeshSequence) -> MeshSequence | None:
    """Return the mesh bound to a file's skeleton; None if there is no mesh, or it differs from the sequence's mesh."""
    try:
        bind_pose = mixseq.read_bind_pose(path)
    except NoMeshError:  # the file contains only a skeleton
        return None
    if bind_pose.vertex_count == sequence.vertex_count:
        return bind_pose
    cure = "; if the sequence has other meshes as well, encode that one alone (mixseq encode --prim)"
    warnings.warn(
        f"{path}: the mesh on the skeleton has {bind_pose.vertex_count} vertices, that of the sequence has "
        f"{sequence.vertex_count}; it is left out, and the skeleton is taken as it would stand in the first frame"
        + (cure if sequence.vertex_count > bind_pose.vertex_count else ""),
        MixseqWarning,
        stacklevel=2,
    )
    return None


def rows(
    path: Path, rig: Skin | Morph, sequence: MeshSequence, measured: RigErrors, motion: Decodable | None = None
) -> list[tuple[str, str]]:
    """Return table rows about the contents of a written rig file, and its distance from the sequence and the motion."""
    from mixseq.rigging.rigs import Skin
    from mixseq_io.gltf.new_document import size_with_frame_targets
    from mixseq_io.rig_files import GLTF_EXTENSIONS, measure_file_between

    diagonal = sequence.diagonal * sequence.metres_per_unit
    first, last = rig.header.times[[0, -1]]
    rate = format_rate(rig.header.fps)
    frames = f"{rig.header.frame_count:,} from {first:g} to {last:g} s at {rate} frames per second"
    table = [
        ("keys", frames),
        *([("bones", f"{rig.bone_count}")] if isinstance(rig, Skin) else []),
        ("morph targets", f"{len(rig.targets)}"),
        ("max error", length_text(measured.max_error, diagonal)),
        ("rms error", length_text(measured.rms_error, diagonal)),
        ("KG error", f"{measured.kg_percent:.4g} %"),
    ]
    if motion is not None:
        error = measure_file_between(path, sequence.header, motion.blocks)
        table += files.between_row(error and error / (sequence.diagonal or 1.0), diagonal)
    if path.suffix.lower() in GLTF_EXTENSIONS:
        size = format_bytes(size_with_frame_targets(sequence.header))
        table.append(("every frame", f"would be {size} as a morph target each"))
    return table


def texture_rows(report: VatReport, diagonal: float) -> list[tuple[str, str]]:
    """Return table rows about sizes and errors of textures; `diagonal` is in metres."""
    kind = report.kind if not report.rank else f"{report.kind}, {report.rank} basis vectors"
    return [
        ("textures", f"{kind}: {format_bytes(report.file_bytes)}, in memory {format_bytes(report.memory_bytes)}"),
        ("max error", length_text(report.max_error, diagonal)),
        ("rms error", length_text(report.rms_error, diagonal)),
        *files.between_row(report.between_error, diagonal),
        ("normals", f"off by {report.normal_degrees:.3g} degrees (root mean square)"),
    ]


def _seconds(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(item) for item in text.split(","))
    except ValueError:
        raise click.BadParameter(f"{text!r} is not a list of seconds such as 0,0.5,1.25") from None


@options.command(
    "decode",
    "mixseq decode walk.h5 walk48.usdc --fps 48",
    "mixseq decode walk.h5 still.obj --times 0.73",
    "mixseq decode shot.h5 part.usdc --frames 1005-1010",
    "mixseq decode walk.h5 slow.usdc --fps 240 --start 0.5 --end 1 --velocities",
    "mixseq decode walk.h5 again.usdc --cluster tcp://host:8786",
    "mixseq decode walk.h5 walk.glb --as skin --set bones=30",
    "mixseq decode walk.abc walk.glb --as skin --set skeleton=character.glb",
    "mixseq decode walk.abc walk.glb --as morph --max-error 0.001",
    "mixseq decode walk.h5 walk.vat --max-error 0.001",
    "mixseq decode herd.h5 'out/{body}.usdc'",
    source=argument(metavar="MODEL"),
    frame_options=Group(
        options.fps("Frames per second.  [default: the original frames]"),
        option("--times S,S,...", "Decode exactly these times, in seconds.", type=_seconds),
        options.frames(
            "Only these frames of the model, by their numbers; with --fps from the first to the last of them."
        ),
        option("--start S", "First time in seconds.  [default: that of the model]", type=float),
        option("--end S", "Last time in seconds.  [default: that of the model]", type=float),
    ),
    between=setting(
        "--between",
        "Motion between frames: the model's, or along splines of vertices, as players show compressed models.",
        type=click.Choice(["auto", "vertices"]),
        default="auto",
    ),
    body=options.body(
        "Body to decode, of a model with several; {body} in TARGET decodes all, to files by their names."
    ),
    kind=option(
        "--as",
        "Write glTF or USD for engines: a skin over moving bones, or a mesh with few morph targets.",
        type=click.Choice(["skin", "morph"]),
    ),
    rig=Group(
        setting("--bones N", "Number of bones of a skin.", type=POSITIVE_INTEGER),
        setting("--skeleton FILE", "glTF or USD file with the bones of a skin."),
        option("--kg P", "Give a skin as few bones as reach this KG error, in percent.", type=POSITIVE_NUMBER),
        length("--correctives E", "Correct a skin by morph targets, up to this largest error.", cls=Setting),
        length(
            "--max-error E",
            "Largest error of a skin's bones, of a morph or of textures, as a fraction of the bounding box's "
            "diagonal, or 0.5mm; a morph without it is exact.",
        ),
        flag(
            "--between-frames",
            "Keep --max-error between frames, too, at quarters of a frame of TARGET, with up to 8 times the frames.",
        ),
        setting("--max-targets N", "Number of morph targets at most.", type=NON_NEGATIVE_INTEGER),
    ),
    texture=setting(
        "--texture",
        "Of vertex animation textures (TARGET is a folder .vat): PNG with 16 bits, or EXR.",
        type=click.Choice(["png16", "exr"]),
        default="png16",
    ),
)
def command(
    source: Path,
    target: Path,
    frame_options: dict[str, Any],
    between: BetweenName,
    body: str | None,
    velocities: bool,
    kind: str | None,
    rig: dict[str, Any],
    texture: TextureName,
    writing: dict[str, Any],
    workers: options.Workers,
    claim: files.Claim,
    quiet: bool,
) -> None:
    """Turn a model back into a sequence, at any frame rate.

    TARGET's format follows from its extension, see "mixseq formats". Frames are written while later frames are decoded.

    A model with several bodies, from "mixseq transfer --as-body", is the one that it was made of, or --body.

    If TARGET is a folder .vat, frames become textures for graphics cards: one texel for every vertex and frame, or with
    --max-error low-rank textures, which are much smaller.

    With --as, TARGET is a .glb or .gltf for game engines, or USD with a skeleton. It is fitted to all frames, read back
    and compared with the frames. MODEL may then also be a sequence.
    """
    textures = target.suffix.lower() == files.VAT_EXTENSION
    if textures:
        names = {"kind", *_KINDS_BY_OPTION, "velocities", *writing} - {"max_error", "between_frames"}
        for option in options.given_options(*sorted(names)):
            raise SettingsError(f"vertex animation textures (.vat) have no place for {option}; leave it out")
    else:
        _check_rig(kind)
    hold = rig.pop("between_frames", False)
    if "max_error" not in rig:
        options.refuse("between_frames", why="is about --max-error; give both")
    targets = files.targets_of_bodies(source, target, body)
    claim(*targets)
    if textures:
        from mixseq_io.vat.writer import check_vat_target

        check_vat_target(target)
    elif kind is not None:
        from mixseq_io.rig_files import check_rig_target, write_measured_rig

        check_rig_target(target)
    tables = []
    with workers as work, progress_bar(quiet) as progress, ExitStack() as opened:
        for path, name in targets.items():
            if kind is None and not textures:
                model = _load(source, between, name, progress)
                header = _header_of_frames(model, **frame_options)
                files.write_frames(path, model, header, velocities, writing, progress, work)
                tables.append(
                    [] if quiet else files.time_rows(header) + files.between_rows(path, header, model.blocks, writing)
                )
                continue
            sequence, frames = _frames_to_fit(source, frame_options, between, name, progress, work, opened)
            files.check_origin(path, sequence)
            settings = in_diagonals(rig, sequence, "max_error", "correctives")
            motion = None if quiet and not hold else _motion_of(frames, progress, hold)
            if textures:
                report = mixseq.write_vat(
                    path, sequence, settings.get("max_error"), texture, progress, motion=motion, between_frames=hold
                )
                tables.append(texture_rows(report, sequence.diagonal * sequence.metres_per_unit))
                continue
            if hold and motion is not None:
                rig_model, sequence = _hold_rig_between(kind or "", sequence, motion, progress, **settings)
            else:
                rig_model = _fit_rig(kind or "", sequence, progress, **settings)
            bound = settings.get("correctives") or settings.get("max_error")
            measured = write_measured_rig(path, rig_model, sequence, bound)
            tables.append([] if quiet else rows(path, rig_model, sequence, measured, motion))
    for path, table in zip(targets, tables, strict=True):
        if not quiet:
            print_table(table)
        announce(path)


def _load(source: Path, between: BetweenName, body: str | None, progress: Progress) -> Decodable:
    """Load a model with a body in front, by default its own, or the motion of its vertices alone."""
    from mixseq.operations.resampling import vertex_motion

    model = files.load_body(source, body)
    return vertex_motion(model, progress) if between == "vertices" else model


def _frames_to_fit(
    source: Path,
    frame_options: Mapping[str, Any],
    between: BetweenName,
    body: str | None,
    progress: Progress,
    workers: Executor,
    opened: ExitStack,
) -> tuple[MeshSequence, Decodable | Frames]:
    """Decode the chosen frames of a model into memory, or read a sequence; also return the model, rig or sequence."""
    from mixseq.sequence.sequence import is_rig, join_blocks

    named_as_model = source.suffix.lower() in files.MODEL_EXTENSIONS and not source.is_file()
    if not (files.is_model(source) or named_as_model):
        if frame_options:
            raise SettingsError(
                f"{source} is a sequence, whose frames are fitted as they are; leave out --fps, --times, --frames, "
                "--start and --end, or turn it into a model first, with mixseq encode"
            )
        options.refuse("between", "body", why=f"is for models, and {source} is a sequence; leave it out")
        sequence = files.read_sequence(source, {}, progress)
        reader = opened.enter_context(mixseq.open_sequence(source))
        return sequence, reader if is_rig(reader) else sequence
    model = _load(source, between, body, progress)
    header = _header_of_frames(model, **frame_options)
    return join_blocks(header, model.blocks(header.times, progress=progress, workers=workers)), model


def _header_of_frames(
    model: Decodable,
    fps: float | None = None,
    times: tuple[float, ...] | None = None,
    frames: options.FrameChoice | None = None,
    start: float | None = None,
    end: float | None = None,
) -> SequenceHeader:
    """Return the header of the frames to decode, by default those of the model."""
    if frames is not None:
        for option in options.given_options("times", "start", "end"):
            raise SettingsError(f"--frames chooses all frames; leave out {option}")
        if fps is not None:
            return _range(model, fps, *frames.span(model.header))
        return model.header_at(model.times[frames.indices(model.header)])
    if times is None:
        return _range(model, fps, start, end)
    if start is None and end is None:
        return model.header_at(times, fps)
    raise SettingsError("--times chooses all times; leave out --start and --end")


def _range(model: Decodable, fps: float | None, start: float | None, end: float | None) -> SequenceHeader:
    """Return the header of frames from `start` to `end`: at the rate `fps`, or the original frames if it is None."""
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
        rate = snap_to_ntsc(fps, model.header.fps)
        return model.header_at(frame_times(first, last, rate), rate)
    model.clip_times([first, last])
    times = model.times[(model.times >= first - slack) & (model.times <= last + slack)]
    if not times.size:
        raise SettingsError(f"the model has no frame from {first:g} to {last:g} s; give --fps to make new ones")
    return model.header_at(times)
