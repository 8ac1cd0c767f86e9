"""Compression of glTF files, and documents without it and without extensions that move or multiply meshes.

Compressed views (``EXT_meshopt_compression``, ``KHR_meshopt_compression``) and primitives
(``KHR_draco_mesh_compression``) get buffers that are unpacked on access, in a separate process, by meshopt and DracoPy
(extra `gltf`). The uncompressed form of a primitive is preferred.

Channels of ``KHR_animation_pointer`` to the transform or weights of a node become channels of this node, those to the
weights of a mesh channels of all nodes that use them; the path of a single weight is "weights/2". Instances of
``EXT_mesh_gpu_instancing`` become child nodes "instance 0", "instance 1", ... with the mesh.

Specification: https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0 (``Vendor``, ``Khronos``)
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, MissingExtraError, OutputError
from mixseq.types import Single
from mixseq_io.gltf.buffers import Json, align, append
from mixseq_io.gltf.document import (
    DRACO_EXTENSION,
    INSTANCING_EXTENSION,
    MESHOPT_EXTENSIONS,
    POINTER_EXTENSION,
    Document,
    Fields,
    element_layout,
    load_document,
    remove_extension,
    undeclare_extensions,
    used_extensions,
)
from mixseq_io.isolation import call_isolated
from mixseq_io.reader import warn
from mixseq_io.surfaces import colours_to_bytes


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
    sizes = [align(layout.size) for layout in layouts]
    document.check_effort(sum(sizes) // 2, packed.place)
    buffer, start = append(edited.json, "buffers", {"byteLength": sum(sizes)}), 0
    edited.unpackers[buffer] = partial(_unpack_primitive, document, packed, layouts, sizes)
    for accessor, layout, size in zip(unique_ids, layouts, sizes, strict=True):
        entry = edited.json["accessors"][accessor]
        if "bufferView" not in entry:  # primitives may share accessors
            view = {"buffer": buffer, "byteOffset": start, "byteLength": layout.size}
            entry.update(bufferView=append(edited.json, "bufferViews", view), byteOffset=0)
        start += size


_WEIGHTS_PATTERN = r"weights(?:/\d{1,9})?"
_POINTER_PATTERN = re.compile(
    rf"/nodes/(\d{{1,9}})/(translation|rotation|scale|{_WEIGHTS_PATTERN})|/meshes/(\d{{1,9}})/({_WEIGHTS_PATTERN})"
)
_INSTANCE_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}  # numbers of an instance by attribute


def load_plain_document(path: Path) -> Document:
    """Read a .gltf or .glb file, without compression, pointers of animations to nodes, and instances."""
    document, extensions = decompress_document(load_document(path)), {POINTER_EXTENSION, INSTANCING_EXTENSION}
    if not extensions & used_extensions(document):
        return document
    plain = replace(document, json=deepcopy(document.json))
    instances = {}
    for index in _instanced_nodes(document):
        try:
            instances[index] = _add_instances(document, plain.json, index)
        except FormatError as error:
            warn(f"{error}; its instances are left out")
    for animation, entry in zip(document.items("animations"), plain.json.get("animations", ()), strict=True):
        entry["channels"] = [
            {**channel.values, "target": target}
            for channel in animation.objects("channels")
            for target in _resolve(document, channel.object("target"), instances)
        ]
    undeclare_extensions(plain.json, extensions)
    return plain


def _resolve(document: Document, target: Fields, instances: Mapping[int, Sequence[int]]) -> list[Json]:
    """Return the targets of a channel at nodes and at instances; the target itself if it points elsewhere."""
    node, name, nodes = target.index("node"), target.text("path"), list[int]()
    pointer = target.object("extensions").object(POINTER_EXTENSION).text("pointer")
    found = _POINTER_PATTERN.fullmatch(pointer) if name == "pointer" else None
    if found and found[3]:
        name, users = found[4], enumerate(document.items("nodes"))
        nodes = [index for index, user in users if user.index("mesh") == int(found[3]) and "weights" not in user]
    elif found and int(found[1]) < len(document.items("nodes")):
        name, nodes = found[2], [int(found[1])]
    elif node is not None:
        nodes = [node]
    if not nodes:
        return [dict(target.values)]
    if name.startswith("weights"):
        nodes = [each for index in nodes for each in instances.get(index, [index])]
    return [{"node": each, "path": name} for each in nodes]


def _instanced_nodes(document: Document) -> list[int]:
    """Return the nodes whose meshes have instances; warn of skinned ones, whose joints move a single mesh."""
    nodes = document.items("nodes")
    found = [index for index, node in enumerate(nodes) if INSTANCING_EXTENSION in node.object("extensions")]
    for index in found:
        if "skin" in nodes[index]:
            warn(f"{document.path}: nodes[{index}] has a skin; its instances ({INSTANCING_EXTENSION}) are left out")
    return [index for index in found if "mesh" in nodes[index] and "skin" not in nodes[index]]


def _add_instances(document: Document, plain: Json, index: int) -> list[int]:
    """Move the mesh of a node of a plain document to a child node for each of its instances; return these."""
    node = document.items("nodes")[index]
    extension = node.object("extensions").object(INSTANCING_EXTENSION)
    attributes = extension.object("attributes")
    stored = [name for name in _INSTANCE_WIDTHS if name.upper() in attributes]
    values = {name: document.accessor(attributes.integer(name.upper())) for name in stored}
    accessors = (document.item("accessors", attributes.integer(name)) for name in attributes.values)
    counts = {accessor.integer("count") for accessor in accessors}
    if len(counts) != 1 or any(each.shape[1:] != (_INSTANCE_WIDTHS[name],) for name, each in values.items()):
        raise extension.error("has attributes of different counts or types; the file is damaged")
    (count,) = counts
    document.check_effort(16 * (len(plain["nodes"]) + count), "instances of all meshes together")
    entry = plain["nodes"][index]
    shared = {key: entry.pop(key) for key in ("mesh", "weights") if key in entry}
    remove_extension(entry, INSTANCING_EXTENSION)
    transforms = ({name: values[name][k].tolist() for name in stored} for k in range(count))
    children = [
        append(plain, "nodes", {"name": f"instance {k}", **shared, **transform})
        for k, transform in enumerate(transforms)
    ]
    if children or "children" in entry:
        entry["children"] = children + entry.get("children", [])
    return children
