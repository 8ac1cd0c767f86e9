"""Diagonals, and lengths in them, at any scale."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.mesh.measures import Diagonal
from mixseq.sequence.sequence import bounding_diagonal

BOX = np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 6]])


@pytest.mark.parametrize("exponent", [-1060, -600, -100, 0, 100, 600, 1021])
def test_diagonals_of_any_size(exponent: int) -> None:
    points = np.ldexp(BOX, exponent)
    unit = Diagonal.of(points)
    assert unit == Diagonal(7 / 8, exponent + 3)
    assert unit.length == np.ldexp(7.0, exponent)
    np.testing.assert_array_equal(unit.shifted(points), BOX / 8)


def test_digits_are_those_of_the_plain_formula() -> None:
    for points in np.random.default_rng(1).normal(size=(50, 10, 3)):
        extent = points.max(axis=0) - points.min(axis=0)
        assert bounding_diagonal(points) == np.linalg.norm(extent)
        assert bounding_diagonal(points.astype(np.float32)) > 0


def test_places_do_not_matter() -> None:
    assert Diagonal.of(BOX + 2.0**40) == Diagonal.of(BOX)


def test_one_point_has_none() -> None:
    for place in (0.0, 1e300, np.finfo(np.float64).max):
        assert Diagonal.of(np.full((3, 3), place)) == Diagonal(0.0, 0)


def test_what_does_not_fit_into_a_double() -> None:
    most = np.finfo(np.float64).max
    unit = Diagonal.of(np.array([[-most, 0, 0], [most, 0, 0]]))
    assert (round(unit.fraction, 12), unit.exponent) == (1.0, 1025)
    assert unit.length == np.inf
    assert Diagonal.of(BOX * 1e-300).shifted(np.array([1e300])) == np.inf
