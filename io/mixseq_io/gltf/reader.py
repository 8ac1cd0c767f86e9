"""glTF, reading: skinned, morphed and moving meshes in world space (.gltf, .glb).

Frames are at all keys of the chosen meshes, or at a given rate. Where more than translations and linear morph weights
moves, points follow arcs, and gaps between keys are filled with frames (`mixseq_io.gltf.animation.played_times`).
Keys are float32; frames within that rounding of the frame grid are moved onto it in float64. Split vertices are
welded (`mixseq_io.gltf.primitives`). Points are computed in float64 and rounded to float32. A .glb with a mesh sequence
(`mixseq_io.gltf.mesh_sequence`) is decoded as a compressed model.

In the bind pose of a skin, the inverse bind matrix :math:`I_j` takes the mesh to the joint's axes, so that the joint
lies at :math:`I_j^{-1}` in mesh space. Mesh space is placed in the world by the first joint without a parent,
:math:`W_r I_r`, where its node stands:

.. math:: M_j = W_r I_r I_j^{-1}.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mixseq.errors import FormatError, InvalidSequenceError, NoMeshError
from mixseq.mesh.measures import hard_edges_of_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import NO_UV, WHITE, CornerValues, FaceSet, Origin
from mixseq.sequence.header import DEFAULT_FPS, SequenceHeader
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.gltf.animation import (
    Channel,
    NodeSkin,
    Shape,
    bearers,
    choose_animation,
    inverse_binds_of,
    joints_of,
    key_times,
    played_rate,
    played_times,
    pose_at,
    rate_of,
    read_channels,
    read_shape,
    sampled_times,
    told_by,
)
from mixseq_io.gltf.codecs import decompress_document
from mixseq_io.gltf.document import Document, Fields, load_document
from mixseq_io.gltf.primitives import Primitive, Weld, primitives_of, texture_transform, weld
from mixseq_io.gltf.scene import Pose, Scene, read_scene
from mixseq_io.reader import SequenceReader, prefix_errors, warn
from mixseq_io.rig_arrays import build_skeleton, choose_skeleton
from mixseq_io.scene_meshes import (
    SceneMesh,
    common_name,
    join_meshes,
    select_meshes,
    select_moving_meshes,
    snap_to_frames,
)
from mixseq_io.surfaces import ensure_alpha
from mixseq_io.text.labels import Markings, Skinning, concatenate_skinning

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Skeleton


def chosen_nodes(document: Document, scene: Scene, prim: str | None) -> list[int]:
    """Return the nodes with meshes selected by `prim`, or all; hidden ones only if there are no others."""
    nodes = [node for node in scene.objects if "mesh" in scene.nodes[node]]
    if prim is not None:
        nodes = [
            nodes[i] for i in select_meshes(document.path, [scene.objects[node] for node in nodes], prim)
        ]
    return [node for node in nodes if node not in scene.hidden] or nodes


def moving_nodes(
    document: Document, scene: Scene, nodes: Sequence[int], channels: Collection[Channel]
) -> list[int]:
    """Return the nodes whose meshes move; all if none moves."""
    moved = {channel.node for channel in channels if channel.moves and channel.name != "weights"}
    morphed = {channel.node for channel in channels if channel.moves and channel.name == "weights"}
    moves = [
        node in morphed
        or not moved.isdisjoint(scene.with_ancestors(bearers(document, scene.nodes[node], node)))
        for node in nodes
    ]
    return [
        nodes[i] for i in select_moving_meshes(document.path, [scene.objects[node] for node in nodes], moves)
    ]


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
    return ensure_alpha(values)


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


def _skinning(shape: Shape) -> Skinning:
    """Return a mesh's joints and weights; an unskinned mesh follows its node."""
    if shape.skin is None:
        return Skinning.rigid(shape.scene.paths[shape.node], shape.weld.count)
    joints = shape.skin.joints
    paths = tuple(shape.scene.paths.get(joint, f"node {joint}") for joint in joints)
    above = tuple(paths[parent] if parent >= 0 else "" for parent in _parents(shape.scene, joints))
    return Skinning(shape.skin.weights, paths, above)


