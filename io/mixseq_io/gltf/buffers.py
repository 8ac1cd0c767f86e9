"""Buffers of glTF files: layout, then sequential writing while frames arrive, without a copy in memory.

The bounds of points are known last, so the JSON at the start of a ``.glb`` is written last, into reserved space. A
``.gltf`` holds the buffer in base64 as its first member, since only a single file can be replaced atomically.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#glb-file-format-specification
"""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.mesh.measures import bounding_box
from mixseq.types import Single
from mixseq.version import __version__
from mixseq_io.files import atomic_file

Json = dict[str, Any]
Bounds = tuple[list[float], list[float]]
Chunk = bytes | memoryview | NDArray[Any]

GENERATOR_NAME = f"mixseq {__version__}"
FLOAT_COMPONENT, UNSIGNED_COMPONENT = 5126, 5125
COMPONENT_TYPES = {"f4": FLOAT_COMPONENT, "u4": UNSIGNED_COMPONENT, "u2": 5123, "u1": 5121}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

_MAX_GLB_BYTES = 2**32 - 1
_MAX_TEXT_BUFFER_BYTES = 384 << 20  # 512 MiB in base64, the longest string of browsers
_ALIGNMENT_BYTES = 4
_GLB_OVERHEAD_BYTES = 28
_PLACEHOLDER_BOUNDS: Bounds = (
    [-1.2345678901234567e-100] * 3,
    [-1.2345678901234567e-100] * 3,
)  # no float32 has a longer text


class Layout:
    """Document with a buffer whose views are appended one after the other."""

    def __init__(self, document: Json) -> None:
        self.document = document
        self.length = 0
        self.contents: list[tuple[int, Iterable[Chunk]]] = []

    def reserve(self, length: int, **properties: Any) -> int:
        """Add a view whose data are written later; return its index."""
        start = align(self.length)
        self.length = start + length
        view = {"buffer": 0, "byteOffset": start, "byteLength": length, **properties}
        return append(self.document, "bufferViews", view)

    def add(self, data: Iterable[Chunk], length: int, **properties: Any) -> int:
        """Add a view of given data; return its index."""
        view = self.reserve(length, **properties)
        self.contents.append((self.document["bufferViews"][view]["byteOffset"], data))
        return view

    def add_array(self, values: NDArray[Any], **properties: int) -> int:
        """Add an array ``(n,)`` or ``(n, k)`` in a separate view; return its accessor's index."""
        data = np.ascontiguousarray(values)
        view = self.add([data], data.nbytes, **properties)
        width = 1 if data.ndim == 1 else data.shape[1]
        kind = {1: "SCALAR", 16: "MAT4"}.get(width, f"VEC{width}")
        return self.accessor(view, len(data), kind, component=COMPONENT_TYPES[data.dtype.str[1:]])

    def add_points(self, points: Single) -> int:
        """Add vertex positions ``(n, 3)`` with their bounds; return their accessor's index."""
        accessor = self.add_array(points, target=ARRAY_BUFFER)
        self.set_bounds(accessor, compute_bounds(points))
        return accessor

    def accessor(self, view: int, count: int, kind: str, offset: int = 0, component: int = FLOAT_COMPONENT) -> int:
        """Add an accessor at an offset in bytes within a view; return its index."""
        position = {"bufferView": view, "byteOffset": offset}
        contents = {"componentType": component, "count": count, "type": kind}
        return append(self.document, "accessors", position | contents)

    def set_bounds(self, accessor: int, bounds: Bounds = _PLACEHOLDER_BOUNDS) -> Json:
        """Set the bounds of an accessor, or reserve space for the bounds; return the accessor's JSON entry."""
        entry: Json = self.document["accessors"][accessor]
        entry["min"], entry["max"] = bounds
        return entry


def compute_bounds(points: Single) -> Bounds:
    """Return the minimum and maximum of points ``(n, 3)``."""
    low, high = bounding_box(points)
    return low.tolist(), high.tolist()


def append(document: Json, member: str, entry: Json) -> int:
    """Append an entry to a list of a document; return the entry's index."""
    entries = document.setdefault(member, [])
    entries.append(entry)
    return len(entries) - 1


