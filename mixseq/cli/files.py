"""Read with progress, and check files before long work starts.

Protect files from being overwritten: no input is an output, and no file is replaced without consent.

On a terminal, replacing a named target needs an answer, before the work. Without a terminal it is replaced, as other
tools in scripts do, so that a script may run twice. ``--overwrite`` and ``--no-overwrite`` answer in advance.

Labels chosen by ``--labels`` and ``--source``, and their connected parts.

Read and write the files of a transfer, checked before the work.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from functools import wraps
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.group import printable
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.runtime.progress import Progress

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from mixseq.pictures.scene import SceneItem
    from mixseq.retargeting.markers import Correspondence, Markers
    from mixseq.retargeting.sources import SourceMotion
    from mixseq.retargeting.transfer import Transfer
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import MeshSequence
    from mixseq.signals.model import Model
    from mixseq.types import FloatArray
    from mixseq_io.reader import SequenceReader
    from mixseq_io.text.labels import Labels


MODEL_EXTENSIONS, GLB = (".h5", ".hdf5"), ".glb"
VAT = ".vat"
"""Extension of folders with vertex animation textures, the only folders that are written as targets."""


def is_model(path: Path) -> bool:
    """Return whether a file is a model, see `mixseq_io.loading.is_model`."""
    from mixseq_io.loading import is_model

    return is_model(path)


def read_sequence(path: Path, reading: Mapping[str, Any], progress: Progress) -> MeshSequence:
    """Read a sequence into memory, reporting progress."""
    from mixseq.sequence.sequence import collect

    with mixseq.open_sequence(path, **reading) as reader:
        reader.check_whole()
        frames = reader.header.frame_count
        return collect(reader.header, counted(reader.blocks(), frames, f"reading {path.name}", progress))


def counted(blocks: Iterable[FloatArray], frames: int, what: str, progress: Progress) -> Iterator[FloatArray]:
    """Pass on blocks of frames, reporting their number as progress."""
    done = 0
    for block in blocks:
        yield block
        done += len(block)
        progress(done, frames, what)


def write_frames(
    path: Path,
    model: Model,
    header: SequenceHeader,
    velocities: bool,
    writing: Mapping[str, Any],
    progress: Progress,
    workers: Executor,
    sources: ArrayLike | None = None,
) -> None:
    """Decode the frames of a header and write them block by block, with velocities or without."""
    from mixseq_io.reader import in_step

    if velocities:
        points, speeds = in_step(model.moving_blocks(header.times, progress=progress, workers=workers))
        write_sequence(path, header, points, speeds, writing, sources)
    else:
        blocks = model.blocks(header.times, progress=progress, workers=workers)
        write_sequence(path, header, blocks, None, writing, sources)


def write_sequence(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None,
    writing: Mapping[str, Any],
    sources: ArrayLike | None = None,
) -> None:
    """Write frames block by block, rotated and scaled on request, but never over the file of their origin.

    Formats with `sources` get the times (T,) of the original for the frames, in seconds.
    """
    from mixseq.sequence.sequence import UnitConversion
    from mixseq_io.registry import FORMATS

    check_origin(path, header)
    forms = (form for form in FORMATS if path.suffix.lower() in form.extensions)
    told = {} if sources is None else {"sources": sources}
    taken = told if any("sources" in form.write_options for form in forms) else {}
    options = {
        name: value for name, value in writing.items() if name not in ("convert_axes", "convert_units")
    }
    conversion = UnitConversion.of(header, writing.get("convert_axes"), writing.get("convert_units"))
    mixseq.write_blocks(
        path,
        conversion.header(header),
        conversion.blocks(blocks),
        None if velocities is None else conversion.blocks(velocities),
        **options,
        **taken,
    )


def check_origin(path: Path, header: SequenceHeader) -> None:
    """Raise an error if a path is the file from which a sequence was read."""
    origin = header.surface.origin
    if origin is not None and _replaces(path, Path(origin.path)):
        lost = origin.path if path.is_dir() else path
        raise OutputError(
            f"{lost} is the file that the sequence came from, which would be lost; give another name"
        )


def check_target(path: Path, source: Path) -> None:
    """Raise an error, before the work, for a file that cannot be written or would replace the source."""
    if _replaces(path, source) or _share_files(path, source):
        lost = source if path.is_dir() else path
        raise OutputError(f"{lost} is the source itself and would be lost; give another name")
    check_place(path)


def check_place(path: Path) -> None:
    """Raise an error, before the work, for a file that cannot be written at its path."""
    folder = path.parent
    if path.is_dir() and path.suffix.lower() != VAT:
        raise OutputError(f"{path} is a folder; give the name of a file")
    if not folder.is_dir():
        raise OutputError(f"{path}: the folder {folder} does not exist; make it first")
    if not os.access(folder, os.W_OK):
        raise OutputError(f"cannot write {path}: no permission; choose a folder that you may write to")


def _replaces(target: Path, source: Path) -> bool:
    """Return whether a target is an existing source, or a folder of textures that contains the source."""
    if not (target.exists() and source.exists()):
        return False
    if not (target.is_dir() and target.suffix.lower() == VAT):
        return target.samefile(source)
    from mixseq_io.vat.writer import OWN

    folder = target.resolve()
    names = (source.parent.resolve() / source.name, source.resolve())  # of a link, and of what it leads to
    return any(name.parent == folder and name.name in OWN for name in names)


def _share_files(target: Path, source: Path) -> bool:
    """Return whether files of a numbered target are files of a numbered source."""
    from mixseq_io.numbered.files import files_of_pattern

    if target.suffix.lower() != source.suffix.lower() and not source.is_dir():
        return False
    of_source = (
        source.iterdir() if source.is_dir() else [source, *(file for _, file in files_of_pattern(source))]
    )
    ours = {file.resolve() for _, file in files_of_pattern(target)}
    return not ours.isdisjoint(file.resolve() for file in of_source)


def check_model_name(path: Path, compressed: bool) -> None:
    """Raise an error for a path without a model's extension."""
    suffix = path.suffix.lower()
    if suffix == GLB and not compressed:
        raise OutputError(f"{path}: a .glb holds compressed models; give --max-error, --kg or --size, too")
    if suffix not in (*MODEL_EXTENSIONS, GLB):
        raise OutputError(
            f"{path}: models are HDF5 files; end the name in {' or '.join(MODEL_EXTENSIONS)}, or in {GLB} for the web"
        )


