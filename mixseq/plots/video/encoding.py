"""Encoding of films: WebP and GIF by Pillow, MP4 by ffmpeg.

Frames are drawn while they are encoded. Pillow keeps the encoded WebP, and one byte per pixel of all GIF frames, in
memory. Encoders run on one thread, so that equal films are equal files.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, Literal, get_args

import numpy as np

from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.plots.raster import PAPER, Picture
from mixseq.plots.video.ffmpeg import find_ffmpeg, write_mp4

FilmFormat = Literal["mp4", "gif", "webp"]
FILM_FORMATS: tuple[FilmFormat, ...] = get_args(FilmFormat)

Draw = Callable[[Iterable[int]], Iterator[Picture]]
"""From frame numbers to pictures ``(H, W, 3)`` in their order."""

SMALLEST, LARGEST = 64, 8192
"""Sides of a film, in pixels."""

WEBP_QUALITY = 80
"""WebP quality, of 100."""

WEBP_EFFORT = 3
"""WebP effort, from 0 (fast) to 6 (small)."""

WEBP_KEYFRAME_DISTANCES = 24, 48
"""Smallest and largest number of frames from one keyframe to the next."""

GIF_PALETTE_FRAMES = 6
"""Number of frames, evenly spaced, whose colours make the palette of a GIF."""

FASTEST_GIF = 50.0
"""Largest GIF frame rate, in 1/s: delays are in hundredths of seconds, and players slow down delays below two."""

LONGEST_GIF = 655.0
"""Longest duration of one GIF picture, which may cover all frames, in seconds."""


def film_format(target: str | PathLike[str]) -> FilmFormat:
    """Return a film's format from its file's extension."""
    extension = Path(target).suffix.lower().removeprefix(".")
    for known in FILM_FORMATS:
        if extension == known:
            return known
    raise OutputError(f"{target}: films are MP4, GIF or WebP files; end the name in .mp4, .gif or .webp")


def check_film(form: FilmFormat, size: tuple[int, int], fps: float | None = None) -> None:
    """Raise errors for limits of a format or of this machine, before the work."""
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
    modules = pillow_module("features").get_supported_modules()
    if form == "webp" and "webp" not in modules:
        raise MissingExtraError(
            "Pillow is installed without its WebP encoder; get one with: pip install 'pillow>=11.3', or write a .gif"
        )
    if form == "mp4":
        find_ffmpeg()


def encode_film(target: Path, form: FilmFormat, draw: Draw, count: int, fps: float) -> None:
    """Write frames as they are drawn; the file is replaced when all are written."""
    target = target.resolve()  # a symbolic link is followed, not replaced
    with TemporaryDirectory(prefix=target.name, dir=target.parent) as folder:
        temporary = Path(folder, target.name)
        if form == "mp4":
            write_mp4(temporary, draw(range(count)), fps)
        else:
            with temporary.open("wb") as file:
                if form == "webp":
                    _write_webp(file, draw(range(count)), count, fps)
                else:
                    _write_gif(file, draw, count, fps)
        temporary.replace(target)


def _write_webp(file: IO[bytes], pictures: Iterator[Picture], count: int, fps: float) -> None:
    frames = map(pillow_module("Image").fromarray, pictures)
    least, most = WEBP_KEYFRAME_DISTANCES
    next(frames).save(
        file,
        "WEBP",
        save_all=True,
        append_images=[_Reel(frames, count - 1)],
        duration=1000 / fps,
        loop=0,
        quality=WEBP_QUALITY,
        method=WEBP_EFFORT,
        kmin=least,
        kmax=most,
    )


class _Reel:
    """An animation for Pillow whose frames are drawn when they are sought, to save memory."""

    def __init__(self, frames: Iterator[Any], count: int) -> None:
        self.n_frames = count
        self._frames = frames
        self._shown: Any = None

    def seek(self, frame: int) -> None:
        self._shown = next(self._frames)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._shown, name)


def _write_gif(file: IO[bytes], draw: Draw, count: int, fps: float) -> None:
    """Write frames as an endless GIF with one palette, without dithering, which would flicker."""
    if count > LONGEST_GIF * fps:
        raise SettingsError(
            f"the film takes {count / fps:g} s; GIF has at most {LONGEST_GIF:g} s, write .mp4 or .webp"
        )
    image = pillow_module("Image")
    sampled = sorted({number * count // GIF_PALETTE_FRAMES for number in range(GIF_PALETTE_FRAMES)})
    pixels = np.concatenate([picture.reshape(-1, 3) for picture in draw(sampled)])
    counts, colours = zip(*image.fromarray(pixels[None]).getcolors(len(pixels)), strict=True)
    # weighted by the root of their counts: neither small parts nor soft shadows lose their colours
    weighted = np.repeat(np.array(colours, np.uint8), np.ceil(np.sqrt(counts)).astype(np.int64), axis=0)
    chosen = image.fromarray(weighted[None]).quantize(255).getpalette()
    palette = image.new("P", (1, 1))
    palette.putpalette([*chosen, PAPER, PAPER, PAPER])

    def quantized(picture: Picture) -> Any:
        frame = image.fromarray(picture).quantize(palette=palette, dither=image.Dither.NONE)
        # the nearest colour is approximate, but paper stays white
        frame.paste(len(chosen) // 3, mask=image.fromarray((picture == PAPER).all(axis=2)))
        return frame

    frames = map(quantized, draw(range(count)))
    ends = [10 * round(100 * frame / fps) for frame in range(count + 1)]
    durations = np.diff(ends).tolist()
    next(frames).save(file, "GIF", save_all=True, append_images=frames, duration=durations, loop=0)


def pillow_module(name: str) -> Any:
    """Import a module of Pillow on first use."""
    try:
        return import_module(f"PIL.{name}")
    except ImportError as error:
        raise MissingExtraError("films need Pillow; get it with: pip install 'mixseq[plot]'") from error
