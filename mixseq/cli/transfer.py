"""``mixseq transfer``."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

import mixseq
from mixseq.choices import TRANSFERS
from mixseq.cli.console import announce, print_json, print_table, progress_bar
from mixseq.cli.files import check_target, is_model, options_of, write_sequence
from mixseq.cli.labelled import parts_given
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
from mixseq.cli.settings import CommandWithSettings, setting
from mixseq.cli.transferred import facts, rows
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.warned import warnings_heard

if TYPE_CHECKING:
    from mixseq.arrays import FloatArray
    from mixseq.choices import TransferName
    from mixseq.correspondence.dense import Correspondence
    from mixseq.correspondence.markers import Markers
    from mixseq.mapping import Executor
    from mixseq.retargeting.sources import SourceMotion
    from mixseq.retargeting.transfer import Transfer
    from mixseq.sequence import MeshSequence
    from mixseq.signals import Model
    from mixseq_io import SequenceReader

COLUMNS = 5
"""Frames in the picture, beside the rest."""

_ANIMATED = (".glb", ".gltf")  # formats that have a pose beside their animations

_OF_ALL = ("up_axis", "metres_per_unit")  # reader options that hold for every file


@click.command(
    "transfer",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq transfer walk.usdc tall.obj tall_walk.usdc",
        "mixseq transfer horse.h5 camel.obj camel.usdc --markers pairs.txt --save-map map.npz",
        "mixseq transfer gallop.abc camel.obj camel.abc --map map.npz --rest horse.obj",
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
    help="Frame in which SOURCE is in TARGET's pose, or a file with the same mesh in that pose.  [default: 0; of glTF "
    "SOURCE without animation]",
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
@setting("--target-prim", metavar="PATH", help="Mesh to read of TARGET, as --prim is of SOURCE.")
@click.option("--picture", type=FILE, metavar="PNG", help="Name of the picture.  [default: beside OUT]")
@click.option("--no-picture", is_flag=True, help="Draw no picture.")
@json_option
@reader_options
@writer_options
@workers_options
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
    target_prim: str | None,
    picture: Path | None,
    no_picture: bool,
    as_json: bool,
    reading: dict[str, Any],
    writing: dict[str, Any],
    workers: AbstractContextManager[Executor],
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
    frame, rest_file = _rest(rest, source)
    drawn = None if no_picture else picture or _picture_beside(out)
    _check_files(
        [each for each in (out, drawn, save_map) if each is not None],
        [
            each
            for each in (source, target, markers, map_file, labels, contacts, rest_file)
            if each is not None
        ],
    )
    _check_formats(out, drawn, save_map)
    common = {name: value for name, value in reading.items() if name in _OF_ALL}
    notes: list[str] = []
    with (
        workers as work,
        progress_bar(quiet) as progress,
        warnings_heard(notes.append),
        _opened(source, reading) as opened,
    ):
        from mixseq.retargeting.report import Meter
        from mixseq.retargeting.sources import source_motion
        from mixseq.retargeting.transfer import plan

        pairs, feet = _markers(markers, reverse), _contacts(contacts)
        shape = _first_frame(target, common | ({} if target_prim is None else {"prim": target_prim}))
        rest_shape = frame if rest_file is None else _at_rest(rest_file, reading, opened, rest is None)
        given = _parts(opened, parts, labels, label_source, reading)
        motion = source_motion(opened, rest_shape, given, progress)
        made = plan(
            motion,
            shape,
            pairs,
            _map(map_file, motion, shape),
            cast("TransferName", method),
            contacts=feet,
            joint_width=joint_width or 3,
            progress=progress,
            workers=work,
        )
        if save_map is not None:
            _save_map(save_map, made)
        meter, shown = Meter(made), _Shown(_frames_to_draw(made, frame, rest_file))
        blocks = shown.passing(meter.passing(made.blocks(progress, work)))
        write_sequence(out, made.header, blocks, None, writing)
        report = meter.report()
        if drawn is not None:
            _draw(drawn, made, shown)
    if as_json:
        files = {"source": str(source), "target": str(target), "out": str(out)}
        print_json(files | facts(made, method, report) | {"warnings": notes})
        return
    if not quiet:
        print_table(rows(made, method, report))
    for each in (save_map, out, drawn):
        if each is not None:
            announce(each)


def _check_settings(
    markers: Path | None,
    map_file: Path | None,
    reverse: bool,
    method: str,
    told: Mapping[str, object],
    picture: Path | None,
    no_picture: bool,
) -> None:
    """Refuse options that contradict each other, before anything is read."""
    if markers is not None and map_file is not None:
        raise SettingsError("--markers and --map are two ways to say the same; give one of them")
    if reverse and markers is None:
        raise SettingsError("--reverse is about the order of --markers; give both, or neither")
    if picture is not None and no_picture:
        raise SettingsError("--picture and --no-picture exclude each other")
    if method == "gradients":
        for name, value in told.items():
            if value is not None:
                raise SettingsError(f"the method gradients knows no parts; leave out --{name}, or --method")


def _rest(text: str | None, source: Path) -> tuple[int, Path | None]:
    """Return the frame that is meant, or a file."""
    if text is None:
        return 0, source if source.suffix.lower() in _ANIMATED else None
    return (int(text), None) if re.fullmatch(r"-?\d+", text) else (0, Path(text))


def _at_rest(
    path: Path, reading: Mapping[str, Any], opened: SequenceReader | Model, unasked: bool
) -> MeshSequence | int:
    """Read the source's mesh at rest; frame 0 instead, if nobody asked for a file that has other meshes."""
    shape = _first_frame(path, {name: reading[name] for name in (*_OF_ALL, "prim") if name in reading})
    header = opened.header
    if not unasked or (shape.vertex_count, len(shape.faces)) == (header.vertex_count, len(header.faces)):
        return shape
    warnings.warn(
        f"{path}: without animation there are other meshes than those that move, so frame 0 counts as the rest; "
        "--prim / takes all meshes, --rest FRAME says that a frame is meant",
        MixseqWarning,
        stacklevel=2,
    )
    return 0


