"""Buffers of glTF files: laid out and written, and decompressed.

A buffer is laid out first, then written front to back while frames arrive, with no copy in memory. All sizes and
offsets are known beforehand, except for the bounds of the points. A ``.glb`` begins with its JSON, which is written
last into reserved space, padded with spaces. A ``.gltf`` holds the buffer in base64 as its first member, since a single
file can be replaced atomically.

Compressed files are read as uncompressed documents: views (``EXT_meshopt_compression``, ``KHR_meshopt_compression``)
and primitives (``KHR_draco_mesh_compression``) get buffers that are unpacked when read, in a process of their own, by
meshopt and Google's DracoPy (extra `gltf`). A primitive is read plain if it has a plain form, too.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#glb-file-format-specification,
https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Vendor/EXT_meshopt_compression/README.md,
https://github.com/KhronosGroup/glTF/blob/main/extensions/2.0/Khronos/KHR_draco_mesh_compression/README.md
"""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError, OutputError
from mixseq.version import __version__
from mixseq_io.gltf.document import DRACO, MESHOPT, Document, Fields, layout_of
from mixseq_io.isolation import call_isolated
from mixseq_io.surfaces import colours_to_bytes

Json = dict[str, Any]
Bounds = tuple[list[float], list[float]]
Chunk = bytes | memoryview | NDArray[Any]

GENERATOR = f"mixseq {__version__}"
FLOAT, UNSIGNED = 5126, 5125
COMPONENT_OF = {"f4": FLOAT, "u4": UNSIGNED, "u2": 5123, "u1": 5121}
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963

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

    def add_points(self, points: NDArray[np.float32]) -> int:
        """Add positions of vertices ``(n, 3)``, with their bounds; return their accessor."""
        accessor = self.add_array(points, target=ARRAY_BUFFER)
        self.bounded(accessor, bounds_of(points))
        return accessor

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


def bounds_of(points: NDArray[np.float32]) -> Bounds:
    """Return the least and the largest coordinates of points ``(n, 3)``."""
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


def append(document: Json, member: str, entry: Json) -> int:
    """Append an entry to a list of the document; return its index."""
    entries = document.setdefault(member, [])
    entries.append(entry)
    return len(entries) - 1


def compute_glb_size(layout: Layout) -> int:
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
def open_buffer_writer(path: Path, temporary: Path, layout: Layout) -> Iterator[BufferWriter]:
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


Rows = NDArray[np.uint8]


def unpacked_view(document: Document, packed: Fields) -> bytes:
    """Return the unpacked bytes of a view, given its extension object."""
    if find_spec("meshopt") is None:
        raise MissingExtraError(
            f"{document.path} is compressed by meshoptimizer; to read it: pip install 'mixseq[gltf]'"
        )
    count, stride = packed.integer("count"), packed.integer("byteStride")
    mode, name = packed.text("mode"), packed.text("filter", "NONE")
    data = document.part(packed)
    here = "mixseq_io.gltf.codecs:unpack_meshopt"
    rows = call_isolated(here, document.path, data, packed.place, count, stride, mode, name)
    return bytes(rows.tobytes())


def unpack_meshopt(
    path: Path, data: bytes, place: str, count: int, stride: int, mode: str, name: str
) -> Rows:
    """Unpack a view; see `unpacked_view`. Damaged data may end the process."""
    import meshopt

    try:
        rows = meshopt.decode_gltf_buffer(data, count, stride, mode, name)
    except (ValueError, RuntimeError, TypeError) as error:
        raise Fields(path, place, {}).error(
            f"cannot be unpacked by meshoptimizer ({mode[:40]!r}, {name[:40]!r}, {stride} bytes each): {error}"
        ) from None
    return np.ascontiguousarray(rows).view(np.uint8)


@dataclass(frozen=True)
class Wanted:
    """Layout that an accessor expects."""

    unique_id: int | None
    dtype: np.dtype[Any]
    count: int
    width: int

    @property
    def size(self) -> int:
        """Its size in bytes."""
        return self.count * self.width * self.dtype.itemsize


def unpacked_primitive(
    document: Document, packed: Fields, wanted: Sequence[Wanted], sizes: Sequence[int]
) -> bytes:
    """Return the numbers of several accessors one after the other, each padded to its size in bytes."""
    if find_spec("DracoPy") is None:
        raise MissingExtraError(
            f"{document.path} is compressed with Draco; to read it: pip install 'mixseq[gltf]'"
        )
    data = document.part(document.item("bufferViews", packed.integer("bufferView")))
    arrays = call_isolated(
        "mixseq_io.gltf.codecs:decode_draco", document.path, data, packed.place, list(wanted)
    )
    return b"".join(each.tobytes().ljust(size, b"\0") for each, size in zip(arrays, sizes, strict=True))


