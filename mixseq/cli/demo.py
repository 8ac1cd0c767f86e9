"""``mixseq demo``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import click

import mixseq
from mixseq.cli.compare import at_times_of
from mixseq.cli.files import Claim, overwrite_option, read_sequence
from mixseq.cli.group import announce, print_table, progress_bar
from mixseq.cli.info import dimension_rows
from mixseq.cli.options import FILE, CommandWithSettings, examples, quiet_option

if TYPE_CHECKING:
    from mixseq.sequence.sequence import MeshSequence
    from mixseq.signals.model import Model


@click.command("demo", cls=CommandWithSettings, epilog=examples("mixseq demo --out fox --frames 24"))
@click.option(
    "--out",
    type=FILE,
    default=Path("mixseq-demo"),
    show_default=True,
    help="Folder for the files, made if missing.",
)
@click.option(
    "--frames",
    type=click.IntRange(min=2),
    default=48,
    show_default=True,
    metavar="N",
    help="Frames of the walk.",
)
@overwrite_option
@quiet_option
def command(out: Path, frames: int, claim: Claim, quiet: bool) -> None:
    """Encode and decode a walking fox, and compare.

    Leaves in the folder: creature.usdc, the walk cycle; model.h5, the same in the mixed shape space;
    decoded.usdc, at twice the frame rate; and contact_sheet.png, with the original, parts and joints, the
    reconstruction and its error.
    """
    from mixseq.creature import walk_cycle

    out.mkdir(parents=True, exist_ok=True)
    creature, stored, decoded, sheet = (
        out / name for name in ("creature.usdc", "model.h5", "decoded.usdc", "contact_sheet.png")
    )
    claim(creature, stored, decoded, sheet)
    clock = _Clock()
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
                ("max error", f"{error.max_error:.2g} of the diagonal"),
                ("KG error", f"{error.kg_percent:.2g} %"),
                ("seconds", clock.summary()),
            ]
        )
    for path in (creature, stored, decoded):
        announce(path)
    # Last, as it is the only step that needs an extra package.
    _draw(sheet, original, doubled, model)
    announce(sheet)


def _draw(path: Path, original: MeshSequence, decoded: MeshSequence, model: Model) -> None:
    from mixseq.pictures.sheets import contact_sheet
    from mixseq_io.files import replacing

    parts = model.decomposition
    with replacing(path) as temporary:
        contact_sheet(temporary, original, decoded, parts.part_of_face, parts.joint_of_face)


class _Clock:
    """A stopwatch for the steps."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, step: str) -> Iterator[None]:
        start = perf_counter()
        yield
        self._seconds[step] = perf_counter() - start

    def summary(self) -> str:
        """Return the seconds of every step."""
        return ", ".join(f"{seconds:.1f} to {step}" for step, seconds in self._seconds.items())
