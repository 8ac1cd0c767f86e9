r"""Exaggerate, damp or hold the motion of one limb, a part with all parts below it in the tree of parts.

The parts of a component form a tree by their boundaries: the root is the largest part, and the *parent* of every other
part is its neighbour next to the root. The *joint pose* of a limb is the pose of its part i relative to the parent j:
a rotation vector :math:`\tau` since the reference frame, and a gap g at the pivot. The pivot is the middle of their
boundary in the reference frame, at the offsets :math:`p_i` and :math:`p_j` from the centres of the parts,

.. math:: R_i^T R_j = \exp(\tau), \qquad R_j p_j + t_j = R_i (p_i + g) + t_i ,

for poses relative to the body and rotations since the reference frame. The joint pose has six coordinates. Rotation
vectors are unwrapped along the knots of a model, so whole turns count. Edits change joint poses by one of

.. math::

    \tau' = \bar\tau + \text{gain}\, (\tau - \bar\tau), \qquad
    \tau' = \tau + w(t)\, (\tau(t_0) - \tau).

A changed joint pose moves the part from :math:`(R, t)` to :math:`(R', t')`, and the whole limb as one rigid body,
:math:`x \to R' R^T (x - t) + t'`. Quaternions change by the factor :math:`\exp(\tau') \exp(\tau)^{-1}`, whose sign is
continuous in time at any sampling distance. The change of poses is stored in the model's correction.

Between limb and body, the skin follows the poses of both. The remaining shape change in the joint is edited by the same
formulas. The edited signals are approximated by cubic splines with adaptive sites.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csgraph

from mixseq.errors import SettingsError
from mixseq.mesh.rotations import (
    continuous_rotvec,
    normalise_quat,
    quat_conjugate,
    quat_multiply,
    quat_to_matrix,
    rotate_vectors,
    rotvec_to_quat,
    unwrap_rotvec,
)
from mixseq.operations.filters import check_gain
from mixseq.operations.sections import (
    KeyWeights,
    add_key_shapes,
    blend_key_poses,
    correction_norm,
    interpolate_adaptively,
    model_sites,
    shape_norm,
    snap_time,
    splice,
    subdivide,
)
from mixseq.runtime.public import public
from mixseq.sequence.frame_rates import Seconds
from mixseq.signals.bodies import Body
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.spaces.mixed.mixed_space import MixedSpace, as_mixed
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Mask

JOINT_BLEND_WIDTH_EDGES = 4  # width, in edges, over which joint coordinates blend from one part boundary to another


@dataclass(frozen=True, eq=False)
class Limb:
    """A part of a body and all parts below it."""

    space: MixedSpace  # the space of the parts
    part: int  # root part of the limb
    parent: int  # neighbouring part of the body, to which the root part is joined
    part_mask: Mask  # (p,) the part and all parts below it

    @cached_property
    def _pivots(self) -> tuple[Float, Float]:
        """Middle of the boundary, relative to the centre of the parent ``(3,)`` and of the part ``(3,)``."""
        articulation = self.space.articulation
        from_parent, from_part = (
            articulation.pivots[np.flatnonzero((articulation.pairs == pair).all(axis=1))[0]]
            for pair in ((self.part, self.parent), (self.parent, self.part))
        )
        return from_parent, from_part

    def joint_pose(self, model: Model, times: Float) -> Float:
        """Return rotation vectors and gaps ``(N, 6)`` at times ``(N,)``, unwrapped from the shortest first rotation."""
        knots = np.concatenate([model.time.times, model.correction.times])
        all_times, ids = np.unique(np.concatenate([knots, times]), return_inverse=True)
        poses = part_poses(model, all_times)
        from_parent, from_part = self._pivots
        rotations = quat_to_matrix(poses.rotations)
        to_parent = np.swapaxes(rotations[:, self.parent], -1, -2)
        turns = continuous_rotvec(to_parent @ rotations[:, self.part])
        pivots = rotations[:, self.part] @ from_part + poses.centres[:, self.part]
        gaps = rotate_vectors(to_parent, pivots - poses.centres[:, self.parent]) - from_parent
        return np.concatenate([turns, gaps], axis=1)[ids[len(knots) :]]

    def corrections(self, model: Model, times: Float, joint_pose: Float) -> Float:
        """Return the corrections ``(N, C)`` at times ``(N,)`` that give the limb new joint poses ``(N, 6)``.

        Rotations are unwrapped in steps under half a turn, starting from the model's correction at the first time.
        """
        old_joint_pose, poses = self.joint_pose(model, times), part_poses(model, times)
        from_parent, from_part = self._pivots
        base = normalise_quat(poses.rotations[:, self.parent])
        old, new = (rotvec_to_quat(pose[:, :3]) for pose in (old_joint_pose, joint_pose))
        change = quat_multiply(new, quat_conjugate(old))
        turn = quat_multiply(quat_multiply(base, change), quat_conjugate(base))
        rotations, centres = poses.rotations.copy(), poses.centres.copy()
        rotations[:, self.part_mask] = quat_multiply(turn[:, None], rotations[:, self.part_mask])
        parent, part = (quat_to_matrix(rotations[:, number]) for number in (self.parent, self.part))
        pivot = rotate_vectors(parent, from_parent + joint_pose[:, 3:]) + centres[:, self.parent]
        centre = pivot - part @ from_part
        relative = centres[:, self.part_mask] - centres[:, [self.part]]
        centres[:, self.part_mask] = rotate_vectors(quat_to_matrix(turn)[:, None], relative) + centre[:, None]
        corrections = self.space.pose_corrections(blend_key_poses(model, times), Poses(rotations, centres))
        turns, reference = (
            array.reshape(len(array), 2, -1, 3)[:, 0] for array in (corrections, model.correction(times[:1]))
        )
        turns[:] = unwrap_rotvec(turns, reference[0])
        return corrections

    def joint_weights(self) -> Float:
        """Return weights ``(S,)`` of key shape coordinates in the joints between limb and body.

        Weights are 1 near the boundary of the limb and 0 near other boundaries, blended in joints of several
        boundaries. Vertices that follow a single part, or lie outside the limb, have the weight 0.
        """
        space, topology = self.space, self.space.topology
        sides = space.decomposition.part_of_face[topology.hinge_faces]
        limb_boundary = self.part_mask[sides[:, 0]] != self.part_mask[sides[:, 1]]
        other_boundary = (sides[:, 0] != sides[:, 1]) & ~limb_boundary
        to_limb, to_other = self._edge_distances(limb_boundary), self._edge_distances(other_boundary)
        is_reached = np.isfinite(to_limb)
        closer_by = np.where(is_reached, to_other, 0.0) - np.where(is_reached, to_limb, np.inf)
        weights = np.clip(0.5 + closer_by / JOINT_BLEND_WIDTH_EDGES, 0.0, 1.0)
        edges = weights[topology.edges].mean(axis=1)
        is_skinned = space.skinning_weights @ self.part_mask.astype(np.float64) > 0
        vertices = np.repeat(np.where(is_skinned & (space.rigid_part_of_vertex < 0), weights, 0.0), 3)
        hinges = edges[topology.hinge_edges[space.hinge_ids]]
        return np.concatenate([edges[space.edge_ids], hinges, vertices, np.zeros(space.pose_dim)])

    def part_weights(self) -> Float:
        """Return weights ``(S,)`` of key shape coordinates: 1 for vertices that follow only this part, else 0."""
        of_vertices = np.repeat(self.space.rigid_part_of_vertex == self.part, 3).astype(np.float64)
        return np.pad(of_vertices, (sum(self.space.block_sizes[:2]), self.space.pose_dim))

    def _edge_distances(self, hinge_mask: Mask) -> Float:
        """Return the distances ``(V,)`` of vertices from the masked hinges, in edges along the mesh."""
        topology = self.space.topology
        sources = np.unique(topology.edges[topology.hinge_edges[hinge_mask]])
        if not len(sources):
            return np.full(topology.vertex_count, np.inf)
        graph = topology.vertex_adjacency
        return np.asarray(csgraph.dijkstra(graph, indices=sources, unweighted=True, min_only=True))


def part_poses(model: Model, times: Float) -> Poses:
    """Return the poses ``(N, p)`` of all parts relative to their bodies, at times ``(N,)``."""
    return as_mixed(model.space).correct_poses(blend_key_poses(model, times), model.correction(times))


def find_limb(model: Model, part: int) -> Limb:
    """Return the limb of a part; raise SettingsError if the part does not exist or is a root."""
    space, count = as_mixed(model.space), len(model.decomposition.parts)
    if space.placement == "free":
        raise SettingsError("the free placement ignores poses of parts; fit with placement='anchored'")
    if not 0 <= part < count:
        raise SettingsError(f"there is no part {part}; the model has {count}, from 0 on")
    parents = space.articulation.parents
    parent = int(parents[part])
    if parent < 0:
        has_neighbours = bool((space.articulation.pairs == part).any())
        reason = "is the root of its body" if has_neighbours else "has no neighbours"
        raise SettingsError(f"part {part} {reason}; give a part with a parent")
    part_mask = np.zeros(count, dtype=bool)
    part_mask[part] = True
    for _ in range(count):
        part_mask |= (parents >= 0) & part_mask[parents]
    return Limb(space, part, parent, part_mask)


JointPoseEdit = Callable[[Float, Float], Float]
"""Function from times ``(N,)`` and joint poses ``(N, 6)`` to edited joint poses ``(N, 6)``."""

SIGNAL_TOLERANCE = 1e-5  # largest error of signals between sites, in diagonals
MIN_MODE_SIZE_RATIO = 1e-3  # smallest shape mode kept for a held part and its joints, as a fraction of the largest
MAX_TURN_STEP_RADIANS = 1.0  # largest rotation added to a part between two sites, small enough to resolve whole turns
DEFAULT_FADE_SECONDS = 0.2  # default duration over which a part comes to rest, and moves off again


@public
def exaggerate_part(model: Model, part: int, gain: float) -> Model:
    """Exaggerate or damp the motion of a part relative to its parent, about the mean joint pose.

    Parameters
    ----------
    model : Model
        A model in the mixed space with anchored parts.
    part : int
        Number of the part. The parts below it move along, as one rigid body.
    gain : float
        Factor: 1 changes nothing, 2 doubles the motion, 0 stops it, a negative gain reverses it.

    Raises
    ------
    SettingsError
        If the parts of the model have no separate poses, the part does not exist or has no parent, or the gain is out
        of range.
    """
    limb = find_limb(model, part)
    check_gain(gain)
    mean = limb.joint_pose(model, model.times).mean(axis=0)
    sites = model_sites(model, model.start, model.end)
    correction = _edit_joint(model, limb, sites, lambda _, joint_pose: mean + gain * (joint_pose - mean))
    bodies = tuple(
        body if follower is None else replace(body, shapes=_scale_joint_shapes(*follower, gain))
        for body, follower in _limbs_of_bodies(model, limb)
    )
    return model.edited(correction=correction, shapes=_scale_joint_shapes(model, limb, gain), bodies=bodies)


@public
def hold(
    model: Model, part: int, time: Seconds, start: Seconds, end: Seconds, fade: Seconds = DEFAULT_FADE_SECONDS
) -> Model:
    """Hold a part at rest relative to its parent, in its joint pose at a given time.

    Parameters
    ----------
    model : Model
        A model in the mixed space with anchored parts.
    part : int
        Number of the part. The parts below it move along, as one rigid body.
    time : float
        Time of the held pose, in seconds.
    start, end : float
        Interval in which the part is at rest, in seconds.
    fade : float
        Seconds before `start` in which the part comes to rest, and after `end` in which it moves off again.

    Raises
    ------
    SettingsError
        If the parts of the model have no separate poses, the part does not exist or has no parent, or a time is out
        of range.
    """
    limb = find_limb(model, part)
    time, start, end = snap_time(model, time), snap_time(model, start, "start"), snap_time(model, end, "end")
    if start > end:
        raise SettingsError(f"the start, {start:g} s, is after the end, {end:g} s")
    if not (np.isfinite(fade) and fade > 0):
        raise SettingsError(f"fade is {fade}; a positive number of seconds is expected")

    weights = KeyWeights(np.array([start]), start, end, fade, model)
    sites = weights.sites
    held = limb.joint_pose(model, np.array([time]))
    correction = _edit_joint(model, limb, sites, lambda times, pose: pose + weights.at(times) * (held - pose))
    extended, to_limb_modes = _add_limb_modes(model, limb)
    held_point = model.time([time])

    def held_signal(times: Float) -> Float:
        points = model.time(times)
        return np.concatenate([points, weights.at(times) * to_limb_modes(held_point - points)], axis=1)

    signal = interpolate_adaptively(held_signal, sites, SIGNAL_TOLERANCE, shape_norm(extended))
    return extended.edited(
        time=splice(extended, extended.time, signal), correction=splice(extended, model.correction, correction)
    )


def _edit_joint(model: Model, limb: Limb, sites: Float, edit: JointPoseEdit) -> Curve:
    """Return the correction curve of a model for an edited joint pose of a limb, from the first to the last site."""

    def correction(times: Float) -> Float:
        return limb.corrections(model, times, edit(times, limb.joint_pose(model, times)))

    joint_pose = limb.joint_pose(model, sites)
    turn_steps = np.diff(edit(sites, joint_pose)[:, :3] - joint_pose[:, :3], axis=0)
    count = 1 + int(np.abs(turn_steps).max(initial=0.0) / MAX_TURN_STEP_RADIANS)
    sites = subdivide(sites, count)
    return interpolate_adaptively(correction, sites, SIGNAL_TOLERANCE, correction_norm(model))


def _limbs_of_bodies(model: Model, limb: Limb) -> Iterator[tuple[Body, tuple[Model, Limb] | None]]:
    """Yield the further bodies of a model, with their own models and the same limb if they have it, else None."""
    for body in model.bodies:
        has_limb = body.part_turns is not None and as_mixed(body.space).articulation.parents[limb.part] == limb.parent
        follower = model.alone_as(body)
        yield body, (follower, find_limb(follower, limb.part)) if has_limb else None


def _scale_joint_shapes(model: Model, limb: Limb, gain: float) -> Float:
    """Return the key shapes ``(K, S)`` of a model with joint coordinates of the limb scaled about their mean."""
    weights = limb.joint_weights()
    columns = np.flatnonzero(weights)
    shapes = model.shapes.copy()
    mean = (model.pose.weights(model.time(model.times)) @ shapes[:, columns]).mean(axis=0)
    shapes[:, columns] += (gain - 1.0) * weights[columns] * (shapes[:, columns] - mean)
    return shapes


def _add_limb_modes(model: Model, limb: Limb) -> tuple[Model, Callable[[Float], Float]]:
    """Add pose coordinates for the part and its joints only; also return a map from time-signal steps to them."""
    weights, metric = limb.joint_weights() + limb.part_weights(), model.space.shape_weights
    columns = np.flatnonzero(weights * metric)
    jacobian = model.pose.matrix @ (model.shapes[:, columns] - model.shapes[0, columns])
    jacobian = jacobian * (weights * metric)[columns]
    frames = model.time(model.times)
    _, sizes, directions = np.linalg.svd((frames - frames.mean(axis=0)) @ jacobian, full_matrices=False)
    directions = directions[sizes > MIN_MODE_SIZE_RATIO * sizes.max(initial=0.0)]
    rank = len(directions)
    shapes = np.repeat(model.shapes[:1], rank, axis=0)
    shapes[:, columns] += directions / metric[columns]
    to_modes = jacobian @ directions.T
    bodies = []
    for body, follower in _limbs_of_bodies(model, limb):
        added = np.repeat(body.shapes[:1], rank, axis=0)
        if follower is not None:
            body_weights = (follower[1].joint_weights() + follower[1].part_weights()) * (body.space.shape_weights > 0)
            added += np.linalg.pinv(to_modes) @ (model.pose.matrix @ (body.shapes - body.shapes[0])) * body_weights
        bodies.append(replace(body, shapes=np.concatenate([body.shapes, added])))
    time = Curve(model.time.times, np.pad(model.time.values, ((0, 0), (0, rank))))
    return add_key_shapes(model, shapes, time, bodies=tuple(bodies)), lambda steps: np.asarray(steps @ to_modes)
