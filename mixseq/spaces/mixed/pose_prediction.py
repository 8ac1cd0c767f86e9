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
from mixseq.spaces.temporal import Operator, Poses, Rows, chained, predicted_alone
from mixseq.types import Float, Index, Mask

RELATION_WEIGHT = 2.0
r"""Weight :math:`\lambda` of a relation against a pose; chosen on half of the animations of the benchmarks."""

MAX_WORLD_ERROR_RATIO = 2.0
"""Largest error in the world over that in the body; above it, parts are predicted in the body only."""

PRIOR_ROWS = 6.0
"""Number n of rows of errors by which the isotropic covariance counts."""

POSE_ERROR_FLOOR = 1e-3
r"""Error :math:`\varepsilon` that is added to all, in diagonals."""

TIMES_PER_BLOCK = 64
"""Number of times whose systems are solved in one block."""


@dataclass(frozen=True, eq=False)
class PosePrediction:
    """The prediction of the poses of all parts of a sequence."""

    articulation: Articulation  # the parts
    operator: Operator  # the temporal operator of the sequence
    poses: Poses  # poses of the parts in the world at the frames, (T, p): rotations since the reference frame
    in_body: bool  # whether poses are predicted as seen from the body, too

    def at(self, times: Float) -> tuple[Poses, Poses]:
        """Predict body poses ``(N, B)``, and relative part poses ``(N, p)``, at times ``(N,)``; exact at frames."""
        rows, known = self.operator.at(times), np.isin(times, self.operator.times)[:, None, None]
        bodies, alone = (predicted_alone(rows, each) for each in self._bodies)
        if len(self.operator.times) < 3:
            return bodies, alone
        found, seen = self.of(rows)
        return _kept(bodies, found, known), _kept(alone, seen, known)

    def of(self, rows: Rows) -> tuple[Poses, Poses]:
        """Predict body poses, and part poses relative to them, by weights of frames: quaternions of any sign."""
        starts = range(0, len(rows.frames), TIMES_PER_BLOCK)
        found = [self._predicted(rows.at(slice(start, start + TIMES_PER_BLOCK))) for start in starts]
        bodies, seen = (
            Poses(*(np.concatenate(blocks) for blocks in zip(*each, strict=True)))
            for each in zip(*found, strict=True)
        )
        return bodies, seen

    def _predicted(self, rows: Rows) -> tuple[Poses, Poses]:
        bodies, in_world = self._seen_in_world(rows)
        world, body = self._precisions
        guesses = [] if world is None else [(in_world, world)]
        if body is not None:
            guesses.append((predicted_alone(rows, self._bodies[1]), body))
        own: Float = np.sum([precision for _, precision in guesses], axis=0)
        weighted = [precision @ _stacked(guess) for guess, precision in guesses]
        mean = np.asarray(np.linalg.solve(own, np.sum(weighted, axis=0)), dtype=np.float64)
        own = own / len(guesses)
        parts = self.articulation.pairs
        if not len(parts):
            turns = np.swapaxes(mean[:, :, :3], -1, -2)
            return bodies, Poses(matrix_to_quat(nearest_rotations(turns)), mean[:, :, 3])
        seen = _relations(rows, self._related, self.articulation.pivots)
        return bodies, Poses(*_fused(mean, own, seen, RELATION_WEIGHT * self._relation_precisions, parts))

    def _seen_in_world(self, rows: Rows) -> tuple[Poses, Poses]:
        """Body poses of parts predicted in the world, and part poses relative to them."""
        predicted = predicted_alone(rows, self.poses)
        bodies = self.articulation.bodies_of(predicted)
        return bodies, self.articulation.seen_from_bodies(predicted, bodies)

    @cached_property
    def _bodies(self) -> tuple[Poses, Poses]:
        """Body poses at the frames, and part poses relative to them."""
        bodies = self.articulation.bodies_of(self.poses)
        bodies = bodies._replace(rotations=align_quat_signs(bodies.rotations))
        seen = self.articulation.seen_from_bodies(self.poses, bodies)
        return bodies, seen._replace(rotations=align_quat_signs(seen.rotations))

    @cached_property
    def _left_out(self) -> tuple[Index, Rows]:
        return self.operator.left_out()

    @cached_property
    def _precisions(self) -> tuple[Float | None, Float | None]:
        """Precisions ``(p, 4, 4)`` of predictions in the world and in the body; None where one is not used.

        Those in the world are measured there, where a standing foot is exact. Precisions do not depend on the axes.
        """
        (left, rows), seen, radii = self._left_out, _stacked(self._bodies[1]), self.articulation.radii
        world = _precision(_stacked(predicted_alone(rows, self.poses)) - _stacked(self.poses)[left], radii)
        if not self.in_body:
            return world, None
        in_world = _stacked(self._seen_in_world(rows)[1]) - seen[left]
        in_body = _stacked(predicted_alone(rows, self._bodies[1])) - seen[left]
        useless = np.linalg.norm(in_world) > MAX_WORLD_ERROR_RATIO * np.linalg.norm(in_body)
        return None if useless else world, _precision(in_body, radii)

    @cached_property
    def _related(self) -> Poses:
        """Relations at the frames ``(T, n)``: rotations, and places of pivots."""
        related = self.articulation.with_relations(self.poses)
        return Poses(align_quat_signs(related.relation_turns), related.relation_points)

    @cached_property
    def _relation_precisions(self) -> Float:
        """Precisions ``(n, 4, 4)`` of relations."""
        (left, rows), pivots, count = self._left_out, self.articulation.pivots, len(self.poses.centres)
        everywhere = Rows(np.arange(count)[:, None], np.ones((count, 1)), count)
        errors = _relations(rows, self._related, pivots) - _relations(everywhere, self._related, pivots)[left]
        return _precision(errors[..., :3], self.articulation.radii[self.articulation.pairs[:, 1]])


