"""Rewrite extensions that move or multiply meshes as plain nodes and channels of glTF.

Channels of ``KHR_animation_pointer`` to the transform or weights of a node become channels of this node, those to the
weights of a mesh channels of all nodes that use them; the path of a single weight is "weights/2". Instances of
``EXT_mesh_gpu_instancing`` become child nodes "instance 0", "instance 1", ... with the mesh.

Specification: https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Khronos/KHR_animation_pointer,
https://github.com/KhronosGroup/glTF/tree/main/extensions/2.0/Vendor/EXT_mesh_gpu_instancing
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

from mixseq.errors import FormatError
from mixseq_io.gltf.codecs import Json, append, decompress_document
from mixseq_io.gltf.document import (
    INSTANCING_EXTENSION,
    POINTER_EXTENSION,
    Document,
    Fields,
    load_document,
    remove_extension,
    undeclare_extensions,
    used_extensions,
)
from mixseq_io.reader import warn

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
