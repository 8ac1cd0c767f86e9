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
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree, shortest_path

from mixseq.mesh.rigid import MIN_COVARIANCE_RATIO, nearest_rotation_kernel
from mixseq.rigging.bones import Binding, cholesky_solve
from mixseq.runtime.jit import compiled
from mixseq.types import Float, Index, Mask

SWEEPS_PER_ROUND = 10  # number of sweeps over the bones in a fit of motions
_ROTATION_STIFFNESS = 1e-9  # weight of the previous rotation, relative to its moment, for collinear points
_PARENT_STIFFNESS = 1e-6  # weight of the parent's rotation, for bones of a given skeleton that hardly move vertices
_JOINT_STIFFNESS = 1e-2  # weight of the previous position, relative to rotations by one radian in all frames
_FRAMES_PER_BLOCK = 32  # number of frames whose residuals fit into the cache of a processor


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

    @cached_property
    def branches(self) -> Index:
        """The bone or child ``(B, B)`` of each bone (rows) whose subtree has each bone (columns); -1 outside it."""
        return np.asarray(_find_branches(self.parents))

    def moves_vertices(self, binding: Binding) -> Mask:
        """Return a mask ``(B,)`` of the bones with vertices in their subtree."""
        is_used = np.isin(np.arange(len(self.parents)), binding.influences[binding.weights > 0])
        return np.asarray(((self.branches >= 0) & is_used).any(axis=1))


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
    fitted = attach_joints(_follow_parents(motions, joints, idle_bones), joints)
    rows = binding.matrix(len(motions))
    products = np.asarray((rows.T @ rows).todense())
    residual = np.asarray(rows.T @ tracks) - products @ fitted.reshape(len(products), -1)
    if not np.isfinite(residual).all():
        raise np.linalg.LinAlgError("positions with an entry that is not finite have no motion")
    fitted_joints = replace(joints, pivots=joints.pivots.copy())
    subtree_products = products[3::4].copy()
    for bone in range(len(motions) - 1, 0, -1):
        if joints.parents[bone] >= 0:
            subtree_products[joints.parents[bone]] += subtree_products[bone]
    graph = joints.parents, joints.branches, joints.sliding, fitted_joints.pivots
    shapes = (count := len(motions), 3), (count, 4 * count, 3), (count, 3, 3)
    tree = _Tree(products, subtree_products, *graph, *map(np.zeros, shapes))
    stiffness = 0.0 if fit_pivots else _PARENT_STIFFNESS
    _descend(tree, fitted, residual.reshape(fitted.shape), fit_pivots and not joints.sliding.all(), stiffness)
    return attach_joints(_follow_parents(fitted, joints, idle_bones), fitted_joints), fitted_joints


def _follow_parents(motions: Float, joints: Joints, idle: Index) -> Float:
    """Replace the motions of idle bones by the motions of their parents."""
    following = motions.copy()
    for bone in idle.tolist():
        following[bone] = following[joints.parents[bone]]
    return following


@compiled
def _find_branches(parents: Index) -> Index:
    """Return the bone or child ``(B, B)`` of each bone (rows) whose subtree has each bone (columns), or -1."""
    branches = np.full((len(parents), len(parents)), -1, dtype=np.int64)
    for bone in range(len(parents)):
        branch, ancestor = bone, bone
        while ancestor >= 0:
            branches[ancestor, bone] = branch
            branch, ancestor = ancestor, parents[ancestor]
    return branches


class _Tree(NamedTuple):
    """Sums over the vertices of bones, and a tree of these."""

    products: Float  # (4B, 4B), K
    subtree_products: Float  # (B, 4B), H_b K; an entry is zero where no vertex is shared
    parents: Index  # (B,)
    branches: Index  # (B, B)
    sliding: Mask  # (B,)
    pivots: Float  # (B, 3), which may be fitted
    origins: Float  # (B, 3) points about which bones rotate; these and the following follow from the pivots
    levers: Float  # (B, 4B, 3) products of K and the levers
    moments: Float  # (B, 3, 3) moments of the levers


