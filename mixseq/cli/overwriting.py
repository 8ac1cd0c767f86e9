"""Protect files from being overwritten: no input is an output, and no file is replaced without consent.

On a terminal, replacing a named target needs an answer, before the work. Without a terminal it is replaced, as other
tools in scripts do, so that a script may run twice. ``--overwrite`` and ``--no-overwrite`` answer in advance.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

import click

from mixseq.cli.console import printable
from mixseq.cli.files import check_place, check_target
from mixseq.errors import OutputError

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
    from mixseq_io import FORMATS
    from mixseq_io.numbered.names import files_of_pattern

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
