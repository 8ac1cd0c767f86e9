"""Frames chosen by their numbers in the time line: ``1005-1010``, ``1001,1005-1010``."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from mixseq.cli.options import Command
from mixseq.errors import SettingsError
from mixseq.frame_numbers import NEAR, frames_text, number_at, number_text, time_of
from mixseq.frame_rates import rate_text

if TYPE_CHECKING:
    from mixseq.arrays import FloatArray
    from mixseq.sequence import SequenceHeader

_RANGE = re.compile(r"\s*(-?\d+)(?:-(-?\d+))?\s*")


@dataclass(frozen=True)
class FrameChoice:
    """Frames by their numbers."""

    ranges: tuple[tuple[int, int], ...]  # first and last number of every range; equal for a single frame

    def indices(self, header: SequenceHeader) -> list[int]:
        """Return the indices of the chosen frames of a sequence, in order."""
        import numpy as np

        numbers = header.times * header.fps
        chosen = np.zeros(header.frame_count, dtype=bool)
        for first, last in self.ranges:
            self._check(header, first, last)
            within = (numbers >= first - NEAR) & (numbers <= last + NEAR)
            if not within.any():
                header.index_of(first)
            chosen |= within
        return [int(index) for index in np.flatnonzero(chosen)]

    def span(self, header: SequenceHeader) -> tuple[float, float]:
        """Return the times of the first and last chosen frame, in seconds."""
        if len(self.ranges) > 1:
            raise SettingsError("--frames is one range here, such as 1005-1010")
        ((first, last),) = self.ranges
        self._check(header, first, last)
        return time_of(first, header.fps), time_of(last, header.fps)

    def _check(self, header: SequenceHeader, *numbers: int) -> None:
        low, high = header.times[0] * header.fps - NEAR, header.times[-1] * header.fps + NEAR
        for number in numbers:
            if not low <= number <= high:
                raise SettingsError(
                    f"there is no frame {number_text(number)}; frames are {header.frame_numbers}"
                )


def _as_choice(context: click.Context, option: click.Parameter, value: str | None) -> FrameChoice | None:
    if value is None:
        return None
    found = [_RANGE.fullmatch(part) for part in value.split(",")]
    ranges = [(int(each[1]), int(each[2] or each[1])) for each in found if each]
    if len(ranges) < len(found) or any(first > last for first, last in ranges):
        raise click.BadParameter(f"{value!r} is not a range of frames such as 1005-1010, or a list of them")
    return FrameChoice(tuple(ranges))


def frames_option(help_text: str, metavar: str = "A-B") -> Callable[[Command], Command]:
    """Return the option ``--frames``; the command gets ``frames``, a `FrameChoice` or None."""
    return click.option("--frames", callback=_as_choice, metavar=metavar, help=help_text)


def chosen_blocks(blocks: Iterable[FloatArray], indices: Iterable[int]) -> Iterator[FloatArray]:
    """Yield the chosen frames of a sequence's blocks, in order; later ones are not read."""
    left, first = sorted(indices), 0
    for block in blocks:
        here = [index - first for index in left if index < first + len(block)]
        if here:
            yield block[here]
        left, first = left[len(here) :], first + len(block)
        if not left:
            return


def time_rows(header: SequenceHeader) -> list[tuple[str, str]]:
    """Return table rows about the written frames."""
    first, last = (float(time) for time in header.times[[0, -1]])
    numbers = (number_at(time, header.fps) for time in (first, last))
    return [
        ("frames", frames_text(header.frame_count, *numbers)),
        ("time", f"{first:g} to {last:g} s at {rate_text(header.fps)} frames per second"),
    ]
