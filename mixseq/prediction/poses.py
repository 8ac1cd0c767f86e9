r"""Poses between frames, each predicted independently.

Rotations are chained: with the weights :math:`w_k(t)` of the temporal operator and :math:`c_k = \sum_{j \ge k} w_j`,

.. math:: R(t) = R_0 \prod_{k \ge 1} \bigl(R_{k-1}^T R_k\bigr)^{c_k(t)},

which interpolates the frames without a chart: a body may spin. Centres are weighted sums.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float
from mixseq.geometry.rotations import continued, inverse, normalised, powers, product
from mixseq.prediction.operator import Rows

NOTHING = 1e-12
"""Distance to 0 or 1 below which exponents of rotations are rounded."""


class Poses(NamedTuple):
    """Poses of p parts in T frames."""

    rotations: Float  # (T, p, 4) unit quaternions with continuous signs
    centres: Float  # (T, p, 3) where the parts' centres are


def predicted_alone(rows: Rows, poses: Poses) -> Poses:
    """Predict each pose independently: rotations chained, centres as weighted sums."""
    return Poses(chained(rows, poses.rotations), rows.of(poses.centres))


def chained(rows: Rows, rotations: Float) -> Float:
    """Return the rotations ``(N, p, 4)`` chained from those at the frames ``(T, p, 4)`` by weights."""
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