def _kept(frames: Poses, predicted: Poses, known: Mask) -> Poses:
    """Return predicted poses, replaced by those of the frames at known times ``(N, 1, 1)``."""
    turns = align_quat_signs(predicted.rotations, frames.rotations[0])
    return Poses(np.where(known, frames.rotations, turns), np.where(known, frames.centres, predicted.centres))


def _relations(rows: Rows, related: Poses, pivots: Float) -> Float:
    """Predict relations, as matrices G ``(N, n, 4, 4)``."""
    rotations = quat_to_matrix(chained(rows, related.rotations))
    result = np.zeros((*rotations.shape[:2], 4, 4))
    result[..., :3, :3] = np.swapaxes(rotations, -1, -2)
    result[..., 3, :3] = rows.of(related.centres) - rotate_vectors(rotations, pivots)
    result[..., 3, 3] = 1.0
    return result


def _precision(errors: Float, radii: Float) -> Float:
    """Precisions ``(n, 4, 4)`` of matrices with errors ``(F, n, 4, 3)``, of parts with given radii."""
    lengths = np.concatenate([np.repeat(radii[:, None], 3, axis=1), np.ones((len(radii), 1))], axis=1)
    errors = errors * lengths[:, :, None]
    squares = np.einsum("fnac,fnbc->nab", errors, errors)
    count = 3 * len(errors)
    turning = np.trace(squares[:, :3, :3], axis1=1, axis2=2) / 3.0
    isotropic = np.concatenate([np.repeat(turning[:, None], 3, axis=1), squares[:, 3:, 3]], axis=1) / count
    covariance = squares + PRIOR_ROWS * isotropic[:, :, None] * np.eye(4)
    inverted = np.linalg.inv(covariance / (count + PRIOR_ROWS) + POSE_ERROR_FLOOR**2 / 3.0 * np.eye(4))
    return np.asarray(inverted * lengths[:, :, None] * lengths[:, None, :])


def _fused(alone: Float, own: Float, seen: Float, relative: Float, parts: Index) -> tuple[Float, Float]:
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


def _stacked(poses: Poses) -> Float:
    """Poses as matrices X ``(T, p, 4, 3)``."""
    rotations = np.swapaxes(quat_to_matrix(poses.rotations), -1, -2)
    return np.concatenate([rotations, poses.centres[:, :, None]], axis=2)
