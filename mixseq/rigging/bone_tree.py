r"""The tree of bones, and motions of bones in it.

*The joint of two bones.* Of points p of the rest shape, the one that both move most alike minimises

.. math:: \sum_t |M_{ta} \tilde p - M_{tb} \tilde p|^2 + \mu T\, |p - p_0|^2 = \tilde p^T S_{ab}\, \tilde p + \dots,
          \quad S_{ab} = \sum_t (M_{ta} - M_{tb})^T (M_{ta} - M_{tb}),

with :math:`\mu = 0.01`: a joint that never turns stays at :math:`p_0`, the middle of the contact, and a hinge stays
next to it on its axis. The minimum, :math:`g_{ab}`, is the separation of the joint (root mean square).

*The tree* joins all bones by the pairs of least separation; pairs without contact are only used to connect components
of the mesh. Its root is the bone with the fewest joints to the others, weighted by their vertices: the trunk of an
animal.

*Motions.* Given weights, they minimise :math:`\sum_v |x_t(v) - \sum_b w_{vb} M_{tb} \tilde r_v|^2` in every frame. The
joint of bone b with its parent a is the point :math:`p_b` of the rest shape, and both take it to the same place:
:math:`c_{tb} = M_{ta} \tilde p_b` and :math:`M_{tb} \tilde r = R_{tb} (r - p_b) + c_{tb}`. Roots have translations of
their own, and so have *sliding* joints; free bones (Le and Deng 2012) are roots. With rows :math:`\rho_v` of all
:math:`w_{vb} \tilde r_v` and the motions transposed and stacked to :math:`M_t`, the residual of a vertex is
:math:`x_t(v) - M_t^T \rho_v`. In each unknown alone it has a closed solution; unknowns are solved in turn:

*Rotations.* Points follow :math:`R_{tb} u_v` with :math:`u_v = U_b \rho_v`: those of the bone, :math:`w_{vb}(r_v -
p_b)`, and for each child c the joint, :math:`p_c - p_b`, times the weights of c and all below it. The length of
:math:`u_v` is constant, so the best rotation is the nearest to
:math:`\sum_v (x_t - M_t^T \rho_v + R_{tb} u_v)\, u_v^T`.

*Translations* of roots and sliding joints move all below: :math:`\delta_t = \sum_v h_v (x_t - M_t^T \rho_v) / \sum_v
h_v^2` with :math:`h_v = H_b \rho_v`, the sum of the weights of b and all below it. Such bones turn about the point
where :math:`\sum_v h_v u_v = 0`, so that rotation and translation together are the best.

*Joints* may be fitted too: :math:`p_b + d` moves all below by :math:`(R_{ta} - R_{tb})\, d`, a problem of least squares
in three unknowns.

All of it follows from the sums :math:`K_{bc} = \sum_v w_{vb} w_{vc} \tilde r_v \tilde r_v^T` and
:math:`L_{tb} = \sum_v w_{vb} \tilde r_v x_t(v)^T`, so that the cost of a sweep over the bones does not depend on the
vertices. It updates :math:`E = L - K M`. The constants were chosen empirically.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from mixseq.mesh.rigid import aligning_rotations
from mixseq.rigging.bones import Binding
from mixseq.types import Float, Index, Mask

SWEEPS = 10
"""Number of sweeps over the bones between two rounds of weights."""

_ROTATION_STIFFNESS = 1e-9
"""Pull of a rotation towards the one before, relative to its moment: fixes rotations of collinear points."""

_STIFFNESS = 1e-6
"""Pull of a given bone towards the one above, in vertices one diagonal away: fixes bones that move hardly anything."""

_JOINT_HELD = 1e-2
"""Pull of a joint towards its position, relative to a turn by one radian in all frames."""


@dataclass(frozen=True, eq=False)
class Joints:
    """Parents, positions and sliding of joints."""

    parents: Index  # (B,) the bone above each, which stands before it; -1 for roots
    pivots: Float  # (B, 3) joints with the parents, in the rest shape; pivots of roots
    sliding: Mask  # (B,) whether the joint has a translation of its own; roots have

    @classmethod
    def loose(cls, count: int) -> Joints:
        """Return free bones that turn about the origin."""
        return cls(np.full(count, -1), np.zeros((count, 3)), np.ones(count, dtype=bool))

    def below(self) -> Mask:
        """Return ``(B, B)`` whether a bone (column) is another (row) or below it."""
        found = np.eye(len(self.parents), dtype=bool)
        for bone in range(len(self.parents) - 1, -1, -1):
            if self.parents[bone] >= 0:
                found[self.parents[bone]] |= found[bone]
        return found


def attached(motions: Float, joints: Joints) -> Float:
    """Return transposed motions ``(B, 4, 3T)``, translated to connect joints that do not slide."""
    result = motions.copy()
    for bone, parent in enumerate(joints.parents.tolist()):
        if not joints.sliding[bone]:
            pivot = joints.pivots[bone]
            result[bone, 3] = pivot @ (result[parent, :3] - result[bone, :3]) + result[parent, 3]
    return result


def move(
    tracks: Float, binding: Binding, motions: Float, joints: Joints, fit_pivots: bool = True
) -> tuple[Float, Joints]:
    """Fit the motions of bones, and their joints: tracks ``(V, 3T)``; motions ``(B, 4, 3T)``; result ``(B, 4, 3T)``."""
    used = np.isin(np.arange(len(motions)), binding.influences[binding.weights > 0])
    # Bones with parents that move no vertex, directly or by a bone below.
    idle = np.flatnonzero(~(joints.below() & used).any(axis=1) & (joints.parents >= 0))
    stiffness = 0.0 if fit_pivots else _STIFFNESS
    fit = _Fit(tracks, binding, attached(_following(motions, joints, idle), joints), joints, stiffness)
    for _ in range(SWEEPS):
        for bone in range(len(motions)):
            fit.turn(bone)
            if joints.sliding[bone]:
                fit.slide(bone)
        if fit_pivots:
            for bone in np.flatnonzero(~joints.sliding).tolist():
                fit.shift_joint(bone)
    fitted = replace(joints, pivots=fit.pivots)
    return attached(_following(fit.motions, joints, idle), fitted), fitted


def _following(motions: Float, joints: Joints, idle: Index) -> Float:
    """Return motions with those of idle bones replaced by those of the bones above."""
    result = motions.copy()
    for bone in idle.tolist():
        result[bone] = result[joints.parents[bone]]
    return result


class _Fit:
    """State of the coordinate descent: motions, joints, and E."""

    def __init__(
        self, tracks: Float, binding: Binding, motions: Float, joints: Joints, stiffness: float
    ) -> None:
        bones = len(motions)
        rows = binding.matrix(bones)
        self.products = np.asarray((rows.T @ rows).todense())
        self.motions, self.pivots = motions.copy(), joints.pivots.copy()
        self.left = np.asarray(rows.T @ tracks) - self.products @ self.motions.reshape(4 * bones, -1)
        self.parents, self.sliding, self.below = joints.parents, joints.sliding, joints.below()
        self.stiffness = stiffness

    def turn(self, bone: int) -> None:
        """Fit the rotations of a bone, which carry all below it."""
        bones = len(self.motions)
        arms = np.zeros((3, bones, 4))
        arms[:, bone, :3], arms[:, bone, 3] = np.eye(3), -self.pivots[bone]
        for child in np.flatnonzero(self.parents == bone).tolist():
            arms[:, self.below[child], 3] += (self.pivots[child] - self.pivots[bone])[:, None]
        lever = arms.reshape(3, -1)  # U
        if self.sliding[bone]:
            lever -= self._middle(bone, lever)[:, None] * self._all_below(bone)
        pulled = self.products @ lever.T
        spread = lever @ pulled
        size = float(np.trace(spread))
        if size <= _ROTATION_STIFFNESS**2:
            return
        before = self.motions[bone, :3]
        seen = (lever @ self.left + spread @ before).reshape(3, -1, 3).transpose(1, 2, 0)
        above = self.motions[self.parents[bone], :3] if self.parents[bone] >= 0 else before
        held = _ROTATION_STIFFNESS * size * before + self.stiffness * above
        turns = seen + held.reshape(3, -1, 3).transpose(1, 2, 0)
        after = aligning_rotations(turns).transpose(2, 0, 1).reshape(3, -1)
        self._move(lever, pulled, after - before)

    def slide(self, bone: int) -> None:
        """Fit the translations of a bone, which carry all below it."""
        seen, weight = self.seen_below(bone)
        if weight > _ROTATION_STIFFNESS:
            lever = self._all_below(bone)
            self._move(lever[None], (self.products @ lever)[:, None], seen[None] / weight)

    def shift_joint(self, bone: int) -> None:
        """Fit the position of a joint, where its bone and the one above agree best."""
        seen, weight = self.seen_below(bone)
        # D, transposed.
        apart = (self.motions[self.parents[bone], :3] - self.motions[bone, :3]).reshape(3, -1, 3)
        normal = weight * (np.einsum("ati,bti->ab", apart, apart) + _JOINT_HELD * apart.shape[1] * np.eye(3))
        if weight <= _ROTATION_STIFFNESS:
            return
        step = np.linalg.solve(normal, np.einsum("ati,ti->a", apart, seen.reshape(-1, 3)))
        self.pivots[bone] += step
        lever = self._all_below(bone)
        self._move(lever[None], (self.products @ lever)[:, None], (step @ apart.reshape(3, -1))[None])

    def seen_below(self, bone: int) -> tuple[Float, float]:
        """Return the summed residual ``(3T,)`` of a bone and all below it, and its weight."""
        lever = self._all_below(bone)
        return lever @ self.left, float(lever @ self.products @ lever)

    def _middle(self, bone: int, lever: Float) -> Float:
        """Return sum h_v u_v / sum h_v^2 ``(3,)``, for the lever U of the rotations of a bone."""
        along = self.products @ self._all_below(bone)
        return lever @ along / max(float(self._all_below(bone) @ along), _ROTATION_STIFFNESS)

    def _all_below(self, bone: int) -> Float:
        lever = np.zeros((len(self.motions), 4))  # H
        lever[self.below[bone], 3] = 1.0
        return lever.reshape(-1)

    def _move(self, lever: Float, pulled: Float, change: Float) -> None:
        self.motions += (lever.T @ change).reshape(self.motions.shape)
        self.left -= pulled @ change


_PIVOT_DAMPING = 1e-2
_TOUCH = 0.02  # share of the lighter bone's own weight; chosen empirically
_FAR = 1.0  # separation of a joint without contact, in diagonals


def bone_tree(faces: Index, binding: Binding, motions: Float) -> tuple[Index, Joints]:
    """Find the tree of bones: faces ``(F, 3)``; motions ``(B, 4, 3T)``; result ``(B,)``."""
    bones, frames = len(motions), motions.shape[2] // 3
    weights = _weights(binding, bones)
    mass = np.asarray(weights.sum(axis=0), dtype=np.float64).reshape(-1)
    touch, middles = _contacts(faces, weights, binding.rest, mass)
    flat = motions.reshape(4 * bones, -1)
    products = (flat @ flat.T).reshape(bones, 4, bones, 4).swapaxes(1, 2)
    own = products[np.arange(bones), np.arange(bones)]
    apart = own[:, None] + own[None] - products - products.swapaxes(0, 1)  # S
    pivots = np.linalg.solve(
        apart[..., :3, :3] + _PIVOT_DAMPING * frames * np.eye(3),
        (_PIVOT_DAMPING * frames * middles - apart[..., :3, 3])[..., None],
    )[..., 0]
    whole = np.concatenate([pivots, np.ones((bones, bones, 1))], axis=2)
    gaps = np.sqrt(np.maximum(np.einsum("abi,abij,abj->ab", whole, apart, whole), 0) / frames)
    costs = np.triu(1 + gaps + _FAR * ~touch, 1)  # a sparse graph has no edges of zero cost
    tree = minimum_spanning_tree(costs)
    links = np.asarray((tree + tree.T).todense()) > 0
    order, parents = _from_root(links, mass)
    above = np.where(parents < 0, np.arange(bones), order[parents])
    places = pivots[order, above]
    places[0] = middles[order[0], order[0]]
    return order, Joints(parents, places, parents < 0)


def _weights(binding: Binding, bones: int) -> sparse.csr_array:
    vertices = np.repeat(np.arange(len(binding.rest)), binding.weights.shape[1])
    entries = (binding.weights.reshape(-1), (vertices, binding.influences.reshape(-1)))
    return sparse.csr_array(entries, shape=(len(binding.rest), bones))


def _contacts(faces: Index, weights: sparse.csr_array, rest: Float, mass: Float) -> tuple[Mask, Float]:
    """Return contacts ``(B, B)`` of bones, and their middles ``(B, B, 3)``; without contact, of the lighter bone."""
    corners = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = sparse.csr_array((np.ones(len(corners)), corners.T), (len(rest), len(rest)))
    near = weights + (edges + edges.T).minimum(1) @ weights  # a vertex touches its neighbours' bones
    shared = np.asarray((weights.T @ near).todense())
    middles = np.stack(
        [np.asarray((weights.T @ (near * rest[:, [axis]])).todense()) for axis in range(3)], axis=2
    )
    shared, middles = shared + shared.T, middles + middles.swapaxes(0, 1)
    own = np.diag(shared)
    touch = shared > _TOUCH * np.minimum(own[:, None], own[None])
    centres = np.asarray(weights.T @ rest) / mass[:, None]
    lighter = np.where((mass[:, None] < mass[None])[..., None], centres[:, None], centres[None])
    touching = (touch & ~np.eye(len(mass), dtype=bool))[..., None]
    return touch, np.where(touching, middles / np.maximum(shared, 1e-300)[..., None], lighter)


def _from_root(links: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], mass: Float) -> tuple[Index, Index]:
    """Return the bones, parents first, and the places of their parents in that order."""
    bones = len(mass)

    def walk(root: int) -> tuple[Index, Index]:
        order, above = breadth_first_order(sparse.csr_array(links), root, directed=False)
        place = np.empty(bones, dtype=np.int64)
        place[order] = np.arange(bones)
        above = above[order]
        return order.astype(np.int64), np.where(above < 0, -1, place[np.maximum(above, 0)]).astype(np.int64)

    def depth(root: int) -> float:
        order, parents = walk(root)
        depths = np.zeros(bones)
        for place, parent in enumerate(parents.tolist()):
            depths[place] = 0 if parent < 0 else depths[parent] + 1
        return float(depths @ mass[order])

    return walk(min(range(bones), key=depth))
