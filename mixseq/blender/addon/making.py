"""Create meshes from models, with polygons, UVs, colour attributes, materials and sharp edges."""

from __future__ import annotations

import bpy
import numpy as np

from mixseq.blender.motion import MeshParts, part_slices
from mixseq.sequence.header import SequenceHeader


def new_mesh(header: SequenceHeader, part: str) -> bpy.types.Mesh:
    """Create the mesh of one part of a model, or of all parts for ""; `live` moves the vertices."""
    parts = MeshParts.from_header(header, part)
    vertices, _ = part_slices(header, part)
    mesh = bpy.data.meshes.new(part.rpartition("/")[2] or header.name)
    mesh.vertices.add(vertices.stop - vertices.start)
    mesh.loops.add(len(parts.corners))
    mesh.loops.foreach_set("vertex_index", parts.corners.astype(np.int32))
    mesh.polygons.add(len(parts.counts))
    mesh.polygons.foreach_set("loop_start", parts.starts.astype(np.int32))
    for name in parts.materials:
        mesh.materials.append(_material(name))
    mesh.polygons.foreach_set("material_index", parts.material_of_polygon.astype(np.int32))
    mesh.shade_smooth()
    mesh.update(calc_edges=True)
    if parts.uvs is not None:
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.ravel(parts.uvs).astype(np.float32))
    if parts.colours is not None:  # linear, like Blender's float colours
        attribute = mesh.color_attributes.new(name="Color", type="FLOAT_COLOR", domain="CORNER")
        attribute.data.foreach_set("color", np.ravel(parts.colours).astype(np.float32))
    _mark_sharp_edges(mesh, parts)
    mesh.validate(clean_customdata=False)  # removes polygons with a repeated vertex, which Blender forbids
    return mesh


def _material(name: str) -> bpy.types.Material | None:
    """Return the material with a name; create the material if it is missing."""
    return (bpy.data.materials.get(name) or bpy.data.materials.new(name)) if name else None


def _mark_sharp_edges(mesh: bpy.types.Mesh, parts: MeshParts) -> None:
    edge_of_corner = np.empty(len(mesh.loops), dtype=np.int32)
    mesh.loops.foreach_get("edge_index", edge_of_corner)
    is_sharp = parts.sharp_edges(edge_of_corner)
    if is_sharp.any():
        mesh.attributes.new("sharp_edge", "BOOLEAN", "EDGE").data.foreach_set("value", is_sharp)
