"""Node tree of a glTF file: names, paths and world transforms, as matrices on column vectors, ``p' = M p``.

A mesh whose points are in world space below transformed parents gets the inverse transform, so that it keeps its path.
The inverse is rounded, and unevenly scaled parents have none as translation, rotation and scale; nearly inverse
transforms are accepted, since exporters write scales such as 0.9999999. A mark in the node's ``extras`` makes the
reader take the points as world space, as long as the transforms still nearly cancel.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from mixseq.rigging.rigs import rotation_matrices
from mixseq.types import Float
from mixseq_io.gltf.document import Document, Fields
from mixseq_io.scene_meshes import SceneObject

MARK = "mixseq:world"
"""Member of the ``extras`` of a node whose points are in world space."""

_NEARLY = 1e-6  # rounding of rotations and scales by exporters
_HERE = 1e-9  # rounding of translations by mixseq


def undoing(above: NDArray[np.float64]) -> dict[str, Any] | None:
    """Return the transform that nearly inverts a parent's ``(4, 4)``, {} for the identity, None if there is none."""
    if np.array_equal(above, np.eye(4)):
        return {}
    if not np.isfinite(above).all() or abs(np.linalg.det(above)) < 1e-30:
        return None
    inverse = np.linalg.inv(above)
    scale = np.linalg.norm(inverse[:3, :3], axis=0)
    scale[0] = np.copysign(scale[0], np.linalg.det(inverse))
    rotation = Rotation.from_matrix(inverse[:3, :3] / scale)
    own = np.eye(4)
    own[:3, :3], own[:3, 3] = rotation.as_matrix() * scale, inverse[:3, 3]
    if not nearly_undone(above[None] @ own):
        return None
    return {
        "translation": (own[:3, 3] + 0.0).tolist(),
        "rotation": rotation.as_quat().tolist(),
        "scale": scale.tolist(),
    }


def nearly_undone(world: Float) -> bool:
    """Whether matrices ``(B, 4, 4)`` are the identity within the rounding of exporters."""
    off = np.abs(world - np.eye(4))
    return bool((off[:, :3, :3] < _NEARLY).all() and (off[:, :3, 3] < _HERE).all())


Pose = Mapping[tuple[int, str], NDArray[np.float64]]
"""Animated values ``(B, k)`` by node and property: "translation", "rotation", "scale", "weights"."""

_LONGEST_PATH = 1 << 14
_REST = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, eq=False)
class Scene:
    """Nodes of a file, and those of its default scene."""

    nodes: Sequence[Fields]
    parents: Sequence[int]
    objects: Mapping[int, SceneObject]
    hidden: Set[int]

    @cached_property
    def paths(self) -> Mapping[int, str]:
        """Paths of the default scene's nodes, depth-first."""
        return {node: each.path for node, each in self.objects.items()}

    def above(self, node: int) -> list[int]:
        """Return a node and its ancestors, the root last."""
        found = []
        while node >= 0:
            found.append(node)
            node = self.parents[node]
        return found

    def with_above(self, nodes: Iterable[int]) -> set[int]:
        """Return nodes and all their ancestors."""
        found = {-1}
        for node in nodes:
            while node not in found:
                found.add(node)
                node = self.parents[node]
        return found - {-1}

    def world(self, wanted: Iterable[int], pose: Pose) -> dict[int, Float]:
        """Return the local-to-world matrices of nodes, ``(B, 4, 4)``, or ``(1, 4, 4)`` if they are constant."""
        found: dict[int, Float] = {-1: np.eye(4)[None]}
        for node in wanted:
            missing = []
            while node not in found:
                missing.append(node)
                node = self.parents[node]
            for each in reversed(missing):
                matrices = found[self.parents[each]] @ _local(self.nodes[each], each, pose)
                extras = self.nodes[each].values.get("extras")
                undone = isinstance(extras, dict) and MARK in extras and nearly_undone(matrices)
                found[each] = np.eye(4)[None] if undone else matrices
        return found


