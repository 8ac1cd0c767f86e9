r"""Limbs: a part with all that hangs on it, and what it takes to move it in its joint.

The parts of a component are a tree by their boundaries: the root is the largest part, every other part hangs on its
*parent*, one boundary nearer to the root. The *stance* of a limb is how the part stands to its parent: a turn
:math:`\tau` from how it stands in the reference frame, and a gap g at the pivot, the middle of their boundary there,
which is p in either part's coordinates,

.. math:: R_i^T R_j = \bar Q \exp(\tau), \qquad R_j p_j + t_j = R_i (p_i + g) + t_i .

Another stance moves the part, from :math:`(R, t)` to :math:`(R', t')`, and the whole limb with it as one rigid body,
:math:`x \to R' R^T (x - t) + t'`. Turns are unwrapped along the knots of a placement, so whole turns count; quaternions
follow from turns, :math:`\exp(\tau') \exp(\tau)^{-1}`, so that their signs do not jump however far apart times are.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csgraph

from mixseq.arrays import Float, Mask
from mixseq.errors import SettingsError
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
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.mixed import AnchoredSpace

STRIPS = 4
"""Over so many edges the coordinates of a joint pass from one border of parts to another."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body and all parts that hang on it.

    Attributes
    ----------
    space : AnchoredSpace
        Tells of parts and where they meet.
    part, parent : int
        The part, and the one that it hangs on.
    parts : (p,) bool
        The part and what hangs on it.
    """

    space: AnchoredSpace
    part: int
    parent: int
    parts: Mask

    @cached_property
    def _pivots(self) -> tuple[Float, Float]:
        """The middle of the boundary ``(3,)``, seen from the centre of the parent and of the part."""
        pairs = self.space.neighbours.parts
        pair = [
            np.flatnonzero((pairs == ends).all(axis=1))[0]
            for ends in ((self.part, self.parent), (self.parent, self.part))
        ]
        return self.space.neighbours.pivots[pair[0]], self.space.neighbours.pivots[pair[1]]

    @cached_property
    def _rest(self) -> Float:
        """How the part is turned against its parent in the reference frame: a quaternion ``(4,)``."""
        rest = self.space.frames.rest.rotations[0]
        return product(inverse(rest[self.parent]), rest[self.part])

    def stance(self, placement: Curve, times: Float) -> Float:
        """Return turns and gaps ``(N, 6)`` of the limb in a placement at times ``(N,)``, turns unwrapped.

        The first knot of the placement has the shortest turn, whatever the times.
        """
        known, asked = np.unique(np.concatenate([placement.times, times]), return_inverse=True)
        poses = self.space.poses(placement(known))
        near, far = self._pivots
        rotations = rotations_of(poses.rotations)
        back = np.swapaxes(rotations[:, self.parent], -1, -2)
        turns = continuous_vectors(rotations_of(self._rest).T @ back @ rotations[:, self.part])
        pivots = rotations[:, self.part] @ far + poses.centres[:, self.part]
        gaps = turned(back, pivots - poses.centres[:, self.parent]) - near
        return np.concatenate([turns, gaps], axis=1)[asked[len(placement.times) :]]

    def moved(self, placement: Curve, times: Float, stance: Float) -> Float:
        """Return placements ``(N, P)`` at times ``(N,)`` with another stance ``(N, 6)`` of the limb."""
        before, poses = self.stance(placement, times), self.space.poses(placement(times))
        near, far = self._pivots
        base = product(normalised(poses.rotations[:, self.parent]), self._rest)
        change = product(exponentials(stance[:, :3]), inverse(exponentials(before[:, :3])))
        turn = product(product(base, change), inverse(base))
        rotations, centres = poses.rotations.copy(), poses.centres.copy()
        rotations[:, self.parts] = product(turn[:, None], rotations[:, self.parts])
        parent, part = (rotations_of(rotations[:, which]) for which in (self.parent, self.part))
        place = turned(parent, near + stance[:, 3:]) + centres[:, self.parent] - part @ far
        away = centres[:, self.parts] - centres[:, [self.part]]
        centres[:, self.parts] = turned(rotations_of(turn)[:, None], away) + place[:, None]
        return self.space.placements(Poses(rotations, centres))

    def joint(self) -> Float:
        """Return how much ``(S,)`` coordinates of key shapes belong to the joints between limb and body.

        1 for what is near the border of the limb, 0 near other borders of parts, and in between where a joint is that
        of several borders. 0 for vertices that follow one part alone.
        """
        space, topology = self.space, self.space.topology
        sides = space.decomposition.part_of_face[topology.hinge_faces]
        ours = self.parts[sides[:, 0]] != self.parts[sides[:, 1]]
        others = (sides[:, 0] != sides[:, 1]) & ~ours
        own, other = self._away(ours), self._away(others)
        closer = np.where(np.isfinite(own), other, 0.0) - np.where(np.isfinite(own), own, np.inf)
        near = np.clip(0.5 + closer / STRIPS, 0.0, 1.0)
        along = near[topology.edges].mean(axis=1)
        vertices = np.where(space.frames.alone >= 0, 0.0, near)
        faces = near[space.seams.faces].mean(axis=1)
        hinges = topology.hinge_edges[space.hinge_ids]
        return np.concatenate(
            [along[space.edge_ids], along[hinges], np.repeat(vertices, 3), np.repeat(faces, 6)]
        )

    def own_shape(self) -> Float:
        """Return 1 for the coordinates ``(S,)`` of key shapes that follow the part alone, 0 elsewhere."""
        before, after = sum(self.space.sizes[:2]), self.space.sizes[3]
        own = np.repeat(self.space.frames.alone == self.part, 3).astype(np.float64)
        return np.pad(own, (before, after))

    def _away(self, hinges: Mask) -> Float:
        """How many edges all vertices ``(V,)`` are away from hinges."""
        topology = self.space.topology
        start = np.unique(topology.edges[topology.hinge_edges[hinges]])
        if not len(start):
            return np.full(topology.vertex_count, np.inf)
        graph = topology.vertex_adjacency
        return np.asarray(csgraph.dijkstra(graph, indices=start, unweighted=True, min_only=True))


def limb_of(model: Model, part: int) -> Limb:
    """Return the limb of a part.

    Raises
    ------
    SettingsError
        If the parts of the model have no poses of their own, the part is none of them, or hangs on no other.
    """
    space, count = model.space.anchored(), len(model.decomposition.parts)
    if not 0 <= part < count:
        raise SettingsError(f"there is no part {part}; the model has {count}, from 0 on")
    above = space.parents
    parent = int(above[part])
    if parent < 0:
        linked = bool((space.neighbours.parts == part).any())
        why = "is the root, which others hang on" if linked else "has no neighbours"
        raise SettingsError(f"part {part} {why}; give a part that hangs on another one")
    parts = np.zeros(count, dtype=bool)
    parts[part] = True
    for _ in range(count):
        parts |= (above >= 0) & parts[above]
    return Limb(space, part, parent, parts)
