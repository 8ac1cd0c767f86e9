r"""How all parts of a mesh hang together, and where they go if they move in their joints in another way.

The parts of a component are a tree by their boundaries (`ShapeSpace.parents`). Components, such as eyes, shoes and
swords, hang on each other where they are nearest (`mixseq.retargeting.attachments`). Any part can be the root of all;
the one as seen from which the others move least is the trunk of a body, though its head may be larger.

Two parts i and j meet in a pivot, p as seen from either. In a component it is the middle of their boundary. Between
components it is the point that is most nearly the same on both in all frames,

.. math::

    \min_{p_i, p_j} \sum_t |R_i p_i + t_i - R_j p_j - t_j|^2
    + \lambda T\, (|p_i - \bar p_i|^2 + |p_j - \bar p_j|^2) ,

where the motion tells, and else next to :math:`\bar p`, where they are nearest. The *stance* of a part is that of
`mixseq.operations.limb_joints`: a turn :math:`\tau` from how it stands to its parent at rest, and a gap at the pivot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from mixseq.arrays import Float, Index
from mixseq.geometry.rotations import (
    continuous_vectors,
    exponentials,
    inverse,
    normalised,
    product,
    rotations_of,
    turned,
)
from mixseq.prediction.poses import Poses
from mixseq.retargeting.attachments import Attachments, attach
from mixseq.spaces.mixed import AnchoredSpace

NEAREST = 1e-3
r"""Weight :math:`\lambda` of where components are nearest; turns by 0.03 radians tell as much. Ours."""


@dataclass(frozen=True, eq=False)
class JointTree:
    """What every one of p parts hangs on, and where.

    Attributes
    ----------
    parts, parents : (n,) int64
        All parts but the root, each after what it hangs on; and what that is.
    near, far : (n, 3) float64
        The pivot, as seen from the centres of parent and part, in diagonals.
    rest : (n, 4) float64
        How the part is turned against its parent in the reference frame, a quaternion.
    """

    parts: Index
    parents: Index
    near: Float
    far: Float
    rest: Float

    @classmethod
    def of(cls, space: AnchoredSpace, poses: Poses) -> JointTree:
        """Find how the parts of a space hang together in a motion, poses ``(T, p)``."""
        inside, outside = _boundaries(space), _attachments(space, poses)
        pairs, pivots = (np.concatenate(blocks) for blocks in zip(inside, outside, strict=True))
        count = len(pairs) + 1
        joints = sparse.coo_array(
            (np.arange(1, count), (pairs[:, 0], pairs[:, 1])), shape=(count, count)
        ).tocsr()
        order, above = csgraph.breadth_first_order(joints, _quietest(space, poses), directed=False)
        parts, parents = order[1:].astype(np.int64), above[order[1:]].astype(np.int64)
        joint = np.asarray((joints + joints.T)[parts, parents]).reshape(-1) - 1
        own = np.where(pairs[joint, 1] == parts, 1, 0)
        near, far = pivots[joint, 1 - own], pivots[joint, own]
        rest = space.frames.rest.rotations[0]
        return cls(parts, parents, near, far, product(inverse(rest[parents]), rest[parts]))

    def stances(self, poses: Poses) -> Float:
        """Return turns and gaps ``(T, n, 6)`` in poses at increasing times, turns unwrapped from the first on."""
        rotations = rotations_of(poses.rotations)
        back = np.swapaxes(rotations[:, self.parents], -1, -2)
        turns = continuous_vectors(
            np.swapaxes(rotations_of(self.rest), -1, -2) @ back @ rotations[:, self.parts]
        )
        pivots = turned(rotations[:, self.parts], self.far) + poses.centres[:, self.parts]
        gaps = turned(back, pivots - poses.centres[:, self.parents]) - self.near
        return np.concatenate([turns, gaps], axis=2)

    def moved(self, poses: Poses, before: Float, after: Float) -> Poses:
        """Return poses with other stances ``(T, n, 6)`` than before; the root stays where it is."""
        rotations, centres = normalised(poses.rotations), poses.centres.copy()
        # Signs of quaternions stay: they say which way round parts go from one motion into another.
        expected = product(product(rotations[:, self.parents], self.rest), exponentials(before[..., :3]))
        signs = np.where(np.einsum("tni,tni->tn", expected, rotations[:, self.parts]) < 0, -1.0, 1.0)
        turns = signs[..., None] * product(self.rest, exponentials(after[..., :3]))
        for number, (part, parent) in enumerate(zip(self.parts, self.parents, strict=True)):
            rotations[:, part] = product(rotations[:, parent], turns[:, number])
            base, own = (rotations_of(rotations[:, which]) for which in (parent, part))
            pivots = turned(base, self.near[number] + after[:, number, 3:]) + centres[:, parent]
            centres[:, part] = pivots - own @ self.far[number]
        return Poses(rotations, centres)


def _quietest(space: AnchoredSpace, poses: Poses) -> int:
    """Return the part as seen from which the centres of all others move least, weighed by their areas."""
    weights, spreads = np.square(space.radii), np.empty(space.rotation_count)
    back = np.swapaxes(rotations_of(poses.rotations), -1, -2)
    for part in range(len(spreads)):
        seen = turned(back[:, [part]], poses.centres - poses.centres[:, [part]])
        spreads[part] = weights @ seen.var(axis=0).sum(axis=1)
    return int(spreads.argmin())


def _boundaries(space: AnchoredSpace) -> tuple[Index, Float]:
    """Return the pairs of parts ``(n, 2)`` that make trees of components, and their pivots as seen from both."""
    neighbours, below = space.neighbours, np.flatnonzero(space.parents >= 0)
    pairs = np.stack([space.parents[below], below], axis=1)
    seen = dict(zip(map(tuple, neighbours.parts.tolist()), neighbours.pivots, strict=True))
    pivots = [(seen[j, i], seen[i, j]) for i, j in pairs.tolist()]
    return pairs, np.array(pivots).reshape(-1, 2, 3)


def _attachments(space: AnchoredSpace, poses: Poses) -> tuple[Index, Float]:
    """Return the pairs of parts ``(n, 2)`` that hold components together, and their pivots as seen from both."""
    held, part_of_vertex = _held(space), np.zeros(len(space.reference), dtype=np.int64)
    part_of_vertex[space.topology.faces] = space.decomposition.part_of_face[:, None]
    pairs = part_of_vertex[np.stack([held.other, held.own], axis=1)]
    middles = (space.reference[held.own] + space.reference[held.other]) / 2
    rest = space.frames.rest
    back = np.swapaxes(rotations_of(rest.rotations[0])[pairs], -1, -2)
    nearest = turned(back, middles[:, None] - rest.centres[0][pairs])
    pivots = [_pivot(poses, pair, guess) for pair, guess in zip(pairs, nearest, strict=True)]
    return pairs, np.array(pivots).reshape(-1, 2, 3)


def _held(space: AnchoredSpace) -> Attachments:
    """Return where components hold each other at rest."""
    parts, bodies = space.decomposition.parts, space.bodies
    members = [np.flatnonzero(bodies == body) for body in np.unique(bodies)]
    pieces = [np.unique(np.concatenate([parts[part] for part in some])) for some in members]
    return attach(pieces, space.reference, np.arange(len(space.reference)))


def _pivot(poses: Poses, pair: Index, guess: Float) -> Float:
    """Return the pivot of two parts as seen from both ``(2, 3)``, next to a guess where the motion does not tell."""
    first, second = np.moveaxis(rotations_of(poses.rotations[:, pair]), 1, 0)
    rows = np.concatenate([first, -second], axis=2)
    apart = poses.centres[:, pair[1]] - poses.centres[:, pair[0]] - rows @ guess.reshape(-1)
    matrix = np.einsum("tri,trj->ij", rows, rows) + NEAREST * len(rows) * np.eye(6)
    return guess + np.linalg.solve(matrix, np.einsum("tri,tr->i", rows, apart)).reshape(2, 3)
