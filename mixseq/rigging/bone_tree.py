r"""The tree of bones, from their contacts and motions.

*The joint of two bones.* Of points p of the rest shape, the one that both move most alike minimises

.. math:: \sum_t |M_{ta} \tilde p - M_{tb} \tilde p|^2 + \mu T\, |p - p_0|^2 = \tilde p^T S_{ab}\, \tilde p + \dots,
          \quad S_{ab} = \sum_t (M_{ta} - M_{tb})^T (M_{ta} - M_{tb}),

with :math:`\mu = 0.01` (chosen empirically): a joint that never turns stays at :math:`p_0`, the middle of the contact,
and a hinge stays next to it on its axis. The minimum, :math:`g_{ab}`, is the separation of the joint (root mean
square).

*The tree* joins all bones by the pairs of least separation; pairs without contact are only used to connect components
of the mesh. Its root is the bone with the fewest joints to the others, weighted by their vertices: the trunk of an
animal.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

from mixseq.arrays import Float, Index
from mixseq.rigging.jointed_motions import Joints
from mixseq.rigging.weights import Binding

_HELD = 1e-2
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
        apart[..., :3, :3] + _HELD * frames * np.eye(3),
        (_HELD * frames * middles - apart[..., :3, 3])[..., None],
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


def _contacts(
    faces: Index, weights: sparse.csr_array, rest: Float, mass: Float
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.bool_]], Float]:
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
