r"""Weights of the values at knots in the cubic spline through them.

With second derivatives :math:`m_i` at knots that are :math:`h_i` apart, the spline through values :math:`y_i` has

.. math:: h_{i-1} m_{i-1} + 2 (h_{i-1} + h_i) m_i + h_i m_{i+1} = 6\, (s_i - s_{i-1}), \qquad
   s_i = (y_{i+1} - y_i) / h_i

at inner knots, and between two of them, with :math:`b = (t - t_i) / h_i` and :math:`a = 1 - b`, the value
:math:`a y_i + b y_{i+1} + h_i^2 / 6\, ((a^3 - a) m_i + (b^3 - b) m_{i+1})`, linear in the values. Numpy suffices for
few knots: importing scipy's splines takes longer than decoding a frame.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from mixseq.arrays import Float

Ends = Literal["natural", "not-a-knot"]
"""End conditions: zero second derivatives, or one cubic through the first two intervals and the last two."""


def spline_weights(knots: Float, times: Float, ends: Ends) -> Float:
    """Return the weights ``(N, m)`` of values at two or more knots ``(m,)`` in the spline at times ``(N,)``."""
    steps = np.diff(knots)
    system, right = np.diag(np.ones(len(knots))), np.zeros((len(knots), len(knots)))
    inner = np.arange(1, len(knots) - 1)
    for offset, entries in ((-1, steps[:-1]), (0, 2 * (steps[:-1] + steps[1:])), (1, steps[1:])):
        system[inner, inner + offset] = entries
    right[inner] = 6 * np.diff(np.diff(np.eye(len(knots)), axis=0) / steps[:, None], axis=0)
    if ends == "not-a-knot" and len(knots) > 3:
        system[0, :3] = steps[1], -steps[0] - steps[1], steps[0]
        system[-1, -3:] = steps[-1], -steps[-1] - steps[-2], steps[-2]
    elif ends == "not-a-knot" and len(knots) == 3:  # both conditions are the same: it is a parabola
        system[0, 1] = system[-1, -2] = -1.0
    bends = np.linalg.solve(system, right)

    left = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(steps) - 1)
    width, after = steps[left], (times - knots[left]) / steps[left]
    before = 1 - after
    weights = (before**3 - before)[:, None] * bends[left] + (after**3 - after)[:, None] * bends[left + 1]
    weights *= width[:, None] ** 2 / 6
    rows = np.arange(len(times))
    weights[rows, left] += before
    weights[rows, left + 1] += after
    return np.asarray(weights)
