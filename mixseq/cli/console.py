"""Output of commands: tables and finished files on stdout, progress on stderr.

Names in files are untrusted: they must not move the cursor, colour or rename the terminal, or reverse the rest of a
line. So all output goes through `printable`; JSON has escapes of its own.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from mixseq.progress import Progress, silent

_CONTROLS = re.compile(
    "[\x00-\x1f\x7f-\x9f"  # C0, DEL and C1
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # of bidirectional text
    "\u2028\u2029\ud800-\udfff]"  # ends of lines and paragraphs; halves of characters
)


def printable(text: str) -> str:
    """Return text with all control and formatting characters escaped."""
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def say(text: str, err: bool = False) -> None:
    """Print a line, on stdout or stderr."""
    click.echo(printable(text), err=err)


def print_table(rows: Iterable[Sequence[str]], heading: Sequence[str] | None = None) -> None:
    """Print rows of text in columns: coloured on a terminal, aligned plain text elsewhere."""
    lines = [[printable(cell) for cell in row] for row in rows]
    if sys.stdout.isatty():
        _print_rich(lines, heading)
        return
    if heading:
        lines.insert(0, list(heading))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for line in lines:
        cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        say("  ".join(cells).rstrip())


def _print_rich(rows: list[list[str]], heading: Sequence[str] | None) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD if heading else None, show_header=bool(heading), pad_edge=False)
    for number, name in enumerate(heading or rows[0]):
        table.add_column(name, style="cyan" if number == 0 else None, overflow="fold")
    for row in rows:
        table.add_row(*row)
    # Names in files are data: brackets and colons in them are not markup.
    Console(markup=False, emoji=False, highlight=False).print(table)


def print_json(data: dict[str, Any]) -> None:
    """Print data as JSON."""
    click.echo(json.dumps(data, indent=2, allow_nan=False))


def announce(path: Path) -> None:
    """Print that a file is written, and which others it needs."""
    size = f" ({format_bytes(path.stat().st_size)})" if path.is_file() else ""
    say(f"wrote {click.format_filename(path)}{size}{needed(path)}")


def needed(path: Path) -> str:
    """Return the files that a USD file depends on, "" if there are none."""
    if path.suffix.lower() not in (".usd", ".usda", ".usdc"):
        return ""
    from mixseq_io.usd.paths import clips_of, sublayer_of

    below, clips = sublayer_of(path), clips_of(path)
    over = f", a layer over {below}" if below else ""
    if not clips:
        return over
    size = format_bytes(sum(file.stat().st_size for file in clips))
    return f"{over}, with {len(clips)} files ({size}) in {click.format_filename(clips[0].parent.name)}"


def format_bytes(count: float) -> str:
    """Format a size in the largest fitting unit.

    >>> format_bytes(999), format_bytes(1_234_567)
    ('999 bytes', '1.23 MB')
    """
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count:.0f} bytes"


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress]:
    """Show the progress of work, if stderr is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def tell(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=printable(what))

        yield tell
