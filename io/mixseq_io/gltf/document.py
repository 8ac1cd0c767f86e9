"""glTF files (.gltf, .glb): the JSON, kept unchanged for writers, and the numbers in its buffers.

Every count and offset is compared with the available bytes before an array is allocated.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError
from mixseq_io.gltf.containers import Data, chunks, data_in_memory, data_of_file, data_of_uri
from mixseq_io.gltf.json_fields import Fields, check_extensions
from mixseq_io.memory import check_memory
from mixseq_io.reader import reading

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy dtypes by ``componentType``."""

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers per element by accessor type; MAT2 and MAT3 do not occur in meshes and animations."""

# Numbers allowed beyond the stored bytes: zeros, and the same mesh in many places.
_FREE_NUMBERS, _NUMBERS_PER_BYTE = 10_000_000, 16

_KINDS = (
    "accessors",
    "animations",
    "buffers",
    "bufferViews",
    "materials",
    "meshes",
    "nodes",
    "scenes",
    "skins",
)


@dataclass(frozen=True, eq=False)
class Document:
    """glTF file: JSON in memory, numbers read on demand."""

    path: Path
    json: dict[str, Any]
    chunk: Data | None
    size: int
    unpacking: Mapping[int, Callable[[], bytes]] = field(default_factory=dict, repr=False)
    _buffers: dict[int, Data] = field(default_factory=dict, repr=False)

    @cached_property
    def _items(self) -> dict[str, list[Fields]]:
        return {kind: self.top.objects(kind) for kind in _KINDS}

    def edited(self, json: dict[str, Any], unpacking: Mapping[int, Callable[[], bytes]]) -> Document:
        """Return the file with another JSON, whose additional buffers are unpacked when read."""
        return Document(self.path, json, self.chunk, self.size, unpacking)

    @property
    def top(self) -> Fields:
        """Outermost JSON object."""
        return Fields(self.path, "", self.json)

    def items(self, kind: str) -> list[Fields]:
        """Return all items of a list such as ``"nodes"``, ``"meshes"`` or ``"animations"``."""
        return self._items[kind]

    def item(self, kind: str, index: int) -> Fields:
        """Return an item of such a list."""
        items = self._items[kind]
        if not 0 <= index < len(items):
            raise FormatError(
                f"{self.path}: {kind}[{index}] is referred to, but there are {len(items)} {kind}"
            )
        return items[index]

    def accessor(self, index: int) -> NDArray[Any]:
        """Return an accessor's numbers ``(n,)`` or ``(n, k)``, sparse values filled in, normalised ones as floats."""
        accessor = self.item("accessors", index)
        dtype, width = layout_of(accessor)
        count = accessor.integer("count")
        if "bufferView" in accessor:
            values = self._numbers(accessor, dtype, (count, width))
        else:
            self.check_effort(count * width, accessor.place)
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            values = self._with_sparse(accessor, values)
        if accessor.flag("normalized"):
            values = _normalised(values)
        values.flags.writeable = False
        return values[:, 0] if width == 1 else values

    @cached_property
    def data_size(self) -> int:
        """Size of the file and its buffers in bytes."""
        stored = (index for index in range(len(self.items("buffers"))) if self._is_stored(index))
        return self.size + sum(self.buffer(index).size for index in stored)

    def _is_stored(self, index: int) -> bool:
        """Whether a buffer is stored in a file; others are generated or reserve room for unpacked data."""
        return "uri" in self.item("buffers", index) or (index == 0 and self.chunk is not None)

    def check_effort(self, numbers: int, what: str) -> None:
        """Raise an error for far more numbers than the file has bytes, as damaged or hostile files announce."""
        if numbers > _FREE_NUMBERS + _NUMBERS_PER_BYTE * self.data_size:
            raise FormatError(
                f"{self.path}: {what} have {numbers} numbers, but the file only {self.data_size} bytes; it is damaged, "
                "or repeats one mesh too often: choose fewer with prim"
            )
        check_memory(self.path, 8 * numbers, what)

    def buffer(self, index: int) -> Data:
        """Return the bytes of a buffer: a .glb chunk, a data URI, or a file beside."""
        if index not in self._buffers:
            self._buffers[index] = self._read_buffer(index)
        return self._buffers[index]

    def _read_buffer(self, index: int) -> Data:
        buffer = self.item("buffers", index)
        length = buffer.integer("byteLength")
        if index in self.unpacking:
            data = data_in_memory(self.unpacking[index]())
        elif "uri" in buffer:
            data = data_of_uri(buffer, buffer.text("uri"))
        elif index == 0 and self.chunk is not None:
            data = self.chunk
        else:
            raise buffer.error("has no data; it is compressed or kept elsewhere, export it with its data")
        if length > data.size:
            raise buffer.error(f"has {data.size} bytes of {length}; it is truncated")
        return data.part(0, length)

    def part(self, place: Fields) -> bytes:
        """Return the bytes of an object with ``buffer``, ``byteOffset`` and ``byteLength``."""
        data = self.buffer(place.integer("buffer"))
        start, length = place.integer("byteOffset", 0), place.integer("byteLength")
        if start + length > data.size:
            raise place.error(f"does not fit its buffer of {data.size} bytes; the file is damaged")
        return data.read(start, length)

    def _numbers(self, owner: Fields, dtype: np.dtype[Any], shape: tuple[int, int]) -> NDArray[Any]:
        """Return the numbers ``(n, k)`` of an accessor or of a part of a sparse one."""
        view = self.item("bufferViews", owner.integer("bufferView"))
        data = self.buffer(view.integer("buffer"))
        start, length = view.integer("byteOffset", 0), view.integer("byteLength")
        element = dtype.itemsize * shape[1]
        stride, offset = view.integer("byteStride", element), owner.integer("byteOffset", 0)
        if start + length > data.size or stride < element:
            raise view.error(f"does not fit its buffer of {data.size} bytes; the file is damaged")
        if shape[0] and offset + stride * (shape[0] - 1) + element > length:
            raise owner.error(
                f"has {shape[0]} elements, more than its {length} bytes hold; the file is damaged"
            )
        if not shape[0]:
            return np.empty(shape, dtype)
        content = data.read(start + offset, stride * (shape[0] - 1) + element)
        return np.ndarray(shape, dtype, content, 0, (stride, dtype.itemsize))

    def _with_sparse(self, accessor: Fields, values: NDArray[Any]) -> NDArray[Any]:
        sparse = accessor.object("sparse")
        rows, replaced = sparse.object("indices"), sparse.object("values")
        kind = COMPONENTS.get(rows.integer("componentType"), "")
        if kind not in ("<u1", "<u2", "<u4"):
            raise rows.error("are not unsigned integers")
        count = sparse.integer("count")
        indices = self._numbers(rows, np.dtype(kind), (count, 1))[:, 0]
        if indices.max(initial=0) >= max(len(values), 1):
            raise rows.error(f"go up to {indices.max()}, but there are {len(values)} elements")
        filled = values.copy()
        filled[indices] = self._numbers(replaced, values.dtype, (count, values.shape[1]))
        return filled


