"""``mixseq batch``: find sequences, encode them locally or on a cluster, and update a report after every asset.

The report is written as JSON, for resuming the batch, and as Markdown.
"""

from __future__ import annotations

import json
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields, replace
from hashlib import sha256
from html import escape
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.encode import aiming, compressed
from mixseq.cli.files import Claim, check_options, decoded, is_model, options_of, overwriting
from mixseq.cli.formats import as_markdown
from mixseq.cli.group import format_bytes, length_text, print_table, printable, progress_bar, say
from mixseq.cli.options import in_diagonals
from mixseq.errors import (
    FormatError,
    GivenUpError,
    MissingFileError,
    MixseqError,
    MixseqWarning,
    OutputError,
    SettingsError,
)
from mixseq.runtime.progress import Progress, log_progress
from mixseq.version import __version__

if TYPE_CHECKING:
    from mixseq.runtime.cluster import ClusterExecutor
    from mixseq.runtime.parallel import Executor


TABLE_HEADINGS = ("asset", "frames", "vertices", "time", "max error", "KG error", "size", "bits", "")

_INPUTS = ("source", "target", "source_bytes", "source_signature", "settings")
"""Fields of an `Entry` on which its result depends."""

Settings = Mapping[str, Any]
"""JSON settings of `mixseq.fit`, with `mixseq.compress` settings in ``aim`` and reader settings in ``reading``."""


@dataclass(frozen=True)
class Entry:
    """A sequence to encode, and the result."""

    # File, or pattern of numbered files; paths are absolute, as other processes may have a different working directory.
    source: str
    target: str  # path of the model to write
    source_bytes: int  # total size of the source files
    source_signature: str  # hash of the names, sizes and modification times of the source files
    settings: Settings  # settings of the encoding
    state: Literal["done", "failed", "left"] = "left"  # left: not started
    frames: int | None = None  # number of frames
    vertices: int | None = None  # number of vertices
    seconds: float | None = None  # duration of the encoding, without the comparison
    max_error: float | None = None  # largest vertex error of the decoded model, in diagonals
    diagonal: float | None = None  # diagonal of the first frame, in metres
    kg_percent: float | None = None  # Karni-Gotsman error
    bytes: int | None = None  # size of the model
    target_signature: str | None = None  # hash of the name, size and modification time of the last model written
    bits: float | None = None  # size of the model in bits per vertex and frame
    history: str = ""  # what the model comes from and how far it is from it, see `mixseq.sequence.provenance`
    message: str = ""  # reason of a failure
    warnings: tuple[str, ...] = field(default=())  # warnings while reading

    @property
    def model(self) -> Path:
        """Path of the model."""
        return Path(self.target)

    def holds_for(self, asset: Entry) -> bool:
        """Return whether the entry is a valid result: equal source and settings, and the model still exists."""
        is_same = all(getattr(self, name) == getattr(asset, name) for name in _INPUTS)
        return self.state == "done" and is_same and self.is_unchanged()

    def is_unchanged(self) -> bool:
        """Return whether the model has the size and modification time that the batch has written."""
        return self.model.is_file() and _size_and_hash([self.model])[1] == self.target_signature


def find_sources(paths: Iterable[Path]) -> list[Path]:
    """Return the distinct absolute paths of sequences: the given files and patterns, and the sequences in folders.

    Sequences in a folder are files in sequence formats and numbered files; subfolders are not searched. Models and the
    meshes of point caches are skipped; other single meshes are skipped with a warning.
    """
    sources: dict[Path, None] = {}
    for path in paths:
        candidates = sorted(_sequences_in(path)) if path.is_dir() else [path]
        if not candidates:
            raise FormatError(f"{path}: there are no sequences in this folder; `mixseq formats` lists what can be read")
        for source in candidates:
            if not files_of(source):
                raise MissingFileError(f"{source} does not exist")
            sources[source.parent.resolve() / source.name] = None
    return list(sources)


