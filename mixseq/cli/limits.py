"""Parse sizes, and limit the memory of every command."""

from __future__ import annotations

import os
import re

import click

_UNITS = {"": 1, "b": 1, "kb": 1e3, "mb": 1e6, "gb": 1e9, "kib": 2**10, "mib": 2**20, "gib": 2**30}
_SIZE = re.compile(r"(\d+\.?\d*|\.\d+)\s*([kmg]?i?b|)", re.IGNORECASE)


def as_bytes(context: click.Context, option: click.Parameter, value: str | None) -> int | None:
    """Parse a size such as 2MB, 500kB or 1.5MiB; without a unit, bytes."""
    if value is None:
        return None
    found = _SIZE.fullmatch(value.strip())
    unit = found and _UNITS.get(found[2].lower())
    if not found or not unit or float(found[1]) * unit < 1:
        raise click.BadParameter(f"{value!r} is not a size such as 2MB, 500kB or 1.5MiB")
    return int(float(found[1]) * unit)


def _limit_memory(context: click.Context, option: click.Parameter, value: str | None) -> None:
    size = as_bytes(context, option, value)
    if size is None:
        return
    from mixseq_io.memory import VARIABLE

    # Inherited by threads and processes started here.
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(size / (1 << 30))

    def restore() -> None:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before

    context.call_on_close(restore)


max_memory = click.Option(
    ["--max-memory"],
    callback=_limit_memory,
    expose_value=False,
    metavar="SIZE",
    help="Memory that reading a file may take: 12GB, 500MB, ...  [default: 8GB, or half of the machine's]",
)
"""Option ``--max-memory`` of all commands."""
