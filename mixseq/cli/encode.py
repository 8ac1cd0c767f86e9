"""Implement the command ``mixseq encode``, and the options of compression that ``mixseq batch`` shares."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.choices import ORDERS, STILLS, StillName
from mixseq.cli import files, options
from mixseq.cli.group import (
    announce,
    as_bytes,
    in_diagonals,
    in_diagonals_of_all,
    length_text,
    print_table,
    progress_bar,
)
from mixseq.cli.info import bytes_of_frames, coding_facts, coding_rows, dimension_rows, size_row
from mixseq.cli.options import NON_NEGATIVE_INTEGER, POSITIVE_NUMBER, Group, flag, length, option, setting
from mixseq.errors import OutputError, SettingsError

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq.metrics import Comparison
    from mixseq.runtime.progress import Progress
    from mixseq.signals.model import Model
    from mixseq_io.reader import SequenceReader


_OF_FITTING = (
    *("exact", "tolerance", "rank", "space", "segmentation", "joint_width", "placement"),
    *("projection", "volume", "knots", "between"),
)
"""Options of ``mixseq encode`` that apply only to uncompressed models."""


def _aim(uvs: bool = True, inbetweens: bool = True, between_frames: bool = False, **parameters: Any) -> dict[str, Any]:
    """Return the parameters of `mixseq.compress`, empty without a target; raise an error for contradicting options."""
    targets = options.given_options("max_error", "kg", "size")
    if len(targets) > 1:
        raise SettingsError(f"give one of {' and '.join(targets)}, not {len(targets)}: each follows from the other")
    if "max_error" not in parameters:
        options.refuse("between_frames", why="is about --max-error; give both")
    if not targets:
        options.refuse(
            *("uv_error", "uvs", "order", "chunk", "inbetweens"),
            why="is for compressed models; give --max-error, --kg or --size, too",
        )
        return {}
    options.refuse(*_OF_FITTING, why=f"is for models that are not compressed; leave it out, or leave out {targets[0]}")
    parameters |= {"between_frames": True} if between_frames else {}
    switches = {"uvs": uvs, "inbetweens": inbetweens}
    return parameters | {name: False for name, is_on in switches.items() if not is_on}


aiming = Group(
    length(
        "--max-error X",
        "Compress: no vertex of any frame is farther off than this fraction of the bounding box's diagonal, or 0.5mm.",
    ),
    flag(
        "--between-frames",
        "Keep --max-error between frames, too: players are as near to the model, at quarters of a frame.",
    ),
    option("--kg X", "Compress, to a KG error of X percent.", type=POSITIVE_NUMBER),
    option("--size SIZE", "Compress into 2MB, 500kB, 1.5MiB, ...", type=as_bytes),
    setting(
        "--uv-error X",
        "Compressed: u and v are off by X at most, 0 keeps all bits.  [default: 1/16 texel of 4096]",
        type=click.FloatRange(min=0, max=0.25),
    ),
    setting(
        "--order",
        "Compressed: what keeps its numbers, vertices and faces, vertices only, or neither.  [default: keep]",
        type=click.Choice(ORDERS),
    ),
    setting(
        "--chunk N",
        "Compressed: about N frames can be decoded without others.  [default: 512]",
        type=click.IntRange(min=16),
    ),
    setting("--uvs/--no-uvs", "Compressed: keep texture coordinates.", default=True),
    setting(
        "--inbetweens/--no-inbetweens",
        "Compressed: fit a model, so that players show its motion between frames; takes as long as a fit.",
        default=True,
    ),
    gather=_aim,
)
"""Options for targets of compression, as parameters of `mixseq.compress`."""


def compressed(
    frames: SequenceReader, aim: Mapping[str, Any], progress: Progress, still: StillName | None = None
) -> CompressedSequence:
    """Compress a sequence to a target; a target size is the size of the file, a .glb if `still` is given."""
    from mixseq.signals.model import Model
    from mixseq_io.model_files import model_or_reader

    source = model_or_reader(frames)
    bodies = list(source.frames_of_bodies()) if isinstance(source, Model) else [frames]
    aim = in_diagonals_of_all(aim, bodies)
    if "size" not in aim or len(bodies) > 1:
        return mixseq.compress(source, **aim, progress=progress)
    from mixseq_io.coded.sizes import compress_to_size

    return compress_to_size(frames, still=still, progress=progress, **aim)


@options.command(
    "encode",
    "mixseq encode walk.usdc walk.h5 --check",
    "mixseq encode walk.usdc walk.h5 --exact",
    "mixseq encode walk.usdc walk.h5 --tolerance 0.002 --parts 12",
    "mixseq encode man.glb man.h5 --source skeleton",
    "mixseq encode walk.usdc small.h5 --max-error 0.5mm",
    "mixseq encode walk.usdc small.h5 --size 200kB",
    "mixseq encode walk.usdz walk.glb --max-error 0.001",
    aim=aiming,
    knots=setting(
        "--knots N",
        "Number of inner knots of all curves over time.  [default: as the tolerance needs, else all]",
        type=NON_NEGATIVE_INTEGER,
    ),
    still=setting(
        "--still",
        "Of a .glb: the first frame for other viewers, by Draco, as float32, or left out.  [default: draco]",
        type=click.Choice(STILLS),
    ),
    check=option(
        "--check/--no-check", "Decode all frames of the finished model and compare them with SOURCE.", default=False
    ),
)
@files.each_animation
def command(
    source: Path,
    target: Path,
    aim: dict[str, Any],
    fitting: dict[str, Any],
    timing: dict[str, Any],
    labels: files.LabelChoice,
    knots: int | None,
    still: StillName | None,
    check: bool,
    workers: options.Workers,
    reading: dict[str, Any],
    claim: files.Claim,
    quiet: bool,
) -> None:
    """Turn a sequence into a model.

    SOURCE is a sequence in any format, and may be larger than memory. TARGET is an HDF5 file, or a .glb if the model is
    compressed. The model reproduces the frames within the tolerance and can be decoded at any time in between.

    With --max-error or --kg the model is compressed to the smallest size with this error; with --size, to the smallest
    error with this size. --max-error is guaranteed; other errors are measured, see "mixseq verify". A .glb plays on the
    web (see "mixseq web"). If SOURCE is already a compressed model, its data is copied to the .glb unchanged.
    """
    web = target.suffix.lower() == files.GLB_EXTENSION
    _check_name(target, compressed=bool(aim) or (web and files.is_model(source)))
    if not web:
        options.refuse("still", why="is for .glb files; leave it out")
    still = still or "draco"
    claim(target)
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence

    start = perf_counter()
    error: Comparison | None = None
    with workers as work, progress_bar(quiet) as progress, mixseq.open_sequence(source, **reading) as reader:
        model: Model | CompressedSequence
        parts = labels.parts(reader, fitting.get("parts"), reading)
        if aim:
            chosen = {"parts": parts, **options.at_frames(timing, reader.header)}
            model = compressed(reader, aim | chosen, progress, still if web else None)
        elif web:
            from mixseq_io.model_files import read_compressed

            model = read_compressed(source)
        else:
            fitting = in_diagonals(fitting, reader, "tolerance")
            fitting |= {"parts": parts, **options.at_frames(timing, reader.header)}
            model = mixseq.fit(reader, **fitting, knots=knots, progress=progress, workers=work)
        mixseq.save(target, model, still=still)
        seconds = perf_counter() - start
        if check:
            error = mixseq.compare(reader, files.decoded(mixseq.load(target), progress, work))
    if not quiet:
        if isinstance(model, CompressedSequence):
            rows = dict(coding_rows(coding_facts(target, model), model.header.metres_per_unit))
        else:
            sizes = target.stat().st_size, bytes_of_frames(model.header)
            rows = dict([*dimension_rows(model), size_row(*sizes)])
        rows |= dict(files.history_rows(model.header))
        rows["time"] = f"{seconds:.1f} s"
        if error is not None:
            length = length_text(error.max_error, error.diagonal * reader.header.metres_per_unit, digits=2)
            rows["max error"] = f"{length}, in frame {reader.header.frame_number(error.worst_frame)}"
            rows["KG error"] = f"{error.kg_percent:.2g} %"
        print_table(rows.items())
    announce(target)


def _check_name(path: Path, compressed: bool) -> None:
    """Raise an error if a path does not have the extension of a model."""
    suffix = path.suffix.lower()
    if suffix == files.GLB_EXTENSION and not compressed:
        raise OutputError(f"{path}: a .glb holds compressed models; give --max-error, --kg or --size, too")
    if suffix not in (*files.MODEL_EXTENSIONS, files.GLB_EXTENSION):
        raise OutputError(
            f"{path}: models are HDF5 files; end the name in {' or '.join(files.MODEL_EXTENSIONS)}, or in "
            f"{files.GLB_EXTENSION} for the web"
        )
