"""``mixseq plot``: draw pictures of models, or make films."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from mixseq.choices import COLOURS, PICTURES, PictureKind
from mixseq.cli import options
from mixseq.cli.files import Claim, load_or_fit, read_sequence, scene_items
from mixseq.cli.group import announce, in_diagonals, progress_bar
from mixseq.cli.options import FrameRate, Group, Setting, argument, flag, length, option, setting
from mixseq.errors import SettingsError


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise click.BadParameter(f"{text!r} is not a size such as 1280x720")
    return int(width), int(height)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(","))


_PICTURE_OPTIONS = ("kind", "frames", "tolerance")
_FILM_OPTIONS = ("size", "film_fps", "seconds", "turn", "follow", "colour", "scale", "names")


@options.command(
    "plot",
    "mixseq plot walk.h5 walk.png",
    "mixseq plot walk.h5 errors.png --kind error-vertices --against walk.usdc",
    "mixseq plot walk.h5 embedding.svg --kind embedding --frames 0,12,24,36",
    "mixseq plot --video walk.mp4 walk.usdc walk.h5 --set turn=360 --set seconds=8",
    "mixseq plot --video parts.gif walk.h5 --colour parts --size 640x360",
    files=argument(metavar="MODEL TARGET | --video FILM FILES...", nargs=-1),
    kind=option("--kind", "One picture only.  [default: all of them on one page]", type=click.Choice(PICTURES)),
    against=option("--against SEQUENCE", "The original in any format, to draw the errors of the model."),
    frames=options.frames(
        "Frames to number in the embedding, or to draw with the errors of their vertices.  [default: automatic]",
        metavar="N,N,...",
    ),
    tolerance=length(
        "--tolerance D", "Draw a line at this error, a fraction of the bounding box's diagonal, or 0.5mm."
    ),
    video=option(
        "--video FILE",
        "Make a film of FILES side by side, sequences or models: .webp, .gif, or .mp4, which needs ffmpeg.",
    ),
    names=setting(
        "--names A,B,...", "What stands above FILES in the film.  [default: names of several files]", type=_names
    ),
    filming=Group(
        option("--size WxH", "Pixels of the film.  [default: 1280x720]", type=_size),
        option(
            "--fps N",
            "Frames per second of the film; models are decoded at its times.  [default: those of the first file]",
            name="film_fps",
            type=FrameRate(),
        ),
        setting(
            "--seconds S",
            "Duration of the film; what is shorter starts again.  [default: that of the longest file]",
            type=float,
        ),
        setting("--turn DEGREES", "Let the camera go around in the film.", type=float),
        options.camera,
        flag("--follow", "Let the camera go with a body that travels.", cls=Setting),
        option(
            "--colour",
            "What colours show in the film; own are those of the file, parts need a model, error needs --against.  "
            "[default: clay]",
            type=click.Choice(COLOURS),
        ),
        setting(
            "--scale X",
            "Error (diagonals), strain or bend (degrees) of the last colour.  [default: the largest]",
            type=float,
        ),
    ),
)
def command(
    files: tuple[Path, ...],
    kind: PictureKind | None,
    against: Path | None,
    frames: options.FrameChoice | None,
    tolerance: float | str | None,
    scalar: Path | None,
    video: Path | None,
    names: tuple[str, ...] | None,
    filming: dict[str, Any],
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Draw a model: its signals, its parts, and its errors against the original. Or make a film.

    MODEL may be a sequence in any format, which is turned into a model first. TARGET is a PNG or an SVG file. Without
    --kind, the picture is a page with the time signal in its MDS embedding, its coefficients, the singular values,
    parts and joints, and with --against the errors per frame and per vertex.

    With --video, FILES are models or sequences in any format, which the film shows side by side. Drawing needs no
    graphics card, and the result does not depend on the number of threads.
    """
    if video is not None:
        options.refuse(*_PICTURE_OPTIONS, why="is about pictures; leave it out, or --video")
        if not files:
            raise click.UsageError("Missing argument 'FILES...'.", click.get_current_context())
        if scalar is not None:
            filming.setdefault("colour", "values")
        _make_film(video, files, names, filming, against, scalar, reading, claim, quiet)
        return
    options.refuse(*_FILM_OPTIONS, why="is about films; give --video as well, or leave it out")
    if len(files) < 2:
        missing = "TARGET" if files else "MODEL"
        raise click.UsageError(f"Missing argument '{missing}'.", click.get_current_context())
    if len(files) > 2:
        raise SettingsError(
            f"{files[2]} is one file too many; give MODEL and TARGET, or --video and any number of files"
        )
    source, target = files
    from mixseq.pictures.charts import picture_format
    from mixseq.pictures.models import check_settings, plot_model
    from mixseq_io.files import atomic_file
    from mixseq_io.npz import read_values

    picture_format(target)
    camera = filming.get("camera")
    numbers = None if frames is None else frames.ranges
    check_settings(kind, against is not None, numbers, tolerance is not None, camera, scalar is not None)
    if against is None and reading:
        raise SettingsError(
            "--prim, --animation, --input-fps, --mesh and --allow-gaps are for reading a sequence; give --against"
        )
    claim(target)
    from mixseq.sequence.sequence import LazyFrames

    with progress_bar(quiet) as progress:
        model = load_or_fit(source, progress)
        poses = LazyFrames(model.header, lambda size: model.blocks(model.times, size))
        original = None if against is None else read_sequence(against, reading, progress)
        with atomic_file(target) as temporary:
            plot_model(
                temporary,
                model,
                kind,
                against=original,
                frames=None if frames is None else frames.indices(model.header),
                tolerance=in_diagonals({"tolerance": tolerance}, poses, "tolerance")["tolerance"],
                camera=camera,
                values=None if scalar is None else read_values(scalar),
                progress=progress,
            )
    announce(target)


def _make_film(
    target: Path,
    files: Sequence[Path],
    names: tuple[str, ...] | None,
    filming: Mapping[str, Any],
    against: Path | None,
    scalar: Path | None,
    reading: Mapping[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Make a film of `files`; captions are by default the file names if there are several files."""
    from mixseq.pictures.film import FilmSettings, film
    from mixseq.pictures.film_encoding import check_film, film_format
    from mixseq_io.files import atomic_file

    form = film_format(target)
    settings = FilmSettings(**{name.removeprefix("film_"): value for name, value in filming.items()})
    check_film(form, settings.size, settings.fps)
    claim(target)
    if names is not None and len(names) != len(files):
        raise SettingsError(f"--names has {len(names)} names for {len(files)} files; give one for each")
    captions = names or ([file.name for file in files] if len(files) > 1 else [""])
    with ExitStack() as stack, progress_bar(quiet) as progress:
        shown, original = scene_items(files, captions, against, reading, stack, scalar)
        with atomic_file(target) as temporary:
            film(temporary, shown, settings, original, progress)
    announce(target)