def read_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skin; see `mixseq_io.read_skeleton`."""
    document = decompress_document(load_document(path))
    scene = read_scene(document)
    skin = _chosen(document, name)
    joints = joints_of(document, skin)
    parents = _parents(scene, joints)
    labels = [scene.nodes[joint].text("name") for joint in joints]
    return build_skeleton(labels, parents, _bind_pose(document, scene, skin, parents))


def _nodes_on(document: Document, scene: Scene, skeleton: Fields) -> list[int]:
    """Return the nodes whose meshes follow a skeleton: those of its skins, and those below its joints."""
    wanted = set(joints_of(document, skeleton))
    nodes = [node for node in chosen_nodes(document, scene, None) if _follows(document, scene, node, wanted)]
    if not nodes:
        raise NoMeshError(f"{document.path} has no mesh on its skeleton; export the character with its mesh")
    return nodes


def _bound(document: Document, shape: Shape, skeleton: Fields) -> Shape:
    """Return a shape in its bind pose, bound to a single joint, the first without a parent.

    The transform is :math:`I_r` from its skin's space, :math:`I_r I_j^{-1} W_j^{-1} W_n` for a node n below a joint j.
    """
    scene, skin = shape.scene, shape.skin
    joints = joints_of(document, skeleton)
    if "inverseBindMatrices" not in skeleton:
        return shape  # bound where the joints stand
    inverse_binds = inverse_binds_of(document, skeleton, len(joints))
    root = _parents(scene, joints).index(-1)
    if skin is None:
        above = next(node for node in scene.lineage(shape.node) if node in joints)
        world = scene.world_matrices([above, shape.node], {})
        here = np.linalg.pinv(world[above][0]) @ world[shape.node][0]
        onto = inverse_binds[root] @ np.linalg.pinv(inverse_binds[joints.index(above)]) @ here
    else:
        onto = skin.inverse_binds[list(skin.joints).index(joints[root])]
    alone = csr_array(np.ones((len(shape.rest), 1)))
    return replace(shape, skin=NodeSkin([joints[root]], onto[None], alone))


def _follows(document: Document, scene: Scene, node: int, joints: Set[int]) -> bool:
    skin = scene.nodes[node].index("skin")
    if skin is None:
        return not joints.isdisjoint(scene.lineage(node))
    return joints == set(joints_of(document, document.item("skins", skin)))


def _chosen(document: Document, name: str | None) -> Fields:
    """Return the first skin of the chosen skeleton; skins with the same joints are one skeleton."""
    different: dict[frozenset[int], int] = {}
    for number, skin in enumerate(document.items("skins")):
        different.setdefault(frozenset(joints_of(document, skin)), number)
    skins = list(different.values())
    told = [document.item("skins", number).text("name") for number in skins]
    names = [
        (own if own and told.count(own) == 1 else f"skin {number}", own)
        for number, own in zip(skins, told, strict=True)
    ]
    return document.item("skins", skins[choose_skeleton(document.path, names, name)])


def _parents(scene: Scene, joints: Sequence[int]) -> list[int]:
    """Return the index of each joint's nearest ancestor joint; nodes between them are skipped."""
    number = {joint: i for i, joint in enumerate(joints)}
    return [
        next((number[node] for node in scene.lineage(joint)[1:] if node in number), -1) for joint in joints
    ]


