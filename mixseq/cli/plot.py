"""``mixseq plot``.

The part of ``mixseq plot`` that makes films.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click

import mixseq
from mixseq.choices import COLOURS, PICTURES, Colour, PictureKind
from mixseq.cli.files import Claim, overwrite_option, read_sequence, scene_items
from mixseq.cli.group import announce, progress_bar
from mixseq.cli.options import (
    FILE,
    CommandWithSettings,
    FrameChoice,
    camera_option,
    examples,
    frames_option,
    quiet_option,
    reader_options,
    setting,
)
from mixseq.errors import SettingsError

Command = Callable[..., None]


@dataclass(frozen=True)
class FilmOptions:
    """Options of films as given; None if not."""

    video: Path | None
    size: tuple[int, int] | None
    fps: float | None
    seconds: float | None
    turn: float | None
    camera: tuple[float, float] | None
    follow: bool | None
    colour: Colour | None
    scale: float | None
    names: tuple[str, ...] | None

    def refuse(self) -> None:
        """Raise an error for any of them but the camera where no film is made."""
        for name, value in vars(self).items():
            if value is not None and name != "camera":
                raise SettingsError(f"--{name} is about films; give --video as well, or leave it out")


def _as_size(context: click.Context, option: click.Parameter, value: str | None) -> tuple[int, int] | None:
    if value is None:
        return None
    width, _, height = value.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise click.BadParameter(f"{value!r} is not a size such as 1280x720")
    return int(width), int(height)


def _as_names(context: click.Context, option: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    return None if value is None else tuple(name.strip() for name in value.split(","))


def film_options(command: Command) -> Command:
    """Add the options of films; the command gets all of them as ``filming``."""

    @click.option(
        "--video",
        type=FILE,
        metavar="FILE",
        help="Make a film of FILES side by side, sequences or models: .webp, .gif, or .mp4, which needs ffmpeg.",
    )
    @click.option("--size", callback=_as_size, metavar="WxH", help="Pixels of the film.  [default: 1280x720]")
    @click.option(
        "--fps",
        "film_fps",
        type=float,
        metavar="N",
        help="Frames per second of the film; models are decoded at its times.  [default: those of the first file]",
    )
    @setting(
        "--seconds",
        type=float,
        metavar="S",
        help="Duration of the film; what is shorter starts again.  [default: that of the longest file]",
    )
    @setting("--turn", type=float, metavar="DEGREES", help="Let the camera go around in the film.")
    @camera_option
    @setting("--follow", is_flag=True, default=None, help="Let the camera go with a body that travels.")
    @click.option(
        "--colour",
        type=click.Choice(COLOURS),
        help="What colours show in the film; own are those of the file, parts need a model, error needs --against.  "
        "[default: clay]",
    )
    @setting(
        "--scale",
        type=float,
        metavar="X",
        help="Error (diagonals), strain or bend (degrees) of the last colour.  [default: the largest]",
    )
    @setting(
        "--names",
        callback=_as_names,
        metavar="A,B,...",
        help="What stands above FILES in the film.  [default: names of several files]",
    )
    @wraps(command)
    def with_options(
        *args: Any,
        video: Path | None,
        size: tuple[int, int] | None,
        film_fps: float | None,
        seconds: float | None,
        turn: float | None,
        camera: tuple[float, float] | None,
        follow: bool | None,
        colour: Colour | None,
        scale: float | None,
        names: tuple[str, ...] | None,
        **settings: Any,
    ) -> None:
        filming = FilmOptions(video, size, film_fps, seconds, turn, camera, follow, colour, scale, names)
        command(*args, filming=filming, **settings)

    return with_options


def make_film(
    target: Path,
    files: Sequence[Path],
    options: FilmOptions,
    against: Path | None,
    reading: Mapping[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Make the film of `files`."""
    from mixseq.pictures.film import FilmSettings, film
    from mixseq.pictures.film_encoding import check_film, film_format
    from mixseq_io.files import replacing

    form = film_format(target)
    chosen = {
        name: value
        for name, value in vars(options).items()
        if name not in ("video", "names") and value is not None
    }
    settings = FilmSettings(**chosen)
    check_film(form, settings.size, settings.fps)
    claim(target)
    names = _names(files, options.names)
    with ExitStack() as stack, progress_bar(quiet) as progress:
        shown, original = scene_items(files, names, against, reading, stack)
        with replacing(target) as temporary:
            film(temporary, shown, settings, original, progress)
    announce(target)


def _names(files: Sequence[Path], names: tuple[str, ...] | None) -> Sequence[str]:
    """Return the captions of the files: by default their names, if there are several."""
    if names is None:
        return [file.name for file in files] if len(files) > 1 else [""]
    if len(names) != len(files):
        raise SettingsError(f"--names has {len(names)} names for {len(files)} files; give one for each")
    return names


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
    from mixseq.pictures.charts import picture_format
    from mixseq.pictures.models import check_settings, plot_model
    from mixseq_io.files import replacing

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
