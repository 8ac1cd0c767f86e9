"""Implement the command ``mixseq verify``."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.group import length_text, print_json, print_table, progress_bar
from mixseq.cli.options import argument, option
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq_io.verification import Verification


@options.command(
    "verify",
    "mixseq verify walk.h5",
    "mixseq verify walk.h5 walk.usdc --json",
    path=argument(metavar="FILE"),
    original=argument(required=False),
    script=option("--script FILE", "Edit script by which FILE was edited, to be applied to ORIGINAL, too."),
)
def command(
    path: Path, original: Path | None, script: Path | None, as_json: bool, reading: dict[str, Any], quiet: bool
) -> None:
    """Check that a model is not damaged, and that its error bound holds.

    FILE was written by "mixseq encode". All checksums are checked and all frames are decoded. With ORIGINAL, the error
    of every vertex in every frame is compared with the bound. If FILE was made of another model of ORIGINAL, the bound
    is the sum of both. The exit code is 0 if the bound holds, 1 if it does not, 2 if FILE is damaged.

    An edited model has no bound. With --script, it is compared with the same edit of ORIGINAL.
    """
    if original is None:
        options.refuse("script", why="is applied to ORIGINAL, which is missing; name it")
    if reading and original is None:
        raise SettingsError(f"{next(iter(reading))!r} is for reading ORIGINAL, which is missing; name it")
    from mixseq_io.model_files import model_or_reader

    with ExitStack() as resources:
        progress = resources.enter_context(progress_bar(quiet))
        frames = None
        if original is not None:
            frames = resources.enter_context(mixseq.open_sequence(original, **reading))
        source = None if frames is None else model_or_reader(frames)
        result = mixseq.verify(path, source, progress=progress, script=script)
    if as_json:
        print_json({"file": str(path), "original": None if original is None else str(original)} | result.as_dict())
    elif not quiet:
        for name, each in {"": replace(result, bodies={}), **result.bodies}.items():
            worst = None if frames is None or each.worst_frame is None else frames.header.frame_number(each.worst_frame)
            is_missing = original is not None and each.max_error is None
            missing = [("compared", "no: ORIGINAL has no body of this name")] if is_missing else []
            print_table([*([("body", name)] if name else []), *_rows(each, worst), *missing])
    if not result.holds:
        click.get_current_context().exit(1)


def _rows(result: Verification, worst: str | None) -> list[tuple[str, str]]:

    def length(fraction: float) -> str:
        return length_text(fraction, result.diagonal, digits=6)

    rows = [("intact", f"{result.frames:,} frames of {result.vertices:,} vertices")]
    if result.provenance:
        rows.append(("history", result.provenance))
    if result.bound is not None:
        how = "requested" if result.promised else "as measured"
        rows.append(("bound", f"{length(result.bound)} from {result.source or 'the original'}, {how}"))
    if result.uv_bound is not None:
        rows.append(("texture", f"{result.uv_bound:.6g} of the square, requested"))
    if result.max_error is None:
        return rows
    texture = [("texture error", f"{result.uv_error:.6g} of the square")] if result.uv_error is not None else []
    if result.bound is not None:
        texture.append(("bound holds", "yes" if result.holds else "no"))
    return [
        *rows,
        ("max error", f"{length(result.max_error)}, of vertex {result.worst_vertex} in frame {worst}"),
        ("KG error", f"{result.kg_percent:.4g} %"),
        *texture,
    ]
