r"""Fit targets: the principal shapes of displacements, the fewest for an error.

*Principal shapes.* Of displacements X ``(T, 3V)``, with :math:`X X^T = U \Lambda U^T`, the targets are rows of
:math:`U^T X` and the weights columns of U (Alexa and Mueller 2000). The first M of them approximate X best in the sum
of squares, and all of them exactly. Targets are scaled to a largest weight of one: a target has its displayed size.

*Correctives.* The residual of a skin, :math:`e_t(v)`, is pulled back to the rest pose, before skinning, by the weighted
mean of its bones' rotations, :math:`A_t(v) = \sum_b w_{vb} R_{tb}` (as in pose-space deformation, Lewis et al. 2000):

.. math:: \delta_t(v) = \operatorname*{argmin}_\delta |A_t(v)\, \delta - e_t(v)|^2 + \mu |\delta|^2,

with :math:`\mu = 10^{-6}`. Means of rotations that differ by nearly half a turn have no useful inverse: a vertex where
:math:`\det A_t` falls below 0.04 in a frame (two bones at 157 degrees, half and half) follows only the bone of its
largest weight, and the targets compensate. Both values were chosen empirically. The targets are the principal shapes
of :math:`\delta`, and the error is measured after skinning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Float
from mixseq.rigging.rigs import INFLUENCES, Skin, rotation_matrices

_DAMPING = 1e-6
_COLLAPSED = 0.04
_RANK = 1e-14  # variances below this, relative to the largest, are rounding


@dataclass(frozen=True, eq=False)
class Targets:
    """Displacements as a sum of targets."""

    shapes: Float  # (M, V, 3) the targets
    weights: Float  # (T, M) weights of the targets
    error: float  # largest remaining distance, in the units of the displacements


def principal_shapes(displacements: Float) -> tuple[Float, Float]:
    """Return all targets ``(M, V, 3)`` and weights ``(T, M)``, the most important first."""
    frames = len(displacements)
    flat = displacements.reshape(frames, -1)
    variances, directions = np.linalg.eigh(flat @ flat.T)
    kept = np.flatnonzero(variances > _RANK * max(variances[-1], 0.0))[::-1]
    weights = directions[:, kept]
    if kept.size == 0:
        return np.zeros((0, *displacements.shape[1:])), np.zeros((frames, 0))
    # The sign is that of the largest weight, so that it does not depend on the library.
    largest = weights[np.abs(weights).argmax(axis=0), np.arange(kept.size)]
    shapes = (weights * largest).T @ flat
    return shapes.reshape(-1, *displacements.shape[1:]), weights / largest


def fit_targets(
    displacements: Float, bound: float | None, most: int | None, shown: Callable[[int, Float], Float]
) -> Targets:
    """Fit the fewest targets that bring all displacements ``(T, V, 3)`` within a bound, or as many as allowed."""
    shapes, weights = principal_shapes(displacements)
    most = len(shapes) if most is None else min(most, len(shapes))
    left = displacements.copy()

    def error() -> float:
        return max(float(shown(frame, rest).max()) for frame, rest in enumerate(left))

    count = 0
    reached = error()
    while count < most and (bound is None or reached > bound):
        left -= weights[:, count, None, None] * shapes[count]
        count += 1
        if bound is not None or count == most:
            reached = error()
    return Targets(shapes[:count], weights[:, :count], reached)


def fit_correctives(skin: Skin, points: Float, bound: float, most: int) -> tuple[Skin, float]:
    """Add corrective targets until every vertex of points ``(T, V, 3)`` is within a bound, or there are `most`."""
    turns = rotation_matrices(skin.rotations)
    bare = replace(
        skin,
        weights=_without_collapse(skin, turns),
        targets=skin.targets[:0],
        target_weights=skin.target_weights[:, :0],
    )
    displacements = np.empty_like(points)
    for frame, block in enumerate(bare.blocks(1)):
        a = _mean_rotations(bare, turns[frame])
        normal = np.swapaxes(a, 1, 2) @ a + _DAMPING * np.eye(3)
        right = np.einsum("vji,vj->vi", a, points[frame] - block[0])
        displacements[frame] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]

    def shown(frame: int, left: Float) -> Float:
        moved = np.einsum("vij,vj->vi", _mean_rotations(bare, turns[frame]), left)
        return np.asarray(np.linalg.norm(moved, axis=1))

    targets = fit_targets(displacements, bound, most, shown)
    fitted = replace(bare, targets=targets.shapes, target_weights=targets.weights)
    error = max(
        float(np.linalg.norm(block[0] - points[frame], axis=1).max())
        for frame, block in enumerate(fitted.blocks(1))
    )
    return fitted, error


def _without_collapse(skin: Skin, turns: Float) -> Float:
    """Return the weights, with only one bone for vertices where the mean rotation is nearly singular."""
    volume = np.full(len(skin.rest), np.inf)
    for turn in turns:
        np.minimum(volume, np.linalg.det(_mean_rotations(skin, turn)), out=volume)
    one = np.eye(1, INFLUENCES)
    return np.where(volume[:, None] < _COLLAPSED, one, skin.weights)


def _mean_rotations(skin: Skin, turns: Float) -> Float:
    """Return weighted means ``(V, 3, 3)`` of the rotations ``(B, 3, 3)`` of a frame."""
    means = np.zeros((len(skin.rest), 3, 3))
    for column in range(INFLUENCES):
        means += skin.weights[:, column, None, None] * turns[skin.influences[:, column]]
    return means
