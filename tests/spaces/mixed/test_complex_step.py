"""Complex steps: derivatives to the last digits, of what is analytic."""

from __future__ import annotations

import numpy as np

from mixseq.shells.solvers import factored_laplacian
from mixseq.spaces.mixed.joints import solve, values_and_rates, with_rates

RNG = np.random.default_rng(0)
VALUES, RATES = RNG.normal(size=(2, 5, 3))


def test_numbers_with_rates_have_these() -> None:
    values, rates = values_and_rates(with_rates(VALUES, RATES))
    np.testing.assert_array_equal(values, VALUES)
    np.testing.assert_array_equal(rates, RATES)
    assert values.flags.c_contiguous


def test_functions_have_their_derivatives_to_the_last_digits() -> None:
    x = with_rates(VALUES, RATES)
    values, rates = values_and_rates(np.sqrt(1.0 + x * x) * np.sin(x))
    root = np.sqrt(1.0 + VALUES**2)
    np.testing.assert_allclose(values, root * np.sin(VALUES), rtol=1e-15)
    expected = RATES * (VALUES / root * np.sin(VALUES) + root * np.cos(VALUES))
    np.testing.assert_allclose(rates, expected, rtol=1e-13, atol=1e-15)


def test_a_system_is_solved_for_values_and_for_rates() -> None:
    factor = factored_laplacian(np.array([[0, 1], [1, 2], [2, 3], [3, 4]]), np.arange(1.0, 5.0), np.ones(5))
    values, rates = values_and_rates(solve(factor, with_rates(VALUES, RATES)))
    np.testing.assert_allclose(values, factor.solve(VALUES), rtol=1e-13)
    np.testing.assert_allclose(rates, factor.solve(RATES), rtol=1e-13)
    np.testing.assert_array_equal(solve(factor, VALUES), factor.solve(VALUES))
