"""Which nodes of a glTF file are read, and what is on their meshes."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import AmbiguousError, FormatError
from mixseq.geometry.normals import creases_of_normals
from mixseq.polygons import IntArray, Polygons
from mixseq.surface import CornerValues, FaceSet
from mixseq_io.blocks import warn
from mixseq_io.gltf.animation import Channel
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.primitives import Primitive
from mixseq_io.gltf.scene import Scene
from mixseq_io.gltf.skinning import Shape, bearers
from mixseq_io.pieces import Piece


def chosen_nodes(document: Document, scene: Scene, having: Sequence[int], prim: str) -> list[int]:
    """Return the nodes with meshes at or below a path, or a node's or mesh's name.

    Parameters
    ----------
    having : sequence of int
        The nodes with meshes, in order.
    prim : str
        The path, see `Scene.paths`; "/" is everything.

    Raises
    ------
    FormatError
        If there is no such node or mesh.
    AmbiguousError
        If several have that name.
    """
    path = prim.strip("/")
    if not path:
        return list(having)
    paths = [node for node, own in scene.paths.items() if own == path]
    names = [node for node in scene.paths if scene.nodes[node].text("name") == prim]
    meshes = [node for node in having if mesh_name(document, scene, node) == prim]
    for found in (paths, names, meshes):
        below = [node for node in having if set(scene.above(node)) & set(found)]
        if below and len(found) > 1:
            several = ", ".join(repr(scene.paths[node]) for node in found[:20])
            raise AmbiguousError(
                f"{document.path}: {prim!r} is the name of {len(found)} nodes; give a path: {several}"
            )
        if below:
            return below
    there = ", ".join(repr(scene.paths[node]) for node in having[:20]) + (" ..." if len(having) > 20 else "")
    raise FormatError(f"{document.path} has no mesh at {prim!r}; there are {there}")


def mesh_name(document: Document, scene: Scene, node: int) -> str:
    """Return the name of a node's mesh."""
    return document.item("meshes", scene.nodes[node].integer("mesh")).text("name")


def moving_nodes(
    document: Document, scene: Scene, having: Sequence[int], channels: Collection[Channel]
) -> list[int]:
    """Return the nodes whose meshes move; all if none does.

    Warns
    -----
    MixseqWarning
        Of those that are left out.
    """
    moved = {channel.node for channel in channels if channel.moves and channel.name != "weights"}
    morphed = {channel.node for channel in channels if channel.moves and channel.name == "weights"}
    moving = [
        node
        for node in having
        if node in morphed or moved & scene.with_above(bearers(document, scene.nodes[node], node))
    ]
    still = [node for node in having if node not in moving]
    if moving and still:
        names = ", ".join(repr(scene.paths[node]) for node in still[:20]) + (
            " ..." if len(still) > 20 else ""
        )
        warn(
            f"{document.path}: {len(still)} meshes stand still and are left out: {names}; prim='/' takes them, too"
        )
    return moving or list(having)


def piece_of(document: Document, shape: Shape, first: int, mirrored: bool) -> Piece:
    """Return the surface of a node's mesh.

    Parameters
    ----------
    first : int
        Its first vertex in the sequence.
    mirrored : bool
        Whether the node turns its faces inside out; then their corners are listed the other way round.
    """
    weld, scene = shape.weld, shape.scene
    order = [0, 2, 1] if mirrored else [0, 1, 2]
    corners = np.concatenate(
        [
            each.triangles[:, order] + run.start
            for each, run in zip(weld.primitives, weld.vertices, strict=True)
        ]
    ).reshape(-1)
    polygons = Polygons.from_triangles(weld.faces[:, order])
    name = scene.nodes[shape.node].text("name") or mesh_name(document, scene, shape.node)
    path = scene.paths[shape.node]
    return Piece(
        name=name or path.rpartition("/")[2],
        path=path,
        vertices=slice(first, first + weld.count),
        polygons=polygons,
        uvs=_uvs(weld.primitives, corners),
        creases=_creases(weld.primitives, corners, polygons),
        face_sets=_face_sets(document, weld.primitives),
    )


def _uvs(primitives: Sequence[Primitive], corners: IntArray) -> CornerValues | None:
    """Return TEXCOORD_0, whose v points down in glTF; (0, 0) where only other primitives have it."""
    found = [each.attribute("TEXCOORD_0", 2) for each in primitives]
    if all(each is None for each in found):
        return None
    values = [
        np.zeros((len(each.positions), 2)) if uvs is None else np.column_stack([uvs[:, 0], 1 - uvs[:, 1]])
        for each, uvs in zip(primitives, found, strict=True)
    ]
    rows, indices = np.unique(np.concatenate(values), axis=0, return_inverse=True)
    return CornerValues(rows, indices.reshape(-1)[corners])


def _creases(
    primitives: Sequence[Primitive], corners: IntArray, polygons: Polygons
) -> NDArray[np.int32] | None:
    """Tell which corners share a normal; where a primitive has no normals, its faces are flat, says glTF."""
    normals, flat = [], []
    for each in primitives:
        own = each.attribute("NORMAL", 3)
        normals.append(np.zeros((len(each.positions), 3)) if own is None else own)
        flat.append(np.full(each.triangles.size, own is None))
    at_corners = np.concatenate(normals).astype(np.float64)[corners]
    creases = creases_of_normals(polygons, np.clip(np.nan_to_num(at_corners), -1e6, 1e6))
    if not np.concatenate(flat).any():
        return creases
    groups = polygons.indices if creases is None else creases
    alone = np.arange(corners.size) + int(groups.max(initial=-1)) + 1
    return np.unique(np.where(np.concatenate(flat), alone, groups), return_inverse=True)[1].astype(np.int32)


def _face_sets(document: Document, primitives: Sequence[Primitive]) -> tuple[FaceSet, ...]:
    face_sets, count = [], 0
    for each in primitives:
        polygons = np.arange(count, count + len(each.triangles))
        count += len(each.triangles)
        index = each.fields.index("material")
        if index is None:
            face_sets.append(FaceSet(f"primitive {each.number}", polygons))
        else:
            name = document.item("materials", index).text("name") or f"material {index}"
            face_sets.append(FaceSet(name, polygons, name))
    return tuple(face_sets)
