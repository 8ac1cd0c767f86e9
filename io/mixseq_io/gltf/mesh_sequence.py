"""The glTF extension ``MIXSEQ_mesh_sequence``: a mesh whose frames are the streams of a compressed model.

::

    "meshes": [{
        "primitives": [...],                 the first frame, for viewers that do not know the extension
        "extensions": {"MIXSEQ_mesh_sequence": {
            "version": 1,                    of compressed models
            "coding": 5,                     buffer view: the JSON text
            "streams": 6,                    buffer view: the index, then all streams
            "polygons": [0, 120, 1, 80]      if there are several primitives: the first 120 polygons are of primitive
        }}                                   0, the next 80 of primitive 1, and so on
    }]

Text and streams are, byte for byte, those of an HDF5 file. Vertices, faces, texture coordinates and hard edges are in
them; of the primitives a decoder needs the materials only. Schema and specification: ``docs/file-format.md``.

The still is the first frame as ordinary glTF, by material, for other viewers. It may be coarse: by Draco with points at
11 bits and normals at 7; plain float32; or one degenerate triangle for each material. Materials are copied from the
original by name. Text and streams come first, before textures, for slow loading.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from copy import deepcopy
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import StillName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, to_model
from mixseq.errors import AmbiguousError, FormatError, OutputError
from mixseq.mesh.measures import shared_normals
from mixseq.mesh.surface import Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray
from mixseq_io.coded.packing import pack
from mixseq_io.coded.streams import Container
from mixseq_io.files import atomic_file, check_memory
from mixseq_io.gltf.codecs import (
    ARRAY_BUFFER,
    COMPONENT_TYPES,
    ELEMENT_ARRAY_BUFFER,
    FLOAT_COMPONENT,
    GENERATOR_NAME,
    UNSIGNED_COMPONENT,
    Json,
    Layout,
    append,
    compress_triangles,
    compute_bounds,
    compute_glb_size,
    open_buffer_writer,
)
from mixseq_io.gltf.document import (
    DRACO_EXTENSION,
    MALFORMED_JSON_ERRORS,
    SEQUENCE_EXTENSION,
    Document,
    Fields,
    load_document,
    open_data,
    read_glb_chunks,
)
from mixseq_io.gltf.edits import content_of_image, used_extensions
from mixseq_io.gltf.new_document import (
    SplitPrimitive,
    add_colours,
    axis_conversion,
    material,
    material_name,
    named,
    narrow,
    owners,
    split_corners,
    upside_down,
)
from mixseq_io.reader import as_float32, translate_read_errors, warn
from mixseq_io.scene_meshes import SceneMesh


def is_glb(path: Path) -> bool:
    """Whether a file name is that of a binary glTF file."""
    return path.suffix.lower() == ".glb"


def has_sequence(path: Path) -> bool:
    """Whether a .glb has a mesh sequence."""
    with translate_read_errors(path, "glTF"):
        data = open_data(path)
        if data.read(0, 4) != b"glTF":
            return False  # the error is reported by its reader
        text, _ = read_glb_chunks(path, data)
    if f'"{SEQUENCE_EXTENSION}"'.encode() not in text:  # most files are known by that, without being parsed
        return False
    return next(_sequences(load_document(path)), None) is not None


def read_container(path: Path) -> Container:
    """Read the text and streams of a .glb's mesh sequence."""
    document = load_document(path)
    extension = _only_one(document)
    return Container(
        text=_content(document, extension, "coding"),
        streams=_content(document, extension, "streams"),
        version=extension.integer("version"),
    )


def overhead_size(path: Path) -> int:
    """Return the size in bytes of a .glb without text and streams: a still, and images."""
    document = load_document(path)
    extension = _only_one(document)
    own = {extension.index(name) for name in ("coding", "streams")}
    views = document.items("bufferViews")
    return sum(view.integer("byteLength") for number, view in enumerate(views) if number not in own)


def _only_one(document: Document) -> Fields:
    found = list(_sequences(document))
    if not found:
        raise FormatError(f"{document.path} has no compressed model; make one with mixseq encode --max-error")
    if len(found) > 1:
        raise AmbiguousError(f"{document.path} has {len(found)} mesh sequences; files with one are read")
    return found[0]


def _sequences(document: Document) -> Iterator[Fields]:
    for mesh in document.items("meshes"):
        extensions = mesh.object("extensions")
        if SEQUENCE_EXTENSION in extensions:
            yield extensions.object(SEQUENCE_EXTENSION)


def _content(document: Document, extension: Fields, key: str) -> bytes:
    view = document.item("bufferViews", extension.integer(key))
    check_memory(document.path, view.integer("byteLength"), f"its {key}")
    with translate_read_errors(document.path, "glTF"):
        return document.read_view(view)


