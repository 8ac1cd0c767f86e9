"""Command group that imports commands on demand and reports errors in one line, without a traceback.

Exit codes:

====  ======================================================================
0     success
1     a pipe was closed by its reader, an asset of a batch failed, or a bound does not hold
2     an error that the user can fix
130   interrupted by Ctrl-C
129   its terminal was closed
143   terminated by a signal
====  ======================================================================

Any other error is a bug in mixseq and is reported with a traceback.

Commands print tables and the names of written files on stdout, and progress on stderr. Names in files are untrusted and
may contain control characters for the terminal, so all output is escaped by `printable`.
"""

from __future__ import annotations

import json
import os
import re
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mixseq.choices import UNITS
from mixseq.errors import MixseqError, MixseqWarning, SettingsError
from mixseq.runtime.interrupts import signals_as_exceptions
from mixseq.runtime.parallel import environment
from mixseq.runtime.progress import Progress, forward_warnings, log_progress

if TYPE_CHECKING:
    from mixseq.sequence.sequence import Frames

_CONTROL_CHARACTERS = re.compile(
    "[\x00-\x1f\x7f-\x9f"  # C0, DEL and C1
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # controls of bidirectional text
    "\u2028\u2029\ud800-\udfff]"  # line and paragraph separators; surrogates
)


MAX_TABLE_WIDTH = 100
"""Largest width of a table outside a terminal, in characters, if words are not longer."""

MIN_COLUMN_WIDTH = 10
"""Width in characters below which no column is narrowed."""


def printable(text: str) -> str:
    """Return text with all control and formatting characters escaped."""
    return _CONTROL_CHARACTERS.sub(lambda match: match[0].encode("unicode_escape").decode("ascii"), text)


def say(text: str, err: bool = False) -> None:
    """Print an escaped line on stdout, or on stderr if `err` is set."""
    click.echo(printable(text), err=err)


def print_table(rows: Iterable[Sequence[str]], heading: Sequence[str] | None = None) -> None:
    """Print rows of text in columns, with colours on a terminal and as aligned plain text elsewhere."""
    lines = [[printable(cell) for cell in row] for row in rows]
    if sys.stdout.isatty():
        _print_rich(lines, heading)
        return
    if heading:
        lines.insert(0, list(heading))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    words = [max(map(len, " ".join(column).split()), default=0) for column in zip(*lines, strict=True)]
    limits = [max(MIN_COLUMN_WIDTH, word) for word in (*words[:-1], 0)]  # a long word ends the line
    spare = [max(width - limit, 0) for width, limit in zip(widths, limits, strict=True)]
    while sum(widths) + 2 * len(widths) - 2 > MAX_TABLE_WIDTH and any(spare):
        column = max(range(len(widths)), key=lambda column: (spare[column] > 0, widths[column]))
        widths[column] -= 1
        spare[column] -= 1
    for line in lines:
        wrapped = [  # between words; paths stay whole
            textwrap.wrap(cell, width, break_long_words=False, break_on_hyphens=False) if len(cell) > width else [cell]
            for cell, width in zip(line, widths, strict=True)
        ]
        for cells in zip_longest(*wrapped, fillvalue=""):
            say("  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip())


def _print_rich(rows: list[list[str]], heading: Sequence[str] | None) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD if heading else None, show_header=bool(heading), pad_edge=False)
    for number, name in enumerate(heading or rows[0]):
        table.add_column(name, style="cyan" if number == 0 else None, overflow="fold")
    for row in rows:
        table.add_row(*row)
    # Brackets and colons in names from files must not be interpreted as markup.
    Console(markup=False, emoji=False, highlight=False).print(table)


def print_json(data: dict[str, Any]) -> None:
    """Print data as JSON."""
    click.echo(json.dumps(data, indent=2, allow_nan=False))


def announce(*paths: Path | None) -> None:
    """Print which files were written, and which other files they depend on."""
    for path in filter(None, paths):
        size = f" ({format_bytes(path.stat().st_size)})" if path.is_file() else ""
        say(f"wrote {click.format_filename(path)}{size}{needed(path)}")


def needed(path: Path) -> str:
    """Describe the files that a USD file depends on; return "" if there are none."""
    if path.suffix.lower() not in (".usd", ".usda", ".usdc"):
        return ""
    from mixseq_io.usd.stage import find_clips, find_sublayer

    below, clips = find_sublayer(path), find_clips(path)
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


