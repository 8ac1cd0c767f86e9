r"""Poses of parts between frames: each predicted on its own, and as its neighbours see it.

**Alone.** Rotations are chained: with the weights :math:`w_k(t)` of the temporal operator and :math:`c_k = \sum_{j
\ge k} w_j`,

.. math:: R(t) = R_0 \prod_{k \ge 1} \bigl(R_{k-1}^T R_k\bigr)^{c_k(t)},

which passes through the frames and needs no chart: a body may spin. Centres are weighted sums.

**Together.** A pose is the matrix :math:`X = (R^T; t)` with four rows. Where two parts meet each also sees the other,
as
:math:`X_j = G_{ij} X_i`, and that relation is predicted in the same way, as the other part's rotation and the place
of the boundary's middle on it. Predictions disagree. The poses that agree with all of them best minimise

.. math:: \sum_i |X_i - \hat X_i|^2_{P_i} + \lambda \sum_{ij} |X_j - \hat G_{ij} X_i|^2_{P_{ij}} ,

a linear system; polar decomposition makes its rotations rotations. Every precision P is the inverse of a 4 x 4
covariance of errors :math:`\delta`, those with which frames that are left out are predicted from the others:

.. math:: P = \Bigl(\frac{\sum \delta \delta^T + n\, S}{3 F + n} + \varepsilon^2\Bigr)^{-1}

over F frames, with an isotropic S of the same size that stands for what so few frames do not tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index, Mask
from mixseq.geometry.rigid import nearest_rotations
from mixseq.geometry.rotations import (
    continued,
    inverse,
    normalised,
    powers,
    product,
    quaternions,
    rotations_of,
    turned,
)
from mixseq.prediction.operator import Operator, Rows

TOGETHER = 0.3
r"""Weight :math:`\lambda` of a relation against a pose alone: errors of neighbours go together."""

BLENDED = 3.0
"""The same where nothing can be left out: blends of poses, which may be far apart, and two frames."""

PRIOR = 6.0
"""Rows of errors n that the isotropic covariance stands for."""

FLOOR = 1e-3
r"""Errors :math:`\varepsilon` below this, in diagonals, are all the same."""

NOTHING = 1e-12
"""Powers of rotations nearer to 0 or 1 than this are these."""


class Poses(NamedTuple):
    """Poses of p parts in T frames.

    Attributes
    ----------
    rotations : (T, p, 4) float64
        Quaternions of unit length, with signs that do not jump.
    centres : (T, p, 3) float64
        Where the parts' centres are.
    """

    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Which parts see which, and the sizes of parts.

    Attributes
    ----------
    parts : (n, 2) int64
        A part i, and the part j that it sees; every pair in both orders.
    pivots : (n, 3) float64
        The middle of their boundary, as seen from the centre of part j in its own axes.
    radii : (p,) float64
        Radii of gyration of all parts, in the unit of the pivots: by how much a turn moves a part.
    """

    parts: Index
    pivots: Float
    radii: Float


def predicted(operator: Operator, poses: Poses, neighbours: Neighbours, times: Float) -> Poses:
    """Predict the poses of all parts at times ``(N,)`` from those at the frames, which they pass through.

    Parameters
    ----------
    operator : Operator
        The temporal operator of the sequence.
    poses : Poses
        Poses at its frames.
    neighbours : Neighbours
        Which parts see which.
    times : (N,) float64
        When, increasing.
    """
    left_out = operator.left_out() if len(operator.times) > 2 else None
    return _agreed(operator.at(times), poses, neighbours, np.isin(times, operator.times), left_out)


def blended(weights: Float, poses: Poses, neighbours: Neighbours) -> Poses:
    """Blend T poses of all parts to one, with weights ``(T,)`` that add up to one.

    There is no time, and nothing to leave out: what poses and relations are apart tells how well they are known.
    """
    rows = Rows(np.arange(len(weights))[None], weights[None], len(weights))
    given = np.array([np.count_nonzero(weights) == 1])
    return _agreed(rows, poses, neighbours, given, None)


def _agreed(
    rows: Rows, poses: Poses, neighbours: Neighbours, given: Mask, left_out: tuple[Index, Rows] | None
) -> Poses:
    """Poses that agree best with what they are on their own and as neighbours see them; `given` ones stay."""
    alone = predicted_alone(rows, poses)
    if not len(neighbours.parts) or len(poses.centres) < 2:
        return alone
    relations = _relations(poses, neighbours)
    seen = _seen(rows, relations, neighbours)
    own, relative = _precisions(left_out, poses, relations, neighbours)
    weight = BLENDED if left_out is None else TOGETHER
    rotations, centres = _fused(_stacked(alone), own, seen, weight * relative, neighbours.parts)
    # At a frame all predictions agree: it stays as it is, without the system's rounding.
    fused = Poses(
        np.where(given[:, None, None], alone.rotations, quaternions(rotations)),
        np.where(given[:, None, None], alone.centres, centres),
    )
    return Poses(continued(fused.rotations, alone.rotations[0]), fused.centres)


