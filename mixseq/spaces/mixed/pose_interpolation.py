r"""Interpolation of part poses in time: in world axes, in body axes, and by relations to neighbours.

Rotations are chained and centres are weighted sums (`mixseq.spaces.temporal`), in world axes, where standing feet are
at rest, and in body axes, where the rotation of the body is removed. Bodies are fitted to part poses interpolated in
world axes; relative to bodies, part poses are interpolated independently of body rotations. With the matrix
:math:`X = (R^T; t)` of four rows for a pose, and relations :math:`X_j = G_{ij} X_i` to neighbours, the interpolated
poses minimise

.. math:: \sum_i |X_i - \hat X_i|^2_{P_i} + \lambda \sum_{ij} |X_j - \hat G_{ij} X_i|^2_{P_{ij}} ,

where :math:`\hat X_i` is the mean of the estimates in world and body axes, weighted by their precisions. The minimum
solves a linear system; polar decomposition then projects matrices to rotations. Every precision P is the inverse of a 4
x 4 covariance of the errors :math:`\delta` of leave-one-out cross-validation over F frames,

.. math:: P = \Bigl(\frac{\sum \delta \delta^T + n\, S}{3 F + n} + \varepsilon^2\Bigr)^{-1} ,

with an isotropic prior S of the same mean squares, because few frames leave the covariance underdetermined.
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

MAX_WORLD_ERROR_RATIO = 2.0
"""Largest ratio of errors in world axes to errors in body axes; above it, only body axes are used."""

PRIOR_SAMPLES = 6.0
"""Number n of error samples to which the isotropic prior is equivalent."""

POSE_ERROR_FLOOR = 1e-3
r"""Error :math:`\varepsilon` added to all covariances, in diagonals."""

TIMES_PER_BLOCK = 64
"""Number of times whose systems are solved together."""


@dataclass(frozen=True, eq=False)
class PoseInterpolation:
    """Interpolation in time of the poses of all parts of a sequence."""

    articulation: Articulation  # bodies and relations of the parts
    operator: TemporalOperator  # weights of the frames
    poses: Poses  # (T, p) part poses at the frames in world axes, rotations since the reference frame
    in_body_axes: bool  # whether poses are interpolated in body axes in addition to world axes

    def at(self, times: Float) -> tuple[Poses, Poses]:
        """Return body poses ``(N, B)`` and part poses in body axes ``(N, p)`` at times ``(N,)``; exact at frames."""
        weights = self.operator.weights_at(times)
        bodies, parts = (interpolate_poses(weights, poses) for poses in self._frame_poses)
        if len(self.operator.times) < 3:
            return bodies, parts
        is_frame = np.isin(times, self.operator.times)[:, None, None]
        new_bodies, new_parts = self.interpolate(weights)
        return _keep_frames(bodies, new_bodies, is_frame), _keep_frames(parts, new_parts, is_frame)

    def interpolate(self, weights: FrameWeights) -> tuple[Poses, Poses]:
        """Return body poses and part poses in body axes by weights of frames; quaternions have any sign."""
        starts = range(0, len(weights.frame_ids), TIMES_PER_BLOCK)
        blocks = [self._interpolate_block(weights.select(slice(k, k + TIMES_PER_BLOCK))) for k in starts]
        bodies, parts = (
            Poses(*(np.concatenate(arrays) for arrays in zip(*poses, strict=True)))
            for poses in zip(*blocks, strict=True)
        )
        return bodies, parts

    def _interpolate_block(self, weights: FrameWeights) -> tuple[Poses, Poses]:
        bodies, from_world = self._interpolate_in_world(weights)
        world_precision, body_precision = self._precisions
        estimates = [] if world_precision is None else [(from_world, world_precision)]
        if body_precision is not None:
            estimates.append((interpolate_poses(weights, self._frame_poses[1]), body_precision))
        precision: Float = np.sum([each for _, each in estimates], axis=0)
        weighted = [each @ _pose_matrices(poses) for poses, each in estimates]
        mean = np.asarray(np.linalg.solve(precision, np.sum(weighted, axis=0)), dtype=np.float64)
        precision = precision / len(estimates)
        pairs = self.articulation.pairs
        if not len(pairs):
            return bodies, _nearest_poses(mean)
        relations = _interpolate_relations(weights, self._frame_relations, self.articulation.pivots)
        return bodies, _fuse(mean, precision, relations, RELATION_WEIGHT * self._relation_precisions, pairs)

    def _interpolate_in_world(self, weights: FrameWeights) -> tuple[Poses, Poses]:
        """Interpolate part poses in world axes; return body poses, and the part poses in body axes."""
        world = interpolate_poses(weights, self.poses)
        bodies = self.articulation.fit_bodies(world)
        return bodies, self.articulation.to_body_axes(world, bodies)

    @cached_property
    def _frame_poses(self) -> tuple[Poses, Poses]:
        """Body poses and part poses in body axes at the frames."""
        bodies = self.articulation.fit_bodies(self.poses)
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations))
        parts = self.articulation.to_body_axes(self.poses, bodies)
        return bodies, parts._replace(rotations=align_quat_signs(parts.rotations))

    @cached_property
    def _left_out(self) -> tuple[Index, FrameWeights]:
        return self.operator.leave_one_out()

    @cached_property
    def _precisions(self) -> tuple[Float | None, Float | None]:
        """Precisions ``(p, 4, 4)`` in world axes and in body axes; None for unused axes.

        Errors in world axes are measured there, where standing feet are exact. Precisions are invariant to rotations.
        """
        frame_ids, weights = self._left_out
        world = _pose_matrices(interpolate_poses(weights, self.poses)) - _pose_matrices(self.poses)[frame_ids]
        world_precision = _error_precisions(world, self.articulation.radii)
        if not self.in_body_axes:
            return world_precision, None
        expected = _pose_matrices(self._frame_poses[1])[frame_ids]
        from_world = _pose_matrices(self._interpolate_in_world(weights)[1]) - expected
        body = _pose_matrices(interpolate_poses(weights, self._frame_poses[1])) - expected
        is_useless = np.linalg.norm(from_world) > MAX_WORLD_ERROR_RATIO * np.linalg.norm(body)
        return None if is_useless else world_precision, _error_precisions(body, self.articulation.radii)

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
    return _nearest_poses(estimates + change.reshape(count, size, 4, 3))


def _pose_matrices(poses: Poses) -> Float:
    """Return poses as matrices X ``(T, p, 4, 3)``."""
    rotations = np.swapaxes(quat_to_matrix(poses.rotations), -1, -2)
    return np.concatenate([rotations, poses.centres[:, :, None]], axis=2)


def _nearest_poses(x: Float) -> Poses:
    """Return the poses of matrices X ``(T, p, 4, 3)``, projected to rotations."""
    return Poses(matrix_to_quat(nearest_rotations(np.swapaxes(x[:, :, :3], -1, -2))), x[:, :, 3])
