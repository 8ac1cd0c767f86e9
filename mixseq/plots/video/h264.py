"""H.264 in MP4, by the program ffmpeg: drawn frames go to it through a pipe.

It is used where it is on the PATH with the encoder libx264: H.264 plays everywhere, AV1 does not. On one thread and
without metadata, so that equal films are equal files on any number of cores.
"""

from __future__ import annotations

import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from mixseq.errors import OutputError
from mixseq.plots.video.encoding import Draw
from mixseq.plots.video.mp4 import frame_rate

QUALITY = 18
"""Constant rate factor: 0 is lossless, 51 the worst; from about 18 on nobody sees a difference."""

SECONDS = 2.0
"""From one frame that needs none before it to the next, at most: where players can jump to."""

_COLOURS = ("-colorspace", "bt709", "-color_primaries", "bt709", "-color_trc", "bt709", "-color_range", "tv")


def find_ffmpeg() -> str | None:
    """Return the path of an ffmpeg that encodes H.264, if there is one."""
    program = shutil.which("ffmpeg")
    if program is None:
        return None
    try:
        known = subprocess.run([program, "-hide_banner", "-encoders"], capture_output=True, timeout=30)
    except (OSError, subprocess.SubprocessError):
        return None
    return program if b"libx264 " in known.stdout else None


def write_h264(target: Path, draw: Draw, count: int, fps: float, program: str) -> None:
    """Write frames as an MP4; parameters as those of `encode_film`, and the path of ffmpeg.

    Raises
    ------
    OutputError
        If ffmpeg cannot write it.
    """
    pictures = draw(range(count))
    first = next(pictures)
    height, width = first.shape[:2]
    rate = frame_rate(fps)
    # fmt: off
    command = [
        program, "-v", "error", "-y",
        "-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}", "-framerate", str(rate),
        "-i", "pipe:0",
        "-vf", "scale=out_color_matrix=bt709:out_range=tv", "-pix_fmt", "yuv420p", *_COLOURS,
        "-c:v", "libx264", "-crf", str(QUALITY), "-g", str(max(1, round(SECONDS * rate))), "-threads", "1",
        "-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart",
        "-f", "mp4", str(target),
    ]
    # fmt: on
    with TemporaryFile() as said:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=said) as running:
            assert running.stdin is not None
            try:
                running.stdin.write(first.tobytes())
                for picture in pictures:
                    running.stdin.write(picture.tobytes())
                running.stdin.close()
            except BaseException as error:
                ended = isinstance(error, BrokenPipeError)  # by itself, and it said why
                if not ended:
                    running.kill()
                with suppress(BrokenPipeError):
                    running.stdin.close()
                if not ended:
                    raise
        if running.returncode:
            said.seek(0)
            why = said.read().decode(errors="replace").strip().splitlines() or ["no reason given"]
            raise OutputError(f"ffmpeg cannot write the film: {why[-1]}")
