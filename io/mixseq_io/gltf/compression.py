"""Compressed glTF files as uncompressed documents: views and primitives get buffers that are unpacked when read.

``EXT_meshopt_compression`` and ``KHR_meshopt_compression`` pack buffer views (`mixseq_io.gltf.meshopt`),
``KHR_draco_mesh_compression`` packs triangles and attributes of a primitive (`mixseq_io.gltf.draco`), which is read
plain if it has a plain form, too. Those modules have the specifications.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from mixseq_io.gltf.document import Document, layout_of
from mixseq_io.gltf.draco import Wanted, unpacked_primitive
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.meshopt import unpacked_view

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")

Json = dict[str, Any]
_ALIGNMENT = 4


def plain(document: Document) -> Document:
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
            sizes = [-(-each.size // _ALIGNMENT) * _ALIGNMENT for each in wanted]
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
