r"""Derivatives by a complex step: exact to rounding, of any function that is made of analytic operations.

.. math:: f'(x)\, \dot x = \mathrm{Im}\, f(x + i h \dot x) / h + O(h^2)

No difference is taken, so h can be so small that the error is far below rounding (Squire and Trapp 1998).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Float
from mixseq.shells.solvers import Factor

STEP = 2.0**-400
"""Step h. Its square is nothing beside any number, and products with it are no denormal numbers."""

Numbers = NDArray[Any]
"""Real numbers, or complex ones whose imaginary parts are rates times `STEP`."""


def with_rates(values: Float, rates: Float) -> Numbers:
    """Return numbers that change with rates."""
    return np.asarray(values + 1j * (STEP * rates))


def values_and_rates(numbers: Numbers) -> tuple[Float, Float]:
    """Return values and rates of numbers; the inverse of `with_rates`."""
    return np.ascontiguousarray(numbers.real), numbers.imag / STEP


def solve(factor: Factor, right: Numbers) -> Numbers:
    """Solve a real system for right-hand sides ``(n, k)``, which may be complex."""
    if not np.iscomplexobj(right):
        return np.asarray(factor.solve(right))
    columns = right.shape[1]
    both = factor.solve(np.concatenate(values_and_rates(right), axis=1))
    return with_rates(both[:, :columns], both[:, columns:])
