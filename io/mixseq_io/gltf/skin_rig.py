"""A mesh that follows bones, as glTF has it.

A joint's node turns by ``R_tb`` and stands at ``c_tb``; its inverse bind matrix takes the pivot ``p_b`` to the origin,
so that a point goes to ``R_tb (r_v - p_b) + c_tb``, which is the formula of `mixseq.rigging.rigs.Skin`. glTF adds morph
targets before the skin moves the mesh, as that formula does.

Bones lie side by side under one node, which also turns and scales what is not in metres with Y up: nodes above a
skinned mesh do not move it, those above its joints do.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.rigging.rigs import Morph, Skin
from mixseq_io.blocks import as_float32
from mixseq_io.gltf.buffers import VERTICES, Json, Layout, append
from mixseq_io.gltf.morph_rig import Track, add_targets, animate, numbered_names
from mixseq_io.gltf.morphs import MovingMesh
from mixseq_io.gltf.new_document import named, new_meshes, upright

MOST_BONES = 65535
_MOST_OF_A_BYTE = 256


def skinned_scene(skin: Skin) -> Layout:
    """Return a document of a skinned mesh, its bones and their animation.

    Raises
    ------
    OutputError
        If there are more than 65535 bones.
    InvalidSequenceError
        If points or times do not fit into float32.
    """
    if skin.bone_count > MOST_BONES:
        raise OutputError(
            f"the skin has {skin.bone_count} bones, glTF has numbers for {MOST_BONES}; fit it with fewer (bones=N)"
        )
    layout, meshes = new_meshes(skin.header)
    document = layout.document
    shape = Morph(skin.header, skin.rest, skin.targets, skin.target_weights)
    of_targets = add_targets(layout, meshes, shape)
    root, joints, of_bones = _add_bones(document, skin)
    document["skins"] = [
        {**named(skin.header.name), "inverseBindMatrices": _inverse_binds(layout, skin), "joints": joints}
    ]
    joint, weight = four_influences(skin)
    for mesh in meshes:
        document["nodes"][mesh.node]["skin"] = 0
        _attach(layout, mesh, joint, weight)
    document["scene"] = 0
    document["scenes"] = [{"nodes": [root, *(mesh.node for mesh in meshes)]}]
    animate(layout, skin.header, [*of_bones, *of_targets])
    return layout


def four_influences(
    skin: Skin,
) -> tuple[NDArray[np.unsignedinteger], NDArray[np.float32]]:
    """Return bones and weights ``(V, 4)`` as glTF demands them.

    Every bone of a vertex occurs once, the largest weight comes first, bones without weight are number 0, and the
    weights add to one in float32.
    """
    bones = skin.influences.copy()
    weights = skin.weights.copy()
    for column in range(1, bones.shape[1]):
        for earlier in range(column):
            again = bones[:, column] == bones[:, earlier]
            weights[again, earlier] += weights[again, column]
            weights[again, column] = 0.0
    order = np.argsort(-weights, axis=1, kind="stable")
    bones = np.take_along_axis(bones, order, axis=1)
    rounded = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    rounded[:, 0] = 1 - rounded[:, 1:].astype(np.float64).sum(axis=1)
    dtype = np.uint8 if skin.bone_count <= _MOST_OF_A_BYTE else np.uint16
    return np.where(rounded > 0, bones, 0).astype(dtype), rounded


def _add_bones(document: Json, skin: Skin) -> tuple[int, list[int], list[Track]]:
    """Add a node for every bone, as in the first frame, and one above them; return these and the tracks."""
    rotations = skin.rotations.astype(np.float32)
    translations = as_float32(skin.translations, 0, "glTF", "bone")
    joints, tracks = [], []
    for bone, name in enumerate(numbered_names("bone", skin.bone_count)):
        turn, place = rotations[:, bone], translations[:, bone]
        joint = append(
            document,
            "nodes",
            {"name": name, "rotation": turn[0].tolist(), "translation": place[0].tolist()},
        )
        joints.append(joint)
        tracks += [Track([joint], "rotation", turn), Track([joint], "translation", place)]
    root = append(document, "nodes", {"name": "skeleton", "children": joints, **upright(skin.header)})
    return root, joints, tracks


def _inverse_binds(layout: Layout, skin: Skin) -> int:
    """Add the matrices that take every pivot to the origin; return their accessor."""
    matrices = np.tile(np.eye(4, dtype=np.float32), (skin.bone_count, 1, 1))
    matrices[:, 3, :3] = -as_float32(skin.pivots[None], 0, "glTF", "the pivot of bone")[0]  # column by column
    return layout.add_array(matrices.reshape(-1, 16))


def _attach(
    layout: Layout,
    mesh: MovingMesh,
    joint: NDArray[np.unsignedinteger],
    weight: NDArray[np.float32],
) -> None:
    """Give the vertices of a mesh their bones."""
    for each in mesh.primitives:
        attributes = each.entry["attributes"]
        own = mesh.scene_mesh.vertices
        attributes["JOINTS_0"] = layout.add_array(joint[own][each.vertices], target=VERTICES)
        attributes["WEIGHTS_0"] = layout.add_array(weight[own][each.vertices], target=VERTICES)
