"""Reader of glTF files (.gltf, .glb): skinned, morphed and moving meshes in world space.

Frames are at all keys of the selected meshes, or at a given rate. If anything except translations and linear morph
weights is animated, points may move along arcs, and `mixseq_io.gltf.animation.insert_frames` fills gaps between keys.
Key times are float32, so frame times within float32 rounding of the frame grid are snapped to it. Split vertices are
welded (`mixseq_io.gltf.primitives`). Points are computed in float64 and rounded to float32. A .glb with a mesh sequence
(`mixseq_io.gltf.mesh_sequence`) is decoded as a compressed model.

In the bind pose of a skin, the inverse bind matrix :math:`I_j` maps mesh space to the space of joint j. The matrix of
joint j in mesh space is therefore :math:`I_j^{-1}`. With the world matrix :math:`W_r` of the first joint r without a
parent, :math:`W_r I_r` maps mesh space to the world, and the world matrix of joint j in the bind pose is

.. math:: M_j = W_r I_r I_j^{-1}.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mixseq.errors import InvalidSequenceError, MixseqError, NoMeshError
from mixseq.mesh.measures import hard_edges_from_normals
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import DEFAULT_COLOUR, DEFAULT_UV, CornerValues, FaceSet, Origin
from mixseq.sequence.frame_rates import MAX_GRID_RATE, estimate_frame_rate, format_frame
from mixseq.sequence.header import DEFAULT_FPS, FileKeys, SequenceHeader
from mixseq.types import Float, FloatArray, IntArray
from mixseq_io.gltf.animation import (
    Channel,
    MeshNode,
    MeshSkin,
    choose_animation,
    evaluate_pose,
    insert_frames,
    merge_key_times,
    read_channels,
    read_extra_number,
    read_inverse_binds,
    read_mesh_node,
    sample_times,
)
from mixseq_io.gltf.codecs import load_plain_document
from mixseq_io.gltf.document import Document, Fields, unknown_extensions, used_extensions
from mixseq_io.gltf.primitives import Primitive, Weld, texture_transform, weld_vertices
from mixseq_io.gltf.scene import Pose, Scene, read_scene
from mixseq_io.reader import AnimationReader, SequenceReader, prefix_errors, warn
from mixseq_io.rig_arrays import build_skeleton, choose_skeleton
from mixseq_io.scene_meshes import (
    SceneMesh,
    check_finite,
    common_name,
    find_keys,
    format_names,
    join_meshes,
    read_valid_meshes,
    select_meshes,
    snap_to_frames,
)
from mixseq_io.surfaces import ensure_alpha
from mixseq_io.text.labels import Markings, Skinning, concatenate_skinning

if TYPE_CHECKING:
    from mixseq.rigging.rigs import Skeleton


def _select_nodes(scene: Scene, prim: str | None) -> list[int]:
    """Return the nodes with meshes, only those at or below `prim` if given; omit hidden nodes unless all are."""
    nodes = [node for node in scene.objects if "mesh" in scene.nodes[node]]
    if prim is not None:
        objects = [scene.objects[node] for node in nodes]
        nodes = [nodes[i] for i in select_meshes(scene.document.path, objects, prim)]
    return [node for node in nodes if node not in scene.hidden] or nodes


def _find_moving_nodes(
    scene: Scene, nodes: Sequence[int], channels: Collection[Channel], others: Collection[int]
) -> list[bool]:
    """Return whether the mesh of each node moves; `others` are nodes that may move."""
    moved = {(channel.node, channel.name == "weights") for channel in channels if channel.is_animated}
    moved |= {(node, is_morph) for node in others for is_morph in (False, True)}
    return [
        (node, True) in moved
        or any((above, False) in moved for above in scene.with_ancestors(scene.transform_nodes(node)))
        for node in nodes
    ]


def _make_scene_mesh(mesh_node: MeshNode, pose: Pose, world: Mapping[int, Float], frame_name: str) -> SceneMesh:
    """Return the mesh of a node with its surface, in the pose of a frame, where its points have to be finite."""
    check_finite(mesh_node.world_points(pose, world, 1)[0], frame_name)
    weld, scene, primitives = mesh_node.weld, mesh_node.scene, mesh_node.weld.primitives
    order = [0, 2, 1] if mesh_node.orientation(world)[0] < 0 else [0, 1, 2]
    starts = np.cumsum([0, *(len(each.positions) for each in primitives)]).tolist()
    corners = np.concatenate(
        [each.triangles[:, order] + start for each, start in zip(primitives, starts, strict=False)]
    ).reshape(-1)
    polygons = Polygons.from_triangles(weld.triangles[:, order])
    scene_object = scene.objects[mesh_node.node]
    return SceneMesh(
        name=scene_object.name or scene_object.path.rpartition("/")[2],
        path=scene_object.path,
        vertices=slice(0, weld.vertex_count),
        polygons=polygons,
        uvs=_join_values(primitives, list(map(_read_uvs, primitives)), DEFAULT_UV, corners),
        colours=_join_values(primitives, list(map(_read_colours, primitives)), DEFAULT_COLOUR, corners),
        hard_edges=_find_hard_edges(primitives, corners, polygons),
        face_sets=_make_face_sets(scene.document, primitives),
    )


def _read_uvs(primitive: Primitive) -> FloatArray | None:
    """Return TEXCOORD_0 ``(n, 2)`` after the material's texture transform, converted to v upwards."""
    uvs = primitive.attribute("TEXCOORD_0", 2)
    if uvs is None:
        return None
    transform = texture_transform(primitive.document, primitive.fields)
    if not np.array_equal(transform, np.eye(2, 3)):
        uvs = (uvs @ transform[:, :2].T + transform[:, 2]).astype(np.float32)
    return np.asarray(uvs * np.array([1, -1], np.float32) + np.array([0, 1], np.float32))