def add_channels(
    animation: Json, times: int, values: int, nodes: Iterable[int], path: str, interpolation: str = "LINEAR"
) -> None:
    """Add a sampler of the accessors of times and values to an animation, and a channel for every node."""
    sampler = append(animation, "samplers", {"input": times, "output": values, "interpolation": interpolation})
    for node in nodes:
        append(animation, "channels", {"sampler": sampler, "target": {"node": node, "path": path}})


def compute_glb_size(layout: Layout) -> int:
    """Return the size in bytes of the .glb that is written of a layout."""
    document = layout.document | {"buffers": [{"byteLength": layout.length}]}
    return _GLB_OVERHEAD_BYTES + align(len(_encode(document))) + align(layout.length)


class BufferWriter:
    """Sequential writer of a buffer; gaps between views are filled with zeros."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._write = write
        self.position = 0

    def put(self, offset: int, data: Iterable[Chunk]) -> None:
        """Write the chunks of a view that begins at `offset`."""
        for chunk in chain([bytes(offset - self.position)], data):
            content = chunk.tobytes() if isinstance(chunk, np.ndarray) else bytes(chunk)
            self._write(content)
            self.position += len(content)


@contextmanager
def open_buffer_writer(
    path: Path, layout: Layout, check: Callable[[Path], object] | None = None
) -> Iterator[BufferWriter]:
    """Write the data of a layout; on exit from the context, complete the file; `check` is that of `atomic_file`."""
    is_binary = path.suffix.lower() == ".glb"
    layout.document["buffers"] = [{"byteLength": layout.length}]
    _check_size(path, layout, is_binary)
    write = _write_glb if is_binary else _write_text
    with atomic_file(path, check) as temporary, temporary.open("wb") as file, write(file, layout) as writer:
        for offset, data in layout.contents:
            writer.put(offset, data)
        yield writer
        writer.put(layout.length, [])


@contextmanager
def _write_glb(file: IO[bytes], layout: Layout) -> Iterator[BufferWriter]:
    json_length, length = align(len(_encode(layout.document))), align(layout.length)
    file.write(bytes(12 + 8 + json_length))
    file.write(struct.pack("<I4s", length, b"BIN\0"))
    writer = BufferWriter(file.write)
    yield writer
    writer.put(length, [])
    file.seek(0)
    file.write(struct.pack("<4sII", b"glTF", 2, _GLB_OVERHEAD_BYTES + json_length + length))
    file.write(struct.pack("<I4s", json_length, b"JSON"))
    file.write(_encode(layout.document).ljust(json_length))


@contextmanager
def _write_text(file: IO[bytes], layout: Layout) -> Iterator[BufferWriter]:
    pending = b""

    def write(data: bytes) -> None:
        """Write data as base64, four letters per complete group of three bytes."""
        nonlocal pending
        data = pending + data
        end = len(data) // 3 * 3
        file.write(b64encode(data[:end]))
        pending = data[end:]

    start = f'{{"buffers":[{{"byteLength":{layout.length},"uri":"data:application/octet-stream;base64,'
    file.write(start.encode())
    yield BufferWriter(write)
    file.write(b64encode(pending) + b'"}],')
    members = {name: value for name, value in layout.document.items() if name != "buffers"}
    file.write(_encode(members)[1:])


def _check_size(path: Path, layout: Layout, is_binary: bool) -> None:
    if not is_binary and layout.length > _MAX_TEXT_BUFFER_BYTES:
        raise OutputError(f"{path}: {layout.length / 1e9:.2f} GB of points are too many for a text file; write .glb")
    if is_binary and layout.length + len(_encode(layout.document)) + 64 > _MAX_GLB_BYTES:
        raise OutputError(
            f"{path}: the points take {layout.length / 1e9:.2f} GB, but a GLB file cannot exceed 4.29 GB; "
            "write fewer frames, or USD, .npz or .h5"
        )


def _encode(document: Json) -> bytes:
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.encode("utf-8", errors="replace")


def align(length: int) -> int:
    """Return the next multiple of four bytes."""
    return -(-length // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES
