"""Buffer of a glTF file: laid out first, then written front to back while frames arrive, with no copy in memory.

All sizes and offsets are known beforehand, except for the bounds of the points. A ``.glb`` begins with its JSON, which
is written last into reserved space, padded with spaces. A ``.gltf`` holds the buffer in base64 as its first member,
since a single file can be replaced atomically.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#glb-file-format-specification
"""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.version import __version__

Json = dict[str, Any]
Bounds = tuple[list[float], list[float]]
Chunk = bytes | memoryview | NDArray[Any]

GENERATOR = f"mixseq {__version__}"
FLOAT, UNSIGNED = 5126, 5125
COMPONENT_OF = {"f4": FLOAT, "u4": UNSIGNED, "u2": 5123, "u1": 5121}
VERTICES, INDICES = 34962, 34963

_LARGEST_GLB = 2**32 - 1
_LARGEST_TEXT = 384 << 20  # of the buffer; browsers hold no string of more than 512 MiB
_ALIGNMENT = 4
# Stand for the bounds of points until they are known: no float32 has more digits.
UNKNOWN: Bounds = ([-1.2345678901234567e-100] * 3, [-1.2345678901234567e-100] * 3)


class Layout:
    """Document whose buffer views are appended one after the other."""

    def __init__(self, document: Json) -> None:
        self.document = document
        self.length = 0
        self.contents: list[tuple[int, Iterable[Chunk]]] = []

    def reserve(self, length: int, **properties: Any) -> int:
        """Add a view of data that is written later; return its index."""
        start = _aligned(self.length)
        self.length = start + length
        view = {"buffer": 0, "byteOffset": start, "byteLength": length, **properties}
        return append(self.document, "bufferViews", view)

    def add(self, data: Iterable[Chunk], length: int, **properties: Any) -> int:
        """Add a view of given data; return its index."""
        number = self.reserve(length, **properties)
        self.contents.append((self.document["bufferViews"][number]["byteOffset"], data))
        return number

    def add_array(self, values: NDArray[Any], **properties: int) -> int:
        """Add an array ``(n,)`` or ``(n, k)`` in a view of its own; return its accessor."""
        data = np.ascontiguousarray(values)
        view = self.add([data], data.nbytes, **properties)
        width = 1 if data.ndim == 1 else data.shape[1]
        kind = {1: "SCALAR", 16: "MAT4"}.get(width, f"VEC{width}")
        return self.accessor(view, len(data), kind, component=COMPONENT_OF[data.dtype.str[1:]])

    def accessor(self, view: int, count: int, kind: str, offset: int = 0, component: int = FLOAT) -> int:
        """Add an accessor at an offset in bytes within a view; return its index."""
        accessor = {
            "bufferView": view,
            "byteOffset": offset,
            "componentType": component,
            "count": count,
            "type": kind,
        }
        return append(self.document, "accessors", accessor)

    def bounded(self, accessor: int, bounds: Bounds = UNKNOWN) -> Json:
        """Set the bounds of an accessor, or reserve room for them; return the accessor."""
        found: Json = self.document["accessors"][accessor]
        found["min"], found["max"] = bounds
        return found


def append(document: Json, member: str, entry: Json) -> int:
    """Append an entry to a list of the document; return its index."""
    entries = document.setdefault(member, [])
    entries.append(entry)
    return len(entries) - 1


def glb_size(layout: Layout) -> int:
    """Return the size of a .glb in bytes; the writer adds the document's ``buffers``."""
    return 28 + _aligned(len(_encoded(layout.document))) + _aligned(layout.length)


class BufferWriter:
    """Writer of a buffer, front to back; gaps between views are filled with zeros."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._write = write
        self.position = 0

    def put(self, offset: int, data: Iterable[Chunk]) -> None:
        """Write the chunks of a view, which begins at `offset`."""
        self._next(bytes(offset - self.position))
        for chunk in data:
            self._next(chunk.tobytes() if isinstance(chunk, np.ndarray) else bytes(chunk))

    def _next(self, data: bytes) -> None:
        self._write(data)
        self.position += len(data)


@contextmanager
def writing_buffer(path: Path, temporary: Path, layout: Layout) -> Iterator[BufferWriter]:
    """Write a file: data of the layout, then data put by the block, then the document in its final state."""
    binary = path.suffix.lower() == ".glb"
    layout.document["buffers"] = [{"byteLength": layout.length}]
    _check_size(path, layout, binary)
    with temporary.open("wb") as file, (_binary if binary else _text)(file, layout) as writer:
        for offset, data in layout.contents:
            writer.put(offset, data)
        yield writer
        writer.put(layout.length, [])


@contextmanager
def _binary(file: IO[bytes], layout: Layout) -> Iterator[BufferWriter]:
    room = _aligned(len(_encoded(layout.document)))
    length = _aligned(layout.length)
    file.write(bytes(12 + 8 + room))
    file.write(struct.pack("<I4s", length, b"BIN\0"))
    writer = BufferWriter(file.write)
    yield writer
    writer.put(length, [])
    file.seek(0)
    file.write(struct.pack("<4sII", b"glTF", 2, 12 + 8 + room + 8 + length))
    file.write(struct.pack("<I4s", room, b"JSON"))
    file.write(_encoded(layout.document).ljust(room))


@contextmanager
def _text(file: IO[bytes], layout: Layout) -> Iterator[BufferWriter]:
    rest = b""

    def write(data: bytes) -> None:
        """Write whole groups of three bytes, each as four base64 letters."""
        nonlocal rest
        data = rest + data
        whole = len(data) // 3 * 3
        file.write(b64encode(data[:whole]))
        rest = data[whole:]

    start = f'{{"buffers":[{{"byteLength":{layout.length},"uri":"data:application/octet-stream;base64,'
    file.write(start.encode())
    yield BufferWriter(write)
    file.write(b64encode(rest) + b'"}],')
    members = {name: value for name, value in layout.document.items() if name != "buffers"}
    file.write(_encoded(members)[1:])


def _check_size(path: Path, layout: Layout, binary: bool) -> None:
    if not binary and layout.length > _LARGEST_TEXT:
        raise OutputError(
            f"{path}: {layout.length / 1e9:.2f} GB of points are too many for a text file; write .glb"
        )
    if binary and layout.length + len(_encoded(layout.document)) + 64 > _LARGEST_GLB:
        raise OutputError(
            f"{path}: the points take {layout.length / 1e9:.2f} GB, but a GLB file cannot exceed 4.29 GB; "
            "write fewer frames, or USD, .npz or .h5"
        )


def _encoded(document: Json) -> bytes:
    text = json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.encode("utf-8", errors="replace")


def _aligned(length: int) -> int:
    return -(-length // _ALIGNMENT) * _ALIGNMENT