def decode_draco(path: Path, data: bytes, place: str, wanted: Sequence[Wanted]) -> list[NDArray[Any]]:
    """Decode a primitive; see `unpacked_primitive`. Damaged data may end the process."""
    import DracoPy

    fields = Fields(path, place, {})
    try:
        mesh = DracoPy.decode(data)
        attributes = {each["unique_id"]: each["data"] for each in mesh.attributes}
        attributes[None] = mesh.faces.reshape(-1)
    except (DracoPy.FileTypeException, ValueError, AttributeError, TypeError) as error:
        raise fields.error(f"cannot be decoded by Draco: {error}") from None
    return [_fitted(fields, attributes.get(each.unique_id), each) for each in wanted]


def _fitted(fields: Fields, values: NDArray[Any] | None, wanted: Wanted) -> NDArray[Any]:
    """Convert values to the accessor's layout; DracoPy returns integers as floats."""
    if values is None or values.size != wanted.count * wanted.width:
        has = "nothing" if values is None else f"{values.size} numbers"
        raise fields.error(
            f"has {has} where {wanted.count} times {wanted.width} are expected; the file is damaged"
        )
    if wanted.dtype.kind == "f":
        return values.astype(wanted.dtype)
    limits = np.iinfo(wanted.dtype)
    whole = np.clip(np.rint(np.nan_to_num(values)), limits.min, limits.max)
    return np.asarray(whole, dtype=wanted.dtype)


_POSITION_BITS, _UV_BITS, _NORMAL_BITS = 11, 11, 7
"""Bits per number: a point is off by 1/4000 of the mesh's largest side, a normal by one degree."""

_BEST = 10
"""DracoPy's level of the strongest compression."""

_NAMES = {0: "POSITION", 1: "NORMAL", 2: "COLOR_0", 3: "TEXCOORD_0"}
"""glTF attribute names by Draco type."""


@dataclass(frozen=True, eq=False)
class DracoTriangles:
    """Compressed triangles."""

    data: bytes
    attributes: Mapping[str, NDArray[Any]]
    identifiers: Mapping[str, int]
    triangle_count: int


