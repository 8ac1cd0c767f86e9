"""Read and write numbered PLY files, one text or binary file per frame, with unchanged polygons and vertex order.

Texture coordinates are ``s t`` or ``u v`` of vertices, or the list ``texcoord`` of faces. Colours are ``red``,
``green``, ``blue`` and optionally ``alpha`` of vertices or faces, or the list ``color`` of faces. Points keep the
precision ``float`` or ``double``; integer points become float64.

Files are written as little-endian binary, in the points' precision. Values equal at all corners of each vertex are
written per vertex, colours as ``uchar`` if exact, else ``float``; other values per corner, in MeshLab's lists. trimesh
is not used: it rejects binary files with triangles and quads, and triangulates text files. Counts are checked against
the file's size before reading.

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
from mixseq.runtime.text_files import strip_byte_order_mark
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray, IntArray
from mixseq_io.numbered.files import Encoder, FrameFormat, MeshFile
from mixseq_io.reader import DamageError, warn
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
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_HEADER_BYTES = 1 << 20


@dataclass(frozen=True)
class Property:
    """Property of an element, declared in the header."""

    name: str
    type: np.dtype[Any]
    count_type: np.dtype[Any] | None = None  # type of the length, for lists


@dataclass(frozen=True)
class Element:
    """Element, such as vertices or faces, declared in the header."""

    name: str
    count: int
    properties: tuple[Property, ...] = ()


def read_header(data: bytes) -> tuple[str, Sequence[Element], int]:
    """Return the byte order in a header ("" for text), its elements, and the byte offset of the first row."""
    end = data.find(b"end_header", 0, _MAX_HEADER_BYTES)
    line_end = b"\n" if b"\n" in data[:end] else b"\r"
    start = data.find(line_end, end) + 1
    if not data.startswith(b"ply") or end < 0 or start == 0:
        raise DamageError("it has no header from ply to end_header")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, "1.0"] if kind in _BYTE_ORDERS:
                order = _BYTE_ORDERS[kind]
            case ["element", name, count] if count.isdecimal() and len(count) < 20:
                elements.append(Element(name, int(count)))
            case ["property", *words] if elements and order is not None:
                properties = (*elements[-1].properties, _parse_property(line, words, order or "<"))
                elements[-1] = replace(elements[-1], properties=properties)
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case _:
                raise DamageError(f"the line {line[:60]!r} of its header is invalid")
    if order is None:
        raise DamageError("its header has no format line")
    for names in (
        [element.name for element in elements],
        *([prop.name for prop in element.properties] for element in elements),
    ):
        if len(set(names)) < len(names):
            raise DamageError(f"its header has a name twice among {', '.join(names)}")
    return order, elements, start


def _parse_property(line: str, words: Sequence[str], order: str) -> Property:
    match words:
        case ["list", count, kind, name] if _TYPES.get(count, "f")[0] != "f" and kind in _TYPES:
            return Property(name, np.dtype(order + _TYPES[kind]), np.dtype(order + _TYPES[count]))
        case [kind, name] if kind in _TYPES:
            return Property(name, np.dtype(order + _TYPES[kind]))
    raise DamageError(f"the line {line[:60]!r} of its header is invalid")


@dataclass(frozen=True, eq=False)
class Column:
    """Values of a property in all rows of an element."""

    values: NDArray[Any]  # lists are concatenated; integers of text files are float64
    type: np.dtype[Any]
    counts: NDArray[np.int64] | None = None  # lengths of lists


Columns = Mapping[str, Column]


StoredRows = tuple[Element, bytes]
"""An element, and its rows as stored in the file."""


def read_elements(data: bytes, first_faces: StoredRows | None = None) -> tuple[dict[str, Columns], StoredRows | None]:
    """Read all elements of a file except for faces equal to `first_faces`; also return the stored faces."""
    order, elements, start = read_header(data)
    if order == "":
        # Text is converted to binary doubles, so that text and binary rows are read by the same code.
        words = data[start:].split()
        data, start = np.fromiter(map(float, words), np.dtype("<f8"), len(words)).tobytes(), 0
    result: dict[str, Columns] = {}
    faces = None
    for element in elements:
        stored = _with_double_properties(element) if order == "" else element
        if first_faces is not None and stored == first_faces[0] and data.startswith(first_faces[1], start):
            faces, start = first_faces, start + len(first_faces[1])
            continue
        columns, end = _read_rows(data, start, stored)
        result[element.name] = _cast_columns(columns, element)
        if element.name == "face":
            faces = stored, data[start:end]
        start = end
    if data[start:].strip():
        raise DamageError(f"{len(data) - start} extra bytes follow the last element")
    return result, faces


def _with_double_properties(element: Element) -> Element:
    double = np.dtype("<f8")
    properties = (
        Property(prop.name, double, None if prop.count_type is None else double) for prop in element.properties
    )
    return replace(element, properties=tuple(properties))


def _cast_columns(columns: Columns, element: Element) -> Columns:
    """Cast columns to the header's types in native byte order, except for indices of text files, which stay float64."""
    result: dict[str, Column] = {}
    for prop in element.properties:
        column = replace(columns[prop.name], type=prop.type.newbyteorder("="))
        if column.type.kind == "f" or column.values.dtype.kind != "f":
            with np.errstate(over="ignore"):
                column = replace(column, values=column.values.astype(column.type))
        result[prop.name] = column
    return result


