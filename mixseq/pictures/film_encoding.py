"""Encoding of films: WebP and GIF by Pillow, H.264 in MP4 by the program ffmpeg, with raw frames through a pipe.

Frames are drawn while they are encoded. Pillow keeps the encoded WebP, and one byte per pixel of all GIF frames, in
memory. Encoders run on one thread and write no metadata, so that equal films are equal files on any number of cores.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from fractions import Fraction
from importlib import import_module
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any, Literal, get_args

import numpy as np

from mixseq.errors import MissingExtraError, OutputError, SettingsError
from mixseq.pictures.raster import PAPER, Picture

FilmFormat = Literal["mp4", "gif", "webp"]
FILM_FORMATS: tuple[FilmFormat, ...] = get_args(FilmFormat)

Draw = Callable[[Iterable[int]], Iterator[Picture]]
"""From frame numbers to pictures ``(H, W, 3)`` in their order."""

SMALLEST, LARGEST = 64, 8192
"""Sides of a film, in pixels."""

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


CONSTANT_RATE_FACTOR = 18
"""Quality of H.264, from 0 (lossless) to 51; 18 looks like the original."""

KEYFRAME_SECONDS = 2.0
"""Largest distance of keyframes, to which players can jump, in seconds."""

_COLOURS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv")

_CURE = (
    "install one with libx264 (apt, brew or winget install ffmpeg), or write .webp or .gif, which need none"
)


def find_ffmpeg() -> str:
    """Return the path of an ffmpeg that encodes H.264."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise MissingExtraError(f"MP4 needs ffmpeg, and there is none on the PATH; {_CURE}")
    try:
        encoders = subprocess.run([program, "-hide_banner", "-encoders"], capture_output=True, timeout=30)
    except (OSError, subprocess.SubprocessError) as error:
        raise MissingExtraError(f"MP4 needs ffmpeg, and {program} does not run: {error}; {_CURE}") from error
    if b" libx264 " not in encoders.stdout:
        raise MissingExtraError(f"MP4 needs the encoder libx264, and {program} has none; {_CURE}")
    return program


def write_mp4(target: Path, pictures: Iterator[Picture], fps: float) -> None:
    """Write frames as an MP4 that plays while it is loaded."""
    program = find_ffmpeg()
    first = next(pictures)
    height, width = first.shape[:2]
    rate = frame_rate(fps)
    # fmt: off
    command = [
        program, "-v", "error", "-xerror", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}", "-framerate", str(rate),
        "-i", "pipe:0",
        "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p", *_COLOURS,
        "-c:v", "libx264", "-crf", str(CONSTANT_RATE_FACTOR), "-threads", "1",
        "-g", str(max(1, round(KEYFRAME_SECONDS * rate))),
        "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart",
        "-f", "mp4", str(target),
    ]
    # fmt: on
    with TemporaryFile() as log:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log) as encoder:
            assert encoder.stdin is not None
            try:
                encoder.stdin.write(first.tobytes())
                for picture in pictures:
                    encoder.stdin.write(picture.tobytes())
                encoder.stdin.close()
            except BaseException as error:
                encoder.kill()
                if not isinstance(error, BrokenPipeError):  # else it ended by itself, and its log says why
                    raise
            finally:
                with suppress(BrokenPipeError):
                    encoder.stdin.close()
        if encoder.returncode:
            log.seek(0)
            lines = log.read().decode(errors="replace").strip().splitlines() or ["no reason given"]
            raise OutputError(f"ffmpeg cannot write the film: {lines[0]}")


def frame_rate(fps: float) -> Fraction:
    """Return frames per second as a fraction, such as 24000/1001."""
    return Fraction(fps).limit_denominator(1001) or Fraction(1, max(1, round(1 / fps)))


WEBP_QUALITY = 80
"""WebP quality, of 100."""

WEBP_EFFORT = 3
"""WebP effort, from 0 (fast) to 6 (small)."""

WEBP_KEYFRAME_DISTANCES = 24, 48
"""Smallest and largest number of frames from one keyframe to the next."""

GIF_PALETTE_FRAMES = 6
"""Number of frames, evenly spaced, whose colours make the palette of a GIF."""


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