def _bind_pose(document: Document, scene: Scene, skin: Fields, parents: Sequence[int]) -> Float:
    """Return the world matrices ``(J, 4, 4)`` of the joints."""
    joints = joints_of(document, skin)
    world = scene.world_matrices(joints, {})
    if (
        "inverseBindMatrices" not in skin
    ):  # the mesh is in the space of every joint: these are bound where they are
        return np.concatenate([world[joint] for joint in joints])
    inverse_binds = inverse_binds_of(document, skin, len(joints))
    flat = np.abs(np.linalg.det(inverse_binds)) < np.finfo(np.float64).tiny
    if flat.any() or not np.isfinite(inverse_binds).all():
        raise skin.error(
            "has an inverse bind matrix that cannot be inverted, or is not finite; the file is damaged"
        )
    root = parents.index(-1)
    return np.asarray(world[joints[root]][0] @ inverse_binds[root] @ np.linalg.inv(inverse_binds))


def open_gltf(
    path: Path, prim: str | None = None, animation: str | int | None = None, fps: float | None = None
) -> SequenceReader:
    """Open a glTF file."""
    # Non-finite points are reported with their vertex when they are read.
    with prefix_errors(path), np.errstate(all="ignore"):
        document = decompress_document(load_document(path))
        scene = read_scene(document)
        nodes = chosen_nodes(document, scene, prim)
        chosen = choose_animation(document, animation)
        channels = read_channels(document, chosen, _influencing(document, scene, nodes))
        if prim is None:
            nodes = moving_nodes(document, scene, nodes, channels)
            influencing = _influencing(document, scene, nodes)
            channels = [channel for channel in channels if channel.node in influencing]
        shapes = _shapes(document, scene, nodes, channels)
        times, rate = _frames(path, channels, fps, told_by(chosen, "fps", 0.0))
        start = told_by(chosen, "start") or 0.0
        return _GltfReader(document, shapes, channels, times, rate, start)


def open_gltf_bind_pose(path: Path, skeleton: str | None) -> SequenceReader:
    """Open the meshes of a skeleton in their bind pose; see `mixseq_io.read_bind_pose`."""
    with prefix_errors(path), np.errstate(all="ignore"):
        document = decompress_document(load_document(path))
        scene = read_scene(document)
        skin = _chosen(document, skeleton)
        shapes = _shapes(document, scene, _nodes_on(document, scene, skin), ())
        shapes = [_bound(document, shape, skin) for shape in shapes]
        return _GltfReader(document, shapes, (), np.zeros(1), DEFAULT_FPS, 0.0)


def _frames(
    path: Path, channels: Sequence[Channel], fps: float | None, told: float | None
) -> tuple[NDArray[np.float64], float]:
    """Return frame times ``(T,)`` in s and frames per second: as requested, else from the file, else from the keys."""
    keys = key_times(channel.times for channel in channels)
    if fps is not None:
        times = sampled_times(path, keys, fps)
        return times if times.size else np.zeros(1), fps
    rate = told or rate_of(keys)
    if any(channel.moves and not channel.moves_straight for channel in channels):
        played = told or played_rate(keys)
        times = played_times(keys, played)
        if times.size > keys.size:
            return times, played
    return keys if keys.size else np.zeros(1), rate


def _influencing(document: Document, scene: Scene, nodes: Sequence[int]) -> set[int]:
    """Return the nodes that influence the meshes of some nodes."""
    found, count = set(nodes), 0
    for node in nodes:
        moving = bearers(document, scene.nodes[node], node)
        count += 16 * len(moving)  # their matrices
        document.check_effort(count, "skeletons of all meshes together")
        found |= scene.with_ancestors(moving)
    return found


def _shapes(
    document: Document, scene: Scene, nodes: Sequence[int], channels: Collection[Channel]
) -> list[Shape]:
    welds: dict[int, Weld | None] = {}
    shapes, numbers = [], 0
    for node in nodes:
        mesh = scene.nodes[node].integer("mesh")
        if mesh not in welds:
            welds[mesh] = _welded(document, mesh)
        found = welds[mesh]
        if found is not None:
            numbers += 3 * found.count + found.faces.size
            document.check_effort(numbers, "meshes of all nodes together")
            shapes.append(read_shape(document, scene, node, found))
    if not shapes:
        raise FormatError(f"{document.path} has no triangles to read; points and lines alone are not a mesh")
    for channel in channels:
        for shape in shapes:
            if (channel.node, channel.name) == (shape.node, "weights") and len(channel.values.T) != len(
                shape.weights
            ):
                raise scene.nodes[shape.node].error(
                    f"has {len(shape.weights)} morph targets, but {len(channel.values.T)} weights are animated"
                )
    return shapes


