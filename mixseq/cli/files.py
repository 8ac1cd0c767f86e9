"""Read with progress, and check files before long work starts."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mixseq
from mixseq.errors import OutputError, SettingsError
from mixseq.progress import Progress

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from mixseq.arrays import FloatArray
    from mixseq.mapping import Executor
    from mixseq.scene import SceneItem
    from mixseq.sequence import MeshSequence, SequenceHeader
    from mixseq.signals import Model
    from mixseq_io.reader import SequenceReader

MODEL_EXTENSIONS, GLB = (".h5", ".hdf5"), ".glb"
VAT = ".vat"
"""Extension of folders with vertex animation textures, the only folders that are written as targets."""


def is_model(path: Path) -> bool:
    """Return whether a file is a model, see `mixseq_io.loading.is_model`."""
    from mixseq_io.loading import is_model

    return is_model(path)


def read_sequence(path: Path, reading: Mapping[str, Any], progress: Progress) -> MeshSequence:
    """Read a sequence into memory, reporting progress."""
    from mixseq.sequence import collect

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
    from mixseq_io import in_step

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
    from mixseq.unit_conversion import UnitConversion
    from mixseq_io import FORMATS

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
    from mixseq_io.numbered.names import files_of_pattern

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
    from mixseq_io import FORMATS

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
    from mixseq.scene import SceneItem

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