def files_of(source: Path) -> list[Path]:
    """Return the file or numbered files of a sequence; return an empty list if no file exists."""
    from mixseq_io.numbered.files import find_numbered_files

    return [source] if source.exists() else [file for _, file in find_numbered_files(source)]


def plan(sources: Sequence[Path], out: Path, names: Mapping[str, str], settings: Settings) -> tuple[Entry, ...]:
    """Choose model paths: ``walk.h5`` for ``walk.usdc``, or ``walk.usdc.h5`` if several sources are named walk."""
    taken = {name.casefold() for name in names.values()}
    stems = Counter(stem_of(source).casefold() for source in sources if str(source) not in names)
    owners: dict[str, Path | str] = {
        name.casefold(): other for other, name in names.items() if Path(other) not in set(sources)
    }
    assets = []
    for source in sources:
        stem = stem_of(source)
        is_unique = stems[stem.casefold()] == 1 and f"{stem}.h5".casefold() not in taken
        name = names.get(str(source)) or (f"{stem}.h5" if is_unique else f"{stem}{source.suffix}.h5")
        other = owners.setdefault(name.casefold(), source)
        if other is not source:
            raise OutputError(
                f"{source} and {other} would both be written to {out / name}; give one of them another --out"
            )
        target = out.resolve() / name
        if target in sources:
            raise OutputError(f"{target} is a source itself and would be lost; give another --out")
        assets.append(Entry(str(source), str(target), *_size_and_hash(files_of(source)), settings))
    return tuple(assets)


def _size_and_hash(files: Iterable[Path]) -> tuple[int, str]:
    """Return the total size of files, and a hash of their names, sizes and modification times."""
    states = sorted((file.name, (state := file.stat()).st_size, state.st_mtime_ns) for file in files)
    return sum(size for _, size, _ in states), sha256(repr(states).encode()).hexdigest()


def stem_of(source: Path) -> str:
    """Return the name of a sequence without frame numbers, or the name of its folder if only a number is there.

    >>> [stem_of(Path("shots") / name) for name in ("walk.usdc", "run_####.obj", "%04d.ply")]
    ['walk', 'run', 'shots']
    """
    from mixseq_io.numbered.files import is_pattern

    if source.is_dir():
        return source.name
    if not is_pattern(source):
        return source.stem
    return re.sub(r"[ ._-]*(#+|%\d*d)", "", source.stem) or source.parent.name


def _sequences_in(folder: Path) -> Iterator[Path]:
    from mixseq_io.numbered.files import group_numbered_files
    from mixseq_io.registry import FORMATS

    formats = {extension: form for form in FORMATS for extension in form.extensions}
    caches = set()
    numbered = []
    for file in sorted(folder.iterdir()):
        form = formats.get(file.suffix.lower())
        if form is None or file.name.startswith(".") or not file.is_file():
            continue
        if not form.numbered:
            if not _is_model(file):
                if "mesh" in form.read_options:
                    caches.add(file.stem)
                yield file
        else:
            numbered.append(file)
    single = []
    for pattern, files in group_numbered_files(numbered):
        if len(files) > 1:
            yield folder / pattern
        else:
            single.append(files[0][1].name)
    left_out = [name for name in single if Path(name).stem not in caches]
    if left_out:
        shown = ", ".join(left_out[:5]) + (f" and {len(left_out) - 5} more" if len(left_out) > 5 else "")
        warnings.warn(
            f"{folder}: single meshes are no sequences and are left out: {shown}", MixseqWarning, stacklevel=2
        )


def _is_model(file: Path) -> bool:
    """Return whether a file is a model; an unreadable file counts as a sequence, whose encoding fails."""
    with suppress(FormatError):
        return is_model(file)
    return False


