"""Implement the command ``mixseq compare``."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli import options
from mixseq.cli.files import at_times_of, between_row, check_options, counted, is_model, options_of
from mixseq.cli.group import length_text, print_json, print_table, progress_bar, say
from mixseq.cli.options import argument, option
from mixseq.errors import MixseqWarning
from mixseq.sequence.frame_rates import FRAME_ROUNDING, format_frame, time_to_number

if TYPE_CHECKING:
    from mixseq.metrics import Comparison
    from mixseq.runtime.low_memory import Statistics
    from mixseq.sequence.header import SequenceHeader


@options.command(
    "compare",
    "mixseq compare walk.usdc decoded.usdc",
    "mixseq compare walk.usdc walk.h5 --json",
    reference=argument(),
    other=argument(),
    between_frames=option(
        "--between-frames",
        "Also measure OTHER between its frames, as it is played; fits a model of REFERENCE if it has only points.",
    ),
)
def command(
    reference: Path, other: Path, between_frames: bool, as_json: bool, reading: dict[str, Any], quiet: bool
) -> None:
    """Measure how far a sequence is from a reference.

    Both files are sequences or models of one mesh. If OTHER has more frames, only its frames at the times of REFERENCE
    are compared. Distances are fractions of the diagonal of the reference's bounding box.
    """
    from mixseq.sequence.sequence import LazyFrames

    reference_options, other_options = options_of(reference, reading), options_of(other, reading)
    check_options((reference, other), reading, f"neither {reference} nor {other} is")
    with (
        progress_bar(quiet) as progress,
        mixseq.open_sequence(reference, **reference_options) as a,
        mixseq.open_sequence(other, **other_options) as b,
    ):
        _warn_of_axes(reference, a.header, other, b.header)
        shared = at_times_of(a, b)
        count = a.header.frame_count
        frames = LazyFrames(a.header, lambda size: counted(a.blocks(size), count, "comparing frames", progress))
        result = mixseq.compare(frames, shared)
        error = None
        if between_frames:
            source, delivery = (mixseq.load(x) if is_model(x) else y for x, y in ((reference, a), (other, b)))
            error = mixseq.measure_between(source, delivery, progress)
    if as_json:
        number = time_to_number(result.worst_time, a.header.fps)
        left_out = b.header.frame_count - result.frames
        print_json(
            {"reference": str(reference), "other": str(other), "left_out": left_out}
            | result.as_dict()
            | {"worst_number": number, "between_error": error}
        )
    elif not quiet:
        if shared is not b:
            say(f"compared at the {result.frames} times that {other} shares, out of {b.header.frame_count}")
        diagonal = result.diagonal * a.header.metres_per_unit
        print_table([*_rows(result, a.header), *between_row(error, diagonal)])


def _warn_of_axes(reference: Path, a: SequenceHeader, other: Path, b: SequenceHeader) -> None:
    """Warn if up axes or units differ, as points are compared without conversion."""
    if a.up_axis != b.up_axis or not math.isclose(a.metres_per_unit, b.metres_per_unit, rel_tol=1e-6):
        first, second = (f"{each.up_axis} up and units of {each.metres_per_unit:g} m" for each in (a, b))
        warnings.warn(
            f"{reference} has {first}, {other} has {second}; points are compared as they are",
            MixseqWarning,
            stacklevel=2,
        )


def _rows(result: Comparison, header: SequenceHeader) -> list[tuple[str, str]]:
    volume, diagonal = result.volume, result.diagonal * header.metres_per_unit
    difference = result.max_time_difference
    times = [("times", f"differ by up to {difference:.2g} s ({difference * header.fps:.2g} frames)")]
    return [
        ("verdict", _verdict(result, header)),
        ("compared", f"{result.frames:,} frames of {result.vertices:,} vertices"),
        *(times if difference * header.fps > FRAME_ROUNDING else []),
        ("KG error", f"{result.kg_percent:.4g} %"),
        ("rms error", length_text(result.rms_error, diagonal)),
        ("max error", length_text(result.max_error, diagonal)),
        ("worst frame", f"{format_frame(result.worst_time, header.fps)} at {result.worst_time:g} s"),
        ("edge strain", _statistics(result.edge_strain, " %", 100)),
        ("dihedral error", _statistics(result.dihedral_degrees, " degrees")),
        ("volume error", f"{volume.mean:.4g} mean, {volume.max:.4g} max" if volume else "no volume"),
    ]


def _verdict(result: Comparison, header: SequenceHeader) -> str:
    """Say whether two sequences are equal but for rounding, or differ less than can be seen."""
    from mixseq.signals.detail import EXACT_TOLERANCE, VISUALLY_LOSSLESS_TOLERANCE

    if result.max_error <= EXACT_TOLERANCE:
        return "equal, but for rounding"
    if result.max_error <= VISUALLY_LOSSLESS_TOLERANCE:
        return "no visible difference: less than half a pixel where the mesh fills 1000"
    return f"visibly different, most in frame {format_frame(result.worst_time, header.fps)}"


def _statistics(values: Statistics, unit: str, factor: float = 1) -> str:
    skipped = f" ({values.skipped:,} not defined)" if values.skipped else ""
    rms, p999, most = (f"{factor * value:.4g}{unit}" for value in (values.rms, values.p999, values.max))
    return f"{rms} rms, {p999} at 99.9 %, {most} max{skipped}"