def predicted_alone(rows: Rows, poses: Poses) -> Poses:
    """Predict each pose on its own: rotations chained, centres as weighted sums."""
    return Poses(chained(rows, poses.rotations), rows.of(poses.centres))


def chained(rows: Rows, rotations: Float) -> Float:
    """Return the rotations ``(N, p, 4)`` that are chained of those at the frames, ``(T, p, 4)``, with weights."""
    exponents = np.cumsum(rows.weights[:, ::-1], axis=1)[:, ::-1]
    result = rotations[rows.frames[:, 0]]
    for place in range(1, rows.frames.shape[1]):
        exponent = exponents[:, place]
        before, here = rotations[rows.frames[:, place - 1]], rotations[rows.frames[:, place]]
        whole = np.abs(exponent - 1.0) < NOTHING
        result[whole] = here[whole]  # all that came before is whole, too
        some = ~whole & (np.abs(exponent) >= NOTHING)
        if some.any():
            step = product(inverse(before[some]), here[some])
            result[some] = product(result[some], powers(step, exponent[some, None]))
    return continued(normalised(result))


def _relations(poses: Poses, neighbours: Neighbours) -> Poses:
    """How every part j stands as part i sees it: rotations ``(T, n, 4)`` and centres ``(T, n, 3)``."""
    i, j = neighbours.parts.T
    back = inverse(poses.rotations[:, i])
    away = poses.centres[:, j] - poses.centres[:, i]
    return Poses(continued(product(back, poses.rotations[:, j])), turned(rotations_of(back), away))


def _seen(rows: Rows, relations: Poses, neighbours: Neighbours) -> Float:
    """Predict relations, as matrices G ``(N, n, 4, 4)``."""
    rotations = rotations_of(chained(rows, relations.rotations))
    middles = turned(rotations_of(relations.rotations), neighbours.pivots) + relations.centres
    result = np.zeros((*rotations.shape[:2], 4, 4))
    result[..., :3, :3] = np.swapaxes(rotations, -1, -2)
    result[..., 3, :3] = rows.of(middles) - turned(rotations, neighbours.pivots)
    result[..., 3, 3] = 1.0
    return result


def _precisions(
    left_out: tuple[Index, Rows] | None, poses: Poses, relations: Poses, neighbours: Neighbours
) -> tuple[Float, Float]:
    """Precisions ``(p, 4, 4)`` of poses and ``(n, 4, 4)`` of relations: how well frames left out are predicted."""
    count = len(poses.centres)
    everywhere = Rows(np.arange(count)[:, None], np.ones((count, 1)), count)
    own, seen = _stacked(poses), _seen(everywhere, relations, neighbours)
    if left_out is None:
        own_errors, seen_errors = own[1:] - own[:1], seen[1:] - seen[:1]
    else:
        left, rows = left_out
        own_errors = _stacked(predicted_alone(rows, poses)) - own[left]
        seen_errors = _seen(rows, relations, neighbours) - seen[left]
    radii = neighbours.radii
    return _precision(own_errors, radii), _precision(seen_errors[..., :3], radii[neighbours.parts[:, 1]])


def _precision(errors: Float, radii: Float) -> Float:
    """Precisions ``(n, 4, 4)`` of matrices with errors ``(F, n, 4, 3)``, of parts with given radii."""
    lengths = np.concatenate([np.repeat(radii[:, None], 3, axis=1), np.ones((len(radii), 1))], axis=1)
    errors = errors * lengths[:, :, None]
    squares = np.einsum("fnac,fnbc->nab", errors, errors)
    count = 3 * len(errors)
    turning = np.trace(squares[:, :3, :3], axis1=1, axis2=2) / 3.0
    isotropic = np.concatenate([np.repeat(turning[:, None], 3, axis=1), squares[:, 3:, 3]], axis=1) / count
    covariance = squares + PRIOR * isotropic[:, :, None] * np.eye(4)
    inverted = np.linalg.inv(covariance / (count + PRIOR) + FLOOR**2 / 3.0 * np.eye(4))
    return np.asarray(inverted * lengths[:, :, None] * lengths[:, None, :])


def _fused(alone: Float, own: Float, seen: Float, relative: Float, parts: Index) -> tuple[Float, Float]:
    """Rotations ``(N, p, 3, 3)`` and centres ``(N, p, 3)`` that agree with all predictions best."""
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
    return nearest_rotations(np.swapaxes(together[:, :, :3], -1, -2)), together[:, :, 3]


def _stacked(poses: Poses) -> Float:
    """Poses as matrices X ``(T, p, 4, 3)``."""
    rotations = np.swapaxes(rotations_of(poses.rotations), -1, -2)
    return np.concatenate([rotations, poses.centres[:, :, None]], axis=2)