def free_name(path: Path) -> Path:
    """Return the path, with a number appended if the file exists."""
    tries = (path, *(path.with_stem(f"{path.stem}-{number}") for number in range(2, 10_000)))
    return next(each for each in tries if not each.exists())


def options_of(path: Path, reading: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that the file's format supports: several files may differ in format."""
    from mixseq_io.registry import FORMATS

    extension = path.suffix.lower()
    forms = [form for form in FORMATS if (form.numbered if path.is_dir() else extension in form.extensions)]
    known = {"up_axis", "metres_per_unit", "start_frame"} | {
        name for form in forms for name in form.read_options
    }
    return {name: value for name, value in reading.items() if name in known}


def check_options(files: Sequence[Path], reading: Mapping[str, Any]) -> None:
    """Raise an error for options that no format of the files supports."""
    for name in reading.keys() - set().union(*(options_of(file, reading) for file in files)):
        raise SettingsError(f"none of the files is read with an option {name!r}")


def scene_items(
    files: Sequence[Path],
    names: Sequence[str],
    against: Path | None,
    reading: Mapping[str, Any],
    stack: ExitStack,
) -> tuple[list[SceneItem], SequenceReader | None]:
    """Open models, sequences (frames are read later) and the original for errors; the stack closes them."""
    from mixseq.pictures.scene import SceneItem

    check_options([*files, *([against] if against else [])], reading)

    def opened(file: Path) -> SequenceReader:
        return stack.enter_context(mixseq.open_sequence(file, **options_of(file, reading)))

    items = [
        SceneItem(name, mixseq.load(file) if is_model(file) else opened(file))
        for name, file in zip(names, files, strict=True)
    ]
    return items, None if against is None else opened(against)


@dataclass(frozen=True)
class Decoded:
    """The frames of a model, decoded on demand."""

    model: Model
    progress: Progress
    workers: Executor

    @property
    def header(self) -> SequenceHeader:
        """Mesh and times."""
        return self.model.header

    def blocks(self, size: int = 16) -> Iterator[FloatArray]:
        """Decode all frames."""
        return self.model.blocks(self.model.times, progress=self.progress, workers=self.workers)


_CACHES = (".pc2", ".mdd")
_FOLDERS = ("folders", "pack_from")
"""Parameters with folders that may be read, as opposed to files."""


@dataclass(frozen=True)
class Claim:
    """Claim files for writing."""

    overwrite: bool | None  # the option; None if not given
    given: tuple[Path, ...] = ()  # all files given to the command, to read or to write
    clips: bool = False  # whether USD is written with value clips

    def __call__(self, *targets: Path | None, read: Iterable[Path | None] = ()) -> None:
        """Claim targets, ignoring `None`; `read` are more files that they must not be."""
        written = [target for target in targets if target is not None]
        sources = [*self.given, *(path for path in read if path is not None)]
        for number, target in enumerate(written):
            if target.resolve() in (other.resolve() for other in written[:number]):
                raise OutputError(f"{target} is to be written twice; give another name")
            if target in sources:
                sources.remove(target)  # once: a file given twice is read, too
        for path in (file for target in written for file in (target, *_beside(target))):
            check_place(path)
            for source in sources:
                check_target(path, source)
        self.permit([file for target in written for file in files_in_the_way(target, self.clips)])

    def permit(self, files: Sequence[Path], unasked: bool = True) -> None:
        """Check that files may be replaced; `unasked` is the answer without an option and without a terminal."""
        if not files or self.overwrite:
            return
        asked = self.overwrite is None and on_terminal()
        exist = f"{_named(files)} {'exists' if len(files) == 1 else 'exist'}"
        question = f"{exist}; replace {'it' if len(files) == 1 else 'them'}?"
        if asked and not click.confirm(printable(question), err=True):
            raise OutputError(f"{_named(files)} stayed as before; give another name")
        if not asked and (self.overwrite is False or not unasked):
            raise OutputError(f"{exist}; give another name, or --overwrite")


def overwrite_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add ``--overwrite``; the command gets a `Claim` as ``claim``, to be called before the work."""

    @click.option(
        "--overwrite/--no-overwrite",
        default=None,
        help="Replace files that exist, or refuse to.  [default: ask, on a terminal]",
    )
    @wraps(command)
    def with_option(*args: Any, overwrite: bool | None, **settings: Any) -> None:
        given = click.get_current_context().params
        files = [value for name, value in given.items() if name not in _FOLDERS]
        claim = Claim(overwrite, tuple(_paths(files)), bool(given.get("clips")))
        command(*args, claim=claim, **settings)

    return with_option


def on_terminal() -> bool:
    """Return whether a user can answer."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def files_in_the_way(target: Path, clips: bool = False) -> list[Path]:
    """Return the existing files that writing to a target replaces, with numbered files, and those beside it."""
    from mixseq_io.numbered.files import files_of_pattern
    from mixseq_io.registry import FORMATS

    numbered = any(form.numbered and target.suffix.lower() in form.extensions for form in FORMATS)
    found = [file for _, file in sorted(files_of_pattern(target))] if numbered else []
    folder = [target.with_name(f"{target.name}.clips")] if clips else []
    return [file for file in (*found, target, *_beside(target), *folder) if file.exists()]


def _beside(target: Path) -> list[Path]:
    """Return the files written beside a target: the mesh of a point cache."""
    return [target.with_suffix(".obj")] if target.suffix.lower() in _CACHES else []


def _paths(values: Iterable[Any]) -> Iterator[Path]:
    for value in values:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, tuple):
            yield from _paths(value)


