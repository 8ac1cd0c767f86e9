"""Buffers of glTF files: layout, writing, compression and decompression.

A buffer is laid out first, then written sequentially while frames arrive, without a copy in memory. The bounds of
points are known last, so the JSON at the start of a ``.glb`` is written last, into reserved space. A ``.gltf`` holds
the buffer in base64 as its first member, since only a single file can be replaced atomically.

Compressed files are read as uncompressed documents. Compressed views (``EXT_meshopt_compression``,
``KHR_meshopt_compression``) and primitives (``KHR_draco_mesh_compression``) get buffers that are unpacked on access, in
a separate process, by meshopt and DracoPy (extra `gltf`). The uncompressed form of a primitive is preferred.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#glb-file-format-specification,
https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0 (``Vendor``, ``Khronos``)
"""

from __future__ import annotations

import json
import struct
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import MissingExtraError, OutputError
from mixseq.mesh.measures import bounding_box
from mixseq.types import Single
from mixseq.version import __version__
from mixseq_io.files import atomic_file
from mixseq_io.gltf.document import (
    DRACO_EXTENSION,
    MESHOPT_EXTENSIONS,
    Document,
    Fields,
    element_layout,
    remove_extension,
    undeclare_extensions,
    used_extensions,
)
from mixseq_io.isolation import call_isolated
from mixseq_io.surfaces import colours_to_bytes

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
        start = _align(self.length)
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
    return _GLB_OVERHEAD_BYTES + _align(len(_encode(document))) + _align(layout.length)


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
    json_length, length = _align(len(_encode(layout.document))), _align(layout.length)
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


