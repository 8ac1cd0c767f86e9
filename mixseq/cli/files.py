"""Read and write files, and protect existing files and inputs from being overwritten.

On a terminal, the user must confirm the replacement of a file before the work starts. Without a terminal, the file is
replaced, so that a script may run twice. ``--overwrite`` and ``--no-overwrite`` decide in advance.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import mixseq
from mixseq.cli.group import length_text, printable
from mixseq.errors import OutputError, SettingsError
from mixseq.runtime.progress import Progress
from mixseq.sequence.frame_rates import format_frames, format_rate, time_to_number

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

    from mixseq.pictures.scene import SceneItem
    from mixseq.runtime.parallel import Executor
    from mixseq.sequence.header import SequenceHeader
    from mixseq.sequence.sequence import Frames, LazyFrames, MeshSequence
    from mixseq.signals.decoding import Decodable
    from mixseq.signals.model import Model
    from mixseq.types import Float, FloatArray
    from mixseq_io.reader import SequenceReader
    from mixseq_io.text.labels import Labels


_ORDER_MESSAGES = {
    "keep": "",
    "vertices": "faces have other numbers than the original's",
    "free": "vertices and faces have other numbers than the original's",
}
"""Messages about values of ``order`` that renumber vertices or faces."""

ALL_ANIMATIONS = "all"
"""Choice of a file for every animation."""

MODEL_EXTENSIONS, GLB_EXTENSION = (".h5", ".hdf5"), ".glb"
VAT_EXTENSION = ".vat"
"""Extension of folders with vertex animation textures, the only targets that are folders."""


def is_model(path: Path) -> bool:
    """Return whether a file is a model, see `mixseq_io.model_files.is_model`."""
    from mixseq_io.model_files import is_model

    return is_model(path)


BODY_FIELD = "{body}"
"""What stands for the name of every body in the path of a target."""


def load_body(path: Path, body: str | None) -> Model:
    """Load a model with the given body in front; None for its own."""
    model = mixseq.load(path)
    try:
        return model if body is None else model.body(body)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def targets_of_bodies(source: Path, target: Path, body: str | None) -> dict[Path, str | None]:
    """Return the body to write by target: the given one, or all of a model if the target has the `BODY_FIELD`."""
    if BODY_FIELD not in str(target):
        return {target: body}
    if body is not None:
        raise SettingsError(f"{target}: {BODY_FIELD} stands for all bodies; leave it out, or --body")
    targets: dict[Path, str | None] = {}
    for name in mixseq.load(source).body_names:
        if re.search(r"[/\\\0]|^\.", name):
            raise OutputError(f"the body {name!r} has no name for a file; decode it with --body")
        targets[Path(str(target).replace(BODY_FIELD, name))] = name
    return targets


def load_or_fit(
    path: Path, progress: Progress, body: str | None = None, reading: Mapping[str, Any] | None = None, **settings: Any
) -> Model:
    """Load a model, or fit one to a sequence with settings of `mixseq.fit`."""
    if is_model(path):
        return load_body(path, body)
    if body is not None:
        raise SettingsError(f"{path} is a sequence, which has one body; leave out --body")
    with mixseq.open_sequence(path, **(reading or {})) as reader:
        return mixseq.fit(reader, progress=progress, **settings)


def read_sequence(path: Path, reading: Mapping[str, Any], progress: Progress) -> MeshSequence:
    """Read a sequence into memory and report progress."""
    from mixseq.sequence.sequence import join_blocks

    with mixseq.open_sequence(path, **reading) as reader:
        reader.check_total_memory()
        frames = reader.header.frame_count
        return join_blocks(reader.header, counted(reader.blocks(), frames, f"reading {path.name}", progress))


def counted(blocks: Iterable[FloatArray], frames: int, what: str, progress: Progress) -> Iterator[FloatArray]:
    """Yield the given blocks of frames, and report the number of frames as progress."""
    done = 0
    for block in blocks:
        yield block
        done += len(block)
        progress(done, frames, what)


def select_frames(blocks: Iterable[FloatArray], indices: Iterable[int]) -> Iterator[FloatArray]:
    """Yield the frames with the given indices from blocks of a sequence, in order; stop after the last of them."""
    remaining, first = sorted(indices), 0
    for block in blocks:
        rows = [index - first for index in remaining if index < first + len(block)]
        if rows:
            yield block[rows]
        remaining, first = remaining[len(rows) :], first + len(block)
        if not remaining:
            return


def at_times_of(a: Frames, b: Frames) -> Frames:
    """Return the frames of b at the times of a if b has them and further frames; otherwise return b."""
    from mixseq.metrics import match_frames
    from mixseq.sequence.sequence import LazyFrames

    more = b.header.frame_count > a.header.frame_count
    frames = match_frames(a.header, b.header) if more else None
    if frames is None:
        return b
    indices = sorted(set(frames.tolist()))
    header = b.header.with_times(b.header.times[indices])
    return LazyFrames(header, lambda size: select_frames(b.blocks(size), indices))


def decoded(model: Model, progress: Progress, workers: Executor) -> LazyFrames:
    """Return the frames of a model, decoded on demand."""
    from mixseq.sequence.sequence import LazyFrames

    return LazyFrames(model.header, lambda _: model.blocks(model.times, progress=progress, workers=workers))


def history_rows(header: SequenceHeader) -> list[tuple[str, str]]:
    """Return table rows about what frames come from, how far they are from it, and what has other numbers there."""
    if header.provenance is None:
        return []
    rows = {
        "motion": header.provenance.events,
        "history": str(header.provenance),
        "order": _ORDER_MESSAGES[header.provenance.kept_order],
    }
    return [(name, text) for name, text in rows.items() if text]


def time_rows(header: SequenceHeader) -> list[tuple[str, str]]:
    """Return table rows about the frame times of a written sequence."""
    first, last = (float(time) for time in header.times[[0, -1]])
    numbers = (time_to_number(time, header.fps) for time in (first, last))
    return [
        ("frames", format_frames(header.frame_count, *numbers)),
        ("time", f"{first:g} to {last:g} s at {format_rate(header.fps)} frames per second"),
        *history_rows(header),
    ]


def between_rows(
    path: Path, header: SequenceHeader, points_at: Callable[[Float], Iterable[FloatArray]], writing: Mapping[str, Any]
) -> list[tuple[str, str]]:
    """Return a table row about the error between frames of a written glTF file, as players show it.

    `points_at` returns points of the motion ``(B, V, 3)`` at times ``(N,)`` of the file.
    """
    from mixseq.sequence.sequence import UnitConversion, reference_diagonal
    from mixseq_io.rig_files import GLTF_EXTENSIONS, measure_file_between

    if path.suffix.lower() not in GLTF_EXTENSIONS or header.frame_count == 1:
        return []
    conversion = UnitConversion.from_header(header, writing.get("convert_axes"), writing.get("convert_units"))
    written = conversion.convert_header(header)
    error = measure_file_between(path, written, lambda times: map(conversion.convert, points_at(times)))
    diagonal = reference_diagonal(points_at(header.times)).length * conversion.scale
    return between_row(None if error is None else error / (diagonal or 1.0), diagonal * written.metres_per_unit)


def between_row(error: float | None, diagonal: float) -> list[tuple[str, str]]:
    """Return a table row about an error between frames in diagonals, if it was measured; `diagonal` is in metres."""
    return [] if error is None else [("between frames", length_text(error, diagonal, digits=2))]


def write_frames(
    path: Path,
    model: Decodable,
    header: SequenceHeader,
    velocities: bool,
    writing: Mapping[str, Any],
    progress: Progress,
    workers: Executor,
    sources: ArrayLike | None = None,
) -> None:
    """Decode the frames of a header and write them block by block, optionally with velocities."""
    from mixseq_io.reader import unzip_blocks

    if velocities:
        points, speeds = unzip_blocks(model.moving_blocks(header.times, progress=progress, workers=workers))
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
    """Write frames block by block, rotated and scaled on request, but refuse to replace the file they are read from.

    `sources` (T,) are the frames' times in the original, in seconds, for formats that store them.
    """
    from mixseq.sequence.sequence import UnitConversion
    from mixseq_io.registry import FORMATS

    check_origin(path, header)
    forms = (form for form in FORMATS if path.suffix.lower() in form.extensions)
    of_original = {} if sources is None else {"sources": sources}
    extra = of_original if any("sources" in form.write_options for form in forms) else {}
    options = {name: value for name, value in writing.items() if name not in ("convert_axes", "convert_units")}
    conversion = UnitConversion.from_header(header, writing.get("convert_axes"), writing.get("convert_units"))
    mixseq.write_blocks(
        path,
        conversion.convert_header(header),
        map(conversion.convert, blocks),
        None if velocities is None else map(conversion.convert, velocities),
        **options,
        **extra,
    )


def check_origin(path: Path, header: SequenceHeader) -> None:
    """Raise an error if a path is the file from which the sequence was read."""
    origin = header.surface.origin
    if origin is not None and _replaces(path, Path(origin.path)):
        endangered = origin.path if path.is_dir() else path
        raise OutputError(
            f"{endangered} is the file that the sequence came from, which would be lost; give another name"
        )


def check_target(path: Path, source: Path) -> None:
    """Raise an error before the work if a target cannot be written or would replace the source."""
    if _replaces(path, source) or _share_files(path, source):
        endangered = source if path.is_dir() else path
        raise OutputError(f"{endangered} is the source itself and would be lost; give another name")
    check_place(path)


def check_place(path: Path) -> None:
    """Raise an error before the work if a file cannot be written at the given path."""
    from mixseq_io.files import check_target

    check_target(path, is_folder=path.suffix.lower() == VAT_EXTENSION)
    if not os.access(path.resolve().parent, os.W_OK):
        raise OutputError(f"cannot write {path}: no permission; choose a folder that you may write to")


def _replaces(target: Path, source: Path) -> bool:
    """Return whether writing the target would replace an existing source, as a file or in a texture folder."""
    if not (target.exists() and source.exists()):
        return False
    if not (target.is_dir() and target.suffix.lower() == VAT_EXTENSION):
        return target.samefile(source)
    from mixseq_io.vat.writer import VAT_FILE_NAMES

    folder = target.resolve()
    names = (source.parent.resolve() / source.name, source.resolve())  # of a link, and of its target
    return any(name.parent == folder and name.name in VAT_FILE_NAMES for name in names)


def _share_files(target: Path, source: Path) -> bool:
    """Return whether a numbered target and a numbered source have files in common."""
    from mixseq_io.numbered.files import find_numbered_files

    if target.suffix.lower() != source.suffix.lower() and not source.is_dir():
        return False
    of_source = source.iterdir() if source.is_dir() else [source, *(file for _, file in find_numbered_files(source))]
    of_target = {file.resolve() for _, file in find_numbered_files(target)}
    return not of_target.isdisjoint(file.resolve() for file in of_source)


def options_of(path: Path, reading: Mapping[str, Any]) -> dict[str, Any]:
    """Return the reading options that the format of a file supports."""
    from mixseq_io.registry import FORMATS

    extension = path.suffix.lower()
    forms = [form for form in FORMATS if (form.numbered if path.is_dir() else extension in form.extensions)]
    supported = {"up_axis", "metres_per_unit", "start_frame"} | {name for form in forms for name in form.read_options}
    return {name: value for name, value in reading.items() if name in supported}


def check_options(files: Iterable[Path], reading: Mapping[str, Any], none: str = "none of the files is") -> None:
    """Raise an error for reading options that none of the files' formats supports."""
    supported = set().union(*(options_of(file, reading) for file in files))
    for name in reading:
        if name not in supported:
            raise SettingsError(f"{none} read with an option {name!r}")


