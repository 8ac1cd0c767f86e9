r"""Limbs: a part with all parts below it, and changes of its stance in its joint.

The parts of a component are a tree by their boundaries: the root is the largest part, every other part hangs on its
*parent*, one boundary nearer to the root. The *stance* of a limb is the pose of the part relative to its parent: a turn
:math:`\tau` since the reference frame, and a gap g at the pivot, the middle of their boundary there, which is p from
either part's centre,

.. math:: R_i^T R_j = \exp(\tau), \qquad R_j p_j + t_j = R_i (p_i + g) + t_i ,

for poses relative to the body, rotations since the reference frame.

A changed stance moves the part from :math:`(R, t)` to :math:`(R', t')`, and the whole limb with it as one rigid body,
:math:`x \to R' R^T (x - t) + t'`. Turns are unwrapped along the knots of a model, so whole turns count; quaternions
change by :math:`\exp(\tau') \exp(\tau)^{-1}`, with continuous signs for any distance of times. Poses are changed by the
model's correction.
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
    unwrap,
)
from mixseq.prediction.poses import Poses
from mixseq.signals.model import Model
from mixseq.spaces.mixed import MixedSpace, as_mixed

STRIPS = 4
"""Width, in edges, over which joint coordinates pass from one border of parts to another."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body and all parts below it."""

    space: MixedSpace  # the space of the parts
    part: int  # root part of the limb
    parent: int  # neighbouring part of the body, to which the root part is joined
    parts: Mask  # (p,) the part and all parts below it

    @cached_property
    def _pivots(self) -> tuple[Float, Float]:
        """Middle of the boundary ``(3,)``, from the centre of the parent and of the part."""
        articulation = self.space.articulation
        near, far = (
            articulation.pivots[np.flatnonzero((articulation.pairs == ends).all(axis=1))[0]]
            for ends in ((self.part, self.parent), (self.parent, self.part))
        )
        return near, far

    def stance(self, model: Model, times: Float) -> Float:
        """Return turns and gaps ``(N, 6)`` of the limb in a model at times ``(N,)``.

        Turns are unwrapped from the first frame, which has the shortest turn.
        """
        knots = np.concatenate([model.time.times, model.correction.times])
        known, asked = np.unique(np.concatenate([knots, times]), return_inverse=True)
        poses = part_poses(model, known)
        near, far = self._pivots
        rotations = rotations_of(poses.rotations)
        back = np.swapaxes(rotations[:, self.parent], -1, -2)
        turns = continuous_vectors(back @ rotations[:, self.part])
        pivots = rotations[:, self.part] @ far + poses.centres[:, self.part]
        gaps = turned(back, pivots - poses.centres[:, self.parent]) - near
        return np.concatenate([turns, gaps], axis=1)[asked[len(knots) :]]

    def corrections(self, model: Model, times: Float, stance: Float) -> Float:
        """Return the corrections ``(N, C)`` at times ``(N,)`` with another stance ``(N, 6)`` of the limb.

        Turns continue those of the model's correction at the first time, by less than half a turn from time to time.
        """
        before, poses = self.stance(model, times), part_poses(model, times)
        near, far = self._pivots
        base = normalised(poses.rotations[:, self.parent])
        change = product(exponentials(stance[:, :3]), inverse(exponentials(before[:, :3])))
        turn = product(product(base, change), inverse(base))
        rotations, centres = poses.rotations.copy(), poses.centres.copy()
        rotations[:, self.parts] = product(turn[:, None], rotations[:, self.parts])
        parent, part = (rotations_of(rotations[:, which]) for which in (self.parent, self.part))
        place = turned(parent, near + stance[:, 3:]) + centres[:, self.parent] - part @ far
        away = centres[:, self.parts] - centres[:, [self.part]]
        centres[:, self.parts] = turned(rotations_of(turn)[:, None], away) + place[:, None]
        targets = np.concatenate([each.reshape(len(times), -1) for each in (rotations, centres)], axis=1)
        corrections = self.space.corrections(_blended_poses(model, times), targets)
        spins, before = (
            each.reshape(len(each), 2, -1, 3)[:, 0] for each in (corrections, model.correction(times[:1]))
        )
        spins[:] = unwrap(spins, before[0])
        return corrections

    def joint(self) -> Float:
        """Return shares ``(S,)`` of key shape coordinates in the joints between limb and body.

        They are 1 near the border of the limb, 0 near other borders, and blended in joints of several borders; 0 for
        vertices that follow one part alone, or are outside the limb.
        """
        space, topology = self.space, self.space.topology
        sides = space.decomposition.part_of_face[topology.hinge_faces]
        ours = self.parts[sides[:, 0]] != self.parts[sides[:, 1]]
        others = (sides[:, 0] != sides[:, 1]) & ~ours
        own, other = self._away(ours), self._away(others)
        closer = np.where(np.isfinite(own), other, 0.0) - np.where(np.isfinite(own), own, np.inf)
        near = np.clip(0.5 + closer / STRIPS, 0.0, 1.0)
        along = near[topology.edges].mean(axis=1)
        follows = space.skinning_weights @ self.parts.astype(np.float64) > 0
        vertices = np.where(follows & (space.only_part < 0), near, 0.0)
        hinges = topology.hinge_edges[space.hinge_ids]
        return np.concatenate(
            [along[space.edge_ids], along[hinges], np.repeat(vertices, 3), np.zeros(space.pose_dim)]
        )

    def own_shape(self) -> Float:
        """Return 1 for the coordinates ``(S,)`` of key shapes that follow the part alone, 0 elsewhere."""
        own = np.repeat(self.space.only_part == self.part, 3).astype(np.float64)
        return np.pad(own, (sum(self.space.sizes[:2]), self.space.pose_dim))

    def _away(self, hinges: Mask) -> Float:
        """Return the distances ``(V,)`` of vertices from hinges, in edges."""
        topology = self.space.topology
        start = np.unique(topology.edges[topology.hinge_edges[hinges]])
        if not len(start):
            return np.full(topology.vertex_count, np.inf)
        graph = topology.vertex_adjacency
        return np.asarray(csgraph.dijkstra(graph, indices=start, unweighted=True, min_only=True))


def part_poses(model: Model, times: Float) -> Poses:
    """Return the poses ``(N, p)`` of all parts relative to their bodies, at times ``(N,)``."""
    return as_mixed(model.space).corrected_poses(_blended_poses(model, times), model.correction(times))


def _blended_poses(model: Model, times: Float) -> Float:
    """Return the pose columns ``(N, pose_dim)`` of blended shapes."""
    columns = model.shapes[:, model.space.shape_dim - model.space.pose_dim :]
    return np.asarray(model.pose.weights(model.time(times)) @ columns)


def limb_of(model: Model, part: int) -> Limb:
    """Return the limb of a part; SettingsError if it does not exist or has no parent."""
    space, count = as_mixed(model.space), len(model.decomposition.parts)
    if space.placement == "free":
        raise SettingsError(
            "the free placement ignores poses of parts; fit a model with placement='anchored'"
        )
    if not 0 <= part < count:
        raise SettingsError(f"there is no part {part}; the model has {count}, from 0 on")
    above = space.articulation.parents
    parent = int(above[part])
    if parent < 0:
        linked = bool((space.articulation.pairs == part).any())
        why = "is the root, which others hang on" if linked else "has no neighbours"
        raise SettingsError(f"part {part} {why}; give a part that hangs on another one")
    parts = np.zeros(count, dtype=bool)
    parts[part] = True
    for _ in range(count):
        parts |= (above >= 0) & parts[above]
    return Limb(space, part, parent, parts)
