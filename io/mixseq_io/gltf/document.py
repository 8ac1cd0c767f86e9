"""Checked access to the JSON of glTF files (.gltf, .glb), kept unchanged for writers, and to arrays in buffers.

Buffers in a .glb chunk, in the JSON, or in neighbouring files are read on demand. Every count and offset is compared
with the available bytes before an array is allocated.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import base64
import binascii
import io
import json
import os
import re
import struct
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq.runtime.text_files import decode_text
from mixseq.types import Float, Single
from mixseq_io.files import LimitError, check_memory
from mixseq_io.reader import translate_read_errors
from mixseq_io.scene_meshes import format_names

MALFORMED_JSON_ERRORS = (KeyError, IndexError, TypeError, ValueError, AttributeError, RecursionError)
"""Exceptions raised by unchecked access to the JSON of damaged files, for `translate_read_errors`."""

DRACO_EXTENSION = "KHR_draco_mesh_compression"
MESHOPT_EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
POINTER_EXTENSION = "KHR_animation_pointer"
INSTANCING_EXTENSION = "EXT_mesh_gpu_instancing"
SEQUENCE_EXTENSION = "MIXSEQ_mesh_sequence"
"""Name of the extension that stores a mesh's frames as compressed streams (`mixseq_io.gltf.mesh_sequence`)."""

_APPEARANCE_PATTERN = re.compile(r"[A-Z]+_(materials|texture|lights|packing|xmp)")
"""Beginning of the names of extensions that change neither meshes nor their motion."""

_SUPPORTED_EXTENSIONS = (
    *MESHOPT_EXTENSIONS,
    DRACO_EXTENSION,
    SEQUENCE_EXTENSION,
    POINTER_EXTENSION,
    INSTANCING_EXTENSION,
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_node_selectability",
    "KHR_node_hoverability",
)

_DECLARATIONS = ("extensionsUsed", "extensionsRequired")
_EXACT_INTEGER_END = 2**53  # all JSON readers represent smaller integers exactly
_MAX_JSON_NUMBER = 1e300


@dataclass(frozen=True)
class Fields:
    """JSON object at a JSON path in a file, with checked access to its members."""

    file: Path
    place: str
    values: Mapping[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def integer(self, key: str, default: int | None = None) -> int:
        """Return a non-negative integer; a missing member is an error unless a default is given."""
        return self._integer(key, self.values.get(key, default))

    def index(self, key: str) -> int | None:
        """Return an index into a list of the document, or None if absent."""
        return self.integer(key) if key in self.values else None

    def text(self, key: str, default: str = "") -> str:
        """Return a string, or the default if absent."""
        value = self.values.get(key, default)
        return value if isinstance(value, str) else self._unexpected(key, "a string")

    def flag(self, key: str) -> bool:
        """Return a truth value, False if absent."""
        value = self.values.get(key, False)
        return value if isinstance(value, bool) else self._unexpected(key, "true or false")

    def integers(self, key: str) -> list[int]:
        """Return a list of non-negative integers, empty if absent."""
        return [self._integer(f"{key}[{i}]", value) for i, value in enumerate(self._list(key))]

    def number(self, key: str, default: float) -> float:
        """Return a finite number, or the default if absent."""
        value = self.values.get(key, default)
        return float(value) if _is_number(value) else self._unexpected(key, "a finite number")

    def numbers(self, key: str, count: int) -> Float | None:
        """Return a list of `count` finite numbers, or None if absent."""
        if key not in self.values:
            return None
        numbers = self._list(key)
        if not all(map(_is_number, numbers)) or count != len(numbers):
            self._unexpected(key, f"a list of {count} finite numbers")
        return np.array(numbers, dtype=np.float64)

    def texts(self, key: str) -> list[str]:
        """Return a list of strings, empty if absent."""
        texts = self._list(key)
        if not all(isinstance(text, str) for text in texts):
            self._unexpected(key, "a list of strings")
        return texts

    def object(self, key: str) -> Fields:
        """Return an object, an empty one if absent."""
        return self._object(key, self.values.get(key, {}))

    def objects(self, key: str) -> list[Fields]:
        """Return a list of objects, empty if absent."""
        return [self._object(f"{key}[{i}]", value) for i, value in enumerate(self._list(key))]

    def error(self, problem: str) -> FormatError:
        """Return an error whose message names this object."""
        return FormatError(f"{self.file}: {self.place} {problem}")

    def _list(self, key: str) -> list[Any]:
        value = self.values.get(key, [])
        return value if isinstance(value, list) else self._unexpected(key, "a list")

    def _object(self, key: str, value: Any) -> Fields:
        if not isinstance(value, dict):
            self._unexpected(key, "an object")
        return Fields(self.file, f"{self.place}.{key}".lstrip("."), value)

    def _integer(self, key: str, value: Any) -> int:
        # JSON allows 3.0 as an integer.
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _EXACT_INTEGER_END:
            self._unexpected(key, "a non-negative integer")
        return int(value)

    def _unexpected(self, key: str, expected: str) -> Any:
        place = f"{self.place}.{key}".lstrip(".")
        raise FormatError(f"{self.file}: {place} is missing or damaged; {expected} is expected there")


def _is_number(value: Any) -> bool:
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) < _MAX_JSON_NUMBER
        and isfinite(value)
    )


