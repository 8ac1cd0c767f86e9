"""Reader and writer of the glTF extension ``MIXSEQ_mesh_sequence``: frames as the streams of a compressed model.

The text and streams are those of an HDF5 file, with vertices, faces, texture coordinates and hard edges. They precede
textures in the file, for progressive loading. The still is the first frame as ordinary glTF primitives by material, for
viewers without the extension: compressed by Draco (11 bits for points, 7 for normals), plain float32, or a degenerate
triangle per material. Every body has a node in a scene of its own; viewers show the first. Materials are copied from
the original by name. Frames and still are relative to the origin of the text, at which the node is.

Specification: ``docs/file-format.md``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.choices import StillName
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence, decode
from mixseq.errors import FormatError
from mixseq.mesh.measures import NO_ORIGIN, corner_normals
from mixseq.mesh.surface import Origin
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Single
from mixseq_io.coded.packing import pack
from mixseq_io.coded.streams import Container
from mixseq_io.files import check_memory
from mixseq_io.gltf.buffers import (
    COMPONENT_TYPES,
    FLOAT_COMPONENT,
    GENERATOR_NAME,
    UNSIGNED_COMPONENT,
    Json,
    Layout,
    append,
    compute_bounds,
    compute_glb_size,
    open_buffer_writer,
)
from mixseq_io.gltf.codecs import compress_triangles
from mixseq_io.gltf.document import (
    DRACO_EXTENSION,
    MALFORMED_JSON_ERRORS,
    SEQUENCE_EXTENSION,
    Document,
    Fields,
    collect_extensions,
    list_sequences,
    load_document,
)
from mixseq_io.gltf.new_document import (
    SplitPrimitive,
    add_material,
    add_triangles,
    assign_face_sets,
    material_name,
    name_member,
    node_transform,
    split_primitives,
)
from mixseq_io.gltf.writer import embed_image, iterate_references
from mixseq_io.reader import as_float32, translate_read_errors, warn
from mixseq_io.scene_meshes import SceneMesh


def read_container(path: Path) -> Container:
    """Read the text and streams of a .glb's mesh sequences, the first body and further ones."""
    document = load_document(path)
    containers = [
        Container(
            text=_read_data(document, extension, "coding"),
            streams=_read_data(document, extension, "streams"),
            version=extension.integer("version"),
        )
        for extension in list_sequences(document)
    ]
    if not containers:
        raise FormatError(f"{document.path} has no compressed model; make one with mixseq encode --max-error")
    return replace(containers[0], bodies=tuple(containers[1:]))


def overhead_size(path: Path) -> int:
    """Return the size in bytes of a .glb's contents outside mesh sequences, such as stills and images."""
    document = load_document(path)
    own = {extension.index(name) for extension in list_sequences(document) for name in ("coding", "streams")}
    views = document.items("bufferViews")
    return sum(view.integer("byteLength") for index, view in enumerate(views) if index not in own)


def _read_data(document: Document, extension: Fields, key: str) -> bytes:
    view = document.item("bufferViews", extension.integer(key))
    check_memory(document.path, view.integer("byteLength"), f"its {key}")
    with translate_read_errors(document.path, "glTF"):
        return document.read_view(view)


def copy_materials(layout: Layout, names: Collection[str], origin: Origin | None) -> dict[str, int]:
    """Copy the first material of each name from the original file; return the indices of the copies by name."""
    if origin is None or origin.format != "glTF" or not names:
        return {}
    path = Path(origin.path)
    try:
        with translate_read_errors(path, "glTF", *MALFORMED_JSON_ERRORS):
            original = load_document(path)
            copied: dict[tuple[str, int], int] = {}
            indices: dict[str, int] = {}
            for index, fields in enumerate(original.items("materials")):
                name = fields.text("name") or f"material {index}"
                if name in names and name not in indices:
                    indices[name] = _copy_entry(layout, original, copied, "materials", index)
            return indices
    except FormatError as error:
        warn(f"{error}; materials keep their names, but are plain")
        return {}


def _copy_entry(layout: Layout, original: Document, copied: dict[tuple[str, int], int], kind: str, index: int) -> int:
    """Copy an entry of a list and all entries that it references, unless they are `copied`; return its new index."""
    if (kind, index) not in copied:
        fields = original.top.objects(kind)[index]
        entry = deepcopy(dict(fields.values))
        if kind == "images" and "bufferView" not in entry:
            embed_image(layout, entry, fields)
        elif kind == "images":
            content = original.read_view(original.item("bufferViews", fields.integer("bufferView")))
            entry["bufferView"] = layout.add([content], len(content))
        else:
            for owner, key, target in iterate_references(kind, entry):
                reference = Fields(original.path, fields.place, owner).integer(key)
                owner[key] = _copy_entry(layout, original, copied, target, reference)
        copied[kind, index] = append(layout.document, kind, entry)
    return copied[kind, index]


def as_one_mesh(header: SequenceHeader) -> SceneMesh:
    """Return a sequence as one mesh, since all objects are compressed together."""
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


def encode_polygon_runs(mesh: SceneMesh) -> list[int]:
    """Return the primitive of each polygon as runs: ``[0, 120, 1, 80]`` is 120 polygons of primitive 0, 80 of 1."""
    primitive = np.unique(assign_face_sets(mesh), return_inverse=True)[1]
    starts = np.flatnonzero(np.diff(primitive, prepend=-1))
    counts = np.diff(starts, append=len(primitive))
    return np.column_stack([primitive[starts], counts]).reshape(-1).tolist()


