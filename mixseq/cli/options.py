"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

Command = Callable[..., None]

FILE = click.Path(path_type=Path)

quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print neither progress nor tables.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")


def examples(*lines: str) -> str:
    """Make the end of a help text, marked so that click does not reflow it."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def reader_options(command: Command) -> Command:
    """Add the options of the formats' readers; the command gets those that are given as ``reading``."""

    @click.option("--prim", metavar="PATH", help="Mesh to read, if a USD file has several.")
    @click.option(
        "--input-fps", "fps", type=float, metavar="N", help="Frames per second of OBJ and npz.  [default: 24]"
    )
    @click.option("--allow-gaps", is_flag=True, help="Accept missing numbers among OBJ files.")
    @wraps(command)
    def with_options(
        *args: Any, prim: str | None, fps: float | None, allow_gaps: bool, **settings: Any
    ) -> None:
        given = {"prim": prim, "fps": fps, "allow_gaps": allow_gaps or None}
        reading = {name: value for name, value in given.items() if value is not None}
        command(*args, reading=reading, **settings)

    return with_options