def _read_colours(primitive: Primitive) -> FloatArray | None:
    """Return COLOR_0 as RGBA ``(n, 4)``."""
    index = primitive.attributes.index("COLOR_0")
    if index is None:
        return None
    width = 3 if primitive.document.item("accessors", index).text("type") == "VEC3" else 4
    values = primitive.attribute("COLOR_0", width)
    assert values is not None
    if values.dtype.kind == "u":  # some exporters omit "normalized"
        values = values / float(np.iinfo(values.dtype).max)
    return ensure_alpha(values)


def _join_values(
    primitives: Sequence[Primitive],
    of_primitives: Sequence[FloatArray | None],
    default: Sequence[float],
    corners: IntArray,
) -> CornerValues | None:
    """Join vertex values of primitives at corners ``(C,)``, missing values as `default`; None if all are missing."""
    if all(own is None for own in of_primitives):
        return None
    values = [
        np.tile(default, (len(each.positions), 1)) if own is None else own
        for each, own in zip(primitives, of_primitives, strict=True)
    ]
    return CornerValues.from_corners(np.concatenate(values)).select(corners)


def _find_hard_edges(
    primitives: Sequence[Primitive], corners: IntArray, polygons: Polygons
) -> NDArray[np.int32] | None:
    """Return the normal index of each corner ``(C,)``; primitives without normals are flat-shaded, as glTF requires."""
    normals, flat = [], []
    for each in primitives:
        own = each.attribute("NORMAL", 3)
        normals.append(np.zeros((len(each.positions), 3)) if own is None else own)
        flat.append(np.full(each.triangles.size, own is None))
    is_flat = np.concatenate(flat)
    at_corners = np.concatenate(normals).astype(np.float64)[corners]
    hard_edges = hard_edges_from_normals(polygons, np.clip(np.nan_to_num(at_corners), -1e6, 1e6))
    if not is_flat.any():
        return hard_edges
    groups = polygons.indices if hard_edges is None else hard_edges
    flat_groups = np.arange(corners.size) + int(groups.max(initial=-1)) + 1
    return np.unique(np.where(is_flat, flat_groups, groups), return_inverse=True)[1].astype(np.int32)


