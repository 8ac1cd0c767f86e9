"""The assets of a batch and their results: found in folders, named, and stored as JSON and as Markdown."""

from __future__ import annotations

import json
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from hashlib import sha256
from html import escape
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

from mixseq.cli.files import ALL_ANIMATIONS, animations_of, is_model, options_of
from mixseq.cli.formats import as_markdown
from mixseq.cli.group import format_bytes, length_text, printable
from mixseq.cli.options import READING_OPTIONS
from mixseq.errors import FormatError, MissingFileError, MixseqWarning, OutputError
from mixseq.version import __version__

TABLE_HEADINGS = ("asset", "frames", "vertices", "time", "max error", "KG error", "size", "bits", "")

_INPUTS = ("source", "animation", "target", "source_bytes", "source_signature", "settings")
"""Fields of an `Entry` on which its result depends."""

Settings = Mapping[str, Any]
"""JSON values: the name of the job, its other arguments, its options by parameter name, and a hash of files in them."""


@dataclass(frozen=True)
class Entry:
    """An asset, and the result of its job."""

    # File, or pattern of numbered files; paths are absolute, as other processes may have a different working directory.
    source: str
    target: str  # path of the file to write
    source_bytes: int  # total size of the source files
    source_signature: str  # hash of the names, sizes and modification times of the source files
    settings: Settings  # the job and its options
    state: Literal["done", "failed", "left"] = "left"  # left: not started
    animation: str = ""  # choice of the animation, of several in a glTF file
    frames: int | None = None  # number of frames written
    vertices: int | None = None  # number of vertices
    seconds: float | None = None  # duration of the job
    max_error: float | None = None  # largest vertex error of an encoded model, in diagonals
    diagonal: float | None = None  # diagonal of the first frame, in metres
    kg_percent: float | None = None  # Karni-Gotsman error
    bytes: int | None = None  # size of the written files
    target_signature: str | None = None  # hash of the names, sizes and modification times of the last files written
    bits: float | None = None  # size in bits per vertex and frame
    history: str = ""  # what the model comes from and how far it is from it, see `mixseq.sequence.provenance`
    message: str = ""  # reason of a failure
    output: tuple[str, ...] = ()  # lines that the command printed
    warnings: tuple[str, ...] = field(default=())  # warnings of the command

    @property
    def path(self) -> Path:
        """Path of the file to write."""
        return Path(self.target)

    @property
    def name(self) -> str:
        """Name of the asset in reports."""
        return self.path.stem

    @property
    def verdict(self) -> str:
        """Judgement of the result by the command, the first row of its table; empty for commands that do not judge."""
        first, *rest = self.output or ("",)
        label, _, text = first.partition("  ")
        wrapped = takewhile(lambda line: line.startswith("  "), rest)
        return " ".join(map(str.strip, [text, *wrapped])) if label == "verdict" else ""

    def arguments(self) -> list[str]:
        """Return the arguments of the command for this asset."""
        chosen = dict(self.settings["options"])
        if self.animation or chosen.get("animation") == [f"--animation={ALL_ANIMATIONS}"]:
            chosen["animation"] = [f"--animation={self.animation}"] * bool(self.animation)
        supported = options_of(Path(self.source), dict.fromkeys(READING_OPTIONS.values()))
        left_out = {text for text, name in READING_OPTIONS.items() if name not in supported}
        texts = [text for each in chosen.values() for text in each if text.partition("=")[0] not in left_out]
        return [self.source, *self.settings["between"], self.target, *texts, "--overwrite"]

    def holds_for(self, asset: Entry) -> bool:
        """Return whether the entry is a valid result: equal source and settings, and the file still exists."""
        is_same = all(getattr(self, name) == getattr(asset, name) for name in _INPUTS)
        return self.state == "done" and is_same and self.is_unchanged()

    def is_unchanged(self) -> bool:
        """Return whether the file has the size and modification time that the batch has written."""
        written = files_of(self.path)
        return bool(written) and size_and_hash(written)[1] == self.target_signature


def find_sources(paths: Iterable[Path], reads: Sequence[str] = ("sequences",)) -> list[Path]:
    """Return the distinct absolute paths of assets: the given files and patterns, and those in folders.

    Sequences in a folder are files in sequence formats and numbered files; subfolders are not searched. The meshes of
    point caches are skipped; other single meshes are skipped with a warning.
    """
    sources: dict[Path, None] = {}
    for path in paths:
        candidates = sorted(_assets_in(path, reads)) if path.is_dir() else [path]
        if not candidates:
            what = " or ".join(reads)
            raise FormatError(f"{path}: there are no {what} in this folder; `mixseq formats` lists what can be read")
        for source in candidates:
            if not files_of(source):
                raise MissingFileError(f"{source} does not exist")
            sources[source.parent.resolve() / source.name] = None
    return list(sources)


def files_of(source: Path) -> list[Path]:
    """Return the file, numbered files or files in a folder of a sequence; an empty list if no file exists."""
    from mixseq_io.numbered.files import find_numbered_files

    if source.is_dir():
        return [file for file in source.iterdir() if file.is_file()]
    return [source] if source.exists() else [file for _, file in find_numbered_files(source)]


