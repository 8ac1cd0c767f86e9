"""Numbered PLY files: one file per frame, text or binary, polygons and vertex order as in the files.

Read are ``x``, ``y``, ``z`` of the vertices, the list ``vertex_indices`` (or ``vertex_index``) of the faces, texture
coordinates (``s t`` or ``u v`` of vertices, or the list ``texcoord`` of the faces), and colours (``red``, ``green``,
``blue`` and maybe ``alpha`` of vertices or faces, or the list ``color`` of the faces). Others, such as normals, are
skipped. Points keep the precision ``float`` or ``double``; integers become float64.

Written are little-endian binary files in the precision of the points: texture coordinates as ``s t`` if every vertex
has a single one, else as ``texcoord``; colours alike, as ``uchar`` if exact, else ``float``, and as ``color`` where a
vertex has several. Lists of corners are as in MeshLab. PLY has no place for the name, times, frame rate, units, the up
axis, velocities, hard edges, face sets, objects and subdivision. The parser is mixseq's own since trimesh refuses
binary files with triangles and quads, and triangulates polygons of text files. Counts are checked against the file's
size first.

Specification: https://paulbourke.net/dataformats/ply/
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import DEFAULT_COLOUR, DEFAULT_UV, CornerValues, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.numbered.files import Encoder, FrameFormat, MeshFile
from mixseq_io.reader import warn
from mixseq_io.surfaces import (
    LARGEST_BYTE,
    clip_to_unit,
    colours_to_exact_bytes,
    ensure_alpha,
    lost_colours,
    lost_surface,
    scale_text_colours,
)

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
    least = sum((each.type if each.count is None else each.count).itemsize for each in element.properties)
    if element.count and not element.properties:
        raise ValueError(f"element {element.name} has no properties")
    if element.count * least > len(data) - start:
        raise ValueError(f"the file is too short for {element.count} times element {element.name}")
    equal = _equal_rows(data, start, element) if element.count else None
    return equal or _any_rows(data, start, element)


def _columns(
    element: Element, values: Mapping[str, NDArray[Any]], counts: Mapping[str, ArrayLike]
) -> Columns:
    return {
        each.name: Column(
            values[each.name],
            each.type,
            None if each.count is None else np.asarray(counts[each.name], dtype=np.int64),
        )
        for each in element.properties
    }


def _equal_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int] | None:
    """Read rows of equal length at once; None if lengths differ."""
    fields: list[Any] = []
    lengths: dict[str, int] = {}
    at = start
    for each in element.properties:
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
    rows = np.frombuffer(data, row, element.count, start)
    if any((rows[f"number of {name}"] != length).any() for name, length in lengths.items()):
        return None
    values = {each.name: rows[each.name].reshape(-1) for each in element.properties}
    counts = {name: np.full(element.count, length) for name, length in lengths.items()}
    return _columns(element, values, counts), start + element.count * row.itemsize


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
    joined = {each.name: np.frombuffer(b"".join(parts[each.name]), each.type) for each in element.properties}
    return _columns(element, joined, counts), at


def _code(kind: np.dtype[Any]) -> str:
    """Return a number's code in `struct`."""
    return ("<" if kind.str[0] == "|" else kind.str[0]) + kind.char


_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOUR = ("red", "green", "blue", "alpha")
_KINDS = {"f4": "float", "f8": "double", "u1": "uchar"}


def parse_ply(file: Path, data: bytes, like: MeshFile | None) -> MeshFile:
    """Parse a PLY file; faces stored in the same bytes as in `like` are reused."""
    elements, source = read_elements(data, None if like is None else like.source)
    points = _side_by_side(elements.get("vertex", {}), "x", "y", "z")
    if points is None:
        raise FormatError(f"{file} cannot be read as a PLY file: it has no vertices with x, y and z")
    if like is not None and "face" not in elements:
        colours = _colours_of_vertices(elements["vertex"], like.polygons)
        names = {each.name for each in like.source.element.properties}
        if "color" in names or (colours is None and _COLOUR[0] in names):  # those of the faces
            colours = like.surface.colours
        surface = Surface(colours=colours)
        return MeshFile(points=points, polygons=like.polygons, source=source, surface=surface)
    faces = elements.get("face", {})
    if "tristrips" in elements:
        raise FormatError(f"{file} has triangle strips, which are not read; export its faces one by one")
    corners = faces.get("vertex_indices", faces.get("vertex_index"))
    if corners is None or corners.counts is None:
        raise FormatError(f"{file} cannot be read as a PLY file: it has no faces with vertex_indices")
    indices = _whole(corners.values)
    polygons = Polygons(corners.counts, indices)
    return MeshFile(
        points=points,
        polygons=polygons,
        source=source,
        surface=Surface(uvs=_uvs(file, elements, polygons), colours=_colours(file, elements, polygons, like)),
    )


