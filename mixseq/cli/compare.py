"""``mixseq compare``."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.files import counted, options_of
from mixseq.cli.group import print_json, print_table, progress_bar, say
from mixseq.cli.options import (
    FILE,
    CommandWithSettings,
    chosen_blocks,
    examples,
    json_option,
    quiet_option,
    reader_options,
)
from mixseq.errors import MixseqWarning, SettingsError
from mixseq.sequence.frame_rates import frame_text, number_at

if TYPE_CHECKING:
    from mixseq.metrics import Comparison
    from mixseq.runtime.low_memory import Statistics
    from mixseq.runtime.progress import Progress
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import Frames
    from mixseq.types import FloatArray


@click.command(
    "compare",
    cls=CommandWithSettings,
    epilog=examples("mixseq compare walk.usdc decoded.usdc", "mixseq compare walk.usdc walk.h5 --json"),
)
@click.argument("reference", type=FILE)
@click.argument("other", type=FILE)
@json_option
@reader_options
@quiet_option
def command(reference: Path, other: Path, as_json: bool, reading: dict[str, Any], quiet: bool) -> None:
    """Measure how far a sequence is from a reference.

    Both are sequences or models of one mesh. If OTHER has more frames, those at the times of REFERENCE are
    compared. Distances are fractions of the diagonal of the reference's bounding box.
    """
    ours, theirs = options_of(reference, reading), options_of(other, reading)
    for name in reading.keys() - ours.keys() - theirs.keys():
        raise SettingsError(f"neither {reference} nor {other} is read with an option {name!r}")
    with (
        progress_bar(quiet) as progress,
        mixseq.open_sequence(reference, **ours) as a,
        mixseq.open_sequence(other, **theirs) as b,
    ):
        _warn_of_axes(reference, a.header, other, b.header)
        shared = at_times_of(a, b)
        result = mixseq.compare(_Counted(a, progress), shared)
    if as_json:
        number = number_at(result.worst_time, a.header.fps)
        left_out = b.header.frame_count - result.frames
        print_json(
            {"reference": str(reference), "other": str(other), "left_out": left_out}
            | result.as_dict()
            | {"worst_number": number}
        )
    elif not quiet:
        if shared is not b:
            there = b.header.frame_count
            say(f"compared at the {result.frames} times that {other} shares, out of {there}")
        print_table(_rows(result, a.header.fps))


def at_times_of(a: Frames, b: Frames) -> Frames:
    """Return b at the times of a, if b has more frames and those among them; else b itself."""
    from mixseq.metrics import shared_frames

    more = b.header.frame_count > a.header.frame_count
    frames = shared_frames(a.header, b.header) if more else None
    return b if frames is None else _Some(b, sorted(set(frames.tolist())))


@dataclass(frozen=True)
class _Some:
    """Some frames of a sequence."""

    frames: Frames
    indices: list[int]

    @property
    def header(self) -> SequenceHeader:
        """Mesh and times."""
        whole = self.frames.header
        return whole.with_times(whole.times[self.indices])

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over the chosen frames."""
        return chosen_blocks(self.frames.blocks(size), self.indices)


@dataclass(frozen=True)
class _Counted:
    """A sequence that reports the number of frames read."""

    frames: Frames
    progress: Progress

    @property
    def header(self) -> SequenceHeader:
        """Mesh and times."""
        return self.frames.header

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Iterate over all frames."""
        count = self.frames.header.frame_count
        return counted(self.frames.blocks(size), count, "comparing frames", self.progress)


def _warn_of_axes(reference: Path, a: SequenceHeader, other: Path, b: SequenceHeader) -> None:
    """Warn of different up axes and units: points are compared as they are."""
    if a.up_axis != b.up_axis or not math.isclose(a.metres_per_unit, b.metres_per_unit, rel_tol=1e-6):
        first, second = (f"{each.up_axis} up and units of {each.metres_per_unit:g} m" for each in (a, b))
        warnings.warn(
            f"{reference} has {first}, {other} has {second}; points are compared as they are",
            MixseqWarning,
            stacklevel=2,
        )


def _rows(result: Comparison, fps: float) -> list[tuple[str, str]]:
    volume = result.volume
    return [
        ("compared", f"{result.frames:,} frames of {result.vertices:,} vertices"),
        ("KG error", f"{result.kg_percent:.4g} %"),
        ("rms error", f"{result.rms_error:.4g} diagonals"),
        ("max error", f"{result.max_error:.4g} diagonals"),
        ("worst frame", f"{frame_text(result.worst_time, fps)} at {result.worst_time:g} s"),
        ("edge strain", _statistics(result.edge_strain, " %", 100)),
        ("dihedral error", _statistics(result.dihedral_degrees, " degrees")),
        ("volume error", f"{volume.mean:.4g} mean, {volume.max:.4g} max" if volume else "no volume"),
    ]


def _statistics(values: Statistics, unit: str, factor: float = 1) -> str:
    skipped = f" ({values.skipped:,} not defined)" if values.skipped else ""
    rms, p999, most = (f"{factor * value:.4g}{unit}" for value in (values.rms, values.p999, values.max))
    return f"{rms} rms, {p999} at 99.9 %, {most} max{skipped}"