@compiled
def _descend(tree: _Tree, motions: Float, residual: Float, fit_pivots: bool, parent_stiffness: float) -> None:
    """Fit pivots and motions ``(B, 4, 3T)`` in place by coordinate descent; the residual E is updated."""
    bone_count, columns = len(tree.parents), motions.shape[2]
    changes = np.empty((3, columns))
    for sweep in range(SWEEPS_PER_ROUND):
        for bone in range(bone_count):
            if sweep == 0 or fit_pivots:
                _fill_lever(tree, bone)
        for start in range(0, columns, 3 * _FRAMES_PER_BLOCK):
            width = min(3 * _FRAMES_PER_BLOCK, columns - start)
            block_motions, block_residual = np.empty((bone_count, 4, width)), np.empty((bone_count, 4, width))
            _copy_columns(motions, start, block_motions, 0, width)
            _copy_columns(residual, start, block_residual, 0, width)
            for bone in range(bone_count):
                _fit_rotations(tree, bone, parent_stiffness, block_motions, block_residual, changes)
                if tree.sliding[bone]:
                    weight = _sum_subtree(tree, bone, block_residual, changes)
                    if weight > _ROTATION_STIFFNESS:
                        for i in range(width):
                            changes[0, i] /= weight
                        _translate_subtree(tree, bone, block_motions, block_residual, changes)
            _copy_columns(block_motions, 0, motions, start, width)
            _copy_columns(block_residual, 0, residual, start, width)
        if fit_pivots:
            for bone in range(bone_count):
                if not tree.sliding[bone]:
                    _fit_joint(tree, bone, motions, residual, changes)


@compiled
def _copy_columns(source: Float, source_start: int, target: Float, target_start: int, count: int) -> None:
    """Copy columns of arrays ``(B, 4, n)``; loops over whole rows, from zero on, are vectorised."""
    for bone in range(len(source)):
        for row in range(4):
            for i in range(count):
                target[bone, row, target_start + i] = source[bone, row, source_start + i]


@compiled
def _fill_lever(tree: _Tree, bone: int) -> None:
    """Compute the point about which a bone rotates, the product ``(4B, 3)`` of K and its lever, and its moments."""
    products, subtree_products, branches, pivots = tree.products, tree.subtree_products, tree.branches, tree.pivots
    origins, levers, bone_count, own = tree.origins, tree.levers, len(tree.pivots), 4 * bone
    weight = 0.0
    for other in range(bone, bone_count):
        if branches[bone, other] >= 0:
            weight += subtree_products[bone, 4 * other + 3]
    for axis in range(3):
        origin = pivots[bone, axis]
        if tree.sliding[bone]:
            centre = subtree_products[bone, own + axis] - origin * subtree_products[bone, own + 3]
            for other in range(bone + 1, bone_count):
                if branches[bone, other] >= 0:
                    offset = pivots[branches[bone, other], axis] - pivots[bone, axis]
                    centre += offset * subtree_products[bone, 4 * other + 3]
            origin += centre / max(weight, _ROTATION_STIFFNESS)
        for other in range(bone_count):
            if subtree_products[bone, 4 * other + 3] != 0.0:  # other products stay zero
                for i in range(4 * other, 4 * other + 4):
                    levers[bone, i, axis] = products[own + axis, i] - origin * products[own + 3, i]
        for child in range(bone + 1, bone_count):
            if branches[bone, child] == child:
                offset = pivots[child, axis] - origin
                for other in range(bone_count):
                    if subtree_products[child, 4 * other + 3] != 0.0:
                        for i in range(4 * other, 4 * other + 4):
                            levers[bone, i, axis] += offset * subtree_products[child, i]
        origins[bone, axis] = origin
    for axis in range(3):
        for i in range(3):
            moment = levers[bone, own + axis, i] - origins[bone, axis] * levers[bone, own + 3, i]
            for other in range(bone + 1, bone_count):
                if branches[bone, other] >= 0:
                    offset = pivots[branches[bone, other], axis] - origins[bone, axis]
                    moment += offset * levers[bone, 4 * other + 3, i]
            tree.moments[bone, axis, i] = moment


