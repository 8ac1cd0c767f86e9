"""``mixseq compare``."""

from __future__ import annotations

import math
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.console import print_json, print_table, progress_bar
from mixseq.cli.files import read_sequence
from mixseq.cli.options import FILE, examples, json_option, quiet_option, reader_options
from mixseq.errors import MixseqWarning, SettingsError

if TYPE_CHECKING:
    from mixseq.metrics import Comparison, Spread
    from mixseq.sequence import MeshSequence


@click.command(
    "compare",
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
    ours, theirs = _options_of(reference, reading), _options_of(other, reading)
    for name in reading.keys() - ours.keys() - theirs.keys():
        raise SettingsError(f"neither {reference} nor {other} is read with an option {name!r}")
    with progress_bar(quiet) as progress:
        a = read_sequence(reference, ours, progress)
        b = read_sequence(other, theirs, progress)
    _warn_of_axes(reference, a, other, b)
    shared = at_times_of(a, b)
    result = mixseq.compare(a, shared)
    if as_json:
        left_out = b.frame_count - shared.frame_count
        print_json(
            {"reference": str(reference), "other": str(other), "left_out": left_out} | result.as_dict()
        )
    elif not quiet:
        if shared is not b:
            click.echo(f"compared at the {a.frame_count} times that {other} shares, out of {b.frame_count}")
        print_table(_rows(result))


def at_times_of(a: MeshSequence, b: MeshSequence) -> MeshSequence:
    """Return b at the times of a, if b has more frames and those among them; else b itself."""
    from mixseq.metrics import shared_frames
    from mixseq.sequence import MeshSequence

    frames = shared_frames(a, b) if b.frame_count > a.frame_count else None
    if frames is None:
        return b
    return MeshSequence.from_header(b.header.with_times(b.times[frames]), b.points[frames])


def _warn_of_axes(reference: Path, a: MeshSequence, other: Path, b: MeshSequence) -> None:
    """Tell of up axes and units that differ: points are compared as they are."""
    if a.up_axis != b.up_axis or not math.isclose(a.metres_per_unit, b.metres_per_unit, rel_tol=1e-6):
        first, second = (f"{each.up_axis} up and units of {each.metres_per_unit:g} m" for each in (a, b))
        warnings.warn(
            f"{reference} has {first}, {other} has {second}; points are compared as they are",
            MixseqWarning,
            stacklevel=2,
        )


def _options_of(path: Path, reading: dict[str, Any]) -> dict[str, Any]:
    """Return those of the options that the file's format knows: the two files may differ in format."""
    from mixseq_io import FORMATS

    extension = path.suffix.lower()
    forms = [form for form in FORMATS if (form.numbered if path.is_dir() else extension in form.extensions)]
    known = {"up_axis", "metres_per_unit"} | {name for form in forms for name in form.read_options}
    return {name: value for name, value in reading.items() if name in known}


def _rows(result: Comparison) -> list[tuple[str, str]]:
    volume = result.volume
    return [
        ("compared", f"{result.frames:,} frames of {result.vertices:,} vertices"),
        ("KG error", f"{result.kg_percent:.4g} %"),
        ("rms error", f"{result.rms_error:.4g} diagonals"),
        ("max error", f"{result.max_error:.4g} diagonals"),
        ("worst frame", f"{result.worst_frame} at {result.worst_time:g} s"),
        ("edge strain", _spread(result.edge_strain)),
        ("dihedral error", _spread(result.dihedral_degrees, " degrees")),
        ("volume error", f"{volume.mean:.4g} mean, {volume.max:.4g} max" if volume else "no volume"),
    ]


def _spread(spread: Spread, unit: str = "") -> str:
    skipped = f" ({spread.skipped:,} not defined)" if spread.skipped else ""
    return f"{spread.rms:.4g} rms, {spread.p999:.4g} at 99.9 %, {spread.max:.4g} max{unit}{skipped}"