@dataclass(frozen=True)
class Report:
    """Entries by source path, and whether the batch is complete."""

    entries: Mapping[str, Entry]
    finished: bool = False

    def with_entry(self, entry: Entry) -> Report:
        """Return the report with the given entry replaced or added."""
        return replace(self, entries={**self.entries, entry.source: entry})

    def of(self, assets: Iterable[Entry]) -> Report:
        """Return the report of the given assets only, in the given order."""
        return replace(self, entries={asset.source: self.entries[asset.source] for asset in assets})

    def without_lost(self) -> Report:
        """Return the report without entries whose source files no longer exist; their models are not deleted."""
        return replace(self, entries={key: entry for key, entry in self.entries.items() if files_of(Path(key))})

    def of_others(self, assets: Iterable[Entry], folder: Path) -> list[Path]:
        """Return files that the batch would replace in a folder, but did not write itself or were modified since."""
        replaced = [folder / asset.model.name for asset in assets if asset.model.exists() and not self._made(asset)]
        table = folder / "report.md"
        return replaced + [table] * (table.exists() and not (folder / "report.json").exists())

    def _made(self, asset: Entry) -> bool:
        """Return whether the model of an asset is unchanged since a batch wrote it."""
        entry = self.entries.get(asset.source)
        return entry is not None and entry.target == asset.target and (entry.state == "left" or entry.is_unchanged())

    def count(self, state: str) -> int:
        """Return the number of entries in a state."""
        return sum(entry.state == state for entry in self.entries.values())

    def summary(self) -> str:
        """Return one line about all entries."""
        return ", ".join(f"{self.count(state)} {state}" for state in ("done", "failed", "left") if self.count(state))


def read_report(folder: Path) -> Report:
    """Read the report in a folder; return an empty report if there is no file."""
    path = folder / "report.json"
    if not path.exists():
        return Report({})
    names = {each.name for each in fields(Entry)}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        entries = [Entry(**{key: value for key, value in asset.items() if key in names}) for asset in stored["assets"]]
        rows(entries)  # raises an error for damaged entries
        if not all(isinstance(each, str) for entry in entries for each in (entry.source, entry.target)):
            raise TypeError("a path is no text")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path} is damaged; delete it, and everything is encoded again") from error
    return Report({entry.source: entry for entry in entries}, bool(stored.get("finished")))


