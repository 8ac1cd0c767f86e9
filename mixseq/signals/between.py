"""Errors between frames: the distance of what is played from the motion that it was made of.

Programs interpolate what they play between its frames, each in its own way: joints by slerp, weights and points along
straight lines, compressed files by splines. The distance is measured at the quarters of all intervals between frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import chain, repeat
from typing import TypeVar

import numpy as np

from mixseq.errors import SettingsError
from mixseq.sequence.sequence import Frames, MeshSequence, is_rig
from mixseq.signals.decoding import Decodable
from mixseq.spaces.temporal import insert_midpoints
from mixseq.types import Float, FloatArray

Delivery = TypeVar("Delivery")

MAX_FRAME_FACTOR = 8
"""Largest number of frames of a delivery per frame of its motion."""

FRAME_BOUND_RATIO = 0.75
"""Ratio of the bound at frames to the bound between them. Keys take fewer bytes than accuracy at frames."""


def quarter_times(times: Float) -> Float:
    """Return the times ``(3 (T - 1),)`` at the quarters of the intervals between frames at times ``(T,)``."""
    return np.delete(insert_midpoints(insert_midpoints(times)), np.s_[::4])


def played_blocks(delivery: Decodable | Frames, times: Float) -> Iterator[FloatArray]:
    """Yield points ``(B, V, 3)`` at `quarter_times`, as programs play a delivery: plain points along straight lines."""
    if isinstance(delivery, Decodable):
        return delivery.blocks(times)
    return delivery.blocks_at(times) if is_rig(delivery) else straight_blocks(delivery.blocks(), times)


def straight_blocks(blocks: Iterable[FloatArray], times: Float) -> Iterator[FloatArray]:
    """Yield points ``(3, V, 3)`` at the quarters between frames of blocks ``(B, V, 3)``; a single frame is repeated."""
    frames = chain.from_iterable(blocks)
    before = next(frames)
    is_still = True
    for after in frames:
        yield np.stack([(1 - fraction) * before + fraction * after for fraction in (0.25, 0.5, 0.75)])
        before, is_still = after, False
    if is_still:
        yield from repeat(before[None], len(times))


def largest_distance(expected: Iterable[FloatArray], played: Iterable[FloatArray]) -> float:
    """Return the largest distance of a vertex in blocks of points ``(B, V, 3)``, which may have different sizes."""
    pairs = zip(chain.from_iterable(expected), chain.from_iterable(played), strict=True)
    return max((float(np.sqrt(np.square(x - y).sum(axis=1).max())) for x, y in pairs), default=0.0)


def hold_between(
    motion: Decodable, frames: MeshSequence, bound: float, make: Callable[[MeshSequence, float], tuple[Delivery, float]]
) -> Delivery:
    """Make a delivery of more and more frames, until its error between frames is at most `bound` diagonals.

    `make` takes the frames and their bound, and returns a delivery and its error between frames.
    """
    least, factor = np.inf, 1
    while factor <= MAX_FRAME_FACTOR:
        delivery, error = make(frames, FRAME_BOUND_RATIO * bound)
        if error <= bound:
            return delivery
        least, factor = min(least, error), 2 * factor
        frames = motion.sample(insert_midpoints(frames.times), 2 * frames.fps)
    raise SettingsError(
        f"between frames, {least:.2g} diagonals can be reached with up to {MAX_FRAME_FACTOR} times the frames, not "
        f"{bound:g}; allow more (--max-error), or leave out --between-frames"
    )