def _named(files: Sequence[Path]) -> str:
    """Format files for a message: all of a few, the first and last of many."""
    names = [click.format_filename(file) for file in files]
    if len(names) > 4:
        return f"{names[0]} ... {names[-1]} ({len(names)} files)"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def chosen_labels(
    reader: SequenceReader, labels: Path | None, source: str | None, reading: Mapping[str, Any]
) -> Labels:
    """Read labels of an open sequence from a file, or from the sequence itself."""
    from mixseq_io.text.label_files import labels_of, read_labels

    if labels is None:
        return labels_of(reader, source)
    return read_labels(labels, reader, source, **options_of(labels, reading))


def parts_given(
    reader: SequenceReader,
    parts: int | None,
    labels: Path | None,
    source: str | None,
    reading: Mapping[str, Any],
) -> NDArray[np.int64]:
    """Return the part of every triangle ``(F,)`` from labels; raises an error if a number of parts contradicts them."""
    if parts is not None:
        raise SettingsError("--labels and --source tell the parts; leave out --parts, or them")
    return chosen_labels(reader, labels, source, reading).part_of_face


def connected(header: SequenceHeader, labels: Labels) -> Labels:
    """Split labels into connected parts; the second part of a label "arm" is "arm_1", unless that is a label."""
    import numpy as np

    from mixseq.mesh.topology import Topology
    from mixseq.segmentation.methods import segment_by_labels
    from mixseq_io.text.labels import Labels

    parts = segment_by_labels(labels.part_of_face, Topology(header.faces, header.vertex_count))
    _, first = np.unique(parts, return_index=True)
    label_of_part = labels.part_of_face[first].tolist()
    return Labels(parts, numbered([labels.names[label] for label in label_of_part]))