class _File(io.FileIO):
    """Open file that closes with its last reference; its content stays if the file on disk is replaced."""

    def __del__(self) -> None:
        self.close()


@dataclass(frozen=True, eq=False)
class Data:
    """Range of bytes in a file or in memory."""

    source: _File | bytes
    start: int
    size: int

    def part(self, start: int, size: int) -> Data:
        """Return a subrange of this range."""
        return Data(self.source, self.start + start, size)

    def read(self, start: int, size: int) -> bytes:
        """Return up to `size` bytes within the range; raise `FormatError` if the file was truncated after opening."""
        size = max(0, min(size, self.size - start))
        position = self.start + start
        if isinstance(self.source, bytes):
            return self.source[position : position + size]
        self.source.seek(position)
        parts = []
        while size:
            part = self.source.read(size)
            if not part:
                raise FormatError(f"{self.source.name} ends too early; another program may have changed it")
            parts.append(part)
            size -= len(part)
        return b"".join(parts)


def open_data(path: Path) -> Data:
    """Open a file as a range of bytes that is read on demand."""
    file = _File(path)
    return Data(file, 0, os.fstat(file.fileno()).st_size)


_GLB_HEADER_BYTES, _CHUNK_HEADER_BYTES = 12, 8


def read_glb_chunks(path: Path, data: Data) -> tuple[bytes, Data | None]:
    """Return the JSON and the binary chunk of a .glb."""
    if data.size < _GLB_HEADER_BYTES + _CHUNK_HEADER_BYTES:
        raise FormatError(f"{path} has {data.size} bytes, too few for a .glb; it is truncated")
    version, length = struct.unpack("<II", data.read(4, 8))
    if version != 2:
        raise FormatError(f"{path} is a .glb of version {version}; convert it to version 2")
    if length > data.size:
        raise FormatError(f"{path} has {data.size} bytes of {length}; it is truncated")
    chunks: list[tuple[bytes, Data]] = []
    offset = _GLB_HEADER_BYTES
    while offset + _CHUNK_HEADER_BYTES <= length and len(chunks) < 2:
        size, kind = struct.unpack("<I4s", data.read(offset, _CHUNK_HEADER_BYTES))
        offset += _CHUNK_HEADER_BYTES
        if offset + size > length:
            raise FormatError(f"{path}: a chunk of {size} bytes goes beyond the end; the file is damaged")
        chunks.append((kind, data.part(offset, size)))
        offset += size
    if not chunks or chunks[0][0] != b"JSON":
        raise FormatError(f"{path} does not begin with JSON; the file is damaged")
    text = chunks[0][1]
    return text.read(0, text.size), chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else None


