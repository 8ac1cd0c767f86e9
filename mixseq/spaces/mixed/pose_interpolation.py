r"""Interpolation of part poses in time: predictions in the world, in the axes of the body, and by neighbours.

Rotations are chained and centres are weighted sums (`mixseq.spaces.temporal`), in the axes of the world, where feet
stand, and in those of the body, where a rotation of the body does not move its parts. Bodies follow the first
prediction; part poses are predicted relative to them, independent of the rotations of bodies. Neighbours also predict
each other. A pose is the matrix :math:`X = (R^T; t)` with four rows, a relation :math:`X_j = G_{ij} X_i`.
The poses that agree best with all predictions minimise

.. math:: \sum_i |X_i - \hat X_i|^2_{P_i} + \lambda \sum_{ij} |X_j - \hat G_{ij} X_i|^2_{P_{ij}} ,

with the mean :math:`\hat X_i` of the predictions in the world and in the body, weighted by their precisions. It is a
linear system; polar decomposition makes its rotations rotations. Every precision P is the inverse of a 4 x 4 covariance
of errors :math:`\delta`, those with which frames that are left out are predicted from the others:

.. math:: P = \Bigl(\frac{\sum \delta \delta^T + n\, S}{3 F + n} + \varepsilon^2\Bigr)^{-1}

over F frames, with an isotropic S of the same size, as few frames leave parts of the covariance undetermined.
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
r"""Weight :math:`\lambda` of a relation against a pose; chosen on half of the animations of the benchmarks."""

MAX_WORLD_ERROR_RATIO = 2.0
"""Largest error in the world over that in the body; above it, parts are predicted in the body only."""

PRIOR_SAMPLES = 6.0
"""Number n of rows of errors by which the isotropic covariance counts."""

POSE_ERROR_FLOOR = 1e-3
r"""Error :math:`\varepsilon` that is added to all, in diagonals."""

TIMES_PER_BLOCK = 64
"""Number of times whose systems are solved in one block."""


@dataclass(frozen=True, eq=False)
class PoseInterpolation:
    """The prediction of the poses of all parts of a sequence."""

    articulation: Articulation  # the parts
    operator: TemporalOperator  # the temporal operator of the sequence
    poses: Poses  # poses of the parts in the world at the frames, (T, p): rotations since the reference frame
    in_body_axes: bool  # whether poses are predicted as seen from the body, too

    def at(self, times: Float) -> tuple[Poses, Poses]:
        """Predict body poses ``(N, B)``, and relative part poses ``(N, p)``, at times ``(N,)``; exact at frames."""
        rows, known = self.operator.weights_at(times), np.isin(times, self.operator.times)[:, None, None]
        bodies, alone = (interpolate_poses(rows, each) for each in self._frame_poses)
        if len(self.operator.times) < 3:
            return bodies, alone
        found, seen = self.interpolate(rows)
        return _keep_frames(bodies, found, known), _keep_frames(alone, seen, known)

    def interpolate(self, rows: FrameWeights) -> tuple[Poses, Poses]:
        """Predict body poses, and part poses relative to them, by weights of frames: quaternions of any sign."""
        starts = range(0, len(rows.frame_ids), TIMES_PER_BLOCK)
        found = [
            self._interpolate_block(rows.select(slice(start, start + TIMES_PER_BLOCK))) for start in starts
        ]
        bodies, seen = (
            Poses(*(np.concatenate(blocks) for blocks in zip(*each, strict=True)))
            for each in zip(*found, strict=True)
        )
        return bodies, seen

    def _interpolate_block(self, rows: FrameWeights) -> tuple[Poses, Poses]:
        bodies, in_world = self._interpolate_in_world(rows)
        world, body = self._precisions
        guesses = [] if world is None else [(in_world, world)]
        if body is not None:
            guesses.append((interpolate_poses(rows, self._frame_poses[1]), body))
        own: Float = np.sum([precision for _, precision in guesses], axis=0)
        weighted = [precision @ _pose_matrices(guess) for guess, precision in guesses]
        mean = np.asarray(np.linalg.solve(own, np.sum(weighted, axis=0)), dtype=np.float64)
        own = own / len(guesses)
        parts = self.articulation.pairs
        if not len(parts):
            turns = np.swapaxes(mean[:, :, :3], -1, -2)
            return bodies, Poses(matrix_to_quat(nearest_rotations(turns)), mean[:, :, 3])
        seen = _interpolate_relations(rows, self._frame_relations, self.articulation.pivots)
        return bodies, Poses(*_fuse(mean, own, seen, RELATION_WEIGHT * self._relation_precisions, parts))

    def _interpolate_in_world(self, rows: FrameWeights) -> tuple[Poses, Poses]:
        """Body poses of parts predicted in the world, and part poses relative to them."""
        predicted = interpolate_poses(rows, self.poses)
        bodies = self.articulation.fit_bodies(predicted)
        return bodies, self.articulation.to_body_axes(predicted, bodies)

    @cached_property
    def _frame_poses(self) -> tuple[Poses, Poses]:
        """Body poses at the frames, and part poses relative to them."""
        bodies = self.articulation.fit_bodies(self.poses)
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations))
        seen = self.articulation.to_body_axes(self.poses, bodies)
        return bodies, seen._replace(rotations=align_quat_signs(seen.rotations))

    @cached_property
    def _left_out(self) -> tuple[Index, FrameWeights]:
        return self.operator.leave_one_out()

    @cached_property
    def _precisions(self) -> tuple[Float | None, Float | None]:
        """Precisions ``(p, 4, 4)`` of predictions in the world and in the body; None where one is not used.

        Those in the world are measured there, where a standing foot is exact. Precisions do not depend on the axes.
        """
        (left, rows), seen, radii = (
            self._left_out,
            _pose_matrices(self._frame_poses[1]),
            self.articulation.radii,
        )
        world = _error_precisions(
            _pose_matrices(interpolate_poses(rows, self.poses)) - _pose_matrices(self.poses)[left], radii
        )
        if not self.in_body_axes:
            return world, None
        in_world = _pose_matrices(self._interpolate_in_world(rows)[1]) - seen[left]
        in_body = _pose_matrices(interpolate_poses(rows, self._frame_poses[1])) - seen[left]
        useless = np.linalg.norm(in_world) > MAX_WORLD_ERROR_RATIO * np.linalg.norm(in_body)
        return None if useless else world, _error_precisions(in_body, radii)

    @cached_property
    def _frame_relations(self) -> Poses:
        """Relations at the frames ``(T, n)``: rotations, and places of pivots."""
        related = self.articulation.add_relations(self.poses)
        return Poses(align_quat_signs(related.relation_rotations), related.relation_points)

    @cached_property
    def _relation_precisions(self) -> Float:
        """Precisions ``(n, 4, 4)`` of relations."""
        (left, rows), pivots, count = self._left_out, self.articulation.pivots, len(self.poses.centres)
        everywhere = FrameWeights(np.arange(count)[:, None], np.ones((count, 1)), count)
        errors = (
            _interpolate_relations(rows, self._frame_relations, pivots)
            - _interpolate_relations(everywhere, self._frame_relations, pivots)[left]
        )
        return _error_precisions(errors[..., :3], self.articulation.radii[self.articulation.pairs[:, 1]])


def _keep_frames(frames: Poses, predicted: Poses, known: Mask) -> Poses:
    """Return predicted poses, replaced by those of the frames at known times ``(N, 1, 1)``."""
    turns = align_quat_signs(predicted.rotations, frames.rotations[0])
    return Poses(np.where(known, frames.rotations, turns), np.where(known, frames.centres, predicted.centres))


def _interpolate_relations(rows: FrameWeights, related: Poses, pivots: Float) -> Float:
    """Predict relations, as matrices G ``(N, n, 4, 4)``."""
    rotations = quat_to_matrix(chain_rotations(rows, related.rotations))
    result = np.zeros((*rotations.shape[:2], 4, 4))
    result[..., :3, :3] = np.swapaxes(rotations, -1, -2)
    result[..., 3, :3] = rows.interpolate(related.centres) - rotate_vectors(rotations, pivots)
    result[..., 3, 3] = 1.0
    return result


def _error_precisions(errors: Float, radii: Float) -> Float:
    """Precisions ``(n, 4, 4)`` of matrices with errors ``(F, n, 4, 3)``, of parts with given radii."""
    lengths = np.concatenate([np.repeat(radii[:, None], 3, axis=1), np.ones((len(radii), 1))], axis=1)
    errors = errors * lengths[:, :, None]
    squares = np.einsum("fnac,fnbc->nab", errors, errors)
    count = 3 * len(errors)
    turning = np.trace(squares[:, :3, :3], axis1=1, axis2=2) / 3.0
    isotropic = np.concatenate([np.repeat(turning[:, None], 3, axis=1), squares[:, 3:, 3]], axis=1) / count
    covariance = squares + PRIOR_SAMPLES * isotropic[:, :, None] * np.eye(4)
    inverted = np.linalg.inv(covariance / (count + PRIOR_SAMPLES) + POSE_ERROR_FLOOR**2 / 3.0 * np.eye(4))
    return np.asarray(inverted * lengths[:, :, None] * lengths[:, None, :])


def _fuse(alone: Float, own: Float, seen: Float, relative: Float, parts: Index) -> tuple[Float, Float]:
    """Rotations ``(N, p, 4)`` and centres ``(N, p, 3)`` that agree best with all predictions."""
    count, size = alone.shape[:2]
    i, j = parts.T
    forth = relative @ seen  # (N, n, 4, 4)
    gain = np.swapaxes(seen, -1, -2) @ forth
    residuals = alone[:, j] - seen @ alone[:, i]
    system, right = np.zeros((count, size, 4, size, 4)), np.zeros((count, size, 4, 3))
    for part in range(size):
        system[:, part, :, part] = own[part]
    for link, (first, second) in enumerate(parts):
        system[:, second, :, second] += relative[link]
        system[:, first, :, first] += gain[:, link]
        system[:, second, :, first] -= forth[:, link]
        system[:, first, :, second] -= np.swapaxes(forth[:, link], -1, -2)
        right[:, second] -= relative[link] @ residuals[:, link]
        right[:, first] += np.swapaxes(forth[:, link], -1, -2) @ residuals[:, link]
    change = np.linalg.solve(system.reshape(count, 4 * size, 4 * size), right.reshape(count, 4 * size, 3))
    together = alone + change.reshape(count, size, 4, 3)
    return matrix_to_quat(nearest_rotations(np.swapaxes(together[:, :, :3], -1, -2))), together[:, :, 3]


def _pose_matrices(poses: Poses) -> Float:
    """Poses as matrices X ``(T, p, 4, 3)``."""
    rotations = np.swapaxes(quat_to_matrix(poses.rotations), -1, -2)
    return np.concatenate([rotations, poses.centres[:, :, None]], axis=2)