def numbered(names: Sequence[str]) -> tuple[str, ...]:
    """Append numbers to repeated names, skipping existing ones: arm, arm, arm_1 become arm, arm_2, arm_1."""
    used, result = set(names), []
    counts: dict[str, count[int]] = {}
    for name in names:
        if name in counts:
            result.append(next(free for number in counts[name] if (free := f"{name}_{number}") not in used))
            used.add(result[-1])
        else:
            counts[name] = count(1)
            result.append(name)
    return tuple(result)


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
    from mixseq_io.registry import FORMATS

    known = [extension for each in FORMATS for extension in each.extensions]
    if out.suffix.lower() not in known:
        raise OutputError(
            f"{out}: the extension {out.suffix!r} is not known; write one of {', '.join(known)}"
        )
    if save_map is not None and save_map.suffix.lower() != ".npz":
        raise OutputError(f"{save_map}: maps are written as npz files; end the name in .npz")
    if picture is not None:
        from mixseq.pictures.page import matplotlib_module

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
    from mixseq.sequence.sequence import MeshSequence

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
    from mixseq.signals.model import Model

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
    from mixseq_io.text.markers import read_markers

    return read_markers(path, reverse=reverse)


def chosen_contacts(path: Path | None) -> dict[str, list[int]] | None:
    """Read the contacts of a file, None without one."""
    if path is None:
        return None
    from mixseq_io.text.markers import read_contacts

    return read_contacts(path)


def chosen_map(path: Path | None, motion: SourceMotion, shape: MeshSequence) -> Correspondence | None:
    """Read the correspondence of two meshes from a file, None without one."""
    if path is None:
        return None
    from mixseq_io.text.maps import read_map, to_correspondence

    return to_correspondence(
        read_map(path), (motion.rest, motion.header.faces), (shape.points[0], shape.faces)
    )


def save_correspondence(path: Path, made: Transfer) -> None:
    """Write the correspondence of a transfer, for reuse."""
    from mixseq_io.text.maps import write_map

    write_map(path, made.correspondence, made.source.header.faces, made.header.faces)
