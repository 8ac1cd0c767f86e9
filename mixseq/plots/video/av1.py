"""AV1 in MP4: Pillow's encoder of animated AVIF [1]_ makes the frames, whose boxes are then those of an MP4.

An animated AVIF is a track of AV1 samples, as is an MP4; only what stands around it differs. Scenes of a few seconds at
most are encoded one after the other, so that no more than their frames are in memory, and players can jump to their
first frames.

References
----------
.. [1] AV1 Image File Format (AVIF), section 3: image sequences; AV1 Codec ISO Media File Format Binding.
"""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from itertools import islice
from pathlib import Path

from mixseq.plots.raster import Picture
from mixseq.plots.video.encoding import Draw, reel
from mixseq.plots.video.mp4 import VideoTrack, joined, read_track, write_track

SCENE = 2.0
"""Seconds from one frame that needs none before it to the next, at most."""

QUALITY = 85
"""Out of 100."""

SPEED = 8
"""From 0, small, to 10, fast."""


def write_av1(target: Path, draw: Draw, count: int, fps: float) -> None:
    """Write frames as an MP4; parameters as those of `encode_film`."""
    pictures = draw(range(count))
    scenes = [_encoded(pictures, length) for length in scene_lengths(count, fps)]
    with target.open("wb") as file:
        write_track(file, joined(scenes), fps)


def scene_lengths(count: int, fps: float) -> list[int]:
    """Divide frames into scenes of equal lengths, at least 2: a scene of one frame would be a still picture.

    Examples
    --------
    >>> scene_lengths(100, 24), scene_lengths(2, 0.1)
    ([33, 33, 34], [2])
    """
    scenes = max(1, min(-(-count // max(1, round(SCENE * fps))), count // 2))
    return [count * (k + 1) // scenes - count * k // scenes for k in range(scenes)]


def _encoded(pictures: Iterator[Picture], length: int) -> VideoTrack:
    """Encode the next frames as a scene."""
    file = BytesIO()
    reel(islice(pictures, length), length).save(
        file,
        "AVIF",
        save_all=True,
        duration=1,
        quality=QUALITY,
        speed=SPEED,
        codec="aom",
        subsampling="4:2:0",
        range="limited",  # as players expect of films
        max_threads=1,  # with more, other bytes
        autotiling=False,
    )
    return read_track(file.getvalue())