def _read_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int]:
    """Return the columns of an element whose rows begin at the byte `start`, and the end of the rows."""
    if element.count and not element.properties:
        raise DamageError(f"element {element.name} has no properties")
    types = (prop.type if prop.count_type is None else prop.count_type for prop in element.properties)
    if element.count * sum(dtype.itemsize for dtype in types) > len(data) - start:
        raise DamageError(f"the file is too short for {element.count} times element {element.name}")
    uniform = _read_uniform_rows(data, start, element) if element.count else None
    return uniform or _read_variable_rows(data, start, element)


def _make_columns(element: Element, values: Mapping[str, NDArray[Any]], counts: Mapping[str, ArrayLike]) -> Columns:
    lists = {name: np.asarray(own, dtype=np.int64) for name, own in counts.items()}
    return {prop.name: Column(values[prop.name], prop.type, lists.get(prop.name)) for prop in element.properties}


def _read_uniform_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int] | None:
    """Read all rows at once if their lengths are equal; otherwise return None."""
    fields: list[Any] = []
    lengths: dict[str, int] = {}
    offset = start
    for prop in element.properties:
        if prop.count_type is None:
            fields.append((prop.name, prop.type))
            offset += prop.type.itemsize
            continue
        has_count = offset + prop.count_type.itemsize <= len(data)
        number = struct.unpack_from(_struct_code(prop.count_type), data, offset)[0] if has_count else -1
        length = int(number) if 0 <= number <= (len(data) - offset) // prop.type.itemsize else -1
        if length != number:
            return None
        lengths[prop.name] = length
        fields += [(f"number of {prop.name}", prop.count_type), (prop.name, prop.type, (length,))]
        offset += prop.count_type.itemsize + length * prop.type.itemsize
    row = np.dtype(fields)
    if element.count * row.itemsize > len(data) - start:
        return None
    rows = np.frombuffer(data, row, element.count, start)
    if any((rows[f"number of {name}"] != length).any() for name, length in lengths.items()):
        return None
    values = {prop.name: rows[prop.name].reshape(-1) for prop in element.properties}
    counts = {name: np.full(element.count, length) for name, length in lengths.items()}
    return _make_columns(element, values, counts), start + element.count * row.itemsize


