"""Points of a glTF mesh in world space: morph targets first, then the skin, or else the node's transform.

Specification: https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html#skins
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from mixseq.arrays import Float, FloatArray
from mixseq_io.gltf.document import Document
from mixseq_io.gltf.json_fields import Fields
from mixseq_io.gltf.node_tree import Pose, Scene
from mixseq_io.gltf.welding import Weld, deltas, influences, target_count


@dataclass(frozen=True, eq=False)
class Skin:
    """Skin of a mesh: nodes of its J joints, weights ``(W, J)`` whose rows sum to 1, and `inverse_binds` ``(J, 4, 4)``.

    Inverse bind matrices take mesh space to each joint's space in the bind pose.
    """

    joints: Sequence[int]
    inverse_binds: NDArray[np.float64]
    weights: csr_array

    def matrices(self, world: Mapping[int, Float]) -> NDArray[np.float64]:
        """Return the matrices ``(B, J, 4, 4)`` that move points bound to the joints."""
        joints = np.broadcast_arrays(*(world[joint] for joint in self.joints))
        return np.stack(joints, axis=1) @ self.inverse_binds


@dataclass(frozen=True, eq=False)
class Shape:
    """Node with a welded mesh: rest positions ``(W, 3)``, static morph weights ``(K,)``, and a skin or None.

    A skin replaces the node's transform.
    """

    scene: Scene
    node: int
    weld: Weld
    rest: NDArray[np.float64]
    weights: NDArray[np.float64]
    skin: Skin | None

    @property
    def bearers(self) -> Sequence[int]:
        """Nodes whose matrices move the mesh."""
        return [self.node] if self.skin is None else self.skin.joints

    def handedness(self, world: Mapping[int, Float]) -> NDArray[np.float64]:
        """Return the orientation ``(B,)``: 1 as modelled, -1 mirrored, 0 flat; of joints the majority decides."""
        if self.skin is None:
            return _signs(world[self.node])
        used = np.unique(self.skin.weights.indices)
        matrices = self.skin.matrices(world)
        return np.asarray(np.sign(_signs(matrices[:, used]).sum(axis=1)))

    def points(self, pose: Pose, world: Mapping[int, Float], frames: int) -> FloatArray:
        """Return the points ``(B, W, 3)`` in world space for the B frames of a pose, given the bearers' matrices."""
        own = self._morphed(pose, frames)
        if self.skin is None:
            matrices = np.broadcast_to(world[self.node], (frames, 4, 4))
            return own @ matrices[:, :3, :3].transpose(0, 2, 1) + matrices[:, None, :3, 3]
        joints = self.skin.matrices(world)[:, :, :3].reshape(-1, len(self.skin.joints), 12)
        joints = np.broadcast_to(joints, (frames, *joints.shape[1:]))
        return np.stack([_skinned(*each, self.skin.weights) for each in zip(own, joints, strict=True)])

    def _morphed(self, pose: Pose, frames: int) -> NDArray[np.float64]:
        points = np.tile(self.rest, (frames, 1, 1))
        weights = np.broadcast_to(pose.get((self.node, "weights"), self.weights), (frames, len(self.weights)))
        for target in np.flatnonzero(weights.any(axis=0)):
            here = np.flatnonzero(weights[:, target])
            delta = deltas(self.weld.primitives, int(target))[self.weld.representatives]
            points[here] += weights[here, target, None, None] * delta
        return points


def _signs(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.nan_to_num(np.sign(np.linalg.det(matrices[..., :3, :3]))))


def _skinned(
    points: NDArray[np.float64], joints: NDArray[np.float64], weights: csr_array
) -> NDArray[np.float64]:
    blended = (weights @ joints).reshape(-1, 3, 4)
    return np.asarray(np.einsum("vij,vj->vi", blended[:, :, :3], points) + blended[:, :, 3])


def bearers(document: Document, node: Fields, index: int) -> list[int]:
    """Return the nodes whose matrices move a node's mesh: its skin's joints, or the node itself."""
    skin = node.index("skin")
    if skin is None:
        return [index]
    return joints_of(document, document.item("skins", skin))


def joints_of(document: Document, skin: Fields) -> list[int]:
    """Return the nodes of a skin's joints."""
    joints = skin.integers("joints")
    if not joints:
        raise skin.error("has no joints; the file is damaged")
    for joint in joints:
        document.item("nodes", joint)
    return joints


def read_shape(document: Document, scene: Scene, node: int, weld: Weld) -> Shape:
    """Read the shape of a node's mesh."""
    fields = scene.nodes[node]
    mesh = document.item("meshes", fields.integer("mesh"))
    positions = np.concatenate([each.positions for each in weld.primitives]).astype(np.float64)
    count = target_count(weld.primitives)
    owner = fields if "weights" in fields else mesh
    weights = owner.numbers("weights", count) if "weights" in owner and count else None
    skin = fields.index("skin")
    return Shape(
        scene=scene,
        node=node,
        weld=weld,
        rest=positions[weld.representatives],
        weights=np.zeros(count) if weights is None else weights,
        skin=None if skin is None else _read_skin(document, skin, bearers(document, fields, node), weld),
    )


def _read_skin(document: Document, index: int, joints: Sequence[int], weld: Weld) -> Skin:
    fields = document.item("skins", index)
    inverse_binds = inverse_binds_of(document, fields, len(joints))
    joint, weight = influences(weld.primitives)
    if not joint.size:
        raise fields.error("moves a mesh that has no JOINTS_0 and WEIGHTS_0; the file is damaged")
    if joint.max() >= len(joints):
        raise fields.error(
            f"has {len(joints)} joints, but vertices follow joint {joint.max()}; the file is damaged"
        )
    rows = weld.representatives
    return Skin(joints, inverse_binds, _normalised(joint[rows], weight[rows], len(joints)))


def inverse_binds_of(document: Document, skin: Fields, count: int) -> NDArray[np.float64]:
    """Return a skin's matrices ``(J, 4, 4)`` from the mesh to each of its `count` joints."""
    binds = skin.index("inverseBindMatrices")
    if binds is None:
        return np.tile(np.eye(4), (count, 1, 1))
    matrices = document.accessor(binds)
    if matrices.ndim != 2 or matrices.shape[1] != 16 or len(matrices) < count:
        raise skin.error(f"has {count} joints, but inverse bind matrices of shape {matrices.shape}")
    return matrices[:count].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def _normalised(joint: NDArray[np.int64], weight: NDArray[np.float64], joints: int) -> csr_array:
    """Return weights ``(W, J)`` with row sums 1, as in renderers; vertices without weight follow the first joint."""
    sums = weight.sum(axis=1, keepdims=True)
    weight = np.where(sums != 0, weight / np.where(sums != 0, sums, 1), np.arange(weight.shape[1]) == 0)
    rows = np.repeat(np.arange(len(weight)), weight.shape[1])
    matrix = csr_array((weight.reshape(-1), (rows, joint.reshape(-1))), shape=(len(weight), joints))
    matrix.eliminate_zeros()
    return matrix
