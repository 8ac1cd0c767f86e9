"""The part of ``mixseq plot`` that makes films."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click

from mixseq.choices import COLOURS, Colour
from mixseq.cli.camera import camera_option
from mixseq.cli.console import announce, progress_bar
from mixseq.cli.files import scene_items
from mixseq.cli.options import FILE
from mixseq.cli.overwriting import Claim
from mixseq.cli.settings import setting
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
    from mixseq.plots.video import FilmSettings, check_film, film, film_format
    from mixseq_io.atomic import replacing

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