def _make_face_sets(document: Document, primitives: Sequence[Primitive]) -> tuple[FaceSet, ...]:
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


def _skinning_of(mesh_node: MeshNode) -> Skinning:
    """Return the joints and skinning weights of a mesh; an unskinned mesh has its node as the only joint."""
    scene, skin = mesh_node.scene, mesh_node.skin
    if skin is None:
        return Skinning.rigid(scene.paths[mesh_node.node], mesh_node.weld.vertex_count)
    paths = tuple(scene.paths.get(joint, f"node {joint}") for joint in skin.joints)
    parents = tuple(paths[parent] if parent >= 0 else "" for parent in _joint_parents(scene, skin.joints))
    return Skinning(skin.weights, paths, parents)


def read_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skin; see `mixseq_io.read_skeleton`."""
    scene = read_scene(load_plain_document(path))
    skin = _select_skin(scene, name)
    joints = scene.joints(skin)
    parents = _joint_parents(scene, joints)
    names = [scene.nodes[joint].text("name") for joint in joints]
    return build_skeleton(names, parents, _bind_matrices(scene, skin, parents))


def _select_nodes_of_skin(scene: Scene, skin: Fields) -> list[int]:
    """Return the nodes with meshes bound to the joints of a skin, and nodes with unskinned meshes below the joints."""
    joints = set(scene.joints(skin))

    def is_bound(node: int) -> bool:
        if "skin" not in scene.nodes[node]:
            return not joints.isdisjoint(scene.lineage(node))
        return joints == set(scene.transform_nodes(node))

    nodes = [node for node in _select_nodes(scene, None) if is_bound(node)]
    if not nodes:
        raise NoMeshError(f"{scene.document.path} has no mesh on its skeleton; export the character with its mesh")
    return nodes


def _bind(mesh_node: MeshNode, skin: Fields) -> MeshNode:
    """Return a mesh in its bind pose, bound to the first joint r without a parent.

    The inverse bind matrix is :math:`I_r`, or :math:`I_r I_j^{-1} W_j^{-1} W_n` if node n is unskinned below joint j.
    """
    scene, own_skin = mesh_node.scene, mesh_node.skin
    joints = scene.joints(skin)
    if "inverseBindMatrices" not in skin:
        return mesh_node  # the static pose is the bind pose
    inverse_binds = read_inverse_binds(scene.document, skin, len(joints))
    root = _joint_parents(scene, joints).index(-1)
    if own_skin is None:
        joint = next(node for node in scene.lineage(mesh_node.node) if node in joints)
        world = scene.world_matrices([joint, mesh_node.node], {})
        to_joint = np.linalg.pinv(world[joint][0]) @ world[mesh_node.node][0]
        to_root = inverse_binds[root] @ np.linalg.pinv(inverse_binds[joints.index(joint)]) @ to_joint
    else:
        to_root = own_skin.inverse_binds[list(own_skin.joints).index(joints[root])]
    weights = csr_array(np.ones((len(mesh_node.rest), 1)))
    return replace(mesh_node, skin=MeshSkin([joints[root]], to_root[None], weights))


def _select_skin(scene: Scene, name: str | None) -> Fields:
    """Return the first skin of the named or only skeleton; skins with the same joints form one skeleton."""
    document = scene.document
    first_skins: dict[frozenset[int], int] = {}
    for index, skin in enumerate(document.items("skins")):
        first_skins.setdefault(frozenset(scene.joints(skin)), index)
    skins = list(first_skins.values())
    own_names = [document.item("skins", index).text("name") for index in skins]
    names = [
        (own if own and own_names.count(own) == 1 else f"skin {index}", own)
        for index, own in zip(skins, own_names, strict=True)
    ]
    return document.item("skins", skins[choose_skeleton(document.path, names, name)])


def _joint_parents(scene: Scene, joints: Sequence[int]) -> list[int]:
    """Return the index of each joint's nearest ancestor joint, or -1 without one."""
    index = {joint: i for i, joint in enumerate(joints)}
    return [next((index[node] for node in scene.lineage(joint)[1:] if node in index), -1) for joint in joints]


