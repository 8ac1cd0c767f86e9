"""``mixseq plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import mixseq
from mixseq.choices import PICTURES, PictureKind
from mixseq.cli.console import announce, progress_bar
from mixseq.cli.files import read_sequence
from mixseq.cli.filmed import FilmOptions, film_options, make_film
from mixseq.cli.frames import FrameChoice, frames_option
from mixseq.cli.options import FILE, examples, quiet_option, reader_options
from mixseq.cli.overwriting import Claim, overwrite_option
from mixseq.cli.settings import CommandWithSettings
from mixseq.errors import SettingsError


@click.command(
    "plot",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq plot walk.h5 walk.png",
        "mixseq plot walk.h5 errors.png --kind error-vertices --against walk.usdc",
        "mixseq plot walk.h5 embedding.svg --kind embedding --frames 0,12,24,36",
        "mixseq plot --video walk.mp4 walk.usdc walk.h5 --turn 360 --seconds 8",
        "mixseq plot --video parts.gif walk.h5 --colour parts --size 640x360",
    ),
)
@click.argument("files", metavar="MODEL TARGET | --video FILM FILES...", nargs=-1, type=FILE)
@click.option(
    "--kind",
    type=click.Choice(PICTURES),
    help="One picture only.  [default: all of them on one page]",
)
@click.option(
    "--against",
    type=FILE,
    metavar="SEQUENCE",
    help="The original in any format, to draw the errors of the model.",
)
@frames_option(
    "Frames to number in the embedding, or to draw with the errors of their vertices.  [default: automatic]",
    "N,N,...",
)
@click.option("--tolerance", type=float, metavar="D", help="Draw a line at an error of so many diagonals.")
@film_options
@reader_options
@overwrite_option
@quiet_option
def command(
    files: tuple[Path, ...],
    kind: PictureKind | None,
    against: Path | None,
    frames: FrameChoice | None,
    tolerance: float | None,
    filming: FilmOptions,
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Draw a model: its signals, its parts, and how far it is from the original. Or make a film.

    TARGET is a PNG or an SVG file. Without --kind it is a page with the time signal in its MDS embedding, its
    coefficients, the singular values, parts and joints, and with --against the errors per frame and per vertex.

    With --video, FILES are models or sequences in any format, which are shown side by side. It is drawn without a
    graphics card, and the same on every number of threads.
    """
    if filming.video is not None:
        _refuse_in_films(files, kind, frames, tolerance)
        make_film(filming.video, files, filming, against, reading, claim, quiet)
        return
    filming.refuse()
    source, target = _model_and_target(files)
    from mixseq.plots import check_settings, picture_format, plot_model
    from mixseq_io.atomic import replacing

    picture_format(target)
    check_settings(
        kind, against is not None, None if frames is None else frames.ranges, tolerance, filming.camera
    )
    if against is None and reading:
        raise SettingsError(
            "--prim, --animation, --input-fps, --mesh and --allow-gaps tell how to read a sequence; give --against"
        )
    claim(target)
    model = mixseq.load(source)
    with progress_bar(quiet) as progress:
        original = None
        if against is not None:
            original = read_sequence(against, reading, progress)
        with replacing(target) as temporary:
            plot_model(
                temporary,
                model,
                kind,
                against=original,
                frames=None if frames is None else frames.indices(model.header),
                tolerance=tolerance,
                camera=filming.camera,
                progress=progress,
            )
    announce(target)


def _model_and_target(files: tuple[Path, ...]) -> tuple[Path, Path]:
    """Return the two arguments of pictures, without --video."""
    if len(files) < 2:
        raise click.UsageError(
            f"Missing argument '{'TARGET' if files else 'MODEL'}'.", click.get_current_context()
        )
    if len(files) > 2:
        raise SettingsError(
            f"{files[2]} is one file too many; give MODEL and TARGET, or --video and any number of files"
        )
    return files[0], files[1]


def _refuse_in_films(
    files: tuple[Path, ...], kind: PictureKind | None, frames: FrameChoice | None, tolerance: float | None
) -> None:
    """Raise an error for options that only pictures have."""
    for name, value in (("kind", kind), ("frames", frames), ("tolerance", tolerance)):
        if value is not None:
            raise SettingsError(f"--{name} is about pictures; leave it out, or --video")
    if not files:
        raise click.UsageError("Missing argument 'FILES...'.", click.get_current_context())
