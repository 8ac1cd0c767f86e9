"""Options for the size or error of compressed models, and reports of the result, shared by commands."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.choices import ORDERS
from mixseq.cli import options
from mixseq.cli.group import as_bytes, format_bytes, length_text
from mixseq.cli.options import in_diagonals
from mixseq.errors import SettingsError

if TYPE_CHECKING:
    from mixseq.choices import StillName
    from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
    from mixseq.runtime.progress import Progress
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import Frames


Rows = list[tuple[str, str]]

_OF_FITTING = (
    *("exact", "tolerance", "rank", "space", "segmentation", "joint_width", "placement"),
    *("projection", "volume", "knots", "pose", "between", "cuts"),
)
"""Options of ``mixseq encode`` that apply only to uncompressed models."""

_ORDER_MESSAGES = {
    "keep": "",
    "vertices": "faces have other numbers than the original's",
    "free": "vertices and faces have other numbers than the original's",
}
"""Messages about values of ``order`` that renumber vertices or faces."""


def _aim(uvs: bool = True, inbetweens: bool = True, between_frames: bool = False, **parameters: Any) -> dict[str, Any]:
    """Return the parameters of `mixseq.compress`, empty without a target; raise an error for contradicting options."""
    targets = options.given_options("max_error", "kg", "size")
    if len(targets) > 1:
        raise SettingsError(f"give one of {' and '.join(targets)}, not {len(targets)}: each follows from the other")
    if "max_error" not in parameters:
        options.refuse("between_frames", why="is about --max-error; give both")
    if not targets:
        options.refuse(
            *("uv_error", "uvs", "order", "chunk", "inbetweens"),
            why="is for compressed models; give --max-error, --kg or --size, too",
        )
        return {}
    options.refuse(*_OF_FITTING, why=f"is for models that are not compressed; leave it out, or leave out {targets[0]}")
    parameters |= {"between_frames": True} if between_frames else {}
    switches = {"uvs": uvs, "inbetweens": inbetweens}
    return parameters | {name: False for name, is_on in switches.items() if not is_on}


aiming = options.group(
    "aim",
    options.length(
        "--max-error X",
        help="Compress: no vertex of any frame is farther off than this fraction of the bounding box's diagonal, or "
        "0.5mm.",
    ),
    options.flag(
        "--between-frames",
        help="Keep --max-error between frames, too: players are as near to the model, at quarters of a frame.",
    ),
    options.option("--kg X", type=options.POSITIVE_NUMBER, help="Compress, to a KG error of X percent."),
    options.option("--size SIZE", type=as_bytes, help="Compress into 2MB, 500kB, 1.5MiB, ..."),
    options.setting(
        "--uv-error X",
        type=click.FloatRange(min=0, max=0.25),
        help="Compressed: u and v are off by X at most, 0 keeps all bits.  [default: 1/16 texel of 4096]",
    ),
    options.setting(
        "--order",
        type=click.Choice(ORDERS),
        help="Compressed: what keeps its numbers, vertices and faces, vertices only, or neither.  [default: keep]",
    ),
    options.setting(
        "--chunk N",
        type=click.IntRange(min=16),
        help="Compressed: about N frames can be decoded without others.  [default: 512]",
    ),
    options.setting("--uvs/--no-uvs", default=True, help="Compressed: keep texture coordinates."),
    options.setting(
        "--inbetweens/--no-inbetweens",
        default=True,
        help="Compressed: fit a model, so that players show its motion between frames; takes as long as a fit.",
    ),
    make=_aim,
)
"""Options for targets of compression; the argument ``aim`` gets the parameters of `mixseq.compress`."""


def compressed(
    frames: Frames, aim: Mapping[str, Any], progress: Progress, still: StillName | None = None
) -> CompressedSequence:
    """Compress a sequence to a target; a target size is the size of the file, a .glb if `still` is given."""
    aim = in_diagonals(aim, frames, "max_error")
    if "size" not in aim:
        return mixseq.compress(frames, **aim, progress=progress)
    from mixseq_io.coded.sizes import compress_to_size

    return compress_to_size(frames, still=still, progress=progress, **aim)


def coding_facts(path: Path, coded: CompressedSequence) -> dict[str, Any]:
    """Return the size in bytes, bit rates and errors of a compressed model in a file."""
    from dataclasses import asdict

    from mixseq_io.verification import compressed_sizes

    sizes = compressed_sizes(path)
    return {
        "bytes": sizes,
        "coding": {
            **asdict(coded.parameters),
            "order": coded.order,
            "groups": len(coded.basis),
            "chunks": len(coded.chunks),
            "bits": {name: bits(sizes[name], coded.header) for name in ("signals", "total")},
            "bits_of_motion": bits(sizes["signals"] - sizes["surface"] - sizes["uvs"], coded.header),
        },
    }


def bits(size: int, header: SequenceHeader) -> float:
    """Convert a size in bytes to bits per vertex and frame."""
    return 8 * size / (header.vertex_count * header.frame_count)


def coding_rows(facts: dict[str, Any], metres_per_unit: float) -> Rows:
    """Return table rows for the result of `coding_facts`."""
    sizes, coding = facts["bytes"], facts["coding"]
    stated = "at most " if coding["promised"] else ""
    components = [
        ("connectivity", "faces"),
        ("uvs", "texture coordinates"),
        ("surface", f"{'texture coordinates' if coding['uv_error'] is None else 'face sets'} and the like"),
        ("still", "first frame and textures"),
        ("container", "container"),
    ]
    motion = sizes["signals"] - sizes["surface"] - sizes["uvs"]
    rates = [
        ("signals", motion, coding["bits_of_motion"]),
        ("total", sizes["total"], coding["bits"]["total"]),
    ]
    rows = [
        *((name, f"{format_bytes(size)}, {rate:.3g} bits per vertex and frame") for name, size, rate in rates),
        (
            "of it",
            ", ".join(f"{format_bytes(sizes[name])} {what}" for name, what in components if sizes[name]),
        ),
        (
            "max error",
            stated + length_text(coding["max_error"], coding["diagonal"] * metres_per_unit, digits=3),
        ),
        ("KG error", f"{coding['kg_percent']:.3g} %"),
    ]
    if coding["inbetween_error"] is not None:
        length = length_text(coding["inbetween_error"], coding["diagonal"] * metres_per_unit, digits=2)
        rows.append(("in-betweens", f"players are {length} from the model at most"))
    if coding["uv_error"] is not None:
        rows.append(("texture error", f"at most {coding['uv_error']:.3g} of the square"))
    return rows


def history_rows(header: SequenceHeader) -> Rows:
    """Return table rows about what frames come from, how far they are from it, and what has other numbers there."""
    if header.provenance is None:
        return []
    rows = {
        "motion": header.provenance.events,
        "history": str(header.provenance),
        "order": _ORDER_MESSAGES[header.provenance.kept_order],
    }
    return [(name, text) for name, text in rows.items() if text]
