"""Elements of PLY files: their rows, as text or binary; counts are checked against the file's size first."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq_io.numbered.ply_header import Element, Property, read_header


@dataclass(frozen=True, eq=False)
class Column:
    """Values of a property in all rows; of lists their concatenation, with `counts`; text integers are float64."""

    values: NDArray[Any]
    type: np.dtype[Any]
    counts: NDArray[np.int64] | None = None


Columns = Mapping[str, Column]


@dataclass(frozen=True)
class Rows:
    """Element and its rows as stored in the file."""

    element: Element
    data: bytes


def read_elements(data: bytes, faces: Rows | None = None) -> tuple[dict[str, Columns], Rows | None]:
    """Read all elements of a file."""
    order, elements, start = read_header(data)
    if order == "":
        # Text is turned into binary numbers of one type, so that there is one way to read rows.
        words = data[start:].split()
        data, start = np.fromiter(map(float, words), np.dtype("<f8"), len(words)).tobytes(), 0
    found: dict[str, Columns] = {}
    source = None
    for element in elements:
        stored = _as_doubles(element) if order == "" else element
        if faces is not None and stored == faces.element and data.startswith(faces.data, start):
            source, start = faces, start + len(faces.data)
            continue
        columns, end = _read_rows(data, start, stored)
        found[element.name] = _of_types(columns, element)
        if element.name == "face":
            source = Rows(stored, data[start:end])
        start = end
    if data[start:].strip():
        raise ValueError(f"{len(data) - start} bytes too many follow the last element")
    return found, source


def _as_doubles(element: Element) -> Element:
    double = np.dtype("<f8")
    return replace(
        element,
        properties=tuple(
            Property(each.name, double, None if each.count is None else double) for each in element.properties
        ),
    )


def _of_types(columns: Columns, element: Element) -> Columns:
    """Return columns in the header's types and native byte order; indices in text stay float64."""
    typed: dict[str, Column] = {}
    for each in element.properties:
        column = replace(columns[each.name], type=each.type.newbyteorder("="))
        if column.type.kind == "f" or column.values.dtype.kind != "f":
            with np.errstate(over="ignore"):
                column = replace(column, values=column.values.astype(column.type))
        typed[each.name] = column
    return typed


def _read_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int]:
    """Return the columns of an element whose rows begin at the byte `start`, and their end."""
    least = sum(each.least for each in element.properties)
    if element.count and not element.properties:
        raise ValueError(f"element {element.name} has no properties")
    if element.count * least > len(data) - start:
        raise ValueError(f"the file is too short for {element.count} times element {element.name}")
    return _equal_rows(data, start, element) or _any_rows(data, start, element)


def _equal_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int] | None:
    """Read rows of equal length at once; None if lengths differ."""
    fields: list[Any] = []
    lengths: dict[str, int] = {}
    at = start
    for each in element.properties if element.count else ():
        if each.count is None:
            fields.append((each.name, each.type))
            at += each.type.itemsize
            continue
        number = (
            struct.unpack_from(_code(each.count), data, at)[0]
            if at + each.count.itemsize <= len(data)
            else -1
        )
        length = int(number) if 0 <= number <= (len(data) - at) // each.type.itemsize else -1
        if length != number:
            return None
        lengths[each.name] = length
        fields += [(f"number of {each.name}", each.count), (each.name, each.type, (length,))]
        at += each.count.itemsize + length * each.type.itemsize
    row = np.dtype(fields)
    if element.count * row.itemsize > len(data) - start:
        return None
    if not element.count:
        rows = np.zeros(0, dtype=[(each.name, each.type) for each in element.properties])
    else:
        rows = np.frombuffer(data, row, element.count, start)
    if any((rows[f"number of {name}"] != length).any() for name, length in lengths.items()):
        return None
    columns = {
        each.name: Column(
            rows[each.name].reshape(-1),
            each.type,
            None if each.count is None else np.full(element.count, lengths.get(each.name, 0), dtype=np.int64),
        )
        for each in element.properties
    }
    return columns, start + element.count * row.itemsize


def _any_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int]:
    """Read rows one by one."""
    parts: dict[str, list[bytes]] = {each.name: [] for each in element.properties}
    counts: dict[str, list[int]] = {each.name: [] for each in element.properties}
    plan = [
        (
            each.type.itemsize,
            None if each.count is None else struct.Struct(_code(each.count)),
            parts[each.name],
            counts[each.name],
        )
        for each in element.properties
    ]
    at = start
    for _ in range(element.count):
        for size, counter, values, numbers in plan:
            length = 1
            if counter is not None:
                if at + counter.size > len(data):
                    raise ValueError(f"the file ends within element {element.name}")
                (number,) = counter.unpack_from(data, at)
                at += counter.size
                if not 0 <= number <= (len(data) - at) // size or number != int(number):
                    raise ValueError(f"element {element.name} has a list of {number:g} numbers")
                length = int(number)
                numbers.append(length)
            values.append(data[at : at + length * size])
            at += length * size
    if at > len(data):
        raise ValueError(f"the file ends within element {element.name}")
    columns = {
        each.name: Column(
            np.frombuffer(b"".join(parts[each.name]), each.type),
            each.type,
            None if each.count is None else np.array(counts[each.name], dtype=np.int64),
        )
        for each in element.properties
    }
    return columns, at


def _code(kind: np.dtype[Any]) -> str:
    """Return a number's code in `struct`."""
    return ("<" if kind.str[0] == "|" else kind.str[0]) + kind.char