def scene_items(
    files: Sequence[Path],
    names: Sequence[str],
    against: Path | None,
    reading: Mapping[str, Any],
    stack: ExitStack,
    scalar: Path | None = None,
) -> tuple[list[SceneItem], SequenceReader | None]:
    """Open models, sequences (frames are read later), the original for errors, and values; `stack` closes the files.

    A model of several bodies is an item for each.
    """
    from mixseq.pictures.colours import check_values
    from mixseq.pictures.scene import SceneItem
    from mixseq_io.npz import read_values

    values = None if scalar is None else read_values(scalar)
    check_options([*files, *([against] if against else [])], reading)

    def opened(file: Path) -> SequenceReader:
        return stack.enter_context(mixseq.open_sequence(file, **options_of(file, reading)))

    items = [
        item
        for name, file in zip(names, files, strict=True)
        for item in SceneItem(name, mixseq.load(file) if is_model(file) else opened(file), values=values).of_bodies()
    ]
    if len(files) == 1 and len(items) > 1:
        items = [replace(item, name=item.header.name) for item in items]
    if values is not None:
        for item in items:
            check_values(values, item.header)
    return items, None if against is None else opened(against)


_CACHE_EXTENSIONS = (".pc2", ".mdd")
_FOLDER_PARAMETERS = ("folders", "pack_from")
"""Command parameters whose values are folders to read from, not files."""