def plan(
    sources: Sequence[Path], out: Path, earlier: Iterable[Entry], settings: Settings, extension: str | None = None
) -> tuple[Entry, ...]:
    """Choose paths to write: ``walk.h5`` for ``walk.usdc``, or ``walk.usdc.h5`` if several assets are named walk."""
    wanted = {
        (str(source), choice, extension or source.suffix.lower()): f"{stem_of(source)}{label and '-'}{label}"
        for source in sources
        for label, choice in _animations_to_read(source, settings).items()
    }
    names = {(each.source, each.animation, each.path.suffix): each.path.name for each in earlier}
    taken = {name.casefold() for name in names.values()}
    stems = Counter(stem.casefold() for key, stem in wanted.items() if key not in names)
    owners = {name.casefold(): key for key, name in names.items() if key not in wanted}
    assets = []
    for key, stem in wanted.items():
        source, choice, suffix = key
        is_unique = stems[stem.casefold()] == 1 and _file_name(stem, suffix).casefold() not in taken
        name = names.get(key) or _file_name(stem if is_unique else f"{stem}{Path(source).suffix}", suffix)
        other = owners.setdefault(name.casefold(), key)
        if other != key:
            raise OutputError(
                f"{source} and {other[0]} would both be written to {out / name}; give one of them another --out"
            )
        target = out.resolve() / name
        if target in sources:
            raise OutputError(f"{target} is a source itself and would be lost; give another --out")
        assets.append(Entry(source, str(target), *size_and_hash(files_of(Path(source))), settings, animation=choice))
    return tuple(assets)


def _animations_to_read(source: Path, settings: Settings) -> dict[str, str]:
    """Return a label and a choice for every animation to read from an asset; both are empty unless all are wanted."""
    if settings["options"].get("animation") == [f"--animation={ALL_ANIMATIONS}"]:
        with suppress(FormatError):  # the asset fails when it is read
            return animations_of(source) or {"": ""}
    return {"": ""}


def _file_name(stem: str, suffix: str) -> str:
    from mixseq_io.registry import FORMATS

    is_numbered = any(form.numbered and suffix in form.extensions for form in FORMATS)
    return f"{stem}{'_####' * is_numbered}{suffix}"


def size_and_hash(files: Iterable[Path]) -> tuple[int, str]:
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


def _assets_in(folder: Path, reads: Sequence[str]) -> Iterator[Path]:
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
            if ("models" if _is_model(file) else "sequences") in reads:
                if "mesh" in form.read_options:
                    caches.add(file.stem)
                yield file
        elif "sequences" in reads:
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
    """Entries by the path that they write, and whether the batch is complete."""

    entries: Mapping[str, Entry]
    finished: bool = False

    def with_entry(self, entry: Entry) -> Report:
        """Return the report with the given entry replaced or added."""
        return replace(self, entries={**self.entries, entry.target: entry})

    def of(self, assets: Iterable[Entry]) -> Report:
        """Return the report of the given assets only, in the given order."""
        return replace(self, entries={asset.target: self.entries[asset.target] for asset in assets})

    def without_lost(self) -> Report:
        """Return the report without entries whose source files no longer exist; what they wrote is not deleted."""
        kept = {target: entry for target, entry in self.entries.items() if files_of(Path(entry.source))}
        return replace(self, entries=kept)

    def of_others(self, assets: Iterable[Entry], folder: Path) -> list[Path]:
        """Return files that the batch would replace in a folder, but did not write itself or were modified since."""
        replaced = [folder / asset.path.name for asset in assets if files_of(asset.path) and not self._made(asset)]
        table = folder / "report.md"
        return replaced + [table] * (table.exists() and not (folder / "report.json").exists())

    def _made(self, asset: Entry) -> bool:
        """Return whether the file of an asset is unchanged since a batch wrote it."""
        entry = self.entries.get(asset.target)
        return entry is not None and (entry.state == "left" or entry.is_unchanged())

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
        raise FormatError(f"{path} is damaged; delete it, and everything is done again") from error
    return Report({entry.target: entry for entry in entries}, bool(stored.get("finished")))


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
    """Return the headings and rows of a table of entries, with those columns of `TABLE_HEADINGS` that are not empty."""

    def shown(value: float | None, form: str) -> str:
        return "" if value is None else form.format(value)

    table = [
        (
            entry.name,
            shown(entry.frames, "{:,}"),
            shown(entry.vertices, "{:,}"),
            shown(entry.seconds, "{:.1f} s"),
            ""
            if entry.max_error is None or entry.diagonal is None
            else length_text(entry.max_error, entry.diagonal, digits=2),
            shown(entry.kg_percent, "{:.2g} %"),
            "" if entry.bytes is None else format_bytes(entry.bytes),
            shown(entry.bits, "{:.3g}"),
            {"done": entry.verdict, "failed": f"failed: {entry.message}", "left": "left"}[entry.state],
        )
        for entry in entries
    ]
    used = [index for index in range(len(TABLE_HEADINGS)) if index == 0 or any(row[index] for row in table)]
    return [tuple(row[index] for index in used) for row in (TABLE_HEADINGS, *table)]


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
        as_markdown(cells),
        "",
        "Errors are those of all decoded frames: the largest of a vertex, and the one of Karni and Gotsman. Bits are",
        "per vertex and frame.",
    ]
    lines += [_plain(f"- {each.name}: {each.history}") for each in entries if ", which" in each.history]
    messages = [_plain(f"- {entry.name}: {each}") for entry in entries for each in entry.warnings]
    return "\n".join([*lines, *(["", "## Warnings", "", *messages] if messages else [])]) + "\n"


def _plain(text: str) -> str:
    """Escape control characters, and HTML, which Markdown passes through."""
    return escape(printable(text), quote=False)
