"""Encode films: WebP and GIF with Pillow, H.264 in MP4 with the program ffmpeg, which gets raw frames through a pipe.

Frames are drawn while the film is encoded. Pillow keeps the encoded WebP, or all GIF frames with one byte per pixel, in
memory. Encoders run on one thread and write no metadata, so that equal films give identical files on any machine.
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
from mixseq.pictures.raster import BACKGROUND_GREY, Picture

FilmFormat = Literal["mp4", "gif", "webp"]
FILM_FORMATS: tuple[FilmFormat, ...] = get_args(FilmFormat)

Draw = Callable[[Iterable[int]], Iterator[Picture]]
"""Function from frame numbers to pictures ``(H, W, 3)``, in the order of the numbers."""

MIN_SIDE, MAX_SIDE = 64, 8192
"""Limits of the width and height of a film, in pixels."""

MAX_GIF_FPS = 50.0
"""Largest frame rate of GIF, whose delays are in 1/100 s; players slow down films with delays below 2/100 s."""

MAX_GIF_SECONDS = 655.0
"""Longest delay of a GIF frame; a film without movement is a single frame with its duration as delay."""


def film_format(target: str | PathLike[str]) -> FilmFormat:
    """Return the format of a film by the extension of its file."""
    extension = Path(target).suffix.lower().removeprefix(".")
    for known in FILM_FORMATS:
        if extension == known:
            return known
    raise OutputError(f"{target}: films are MP4, GIF or WebP files; end the name in .mp4, .gif or .webp")


def check_film(file_format: FilmFormat, size: tuple[int, int], fps: float | None = None) -> None:
    """Raise an error if the format does not allow the size or frame rate, or if the encoder is missing."""
    for side in size:
        if not MIN_SIDE <= side <= MAX_SIDE:
            raise SettingsError(
                f"the size is {size[0]}x{size[1]}; films have {MIN_SIDE} to {MAX_SIDE} pixels on each side"
            )
        if file_format == "mp4" and side % 2:
            raise SettingsError(f"the size is {size[0]}x{size[1]}; MP4 needs even numbers, {side} could be {side + 1}")
    if file_format == "gif" and fps is not None and fps > MAX_GIF_FPS:
        raise SettingsError(
            f"{fps:g} frames per second are too many for GIF, which has at most {MAX_GIF_FPS:g}; give a lower rate, "
            "or write .mp4 or .webp"
        )
    modules = import_pillow("features").get_supported_modules()
    if file_format == "webp" and "webp" not in modules:
        raise MissingExtraError(
            "Pillow is installed without WebP; get it with: pip install 'pillow>=11.3', or write a .gif"
        )
    if file_format == "mp4":
        find_ffmpeg()


def encode_film(target: Path, file_format: FilmFormat, draw: Draw, count: int, fps: float) -> None:
    """Draw and write all frames of a film; an old file is replaced when the new one is complete."""
    if target.exists() and not target.is_file():
        raise OutputError(f"{target} is no regular file, which would be replaced; give another name")
    target = target.resolve()  # follows a symbolic link instead of replacing it
    with TemporaryDirectory(prefix=target.name, dir=target.parent) as folder:
        temporary = Path(folder, target.name)
        if file_format == "mp4":
            write_mp4(temporary, draw(range(count)), fps)
        else:
            with temporary.open("wb") as file:
                if file_format == "webp":
                    _write_webp(file, draw(range(count)), count, fps)
                else:
                    _write_gif(file, draw, count, fps)
        temporary.replace(target)


_FFMPEG_CURE = "install it with libx264 (apt, brew or winget install ffmpeg), or write .webp or .gif instead"


def find_ffmpeg() -> str:
    """Return the path of an ffmpeg program that can encode H.264."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise MissingExtraError(f"MP4 needs ffmpeg, which is not on the PATH; {_FFMPEG_CURE}")
    try:
        encoders = subprocess.run([program, "-hide_banner", "-encoders"], capture_output=True, timeout=30)
    except (OSError, subprocess.SubprocessError) as error:
        raise MissingExtraError(f"MP4 needs ffmpeg, and {program} does not run: {error}; {_FFMPEG_CURE}") from error
    if b" libx264 " not in encoders.stdout:
        raise MissingExtraError(f"MP4 needs the encoder libx264, and {program} has none; {_FFMPEG_CURE}")
    return program


