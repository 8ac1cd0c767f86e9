"""The report of a batch, with the result of every asset: in JSON, for resuming the batch, and in Markdown."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from mixseq.cli.batch.plan import Asset, files_of
from mixseq.cli.console import format_bytes, printable
from mixseq.cli.formats import as_markdown
from mixseq.errors import FormatError
from mixseq.version import __version__

HEADING = ("asset", "frames", "vertices", "time", "max error", "KG error", "size", "bits", "")


@dataclass(frozen=True)
class Entry:
    """The result of an asset."""

    source: str  # absolute path of the sequence, or pattern of its numbered files
    target: str  # absolute path of the model
    source_bytes: int  # size of the source, all of its files together
    source_signature: str  # hash of the names, sizes and modification times of its files
    settings: Mapping[str, Any]  # settings of the encoding
    state: Literal["done", "failed", "left"] = "left"  # left: not started
    frames: int | None = None  # number of frames
    vertices: int | None = None  # number of vertices
    seconds: float | None = None  # time of encoding, without the check
    max_error: float | None = None  # largest error of a vertex in diagonals, decoded
    kg_percent: float | None = None  # Karni-Gotsman error
    bytes: int | None = None  # size of the model
    bits: float | None = None  # the same in bits per vertex and frame
    message: str = ""  # why it failed
    warnings: tuple[str, ...] = field(default=())  # warnings while reading

    @classmethod
    def of(cls, asset: Asset, settings: Mapping[str, Any], **result: Any) -> Entry:
        """Make the entry of an asset."""
        return cls(str(asset.source), str(asset.target), asset.size, asset.signature, settings, **result)

    def holds_for(self, asset: Asset, settings: Mapping[str, Any]) -> bool:
        """Return whether the asset is done: same source and settings, and the model still exists."""
        same = Entry.of(asset, settings)
        told = ("source", "target", "source_bytes", "source_signature", "settings")
        return (
            self.state == "done"
            and all(getattr(self, name) == getattr(same, name) for name in told)
            and asset.target.is_file()
            and asset.target.stat().st_size == self.bytes
        )


@dataclass(frozen=True)
class Report:
    """Entries by their sources, and whether the batch is complete."""

    entries: Mapping[str, Entry]
    finished: bool = False

    def with_entry(self, entry: Entry) -> Report:
        """Return the report with an entry replaced or added."""
        return replace(self, entries={**self.entries, entry.source: entry})

    def of(self, assets: Iterable[Asset]) -> Report:
        """Return the report of these assets only, in their order."""
        return replace(self, entries={key: self.entries[key] for key in (str(a.source) for a in assets)})

    def without_lost(self) -> Report:
        """Return the report without entries whose source is gone; their models are kept."""
        return replace(
            self, entries={key: entry for key, entry in self.entries.items() if files_of(Path(key))}
        )

    def of_others(self, assets: Iterable[Asset], folder: Path) -> list[Path]:
        """Return files in a folder that the batch would replace, but did not make, or that changed since."""
        found = [
            folder / asset.target.name for asset in assets if asset.target.exists() and not self._made(asset)
        ]
        table = folder / "report.md"
        return found + [table] * (table.exists() and not (folder / "report.json").exists())

    def _made(self, asset: Asset) -> bool:
        """Return whether the model of an asset is unchanged since a batch wrote it."""
        entry = self.entries.get(str(asset.source))
        return (
            entry is not None
            and entry.target == str(asset.target)
            and (entry.state != "done" or asset.target.stat().st_size == entry.bytes)
        )

    def count(self, state: str) -> int:
        """Return the number of entries in a state."""
        return sum(entry.state == state for entry in self.entries.values())

    def summary(self) -> str:
        """Return one line about all entries."""
        return ", ".join(
            f"{self.count(state)} {state}" for state in ("done", "failed", "left") if self.count(state)
        )


def read_report(folder: Path) -> Report:
    """Read the report in a folder; empty if there is none."""
    path = folder / "report.json"
    if not path.exists():
        return Report({})
    known = {each.name for each in fields(Entry)}
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        entries = [
            Entry(**{key: value for key, value in asset.items() if key in known})
            for asset in stored["assets"]
        ]
        rows(entries)  # raises an error for damaged entries
        if not all(isinstance(each, str) for entry in entries for each in (entry.source, entry.target)):
            raise TypeError("a path is no text")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FormatError(f"{path} is damaged; delete it, and everything is encoded again") from error
    return Report({entry.source: entry for entry in entries}, bool(stored.get("finished")))


def write_report(folder: Path, report: Report) -> None:
    """Write ``report.json`` and ``report.md``, each atomically."""
    from mixseq_io.atomic import replacing

    stored = {
        "mixseq": __version__,
        "finished": report.finished,
        "assets": [asdict(entry) for entry in report.entries.values()],
    }
    for name, text in (
        ("report.json", json.dumps(stored, indent=2) + "\n"),
        ("report.md", in_markdown(report)),
    ):
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def rows(entries: Iterable[Entry]) -> list[tuple[str, ...]]:
    """Return the rows of the table under `HEADING`."""
    return [_row(entry) for entry in entries]


def _row(entry: Entry) -> tuple[str, ...]:
    def shown(value: float | None, form: str) -> str:
        return "" if value is None else form.format(value)

    return (
        Path(entry.target).stem,
        shown(entry.frames, "{:,}"),
        shown(entry.vertices, "{:,}"),
        shown(entry.seconds, "{:.1f} s"),
        shown(entry.max_error, "{:.2g}"),
        shown(entry.kg_percent, "{:.2g} %"),
        "" if entry.bytes is None else format_bytes(entry.bytes),
        shown(entry.bits, "{:.3g}"),
        {"done": "", "failed": f"failed: {entry.message}", "left": "left"}[entry.state],
    )


def in_markdown(report: Report) -> str:
    """Return the report in Markdown."""
    entries = list(report.entries.values())
    again = "" if report.finished else " Not finished: the same command goes on with what is left."
    cells = [[printable(cell).replace("|", "\\|") for cell in row] for row in rows(entries)]
    lines = [
        "# Batch",
        "",
        f"{len(entries)} assets: {report.summary()}.{again}",
        "",
        as_markdown([HEADING, *cells]),
        "",
        "Times are those of encoding. Errors are of all decoded frames: the largest of a vertex in diagonals, and the",
        "one of Karni and Gotsman. Bits are per vertex and frame.",
    ]
    told = [printable(f"- {Path(entry.target).stem}: {each}") for entry in entries for each in entry.warnings]
    return "\n".join([*lines, *(["", "## Warnings", "", *told] if told else [])]) + "\n"