@compiled
def _fit_rotations(
    tree: _Tree, bone: int, parent_stiffness: float, motions: Float, residual: Float, changes: Float
) -> None:
    """Fit the rotations of a bone, which move the bone and its subtree."""
    parents, branches, pivots, origins = tree.parents, tree.branches, tree.pivots, tree.origins
    subtree_products, levers, moments = tree.subtree_products, tree.levers, tree.moments
    moment = moments[bone, 0, 0] + moments[bone, 1, 1] + moments[bone, 2, 2]
    if moment <= _ROTATION_STIFFNESS**2:
        return
    parent = parents[bone] if parents[bone] >= 0 else bone
    covariances = np.empty((residual.shape[2] // 3, 3, 3))
    for axis in range(3):
        for i in range(residual.shape[2]):
            changes[axis, i] = (
                residual[bone, axis, i]
                - origins[bone, axis] * residual[bone, 3, i]
                + moments[bone, axis, 0] * motions[bone, 0, i]
                + moments[bone, axis, 1] * motions[bone, 1, i]
                + moments[bone, axis, 2] * motions[bone, 2, i]
                + _ROTATION_STIFFNESS * moment * motions[bone, axis, i]
                + parent_stiffness * motions[parent, axis, i]
            )
        for other in range(bone + 1, len(parents)):
            if branches[bone, other] >= 0:
                offset = pivots[branches[bone, other], axis] - origins[bone, axis]
                for i in range(residual.shape[2]):
                    changes[axis, i] += offset * residual[other, 3, i]
        for i in range(residual.shape[2]):
            covariances[i // 3, i % 3, axis] = changes[axis, i]
    rotations = nearest_rotation_kernel(covariances, MIN_COVARIANCE_RATIO)
    for axis in range(3):
        for i in range(residual.shape[2]):
            changes[axis, i] = rotations[i // 3, i % 3, axis] - motions[bone, axis, i]
            motions[bone, axis, i] += changes[axis, i]
    for other in range(bone, len(parents)):
        if branches[bone, other] >= 0:
            x, y, z = -origins[bone, 0], -origins[bone, 1], -origins[bone, 2]
            if other != bone:
                branch = branches[bone, other]
                x, y, z = x + pivots[branch, 0], y + pivots[branch, 1], z + pivots[branch, 2]
            for i in range(residual.shape[2]):
                motions[other, 3, i] += x * changes[0, i] + y * changes[1, i] + z * changes[2, i]
    for other in range(len(parents)):
        if subtree_products[bone, 4 * other + 3] != 0.0:
            for row in range(4):
                lever = levers[bone, 4 * other + row]
                x, y, z = lever[0], lever[1], lever[2]
                for i in range(residual.shape[2]):
                    residual[other, row, i] -= x * changes[0, i] + y * changes[1, i] + z * changes[2, i]


@compiled
def _fit_joint(tree: _Tree, bone: int, motions: Float, residual: Float, changes: Float) -> None:
    """Fit the position of a joint; a shift of the joint moves the subtree of its bone."""
    columns, parent = motions.shape[2], tree.parents[bone]
    weight = _sum_subtree(tree, bone, residual, changes)
    if weight <= _ROTATION_STIFFNESS:
        return
    normal, step = np.zeros((3, 3)), np.zeros(3)
    for axis in range(3):
        for i in range(columns):
            difference = motions[parent, axis, i] - motions[bone, axis, i]
            step[axis] += difference * changes[0, i]
            for other in range(3):
                normal[axis, other] += weight * difference * (motions[parent, other, i] - motions[bone, other, i])
        normal[axis, axis] += weight * _JOINT_STIFFNESS * (columns // 3)
    cholesky_solve(normal, step, 3)
    for axis in range(3):
        tree.pivots[bone, axis] += step[axis]
    for i in range(columns):
        changes[0, i] = 0.0
        for axis in range(3):
            changes[0, i] += step[axis] * (motions[parent, axis, i] - motions[bone, axis, i])
    _translate_subtree(tree, bone, motions, residual, changes)


@compiled
def _sum_subtree(tree: _Tree, bone: int, residual: Float, changes: Float) -> float:
    """Sum the residual over the subtree of a bone into the first row of `changes`; return the sum of h_v^2."""
    branches, weight = tree.branches, 0.0
    for i in range(residual.shape[2]):
        changes[0, i] = 0.0
    for other in range(bone, len(branches)):
        if branches[bone, other] >= 0:
            weight += tree.subtree_products[bone, 4 * other + 3]
            for i in range(residual.shape[2]):
                changes[0, i] += residual[other, 3, i]
    return weight


@compiled
def _translate_subtree(tree: _Tree, bone: int, motions: Float, residual: Float, changes: Float) -> None:
    """Translate the subtree of a bone by the first row of `changes`."""
    subtree_products, branches = tree.subtree_products, tree.branches
    for other in range(len(branches)):
        if branches[bone, other] >= 0:
            for i in range(residual.shape[2]):
                motions[other, 3, i] += changes[0, i]
        if subtree_products[bone, 4 * other + 3] != 0.0:
            for row in range(4):
                factor = subtree_products[bone, 4 * other + row]
                for i in range(residual.shape[2]):
                    residual[other, row, i] -= factor * changes[0, i]


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
