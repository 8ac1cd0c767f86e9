"""Header of PLY files: the elements and the properties of their rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LARGEST_HEADER = 1 << 20


@dataclass(frozen=True)
class Property:
    """Property: its type, and the type of its counts if it is a list."""

    name: str
    type: np.dtype[Any]
    count: np.dtype[Any] | None = None

    @property
    def least(self) -> int:
        """Minimum size in bytes of a row's entry."""
        return (self.type if self.count is None else self.count).itemsize


@dataclass(frozen=True)
class Element:
    """Header entry of an element."""

    name: str
    count: int
    properties: tuple[Property, ...] = ()


def read_header(data: bytes) -> tuple[str, Sequence[Element], int]:
    """Read a header."""
    end = data.find(b"end_header", 0, _LARGEST_HEADER)
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or start == 0:
        raise ValueError("it has no header from ply to end_header")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, "1.0"] if kind in _ORDERS:
                order = _ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(Element(name, int(count)))
            case ["property", *words] if elements and order is not None:
                properties = (*elements[-1].properties, _property(line, words, order or "<"))
                elements[-1] = replace(elements[-1], properties=properties)
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise ValueError(f"the line {line[:60]!r} of its header has no meaning")
    if order is None:
        raise ValueError("its header does not tell the format")
    for names in (
        [each.name for each in elements],
        *([part.name for part in each.properties] for each in elements),
    ):
        if len(set(names)) < len(names):
            raise ValueError(f"its header has a name twice among {', '.join(names)}")
    return order, elements, start


def _property(line: str, words: Sequence[str], order: str) -> Property:
    match words:
        case ["list", count, kind, name] if _TYPES.get(count, "f")[0] != "f" and kind in _TYPES:
            return Property(name, np.dtype(order + _TYPES[kind]), np.dtype(order + _TYPES[count]))
        case [kind, name] if kind in _TYPES:
            return Property(name, np.dtype(order + _TYPES[kind]))
    raise ValueError(f"the line {line[:60]!r} of its header has no meaning")
