"""Frames of a film as a file: GIF, WebP, and H.264 or AV1 in MP4.

Pillow has the encoders, but for H.264, which ffmpeg has if it is installed; all of them run on one thread. Pillow's
take frames one by one, as those of an opened file, from a `reel`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
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

WEBP_QUALITY = 80
"""Out of 100."""

WEBP_EFFORT = 3
"""From 0, fast, to 6, small."""

BETWEEN_KEYS = 24, 48
"""So many frames are between those that need none before them, at least and at most."""

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
    from mixseq.plots.video.h264 import find_ffmpeg

    if form != "gif" and not (form == "mp4" and find_ffmpeg()):
        encoder = "avif" if form == "mp4" else form
        if encoder not in features.get_supported_modules():
            raise MissingExtraError(
                f"Pillow is installed without its {encoder.upper()} encoder; get one with: pip install 'pillow>=11.3', "
                f"{'or install ffmpeg, ' if form == 'mp4' else ''}or write a .gif"
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
    from mixseq.plots.video import av1, gif, h264

    if form == "gif":
        gif.write_gif(target, draw, count, fps)
    elif form == "webp":
        write_webp(target, draw, count, fps)
    elif program := h264.find_ffmpeg():
        h264.write_h264(target, draw, count, fps, program)
    else:
        av1.write_av1(target, draw, count, fps)


def write_webp(target: Path, draw: Draw, count: int, fps: float) -> None:
    """Write frames as a WebP that plays for ever; parameters as those of `encode_film`."""
    least, most = BETWEEN_KEYS
    reel(draw(range(count)), count).save(
        target,
        "WEBP",
        save_all=True,
        duration=1000 / fps,
        loop=0,
        quality=WEBP_QUALITY,
        method=WEBP_EFFORT,
        kmin=least,
        kmax=most,
    )


def reel(pictures: Iterator[Picture], count: int) -> Any:
    """Return an image of `count` frames that takes each from `pictures` when it is sought; there is no way back.

    Raises
    ------
    StopIteration
        If there are no pictures.
    """
    return _reel_class()(pictures, count)


@lru_cache(maxsize=1)
def _reel_class() -> Any:
    """Return the class, which can only be made where Pillow is."""
    image = pillow_module("Image")
    base: Any = image.Image

    class Reel(base):  # type: ignore[misc]
        is_animated = True

        def __init__(self, pictures: Iterator[Picture], count: int) -> None:
            super().__init__()
            self.n_frames = count
            self._pictures = pictures
            self._frame = -1
            self.seek(0)

        def tell(self) -> int:
            return self._frame

        def seek(self, frame: int) -> None:
            if frame >= self.n_frames:
                raise EOFError
            while self._frame < frame:
                picture = image.fromarray(next(self._pictures))
                self.im, self._mode, self._size = picture.im, picture.mode, picture.size
                self._frame += 1

    return Reel


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