def read_uri(buffer: Fields, uri: str) -> Data:
    """Return the bytes of a data URI, or of a file in the document's folder."""
    if uri.startswith("data:"):
        header, _, data = uri.partition(",")
        if not header.endswith(";base64"):
            raise buffer.error("is a data URI without base64; it is damaged")
        try:
            content = base64.b64decode(data, validate=True)
            return Data(content, 0, len(content))
        except (binascii.Error, ValueError):
            raise buffer.error("is a data URI with invalid base64; it is damaged") from None
    name, folder = unquote(uri), buffer.file.parent.resolve()
    # Only relative paths are allowed, without links that leave the folder.
    if ":" in name or "\\" in name or "\0" in name or name.startswith("/") or ".." in name.split("/"):
        raise buffer.error(f"is in {name[:80]!r}; only files in the folder of the glTF file are read")
    with translate_read_errors(folder / name, "the buffer of a glTF file"):
        file = (folder / name).resolve()
        if not file.is_relative_to(folder):
            raise buffer.error(f"is in {name[:80]!r}, a link; only files in the folder of the glTF file are read")
        if not file.is_file():
            raise buffer.error(f"is in {name[:80]!r}, which is not a file beside {buffer.file.name}; put it there")
        return open_data(file)


COMPONENT_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy dtypes by ``componentType``."""

ELEMENT_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers per element by accessor type; meshes and animations have no MAT2 and MAT3."""

_MAX_UNSTORED_NUMBERS, _MAX_NUMBERS_PER_BYTE = 10_000_000, 16
"""Limits on computed numbers that are not stored in the file, such as zeros and repeated meshes."""

_LISTS = ("accessors", "animations", "buffers", "bufferViews", "materials", "meshes", "nodes", "scenes", "skins")


