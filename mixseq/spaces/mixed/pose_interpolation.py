r"""Interpolation of part poses in time: in the axes of a root part, by relations to neighbours, and in world axes.

Rotations are chained and centres are weighted sums (`mixseq.spaces.temporal`). The shape of a body follows from part
poses in the axes of its root and from relations to neighbours, and is invariant to rotations of the body. With the
matrix :math:`X = (R^T; t)` of four rows for a pose, and relations :math:`X_j = G_{ij} X_i` to neighbours, the
interpolated poses minimise

.. math:: \sum_i |X_i - \hat X_i|^2_{P_i} + \lambda \sum_{ij} |X_j - \hat G_{ij} X_i|^2_{P_{ij}} ,

where :math:`\hat X_i` is interpolated in root axes. The minimum solves a linear system; polar decomposition then
projects matrices to rotations. The root axes (Q, C) are placed by part poses :math:`\hat Y_i` interpolated in world
axes, where standing feet are at rest:

.. math:: \min_{Q, C} \sum_i |X_i Q^T + (0; C^T) - \hat Y_i|^2_{P'_i} .

Every precision P is the inverse of a 4 x 4 covariance of the errors :math:`\delta` of leave-one-out cross-validation
over F frames,

.. math:: P = \Bigl(\frac{\sum \delta \delta^T + n\, S}{3 F + n} + \varepsilon^2\Bigr)^{-1} ,

with an isotropic prior S of the same mean squares, because few frames leave the covariance underdetermined. The root of
a body is the large part in whose axes these errors are least.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.rotations import align_quat_signs, matrix_to_quat, quat_to_matrix, rotate_vectors
from mixseq.spaces.mixed.articulation import Articulation
from mixseq.spaces.temporal import FrameWeights, Poses, TemporalOperator, chain_rotations, interpolate_poses
from mixseq.types import Float, Index, Mask

RELATION_WEIGHT = 2.0
r"""Weight :math:`\lambda` of a relation relative to a pose, chosen empirically on half of the benchmark animations."""

MAX_ROOT_CANDIDATES = 4  # number of parts with the largest areas, in every body, from which the root is selected
PRIOR_SAMPLES = 6.0  # number n of error samples to which the isotropic prior is equivalent

POSE_ERROR_FLOOR = 1e-3
r"""Error :math:`\varepsilon` added to all covariances, in diagonals."""

TIMES_PER_BLOCK = 64  # number of times whose systems are solved together


@dataclass(frozen=True, eq=False)
class PoseInterpolation:
    """Interpolation in time of the poses of all parts of a sequence."""

    articulation: Articulation  # bodies and relations of the parts
    operator: TemporalOperator  # weights of the frames
    poses: Poses  # (T, p) part poses at the frames in world axes, rotations since the reference frame

    def at(self, times: Float) -> tuple[Poses, Poses]:
        """Return body poses ``(N, B)`` and part poses in body axes ``(N, p)`` at times ``(N,)``; exact at frames."""
        weights = self.operator.weights_at(times)
        bodies, parts = (interpolate_poses(weights, poses) for poses in self._split(self.poses))
        if len(self.operator.times) < 3 or not len(self._left_out[0]):
            return bodies, parts
        is_frame = np.isin(times, self.operator.times)[:, None, None]
        new_bodies, new_parts = self.interpolate(weights)
        return _keep_frames(bodies, new_bodies, is_frame), _keep_frames(parts, new_parts, is_frame)

    def interpolate(self, weights: FrameWeights) -> tuple[Poses, Poses]:
        """Return body poses and part poses in body axes by weights of frames; quaternions have any sign."""
        starts = range(0, len(weights.frame_ids), TIMES_PER_BLOCK)
        blocks = [self._interpolate_block(weights.select(slice(k, k + TIMES_PER_BLOCK))) for k in starts]
        return self._split(Poses(*(np.concatenate(arrays) for arrays in zip(*blocks, strict=True))))

    def _split(self, world: Poses) -> tuple[Poses, Poses]:
        """Split part poses in world axes into body poses and part poses in body axes, with continuous signs."""
        bodies = self.articulation.fit_bodies(world)
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations))
        parts = self.articulation.to_body_axes(world, bodies)
        return bodies, parts._replace(rotations=align_quat_signs(parts.rotations))

    def _interpolate_block(self, weights: FrameWeights) -> Poses:
        """Return part poses ``(N, p)`` in world axes."""
        in_root_axes, root_precisions = self._root_axes
        parts, pairs = interpolate_poses(weights, in_root_axes), self.articulation.pairs
        if len(pairs):
            relations = _interpolate_relations(weights, self._frame_relations, self.articulation.pivots)
            relation_precisions = RELATION_WEIGHT * self._relation_precisions
            parts = _fuse(_pose_matrices(parts), root_precisions, relations, relation_precisions, pairs)
        return self._place(parts, interpolate_poses(weights, self.poses))

    def _place(self, parts: Poses, world: Poses) -> Poses:
        """Move parts ``(N, p)`` of each body rigidly to the poses in world axes; return poses in world axes."""
        sums, body = self.articulation.body_sums, self.articulation.body_of_part
        precisions, x, y = self._world_precisions, _pose_matrices(parts), _pose_matrices(world)
        offset = np.broadcast_to(np.eye(4)[:, 3:], (*x.shape[:2], 4, 1))
        with_offset = np.concatenate([x, offset], axis=3)
        weighted = np.swapaxes(with_offset, 2, 3) @ precisions
        solution = np.linalg.solve(sums(weighted @ with_offset), sums(weighted @ y))
        rotations = nearest_rotations(np.swapaxes(solution[:, :, :3], 2, 3))
        residuals = y - x @ np.swapaxes(rotations, 2, 3)[:, body]
        centres = sums(precisions[:, 3:] @ residuals) / sums(precisions[None, :, 3:, 3:])
        return self.articulation.to_world_axes(parts, Poses(matrix_to_quat(rotations), centres[:, :, 0]))

    @cached_property
    def _left_out(self) -> tuple[Index, FrameWeights]:
        return self.operator.leave_one_out()

    @cached_property
    def _world_precisions(self) -> Float:
        """Precisions ``(p, 4, 4)`` of part poses in world axes."""
        return _error_precisions(self._left_out_errors(self.poses), self.articulation.radii)

    @cached_property
    def _root_axes(self) -> tuple[Poses, Float]:
        """Part poses ``(T, p)`` in the axes of the root of their body, and their precisions ``(p, 4, 4)``."""
        poses = self._in_axes_of(self._roots)
        return poses, _error_precisions(self._left_out_errors(poses), self.articulation.radii)

    @cached_property
    def _roots(self) -> Index:
        """Roots ``(B,)`` of the bodies."""
        masses, radii = self.articulation.masses, self.articulation.radii
        row_masses = masses[:, None] * np.append(np.square([radii] * 3), np.ones((1, len(radii))), axis=0).T
        parts = np.argsort(-self.articulation.areas, kind="stable")
        members = [parts[self.articulation.body_of_part[parts] == body] for body in range(self.articulation.body_count)]
        roots, least = np.zeros(len(members), dtype=np.int64), np.full(len(members), np.inf)
        for rank in range(min(MAX_ROOT_CANDIDATES, max(map(len, members)))):
            candidates = np.array([ids[min(rank, len(ids) - 1)] for ids in members])
            errors = self._left_out_errors(self._in_axes_of(candidates))
            squares = self.articulation.body_sums(np.einsum("fpac,pa->p", np.square(errors), row_masses)[None])[0]
            roots, least = np.where(squares < least, candidates, roots), np.minimum(squares, least)
        return roots

    def _in_axes_of(self, roots: Index) -> Poses:
        """Return part poses ``(T, p)`` at the frames in the axes of the roots ``(B,)`` of their bodies."""
        poses = self.articulation.to_body_axes(self.poses, Poses(*(block[:, roots] for block in self.poses)))
        return poses._replace(rotations=align_quat_signs(poses.rotations))

    def _left_out_errors(self, poses: Poses) -> Float:
        """Return the errors ``(F, p, 4, 3)`` of left-out frames of poses ``(T, p)``."""
        frame_ids, weights = self._left_out
        return _pose_matrices(interpolate_poses(weights, poses)) - _pose_matrices(poses)[frame_ids]

    @cached_property
    def _frame_relations(self) -> Poses:
        """Relations at the frames ``(T, n)``: rotations, and positions of pivots."""
        poses = self.articulation.add_relations(self.poses)
        return Poses(align_quat_signs(poses.relation_rotations), poses.relation_points)

    @cached_property
    def _relation_precisions(self) -> Float:
        """Precisions ``(n, 4, 4)`` of relations."""
        (frame_ids, weights), count = self._left_out, len(self.poses.centres)
        identity = FrameWeights(np.arange(count)[:, None], np.ones((count, 1)), count)
        relations, pivots = self._frame_relations, self.articulation.pivots
        actual, expected = (_interpolate_relations(each, relations, pivots) for each in (weights, identity))
        radii = self.articulation.radii[self.articulation.pairs[:, 1]]
        return _error_precisions((actual - expected[frame_ids])[..., :3], radii)


def _keep_frames(frames: Poses, poses: Poses, is_frame: Mask) -> Poses:
    """Return poses with aligned signs, replaced by the poses of frames where `is_frame` ``(N, 1, 1)``."""
    rotations = align_quat_signs(poses.rotations, frames.rotations[0])
    centres = np.where(is_frame, frames.centres, poses.centres)
    return Poses(np.where(is_frame, frames.rotations, rotations), centres)


def _interpolate_relations(weights: FrameWeights, relations: Poses, pivots: Float) -> Float:
    """Return the matrices G ``(N, n, 4, 4)`` of relations interpolated in time."""
    rotations = quat_to_matrix(chain_rotations(weights, relations.rotations))
    result = np.zeros((*rotations.shape[:2], 4, 4))
    result[..., :3, :3] = np.swapaxes(rotations, -1, -2)
    result[..., 3, :3] = weights.interpolate(relations.centres) - rotate_vectors(rotations, pivots)
    result[..., 3, 3] = 1.0
    return result


def _error_precisions(errors: Float, radii: Float) -> Float:
    """Return precisions ``(n, 4, 4)`` from errors ``(F, n, 4, 3)`` of poses of parts with radii ``(n,)``."""
    lengths = np.concatenate([np.repeat(radii[:, None], 3, axis=1), np.ones((len(radii), 1))], axis=1)
    errors = errors * lengths[:, :, None]
    squares = np.einsum("fnac,fnbc->nab", errors, errors)
    count = 3 * len(errors)
    rotation_squares = np.trace(squares[:, :3, :3], axis1=1, axis2=2) / 3.0
    prior = np.concatenate([np.repeat(rotation_squares[:, None], 3, axis=1), squares[:, 3:, 3]], axis=1)
    prior /= count
    covariance = squares + PRIOR_SAMPLES * prior[:, :, None] * np.eye(4)
    inverted = np.linalg.inv(covariance / (count + PRIOR_SAMPLES) + POSE_ERROR_FLOOR**2 / 3.0 * np.eye(4))
    return np.asarray(inverted * lengths[:, :, None] * lengths[:, None, :])


def _fuse(estimates: Float, precisions: Float, relations: Float, relation_precisions: Float, pairs: Index) -> Poses:
    """Return the poses ``(N, p)`` that fit estimates ``(N, p, 4, 3)`` and relations ``(N, n, 4, 4)`` best."""
    count, size = estimates.shape[:2]
    i, j = pairs.T
    forward = relation_precisions @ relations  # (N, n, 4, 4)
    backward = np.swapaxes(forward, -1, -2)
    gain = np.swapaxes(relations, -1, -2) @ forward
    residuals = estimates[:, j] - relations @ estimates[:, i]
    system, right = np.zeros((count, size, 4, size, 4)), np.zeros((count, size, 4, 3))
    for part in range(size):
        system[:, part, :, part] = precisions[part]
    for relation, (first, second) in enumerate(pairs):
        system[:, second, :, second] += relation_precisions[relation]
        system[:, first, :, first] += gain[:, relation]
        system[:, second, :, first] -= forward[:, relation]
        system[:, first, :, second] -= backward[:, relation]
        right[:, second] -= relation_precisions[relation] @ residuals[:, relation]
        right[:, first] += backward[:, relation] @ residuals[:, relation]
    change = np.linalg.solve(system.reshape(count, 4 * size, 4 * size), right.reshape(count, 4 * size, 3))
    fitted = estimates + change.reshape(count, size, 4, 3)
    return Poses(matrix_to_quat(nearest_rotations(np.swapaxes(fitted[:, :, :3], -1, -2))), fitted[:, :, 3])


def _pose_matrices(poses: Poses) -> Float:
    """Return poses as matrices X ``(T, p, 4, 3)``."""
    rotations = np.swapaxes(quat_to_matrix(poses.rotations), -1, -2)
    return np.concatenate([rotations, poses.centres[:, :, None]], axis=2)
