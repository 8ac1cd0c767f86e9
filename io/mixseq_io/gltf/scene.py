"""Node tree of a glTF file: names, paths and world transforms, as matrices on column vectors, ``p' = M p``.

A mesh with world-space points can keep its node's path below transformed parents if the node has their inverse
transform. This inverse is rounded; below non-uniformly scaled parents it may not exist as translation, rotation and
scale (TRS). A member of the node's ``extras`` marks such meshes. The reader takes their points as world-space points
if the transforms cancel within the rounding of exporters, which write scales such as 0.9999999.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mixseq.rigging.rigs import rotation_matrices
from mixseq.types import Float
from mixseq_io.gltf.document import Document, Fields
from mixseq_io.reader import warn
from mixseq_io.scene_meshes import SceneObject

WORLD_SPACE_MARK = "mixseq:world"
"""Name of the member of a node's ``extras`` that marks world-space points."""

_LINEAR_TOLERANCE = 1e-6  # rounding of rotations and scales by exporters
_TRANSLATION_TOLERANCE = 1e-9  # rounding by `invert_transform`
_MIN_DETERMINANT = 1e-30


def invert_transform(matrix: Float) -> dict[str, Any] | None:
    """Return the inverse of a matrix ``(4, 4)`` as a node's TRS members, {} for the identity; None if impossible."""
    if np.array_equal(matrix, np.eye(4)):
        return {}
    if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < _MIN_DETERMINANT:
        return None
    inverse = np.linalg.inv(matrix)
    translation, scale = inverse[:3, 3], np.linalg.norm(inverse[:3, :3], axis=0)
    scale[0] = np.copysign(scale[0], np.linalg.det(inverse))
    rotation = Rotation.from_matrix(inverse[:3, :3] / scale)
    composed = np.eye(4)
    composed[:3, :3], composed[:3, 3] = rotation.as_matrix() * scale, translation
    if not is_nearly_identity(matrix[None] @ composed):
        return None
    return {
        "translation": (translation + 0.0).tolist(),
        "rotation": rotation.as_quat().tolist(),
        "scale": scale.tolist(),
    }


def is_nearly_identity(matrices: Float) -> bool:
    """Whether matrices ``(B, 4, 4)`` are the identity within the rounding of exporters."""
    error = np.abs(matrices - np.eye(4))
    is_linear_close = (error[:, :3, :3] < _LINEAR_TOLERANCE).all()
    return bool(is_linear_close and (error[:, :3, 3] < _TRANSLATION_TOLERANCE).all())


Pose = Mapping[tuple[int, str], Float]
"""Animated values ``(B, k)`` by node and property: "translation", "rotation", "scale", "weights"."""

_MAX_PATH_LENGTH = 1 << 14
_IDENTITY_TRS = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Scene:
    """Nodes of a file with their parents (-1 for roots), and the objects and hidden nodes of its default scene."""

    document: Document
    parents: Sequence[int]
    objects: Mapping[int, SceneObject]
    hidden: Set[int]

    @property
    def nodes(self) -> Sequence[Fields]:
        """Fields of all nodes."""
        return self.document.items("nodes")

    @cached_property
    def paths(self) -> Mapping[int, str]:
        """Paths of the default scene's nodes, depth-first."""
        return {node: scene_object.path for node, scene_object in self.objects.items()}

    def lineage(self, node: int) -> list[int]:
        """Return a node and its ancestors, the root last."""
        chain = []
        while node >= 0:
            chain.append(node)
            node = self.parents[node]
        return chain

    def with_ancestors(self, nodes: Iterable[int]) -> set[int]:
        """Return the given nodes and all their ancestors."""
        visited = {-1}
        for node in nodes:
            while node not in visited:
                visited.add(node)
                node = self.parents[node]
        return visited - {-1}

    def joints(self, skin: Fields) -> list[int]:
        """Return the nodes of a skin's joints."""
        joints = skin.integers("joints")
        if not joints:
            raise skin.error("has no joints; the file is damaged")
        for joint in joints:
            self.document.item("nodes", joint)
        return joints

    def transform_nodes(self, node: int) -> list[int]:
        """Return the nodes whose matrices move a mesh: the joints of its skin, or its own node if it is unskinned."""
        skin = self.nodes[node].index("skin")
        return [node] if skin is None else self.joints(self.document.item("skins", skin))

    def world_matrices(
        self, nodes: Iterable[int], pose: Pose, world: dict[int, Float] | None = None
    ) -> dict[int, Float]:
        """Return local-to-world matrices ``(B or 1, 4, 4)`` of nodes and ancestors, added to `world` if given."""
        world = {} if world is None else world
        world.setdefault(-1, np.eye(4)[None])
        for node in nodes:
            missing = []
            while node not in world:
                missing.append(node)
                node = self.parents[node]
            for each in reversed(missing):
                matrices = world[self.parents[each]] @ _local_matrices(self.nodes[each], each, pose)
                extras = self.nodes[each].values.get("extras")
                is_marked = isinstance(extras, dict) and WORLD_SPACE_MARK in extras
                world[each] = np.eye(4)[None] if is_marked and is_nearly_identity(matrices) else matrices
        return world