def carried_materials(layout: Layout, names: Collection[str], origin: Origin | None) -> dict[str, int]:
    """Copy materials into a document."""
    if origin is None or origin.format != "glTF" or not names:
        return {}
    path = Path(origin.path)
    try:
        with translate_read_errors(path, "glTF", *MALFORMED_JSON_ERRORS):
            copy = _Copy(layout, load_document(path))
            return copy.materials(names)
    except FormatError as error:
        warn(f"{error}; materials are plain, with the names that they had")
        return {}


class _Copy:
    """Copier between two documents that copies each entry once."""

    def __init__(self, layout: Layout, original: Document) -> None:
        self._layout, self._original = layout, original
        self._copied: dict[tuple[str, int], int] = {}

    def materials(self, names: Collection[str]) -> dict[str, int]:
        """Copy the first material of each name."""
        found: dict[str, int] = {}
        for number, each in enumerate(self._original.items("materials")):
            name = each.text("name") or f"material {number}"
            if name in names and name not in found:
                found[name] = self._entry("materials", number)
        return found

    def _entry(self, kind: str, number: int) -> int:
        """Copy an entry of a list and all it refers to; return its new index."""
        if (kind, number) not in self._copied:
            original = self._original.top.objects(kind)[number]
            entry = deepcopy(dict(original.values))
            if kind == "images":
                self._embed(entry, original)
            for owner, key, of in _references(kind, entry):
                owner[key] = self._entry(of, Fields(original.file, original.place, owner).integer(key))
            self._copied[kind, number] = append(self._layout.document, kind, entry)
        return self._copied[kind, number]

    def _embed(self, entry: Json, image: Fields) -> None:
        if "bufferView" in image:
            content = self._original.read_view(
                self._original.item("bufferViews", image.integer("bufferView"))
            )
        else:
            try:
                content, entry["mimeType"] = content_of_image(image)
            except FormatError as error:
                warn(f"{error}; the image is not taken along, only the reference to it")
                return
        entry.pop("uri", None)
        entry["bufferView"] = self._layout.add([content], len(content))


def _references(kind: str, entry: Json) -> Iterator[tuple[Json, str, str]]:
    """Yield each reference of a material or texture: its object, its member and the kind of entry it refers to."""
    if kind == "textures":
        for owner in (entry, *entry.get("extensions", {}).values()):
            if "source" in owner:
                yield owner, "source", "images"
        if "sampler" in entry:
            yield entry, "sampler", "samplers"
    elif kind == "materials":
        waiting = [entry]
        while waiting:
            each = waiting.pop()
            for key, value in each.items():
                if isinstance(value, dict):
                    waiting.append(value)
                    if key.endswith("Texture") and "index" in value:
                        yield value, "index", "textures"


_TRIANGLES_WITHOUT_AREA = {
    "componentType": FLOAT_COMPONENT,
    "count": 3,
    "type": "VEC3",
    "min": [0.0] * 3,
    "max": [0.0] * 3,
}


def as_one_mesh(header: SequenceHeader) -> SceneMesh:
    """Return a sequence as one mesh, since all objects are coded together."""
    surface = header.surface
    return SceneMesh(
        name=header.name,
        path="",
        vertices=slice(0, header.vertex_count),
        polygons=header.polygons,
        uvs=surface.uvs,
        colours=surface.colours,
        hard_edges=surface.hard_edges,
        face_sets=surface.face_sets,
    )


def runs_of_polygons(mesh: SceneMesh) -> list[int]:
    """Return runs of polygons and their primitives (`split_corners`): ``[0, 120, 1, 80]`` is 120 of 0, then 80 of 1."""
    primitive = np.unique(owners(mesh), return_inverse=True)[1]
    starts = np.flatnonzero(np.diff(primitive, prepend=-1))
    counts = np.diff(starts, append=len(primitive))
    return np.column_stack([primitive[starts], counts]).reshape(-1).tolist()


def add_still(
    layout: Layout, mesh: SceneMesh, points: FloatArray, still: StillName, materials: dict[str, int]
) -> list[Json]:
    """Add the primitives of a still to a document: points ``(V, 3)``."""
    single = as_float32(points[None], 0, "glTF")[0]
    normals = shared_normals(single[None], mesh.polygons, mesh.hard_edges)[0].astype(np.float32)
    add = {"draco": _draco, "plain": _plain, "none": _none}[still]
    entries = []
    for each in split_corners(mesh):
        entry = add(layout, *_used(each, single, normals))
        if each.face_set is not None:
            entry["material"] = material(layout.document, material_name(each.face_set), materials)
        entries.append(entry)
    if not entries:
        raise OutputError("glTF cannot hold a mesh without faces; write .h5")
    return entries


