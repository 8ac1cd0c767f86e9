r"""Writer of skins and morphs as glTF documents.

A morph target has displacements ``d_m`` and weights ``w_tm`` from 0 to 1 (`rig_arrays.normalise_morph_weights`). glTF
blends normals like points, ``n_t ~ n_0 + sum_m w_tm e_m`` before normalisation. The ``e_m`` are fitted to the exact
normals ``N_t`` of all frames by least squares: ``E = W^+ (N - n_0)`` with the matrix ``W`` of weights.

Joints are nodes in a tree. The node of joint b has the rotation and translation of `Skin.local_motion` relative to its
parent. In the world, the node moves the axes ``A_b`` at the pivot ``p_b`` to ``R_tb A_b`` at ``c_tb``. The inverse
bind matrix maps the axes ``A_b`` at ``p_b`` to the world axes at the origin,

.. math:: \begin{pmatrix} A_b & p_b \\ 0 & 1 \end{pmatrix}^{-1} =
          \begin{pmatrix} A_b^T & -A_b^T p_b \\ 0 & 1 \end{pmatrix},

so that a point is mapped to ``R_tb (r_v - p_b) + c_tb``, the skin's formula; morph targets are applied before.
Constant properties are not animated. The root joints have a common parent that converts axes and units, and is at the
origin of meshes far from zero, since only joints and their ancestors move a skinned mesh.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mixseq.errors import OutputError
from mixseq.rigging.rigs import Morph, Skin, rotation_matrices
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, Single
from mixseq_io.gltf.buffers import ARRAY_BUFFER, Json, Layout, add_channels, append
from mixseq_io.gltf.new_document import (
    MovingMesh,
    create_animation,
    create_meshes,
    create_scene,
    name_member,
    node_transform,
)
from mixseq_io.reader import as_float32
from mixseq_io.rig_arrays import (
    four_influences,
    local_joint_transforms,
    move_rig,
    normalise_morph_weights,
    target_names,
)

_ACCESSOR_TYPES = {"translation": "VEC3", "rotation": "VEC4", "weights": "SCALAR"}


@dataclass(frozen=True, eq=False)
class Track:
    """Values of a node property at every frame, and the nodes that have these values."""

    nodes: Sequence[int]
    path: str
    values: Single


def add_animation(layout: Layout, header: SequenceHeader, tracks: Sequence[Track]) -> None:
    """Add a linearly interpolated animation of all non-constant tracks, with keys at the frames of a sequence."""
    varying = [track for track in tracks if (track.values != track.values[0]).any()]
    if not varying:
        return
    times, animation = create_animation(layout, header)
    # All tracks, possibly hundreds, share one view.
    arrays = [np.ascontiguousarray(track.values) for track in varying]
    view, offset = layout.add(arrays, sum(array.nbytes for array in arrays)), 0
    for track, array in zip(varying, arrays, strict=True):
        kind = _ACCESSOR_TYPES[track.path]
        count = array.size if kind == "SCALAR" else len(array)
        output = layout.accessor(view, count, kind, offset)
        add_channels(animation, times, output, track.nodes, track.path)
        offset += array.nbytes
    append(layout.document, "animations", animation)


_MIN_SINGULAR_VALUE_RATIO = 1e-6
"""Smallest singular value of the weights used in the pseudoinverse for normals, relative to the largest."""


def create_morphed_scene(morph: Morph) -> Layout:
    """Create a document of a mesh with morph targets and the animation of their weights."""
    morph, origin = move_rig(morph)
    layout, meshes = create_scene(morph.header, origin)
    add_animation(layout, morph.header, add_morph_targets(layout, meshes, normalise_morph_weights(morph)))
    return layout


def add_morph_targets(layout: Layout, meshes: Sequence[MovingMesh], morph: Morph) -> list[Track]:
    """Add points, normals and morph targets to the meshes of a document; return the tracks of morph weights."""
    base = as_float32(morph.base[None], 0, "glTF")[0]
    targets = as_float32(morph.targets, 0, "glTF", "a target of vertex")
    for mesh in meshes:
        _add_shapes(layout, mesh, morph, base, targets)
    if not len(targets):
        return []
    for mesh in meshes:
        entry = layout.document["meshes"][layout.document["nodes"][mesh.node]["mesh"]]
        entry["weights"] = morph.weights[0].astype(np.float32).tolist()
        entry["extras"] = {"targetNames": target_names(len(targets))}
    return [Track([mesh.node for mesh in meshes], "weights", morph.weights.astype(np.float32))]


def _add_shapes(layout: Layout, mesh: MovingMesh, morph: Morph, base: Single, targets: Single) -> None:
    base_normals, target_normals = _fit_normals(mesh, morph)
    for primitive in mesh.primitives:
        shapes = [(base, base_normals), *zip(targets, target_normals, strict=True)]
        for index, (points, normals) in enumerate(shapes):
            attributes = primitive.entry["attributes"] if index == 0 else {}
            positions = points[mesh.scene_mesh.vertices][primitive.vertex_ids]
            attributes["POSITION"] = layout.add_points(positions)
            if primitive.normal_ids is not None:
                attributes["NORMAL"] = layout.add_array(normals[primitive.normal_ids], target=ARRAY_BUFFER)
            if index > 0:
                append(primitive.entry, "targets", attributes)


def _fit_normals(mesh: MovingMesh, morph: Morph) -> tuple[Single, Single]:
    """Return the normals of the base mesh ``(G, 3)``, and the normal displacements of M targets ``(M, G, 3)``."""
    (base,) = mesh.compute_normals(morph.base[None])
    targets = np.zeros((len(morph.targets), base.size))
    if len(targets):
        inverse = np.linalg.pinv(morph.weights, rcond=_MIN_SINGULAR_VALUE_RATIO)
        frame = 0
        for block in morph.blocks():
            displacements = (mesh.compute_normals(block) - base.astype(np.float64)).reshape(len(block), -1)
            targets += inverse[:, frame : frame + len(block)] @ displacements
            frame += len(block)
    return base, targets.reshape(-1, *base.shape).astype(np.float32)


_MAX_BONE_COUNT = 65535
_MAX_BYTE_BONE_COUNT = 256


def create_skinned_scene(skin: Skin) -> Layout:
    """Create a document of a skinned mesh, its joints and their animation."""
    if skin.bone_count > _MAX_BONE_COUNT:
        raise OutputError(
            f"the skin has {skin.bone_count} bones, glTF allows {_MAX_BONE_COUNT}; fit it with fewer (bones=N)"
        )
    skin, origin = move_rig(skin)
    layout, meshes = create_meshes(skin.header)
    document = layout.document
    morph_tracks = add_morph_targets(layout, meshes, normalise_morph_weights(skin))
    root, joints, joint_tracks = _add_joints(document, skin, origin)
    document["skins"] = [
        {
            **name_member(skin.header.name),
            "inverseBindMatrices": _add_inverse_binds(layout, skin),
            "joints": joints,
            "skeleton": root,
        }
    ]
    bones, weights = four_influences(skin)
    narrow_bones = bones.astype(np.uint8 if skin.bone_count <= _MAX_BYTE_BONE_COUNT else np.uint16)
    for mesh in meshes:
        document["nodes"][mesh.node]["skin"] = 0
        for primitive in mesh.primitives:
            attributes = primitive.entry["attributes"]
            for name, values in (("JOINTS_0", narrow_bones), ("WEIGHTS_0", weights)):
                own = values[mesh.scene_mesh.vertices][primitive.vertex_ids]
                attributes[name] = layout.add_array(own, target=ARRAY_BUFFER)
    document["scene"] = 0
    document["scenes"] = [{"nodes": [root, *(mesh.node for mesh in meshes)]}]
    add_animation(layout, skin.header, [*joint_tracks, *morph_tracks])
    return layout


def _add_joints(document: Json, skin: Skin, origin: Float) -> tuple[int, list[int], list[Track]]:
    """Add a node for every bone in its first-frame pose, and a common root; return the root, nodes and tracks."""
    skeleton = skin.skeleton
    rotations, translations = local_joint_transforms(skin, "glTF")
    root = append(document, "nodes", {"name": "skeleton", "children": [], **node_transform(skin.header, origin)})
    joints: list[int] = []
    tracks: list[Track] = []
    for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        rotation, translation = rotations[:, bone], translations[:, bone]
        entry = {"name": name, "rotation": rotation[0].tolist(), "translation": translation[0].tolist()}
        joint = append(document, "nodes", entry)
        parent_entry = document["nodes"][root if parent < 0 else joints[parent]]
        parent_entry.setdefault("children", []).append(joint)
        joints.append(joint)
        tracks += [Track([joint], "rotation", rotation), Track([joint], "translation", translation)]
    return root, joints, tracks


def _add_inverse_binds(layout: Layout, skin: Skin) -> int:
    """Add the inverse bind matrices ``(B, 4, 4)``; return their accessor's index."""
    pivots = as_float32(skin.pivots[None], 0, "glTF", "the pivot of bone")[0].astype(np.float64)
    inverse_axes = rotation_matrices(skin.skeleton.axes).swapaxes(1, 2)
    matrices = np.tile(np.eye(4, dtype=np.float32), (skin.bone_count, 1, 1))
    matrices[:, :3, :3] = inverse_axes.swapaxes(1, 2)  # column by column
    matrices[:, 3, :3] = -np.einsum("bij,bj->bi", inverse_axes, pivots)
    return layout.add_array(matrices.reshape(-1, 16))