def _read_variable_rows(data: bytes, start: int, element: Element) -> tuple[Columns, int]:
    """Read rows of different lengths one by one."""
    chunks: dict[str, list[bytes]] = {prop.name: [] for prop in element.properties}
    counts: dict[str, list[int]] = {prop.name: [] for prop in element.properties if prop.count_type is not None}
    plan = [
        (
            prop.type.itemsize,
            None if prop.count_type is None else struct.Struct(_struct_code(prop.count_type)),
            chunks[prop.name],
            counts.get(prop.name, []),
        )
        for prop in element.properties
    ]
    offset = start
    for _ in range(element.count):
        for size, counter, own_chunks, own_counts in plan:
            length = 1
            if counter is not None:
                if offset + counter.size > len(data):
                    raise DamageError(f"the file ends within element {element.name}")
                (number,) = counter.unpack_from(data, offset)
                offset += counter.size
                if not 0 <= number <= (len(data) - offset) // size or number != int(number):
                    raise DamageError(f"element {element.name} has a list of {number:g} numbers")
                length = int(number)
                own_counts.append(length)
            own_chunks.append(data[offset : offset + length * size])
            offset += length * size
    if offset > len(data):
        raise DamageError(f"the file ends within element {element.name}")
    values = {prop.name: np.frombuffer(b"".join(chunks[prop.name]), prop.type) for prop in element.properties}
    return _make_columns(element, values, counts), offset


def _struct_code(dtype: np.dtype[Any]) -> str:
    """Return the format code of a number type for the module `struct`."""
    return ("<" if dtype.str[0] == "|" else dtype.str[0]) + dtype.char


_UV_NAMES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOUR_NAMES = ("red", "green", "blue", "alpha")
_TYPE_NAMES = {"f4": "float", "f8": "double", "u1": "uchar"}


def parse_ply(file: Path, data: bytes, first: MeshFile | None) -> MeshFile:
    """Parse a PLY file; faces stored in the same bytes as in `first` are reused."""
    data = strip_byte_order_mark(file, data, "a PLY file")
    elements, stored_faces = read_elements(data, None if first is None else first.stored_faces)
    points = _stack_columns(elements.get("vertex", {}), "x", "y", "z")
    if points is None:
        raise FormatError(f"{file} cannot be read as a PLY file: it has no vertices with x, y and z")
    if first is not None and "face" not in elements:
        colours = _vertex_colours(elements["vertex"], first.polygons)
        face_properties = {prop.name for prop in first.stored_faces[0].properties}
        if "color" in face_properties or (colours is None and _COLOUR_NAMES[0] in face_properties):
            colours = first.surface.colours
        surface = Surface(colours=colours)
        return MeshFile(points=points, polygons=first.polygons, stored_faces=stored_faces, surface=surface)
    faces = elements.get("face", {})
    if "tristrips" in elements:
        raise FormatError(f"{file} has triangle strips, which are not read; export its faces one by one")
    corners = faces.get("vertex_indices", faces.get("vertex_index"))
    if corners is None or corners.counts is None:
        raise FormatError(f"{file} cannot be read as a PLY file: it has no faces with vertex_indices")
    polygons = Polygons(corners.counts, _to_indices(corners.values))
    surface = Surface(uvs=_uvs(file, elements, polygons), colours=_colours(file, elements, polygons, first))
    return MeshFile(points=points, polygons=polygons, stored_faces=stored_faces, surface=surface)


def _stack_columns(columns: Columns, *names: str) -> FloatArray | None:
    """Stack properties as columns ``(n, k)``, float32 if all are; return None if a property is missing."""
    arrays = [columns[name].values for name in names if name in columns and columns[name].counts is None]
    if len(arrays) < len(names):
        return None
    is_single = all(array.dtype == np.float32 for array in arrays)
    return np.stack(arrays, axis=1).astype(np.float32 if is_single else np.float64)


def _to_indices(numbers: NDArray[np.generic]) -> IntArray:
    """Convert indices to integers, since indices from text files are float64."""
    limit = np.iinfo(np.int32).max
    values = numbers.astype(np.float64)
    if not ((np.abs(values) <= limit) & (values == np.rint(values))).all():
        raise DamageError("a face has a corner that is not a vertex number")
    return values.astype(np.int32)