def read_scene(document: Document) -> Scene:
    """Read the node tree."""
    nodes = document.items("nodes")
    children = [node.integers("children") for node in nodes]
    parents = [-1] * len(nodes)
    for parent, own_children in enumerate(children):
        for child in own_children:
            node = document.item("nodes", child)
            if parents[child] >= 0:
                raise node.error(f"is a child of two nodes, {parents[child]} and {parent}; one is allowed")
            parents[child] = parent
    _check_acyclic(nodes, parents)
    order = _order_depth_first(_read_roots(document, parents), children)
    return Scene(document, parents, _read_objects(document, parents, order), _find_hidden(nodes, parents, order))


def _check_acyclic(nodes: Sequence[Fields], parents: Sequence[int]) -> None:
    """Raise an error if the node hierarchy has a cycle."""
    checked = {-1}
    for node in range(len(nodes)):
        chain = set()
        while node not in checked:
            if node in chain:
                raise nodes[node].error("is below itself; the file is damaged")
            chain.add(node)
            node = parents[node]
        checked |= chain


def _read_roots(document: Document, parents: Sequence[int]) -> list[int]:
    """Return the roots of the default scene, or of all nodes in a file without scenes."""
    if not document.items("scenes"):
        return [node for node, parent in enumerate(parents) if parent < 0]
    scene = document.item("scenes", document.top.integer("scene", 0))
    roots = scene.integers("nodes")
    for root in roots:
        document.item("nodes", root)
        if parents[root] >= 0:
            warn(f"{document.path}: nodes[{root}] is a root of the scene, though a child of nodes[{parents[root]}]")
    return roots


def _order_depth_first(roots: Sequence[int], children: Sequence[Sequence[int]]) -> list[int]:
    order, stack = [], list(reversed(roots))
    while stack:
        node = stack.pop()
        order.append(node)
        stack.extend(reversed(children[node]))
    return list(dict.fromkeys(order))


def _read_objects(document: Document, parents: Sequence[int], order: Sequence[int]) -> dict[int, SceneObject]:
    """Return a scene object with a unique path for every node, parents before children."""
    objects: dict[int, SceneObject] = {}
    paths: set[str] = set()
    path_lengths = 0
    for node in order:
        fields = document.item("nodes", node)
        mesh, name = fields.index("mesh"), fields.text("name")
        parent = objects.get(parents[node])
        path = f"{parent.path}/{name or f'node {node}'}" if parent else name or f"node {node}"
        if path in paths:
            path = f"{path} (node {node})"
        if len(path) > _MAX_PATH_LENGTH:
            raise fields.error(f"is nested too deeply; its path has {len(path)} characters")
        path_lengths += len(path)
        document.check_effort(path_lengths, "paths of all nodes together")
        paths.add(path)
        is_missing = mesh is None or mesh >= len(document.items("meshes"))  # which is reported when it is read
        mesh_name = "" if mesh is None or is_missing else document.item("meshes", mesh).text("name")
        objects[node] = SceneObject(path, (name, mesh_name), parent)
    return objects


def _find_hidden(nodes: Sequence[Fields], parents: Sequence[int], order: Sequence[int]) -> set[int]:
    """Return the invisible nodes and all nodes below them."""
    hidden: set[int] = set()
    for node in order:
        visibility = nodes[node].object("extensions").object("KHR_node_visibility")
        if parents[node] in hidden or ("visible" in visibility and not visibility.flag("visible")):
            hidden.add(node)
    return hidden


def _local_matrices(node: Fields, index: int, pose: Pose) -> Float:
    """Return the parent-relative matrices of a node, ``(B, 4, 4)`` or constant ``(1, 4, 4)``."""
    animated = [name for name in _IDENTITY_TRS if (index, name) in pose]
    matrix = node.numbers("matrix", 16)
    if matrix is not None:
        if animated:
            raise node.error(f"has a matrix, and its {animated[0]} is animated; export the node with TRS instead")
        return matrix.reshape(1, 4, 4).transpose(0, 2, 1)
    translation, rotation, scale = (_read_property(node, index, name, pose) for name in _IDENTITY_TRS)
    matrices = np.zeros((max(map(len, (translation, rotation, scale))), 4, 4))
    matrices[:, :3, :3] = rotation_matrices(rotation) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    matrices[:, 3, 3] = 1.0
    return matrices


def _read_property(node: Fields, index: int, name: str, pose: Pose) -> Float:
    """Return the animated values ``(B, k)`` of a node's property, or the static value ``(1, k)``."""
    if (index, name) in pose:
        return pose[index, name]
    values = node.numbers(name, len(_IDENTITY_TRS[name]))
    return np.array(_IDENTITY_TRS[name] if values is None else values)[None]