def _side_by_side(columns: Columns, *names: str) -> FloatArray | None:
    """Return the columns ``(n, k)`` of some properties, None unless all exist; float32 if all are."""
    found = [columns[name].values for name in names if name in columns and columns[name].counts is None]
    if len(found) < len(names):
        return None
    single = all(each.dtype == np.float32 for each in found)
    return np.stack(found, axis=1).astype(np.float32 if single else np.float64)


def _whole(numbers: NDArray[np.generic]) -> IntArray:
    """Return indices as integers; text files give float64."""
    limit = np.iinfo(np.int32).max
    values = numbers.astype(np.float64)
    if not (
        np.isfinite(values).all() and (np.abs(values) <= limit).all() and (values == np.rint(values)).all()
    ):
        raise ValueError("a face has a corner that is no vertex number")
    return values.astype(np.int32)


def _uvs(file: Path, elements: dict[str, Columns], polygons: Polygons) -> CornerValues | None:
    """Return the texture coordinates, those of faces before those of vertices; (0, 0) for faces without."""
    lists = elements["face"].get("texcoord")
    with np.errstate(over="ignore"):
        if lists is not None and lists.counts is not None and lists.counts.any():
            wrong = (lists.counts != 0) & (lists.counts != 2 * polygons.counts)
            if wrong.any():
                face = int(np.argmax(wrong))
                raise FormatError(
                    f"{file}, face {face} has {lists.counts[face]} numbers of texture coordinates for "
                    f"{polygons.counts[face]} corners; it is damaged"
                )
            return CornerValues.from_corners(_of_lists(lists, polygons, DEFAULT_UV))
        for names in _UV_NAMES:
            values = _side_by_side(elements["vertex"], *names)
            if values is not None:
                return CornerValues(values.astype(np.float32), polygons.indices)
    return None


def _colours(
    file: Path, elements: dict[str, Columns], polygons: Polygons, like: MeshFile | None
) -> CornerValues | None:
    """Return the colours of corners, else of vertices, else of faces."""
    faces = elements["face"]
    lists = faces.get("color")
    if lists is not None and lists.counts is not None and lists.counts.any():
        first = int(np.argmax(lists.counts > 0))
        width = 4 if lists.counts[first] == 4 * polygons.counts[first] else 3
        wrong = (lists.counts != 0) & (lists.counts != width * polygons.counts)
        if not wrong.any():
            shares = replace(lists, values=_from_zero_to_one([lists])[0])
            return CornerValues.from_corners(
                ensure_alpha(_of_lists(shares, polygons, DEFAULT_COLOUR[:width]))
            )
        face = int(np.argmax(wrong))
        if like is None:
            warn(
                f"{file}, face {face} has {lists.counts[face]} numbers of colours for {polygons.counts[face]} "
                f"corners, not {width} for each; the colours of corners are left out"
            )
    of_vertices = _colours_of_vertices(elements["vertex"], polygons)
    if of_vertices is not None:
        return of_vertices
    values = _colour_rows(faces)
    rows = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    return None if values is None else CornerValues(values, rows).weld(polygons.indices)


def _colours_of_vertices(vertices: Columns, polygons: Polygons) -> CornerValues | None:
    """Return the colours of vertices; out-of-range vertices of faces are left to the header's check."""
    values = _colour_rows(vertices)
    return None if values is None else CornerValues(values, polygons.indices)


def _colour_rows(columns: Columns) -> FloatArray | None:
    """Return colours ``(n, 4)`` of vertices or faces, None if there are none."""
    for names in (_COLOUR, _COLOUR[:3]):
        found = [columns[name] for name in names if name in columns and columns[name].counts is None]
        if len(found) == len(names) and len(found[0].values):
            return ensure_alpha(np.stack(_from_zero_to_one(found), axis=1))
    return None


def _from_zero_to_one(columns: Sequence[Column]) -> list[FloatArray]:
    """Return colours scaled to 0 to 1: integers by the value of 1 in their type, floats by all of them."""
    floats = [each.values for each in columns if each.type.kind == "f"]
    shares = iter(scale_text_colours(np.stack(floats)) if floats else ())
    return [
        next(shares) if each.type.kind == "f" else each.values / np.float64(_one_of(each.type, columns))
        for each in columns
    ]