def _bind_matrices(scene: Scene, skin: Fields, parents: Sequence[int]) -> Float:
    """Return the world matrices ``(J, 4, 4)`` of the joints in the bind pose."""
    joints = scene.joints(skin)
    world = scene.world_matrices(joints, {})
    if "inverseBindMatrices" not in skin:  # the static pose is the bind pose
        return np.concatenate([world[joint] for joint in joints])
    inverse_binds = read_inverse_binds(scene.document, skin, len(joints))
    is_singular = np.abs(np.linalg.det(inverse_binds)) < np.finfo(np.float64).tiny
    if is_singular.any() or not np.isfinite(inverse_binds).all():
        raise skin.error("has an inverse bind matrix that is not invertible or finite; the file is damaged")
    root = parents.index(-1)
    return np.asarray(world[joints[root]][0] @ inverse_binds[root] @ np.linalg.inv(inverse_binds))


def open_gltf(
    path: Path, prim: str | None = None, animation: str | int | None = None, fps: float | None = None
) -> SequenceReader:
    """Open a glTF file."""
    # Reading a frame reports non-finite points with their vertex.
    with prefix_errors(path), np.errstate(all="ignore"):
        document = load_plain_document(path)
        if unknown := unknown_extensions(used_extensions(document)):
            warn(f"{path}: extensions that are not supported are ignored: {format_names(unknown)}")
        scene = read_scene(document)
        nodes = _select_nodes(scene, prim)
        if not nodes:
            raise NoMeshError(f"{path} has no triangles to read; points and lines alone are not a mesh")
        fields = choose_animation(document, animation)
        errors: dict[int, MixseqError] = {}  # by node whose channels cannot be read
        all_channels = read_channels(document, fields, _influencing_nodes(scene, nodes), errors)
        is_moving = [False] * len(nodes)
        if prim is None:
            is_moving = _find_moving_nodes(scene, nodes, all_channels, errors)
        stored_rate, start = read_extra_number(fields, "fps", 0.0), read_extra_number(fields, "start") or 0.0
        channels, times, rate = all_channels, np.zeros(1), DEFAULT_FPS

        def prepare(chosen: list[int]) -> Callable[[int], tuple[MeshNode, SceneMesh]]:
            nonlocal channels, times, rate
            influencing = _influencing_nodes(scene, [nodes[index] for index in chosen])
            channels = [channel for channel in all_channels if channel.node in influencing]
            times, rate = _choose_times(path, channels, fps, stored_rate)
            frame_name = f"frame {format_frame(times[0] + start, rate)}"
            pose, read = evaluate_pose(channels, times[:1]), _mesh_node_reader(scene, channels)
            world: dict[int, Float] = {}  # of ancestors of all meshes, computed once

            def read_mesh(index: int) -> tuple[MeshNode, SceneMesh]:
                for node in _influencing_nodes(scene, nodes[index : index + 1]) if errors else ():
                    if node in errors:
                        raise errors[node]
                mesh_node = read(nodes[index])
                scene.world_matrices(mesh_node.transform_nodes, pose, world)
                return mesh_node, _make_scene_mesh(mesh_node, pose, world, frame_name)

            return read_mesh

        meshes = read_valid_meshes(path, [scene.objects[node] for node in nodes], is_moving, prepare)
        mesh_nodes, scene_meshes = [mesh_node for mesh_node, _ in meshes], [scene_mesh for _, scene_mesh in meshes]
        return _GltfReader(mesh_nodes, scene_meshes, channels, times, rate, start)


