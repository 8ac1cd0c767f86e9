"""``mixseq verify``."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.group import print_json, print_table, progress_bar
from mixseq.cli.lengths import length_text
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq_io.verification import Verification


@options.command("verify", "mixseq verify walk.h5", "mixseq verify walk.h5 walk.usdc --json")
@options.argument("path", metavar="FILE")
@options.argument("original", required=False)
@options.as_json
@options.reading
@options.quiet
def command(path: Path, original: Path | None, as_json: bool, reading: dict[str, Any], quiet: bool) -> None:
    """Check a compressed model: that it is not damaged, and that its bound holds.

    FILE is what "mixseq encode --max-error", --kg or --size wrote. All checksums are checked and all frames decoded.
    With ORIGINAL every vertex of every frame is compared with the bound. The exit code is 0 if it holds, 1 if not,
    2 if FILE is damaged.
    """
    from mixseq_io.verification import read_compressed

    if reading and original is None:
        raise SettingsError(f"{next(iter(reading))!r} tells how to read ORIGINAL, but there is none; name it")
    with ExitStack() as resources:
        progress = resources.enter_context(progress_bar(quiet))
        frames = None
        if original is not None:
            frames = resources.enter_context(mixseq.open_sequence(original, **reading))
        found = mixseq.verify(path, frames, progress=progress)
    worst = (
        None if frames is None or found.worst_frame is None else frames.header.frame_number(found.worst_frame)
    )
    if as_json:
        print_json(
            {"file": str(path), "original": None if original is None else str(original)} | found.as_dict()
        )
    elif not quiet:
        print_table(_rows(found, read_compressed(path), worst))
    if not found.holds:
        click.get_current_context().exit(1)


def _rows(found: Verification, coded: CompressedSequence, worst: str | None) -> list[tuple[str, str]]:

    def length(fraction: float) -> str:
        return length_text(fraction, coded.parameters.diagonal * coded.header.metres_per_unit, digits=6)

    rows = [
        ("intact", f"{found.frames:,} frames of {found.vertices:,} vertices"),
        ("bound", f"{length(found.bound)}, {'requested' if found.promised else 'as measured'}"),
    ]
    if found.uv_bound is not None:
        rows.append(("texture", f"{found.uv_bound:.6g} of the square, requested"))
    if found.max_error is None:
        return rows
    texture = [("texture error", f"{found.uv_error:.6g} of the square")] if found.uv_error is not None else []
    return [
        *rows,
        (
            "max error",
            f"{length(found.max_error)}, of vertex {found.worst_vertex} in frame {worst}",
        ),
        ("KG error", f"{found.kg_percent:.4g} %"),
        *texture,
        ("bound holds", "yes" if found.holds else "no"),
    ]
