"""Which frames of two sequences belong side by side."""

from __future__ import annotations

import numpy as np

from mixseq.errors import SettingsError
from mixseq.sequence import SequenceHeader


def common_frames(
    original: SequenceHeader, decoded: SequenceHeader, count: int
) -> tuple[list[int], list[int]]:
    """Pick up to ``count`` evenly spread frames of the original, and the decoded ones at the same times.

    Raises
    ------
    SettingsError
        If the sequences have no time in common.
    """
    nearest = np.abs(decoded.times[None] - original.times[:, None]).argmin(axis=1)
    gap = np.abs(decoded.times[nearest] - original.times)
    common = np.flatnonzero(gap < 1e-3 / max(original.fps, decoded.fps))
    if not common.size:
        raise SettingsError(
            "original and decoded have no frame at the same time; decode at the original's times"
        )
    count = min(count, len(common))
    chosen = common[np.arange(count) * len(common) // count]  # as of a loop: without the last one
    return chosen.tolist(), nearest[chosen].tolist()


def frames_between(original: SequenceHeader, decoded: SequenceHeader, frames: list[int]) -> dict[int, int]:
    """Find the decoded frames about half-way from original frames to the next ones.

    Returns
    -------
    dict
        Decoded frame by position in `frames`; only where there is one.
    """
    result = {}
    for position, frame in enumerate(frames):
        start, *later = original.times[frame : frame + 2]
        for end in later:
            away = np.abs(decoded.times - (start + end) / 2)
            if away.min() < 0.3 * (end - start):
                result[position] = int(away.argmin())
    return result