def _uvs(file: Path, elements: dict[str, Columns], polygons: Polygons) -> CornerValues | None:
    """Return the texture coordinates of faces, else of vertices; faces without coordinates get (0, 0)."""
    lists = elements["face"].get("texcoord")
    with np.errstate(over="ignore"):
        if lists is not None and lists.counts is not None and lists.counts.any():
            wrong_mask = (lists.counts != 0) & (lists.counts != 2 * polygons.counts)
            if wrong_mask.any():
                face = int(np.argmax(wrong_mask))
                raise FormatError(
                    f"{file}, face {face} has {lists.counts[face]} numbers of texture coordinates for "
                    f"{polygons.counts[face]} corners; it is damaged"
                )
            return CornerValues.from_corners(_corner_values(lists, polygons, DEFAULT_UV))
        for names in _UV_NAMES:
            values = _stack_columns(elements["vertex"], *names)
            if values is not None:
                return CornerValues(values.astype(np.float32), polygons.indices)
    return None


def _colours(
    file: Path, elements: dict[str, Columns], polygons: Polygons, first: MeshFile | None
) -> CornerValues | None:
    """Return the colours of corners if they exist, else of vertices, else of faces."""
    faces = elements["face"]
    lists = faces.get("color")
    if lists is not None and lists.counts is not None and lists.counts.any():
        face = int(np.argmax(lists.counts > 0))
        width = 4 if lists.counts[face] == 4 * polygons.counts[face] else 3
        wrong_mask = (lists.counts != 0) & (lists.counts != width * polygons.counts)
        if not wrong_mask.any():
            scaled = replace(lists, values=_scale_to_unit([lists])[0])
            colours = _corner_values(scaled, polygons, DEFAULT_COLOUR[:width])
            return CornerValues.from_corners(ensure_alpha(colours))
        face = int(np.argmax(wrong_mask))
        if first is None:
            warn(
                f"{file}, face {face} has {lists.counts[face]} numbers of colours for {polygons.counts[face]} "
                f"corners, not {width} for each; the colours of corners are left out"
            )
    of_vertices = _vertex_colours(elements["vertex"], polygons)
    if of_vertices is not None:
        return of_vertices
    values = _stack_colours(faces)
    face_ids = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    return None if values is None else CornerValues(values, face_ids).weld(polygons.indices)


def _vertex_colours(vertices: Columns, polygons: Polygons) -> CornerValues | None:
    """Return the colours of vertices; the header's check reports faces with out-of-range vertices."""
    values = _stack_colours(vertices)
    return None if values is None else CornerValues(values, polygons.indices)


def _stack_colours(columns: Columns) -> FloatArray | None:
    """Return the colours ``(n, 4)`` of vertices or faces, or None if there are no colours."""
    for names in (_COLOUR_NAMES, _COLOUR_NAMES[:3]):
        channels = [columns[name] for name in names if name in columns and columns[name].counts is None]
        if len(channels) == len(names) and len(channels[0].values):
            return ensure_alpha(np.stack(_scale_to_unit(channels), axis=1))
    return None


def _scale_to_unit(columns: Sequence[Column]) -> list[FloatArray]:
    """Scale colours to the range 0 to 1: integers by `_unit_integer`, floats jointly by `scale_text_colours`."""
    floats = [column.values for column in columns if column.type.kind == "f"]
    scaled = iter(scale_text_colours(np.stack(floats)) if floats else ())
    return [
        next(scaled) if column.type.kind == "f" else column.values / _unit_integer(column.type, columns)
        for column in columns
    ]


def _unit_integer(dtype: np.dtype[Any], columns: Sequence[Column]) -> np.float64:
    """Return the integer that represents 1: the largest of the type, or 255 if a wider type holds only bytes."""
    largest = max(column.values.max(initial=0) for column in columns if column.type == dtype)
    has_bytes = dtype.itemsize > 1 and largest <= LARGEST_BYTE
    return np.float64(LARGEST_BYTE if has_bytes else np.iinfo(dtype).max)