def load_document(path: Path) -> Document:
    """Read a .gltf or .glb file; buffers in other files are read on demand."""
    with reading(path, "glTF"):
        data = data_of_file(path)
        binary = data.read(0, 4) == b"glTF"
        text, chunk = chunks(path, data) if binary else (data.read(0, data.size), None)
    with reading(path, "glTF", ValueError, RecursionError):
        parsed = json.loads(text.decode("utf-8-sig"))
    if not isinstance(parsed, dict):
        raise FormatError(f"{path} is JSON, but not glTF")
    top = Fields(path, "", parsed)
    version = top.object("asset").text("version")
    if not version.startswith("2."):
        raise FormatError(
            f"{path} is glTF version {version or 'unknown'}; version 2 is read, convert it first"
        )
    check_extensions(top)
    document = Document(path, parsed, chunk, data.size)
    document.items("nodes")  # raises errors of any of the lists
    return document


def layout_of(accessor: Fields) -> tuple[np.dtype[Any], int]:
    """Return the dtype of an accessor's components and their number per element."""
    kind, shape = accessor.integer("componentType"), accessor.text("type")
    if kind not in COMPONENTS or shape not in WIDTHS:
        raise accessor.error(
            f"has components {kind} of type {shape[:20]!r}, which meshes and animations never have"
        )
    return np.dtype(COMPONENTS[kind]), WIDTHS[shape]


def _normalised(values: NDArray[Any]) -> NDArray[np.float32]:
    """Return integers as fractions of the largest; see "Animations" and "Accessors" in the specification."""
    if values.dtype.kind == "f":
        return values
    fractions = np.maximum(values / float(np.iinfo(values.dtype).max), -1.0)
    return fractions.astype(np.float32)
