"""What is done with a file, as users do it: commands of mixseq, or functions under its way to report errors.

Each takes the file and returns the exit code; what it found is in `OUT` in the same folder.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from mixseq.cli import main
from mixseq.cli.group import exit_code

OUT = "out.npz"
"""What a use writes: an archive of arrays, or a pickle of whatever the file said."""

Use = Callable[[Path], int]


def _command(*words: object) -> int:
    try:
        main([os.fspath(word) if isinstance(word, Path) else str(word) for word in words], prog_name="mixseq")
    except SystemExit as left:
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    return 0


def _commands(*commands: tuple[object, ...]) -> int:
    """Run all; the first that fails tells the exit code, but none is left out."""
    return next(filter(None, [_command(*words) for words in commands]), 0)


def convert(file: Path) -> int:
    return _commands(("info", file), ("convert", file, OUT, "-q"))


def convert_usd(file: Path) -> int:
    """Also what is packed: a written archive may hold other files."""
    return _commands(("info", file), ("convert", file, OUT, "-q"), ("convert", file, "packed.usdz", "-q"))


def decode(file: Path) -> int:
    return _commands(("info", file), ("decode", file, OUT, "-q"))


def decode_compressed(file: Path) -> int:
    """What can be decoded is verified, which may end as it likes."""
    code = decode(file)
    if code:
        return code
    other = _command("verify", file)
    return code if other in (0, 1, 2) else other


def segment(file: Path) -> int:
    mesh = file.with_name("mesh.npz")
    return _command("segment", mesh, OUT, "--labels", file, "--no-picture", "-q")


def edit(file: Path) -> int:
    return _command("edit", file.with_name("model.h5"), OUT, "--script", file.with_name("edits.toml"), "-q")


def _call(function: Callable[[], Any]) -> int:
    def call() -> None:
        found = function()
        Path(OUT).write_bytes(pickle.dumps(found))
        click.echo(repr(found)[:500])

    return exit_code(call)


def markers(file: Path) -> int:
    from mixseq_io.correspondence.markers import read_markers

    return _call(lambda: read_markers(file))


def maps(file: Path) -> int:
    from mixseq_io.correspondence.maps import read_map, to_correspondence
    from scripts.fuzzing.corpus import arm

    mesh = arm(1)
    return _call(lambda: to_correspondence(read_map(file), *[(mesh.points[0], mesh.faces)] * 2))


def contacts(file: Path) -> int:
    from mixseq_io.correspondence.contacts import read_contacts

    return _call(lambda: read_contacts(file))


def retiming(file: Path) -> int:
    from mixseq.operations.retiming_files import read_retiming

    return _call(lambda: read_retiming(file))


def report(file: Path) -> int:
    from mixseq.cli.batch.report import read_report, rows

    def found() -> list[Any]:
        read = read_report(file.parent)
        read.without_lost()  # which looks for the files that it names
        return list(rows(read.entries.values()))

    return _call(found)