def _picture_beside(out: Path) -> Path:
    """Return a name for the picture; that of numbered files has no number."""
    stem = re.sub(r"[-_. ]*(#+|\*+|%\d*d)", "", out.stem)
    return out.with_name(f"{stem}-transfer.png" if stem else "transfer.png")


def _check_files(written: Sequence[Path], read: Sequence[Path]) -> None:
    """Refuse what cannot be written, or would replace what is read or written, before the work."""
    for number, each in enumerate(written):
        for source in read:
            check_target(each, source)
        for other in written[:number]:
            if each.resolve() == other.resolve():
                raise OutputError(f"{each} is to be written twice; give another name")


def _check_formats(out: Path, picture: Path | None, save_map: Path | None) -> None:
    """Refuse extensions that nothing can write, before the work."""
    from mixseq_io import FORMATS

    known = [extension for each in FORMATS for extension in each.extensions]
    if out.suffix.lower() not in known:
        raise OutputError(
            f"{out}: the extension {out.suffix!r} is not known; write one of {', '.join(known)}"
        )
    if save_map is not None and save_map.suffix.lower() != ".npz":
        raise OutputError(f"{save_map}: maps are written as npz files; end the name in .npz")
    if picture is not None:
        from mixseq.plots.layout import matplotlib_module

        if picture.suffix.lower() != ".png":
            raise OutputError(f"{picture}: the picture is a PNG file; end the name in .png")
        matplotlib_module("figure")


def _opened(source: Path, reading: Mapping[str, Any]) -> AbstractContextManager[SequenceReader | Model]:
    """Open a sequence, or load a model."""
    if not is_model(source):
        return mixseq.open_sequence(source, **reading)
    others = [name for name in reading if name not in _OF_ALL]
    if others:
        raise SettingsError(
            f"{source} is a model, which is read without options; leave out those for sequences"
        )
    return nullcontext(mixseq.load(source))


def _first_frame(path: Path, reading: Mapping[str, Any]) -> MeshSequence:
    """Read the first frame of a file; of glTF, whose animations rarely begin at rest, the pose without any."""
    from mixseq.sequence import MeshSequence

    still = {"animation": "none"} if path.suffix.lower() in _ANIMATED else {}
    with mixseq.open_sequence(path, **options_of(path, still | dict(reading))) as reader:
        first = next(iter(reader.blocks(1)))[:1]
        return MeshSequence.from_header(reader.header.with_times(reader.header.times[:1]), first)


def _parts(
    motion: SequenceReader | Model,
    parts: int | None,
    labels: Path | None,
    label_source: str | None,
    reading: Mapping[str, Any],
) -> Any:
    """Return a number of parts, labels of triangles, or None."""
    from mixseq.signals import Model

    if labels is None and label_source is None:
        return parts
    if isinstance(motion, Model):
        raise SettingsError(
            "labels are for sequences; leave out --labels and --source, the model has its own parts"
        )
    return parts_given(motion, parts, labels, label_source, reading)


def _markers(path: Path | None, reverse: bool) -> Markers | None:
    if path is None:
        return None
    from mixseq_io.correspondence.markers import read_markers

    return read_markers(path, reverse=reverse)


def _contacts(path: Path | None) -> dict[str, list[int]] | None:
    if path is None:
        return None
    from mixseq_io.correspondence.contacts import read_contacts

    return read_contacts(path)


def _map(path: Path | None, motion: SourceMotion, shape: MeshSequence) -> Correspondence | None:
    if path is None:
        return None
    from mixseq_io.correspondence.maps import read_map, to_correspondence

    return to_correspondence(
        read_map(path), (motion.rest, motion.header.faces), (shape.points[0], shape.faces)
    )


def _save_map(path: Path, made: Transfer) -> None:
    from mixseq_io.correspondence.maps import write_map

    write_map(path, made.correspondence, made.source.header.faces, made.header.faces)


def _frames_to_draw(made: Transfer, frame: int, rest_file: Path | None) -> list[int]:
    """Choose frames for the picture; the one that is the rest is drawn anyway."""
    from mixseq.arrays import evenly

    count = made.header.frame_count
    chosen = [int(each) for each in evenly(count, COLUMNS)]
    return [each for each in chosen if rest_file is not None or each != frame % count] or chosen


class _Shown:
    """Keeps some frames ``(V', 3)`` while blocks pass by."""

    def __init__(self, frames: Sequence[int]) -> None:
        self.frames = frames
        self.points: list[FloatArray] = []

    def passing(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        first = 0
        for block in blocks:
            self.points += [
                block[each - first].copy() for each in self.frames if 0 <= each - first < len(block)
            ]
            first += len(block)
            yield block


def _draw(picture: Path, made: Transfer, shown: _Shown) -> None:
    import numpy as np

    from mixseq.plots.transfers import transfer_sheet
    from mixseq_io.atomic import replacing

    with replacing(picture) as temporary:
        transfer_sheet(temporary, made, shown.frames, np.stack(shown.points))
