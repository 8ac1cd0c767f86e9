r"""Bind pose of a glTF skin: its joints, and the meshes on them.

The inverse bind matrix :math:`I_j` takes the mesh to the joint's axes, so that the joint lies at :math:`I_j^{-1}` in
mesh space. Mesh space is placed in the world by the first joint without a parent, :math:`W_r I_r`, where its node
stands:

.. math:: M_j = W_r I_r I_j^{-1}.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from mixseq.arrays import Float
from mixseq.errors import NoMeshError
from mixseq_io.gltf.compression import plain
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.node_meshes import chosen_nodes
from mixseq_io.gltf.node_tree import Scene, read_scene
from mixseq_io.gltf.world_points import Shape, Skin, inverse_binds_of, joints_of
from mixseq_io.skeletons import choose_skeleton, skeleton_of

if TYPE_CHECKING:
    from mixseq.rigging.skeletons import Skeleton


def read_joints(path: Path, name: str | None) -> Skeleton:
    """Read the joints of a skin; see `mixseq_io.read_skeleton`."""
    document = plain(load_document(path))
    scene = read_scene(document)
    skin = _chosen(document, name)
    joints = joints_of(document, skin)
    parents = _parents(scene, joints)
    labels = [scene.nodes[joint].text("name") for joint in joints]
    return skeleton_of(labels, parents, _bind_pose(document, scene, skin, parents))


def nodes_on(document: Document, scene: Scene, name: str | None) -> list[int]:
    """Return the nodes whose meshes follow a skeleton: those of its skins, and those below its joints."""
    wanted = set(joints_of(document, _chosen(document, name)))
    nodes = [node for node in chosen_nodes(document, scene, None) if _follows(document, scene, node, wanted)]
    if not nodes:
        raise NoMeshError(f"{document.path} has no mesh on its skeleton; export the character with its mesh")
    return nodes


def bound(document: Document, shape: Shape, name: str | None) -> Shape:
    """Return a shape in its bind pose, bound to a single joint, the first without a parent.

    The transform is :math:`I_r` from its skin's space, :math:`I_r I_j^{-1} W_j^{-1} W_n` for a node n below a joint j.
    """
    scene, skin, fields = shape.scene, shape.skin, _chosen(document, name)
    joints = joints_of(document, fields)
    if "inverseBindMatrices" not in fields:
        return shape  # bound where the joints stand
    inverse_binds = inverse_binds_of(document, fields, len(joints))
    root = _parents(scene, joints).index(-1)
    if skin is None:
        above = next(node for node in scene.above(shape.node) if node in joints)
        world = scene.world([above, shape.node], {})
        here = np.linalg.pinv(world[above][0]) @ world[shape.node][0]
        onto = inverse_binds[root] @ np.linalg.pinv(inverse_binds[joints.index(above)]) @ here
    else:
        onto = skin.inverse_binds[list(skin.joints).index(joints[root])]
    alone = csr_array(np.ones((len(shape.rest), 1)))
    return replace(shape, skin=Skin([joints[root]], onto[None], alone))


def _follows(document: Document, scene: Scene, node: int, joints: Set[int]) -> bool:
    skin = scene.nodes[node].index("skin")
    if skin is None:
        return not joints.isdisjoint(scene.above(node))
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
    return [next((number[node] for node in scene.above(joint)[1:] if node in number), -1) for joint in joints]


def _bind_pose(document: Document, scene: Scene, skin: Fields, parents: Sequence[int]) -> Float:
    """Return the world matrices ``(J, 4, 4)`` of the joints."""
    joints = joints_of(document, skin)
    world = scene.world(joints, {})
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