def length_text(fraction: float, diagonal: float, digits: int = 4) -> str:
    """Format a fraction of a diagonal, with the corresponding length in brackets; `diagonal` is in metres.

    >>> length_text(0.0005, 1.8)
    '0.0005 diagonals (0.9 mm)'
    """
    metres = fraction * diagonal
    unit = next((name for name in ("km", "m", "cm", "mm") if metres >= UNITS[name]), "mm")
    return f"{fraction:.{digits}g} diagonals ({metres / UNITS[unit]:.3g} {unit})"


_LENGTH_PATTERN = re.compile(rf"(\d+\.?\d*(?:e[-+]?\d+)?|\.\d+(?:e[-+]?\d+)?)\s*({'|'.join(UNITS)}|)", re.IGNORECASE)


def parse_length(text: str) -> float | str:
    """Parse an option value: return a fraction of the diagonal as a number, a length with a unit as text.

    >>> parse_length("1e-3"), parse_length("0.5 mm")
    (0.001, '0.5mm')
    """
    match = _LENGTH_PATTERN.fullmatch(text.strip())
    if not match or not 0.0 < float(match[1]) < float("inf"):
        raise click.BadParameter(f"{text!r} is not a length above 0, such as 0.001 (of the diagonal) or 0.5mm")
    return f"{match[1]}{match[2].lower()}" if match[2] else float(match[1])


def in_diagonals(settings: Mapping[str, Any], frames: Frames, *names: str) -> dict[str, Any]:
    """Return settings with the named lengths converted to fractions of a sequence's unit of errors."""
    from mixseq.sequence.sequence import reference_diagonal

    converted = dict(settings)
    for name in names:
        length = settings.get(name)
        match = _LENGTH_PATTERN.fullmatch(length) if isinstance(length, str) else None
        if match is None:
            continue
        diagonal = reference_diagonal(frames.blocks(1)).length * frames.header.metres_per_unit
        if not diagonal > 0.0:
            raise SettingsError(
                f"{frames.header.name!r} has no size in any frame, so {length} is no fraction of it; give a "
                "sequence that is larger than a point"
            )
        converted[name] = float(match[1]) * UNITS[match[2]] / diagonal
    return converted


def in_diagonals_of_all(settings: Mapping[str, Any], sequences: Iterable[Frames]) -> dict[str, Any]:
    """Return settings with a length `max_error` converted to the smallest of its fractions of several sequences."""
    converted = (in_diagonals(settings, frames, "max_error") for frames in sequences)
    return min(converted, key=lambda settings: settings.get("max_error", 0.0))


@contextmanager
def progress_bar(quiet: bool) -> Iterator[Progress]:
    """Show a progress bar if stderr is a terminal and `quiet` is not set."""
    if quiet or not sys.stderr.isatty():
        yield log_progress
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None)

        def update(done: int, total: int, what: str) -> None:
            bar.update(task, completed=done, total=total, description=printable(what))

        yield update


# If address space is limited, as by ``ulimit -v``, C libraries may crash, abort or hang, which Python cannot catch.
# Stacks and arenas of their threads take hundreds of megabytes. So under a limit libraries use one thread, and below a
# minimum they are not loaded.

MIN_ADDRESS_SPACE = 2000 << 20
"""Smallest address space in bytes; small files need up to 1.8 GB on one thread (measured), 1/6 of it for libraries."""

_THREAD_VARIABLES = ("MIXSEQ_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS")

_OUT_OF_MEMORY_SIGNS = ("can't start new thread", "failed to map segment", "Cannot allocate memory", "libllvmlite")
"""Parts of error messages that signal a lack of memory."""


def limit_threads() -> None:
    """Limit libraries that are not loaded yet to one thread if the address space is limited."""
    limit = _address_space()
    if limit is None:
        return
    if limit < MIN_ADDRESS_SPACE:
        raise SettingsError(
            f"the address space is limited to {limit >> 20} MiB (ulimit -v), and the libraries that mixseq works with "
            f"need {MIN_ADDRESS_SPACE >> 20} MiB before they begin; raise the limit"
        )
    for name in _THREAD_VARIABLES:
        os.environ.setdefault(name, "1")


def is_short_of_memory(error: Exception) -> bool:
    """Return whether an error that is not a MemoryError is caused by limited memory."""
    return _address_space() is not None and any(sign in str(error) for sign in _OUT_OF_MEMORY_SIGNS)


def _address_space() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


_BYTE_UNITS = {"": 1, "b": 1, "kb": 1e3, "mb": 1e6, "gb": 1e9, "kib": 2**10, "mib": 2**20, "gib": 2**30}
_SIZE_PATTERN = re.compile(r"(\d+\.?\d*|\.\d+)\s*([kmg]?i?b|)", re.IGNORECASE)