def _used(
    primitive: SplitPrimitive, points: NDArray[np.float32], normals: NDArray[np.float32]
) -> tuple[NDArray[np.uint32], dict[str, NDArray[np.float32]]]:
    """Return the triangles ``(F, 3)``, and attributes ``(n, k)`` of their vertices."""
    kept, corners = np.unique(primitive.triangles, return_inverse=True)
    attributes = {
        "POSITION": points[primitive.vertices[kept]],
        "NORMAL": normals[primitive.normals[kept]],
    }
    if primitive.uvs is not None:
        attributes["TEXCOORD_0"] = upside_down(primitive.uvs[kept])
    if primitive.colours is not None:
        attributes["COLOR_0"] = primitive.colours[kept]
    return corners.reshape(-1, 3).astype(np.uint32), attributes


def _plain(
    layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> Json:
    accessors = {
        name: add_colours(layout, values)
        if name == "COLOR_0"
        else layout.add_array(values, target=ARRAY_BUFFER)
        for name, values in attributes.items()
    }
    layout.set_bounds(accessors["POSITION"], compute_bounds(attributes["POSITION"]))
    return {
        "attributes": accessors,
        "indices": layout.add_array(narrow(triangles.reshape(-1)), target=ELEMENT_ARRAY_BUFFER),
    }


def _draco(
    layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> Json:
    coded = compress_triangles(triangles, attributes)
    view = layout.add([coded.data], len(coded.data))
    accessors = {
        name: _without_data(
            layout, len(values), f"VEC{values.shape[1]}", COMPONENT_TYPES[values.dtype.str[1:]]
        )
        for name, values in coded.attributes.items()
    }
    if "COLOR_0" in accessors:
        layout.document["accessors"][accessors["COLOR_0"]]["normalized"] = True
    layout.set_bounds(accessors["POSITION"], compute_bounds(coded.attributes["POSITION"]))
    return {
        "attributes": accessors,
        "indices": _without_data(layout, 3 * coded.triangle_count, "SCALAR", UNSIGNED_COMPONENT),
        "extensions": {DRACO_EXTENSION: {"bufferView": view, "attributes": dict(coded.attribute_ids)}},
    }


def _none(
    layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> Json:
    """Add a triangle of zeros as accessors without data, with texture coordinates that materials may need."""
    accessors = {
        name: _without_data(layout, 3, f"VEC{values.shape[1]}", FLOAT_COMPONENT)
        for name, values in attributes.items()
        if name not in ("NORMAL", "COLOR_0")
    }
    layout.set_bounds(accessors["POSITION"], ([0.0] * 3, [0.0] * 3))
    return {"attributes": accessors}


def _without_data(layout: Layout, count: int, kind: str, component: int) -> int:
    entry = {"componentType": component, "count": count, "type": kind}
    return append(layout.document, "accessors", entry)


_TEXT = 1000
"""Maximum size of a text in bytes, apart from long names."""

_FINER = 1.02
"""Largest ratio of the size of a decoded frame's still to that of the frame itself."""


def write_sequence(path: Path, coded: CompressedSequence, still: StillName) -> None:
    """Write a compressed sequence as a .glb."""
    write_container(path, pack(coded), coded.header, to_model(coded)(coded.header.times[0]), still)


def write_container(
    path: Path, container: Container, header: SequenceHeader, points: FloatArray, still: StillName
) -> None:
    """Write text, streams, and a still of `points` ``(V, 3)``; see `write_sequence`."""
    layout = _layout(header, points, container, still)
    with atomic_file(path) as temporary, open_buffer_writer(path, temporary, layout):
        pass


def bound_overhead_size(header: SequenceHeader, points: FloatArray, still: StillName) -> int:
    """Return an upper bound in bytes of a .glb without its streams: points ``(V, 3)``."""
    layout = _layout(header, points, Container(bytes(_TEXT + 6 * len(header.name)), b""), still)
    return int(_FINER * compute_glb_size(layout))


def _layout(header: SequenceHeader, points: FloatArray, container: Container, still: StillName) -> Layout:
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR_NAME}})
    coding = layout.add([container.text], len(container.text))
    streams = layout.add([container.streams], len(container.streams))
    mesh = as_one_mesh(header)
    names = {material_name(each) for each in mesh.face_sets}
    materials = carried_materials(layout, names, header.surface.origin)
    primitives = add_still(layout, mesh, points, still, materials)
    runs = runs_of_polygons(mesh) if len(primitives) > 1 else None
    extension = {
        "version": container.version,
        "coding": coding,
        "streams": streams,
        **({} if runs is None else {"polygons": runs}),
    }
    document = layout.document
    entry = {**named(header.name), "primitives": primitives, "extensions": {SEQUENCE_EXTENSION: extension}}
    node = {**named(header.name), "mesh": append(document, "meshes", entry), **axis_conversion(header)}
    document["scene"], document["scenes"] = 0, [{"nodes": [append(document, "nodes", node)]}]
    document["extensionsUsed"] = sorted(used_extensions(document))
    needed = [DRACO_EXTENSION] if still == "draco" else [SEQUENCE_EXTENSION] if still == "none" else []
    if needed:
        document["extensionsRequired"] = needed
    return layout