def open_gltf_bind_pose(path: Path, skeleton: str | None) -> SequenceReader:
    """Open the meshes of a skeleton in their bind pose; see `mixseq_io.read_bind_pose`."""
    with prefix_errors(path), np.errstate(all="ignore"):
        scene = read_scene(load_plain_document(path))
        skin = _select_skin(scene, skeleton)
        read = _mesh_node_reader(scene, ())
        mesh_nodes = [_bind(read(node), skin) for node in _select_nodes_of_skin(scene, skin)]
        world = _world_matrices(mesh_nodes, {})
        scene_meshes = [_make_scene_mesh(each, {}, world, "the bind pose") for each in mesh_nodes]
        return _GltfReader(mesh_nodes, scene_meshes, (), np.zeros(1), DEFAULT_FPS, 0.0)


_MIN_KEY_RATE = 10.0
"""Lowest rate in Hz of even keys that are taken for frames."""


def _choose_times(
    path: Path, channels: Sequence[Channel], fps: float | None, stored_rate: float | None
) -> tuple[Float, float]:
    """Return frame times ``(T,)`` in s and the frame rate: `fps`, else `stored_rate`, else estimated from the keys."""
    keys = merge_key_times(channel.times for channel in channels)
    if fps is not None:
        times = sample_times(path, keys, fps)
        return times if times.size else np.zeros(1), fps
    rate = stored_rate or estimate_frame_rate(keys, lowest=_MIN_KEY_RATE) or DEFAULT_FPS
    if any(channel.is_animated and not channel.is_linear_motion for channel in channels):
        filling_rate = rate if stored_rate or rate <= MAX_GRID_RATE else DEFAULT_FPS
        times = insert_frames(keys, filling_rate)
        if times.size > keys.size:
            return times, filling_rate
    return keys if keys.size else np.zeros(1), rate


def _find_keys(animated: Sequence[Channel], times: Float, rate: float) -> FileKeys | None:
    """Return the frames at times ``(T,)`` that are keys, if all animated channels are linear, or all are steps."""
    kinds = set().union(*(channel.interpolations for channel in animated))
    if kinds not in ({"LINEAR"}, {"STEP"}):
        return None
    return find_keys(merge_key_times(channel.times for channel in animated), times, rate, kinds == {"STEP"})


def _influencing_nodes(scene: Scene, nodes: Sequence[int]) -> set[int]:
    """Return nodes with meshes, and all nodes whose transforms move these meshes."""
    influencing, number_count = set(nodes), 0
    for node in nodes:
        transforms = scene.transform_nodes(node)
        number_count += 16 * len(transforms)
        scene.document.check_effort(number_count, "skeletons of all meshes together")
        influencing |= scene.with_ancestors(transforms)
    return influencing


def _mesh_node_reader(scene: Scene, channels: Collection[Channel]) -> Callable[[int], MeshNode]:
    """Return the function that reads a node with a mesh, whose animated weights have to match its targets."""
    document, number_count = scene.document, 0
    weld_mesh = cache(partial(_weld, document))

    def read(node: int) -> MeshNode:
        nonlocal number_count
        weld = weld_mesh(scene.nodes[node].integer("mesh"))
        if not weld.primitives:
            where = f"{document.path}: {scene.paths[node]}"
            raise NoMeshError(f"{where} has no triangles to read; points and lines alone are not a mesh")
        number_count += 3 * weld.vertex_count + weld.triangles.size
        document.check_effort(number_count, "meshes of all nodes together")
        mesh_node = read_mesh_node(scene, node, weld)
        count = len(mesh_node.weights)
        for channel in channels:
            if channel.node == node and channel.name == "weights" and len(channel.values.T) != count:
                problem = f"has {count} morph targets, but {len(channel.values.T)} weights are animated"
                raise scene.nodes[node].error(problem)
        return mesh_node

    return read


