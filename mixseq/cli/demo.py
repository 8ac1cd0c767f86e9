"""Implement the command ``mixseq demo``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.files import Claim, at_times_of, read_sequence
from mixseq.cli.group import announce, length_text, print_table, progress_bar
from mixseq.cli.info import dimension_rows
from mixseq.cli.options import option


@options.command(
    "demo",
    "mixseq demo --out fox --frames 24",
    out=options.out_folder(default=Path("mixseq-demo")),
    frames=option("--frames N", "Frames of the walk.", type=click.IntRange(min=2), default=48),
)
def command(out: Path, frames: int, claim: Claim, quiet: bool) -> None:
    """Encode and decode a walking fox, and compare.

    The folder then contains creature.usdc, the walk cycle; model.h5, the model in the mixed shape space;
    decoded.usdc, the model at twice the frame rate; and contact_sheet.png, a picture of the original, parts and joints,
    the reconstruction and its error.
    """
    from mixseq.creature import walk_cycle
    from mixseq_io.files import atomic_file

    out.mkdir(parents=True, exist_ok=True)
    creature, stored, decoded, sheet = (
        out / name for name in ("creature.usdc", "model.h5", "decoded.usdc", "contact_sheet.png")
    )
    claim(creature, stored, decoded, sheet)
    seconds: dict[str, float] = {}

    @contextmanager
    def clock(step: str) -> Iterator[None]:
        start = perf_counter()
        yield
        seconds[step] = perf_counter() - start

    with progress_bar(quiet) as progress:
        with clock("make"):
            mixseq.write(creature, walk_cycle(frames))
            original = read_sequence(creature, {}, progress)
        with clock("encode"):
            mixseq.save(stored, mixseq.fit(original, exact=True, progress=progress))
        with clock("decode"):
            model = mixseq.load(stored)
            doubled = model.sample(fps=2 * original.fps, progress=progress)
            mixseq.write(decoded, doubled)
        with clock("compare"):
            error = mixseq.compare(original, at_times_of(original, doubled))
    if not quiet:
        print_table(
            [
                ("vertices", f"{original.vertex_count:,}"),
                ("frames", f"{original.frame_count} encoded, {doubled.frame_count} decoded"),
                *dimension_rows(model),
                ("max error", length_text(error.max_error, error.diagonal * original.metres_per_unit, digits=2)),
                ("KG error", f"{error.kg_percent:.2g} %"),
                ("seconds", ", ".join(f"{time:.1f} to {step}" for step, time in seconds.items())),
            ]
        )
    announce(creature, stored, decoded)
    # The last step, as it needs an extra package.
    from mixseq.pictures.sheets import contact_sheet

    parts = model.decomposition
    with atomic_file(sheet) as temporary:
        contact_sheet(temporary, original, doubled, parts.part_of_face, parts.joint_of_face)
    announce(sheet)