def as_bytes(text: str) -> int:
    """Parse a size such as 2MB, 500kB or 1.5MiB to bytes; a number without a unit is in bytes."""
    match = _SIZE_PATTERN.fullmatch(text.strip())
    unit = match and _BYTE_UNITS.get(match[2].lower())
    if not match or not unit or float(match[1]) * unit < 1:
        raise click.BadParameter(f"{text!r} is not a size such as 2MB, 500kB or 1.5MiB")
    return int(float(match[1]) * unit)


def _limit_memory(context: click.Context, option: click.Parameter, size: int | None) -> None:
    if size is not None:
        from mixseq_io.files import MEMORY_LIMIT_VARIABLE

        # Threads and processes started here inherit the variable.
        context.with_resource(environment(**{MEMORY_LIMIT_VARIABLE: str(size / (1 << 30))}))


max_memory = click.Option(
    ["--max-memory"],
    type=as_bytes,
    callback=_limit_memory,
    expose_value=False,
    metavar="SIZE",
    help="Memory that reading a file may take: 12GB, 500MB, ...  [default: 8GB, or half of the machine's]",
)
"""Option ``--max-memory`` of all commands."""


class LazyGroup(click.Group):
    """Command group whose commands are the functions ``command`` in the modules of a package."""

    def __init__(self, package: str, sections: Mapping[str, tuple[str, ...]], **settings: Any) -> None:
        super().__init__(**settings)
        self._package = package
        self._sections = sections

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return [name for names in self._sections.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command."""
        if cmd_name not in self.list_commands(ctx):
            return None
        command: click.Command = import_module(f"{self._package}.{cmd_name.replace('-', '_')}").command
        if max_memory not in command.params:
            command.params.append(max_memory)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find a command; for an unknown name, suggest the command with the most similar name."""
        name, commands = args[0], self.list_commands(ctx)
        if name not in commands and not ctx.resilient_parsing:
            from difflib import get_close_matches

            for near in get_close_matches(name, commands, n=1, cutoff=0.7):
                ctx.fail(f"No such command {name!r}; did you mean {near}?")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, grouped by purpose."""
        width = formatter.width - 6 - max(map(len, self.list_commands(ctx)))
        for title, names in self._sections.items():
            commands = ((name, self.get_command(ctx, name)) for name in names)
            with formatter.section(title):
                formatter.write_dl([(name, each.get_short_help_str(width)) for name, each in commands if each])

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command after a check of available memory, which help does not need."""
        if not set(ctx.help_option_names) & set(ctx.args):
            limit_threads()
        return super().invoke(ctx)

    def main(self, *args: Any, standalone_mode: bool = True, **settings: Any) -> Any:
        """Run the command line like `click.Group.main`, with error messages of mixseq."""
        run = partial(super().main, *args, standalone_mode=False, **settings)
        if not standalone_mode:
            return run()
        sys.exit(exit_code(run))


def exit_code(run: Callable[[], object]) -> int:
    """Run a command, report its errors and warnings, and return the exit code of the process."""
    try:
        with _warnings_in_one_line(), signals_as_exceptions():
            result = run()
        return result if isinstance(result, int) else 0
    except MixseqError as error:
        _say(f"error: {error}")
    except click.ClickException as error:
        context = error.ctx if isinstance(error, click.UsageError) else None
        hint = f" (see {context.command_path} --help)" if context else ""
        _say(f"error: {error.format_message()}{hint}")
    except (click.Abort, KeyboardInterrupt):
        _say("interrupted")
        return 130
    except (OSError, ImportError, RuntimeError) as error:
        if is_short_of_memory(error):
            _say(f"error: there is not enough memory ({str(error).splitlines()[0]})")
        elif isinstance(error, OSError):
            where = f"{error.filename}: " if error.filename else ""
            _say(f"error: {where}{error.strerror or error}")
        else:
            raise
    except MemoryError as error:
        _say(f"error: there is not enough memory {f'({error})' if str(error) else ''}")
    return 2


def _say(message: str) -> None:
    """Print a message on one line of stderr; join the lines of a list to an enumeration."""
    head, *rest = (line.strip() for line in message.splitlines())
    say(f"mixseq: {head} {', '.join(rest)}".rstrip(), err=True)


@contextmanager
def _warnings_in_one_line() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("always", MixseqWarning)
        with forward_warnings(lambda text: _say(f"warning: {text}"), replace=True):
            yield