def _align(length: int) -> int:
    return -(-length // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES


def _unpack_view(document: Document, packed: Fields) -> bytes:
    """Return the bytes of a view compressed by meshoptimizer, given its extension object."""
    if find_spec("meshopt") is None:
        raise MissingExtraError(
            f"{document.path} is compressed by meshoptimizer; to read it: pip install 'mixseq[gltf]'"
        )
    count, stride = packed.integer("count"), packed.integer("byteStride")
    mode, name = packed.text("mode"), packed.text("filter", "NONE")
    data = document.read_view(packed)
    function = "mixseq_io.gltf.codecs:unpack_meshopt"
    elements = call_isolated(function, document.path, data, packed.place, count, stride, mode, name)
    return bytes(elements.tobytes())


def unpack_meshopt(
    path: Path, data: bytes, place: str, count: int, stride: int, mode: str, name: str
) -> NDArray[np.uint8]:
    """Unpack `count` meshopt elements of `stride` bytes; damaged data may crash the process."""
    import meshopt

    try:
        elements = meshopt.decode_gltf_buffer(data, count, stride, mode, name)
    except (ValueError, RuntimeError, TypeError) as error:
        raise Fields(path, place, {}).error(
            f"cannot be unpacked by meshoptimizer ({mode[:40]!r}, {name[:40]!r}, {stride} bytes each): {error}"
        ) from None
    return np.ascontiguousarray(elements).view(np.uint8)


@dataclass(frozen=True)
class _AccessorLayout:
    """Layout of an accessor, with the id of its Draco attribute, or None for the triangle indices."""

    unique_id: int | None
    dtype: np.dtype[Any]
    width: int
    count: int

    @property
    def size(self) -> int:
        """Size in bytes."""
        return self.count * self.width * self.dtype.itemsize


def _unpack_primitive(
    document: Document, packed: Fields, layouts: Sequence[_AccessorLayout], sizes: Sequence[int]
) -> bytes:
    """Return the concatenated bytes of a Draco primitive's accessors, each padded to its entry in `sizes`."""
    if find_spec("DracoPy") is None:
        raise MissingExtraError(f"{document.path} is compressed with Draco; to read it: pip install 'mixseq[gltf]'")
    data = document.read_view(document.item("bufferViews", packed.integer("bufferView")))
    function = "mixseq_io.gltf.codecs:decode_draco"
    arrays = call_isolated(function, document.path, data, packed.place, list(layouts))
    return b"".join(array.tobytes().ljust(size, b"\0") for array, size in zip(arrays, sizes, strict=True))


def decode_draco(path: Path, data: bytes, place: str, layouts: Sequence[_AccessorLayout]) -> list[NDArray[Any]]:
    """Decode the accessors of a Draco primitive; damaged data may crash the process."""
    import DracoPy

    fields = Fields(path, place, {})
    try:
        mesh = DracoPy.decode(data)
        attributes = {each["unique_id"]: each["data"] for each in mesh.attributes}
        attributes[None] = mesh.faces.reshape(-1)
    except (DracoPy.FileTypeException, ValueError, AttributeError, TypeError) as error:
        raise fields.error(f"cannot be decoded by Draco: {error}") from None
    return [_convert(fields, attributes.get(layout.unique_id), layout) for layout in layouts]


def _convert(fields: Fields, values: NDArray[Any] | None, layout: _AccessorLayout) -> NDArray[Any]:
    """Convert values to the accessor's layout; DracoPy returns integers as floats."""
    if values is None or values.size != layout.count * layout.width:
        size = 0 if values is None else values.size
        raise fields.error(
            f"has {size} numbers where {layout.count} times {layout.width} are expected; the file is damaged"
        )
    if layout.dtype.kind == "f":
        return values.astype(layout.dtype)
    limits = np.iinfo(layout.dtype)
    integers = np.clip(np.rint(np.nan_to_num(values)), limits.min, limits.max)
    return np.asarray(integers, dtype=layout.dtype)


_POSITION_BITS, _UV_BITS, _NORMAL_BITS = 11, 11, 7
"""Bits per number; points are accurate to 1/4000 of the bounding box's longest edge, normals to one degree."""

_MAX_COMPRESSION_LEVEL = 10
_ATTRIBUTE_NAMES = {0: "POSITION", 1: "NORMAL", 2: "COLOR_0", 3: "TEXCOORD_0"}
"""glTF attribute names by Draco type."""


def compress_triangles(
    triangles: NDArray[np.uint32], attributes: Mapping[str, Single]
) -> tuple[bytes, int, dict[str, tuple[int, NDArray[Any]]]] | None:
    """Compress triangles ``(F, 3)`` and attributes ``(n, k)`` by glTF name; return None if none has an area.

    The bytes, the number of triangles, and the Draco id and decoded values of each attribute are returned.
    """
    if find_spec("DracoPy") is None:
        raise MissingExtraError(
            "a compressed still needs DracoPy: pip install 'mixseq[gltf]', or write a plain one (--still plain)"
        )
    import DracoPy

    uvs, colours = attributes.get("TEXCOORD_0"), attributes.get("COLOR_0")
    try:
        data = DracoPy.encode(
            attributes["POSITION"],
            triangles,
            quantization_bits=_POSITION_BITS,
            compression_level=_MAX_COMPRESSION_LEVEL,
            colors=None if colours is None else colours_to_bytes(colours),
            normals=attributes["NORMAL"].astype(np.float64),
            normal_quantization_bits=_NORMAL_BITS,
            tex_coord=None if uvs is None else uvs.astype(np.float64),
            tex_coord_quantization_bits=None if uvs is None else _UV_BITS,
        )
        decoded = DracoPy.decode(data)
    except DracoPy.EncodingFailedException:
        return None
    except (DracoPy.FileTypeException, ValueError) as error:
        raise OutputError(f"Draco cannot compress the first frame ({error}); use --still plain") from error
    coded = {
        _ATTRIBUTE_NAMES[each["attribute_type"]]: (int(each["unique_id"]), each["data"]) for each in decoded.attributes
    }
    return data, len(decoded.faces), coded


def decompress_document(document: Document) -> Document:
    """Return an uncompressed form of a document, whose compressed data are unpacked on access."""
    compressions = {DRACO_EXTENSION, *MESHOPT_EXTENSIONS}
    if not compressions & used_extensions(document):
        return document
    edited = replace(document, json=deepcopy(document.json), unpackers={})
    undeclare_extensions(edited.json, compressions)
    for buffer in edited.json.get("buffers", ()):
        buffer.pop("extensions", None)
    for index, view in enumerate(document.items("bufferViews")):
        extensions = view.object("extensions")
        for name in [each for each in MESHOPT_EXTENSIONS if each in extensions][:1]:
            _replace_view(document, edited, index, view, extensions.object(name))
    for mesh_index, mesh in enumerate(document.items("meshes")):
        for index, primitive in enumerate(mesh.objects("primitives")):
            if DRACO_EXTENSION in primitive.object("extensions"):
                _replace_primitive(document, edited, primitive)
                remove_extension(edited.json["meshes"][mesh_index]["primitives"][index], DRACO_EXTENSION)
    return edited


def _replace_view(document: Document, edited: Document, index: int, view: Fields, packed: Fields) -> None:
    """Let a meshopt-compressed view of the edited document refer to a buffer of unpacked data."""
    count, stride = packed.integer("count"), packed.integer("byteStride")
    if stride < 1 or count * stride != view.integer("byteLength"):
        raise packed.error(
            f"has {count} elements of {stride} bytes, unlike the length of the view; the file is damaged"
        )
    document.check_effort(-(-count * stride // 4), packed.place)
    buffer = append(edited.json, "buffers", {"byteLength": count * stride})
    edited.unpackers[buffer] = partial(_unpack_view, document, packed)
    kept = {key: value for key, value in view.values.items() if key in ("byteStride", "target", "name")}
    edited.json["bufferViews"][index] = {"buffer": buffer, "byteLength": count * stride, **kept}


def _replace_primitive(document: Document, edited: Document, primitive: Fields) -> None:
    """Let accessors without uncompressed data refer to the unpacked data of a Draco primitive."""
    packed = primitive.object("extensions").object(DRACO_EXTENSION)
    ids, attributes = packed.object("attributes"), primitive.object("attributes")
    position = attributes.index("POSITION")
    if position is None or "bufferView" in document.item("accessors", position):
        return
    unique_ids: dict[int, int | None] = {primitive.integer("indices"): None}
    unique_ids |= {attributes.integer(name): ids.integer(name) for name in ids.values}
    layouts = []
    for accessor, unique_id in unique_ids.items():
        fields = document.item("accessors", accessor)
        layouts.append(_AccessorLayout(unique_id, *element_layout(fields), fields.integer("count")))
    sizes = [_align(layout.size) for layout in layouts]
    document.check_effort(sum(sizes) // 2, packed.place)
    buffer, start = append(edited.json, "buffers", {"byteLength": sum(sizes)}), 0
    edited.unpackers[buffer] = partial(_unpack_primitive, document, packed, layouts, sizes)
    for accessor, layout, size in zip(unique_ids, layouts, sizes, strict=True):
        entry = edited.json["accessors"][accessor]
        if "bufferView" not in entry:  # primitives may share accessors
            view = {"buffer": buffer, "byteOffset": start, "byteLength": layout.size}
            entry.update(bufferView=append(edited.json, "bufferViews", view), byteOffset=0)
        start += size