@dataclass(frozen=True)
class Claim:
    """Checks that files may be written, to be called before the work."""

    overwrite: bool | None  # value of the option ``--overwrite``; None if not given
    given: tuple[Path, ...] = ()  # all files on the command line, to read or to write
    clips: bool = False  # whether USD is written with value clips

    def __call__(self, *targets: Path | None, read: Iterable[Path | None] = ()) -> None:
        """Check that targets may be written, ignoring `None`; `read` are further input files to protect."""
        written = [target for target in targets if target is not None]
        sources = [*self.given, *(path for path in read if path is not None)]
        for number, target in enumerate(written):
            if target.resolve() in (other.resolve() for other in written[:number]):
                raise OutputError(f"{target} is to be written twice; give another name")
            if target in sources:
                sources.remove(target)  # only once, as a file given twice is also an input
        for path in (file for target in written for file in (target, *_beside(target))):
            check_place(path)
            for source in sources:
                check_target(path, source)
        self.permit([file for target in written for file in files_in_the_way(target, self.clips)])

    def permit(self, files: Sequence[Path], unasked: bool = True) -> None:
        """Check that files may be replaced; `unasked` is the answer if there is neither an option nor a terminal."""
        if not files or self.overwrite:
            return
        can_ask = self.overwrite is None and on_terminal()
        exist = f"{_list_files(files)} {'exists' if len(files) == 1 else 'exist'}"
        question = f"{exist}; replace {'it' if len(files) == 1 else 'them'}?"
        if can_ask and not click.confirm(printable(question), err=True):
            raise OutputError(f"{_list_files(files)} stayed as before; give another name")
        if not can_ask and (self.overwrite is False or not unasked):
            raise OutputError(f"{exist}; give another name, or --overwrite")