def add_still(
    layout: Layout, mesh: SceneMesh, points: FloatArray, still: StillName, materials: dict[str, int]
) -> list[Json]:
    """Add the primitives of a still of points ``(V, 3)`` to a document."""
    positions = as_float32(points[None], 0, "glTF")[0]
    normals = corner_normals(positions[None], mesh.polygons, mesh.hard_edges)[0].astype(np.float32)
    add = {"draco": _add_draco, "plain": add_triangles, "none": _add_degenerate}[still]
    entries = []
    for each in split_primitives(mesh):
        entry = add(layout, *_select_used(each, positions, normals))
        if each.face_set is not None:
            entry["material"] = add_material(layout.document, material_name(each.face_set), materials)
        entries.append(entry)
    return entries


def _select_used(
    primitive: SplitPrimitive, positions: Single, normals: Single
) -> tuple[NDArray[np.uint32], dict[str, Single]]:
    """Return the triangles ``(F, 3)`` of a primitive, and attributes ``(n, k)`` of the vertices in triangles."""
    used, corners = np.unique(primitive.triangles, return_inverse=True)
    attributes = {"POSITION": positions[primitive.vertex_ids[used]], "NORMAL": normals[primitive.normal_ids[used]]}
    attributes |= {name: values[used] for name, values in primitive.attributes.items()}
    return corners.reshape(-1, 3).astype(np.uint32), attributes


def _add_draco(layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, Single]) -> Json:
    compressed = compress_triangles(triangles, attributes)
    if compressed is None:
        warn("Draco compresses no triangles without area; the still of these is plain")
        return add_triangles(layout, triangles, attributes)
    data, triangle_count, coded = compressed
    view = layout.add([data], len(data))
    accessors = {
        name: _add_empty_accessor(layout, len(values), f"VEC{values.shape[1]}", COMPONENT_TYPES[values.dtype.str[1:]])
        for name, (_, values) in coded.items()
    }
    if "COLOR_0" in accessors:
        layout.document["accessors"][accessors["COLOR_0"]]["normalized"] = True
    layout.set_bounds(accessors["POSITION"], compute_bounds(coded["POSITION"][1]))
    ids = {name: unique_id for name, (unique_id, _) in coded.items()}
    return {
        "attributes": accessors,
        "indices": _add_empty_accessor(layout, 3 * triangle_count, "SCALAR", UNSIGNED_COMPONENT),
        "extensions": {DRACO_EXTENSION: {"bufferView": view, "attributes": ids}},
    }


def _add_degenerate(layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, Single]) -> Json:
    """Add a degenerate triangle as accessors without data, with texture coordinates if the primitive has them."""
    accessors = {
        name: _add_empty_accessor(layout, 3, f"VEC{values.shape[1]}", FLOAT_COMPONENT)
        for name, values in attributes.items()
        if name not in ("NORMAL", "COLOR_0")
    }
    layout.set_bounds(accessors["POSITION"], ([0.0] * 3, [0.0] * 3))
    return {"attributes": accessors}


def _add_empty_accessor(layout: Layout, count: int, kind: str, component: int) -> int:
    entry = {"componentType": component, "count": count, "type": kind}
    return append(layout.document, "accessors", entry)


class StillBody(NamedTuple):
    """A body in a .glb: its streams, and a frame as still."""

    container: Container
    header: SequenceHeader
    points: FloatArray  # (V, 3) of the still
    origin: Float  # (3,) at which its node is

    @classmethod
    def from_sequence(cls, coded: CompressedSequence) -> StillBody:
        """Pack a compressed sequence, and decode its first frame."""
        points, origin = decode(coded)(coded.header.times[0]), np.array(coded.parameters.origin or NO_ORIGIN)
        return cls(pack(replace(coded, bodies=())), coded.header, points, origin)


def write_sequence(path: Path, coded: CompressedSequence, still: StillName) -> None:
    """Write a compressed sequence as a .glb."""
    write_bodies(path, map(StillBody.from_sequence, coded.all_bodies), still)


def write_bodies(path: Path, bodies: Iterable[StillBody], still: StillName) -> None:
    """Write a .glb with the streams of bodies, and their stills, each in a scene of its own."""
    with open_buffer_writer(path, _create_layout(bodies, still)):
        pass


def glb_size(bodies: Iterable[StillBody], still: StillName) -> int:
    """Return the size in bytes of the .glb that `write_bodies` writes."""
    return compute_glb_size(_create_layout(bodies, still))


def _create_layout(bodies: Iterable[StillBody], still: StillName) -> Layout:
    layout = Layout({"asset": {"version": "2.0", "generator": GENERATOR_NAME}})
    document = layout.document
    nodes = [append(document, "nodes", _add_body(layout, body, still)) for body in bodies]
    document["scene"], document["scenes"] = 0, [{"nodes": [node]} for node in nodes]
    document["extensionsUsed"] = sorted(collect_extensions(document))
    required = {"draco": DRACO_EXTENSION, "none": SEQUENCE_EXTENSION}.get(still)
    if required in document["extensionsUsed"]:
        document["extensionsRequired"] = [required]
    return layout


def _add_body(layout: Layout, body: StillBody, still: StillName) -> Json:
    """Add the mesh of a body; return the node that has it."""
    container, header, points, origin = body
    coding = layout.add([container.text], len(container.text))
    streams = layout.add([container.streams], len(container.streams))
    mesh = as_one_mesh(header)
    names = {material_name(each) for each in mesh.face_sets}
    materials = copy_materials(layout, names, header.surface.origin)
    primitives = add_still(layout, mesh, points - origin, still, materials)
    extension: Json = {"version": container.version, "coding": coding, "streams": streams}
    if len(primitives) > 1:
        extension["polygons"] = encode_polygon_runs(mesh)
    name = name_member(header.name)
    entry = {**name, "primitives": primitives, "extensions": {SEQUENCE_EXTENSION: extension}}
    return {**name, "mesh": append(layout.document, "meshes", entry), **node_transform(header, origin)}