def write_mp4(target: Path, pictures: Iterator[Picture], fps: float) -> None:
    """Write frames as an MP4 file that players can start before the whole file is loaded."""
    program = find_ffmpeg()
    first = next(pictures)
    height, width = first.shape[:2]
    rate = frame_rate(fps)
    # fmt: off
    command = [
        program, "-v", "error", "-xerror", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}", "-framerate", str(rate),
        "-i", "pipe:0",
        "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p", "-colorspace", "bt709",
        "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv",
        "-c:v", "libx264", "-crf", "18", "-threads", "1",  # visually lossless, from 0 (lossless) to 51 (worst)
        "-g", str(max(1, round(2 * rate))),  # a keyframe every 2 seconds, to which players can seek
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
                if not isinstance(error, BrokenPipeError):  # the log contains the cause of a broken pipe
                    raise
            finally:
                with suppress(BrokenPipeError):
                    encoder.stdin.close()
        if encoder.returncode:
            log.seek(0)
            lines = log.read().decode(errors="replace").strip().splitlines() or ["it gave no reason"]
            raise OutputError(f"ffmpeg cannot write the film: {lines[0]}")


def frame_rate(fps: float) -> Fraction:
    """Return a frame rate as a fraction, such as 24000/1001 for 23.976."""
    return Fraction(fps).limit_denominator(1001) or Fraction(1, max(1, round(1 / fps)))


GIF_PALETTE_FRAMES = 6
"""Number of evenly spaced frames used to choose the palette of a GIF."""


def _write_webp(file: IO[bytes], pictures: Iterator[Picture], count: int, fps: float) -> None:
    frames = map(import_pillow("Image").fromarray, pictures)
    next(frames).save(
        file,
        "WEBP",
        save_all=True,
        append_images=[_LazyFrames(frames, count - 1)],
        duration=1000 / fps,
        loop=0,
        quality=80,
        method=3,  # effort, from 0 (fast) to 6 (small files)
        kmin=24,  # frames between keyframes
        kmax=48,
    )


class _LazyFrames:
    """A multi-frame image for Pillow that draws a frame only when Pillow seeks it, to save memory."""

    def __init__(self, frames: Iterator[Any], count: int) -> None:
        self.n_frames = count
        self._frames = frames
        self._current: Any = None

    def seek(self, frame: int) -> None:
        self._current = next(self._frames)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._current, name)


def _write_gif(file: IO[bytes], draw: Draw, count: int, fps: float) -> None:
    """Write frames as a looping GIF with one palette; dithering is off, as it flickers."""
    if count > MAX_GIF_SECONDS * fps:
        raise SettingsError(
            f"the film takes {count / fps:g} s, a GIF at most {MAX_GIF_SECONDS:g} s; write .mp4 or .webp"
        )
    image = import_pillow("Image")
    sample_frames = sorted({number * count // GIF_PALETTE_FRAMES for number in range(GIF_PALETTE_FRAMES)})
    pixels = np.concatenate([picture.reshape(-1, 3) for picture in draw(sample_frames)])
    counts, colours = zip(*image.fromarray(pixels[None]).getcolors(len(pixels)), strict=True)
    # weight colours by the square roots of their counts, so that small parts and soft shadows keep their colours
    weighted = np.repeat(np.array(colours, np.uint8), np.ceil(np.sqrt(counts)).astype(np.int64), axis=0)
    palette_colours = image.fromarray(weighted[None]).quantize(255).getpalette()
    palette = image.new("P", (1, 1))
    palette.putpalette([*palette_colours, BACKGROUND_GREY, BACKGROUND_GREY, BACKGROUND_GREY])

    def quantize(picture: Picture) -> Any:
        frame = image.fromarray(picture).quantize(palette=palette, dither=image.Dither.NONE)
        # Pillow's search for nearest colours is approximate, so set the white background explicitly
        frame.paste(len(palette_colours) // 3, mask=image.fromarray((picture == BACKGROUND_GREY).all(axis=2)))
        return frame

    frames = map(quantize, draw(range(count)))
    ends = [10 * round(100 * frame / fps) for frame in range(count + 1)]
    durations = np.diff(ends).tolist()
    next(frames).save(file, "GIF", save_all=True, append_images=frames, duration=durations, loop=0)


def import_pillow(name: str) -> Any:
    """Import a module of Pillow when it is first needed."""
    try:
        return import_module(f"PIL.{name}")
    except ImportError as error:
        raise MissingExtraError("films need Pillow; get it with: pip install 'mixseq[plot]'") from error
