"""Files of text and JSON, read whole or as rows of numbers, with errors that name the file and the line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from mixseq.arrays import Float
from mixseq.errors import FormatError
from mixseq_io.reader import brief, read_whole, reading


def read_text(file: Path, what: str) -> str:
    """Read a UTF-8 file, with or without a byte order mark; `what` names its expected contents in messages."""
    with reading(file, what, UnicodeDecodeError):
        return read_whole(file, text=True).decode("utf-8-sig")


def parse_json(file: Path, text: str) -> Any:
    """Parse the text of a JSON file."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits are a ValueError, too
        raise FormatError(f"{file} cannot be read as JSON: {brief(error)}") from None


Kind = Literal["vertices", "triangles", "barycentric"]

COLUMNS: dict[str, tuple[int, int]] = {"vertices": (1, 2), "triangles": (1, 2), "barycentric": (4, 5)}
"""Numbers in a row: with the source alone, and with the target."""

_SEPARATOR = re.compile(r"\s*(?:->|[,:;\s])\s*")

_Rows = list[tuple[str, list[float]]]
"""Rows with their place in the file."""


def read_rows(file: Path, kind: Kind | None = None) -> tuple[Kind, Float]:
    """Read rows ``(n, k)``; return their kind, too: `kind`, else as stated by the file, else by their length."""
    text = read_text(file, "a map")
    said, rows = _of_json(file, text) if file.suffix.lower() == ".json" else _of_text(file, text)
    if not rows:
        raise FormatError(f"{file} has no rows of a map")
    width = len(rows[0][1])
    looks: Kind = (
        "barycentric" if width > 2 else "triangles" if file.suffix.lower() == ".tricorrs" else "vertices"
    )
    chosen = kind or said or looks
    for place, row in rows:
        if len(row) != width or width not in COLUMNS[chosen]:
            few, many = COLUMNS[chosen]
            raise FormatError(
                f"{file}, {place} has {len(row)} numbers; a map of {chosen} has {few} or {many} in every row"
            )
    table = np.array([row for _, row in rows], np.float64)
    whole = table[:, : 1 + (width == COLUMNS[chosen][1])]
    wrong = np.argwhere(~((whole >= -1) & (whole < 1 << 53) & (whole == np.floor(whole))))
    if wrong.size:
        row, column = wrong[0]
        raise FormatError(
            f"{file}, {rows[row][0]}: {whole[row, column]:g} is no number of a vertex or triangle; they count from 0"
        )
    return chosen, table


def _of_text(file: Path, text: str) -> tuple[Kind | None, _Rows]:
    said: Kind | None = None
    rows: _Rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        word = line.strip().lstrip("#").strip().lower()
        if not rows and word in get_args(Kind):
            said = get_args(Kind)[get_args(Kind).index(word)]
            continue
        body = line.partition("#")[0].strip().rstrip(",;")
        if not body:
            continue
        try:
            rows.append((f"line {number}", [float(part) for part in _SEPARATOR.split(body)]))
        except ValueError:
            raise FormatError(
                f"{file}, line {number}: {body[:40]!r} is no row of a map; numbers of the source and of the target are "
                "expected, separated by a space, comma, colon, semicolon or '->'"
            ) from None
    if len(rows) > 1 and len(rows[0][1]) == 1 < len(rows[1][1]):
        (announced,), rows = rows[0][1], rows[1:]
        if announced != len(rows):
            raise FormatError(
                f"{file}: it announces {announced:g} rows, but {len(rows)} follow; is it truncated?"
            )
    return said, rows


def _of_json(file: Path, text: str) -> tuple[Kind | None, _Rows]:
    tree = parse_json(file, text)
    said: Kind | None = None
    if isinstance(tree, dict):
        said = next((kind for kind in get_args(Kind) if kind in tree), None)
        tree = tree.get(said)
    if not isinstance(tree, list):
        raise FormatError(
            f"{file} has no map; a list is expected, by itself or as 'vertices', 'triangles' or 'barycentric'"
        )
    return said, [
        (f"row {number}", _json_row(file, number, item)) for number, item in enumerate(tree, start=1)
    ]


def _json_row(file: Path, number: int, item: Any) -> list[float]:
    row = item if isinstance(item, list) else [-1 if item is None else item]
    try:
        if all(isinstance(value, int | float) and not isinstance(value, bool) for value in row):
            return [float(value) for value in row]
    except OverflowError:
        pass
    raise FormatError(f"{file}, row {number}: {str(item)[:40]} is no row of numbers")
