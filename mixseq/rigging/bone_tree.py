r"""Trees of bones with joints, and the motions of bones in a tree.

*The joint of two bones* is the point p of the rest shape where their motions differ least. It minimises

.. math:: \sum_t |M_{ta} \tilde p - M_{tb} \tilde p|^2 + \mu T\, |p - p_0|^2 = \tilde p^T S_{ab}\, \tilde p + \dots,
          \quad S_{ab} = \sum_t (M_{ta} - M_{tb})^T (M_{ta} - M_{tb}),

with :math:`\mu = 0.01`. A joint that never rotates is at :math:`p_0`, the middle of the contact; a hinge is on its axis
near :math:`p_0`. The minimum, :math:`g_{ab}`, is the separation of the joint (root mean square).

*The tree* is the minimum spanning tree of separations; pairs without contact only connect components of the mesh. The
root, such as an animal's trunk, minimises the mean depth of bones, weighted by their skinning weights.

*Motions* minimise :math:`\sum_v |x_t(v) - \sum_b w_{vb} M_{tb} \tilde r_v|^2` in every frame, for given weights. The
joint of bone b with its parent a is the rest point :math:`p_b`, which both bones move to the same position:
:math:`c_{tb} = M_{ta} \tilde p_b` and :math:`M_{tb} \tilde r = R_{tb} (r - p_b) + c_{tb}`. Roots and *sliding* joints
have independent translations; free bones (Le and Deng 2012) are roots. With rows :math:`\rho_v` of all
:math:`w_{vb} \tilde r_v`, and with the transposed motions stacked to :math:`M_t`, the residual of a vertex is
:math:`x_t(v) - M_t^T \rho_v`. It is minimised by coordinate descent, with closed-form steps for the following unknowns.

*Rotations* move a vertex by :math:`R_{tb} u_v` with the lever :math:`u_v = U_b \rho_v`. The lever is the sum of
:math:`w_{vb}(r_v - p_b)` and, for each child c, of :math:`p_c - p_b` times the weights of the subtree of c. Its length
is constant, so the best rotation is the nearest to
:math:`\sum_v (x_t - M_t^T \rho_v + R_{tb} u_v)\, u_v^T`.

*Translations* of roots and sliding joints move the subtree: :math:`\delta_t = \sum_v h_v (x_t - M_t^T \rho_v) / \sum_v
h_v^2` with :math:`h_v = H_b \rho_v`, the sum of the weights of the subtree of b. Such bones rotate about the point with
:math:`\sum_v h_v u_v = 0`, so that rotation and translation are independent.

*Joints* may be fitted too. A shift of :math:`p_b` by d moves the subtree by :math:`(R_{ta} - R_{tb})\, d`, which is a
linear least-squares problem in three unknowns.

With the sums :math:`K_{bc} = \sum_v w_{vb} w_{vc} \tilde r_v \tilde r_v^T` and
:math:`L_{tb} = \sum_v w_{vb} \tilde r_v x_t(v)^T` the cost of a sweep over the bones does not depend on the number of
vertices. A sweep updates the residual :math:`E = L - K M`. The constants were chosen empirically.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree, shortest_path

from mixseq.mesh.rigid import aligning_rotations
from mixseq.rigging.bones import Binding
from mixseq.types import Float, Index, Mask

SWEEPS_PER_ROUND = 10  # number of sweeps over the bones in a fit of motions
_ROTATION_STIFFNESS = 1e-9  # weight of the previous rotation, relative to its moment, for collinear points
_PARENT_STIFFNESS = 1e-6  # weight of the parent's rotation, for bones of a given skeleton that hardly move vertices
_JOINT_STIFFNESS = 1e-2  # weight of the previous position, relative to rotations by one radian in all frames


@dataclass(frozen=True, eq=False)
class Joints:
    """Joints of bones with their parents."""

    parents: Index  # (B,) parent of every bone; parents precede their children, and roots have -1
    pivots: Float  # (B, 3) joints with the parents, or pivots of roots, in the rest shape
    sliding: Mask  # (B,) bones with independent translations; includes all roots

    @classmethod
    def free(cls, count: int) -> Joints:
        """Return joints of roots without children, which rotate about the origin."""
        return cls(np.full(count, -1), np.zeros((count, 3)), np.ones(count, dtype=bool))

    def descendants(self) -> Mask:
        """Return a mask ``(B, B)`` of the bones (columns) in the subtree of each bone (rows)."""
        descendants = np.eye(len(self.parents), dtype=bool)
        for bone in range(len(self.parents) - 1, -1, -1):
            if self.parents[bone] >= 0:
                descendants[self.parents[bone]] |= descendants[bone]
        return descendants

    def moves_vertices(self, binding: Binding) -> Mask:
        """Return a mask ``(B,)`` of the bones with vertices in their subtree."""
        is_used = np.isin(np.arange(len(self.parents)), binding.influences[binding.weights > 0])
        return np.asarray((self.descendants() & is_used).any(axis=1))


def attach_joints(motions: Float, joints: Joints) -> Float:
    """Translate bones to close all joints except sliding joints: transposed motions ``(B, 4, 3T)``."""
    attached = motions.copy()
    for bone, parent in enumerate(joints.parents.tolist()):
        if not joints.sliding[bone]:
            pivot = joints.pivots[bone]
            attached[bone, 3] = pivot @ (attached[parent, :3] - attached[bone, :3]) + attached[parent, 3]
    return attached


def fit_motions(
    tracks: Float, binding: Binding, motions: Float, joints: Joints, fit_pivots: bool = True
) -> tuple[Float, Joints]:
    """Fit the motions ``(B, 4, 3T)`` of bones, and their joints, to tracks ``(V, 3T)``."""
    idle_bones = np.flatnonzero(~joints.moves_vertices(binding) & (joints.parents >= 0))
    start = attach_joints(_follow_parents(motions, joints, idle_bones), joints)
    fit = _MotionFit(tracks, binding, start, joints, 0.0 if fit_pivots else _PARENT_STIFFNESS)
    for _ in range(SWEEPS_PER_ROUND):
        for bone in range(len(motions)):
            fit.fit_rotations(bone)
            if joints.sliding[bone]:
                fit.fit_translations(bone)
        if fit_pivots:
            for bone in np.flatnonzero(~joints.sliding).tolist():
                fit.fit_joint(bone)
    fitted = replace(joints, pivots=fit.pivots)
    return attach_joints(_follow_parents(fit.motions, joints, idle_bones), fitted), fitted


def _follow_parents(motions: Float, joints: Joints, idle: Index) -> Float:
    """Replace the motions of idle bones by the motions of their parents."""
    following = motions.copy()
    for bone in idle.tolist():
        following[bone] = following[joints.parents[bone]]
    return following


class _MotionFit:
    """State of the coordinate descent: motions, joints, and the residual E."""

    def __init__(
        self, tracks: Float, binding: Binding, motions: Float, joints: Joints, parent_stiffness: float
    ) -> None:
        bone_count = len(motions)
        rows = binding.matrix(bone_count)
        self.products = np.asarray((rows.T @ rows).todense())
        self.motions, self.pivots = motions.copy(), joints.pivots.copy()
        self.residual = np.asarray(rows.T @ tracks) - self.products @ self.motions.reshape(4 * bone_count, -1)
        self.parents, self.sliding = joints.parents, joints.sliding
        self.parent_stiffness = parent_stiffness
        descendants = joints.descendants()
        # For every bone, its descendants, and the child through which each of them hangs on it.
        self.below = [np.flatnonzero(each & (np.arange(bone_count) != bone)) for bone, each in enumerate(descendants)]
        self.branches = [
            np.array(
                [np.flatnonzero((self.parents == bone) & descendants[:, each])[0] for each in below], dtype=np.int64
            )
            for bone, below in enumerate(self.below)
        ]
        self.subtree_levers: Float = np.kron(descendants, np.eye(1, 4, 3)).astype(
            np.float64
        )  # (B, 4B), H of every bone
        self.subtree_products = self.subtree_levers @ self.products
        self.subtree_weights = np.einsum("ab,ab->a", self.subtree_levers, self.subtree_products)  # sums of h_v^2

    def fit_rotations(self, bone: int) -> None:
        """Fit the rotations of a bone, which move the bone and its subtree."""
        bone_count = len(self.motions)
        arms = np.zeros((3, bone_count, 4))
        arms[:, bone, :3], arms[:, bone, 3] = np.eye(3), -self.pivots[bone]
        arms[:, self.below[bone], 3] = (self.pivots[self.branches[bone]] - self.pivots[bone]).T
        lever = arms.reshape(3, -1)  # U
        if self.sliding[bone]:
            weight = max(self.subtree_weights[bone], _ROTATION_STIFFNESS)
            centre = lever @ self.subtree_products[bone] / weight  # sum h_v u_v / sum h_v^2
            lever -= centre[:, None] * self.subtree_levers[bone]
        products = self.products @ lever.T
        moments = lever @ products
        moment = float(np.trace(moments))
        if moment <= _ROTATION_STIFFNESS**2:
            return
        current = self.motions[bone, :3]
        targets = (lever @ self.residual + moments @ current).reshape(3, -1, 3).transpose(1, 2, 0)
        parent_rotations = self.motions[self.parents[bone], :3] if self.parents[bone] >= 0 else current
        stiffness_terms = _ROTATION_STIFFNESS * moment * current + self.parent_stiffness * parent_rotations
        covariances = targets + stiffness_terms.reshape(3, -1, 3).transpose(1, 2, 0)
        fitted = aligning_rotations(covariances).transpose(2, 0, 1).reshape(3, -1)
        self._apply(lever, products, fitted - current)

    def fit_translations(self, bone: int) -> None:
        """Fit the translations of a bone, which move the bone and its subtree."""
        residual, weight = self._subtree_residual(bone)
        if weight > _ROTATION_STIFFNESS:
            self._translate_subtree(bone, residual / weight)

    def fit_joint(self, bone: int) -> None:
        """Fit the position of a joint; a shift of the joint moves the subtree of its bone."""
        residual, weight = self._subtree_residual(bone)
        if weight <= _ROTATION_STIFFNESS:
            return
        # Transposed differences between the rotations of parent and bone.
        d = (self.motions[self.parents[bone], :3] - self.motions[bone, :3]).reshape(3, -1, 3)
        normal = weight * (np.einsum("ati,bti->ab", d, d) + _JOINT_STIFFNESS * d.shape[1] * np.eye(3))
        step = np.linalg.solve(normal, np.einsum("ati,ti->a", d, residual.reshape(-1, 3)))
        self.pivots[bone] += step
        self._translate_subtree(bone, step @ d.reshape(3, -1))

    def _subtree_residual(self, bone: int) -> tuple[Float, float]:
        """Return the residual ``(3T,)`` summed over the subtree of a bone, and the sum of h_v^2."""
        return self.subtree_levers[bone] @ self.residual, float(self.subtree_weights[bone])

    def _translate_subtree(self, bone: int, change: Float) -> None:
        self._apply(self.subtree_levers[bone, None], self.subtree_products[bone, :, None], change[None])

    def _apply(self, lever: Float, products: Float, change: Float) -> None:
        self.motions += (lever.T @ change).reshape(self.motions.shape)
        self.residual -= products @ change


_PIVOT_DAMPING = 1e-2
_MIN_CONTACT_RATIO = 0.02  # smallest shared weight of two bones in contact, relative to the smaller weight of both
_NO_CONTACT_SEPARATION = 1.0  # penalty added to the separation of bones without contact, in diagonals


def build_bone_tree(faces: Index, binding: Binding, motions: Float) -> tuple[Index, Joints]:
    """Build a tree of bones with motions ``(B, 4, 3T)``; return the bones ``(B,)``, parents first, and the joints."""
    bone_count, frame_count = len(motions), motions.shape[2] // 3
    weights = sparse.csr_array(binding.matrix(bone_count)[:, 3::4])
    masses = np.asarray(weights.sum(axis=0), dtype=np.float64).reshape(-1)
    is_touching, middles = _contacts(faces, weights, binding.rest, masses)
    flat = motions.reshape(4 * bone_count, -1)
    products = (flat @ flat.T).reshape(bone_count, 4, bone_count, 4).swapaxes(1, 2)
    squares = products[np.arange(bone_count), np.arange(bone_count)]
    differences = squares[:, None] + squares[None] - products - products.swapaxes(0, 1)  # S
    pivots = np.linalg.solve(
        differences[..., :3, :3] + _PIVOT_DAMPING * frame_count * np.eye(3),
        (_PIVOT_DAMPING * frame_count * middles - differences[..., :3, 3])[..., None],
    )[..., 0]
    homogeneous = np.concatenate([pivots, np.ones((bone_count, bone_count, 1))], axis=2)
    squared = np.einsum("abi,abij,abj->ab", homogeneous, differences, homogeneous)
    separations = np.sqrt(np.maximum(squared, 0) / frame_count)
    costs = 1 + separations + _NO_CONTACT_SEPARATION * ~is_touching  # edges of a graph have positive costs
    tree = minimum_spanning_tree(np.triu(costs, 1))
    order, parents = _order_from_root(sparse.csr_array(tree + tree.T), masses)
    parent_bones = np.where(parents < 0, np.arange(bone_count), order[parents])
    joint_positions = pivots[order, parent_bones]
    joint_positions[0] = middles[order[0], order[0]]
    return order, Joints(parents, joint_positions, parents < 0)


def _contacts(faces: Index, weights: sparse.csr_array, rest: Float, masses: Float) -> tuple[Mask, Float]:
    """Return contacts ``(B, B)`` of bones, and contact middles ``(B, B, 3)`` (else the lighter bone's centre)."""
    corners = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = sparse.csr_array((np.ones(len(corners)), corners.T), (len(rest), len(rest)))
    ring_weights = weights + (edges + edges.T).minimum(1) @ weights  # weights of a vertex and its neighbours
    shared = np.asarray((weights.T @ ring_weights).todense())
    moments = [weights.T @ (ring_weights * rest[:, [axis]]) for axis in range(3)]
    middles = np.stack([np.asarray(moment.todense()) for moment in moments], axis=2)
    shared, middles = shared + shared.T, middles + middles.swapaxes(0, 1)
    own_weights = np.diag(shared)
    is_touching = shared > _MIN_CONTACT_RATIO * np.minimum(own_weights[:, None], own_weights[None])
    centres = np.asarray(weights.T @ rest) / masses[:, None]
    lighter_centres = np.where((masses[:, None] < masses[None])[..., None], centres[:, None], centres[None])
    has_middle = (is_touching & ~np.eye(len(masses), dtype=bool))[..., None]
    return is_touching, np.where(has_middle, middles / np.maximum(shared, 1e-300)[..., None], lighter_centres)


def _order_from_root(links: sparse.csr_array, masses: Float) -> tuple[Index, Index]:
    """Return the bones ``(B,)`` of a tree, parents first, and the position of each bone's parent in this order."""
    depths = shortest_path(links, directed=False, unweighted=True)
    order, predecessors = breadth_first_order(links, int((depths @ masses).argmin()), directed=False)
    positions = np.empty(len(masses), dtype=np.int64)
    positions[order] = np.arange(len(masses))
    predecessors = predecessors[order]
    parents = np.where(predecessors < 0, -1, positions[np.maximum(predecessors, 0)])
    return order.astype(np.int64), parents.astype(np.int64)