@dataclass(frozen=True, eq=False)
class Document:
    """glTF file with its JSON in memory; buffers are read on demand, or computed by `unpackers` (by buffer index)."""

    path: Path
    json: dict[str, Any]
    chunk: Data | None
    size: int
    unpackers: dict[int, Callable[[], bytes]] = field(default_factory=dict, repr=False)
    _buffers: dict[int, Data] = field(default_factory=dict, repr=False)

    @cached_property
    def _items(self) -> dict[str, list[Fields]]:
        return {kind: self.top.objects(kind) for kind in _LISTS}

    @property
    def top(self) -> Fields:
        """Outermost JSON object."""
        return Fields(self.path, "", self.json)

    def items(self, kind: str) -> list[Fields]:
        """Return all items of a list such as ``"nodes"``, ``"meshes"`` or ``"animations"``."""
        return self._items[kind]

    def item(self, kind: str, index: int) -> Fields:
        """Return the item at an index of a list; see `items`."""
        items = self._items[kind]
        if not 0 <= index < len(items):
            raise FormatError(f"{self.path}: {kind}[{index}] is referenced, but there are {len(items)} {kind}")
        return items[index]

    def accessor(self, index: int) -> NDArray[Any]:
        """Return an accessor's numbers ``(n,)`` or ``(n, k)``, sparse or not; normalised integers become floats."""
        accessor = self.item("accessors", index)
        dtype, width = element_layout(accessor)
        count = accessor.integer("count")
        if "bufferView" in accessor:
            values = self._read_numbers(accessor, dtype, (count, width))
        else:
            self.check_effort(count * width, accessor.place)
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            values = self._fill_sparse(accessor.object("sparse"), values)
        if accessor.flag("normalized"):
            values = _normalise(values)
        values.flags.writeable = False
        return values[:, 0] if width == 1 else values

    @cached_property
    def data_size(self) -> int:
        """Size of the file and its buffers in bytes."""
        total = self.size
        for index, buffer in enumerate(self.items("buffers")):
            if "uri" in buffer or (index == 0 and self.chunk is not None):  # other buffers are computed
                total += self.buffer(index).size
        return total

    def check_effort(self, numbers: int, label: str) -> None:
        """Raise an error if a count of numbers far exceeds the file's size, as in damaged or hostile files."""
        if numbers > _MAX_UNSTORED_NUMBERS + _MAX_NUMBERS_PER_BYTE * self.data_size:
            raise LimitError(
                f"{self.path}: {label} have {numbers} numbers, but the file only {self.data_size} bytes; it is "
                "damaged, or repeats one mesh too often: choose fewer meshes with prim"
            )
        check_memory(self.path, 8 * numbers, label)

    def buffer(self, index: int) -> Data:
        """Return the bytes of a buffer: from the .glb chunk, a data URI, a neighbouring file, or an unpacker."""
        if index in self._buffers:
            return self._buffers[index]
        buffer = self.item("buffers", index)
        length = buffer.integer("byteLength")
        if index in self.unpackers:
            content = self.unpackers[index]()
            data = Data(content, 0, len(content))
        elif "uri" in buffer:
            data = read_uri(buffer, buffer.text("uri"))
        elif index == 0 and self.chunk is not None:
            data = self.chunk
        else:
            raise buffer.error("has no data; it is compressed or elsewhere, export it with its data")
        if length > data.size:
            raise buffer.error(f"has {data.size} bytes of {length}; it is truncated")
        self._buffers[index] = data.part(0, length)
        return self._buffers[index]

    def read_view(self, view: Fields) -> bytes:
        """Return the bytes of an object with ``buffer``, ``byteOffset`` and ``byteLength``."""
        data = self.buffer(view.integer("buffer"))
        start, length = view.integer("byteOffset", 0), view.integer("byteLength")
        if start + length > data.size:
            raise view.error(f"does not fit its buffer of {data.size} bytes; the file is damaged")
        return data.read(start, length)

    def _read_numbers(self, owner: Fields, dtype: np.dtype[Any], shape: tuple[int, int]) -> NDArray[Any]:
        """Return the stored numbers ``(n, k)`` of an accessor, or of the indices or values of a sparse accessor."""
        view = self.item("bufferViews", owner.integer("bufferView"))
        data = self.buffer(view.integer("buffer"))
        start, length = view.integer("byteOffset", 0), view.integer("byteLength")
        element = dtype.itemsize * shape[1]
        stride, offset = view.integer("byteStride", element), owner.integer("byteOffset", 0)
        if start + length > data.size or stride < element:
            raise view.error(f"does not fit its buffer of {data.size} bytes; the file is damaged")
        if shape[0] and offset + stride * (shape[0] - 1) + element > length:
            raise owner.error(f"has {shape[0]} elements, more than its {length} bytes hold; the file is damaged")
        if not shape[0]:
            return np.empty(shape, dtype)
        content = data.read(start + offset, stride * (shape[0] - 1) + element)
        return np.ndarray(shape, dtype, content, 0, (stride, dtype.itemsize))

    def _fill_sparse(self, sparse: Fields, values: NDArray[Any]) -> NDArray[Any]:
        """Return a copy of values ``(n, k)`` with a sparse accessor's values at its indices."""
        where = sparse.object("indices")
        dtype = COMPONENT_DTYPES.get(where.integer("componentType"), "")
        if dtype not in ("<u1", "<u2", "<u4"):
            raise where.error("are not unsigned integers")
        count = sparse.integer("count")
        indices = self._read_numbers(where, np.dtype(dtype), (count, 1))[:, 0]
        if indices.max(initial=0) >= max(len(values), 1):
            raise where.error(f"go up to {indices.max()}, but there are {len(values)} elements")
        filled = values.copy()
        filled[indices] = self._read_numbers(sparse.object("values"), values.dtype, (count, values.shape[1]))
        return filled