def claim_of_command(overwrite: bool | None = None) -> Claim:
    """Return the claim of the running command."""
    context = click.get_current_context()
    if context.obj is not None:  # of a batch, to know options before the work
        of_batch: Claim = context.obj
        return of_batch
    given = context.params
    files = _paths(value for name, value in given.items() if name not in _FOLDER_PARAMETERS)
    return Claim(overwrite, tuple(files), bool(given.get("clips")))


def on_terminal() -> bool:
    """Return whether a user at a terminal can answer questions."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def files_in_the_way(target: Path, clips: bool = False) -> list[Path]:
    """Return the existing files that writing to a target replaces, including numbered files and additional files."""
    from mixseq_io.numbered.files import find_numbered_files
    from mixseq_io.registry import FORMATS

    numbered = any(form.numbered and target.suffix.lower() in form.extensions for form in FORMATS)
    numbered_files = [file for _, file in find_numbered_files(target)] if numbered else []
    folder = [target.with_name(f"{target.name}.clips")] if clips else []
    return [file for file in (*numbered_files, target, *_beside(target), *folder) if file.exists()]


def _beside(target: Path) -> list[Path]:
    """Return the additional files written with a target: the mesh of a point cache."""
    return [target.with_suffix(".obj")] if target.suffix.lower() in _CACHE_EXTENSIONS else []


def _paths(values: Iterable[Any]) -> Iterator[Path]:
    for value in values:
        if isinstance(value, Path):
            yield value
        elif isinstance(value, tuple):
            yield from _paths(value)


def _list_files(files: Sequence[Path]) -> str:
    """Format file names for a message; of many files, show only the first and the last."""
    names = [click.format_filename(file) for file in files]
    if len(names) > 4:
        return f"{names[0]} ... {names[-1]} ({len(names)} files)"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


@dataclass(frozen=True)
class LabelChoice:
    """Options that choose face labels from other programs."""

    labels: Path | None = None  # file with labels; None for labels of the sequence itself
    label_source: str | None = None  # name of the labels in the file

    @property
    def is_given(self) -> bool:
        """Whether any of the options is given."""
        return self != LabelChoice()

    def read(self, reader: SequenceReader, reading: Mapping[str, Any]) -> Labels:
        """Read the chosen labels for an open sequence."""
        from mixseq_io.text.label_files import extract_labels, read_labels

        if self.labels is None:
            return extract_labels(reader, self.label_source)
        return read_labels(self.labels, reader, self.label_source, **options_of(self.labels, reading))

    def parts(
        self, reader: SequenceReader, count: int | None, reading: Mapping[str, Any]
    ) -> int | NDArray[np.int64] | None:
        """Return the part of every triangle ``(F,)`` according to labels; without labels, return `count`."""
        if not self.is_given:
            return count
        if count is not None:
            raise SettingsError("--labels and --source give the parts; leave out --parts, or them")
        return self.read(reader, reading).part_of_face


def first_frame(path: Path, reading: Mapping[str, Any]) -> MeshSequence:
    """Read the first frame of a file; of glTF, whose animations rarely begin at rest, always the unanimated pose."""
    from mixseq.sequence.sequence import MeshSequence
    from mixseq_io.rig_files import GLTF_EXTENSIONS

    still = {"animation": "none"} if path.suffix.lower() in GLTF_EXTENSIONS else {}
    with mixseq.open_sequence(path, **options_of(path, dict(reading) | still)) as reader:
        first = next(iter(reader.blocks(1)))[:1]
        return MeshSequence.from_header(reader.header.with_times(reader.header.times[:1]), first)


def animations_of(path: Path) -> dict[str, str]:
    """Return a part of file names and a choice for every animation of a file, glTF; {} for other formats."""
    from mixseq_io.rig_files import GLTF_EXTENSIONS

    if path.suffix.lower() not in GLTF_EXTENSIONS:
        return {}
    from mixseq_io.gltf.animation import animation_choices

    return animation_choices(path)


def each_animation(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command to run once for every animation of SOURCE with ``--animation all``."""

    @wraps(command)
    def run(**values: Any) -> None:
        reading, source, target, claim = (values[name] for name in ("reading", "source", "target", "claim"))
        if reading.get("animation") != ALL_ANIMATIONS:
            command(**values)
            return
        choices = animations_of(source)
        if not choices:
            raise SettingsError(f"{source} has no animations to choose from; leave out --animation all")
        named = re.match(r"(.*?)([-_. ]*(?:#+|%\d*d).*|\.[^.]*)$", target.name)
        before, after = named.groups() if named else (target.name, "")
        targets = {
            choice: target.with_name(f"{before}{label and '-'}{label}{after}") for label, choice in choices.items()
        }
        replace(claim, given=(source,))(*targets.values())
        for choice, path in targets.items():
            given = tuple(path if file is target else file for file in claim.given)
            of_path = replace(claim, overwrite=True, given=given)
            command(**values | {"reading": reading | {"animation": choice}, "target": path, "claim": of_path})

    return run


def picture_path(target: Path, what: str, picture: Path | None = None, no_picture: bool = False) -> Path | None:
    """Return the path of the picture, by default next to the target and without the frame number of numbered files."""
    if picture is None:
        stem = re.sub(r"[-_. ]*(#+|\*+|%\d*d)", "", target.stem)
        return None if no_picture else target.with_name("-".join(filter(None, (stem, f"{what}.png"))))
    if no_picture:
        raise SettingsError("--picture and --no-picture exclude each other")
    return picture


def check_picture(picture: Path) -> None:
    """Raise an error before the work if a picture has an unsupported extension or the drawing library is missing."""
    from mixseq.pictures.charts import import_matplotlib

    if picture.suffix.lower() != ".png":
        raise OutputError(f"{picture}: the picture is a PNG file; end the name in .png")
    import_matplotlib("figure")
