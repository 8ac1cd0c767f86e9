"""``mixseq transfer``."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

import mixseq
from mixseq.choices import TRANSFERS
from mixseq.cli.console import announce, print_json, print_table, progress_bar
from mixseq.cli.files import is_model, write_sequence
from mixseq.cli.options import (
    FILE,
    examples,
    json_option,
    labels_options,
    quiet_option,
    reader_options,
    workers_options,
    writer_options,
)
from mixseq.cli.overwriting import Claim, overwrite_option
from mixseq.cli.settings import CommandWithSettings, setting
from mixseq.cli.transfer_files import (
    READ_OF_ALL,
    check_formats,
    chosen_contacts,
    chosen_map,
    chosen_markers,
    chosen_parts,
    chosen_rest,
    first_frame,
    mesh_at_rest,
    opened_source,
    picture_beside,
    save_correspondence,
)
from mixseq.cli.transfer_report import PassingFrames, draw, facts, frames_to_draw, rows
from mixseq.errors import SettingsError
from mixseq.warned import warnings_heard

if TYPE_CHECKING:
    from mixseq.choices import TransferName
    from mixseq.mapping import Executor


@click.command(
    "transfer",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq transfer walk.usdc tall.obj tall_walk.usdc",
        "mixseq transfer horse.h5 camel.obj camel.usdc --markers pairs.txt --save-map map.npz",
        "mixseq transfer gallop.abc camel.obj camel.abc --map map.npz --rest horse.obj",
        "mixseq transfer gallop.h5 camel.obj camel.h5 --markers pairs.txt --as-model",
    ),
)
@click.argument("source", type=FILE)
@click.argument("target", type=FILE)
@click.argument("out", type=FILE)
@click.option(
    "--markers", type=FILE, metavar="FILE", help="Pairs of vertices that are the same: SOURCE, TARGET."
)
@click.option("--reverse", is_flag=True, help="The vertices of TARGET come first in --markers.")
@click.option(
    "--map", "map_file", type=FILE, metavar="FILE", help="Dense correspondence, instead of markers."
)
@click.option("--save-map", type=FILE, metavar="FILE", help="Keep the correspondence, for --map.")
@click.option(
    "--method",
    type=click.Choice(TRANSFERS),
    default="mixed",
    show_default=True,
    help="Parts, joints and poses, or deformation gradients (Sumner and Popović).",
)
@click.option(
    "--rest",
    metavar="FRAME|FILE",
    help="Frame in which SOURCE is in TARGET's pose, or a file with the same mesh in that pose.  [default: the first; "
    "of glTF SOURCE without animation]",
)
@click.option(
    "--parts",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of parts of SOURCE; every connected component has at least one.  [default: automatic]",
)
@setting(
    "--joint-width",
    type=click.IntRange(min=1),
    metavar="N",
    help="Largest width of joints, in strips of triangles on each side of a boundary.  [default: 3]",
)
@labels_options
@click.option(
    "--contacts",
    type=FILE,
    metavar="FILE",
    help='Vertices of TARGET that shall not slide while SOURCE rests there, as JSON: {"left foot": [12, 13], ...}.',
)
@click.option(
    "--as-model",
    is_flag=True,
    help="OUT is a model with the time and pose signals of SOURCE, a model too; only its key poses are transferred.",
)
@setting("--target-prim", metavar="PATH", help="Mesh to read of TARGET, as --prim is of SOURCE.")
@click.option("--picture", type=FILE, metavar="PNG", help="Name of the picture.  [default: beside OUT]")
@click.option("--no-picture", is_flag=True, help="Draw no picture.")
@json_option
@reader_options
@writer_options
@workers_options
@overwrite_option
@quiet_option
def command(
    source: Path,
    target: Path,
    out: Path,
    markers: Path | None,
    reverse: bool,
    map_file: Path | None,
    save_map: Path | None,
    method: str,
    rest: str | None,
    parts: int | None,
    joint_width: int | None,
    labels: Path | None,
    label_source: str | None,
    contacts: Path | None,
    as_model: bool,
    target_prim: str | None,
    picture: Path | None,
    no_picture: bool,
    as_json: bool,
    reading: dict[str, Any],
    writing: dict[str, Any],
    workers: AbstractContextManager[Executor],
    claim: Claim,
    quiet: bool,
) -> None:
    """Move a mesh as another one moves.

    SOURCE is a sequence in any format, or a model. TARGET is the mesh in its first frame, in a pose like that of SOURCE
    at --rest; of glTF files both are the pose without animation, mostly that in which they were bound. OUT's format
    follows from its extension, see "mixseq formats"; it is written while frames are made.

    Meshes with the same triangles need nothing else. For others, --markers names pairs of vertices, a file with a pair
    a line, counted from 0; what corresponds in between is found by bending SOURCE onto TARGET, which takes a while:
    --save-map keeps it for the next time. Components of TARGET without markers follow what is next to them.

    The table tells what corresponds, how much OUT is strained in comparison with SOURCE, whether it moves as smoothly,
    and where it goes through itself. A picture of both is drawn beside OUT.

    With --as-model only the key poses of SOURCE are transferred, and OUT moves by SOURCE's time and pose signals: what
    is edited in one can be played on the other (mixseq.operations.with_shapes).

    --up-axis and --units are for all files, the other options for reading for SOURCE.
    """
    of_parts = {
        "parts": parts,
        "joint-width": joint_width,
        "labels": labels,
        "source": label_source,
        "contacts": contacts,
    }
    _check_settings(markers, map_file, reverse, method, of_parts, picture, no_picture)
    if as_model:
        _check_models(source, out, contacts)
    frame, rest_file = chosen_rest(rest, source)
    drawn = None if no_picture else picture or picture_beside(out)
    claim(out, drawn, save_map, read=[rest_file])
    check_formats(out, drawn, save_map)
    common = {name: value for name, value in reading.items() if name in READ_OF_ALL}
    notes: list[str] = []
    with (
        workers as work,
        progress_bar(quiet) as progress,
        warnings_heard(notes.append),
        opened_source(source, reading) as opened,
    ):
        from mixseq.retargeting.report import Meter
        from mixseq.retargeting.sources import source_motion
        from mixseq.retargeting.transfer import plan

        pairs, feet = chosen_markers(markers, reverse), chosen_contacts(contacts)
        if rest is not None and rest_file is None and frame >= 0:
            frame = opened.header.index_of(frame)
        shape = first_frame(target, common | ({} if target_prim is None else {"prim": target_prim}))
        rest_shape = frame if rest_file is None else mesh_at_rest(rest_file, reading, opened, rest is None)
        given = chosen_parts(opened, parts, labels, label_source, reading)
        keys = None
        if as_model:
            keys, rest_shape, given = _keys_of(opened, rest_shape)
        motion = source_motion(opened if keys is None else keys, rest_shape, given, progress)
        made = plan(
            motion,
            shape,
            pairs,
            chosen_map(map_file, motion, shape),
            cast("TransferName", method),
            contacts=feet,
            joint_width=joint_width or 3,
            progress=progress,
            workers=work,
        )
        if save_map is not None:
            save_correspondence(save_map, made)
        meter, shown = Meter(made), PassingFrames(frames_to_draw(made, frame, rest_file))
        blocks = shown.passing(meter.passing(made.blocks(progress, work)))
        if as_model:
            _save_model(out, opened, made.header, blocks)
        else:
            write_sequence(out, made.header, blocks, None, writing)
        report = meter.report()
        if drawn is not None:
            draw(drawn, made, shown)
    if as_json:
        files = {"source": str(source), "target": str(target), "out": str(out)}
        print_json(files | facts(made, method, report) | {"warnings": notes})
        return
    if not quiet:
        print_table(rows(made, method, report))
    for each in (save_map, out, drawn):
        if each is not None:
            announce(each)


def _check_models(source: Path, out: Path, contacts: Path | None) -> None:
    """Raise an error for options that a transfer between models does not support, before anything is read."""
    if not (is_model(source) and out.suffix.lower() == ".h5"):
        raise SettingsError(
            "--as-model makes a model of a model: SOURCE and OUT are .h5 files; see mixseq encode"
        )
    if contacts is not None:
        raise SettingsError(
            "--contacts are kept frame by frame, and only key poses are transferred; leave one out"
        )


def _keys_of(model: Any, rest: Any) -> tuple[Any, Any, Any]:
    """Return the key poses of a model as a sequence, the mesh at rest, and the parts."""
    from mixseq.operations import key_poses

    at_rest = model.sample(frames=[rest]) if isinstance(rest, int) else rest
    parts = None if model.space.decomposed is None else model.space.decomposed.part_of_face
    return key_poses(model), at_rest, parts


def _save_model(out: Path, model: Any, header: Any, blocks: Any) -> None:
    """Save the model on the transferred key poses."""
    from mixseq.operations import with_shapes
    from mixseq.sequence import collect

    mixseq.save(out, with_shapes(model, collect(header, blocks)))


def _check_settings(
    markers: Path | None,
    map_file: Path | None,
    reverse: bool,
    method: str,
    of_parts: Mapping[str, object],
    picture: Path | None,
    no_picture: bool,
) -> None:
    """Raise an error for options that contradict each other, before anything is read."""
    if markers is not None and map_file is not None:
        raise SettingsError("--markers and --map are two ways to say the same; give one of them")
    if reverse and markers is None:
        raise SettingsError("--reverse is about the order of --markers; give both, or neither")
    if picture is not None and no_picture:
        raise SettingsError("--picture and --no-picture exclude each other")
    if method == "gradients":
        for name, value in of_parts.items():
            if value is not None:
                raise SettingsError(f"the method gradients knows no parts; leave out --{name}, or --method")