def load_document(path: Path) -> Document:
    """Read the JSON of a .gltf or .glb file; buffers are read on demand."""
    with translate_read_errors(path, "glTF"):
        data = open_data(path)
        is_binary = data.read(0, 4) == b"glTF"
        text, chunk = read_glb_chunks(path, data) if is_binary else (data.read(0, data.size), None)
    with translate_read_errors(path, "glTF", ValueError, RecursionError):
        parsed = json.loads(decode_text(path, text, "glTF"))
    if not isinstance(parsed, dict):
        raise FormatError(f"{path} is JSON, but not glTF")
    top = Fields(path, "", parsed)
    version = top.object("asset").text("version")
    if not version.startswith("2."):
        raise FormatError(f"{path} is glTF version {version or 'unknown'}; convert it to version 2")
    if unknown := unknown_extensions(top.texts("extensionsRequired")):
        raise FormatError(
            f"{path} requires {format_names(unknown)}, extensions that are not supported; export without them"
        )
    document = Document(path, parsed, chunk, data.size)
    document.items("nodes")  # this checks all lists
    return document


def has_sequence(path: Path) -> bool:
    """Whether a .glb has a mesh sequence."""
    with translate_read_errors(path, "glTF"):
        data = open_data(path)
        if data.read(0, 4) != b"glTF":
            return False  # the reader reports the error
        text, _ = read_glb_chunks(path, data)
    # Files without a sequence are not parsed.
    return f'"{SEQUENCE_EXTENSION}"'.encode() in text and bool(list_sequences(load_document(path)))


def list_sequences(document: Document) -> list[Fields]:
    """Return the extension objects of all mesh sequences, one for each body."""
    extensions = [mesh.object("extensions") for mesh in document.items("meshes")]
    return [each.object(SEQUENCE_EXTENSION) for each in extensions if SEQUENCE_EXTENSION in each]


def collect_extensions(document: Mapping[str, Any]) -> set[str]:
    """Return the names of all extensions used in a document's JSON, declared or not."""
    names: set[str] = set()
    stack: list[Any] = [document]
    while stack:
        value = stack.pop()
        if isinstance(value, dict):
            extensions = value.get("extensions")
            names |= set(extensions) if isinstance(extensions, dict) else set()
            stack += value.values()
        elif isinstance(value, list):
            stack += value
    return names


def used_extensions(document: Document) -> set[str]:
    """Return the names of all extensions of a document, declared or in use."""
    declared = (name for member in _DECLARATIONS for name in document.top.texts(member))
    return collect_extensions(document.json) | {*declared}


def undeclare_extensions(document: dict[str, Any], names: Container[str]) -> None:
    """Remove names from the lists of a document's extensions."""
    for member in _DECLARATIONS:
        kept = [name for name in document.pop(member, ()) if name not in names]
        document.update({member: kept} if kept else {})


def remove_extension(entry: dict[str, Any], name: str) -> None:
    """Remove an extension from an entry of a document."""
    del entry["extensions"][name]
    if not entry["extensions"]:
        del entry["extensions"]


def unknown_extensions(names: Iterable[str]) -> list[str]:
    """Return the sorted names of extensions that are not read and may change meshes or their motion."""
    return sorted(
        name[:80] for name in names if name not in _SUPPORTED_EXTENSIONS and not _APPEARANCE_PATTERN.match(name)
    )


def element_layout(accessor: Fields) -> tuple[np.dtype[Any], int]:
    """Return the dtype of an accessor's components, and the number of components per element."""
    kind, shape = accessor.integer("componentType"), accessor.text("type")
    if kind not in COMPONENT_DTYPES or shape not in ELEMENT_WIDTHS:
        raise accessor.error(f"has components {kind} of type {shape[:20]!r}, which meshes and animations never have")
    return np.dtype(COMPONENT_DTYPES[kind]), ELEMENT_WIDTHS[shape]


def _normalise(values: NDArray[Any]) -> Single:
    """Return normalised integers as fractions of their type's maximum, at least -1."""
    if values.dtype.kind == "f":
        return values
    fractions = np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)
    return fractions.astype(np.float32)
