"""Read and write the files of a transfer, checked before the work."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.cli.files import is_model, options_of
from mixseq.cli.labelled import parts_given
from mixseq.errors import MixseqWarning, OutputError, SettingsError

if TYPE_CHECKING:
    from mixseq.correspondence.dense import Correspondence
    from mixseq.correspondence.markers import Markers
    from mixseq.retargeting.sources import SourceMotion
    from mixseq.retargeting.transfer import Transfer
    from mixseq.sequence import MeshSequence
    from mixseq.signals import Model
    from mixseq_io import SequenceReader

_ANIMATED = (".glb", ".gltf")  # formats that have a pose beside their animations

READ_OF_ALL = ("up_axis", "metres_per_unit")  # reader options that hold for every file


def chosen_rest(text: str | None, source: Path) -> tuple[int, Path | None]:
    """Return the rest frame, by its number or from the end, or a file."""
    if text is None:
        return 0, source if source.suffix.lower() in _ANIMATED else None
    return (int(text), None) if re.fullmatch(r"-?\d+", text) else (0, Path(text))


def mesh_at_rest(
    path: Path, reading: Mapping[str, Any], opened: SequenceReader | Model, unasked: bool
) -> MeshSequence | int:
    """Read the source's mesh at rest; frame 0 instead, if a file that was not asked for has other meshes."""
    shape = first_frame(path, {name: reading[name] for name in (*READ_OF_ALL, "prim") if name in reading})
    header = opened.header
    if not unasked or (shape.vertex_count, len(shape.faces)) == (header.vertex_count, len(header.faces)):
        return shape
    warnings.warn(
        f"{path}: without animation there are other meshes than those that move, so frame 0 counts as the rest; "
        "--prim / takes all meshes, --rest FRAME says that a frame is meant",
        MixseqWarning,
        stacklevel=2,
    )
    return 0


def picture_beside(out: Path) -> Path:
    """Return the path of the picture; that of numbered files has no number."""
    stem = re.sub(r"[-_. ]*(#+|\*+|%\d*d)", "", out.stem)
    return out.with_name(f"{stem}-transfer.png" if stem else "transfer.png")


def check_formats(out: Path, picture: Path | None, save_map: Path | None) -> None:
    """Raise an error for unsupported extensions, before the work."""
    from mixseq_io import FORMATS

    known = [extension for each in FORMATS for extension in each.extensions]
    if out.suffix.lower() not in known:
        raise OutputError(
            f"{out}: the extension {out.suffix!r} is not known; write one of {', '.join(known)}"
        )
    if save_map is not None and save_map.suffix.lower() != ".npz":
        raise OutputError(f"{save_map}: maps are written as npz files; end the name in .npz")
    if picture is not None:
        from mixseq.plots.sheet_layout import matplotlib_module

        if picture.suffix.lower() != ".png":
            raise OutputError(f"{picture}: the picture is a PNG file; end the name in .png")
        matplotlib_module("figure")


def opened_source(source: Path, reading: Mapping[str, Any]) -> AbstractContextManager[SequenceReader | Model]:
    """Open a sequence, or load a model."""
    if not is_model(source):
        return mixseq.open_sequence(source, **reading)
    others = [name for name in reading if name not in READ_OF_ALL]
    if others:
        raise SettingsError(
            f"{source} is a model, which is read without options; leave out those for sequences"
        )
    return nullcontext(mixseq.load(source))


def first_frame(path: Path, reading: Mapping[str, Any]) -> MeshSequence:
    """Read the first frame of a file; of glTF, whose animations rarely begin at rest, the pose without animation."""
    from mixseq.sequence import MeshSequence

    still = {"animation": "none"} if path.suffix.lower() in _ANIMATED else {}
    with mixseq.open_sequence(path, **options_of(path, still | dict(reading))) as reader:
        first = next(iter(reader.blocks(1)))[:1]
        return MeshSequence.from_header(reader.header.with_times(reader.header.times[:1]), first)


def chosen_parts(
    motion: SequenceReader | Model,
    parts: int | None,
    labels: Path | None,
    label_source: str | None,
    reading: Mapping[str, Any],
) -> Any:
    """Return a number of parts, labels of triangles, or None."""
    from mixseq.signals import Model

    if labels is None and label_source is None:
        return parts
    if isinstance(motion, Model):
        raise SettingsError(
            "labels are for sequences; leave out --labels and --source, the model has its own parts"
        )
    return parts_given(motion, parts, labels, label_source, reading)


def chosen_markers(path: Path | None, reverse: bool) -> Markers | None:
    """Read the markers of a file, None without one."""
    if path is None:
        return None
    from mixseq_io.correspondence.markers import read_markers

    return read_markers(path, reverse=reverse)


def chosen_contacts(path: Path | None) -> dict[str, list[int]] | None:
    """Read the contacts of a file, None without one."""
    if path is None:
        return None
    from mixseq_io.correspondence.contacts import read_contacts

    return read_contacts(path)


def chosen_map(path: Path | None, motion: SourceMotion, shape: MeshSequence) -> Correspondence | None:
    """Read the correspondence of two meshes from a file, None without one."""
    if path is None:
        return None
    from mixseq_io.correspondence.maps import read_map, to_correspondence

    return to_correspondence(
        read_map(path), (motion.rest, motion.header.faces), (shape.points[0], shape.faces)
    )


def save_correspondence(path: Path, made: Transfer) -> None:
    """Write the correspondence of a transfer, for reuse."""
    from mixseq_io.correspondence.maps import write_map

    write_map(path, made.correspondence, made.source.header.faces, made.header.faces)
