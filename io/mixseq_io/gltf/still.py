"""The still of a mesh sequence: its first frame as ordinary glTF, by material, for other viewers.

Decoders use its materials only, so it may be coarse: by Draco with points at 11 bits and normals at 7; plain float32;
or one degenerate triangle for each material.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray
from mixseq.choices import StillName
from mixseq.errors import OutputError
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import SequenceHeader
from mixseq_io.blocks import as_float32
from mixseq_io.gltf import draco_packing
from mixseq_io.gltf.buffers import COMPONENT_OF, FLOAT, INDICES, UNSIGNED, VERTICES, Json, Layout, append
from mixseq_io.gltf.compression import DRACO
from mixseq_io.gltf.new_document import (
    SplitPrimitive,
    add_colours,
    material,
    material_name,
    narrow,
    owners,
    split_corners,
    upside_down,
)
from mixseq_io.scene_meshes import SceneMesh

_TRIANGLES_WITHOUT_AREA = {
    "componentType": FLOAT,
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
        name: add_colours(layout, values) if name == "COLOR_0" else layout.add_array(values, target=VERTICES)
        for name, values in attributes.items()
    }
    layout.bounded(accessors["POSITION"], _bounds(attributes["POSITION"]))
    return {
        "attributes": accessors,
        "indices": layout.add_array(narrow(triangles.reshape(-1)), target=INDICES),
    }


def _draco(
    layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> Json:
    coded = draco_packing.compressed_triangles(
        triangles,
        attributes["POSITION"],
        attributes["NORMAL"],
        attributes.get("TEXCOORD_0"),
        attributes.get("COLOR_0"),
    )
    view = layout.add([coded.data], len(coded.data))
    accessors = {
        name: _without_data(layout, len(values), f"VEC{values.shape[1]}", COMPONENT_OF[values.dtype.str[1:]])
        for name, values in coded.attributes.items()
    }
    if "COLOR_0" in accessors:
        layout.document["accessors"][accessors["COLOR_0"]]["normalized"] = True
    layout.bounded(accessors["POSITION"], _bounds(coded.attributes["POSITION"]))
    return {
        "attributes": accessors,
        "indices": _without_data(layout, 3 * coded.triangle_count, "SCALAR", UNSIGNED),
        "extensions": {DRACO: {"bufferView": view, "attributes": dict(coded.identifiers)}},
    }


def _none(
    layout: Layout, triangles: NDArray[np.uint32], attributes: Mapping[str, NDArray[np.float32]]
) -> Json:
    """Add a triangle of zeros as accessors without data, with texture coordinates that materials may need."""
    accessors = {
        name: _without_data(layout, 3, f"VEC{values.shape[1]}", FLOAT)
        for name, values in attributes.items()
        if name not in ("NORMAL", "COLOR_0")
    }
    layout.bounded(accessors["POSITION"], ([0.0] * 3, [0.0] * 3))
    return {"attributes": accessors}


def _without_data(layout: Layout, count: int, kind: str, component: int) -> int:
    entry = {"componentType": component, "count": count, "type": kind}
    return append(layout.document, "accessors", entry)


def _bounds(points: NDArray[np.float32]) -> tuple[list[float], list[float]]:
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()