def read_scene(document: Document) -> Scene:
    """Read the node tree."""
    nodes = document.items("nodes")
    children = [node.integers("children") for node in nodes]
    parents = [-1] * len(nodes)
    for parent, below in enumerate(children):
        for child in below:
            node = document.item("nodes", child)
            if parents[child] >= 0:
                raise node.error(f"is a child of two nodes, {parents[child]} and {parent}; one is allowed")
            parents[child] = parent
    _check_acyclic(nodes, parents)
    order = _depth_first(_roots(document, parents), children)
    return Scene(nodes, parents, _objects(document, parents, order), _hidden(nodes, parents, order))


def _check_acyclic(nodes: Sequence[Fields], parents: Sequence[int]) -> None:
    sound = {-1}
    for node in range(len(nodes)):
        chain = set()
        while node not in sound:
            if node in chain:
                raise nodes[node].error("is below itself; the file is damaged")
            chain.add(node)
            node = parents[node]
        sound |= chain


def _roots(document: Document, parents: Sequence[int]) -> list[int]:
    """Return the roots of the default scene, or of the file without scenes."""
    if not document.items("scenes"):
        return [node for node, parent in enumerate(parents) if parent < 0]
    scene = document.item("scenes", document.top.integer("scene", 0))
    roots = scene.integers("nodes")
    for root in roots:
        document.item("nodes", root)
        if parents[root] >= 0:
            raise scene.error(f"has nodes[{root}] as a root, which is a child of nodes[{parents[root]}]")
    return roots


def _depth_first(roots: Sequence[int], children: Sequence[Sequence[int]]) -> list[int]:
    order, waiting = [], list(reversed(roots))
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting.extend(reversed(children[node]))
    return list(dict.fromkeys(order))


def _objects(document: Document, parents: Sequence[int], order: Sequence[int]) -> dict[int, SceneObject]:
    objects: dict[int, SceneObject] = {}
    taken: set[str] = set()
    letters = 0
    for node in order:
        fields = document.item("nodes", node)
        mesh, name = fields.index("mesh"), fields.text("name")
        above = objects.get(parents[node])
        path = f"{above.path}/{name or f'node {node}'}" if above else name or f"node {node}"
        if path in taken:
            path = f"{path} (node {node})"
        if len(path) > _LONGEST_PATH:
            raise fields.error(f"is too deep below others; names of all together have {len(path)} characters")
        letters += len(path)
        document.check_effort(letters, "paths of all nodes together")
        taken.add(path)
        mesh_name = "" if mesh is None else document.item("meshes", mesh).text("name")
        objects[node] = SceneObject(path, (name, mesh_name), above)
    return objects


def _hidden(nodes: Sequence[Fields], parents: Sequence[int], order: Sequence[int]) -> set[int]:
    hidden: set[int] = set()
    for node in order:
        visibility = nodes[node].object("extensions").object("KHR_node_visibility")
        if parents[node] in hidden or ("visible" in visibility and not visibility.flag("visible")):
            hidden.add(node)
    return hidden


def _local(node: Fields, index: int, pose: Pose) -> Float:
    """Return the local matrices of a node, relative to its parent."""
    animated = [name for name in _REST if (index, name) in pose]
    matrix = node.numbers("matrix", 16)
    if matrix is not None:
        if animated:
            raise node.error(
                f"has a matrix, and its {animated[0]} is animated; export the node with TRS instead"
            )
        return matrix.reshape(1, 4, 4).transpose(0, 2, 1)
    translation, rotation, scale = (_property(node, index, name, pose) for name in _REST)
    matrices = np.zeros((max(map(len, (translation, rotation, scale))), 4, 4))
    matrices[:, :3, :3] = _rotations(rotation) * scale[:, None, :]
    matrices[:, :3, 3] = translation
    matrices[:, 3, 3] = 1.0
    return matrices


def _property(node: Fields, index: int, name: str, pose: Pose) -> NDArray[np.float64]:
    if (index, name) in pose:
        return pose[index, name]
    values = node.numbers(name, len(_REST[name]))
    return np.array(_REST[name] if values is None else values)[None]


def _rotations(quaternions: NDArray[np.float64]) -> Float:
    """Return rotation matrices ``(n, 3, 3)`` of quaternions ``(n, 4)``; the identity for zero length."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    unit = quaternions / np.where(lengths > 0, lengths, 1)
    return rotation_matrices(np.where(lengths > 0, unit, _REST["rotation"]))