def _welded(document: Document, mesh: int) -> Weld | None:
    """Return a mesh's welded vertices, None without triangles; warn of skipped primitives."""
    primitives, others = primitives_of(document, mesh)
    place = f"{document.path}: meshes[{mesh}]"
    if others:
        warn(
            f"{place}: primitives {', '.join(map(str, others[:20]))} are points, lines or empty; they are left out"
        )
    for what, name in (("texture coordinates", "TEXCOORD"), ("colours", "COLOR")):
        if any(each.sets(name) > 1 for each in primitives):
            warn(f"{place} has several sets of {what}; {name}_0 is read")
    return weld(document, mesh) if primitives else None


def _world(scene: Scene, shapes: Sequence[Shape], pose: Pose) -> Mapping[int, Float]:
    """Return the world matrices of all bearers of meshes, computed together for their common ancestors."""
    return scene.world_matrices((node for shape in shapes for node in shape.bearers), pose)


class _GltfReader(SequenceReader):
    def __init__(
        self,
        document: Document,
        shapes: Sequence[Shape],
        channels: Sequence[Channel],
        times: NDArray[np.float64],
        rate: float,
        start: float,
    ) -> None:
        scene = shapes[0].scene
        world = _world(scene, shapes, pose_at(channels, times[:1]))
        mirrored = [bool(shape.handedness(world)[0] < 0) for shape in shapes]
        ends = np.cumsum([0, *(shape.weld.count for shape in shapes)]).tolist()
        scene_meshes = [
            scene_mesh_of(document, shape, first, flip)
            for shape, first, flip in zip(shapes, ends, mirrored, strict=False)
        ]
        path = document.path
        polygons, surface = join_meshes(scene_meshes, Origin("glTF", str(path.resolve())))
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=ends[-1],
            times=snap_to_frames(times + start, rate),
            fps=rate,
            name=common_name([scene.objects[shape.node] for shape in shapes]) or path.stem,
            surface=surface,
        )
        super().__init__(path, header)
        self._shapes, self._mirrored, self._channels = shapes, mirrored, channels
        self._times = times  # as the keys have them

    def markings(self) -> Markings:
        """Return the sets of polygons and the joints of the meshes."""
        skinned = any(shape.skin is not None for shape in self._shapes)
        skinning = concatenate_skinning([_skinning(shape) for shape in self._shapes]) if skinned else None
        return replace(super().markings(), skinning=skinning)

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        for start in range(0, self.header.frame_count, size):
            times = self._times[start : start + size]
            with np.errstate(all="ignore"):
                pose = pose_at(self._channels, times)
                world = _world(self._shapes[0].scene, self._shapes, pose)
                self._check_handedness(world, start)
                points = [shape.points(pose, world, len(times)).astype(np.float32) for shape in self._shapes]
            yield np.concatenate(points, axis=1)

    def _check_handedness(self, world: Mapping[int, Float], first: int) -> None:
        for shape, mirrored in zip(self._shapes, self._mirrored, strict=True):
            turned = shape.handedness(world) * (-1 if mirrored else 1) < 0
            if turned.any() and shape.skin is None:
                raise InvalidSequenceError(
                    f"{self.path}: {self.header.frame_name(first + int(np.argmax(turned)))}: "
                    f"{shape.scene.paths[shape.node]!r} is mirrored relative to the first frame, which turns "
                    "its faces inside out; give the animated scale one sign"
                )