def _weld(document: Document, mesh: int) -> Weld:
    """Weld the vertices of a mesh; warn of primitives and attributes that are not read."""
    weld = weld_vertices(document, mesh)
    place = f"{document.path}: meshes[{mesh}]"
    if weld.skipped:
        skipped = ", ".join(map(str, weld.skipped[:20]))
        warn(f"{place}: primitives {skipped} are points, lines or empty; they are left out")
    for label, name in (("texture coordinates", "TEXCOORD"), ("colours", "COLOR")):
        if any(each.count_sets(name) > 1 for each in weld.primitives):
            warn(f"{place} has several sets of {label}; {name}_0 is read")
    return weld


def _world_matrices(mesh_nodes: Sequence[MeshNode], pose: Pose) -> Mapping[int, Float]:
    """Return the world matrices of all nodes that move meshes; common ancestors are evaluated once."""
    nodes = (node for each in mesh_nodes for node in each.transform_nodes)
    return mesh_nodes[0].scene.world_matrices(nodes, pose)


class _GltfReader(AnimationReader):
    """Reader of mesh points at animation times ``(T,)`` in s; the header's times are these plus `start`."""

    def __init__(
        self,
        mesh_nodes: Sequence[MeshNode],
        scene_meshes: Sequence[SceneMesh],
        channels: Sequence[Channel],
        times: Float,
        rate: float,
        start: float,
    ) -> None:
        scene = mesh_nodes[0].scene
        world = _world_matrices(mesh_nodes, evaluate_pose(channels, times[:1]))
        is_mirrored = [bool(each.orientation(world)[0] < 0) for each in mesh_nodes]
        path = scene.document.path
        animated = [channel for channel in channels if channel.is_animated]
        # Shapes that are stored frame by frame are samples, between which weights are not meant to be linear.
        can_evaluate = bool(animated) and not any(channel.is_cache for channel in animated)
        polygons, surface = join_meshes(scene_meshes, Origin("glTF", str(path.resolve())))
        header = SequenceHeader(
            polygons=polygons,
            vertex_count=sum(each.weld.vertex_count for each in mesh_nodes),
            times=snap_to_frames(times + start, rate),
            fps=rate,
            name=common_name([scene.objects[each.node] for each in mesh_nodes]) or path.stem,
            surface=surface,
            keys=_find_keys(animated, times, rate) if can_evaluate else None,
        )
        super().__init__(path, header, can_evaluate=can_evaluate)
        self._frame_times = times  # not snapped to frames
        self._mesh_nodes, self._is_mirrored, self._channels = mesh_nodes, is_mirrored, channels

    def markings(self) -> Markings:
        """Return the sets of polygons and the joints of the meshes."""
        skinning = None
        if any(each.skin is not None for each in self._mesh_nodes):
            skinning = concatenate_skinning([_skinning_of(each) for each in self._mesh_nodes])
        return replace(super().markings(), skinning=skinning)

    def _read(self, what: str, size: int) -> Iterator[FloatArray]:
        return self._evaluate(what, np.arange(float(self.header.frame_count)), size)

    def _points_at(self, times: Float, step_times: Float) -> FloatArray:
        with np.errstate(all="ignore"):
            pose = evaluate_pose(self._channels, times, step_times)
            world = _world_matrices(self._mesh_nodes, pose)
            self._check_orientation(world, times)
            return np.concatenate([each.world_points(pose, world, len(times)) for each in self._mesh_nodes], axis=1)

    def _check_orientation(self, world: Mapping[int, Float], times: Float) -> None:
        for each, mirrored in zip(self._mesh_nodes, self._is_mirrored, strict=True):
            is_flipped = each.orientation(world) * (-1 if mirrored else 1) < 0
            if is_flipped.any() and each.skin is None:
                frame = int(np.searchsorted(self._frame_times, times[int(np.argmax(is_flipped))]))
                raise InvalidSequenceError(
                    f"{self.path}: {self.header.frame_name(frame)}: "
                    f"{each.scene.paths[each.node]!r} is mirrored relative to the first frame, which turns its faces "
                    "inside out; animate its scale without a change of sign"
                )