def _corner_values(column: Column, polygons: Polygons, default: Sequence[float]) -> NDArray[np.float32]:
    """Return the values ``(corners, k)`` of a list property of faces; corners of empty lists get the default."""
    assert column.counts is not None
    values = np.tile(np.asarray(default, dtype=np.float32), (polygons.indices.size, 1))
    values[np.repeat(column.counts > 0, polygons.counts)] = column.values.reshape(-1, len(default))
    return values


def _ply_encoder(path: Path, header: SequenceHeader) -> Encoder:
    """Return the encoder of points ``(V, 3)`` into a PLY file; faces are encoded only once."""
    polygons, surface = header.polygons, header.surface
    columns: list[tuple[str, NDArray[Any]]] = []  # property names, and values of vertices
    lists: list[tuple[str, NDArray[np.float32]]] = []  # property name, and values of corners
    if surface.uvs is not None:
        if surface.uvs.one_per_vertex(polygons.indices):
            uvs = surface.uvs.at_vertices(polygons.indices, header.vertex_count, DEFAULT_UV)
            columns.append(("s t", uvs))
        else:
            lists.append(("texcoord", surface.uvs.at_corners))
    if surface.colours is not None:
        channels = 3 if (surface.colours.values[:, 3] == 1).all() else 4
        colours = replace(surface.colours, values=clip_to_unit(surface.colours.values))
        if colours.one_per_vertex(polygons.indices):
            values = colours.at_vertices(polygons.indices, header.vertex_count, DEFAULT_COLOUR)[:, :channels]
            exact = colours_to_exact_bytes(values)
            columns.append((" ".join(_COLOUR_NAMES[:channels]), values if exact is None else exact))
        else:
            lists.append(("color", colours.at_corners[:, :channels]))
    faces = _encode_faces(polygons, [values for _, values in lists])
    face_lines = [
        f"element face {len(polygons.counts)}",
        "property list uint int vertex_indices",
        *(f"property list uint float {name}" for name, _ in lists),
        "end_header",
    ]

    def encode(points: FloatArray, frame: int) -> Iterable[bytes]:
        frame_columns = [("x y z", points), *columns]
        vertex_lines = [
            "ply",
            "format binary_little_endian 1.0",
            "comment Written by mixseq",
            f"element vertex {len(points)}",
            *(
                f"property {_TYPE_NAMES[values.dtype.str[1:]]} {name}"
                for names, values in frame_columns
                for name in names.split()
            ),
        ]
        yield "".join(f"{line}\n" for line in vertex_lines + face_lines).encode()
        fields = [(names, values.dtype.newbyteorder("<"), values.shape[1]) for names, values in frame_columns]
        rows = np.empty(len(points), dtype=fields)
        for names, values in frame_columns:
            rows[names] = values
        yield rows.tobytes()
        yield faces

    return encode


def _encode_faces(polygons: Polygons, lists: Sequence[NDArray[np.float32]]) -> bytes:
    """Encode the rows of faces: the number of corners and the corners, then the length and values of each list.

    All numbers have four bytes, so that rows of different lengths can be filled together in one array of words.
    """
    counts = polygons.counts.astype(np.int64)
    tables = [polygons.indices[:, None], *(np.ascontiguousarray(values, "<f4").view("<i4") for values in lists)]
    lengths = sum(1 + table.shape[1] * counts for table in tables)
    starts = np.cumsum(lengths) - lengths
    words = np.empty(int(lengths.sum()), dtype="<i4")
    corners = np.arange(polygons.indices.size) - np.repeat(np.cumsum(counts) - counts, counts)
    for table in tables:
        width = table.shape[1]
        words[starts] = width * counts
        offsets = np.repeat(starts + 1, counts) + width * corners
        for column in range(width):
            words[offsets + column] = table[:, column]
        starts = starts + 1 + width * counts
    return words.tobytes()


PLY_FORMAT = FrameFormat(
    "PLY",
    parse_ply,
    _ply_encoder,
    lambda header: lost_surface(header, held=("uvs", "colours")) + lost_colours(header),
    damage_errors=(ValueError, OverflowError),
)
