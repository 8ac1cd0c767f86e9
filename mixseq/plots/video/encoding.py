"""Frames of a film as a file: GIF, WebP, or AV1 in MP4. Pillow has the encoders; all of them run on one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import Any, Literal, get_args

from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.plots.raster import Picture

FilmFormat = Literal["mp4", "gif", "webp"]
FILM_FORMATS: tuple[FilmFormat, ...] = get_args(FilmFormat)

Draw = Callable[[Iterable[int]], Iterator[Picture]]
"""Draws frames of a film, whose numbers it is given: pictures ``(H, W, 3)`` in their order."""

SMALLEST, LARGEST = 64, 8192
"""Pixels along a side of a film."""

FASTEST_GIF = 50.0
"""Frames per second: GIF counts in hundredths of seconds, and players slow down what is shorter than two of them."""


def film_format(target: str | PathLike[str]) -> FilmFormat:
    """Tell a film's format from its file's extension.

    Raises
    ------
    OutputError
        If it is none of `FILM_FORMATS`.
    """
    extension = Path(target).suffix.lower().removeprefix(".")
    for known in FILM_FORMATS:
        if extension == known:
            return known
    raise OutputError(f"{target}: films are MP4, GIF or WebP files; end the name in .mp4, .gif or .webp")


def check_film(form: FilmFormat, size: tuple[int, int], fps: float | None = None) -> None:
    """Refuse before the work what a format or this machine cannot do.

    Raises
    ------
    SettingsError
        If the size or the rate does not go with the format.
    MissingExtraError
        If Pillow or its encoder is not there.
    """
    for side in size:
        if not SMALLEST <= side <= LARGEST:
            raise SettingsError(
                f"the size is {size[0]}x{size[1]}; films have {SMALLEST} to {LARGEST} pixels on each side"
            )
        if form == "mp4" and side % 2:
            raise SettingsError(
                f"the size is {size[0]}x{size[1]}; MP4 needs even numbers, {side} could be {side + 1}"
            )
    if form == "gif" and fps is not None and fps > FASTEST_GIF:
        raise SettingsError(
            f"{fps:g} frames per second are too many for GIF, which has at most {FASTEST_GIF:g}; give a lower rate, "
            "or write .mp4 or .webp"
        )
    features = pillow_module("features")
    if form != "gif":
        encoder = "avif" if form == "mp4" else form
        if encoder not in features.get_supported_modules():
            raise MissingExtraError(
                f"Pillow is installed without its {encoder.upper()} encoder; get one with: pip install 'pillow>=11.3', "
                "or write a .gif"
            )


def encode_film(target: Path, form: FilmFormat, draw: Draw, count: int, fps: float) -> None:
    """Write frames as they are drawn.

    Parameters
    ----------
    target : Path
        The file.
    form : {"mp4", "gif", "webp"}
        Its format, whatever its name.
    draw : callable
        Draws the frames whose numbers it is given.
    count : int
        Number of frames, at least 2.
    fps : float
        Frames per second.
    """
    from mixseq.plots.video import av1, gif, webp

    encoders: dict[FilmFormat, Callable[[Path, Draw, int, float], None]] = {
        "mp4": av1.write_mp4,
        "gif": gif.write_gif,
        "webp": webp.write_webp,
    }
    encoders[form](target, draw, count, fps)


def pillow_module(name: str) -> Any:
    """Import a module of Pillow when it is needed.

    Raises
    ------
    MissingExtraError
        If Pillow is not installed.
    """
    try:
        return import_module(f"PIL.{name}")
    except ImportError as error:
        raise MissingExtraError("films need Pillow; get it with: pip install 'mixseq[plot]'") from error
