"""Choice of the nodes to read from a glTF file, and their meshes: faces, materials, colours, joints.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#meshes-overview
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import FloatArray, IntArray
from mixseq.geometry.normals import hard_edges_of_normals
from mixseq.polygons import Polygons
from mixseq.surface import NO_UV, WHITE, CornerValues, FaceSet
from mixseq_io.choosing import chosen, moving
from mixseq_io.colours import with_alpha
from mixseq_io.gltf.animation import Channel
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.node_tree import Scene
from mixseq_io.gltf.primitives import Primitive
from mixseq_io.gltf.texture_transforms import texture_transform
from mixseq_io.gltf.world_points import Shape, bearers
from mixseq_io.labels.markings import Skinning, joined_skinning
from mixseq_io.scene_meshes import SceneMesh


def chosen_nodes(document: Document, scene: Scene, prim: str | None) -> list[int]:
    """Return the nodes with meshes selected by `prim`, or all; hidden ones only if there are no others."""
    nodes = [node for node in scene.objects if "mesh" in scene.nodes[node]]
    if prim is not None:
        nodes = [nodes[i] for i in chosen(document.path, [scene.objects[node] for node in nodes], prim)]
    return [node for node in nodes if node not in scene.hidden] or nodes


def moving_nodes(
    document: Document, scene: Scene, nodes: Sequence[int], channels: Collection[Channel]
) -> list[int]:
    """Return the nodes whose meshes move; all if none moves."""
    moved = {channel.node for channel in channels if channel.moves and channel.name != "weights"}
    morphed = {channel.node for channel in channels if channel.moves and channel.name == "weights"}
    moves = [
        node in morphed or not moved.isdisjoint(scene.with_above(bearers(document, scene.nodes[node], node)))
        for node in nodes
    ]
    return [nodes[i] for i in moving(document.path, [scene.objects[node] for node in nodes], moves)]


def scene_mesh_of(document: Document, shape: Shape, first: int, mirrored: bool) -> SceneMesh:
    """Return the surface of a node's mesh."""
    weld, scene = shape.weld, shape.scene
    order = [0, 2, 1] if mirrored else [0, 1, 2]
    corners = np.concatenate(
        [
            each.triangles[:, order] + run.start
            for each, run in zip(weld.primitives, weld.vertices, strict=True)
        ]
    ).reshape(-1)
    polygons = Polygons.from_triangles(weld.faces[:, order])
    found = scene.objects[shape.node]
    return SceneMesh(
        name=found.name or found.path.rpartition("/")[2],
        path=found.path,
        vertices=slice(first, first + weld.count),
        polygons=polygons,
        uvs=_uvs(weld.primitives, corners),
        colours=_colours(weld.primitives, corners),
        hard_edges=_hard_edges(weld.primitives, corners, polygons),
        face_sets=_face_sets(document, weld.primitives),
    )


def _uvs(primitives: Sequence[Primitive], corners: IntArray) -> CornerValues | None:
    """Return TEXCOORD_0, whose v points down in glTF, after material transforms; (0, 0) for primitives without."""
    flip, up = np.array([1, -1], np.float32), np.array([0, 1], np.float32)
    found = [each.attribute("TEXCOORD_0", 2) for each in primitives]
    turned = [
        None if uvs is None else _transformed(each, uvs) * flip + up
        for each, uvs in zip(primitives, found, strict=True)
    ]
    return _joined_values(primitives, turned, NO_UV, corners)


def _colours(primitives: Sequence[Primitive], corners: IntArray) -> CornerValues | None:
    """Return COLOR_0; white, as in renderers, for primitives without."""
    return _joined_values(primitives, [_colours_of_vertices(each) for each in primitives], WHITE, corners)


def _colours_of_vertices(primitive: Primitive) -> FloatArray | None:
    index = primitive.attributes.index("COLOR_0")
    if index is None:
        return None
    width = 3 if primitive.document.item("accessors", index).text("type") == "VEC3" else 4
    values = primitive.attribute("COLOR_0", width)
    assert values is not None
    if values.dtype.kind == "u":  # exporters that forget to say "normalized"
        values = values / float(np.iinfo(values.dtype).max)
    return with_alpha(values)


def _joined_values(
    primitives: Sequence[Primitive],
    found: Sequence[FloatArray | None],
    default: Sequence[float],
    corners: IntArray,
) -> CornerValues | None:
    """Join values of vertices at corners, with the default for primitives without; None if none has any."""
    if all(each is None for each in found):
        return None
    values = [
        np.tile(default, (len(each.positions), 1)) if own is None else own
        for each, own in zip(primitives, found, strict=True)
    ]
    return CornerValues.of_corners(np.concatenate(values)).taken(corners)


def _transformed(primitive: Primitive, uvs: NDArray[Any]) -> NDArray[Any]:
    transform = texture_transform(primitive.document, primitive.fields)
    if np.array_equal(transform, np.eye(2, 3)):
        return uvs
    return (uvs @ transform[:, :2].T + transform[:, 2]).astype(np.float32)


def _hard_edges(
    primitives: Sequence[Primitive], corners: IntArray, polygons: Polygons
) -> NDArray[np.int32] | None:
    """Return the normal's index of every corner; primitives without normals are flat-shaded, as glTF specifies."""
    normals, flat = [], []
    for each in primitives:
        own = each.attribute("NORMAL", 3)
        normals.append(np.zeros((len(each.positions), 3)) if own is None else own)
        flat.append(np.full(each.triangles.size, own is None))
    at_corners = np.concatenate(normals).astype(np.float64)[corners]
    hard_edges = hard_edges_of_normals(polygons, np.clip(np.nan_to_num(at_corners), -1e6, 1e6))
    if not np.concatenate(flat).any():
        return hard_edges
    groups = polygons.indices if hard_edges is None else hard_edges
    alone = np.arange(corners.size) + int(groups.max(initial=-1)) + 1
    return np.unique(np.where(np.concatenate(flat), alone, groups), return_inverse=True)[1].astype(np.int32)


def _face_sets(document: Document, primitives: Sequence[Primitive]) -> tuple[FaceSet, ...]:
    """Return a face set for every primitive with a material."""
    face_sets, count = [], 0
    for each in primitives:
        polygons = np.arange(count, count + len(each.triangles))
        count += len(each.triangles)
        index = each.fields.index("material")
        if index is not None:
            name = document.item("materials", index).text("name") or f"material {index}"
            face_sets.append(FaceSet(name, polygons, name))
    return tuple(face_sets)


def skinning_of(shapes: Sequence[Shape]) -> Skinning | None:
    """Return the joints and weights of all meshes, None without skins; unskinned meshes follow their nodes."""
    if all(shape.skin is None for shape in shapes):
        return None
    return joined_skinning([_skinning(shape) for shape in shapes])


def _skinning(shape: Shape) -> Skinning:
    if shape.skin is None:
        return Skinning.rigid(shape.scene.paths[shape.node], shape.weld.count)
    joints = shape.skin.joints
    return Skinning(
        shape.skin.weights,
        tuple(_path(shape.scene, joint) for joint in joints),
        tuple(_path_above(shape.scene, joint, joints) for joint in joints),
    )


def _path(scene: Scene, node: int) -> str:
    return scene.paths.get(node, f"node {node}")


def _path_above(scene: Scene, joint: int, joints: Sequence[int]) -> str:
    """Return the path of the nearest ancestor joint of a joint."""
    return next((_path(scene, each) for each in scene.above(joint)[1:] if each in joints), "")
