r"""Skins and morphs in glTF: a base mesh with morph targets, which may follow bones.

A target is displacements ``d_m`` and weights ``w_tm`` from 0 to 1 (`rig_arrays.normalise_morph_weights`). glTF blends
normals as it does points, ``n_t ~ n_0 + sum_m w_tm e_m`` before normalisation. The ``e_m`` are fitted to the true
normals ``N_t`` of all frames by least squares: with the matrix ``W`` of weights, ``E = W^+ (N - n_0)``.

Joints are nodes in a tree. The node of joint b has the rotation and translation of `Skin.local_motion`
relative to its parent; in the world it takes the axes ``A_b`` at the pivot ``p_b`` to ``R_tb A_b`` at ``c_tb``. Its
inverse bind matrix takes them to the axes of the world at the origin,

.. math:: \begin{pmatrix} A_b & p_b \\ 0 & 1 \end{pmatrix}^{-1} =
          \begin{pmatrix} A_b^T & -A_b^T p_b \\ 0 & 1 \end{pmatrix},

so that a point goes to ``R_tb (r_v - p_b) + c_tb``, the formula of the skin; morph targets come before it. Constant
properties have no track. The roots lie under one node with axes and unit: only nodes above joints move a skinned mesh.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import OutputError
from mixseq.rigging.rigs import Morph, Skin, rotation_matrices
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Single
from mixseq_io.gltf.codecs import ARRAY_BUFFER, Json, Layout, append
from mixseq_io.gltf.new_document import (
    MovingMesh,
    axis_conversion,
    create_scene,
    named,
    new_animation,
    new_meshes,
)
from mixseq_io.reader import as_float32
from mixseq_io.rig_arrays import (
    four_influences,
    local_joint_transforms,
    normalise_morph_weights,
    numbered_names,
)

_KINDS = {"translation": "VEC3", "rotation": "VEC4", "weights": "SCALAR"}


@dataclass(frozen=True, eq=False)
class Track:
    """Values of a property of some nodes at every frame."""

    nodes: Sequence[int]
    path: str
    values: NDArray[np.float32]


def animate(layout: Layout, header: SequenceHeader, tracks: Sequence[Track]) -> None:
    """Add the linear animation of a sequence, with keys at its frames and rotations on the short arc, to a document.

    Constant tracks, and an animation without tracks, are left out: nodes have the values of the first frame.
    """
    moving = [track for track in tracks if (track.values != track.values[0]).any()]
    if not moving:
        return
    times, animation = new_animation(layout, header)
    # One view for all of them, since there may be hundreds.
    values = [np.ascontiguousarray(track.values) for track in moving]
    view, offset = layout.add(values, sum(each.nbytes for each in values)), 0
    for number, (track, each) in enumerate(zip(moving, values, strict=True)):
        kind = _KINDS[track.path]
        count = each.size if kind == "SCALAR" else len(each)
        output = layout.accessor(view, count, kind, offset)
        animation["samplers"].append({"input": times, "output": output, "interpolation": "LINEAR"})
        animation["channels"] += [
            {"sampler": number, "target": {"node": node, "path": track.path}} for node in track.nodes
        ]
        offset += each.nbytes
    append(layout.document, "animations", animation)


_ILL_DEFINED = 1e-6
"""Singular values of the weights below this fraction of the largest are ignored for normals."""


def create_morphed_scene(morph: Morph) -> Layout:
    """Return a document of a mesh with morph targets and the animation of their weights."""
    layout, meshes = create_scene(morph.header)
    animate(layout, morph.header, add_targets(layout, meshes, normalise_morph_weights(morph)))
    return layout


def add_targets(layout: Layout, meshes: Sequence[MovingMesh], morph: Morph) -> list[Track]:
    """Give the meshes of a document points, normals and targets; return the tracks of weights."""
    base = as_float32(morph.base[None], 0, "glTF")[0]
    targets = as_float32(morph.targets, 0, "glTF", "a target of vertex")
    for mesh in meshes:
        _add(layout, mesh, morph, base, targets)
    if not len(targets):
        return []
    for mesh in meshes:
        entry = layout.document["meshes"][layout.document["nodes"][mesh.node]["mesh"]]
        entry["weights"] = morph.weights[0].astype(np.float32).tolist()
        entry["extras"] = {"targetNames": numbered_names("mode", len(targets))}
    return [Track([mesh.node for mesh in meshes], "weights", morph.weights.astype(np.float32))]


def _add(layout: Layout, mesh: MovingMesh, morph: Morph, base: Single, targets: Single) -> None:
    normals, normal_targets = _normals(mesh, morph)
    for each in mesh.primitives:
        shapes = [(base, normals), *zip(targets, normal_targets, strict=True)]
        for number, (points, directions) in enumerate(shapes):
            attributes = each.entry["attributes"] if number == 0 else {}
            attributes["POSITION"] = layout.add_points(points[mesh.scene_mesh.vertices][each.vertices])
            if each.normals is not None:
                attributes["NORMAL"] = layout.add_array(directions[each.normals], target=ARRAY_BUFFER)
            if number > 0:
                append(each.entry, "targets", attributes)


def _normals(mesh: MovingMesh, morph: Morph) -> tuple[Single, Single]:
    """Return the normals of the base ``(G, 3)`` and of the targets ``(M, G, 3)``, see the module's head."""
    (base,) = mesh.normals_of(morph.base[None])
    targets = np.zeros((len(morph.targets), base.size))
    if len(targets):
        inverse = np.linalg.pinv(morph.weights, rcond=_ILL_DEFINED)
        frame = 0
        for block in morph.blocks():
            turned = (mesh.normals_of(block) - base.astype(np.float64)).reshape(len(block), -1)
            targets += inverse[:, frame : frame + len(block)] @ turned
            frame += len(block)
    return base, targets.reshape(-1, *base.shape).astype(np.float32)


MOST_BONES = 65535
_MOST_OF_A_BYTE = 256


def create_skinned_scene(skin: Skin) -> Layout:
    """Return a document of a skinned mesh, its bones and their animation."""
    if skin.bone_count > MOST_BONES:
        raise OutputError(
            f"the skin has {skin.bone_count} bones, glTF has numbers for {MOST_BONES}; fit it with fewer (bones=N)"
        )
    layout, meshes = new_meshes(skin.header)
    document = layout.document
    of_targets = add_targets(layout, meshes, normalise_morph_weights(skin))
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
    skeleton = skin.skeleton
    rotations, translations = local_joint_transforms(skin, "glTF")
    root = append(document, "nodes", {"name": "skeleton", "children": [], **axis_conversion(skin.header)})
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
        attributes["JOINTS_0"] = layout.add_array(bones[own][each.vertices], target=ARRAY_BUFFER)
        attributes["WEIGHTS_0"] = layout.add_array(weights[own][each.vertices], target=ARRAY_BUFFER)