def compressed_triangles(
    triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> DracoTriangles:
    """Compress triangles ``(F, 3)``, and attributes ``(n, k)`` by their glTF names, colours as bytes."""
    library = _library()
    uvs, colours = attributes.get("TEXCOORD_0"), attributes.get("COLOR_0")
    try:
        data = library.encode(
            attributes["POSITION"],
            triangles,
            quantization_bits=_POSITION_BITS,
            compression_level=_BEST,
            colors=None if colours is None else colours_to_bytes(colours),
            normals=attributes["NORMAL"].astype(np.float64),
            normal_quantization_bits=_NORMAL_BITS,
            tex_coord=None if uvs is None else uvs.astype(np.float64),
            tex_coord_quantization_bits=None if uvs is None else _UV_BITS,
        )
        decoded = library.decode(data)
    except (library.EncodingFailedException, library.FileTypeException, ValueError) as error:
        raise OutputError(f"Draco cannot compress the first frame ({error}); write it plain") from error
    found = {_NAMES[each["attribute_type"]]: each for each in decoded.attributes}
    return DracoTriangles(
        data,
        {name: each["data"] for name, each in found.items()},
        {name: int(each["unique_id"]) for name, each in found.items()},
        len(decoded.faces),
    )


def _library() -> ModuleType:
    try:
        import DracoPy
    except ImportError as error:
        raise MissingExtraError(
            "a .glb is smallest with DracoPy; get it with: pip install 'mixseq[gltf]', or write a plain still "
            "(--still plain)"
        ) from error
    library: ModuleType = DracoPy
    return library


def decompress_document(document: Document) -> Document:
    """Return a document without compression; data are unpacked when they are read."""
    edits = _Edits(document)
    for number, view in enumerate(document.items("bufferViews")):
        name = next((each for each in MESHOPT if each in view.object("extensions")), None)
        if name is not None:
            edits.unpack_view(number, view, view.object("extensions").object(name))
    for number, mesh in enumerate(document.items("meshes")):
        for place, primitive in enumerate(mesh.objects("primitives")):
            if DRACO in primitive.object("extensions"):
                edits.unpack_primitive(number, place, primitive)
    return edits.document()


class _Edits:
    """Edits that replace compressed parts of a document."""

    def __init__(self, document: Document) -> None:
        self._compressed = document
        self._json = dict(document.json)
        for kind in ("accessors", "buffers", "bufferViews", "meshes"):
            if kind in self._json:
                self._json[kind] = list(self._json[kind])
        self._unpacking: dict[int, Callable[[], bytes]] = {}
        self._placed: dict[int, bool] = {}

    def document(self) -> Document:
        """Return the edited document."""
        for member in ("extensionsUsed", "extensionsRequired"):
            left = [name for name in self._compressed.top.texts(member) if name not in (DRACO, *MESHOPT)]
            self._json.pop(member, None)
            if left:
                self._json[member] = left
        if "buffers" in self._json:
            self._json["buffers"] = [
                {key: value for key, value in each.items() if key != "extensions"}
                for each in self._json["buffers"]
            ]
        return self._compressed.edited(self._json, self._unpacking)

    def unpack_view(self, number: int, view: Fields, packed: Fields) -> None:
        """Point a meshopt-compressed view at a buffer of unpacked data."""
        count, stride = packed.integer("count"), packed.integer("byteStride")
        if stride < 1 or count * stride != view.integer("byteLength"):
            raise packed.error(
                f"has {count} elements of {stride} bytes, which is not the view's length; the file is damaged"
            )
        self._compressed.check_effort(-(-count * stride // 4), packed.place)
        buffer = self._buffer(count * stride, partial(unpacked_view, self._compressed, packed))
        kept = {key: value for key, value in view.values.items() if key in ("byteStride", "target", "name")}
        self._json["bufferViews"][number] = {"buffer": buffer, "byteLength": count * stride, **kept}

    def unpack_primitive(self, mesh: int, place: int, primitive: Fields) -> None:
        """Point accessors without data of their own at the unpacked data of a Draco primitive."""
        packed = primitive.object("extensions").object(DRACO)
        names = packed.object("attributes")
        position = primitive.object("attributes").index("POSITION")
        if position is not None and "bufferView" not in self._compressed.item("accessors", position):
            indices = primitive.integer("indices")
            accessors = {
                primitive.object("attributes").integer(name): names.integer(name) for name in names.values
            }
            wanted = [self._wanted(indices, None), *(self._wanted(*each) for each in accessors.items())]
            sizes = [_aligned(each.size) for each in wanted]
            self._compressed.check_effort(sum(sizes) // 2, packed.place)
            buffer = self._buffer(
                sum(sizes), partial(unpacked_primitive, self._compressed, packed, wanted, sizes)
            )
            starts = np.cumsum([0, *sizes]).tolist()
            for accessor, each, start in zip((indices, *accessors), wanted, starts, strict=False):
                if not self._placed.get(accessor):  # primitives may have the same data
                    self._place(accessor, {"buffer": buffer, "byteOffset": start, "byteLength": each.size})
        self._replace_primitive(mesh, place)

    def _wanted(self, accessor: int, unique_id: int | None) -> Wanted:
        fields = self._compressed.item("accessors", accessor)
        dtype, width = layout_of(fields)
        return Wanted(unique_id, dtype, fields.integer("count"), width)

    def _place(self, accessor: int, view: Json) -> None:
        self._placed[accessor] = True
        self._json.setdefault("bufferViews", []).append(view)
        entry = {**self._json["accessors"][accessor], "bufferView": len(self._json["bufferViews"]) - 1}
        self._json["accessors"][accessor] = {**entry, "byteOffset": 0}

    def _replace_primitive(self, mesh: int, place: int) -> None:
        entry = self._json["meshes"][mesh]
        primitives = list(entry["primitives"])
        extensions = {name: each for name, each in primitives[place]["extensions"].items() if name != DRACO}
        primitives[place] = {key: value for key, value in primitives[place].items() if key != "extensions"}
        if extensions:
            primitives[place]["extensions"] = extensions
        self._json["meshes"][mesh] = {**entry, "primitives": primitives}

    def _buffer(self, length: int, unpack: Callable[[], bytes]) -> int:
        """Add a buffer that is unpacked when read; return its index."""
        self._json.setdefault("buffers", []).append({"byteLength": length})
        number = len(self._json["buffers"]) - 1
        self._unpacking[number] = unpack
        return number
