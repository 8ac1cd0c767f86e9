"""Retimings from text files: pairs of output and source times, as CSV or TOML."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import FormatError, SettingsError
from mixseq.operations.retiming import Retiming
from mixseq.operations.toml_text import parse_toml
from mixseq.public import public

Lines = list[tuple[int, list[str]]]
"""Lines of a file: line numbers and comma-separated fields."""

Unit = Literal["seconds", "frames"]


class RetimingKeys(NamedTuple):
    """Points of a retiming as in a file."""

    points: Float  # (n, 2) output and source times
    unit: Unit | None  # unit of the times; None if the file has none

    def in_seconds(self, output_fps: float, source_fps: float, unit: Unit = "seconds") -> Float:
        """Return the points in seconds."""
        return self.points / [output_fps, source_fps] if (self.unit or unit) == "frames" else self.points


class _Key(NamedTuple):
    """A point of a retiming, and its place in the file."""

    place: str
    output: float
    source: float


@public
def read_retiming(
    path: str | os.PathLike[str],
    smooth: bool = True,
    output_fps: float | None = None,
    source_fps: float | None = None,
) -> Retiming:
    """Read a retiming from a text file.

    Parameters
    ----------
    path : path-like
        CSV: one line ``output,source`` per point, in seconds; a header of these names may change their order; empty
        lines and text after ``#`` are skipped. Or TOML, if the name ends in ``.toml``: tables ``[[key]]`` with
        ``output`` and ``source``, or two arrays of these names. With a first line ``unit = "frames"`` times are frame
        numbers.
    smooth : bool
        As in `Retiming.through`.
    output_fps, source_fps : float, optional
        Frames per second of the output, by default those of the source, and of the source, for files in frames.

    Raises
    ------
    FormatError
        If the file cannot be read, or its points are no retiming; the message names the file and the line.
    SettingsError
        If the file is in frames, and `source_fps` is missing.
    """
    keys = read_keys(path)
    if source_fps is None and keys.unit == "frames":
        raise SettingsError(f"{path} speaks in frames; give source_fps, the frames per second of the source")
    rate = source_fps or 1.0
    outputs, sources = keys.in_seconds(output_fps or rate, rate).T
    return Retiming.through(outputs, sources, smooth)


def read_keys(path: str | os.PathLike[str]) -> RetimingKeys:
    """Read the points of a retiming; file and errors as in `read_retiming`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise FormatError(f"{file} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FormatError(f"{file} is not text; a CSV or TOML file is expected") from None
    unit: Unit | None
    if file.suffix.lower() == ".toml":
        data = parse_toml(file, text)
        unit = checked_unit(data.pop("unit", None), f"{file}")
        keys = list(_toml_keys(file, data))
    else:
        unit, lines = _csv_lines(file, text)
        keys = list(_csv_keys(file, lines))
    for before, key in zip([None, *keys], keys, strict=False):
        if not (np.isfinite(key.output) and np.isfinite(key.source)):
            raise FormatError(f"{file}, {key.place}: the times {key.output:g}, {key.source:g} are not finite")
        if before is not None and key.output <= before.output:
            raise FormatError(
                f"{file}, {key.place}: the output time {key.output:g} is not after {before.output:g} of "
                f"{before.place}; output times must increase"
            )
    if len(keys) < 2:
        raise FormatError(f"{file} has {len(keys)} points; a retiming needs two or more")
    return RetimingKeys(np.array([[key.output, key.source] for key in keys]), unit)


def checked_unit(unit: object, where: str) -> Unit | None:
    """Return the unit of a file, or None; SettingsError for unknown units."""
    if unit not in (None, "seconds", "frames"):
        raise SettingsError(f"{where}: the unit is {unit!r}; 'seconds' or 'frames' is expected")
    return unit


def _csv_lines(file: Path, text: str) -> tuple[Unit | None, Lines]:
    """Return the unit in the first line, and the other non-empty lines: numbers and fields."""
    lines = [
        (number, [field.strip() for field in line.partition("#")[0].split(",")])
        for number, line in enumerate(text.splitlines(), start=1)
        if line.partition("#")[0].strip()
    ]
    name, told, unit = lines[0][1][0].partition("=") if lines else ("", "", "")
    if not told or name.strip().lower() != "unit":
        return None, lines
    return checked_unit(unit.strip().strip("\"'"), f"{file}, line {lines[0][0]}"), lines[1:]


def _csv_keys(file: Path, lines: Lines) -> Iterable[_Key]:
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
                f"{file}, line {number}: {','.join(fields)[:40]!r} is no point of a retiming; two times, "
                "output,source, are expected"
            ) from None
        yield _Key(f"line {number}", **times)


def _toml_keys(file: Path, data: dict[str, Any]) -> Iterable[_Key]:
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
            raise FormatError(f"{file}, key {number}: the output or the source is not a time")
        yield _Key(f"key {number}", float(table["output"]), float(table["source"]))
