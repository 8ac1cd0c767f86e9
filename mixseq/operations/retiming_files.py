"""Retimings from text files: pairs of output and source times, as CSV or TOML."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import FormatError
from mixseq.operations.retiming import Retiming
from mixseq.operations.toml_text import parse_toml


class _Key(NamedTuple):
    """A point of a retiming, and where in the file it is."""

    place: str
    output: float
    source: float


def read_retiming(path: str | os.PathLike[str], smooth: bool = True) -> Retiming:
    """Read a retiming from a text file.

    Parameters
    ----------
    path : path-like
        CSV: one line ``output,source`` per point, in seconds; lines of another order begin with a header of these
        names; empty lines and what follows ``#`` are skipped. Or TOML, if the name ends in ``.toml``: tables
        ``[[key]]`` with ``output`` and ``source``, or two arrays of these names.
    smooth : bool
        As in `Retiming.through`.

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are no retiming; the message names the file and the line.
    """
    outputs, sources = read_keys(path).T
    return Retiming.through(outputs, sources, smooth)


def read_keys(path: str | os.PathLike[str]) -> Float:
    """Read the points ``(n, 2)`` of a retiming, output and source times; file and errors as in `read_retiming`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FormatError(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FormatError(f"{file} is not text; a CSV or TOML file is expected") from None
    keys = list(_toml_keys(file, text) if file.suffix.lower() == ".toml" else _csv_keys(file, text))
    for before, key in zip([None, *keys], keys, strict=False):
        if not (np.isfinite(key.output) and np.isfinite(key.source)):
            raise FormatError(f"{file}, {key.place}: the times {key.output:g}, {key.source:g} are not finite")
        if before is not None and key.output <= before.output:
            raise FormatError(
                f"{file}, {key.place}: the output time {key.output:g} s is not after {before.output:g} s of "
                f"{before.place}; output times must increase"
            )
    if len(keys) < 2:
        raise FormatError(f"{file} has {len(keys)} points; a retiming needs two or more")
    return np.array([[key.output, key.source] for key in keys])


def _csv_keys(file: Path, text: str) -> Iterable[_Key]:
    lines = [
        (number, [field.strip() for field in line.partition("#")[0].split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.partition("#")[0].strip()
    ]
    names = [name.lower() for name in lines[0][1]] if lines else []
    if sorted(names) == ["output", "source"]:
        del lines[0]
    else:
        names = ["output", "source"]
    for number, fields in lines:
        try:
            times = dict(zip(names, map(float, fields), strict=True))
        except ValueError:
            raise FormatError(
                f"{file}, line {number}: {','.join(fields)[:40]!r} is no point of a retiming; two times in seconds, "
                "output,source, are expected"
            ) from None
        yield _Key(f"line {number}", **times)


def _toml_keys(file: Path, text: str) -> Iterable[_Key]:
    data = parse_toml(file, text)
    tables = data.get("key")
    if data.keys() == {"output", "source"} and all(isinstance(times, list) for times in data.values()):
        if len(data["output"]) != len(data["source"]):
            raise FormatError(
                f"{file} has {len(data['output'])} output times and {len(data['source'])} source times; give as many"
            )
        pairs = zip(data["output"], data["source"], strict=True)
        tables = [{"output": output, "source": source} for output, source in pairs]
    elif data.keys() != {"key"} or not isinstance(tables, list):
        raise FormatError(
            f"{file} has {', '.join(data) or 'nothing'}; tables [[key]] of output and source, or arrays output and "
            "source, are expected"
        )
    for number, table in enumerate(tables, start=1):
        if not isinstance(table, dict) or table.keys() != {"output", "source"}:
            raise FormatError(f"{file}, key {number}: an output and a source are expected, and nothing else")
        if not all(type(time) in (int, float) for time in table.values()):
            raise FormatError(f"{file}, key {number}: the output or the source is not a time in seconds")
        yield _Key(f"key {number}", float(table["output"]), float(table["source"]))
