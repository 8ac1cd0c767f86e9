r"""A mesh that follows bones in glTF.

Joints are nodes in a tree. The node of joint b has the rotation and translation of `mixseq.rigging.rigs.Skin.local`
relative to its parent; in the world it takes the axes ``A_b`` at the pivot ``p_b`` to ``R_tb A_b`` at ``c_tb``. Its
inverse bind matrix takes them to the axes of the world at the origin,

.. math:: \begin{pmatrix} A_b & p_b \\ 0 & 1 \end{pmatrix}^{-1} =
          \begin{pmatrix} A_b^T & -A_b^T p_b \\ 0 & 1 \end{pmatrix},

so that a point goes to ``R_tb (r_v - p_b) + c_tb``, the formula of the skin; morph targets come before it. Constant
properties have no track. The roots lie under one node with axes and unit: only nodes above joints move a skinned mesh.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.rigging.rigs import Skin, rotation_matrices
from mixseq.sequence import bounding_diagonal
from mixseq_io.blocks import as_float32
from mixseq_io.gltf.buffers import VERTICES, Json, Layout, append
from mixseq_io.gltf.morph_rig import Track, add_targets, animate
from mixseq_io.gltf.morphs import MovingMesh
from mixseq_io.gltf.new_document import named, new_meshes, upright
from mixseq_io.rig_arrays import four_influences, shape_of, steadied

MOST_BONES = 65535
_MOST_OF_A_BYTE = 256


def skinned_scene(skin: Skin) -> Layout:
    """Return a document of a skinned mesh, its bones and their animation."""
    if skin.bone_count > MOST_BONES:
        raise OutputError(
            f"the skin has {skin.bone_count} bones, glTF has numbers for {MOST_BONES}; fit it with fewer (bones=N)"
        )
    layout, meshes = new_meshes(skin.header)
    document = layout.document
    of_targets = add_targets(layout, meshes, shape_of(skin))
    root, joints, of_bones = _add_bones(document, skin)
    document["skins"] = [
        {
            **named(skin.header.name),
            "inverseBindMatrices": _inverse_binds(layout, skin),
            "joints": joints,
            "skeleton": root,
        }
    ]
    bones, weights = four_influences(skin)
    narrow = bones.astype(np.uint8) if skin.bone_count <= _MOST_OF_A_BYTE else bones.astype(np.uint16)
    for mesh in meshes:
        document["nodes"][mesh.node]["skin"] = 0
        _attach(layout, mesh, narrow, weights)
    document["scene"] = 0
    document["scenes"] = [{"nodes": [root, *(mesh.node for mesh in meshes)]}]
    animate(layout, skin.header, [*of_bones, *of_targets])
    return layout


def _add_bones(document: Json, skin: Skin) -> tuple[int, list[int], list[Track]]:
    """Add a node for every bone in its first-frame pose, and a common root; return root, nodes and tracks."""
    local, skeleton = skin.local(), skin.skeleton
    rotations = steadied(local.rotations, 1.0).astype(np.float32)
    places = steadied(local.translations, bounding_diagonal(skin.rest))
    translations = as_float32(places, 0, "glTF", "bone")
    root = append(document, "nodes", {"name": "skeleton", "children": [], **upright(skin.header)})
    joints: list[int] = []
    tracks: list[Track] = []
    for bone, (name, parent) in enumerate(zip(skeleton.names, skeleton.parents.tolist(), strict=True)):
        turn, place = rotations[:, bone], translations[:, bone]
        joint = append(
            document,
            "nodes",
            {"name": name, "rotation": turn[0].tolist(), "translation": place[0].tolist()},
        )
        above = document["nodes"][root if parent < 0 else joints[parent]]
        above.setdefault("children", []).append(joint)
        joints.append(joint)
        tracks += [Track([joint], "rotation", turn), Track([joint], "translation", place)]
    return root, joints, tracks


def _inverse_binds(layout: Layout, skin: Skin) -> int:
    """Add the inverse bind matrices ``(B, 4, 4)``; return their accessor."""
    pivots = as_float32(skin.pivots[None], 0, "glTF", "the pivot of bone")[0].astype(np.float64)
    back = rotation_matrices(skin.skeleton.axes).swapaxes(1, 2)
    matrices = np.tile(np.eye(4, dtype=np.float32), (skin.bone_count, 1, 1))
    matrices[:, :3, :3] = back.swapaxes(1, 2)  # column by column
    matrices[:, 3, :3] = -np.einsum("bij,bj->bi", back, pivots)
    return layout.add_array(matrices.reshape(-1, 16))


def _attach(
    layout: Layout,
    mesh: MovingMesh,
    bones: NDArray[np.unsignedinteger],
    weights: NDArray[np.float32],
) -> None:
    """Give the vertices of a mesh their bones and weights ``(V, 4)``."""
    for each in mesh.primitives:
        attributes = each.entry["attributes"]
        own = mesh.scene_mesh.vertices
        attributes["JOINTS_0"] = layout.add_array(bones[own][each.vertices], target=VERTICES)
        attributes["WEIGHTS_0"] = layout.add_array(weights[own][each.vertices], target=VERTICES)