def _one_of(kind: np.dtype[Any], columns: Sequence[Column]) -> int:
    """Return the integer that stands for 1: the largest of its type, or of bytes, which wider types often hold."""
    largest = max(each.values.max(initial=0) for each in columns if each.type == kind)
    return LARGEST_BYTE if kind.itemsize > 1 and largest <= LARGEST_BYTE else int(np.iinfo(kind).max)


def _of_lists(column: Column, polygons: Polygons, default: Sequence[float]) -> NDArray[np.float32]:
    """Return a face list's values at corners; the default for faces with empty lists."""
    assert column.counts is not None
    values = np.tile(np.asarray(default, dtype=np.float32), (polygons.indices.size, 1))
    values[np.repeat(column.counts > 0, polygons.counts)] = column.values.reshape(-1, len(default))
    return values


def _encoder(path: Path, header: SequenceHeader) -> Encoder:
    """Return the encoder of points ``(V, 3)`` into the parts of a PLY file; faces are encoded once."""
    polygons, surface = header.polygons, header.surface
    columns: list[tuple[str, NDArray[Any]]] = []  # names, and numbers of vertices
    lists: list[tuple[str, NDArray[np.float32]]] = []  # name, and numbers of corners
    if surface.uvs is not None:
        if surface.uvs.one_per_vertex(polygons.indices):
            columns.append(
                ("s t", surface.uvs.at_vertices(polygons.indices, header.vertex_count, DEFAULT_UV))
            )
        else:
            lists.append(("texcoord", surface.uvs.at_corners))
    if surface.colours is not None:
        channels = 3 if (surface.colours.values[:, 3] == 1).all() else 4
        colours = replace(surface.colours, values=clip_to_unit(surface.colours.values))
        if colours.one_per_vertex(polygons.indices):
            values = colours.at_vertices(polygons.indices, header.vertex_count, DEFAULT_COLOUR)[:, :channels]
            exact = colours_to_exact_bytes(values)
            columns.append((" ".join(_COLOUR[:channels]), values if exact is None else exact))
        else:
            lists.append(("color", colours.at_corners[:, :channels]))
    faces = _face_bytes(polygons, [values for _, values in lists])
    lines = [
        f"element face {len(polygons.counts)}",
        "property list uint int vertex_indices",
        *(f"property list uint float {name}" for name, _ in lists),
        "end_header",
    ]

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        own = [("x y z", points), *columns]
        head = [
            "ply",
            "format binary_little_endian 1.0",
            "comment Written by mixseq",
            f"element vertex {len(points)}",
            *(
                f"property {_KINDS[values.dtype.str[1:]]} {name}"
                for names, values in own
                for name in names.split()
            ),
        ]
        yield "".join(f"{line}\n" for line in head + lines).encode()
        kinds = [(names, values.dtype.newbyteorder("<"), values.shape[1]) for names, values in own]
        rows = np.empty(len(points), dtype=kinds)
        for names, values in own:
            rows[names] = values
        yield rows.tobytes()
        yield faces

    return encode


def _face_bytes(polygons: Polygons, lists: Sequence[NDArray[np.float32]]) -> bytes:
    """Return the bytes of face rows: number of corners and corners, then number and values of each list.

    All numbers have four bytes, so that rows of any length are filled at once in an array of such words.
    """
    counts = polygons.counts.astype(np.int64)
    columns = [polygons.indices[:, None], *(np.ascontiguousarray(each, "<f4").view("<i4") for each in lists)]
    lengths = sum(1 + each.shape[1] * counts for each in columns)
    starts = np.cumsum(lengths) - lengths
    words = np.empty(int(lengths.sum()), dtype="<i4")
    step = np.arange(polygons.indices.size) - np.repeat(np.cumsum(counts) - counts, counts)
    for each in columns:
        width = each.shape[1]
        words[starts] = width * counts
        place = np.repeat(starts + 1, counts) + width * step
        for column in range(width):
            words[place + column] = each[:, column]
        starts = starts + 1 + width * counts
    return words.tobytes()


PLY = FrameFormat(
    "PLY",
    parse_ply,
    _encoder,
    lambda header: lost_surface(header, held=("uvs", "colours")) + lost_colours(header),
    damage=(ValueError, OverflowError),
)
