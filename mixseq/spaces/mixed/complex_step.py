r"""Derivatives of analytic functions by a complex step, exact to rounding (Squire and Trapp 1998).

.. math:: f'(x)\, \dot x = \mathrm{Im}\, f(x + i h \dot x) / h + O(h^2)

Without a difference, h can be so small that the error is far below rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.shells.solvers import Factor

STEP = 2.0**-400
"""Step h; its square is below rounding, and products with it are normal numbers."""

Numbers = NDArray[Any]
"""Real numbers, or complex ones whose imaginary parts are rates times `STEP`."""


def with_rates(values: Float, rates: Float) -> Numbers:
    """Return complex numbers with values and rates."""
    return np.asarray(values + 1j * (STEP * rates))


def values_and_rates(numbers: Numbers) -> tuple[Float, Float]:
    """Return values and rates of numbers; the inverse of `with_rates`."""
    return np.ascontiguousarray(numbers.real), numbers.imag / STEP


def solve(factor: Factor, right: Numbers) -> Numbers:
    """Solve a real system for real or complex right-hand sides ``(n, k)``."""
    if not np.iscomplexobj(right):
        return np.asarray(factor.solve(right))
    columns = right.shape[1]
    both = factor.solve(np.concatenate(values_and_rates(right), axis=1))
    return with_rates(both[:, :columns], both[:, columns:])
