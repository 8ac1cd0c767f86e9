"""H.264 in MP4 by the program ffmpeg, with raw frames through a pipe.

One thread and no metadata, so that equal films are equal files on any number of cores.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryFile

from mixseq.errors import MissingExtraError, OutputError
from mixseq.plots.raster import Picture

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
