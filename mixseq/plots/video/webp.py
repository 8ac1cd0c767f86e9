"""Animated WebP, by Pillow."""

from __future__ import annotations

from pathlib import Path

from mixseq.plots.video.encoding import Draw
from mixseq.plots.video.reel import reel

QUALITY = 80
"""Out of 100."""

EFFORT = 3
"""From 0, fast, to 6, small."""

BETWEEN_KEYS = 24, 48
"""So many frames are between those that need none before them, at least and at most."""


def write_webp(target: Path, draw: Draw, count: int, fps: float) -> None:
    """Write frames as a WebP that plays for ever; parameters as those of `encode_film`."""
    least, most = BETWEEN_KEYS
    reel(draw(range(count)), count).save(
        target,
        "WEBP",
        save_all=True,
        duration=1000 / fps,
        loop=0,
        quality=QUALITY,
        method=EFFORT,
        kmin=least,
        kmax=most,
    )