def write_report(folder: Path, report: Report) -> None:
    """Write ``report.json`` and ``report.md``, each atomically."""
    from mixseq_io.files import atomic_file

    stored = {
        "mixseq": __version__,
        "finished": report.finished,
        "assets": [asdict(entry) for entry in report.entries.values()],
    }
    for name, text in (
        ("report.json", json.dumps(stored, indent=2) + "\n"),
        ("report.md", in_markdown(report)),
    ):
        with atomic_file(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def rows(entries: Iterable[Entry]) -> list[tuple[str, ...]]:
    """Return the table rows of entries, with the columns of `TABLE_HEADINGS`."""

    def shown(value: float | None, form: str) -> str:
        return "" if value is None else form.format(value)

    return [
        (
            entry.model.stem,
            shown(entry.frames, "{:,}"),
            shown(entry.vertices, "{:,}"),
            shown(entry.seconds, "{:.1f} s"),
            ""
            if entry.max_error is None or entry.diagonal is None
            else length_text(entry.max_error, entry.diagonal, digits=2),
            shown(entry.kg_percent, "{:.2g} %"),
            "" if entry.bytes is None else format_bytes(entry.bytes),
            shown(entry.bits, "{:.3g}"),
            {"done": "", "failed": f"failed: {entry.message}", "left": "left"}[entry.state],
        )
        for entry in entries
    ]


def in_markdown(report: Report) -> str:
    """Return the report in Markdown."""
    entries = list(report.entries.values())
    again = "" if report.finished else " Not finished: the same command goes on with what is left."
    cells = [[_plain(cell).replace("|", "\\|") for cell in row] for row in rows(entries)]
    lines = [
        "# Batch",
        "",
        f"{len(entries)} assets: {report.summary()}.{again}",
        "",
        as_markdown([TABLE_HEADINGS, *cells]),
        "",
        "Times are those of encoding. Errors are of all decoded frames: the largest of a vertex, and the one of Karni",
        "and Gotsman. Bits are per vertex and frame.",
    ]
    lines += [_plain(f"- {each.model.stem}: {each.history}") for each in entries if ", which" in each.history]
    messages = [_plain(f"- {entry.model.stem}: {each}") for entry in entries for each in entry.warnings]
    return "\n".join([*lines, *(["", "## Warnings", "", *messages] if messages else [])]) + "\n"


def _plain(text: str) -> str:
    """Escape control characters, and HTML, which Markdown passes through."""
    return escape(printable(text), quote=False)


Work = Callable[[Sequence[Entry]], Iterator[tuple[Entry, Callable[[], Entry]]]]
"""Function that encodes assets and yields each finished asset with a function that returns its result."""


def run(assets: Iterable[Entry], earlier: Report, out: Path, work: Work, force: bool) -> Report:
    """Encode the assets without valid results, and return the report; write it at the start and after every asset."""
    with _alone(out):
        pending = []
        entries: dict[str, Entry] = {}
        for asset in assets:
            before = earlier.entries.get(asset.source)
            if before is None or force or not before.holds_for(asset):
                before = replace(asset, target_signature=before.target_signature if before else None)
                pending.append(before)
            entries[asset.source] = before
        report = Report(entries | {key: entry for key, entry in earlier.entries.items() if key not in entries})
        write_report(out, report)
        for asset, result in work(pending):
            report = report.with_entry(_entry(asset, result))
            write_report(out, report)
        report = replace(report, finished=not report.of(entries.values()).count("left"))
        write_report(out, report)
        return report


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Lock a folder while a batch writes there; the system releases the lock if the process dies."""
    try:
        import fcntl
    except ImportError:  # Windows has no such locks
        yield
        return
    folder = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(folder)
        raise OutputError(f"{out}: another batch is writing here; wait for it, or give another --out") from None
    try:
        yield
    finally:
        os.close(folder)


def _entry(asset: Entry, result: Callable[[], Entry]) -> Entry:
    try:
        entry = result()
    except GivenUpError as error:
        entry = replace(asset, state="failed", message=str(error))
    if entry.state == "failed" and asset.model.exists():
        return replace(entry, message=f"{entry.message}; an older model is left at {asset.model.name}")
    return entry


def in_turn(workers: Executor, progress: Progress) -> Work:
    """Return a function that encodes assets locally, one after the other, with frames distributed over `workers`."""

    def work(assets: Sequence[Entry]) -> Iterator[tuple[Entry, Callable[[], Entry]]]:
        for number, asset in enumerate(assets, start=1):
            place = f"asset {number} of {len(assets)}, {asset.model.stem}"
            entry = encode_asset(workers, asset, _naming(place, progress))
            yield asset, lambda entry=entry: entry  # type: ignore[misc]

    return work


def on_cluster(cluster: ClusterExecutor, progress: Progress) -> Work:
    """Return a function that encodes assets on a cluster, with one worker per asset."""

    def work(assets: Sequence[Entry]) -> Iterator[tuple[Entry, Callable[[], Entry]]]:
        progress(0, len(assets), "encoding assets")
        for done, item in enumerate(cluster.as_completed(encode_asset, None, assets), start=1):
            yield item
            progress(done, len(assets), "encoding assets")

    return work


def _naming(place: str, progress: Progress) -> Progress:
    return lambda done, total, what: progress(done, total, f"{place}: {what}")


def encode_asset(workers: Executor | None, asset: Entry, progress: Progress = log_progress) -> Entry:
    """Encode an asset, compare the decoded model with it, and move the model to its path; store errors in the entry."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", MixseqWarning)
            result = _encode(asset, workers, progress)
        messages = tuple(str(each.message) for each in caught if issubclass(each.category, MixseqWarning))
        return replace(asset, state="done", warnings=messages, **result)
    except MixseqError as error:
        message = str(error)
    except OSError as error:
        message = f"{error.filename or asset.source}: {error.strerror or error}"
    except MemoryError:
        message = "there is not enough memory"
    except Exception as error:
        # A bug in mixseq; the batch continues with the next asset.
        message = f"a bug in mixseq, {type(error).__name__}: {error}; `mixseq encode` prints more, please report it"
    return replace(asset, state="failed", message=" ".join(message.split()))


def _encode(asset: Entry, workers: Executor | None, progress: Progress) -> dict[str, Any]:
    from mixseq.runtime.parallel import serial_executor
    from mixseq_io.files import atomic_file

    mapped, settings, source = workers or serial_executor, asset.settings, Path(asset.source)
    reading = options_of(source, settings["reading"])
    fitting = {name: value for name, value in settings.items() if name not in ("reading", "aim")}
    with mixseq.open_sequence(source, **reading) as reader, atomic_file(asset.model) as file:
        start = perf_counter()
        if "aim" in settings:
            mixseq.save(file, compressed(reader, settings["aim"], progress))
        else:
            fitting = in_diagonals(fitting, reader, "tolerance")
            mixseq.save(file, mixseq.fit(reader, **fitting, progress=progress, workers=mapped))
        seconds = perf_counter() - start
        model = mixseq.load(file)
        error = mixseq.compare(reader, decoded(model, progress, mapped))
    size, signature = _size_and_hash([asset.model])
    return {
        "frames": error.frames,
        "vertices": error.vertices,
        "seconds": seconds,
        "max_error": error.as_dict()["max_error"],
        "diagonal": error.diagonal * reader.header.metres_per_unit,
        "kg_percent": error.as_dict()["kg_percent"],
        "history": str(model.header.provenance or ""),
        "bytes": size,
        "target_signature": signature,
        "bits": 8 * size / (error.frames * error.vertices),
    }


@options.command(
    "batch",
    "mixseq batch shots/*.usdc --out models",
    "mixseq batch shots --out models --tolerance 0.001",
    "mixseq batch shots --out small --max-error 0.001",
    "mixseq batch shots --out models --cluster tcp://host:8786",
)
@options.argument("caches", nargs=-1, required=True)
@options.option("--out FOLDER", required=True, help="Folder for models and report.")
@options.option("--force", is_flag=True, help="Encode everything again, also what is done.")
@aiming
@options.fitting
@options.workers
@options.reading
@overwriting
@options.quiet
def command(
    caches: tuple[Path, ...],
    out: Path,
    force: bool,
    aim: dict[str, Any],
    fitting: dict[str, Any],
    workers: AbstractContextManager[Executor],
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Turn many sequences into models, with one report.

    CACHES are sequences in any format, or folders of sequences. Each becomes a model in the output folder, is decoded
    and compared; report.json and report.md there are updated. If a sequence fails, the batch continues.

    After an interruption, run the same command again: it encodes only what is missing, failed or has changed. Files
    that no batch has made are replaced only with --overwrite, or if you agree on a terminal.

    With --max-error, --kg or --size every model is compressed, see "mixseq encode".
    """
    if len(options.given_options("exact", "tolerance", "rank")) > 1:
        raise SettingsError("--exact, --tolerance and --rank exclude each other; give one of them")
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file; give the name of a folder")
    from mixseq.runtime.cluster import ClusterExecutor

    read_with = {name: str(value.resolve()) if isinstance(value, Path) else value for name, value in reading.items()}
    settings = {**({"aim": aim} if aim else fitting), "reading": read_with}
    earlier = read_report(out).without_lost()
    names = {source: entry.model.name for source, entry in earlier.entries.items()}
    assets = plan(find_sources(caches), out, names, settings)
    check_options((Path(asset.source) for asset in assets), reading, "none of the sequences is")
    claim.permit(earlier.of_others(assets, out), unasked=False)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {out}: {error.strerror}; choose another one") from error
    with workers as mapped, progress_bar(quiet) as progress:
        work = on_cluster(mapped, progress) if isinstance(mapped, ClusterExecutor) else in_turn(mapped, progress)
        report = run(assets, earlier, out.resolve(), work, force)
    results = report.of(assets)
    if not quiet:
        print_table(rows(results.entries.values()), TABLE_HEADINGS)
    say(f"wrote {click.format_filename(out / 'report.md')} ({results.summary()})")
    if results.count("done") < len(assets):
        click.get_current_context().exit(1)
