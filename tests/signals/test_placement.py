"""Placements that state their dependent numbers, so that knots may be added without changing anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.errors import SettingsError
from mixseq.signals import Curve, fit
from mixseq.signals.placement import StatedPlacement, stated_placement, whole_placement
from tests.meshes import bar

MODEL = fit(bar(sides=5, rings=15, frames=9), knots=1)
WHOLE = whole_placement(MODEL.space, MODEL.placement)
DENSE = np.linspace(MODEL.start, MODEL.end, 33)


def test_stated_numbers_are_the_numbers() -> None:
    stated = stated_placement(MODEL.space, WHOLE)
    assert isinstance(stated, StatedPlacement)
    assert (stated.dim, stated.dependent.dim) == (MODEL.placement.dim, WHOLE.dim - MODEL.placement.dim)
    np.testing.assert_array_equal(whole_placement(MODEL.space, stated).values, WHOLE.values)


def test_knots_do_not_change_what_is_stated() -> None:
    more = Curve(DENSE, WHOLE(DENSE))
    times = np.linspace(0.01, 0.79, 20)
    stated = replace(MODEL, placement=stated_placement(MODEL.space, more))
    np.testing.assert_allclose(stated.curve(times), MODEL.curve(times), atol=1e-12)
    np.testing.assert_allclose(stated.rates(times), MODEL.rates(times), atol=1e-9)
    derived = replace(MODEL, placement=Curve(DENSE, MODEL.placement(DENSE)))
    assert np.abs(derived.curve(times) - MODEL.curve(times)).max() > 1e-6


def test_where_nothing_depends_a_curve_will_do() -> None:
    vertex = fit(bar(sides=5, rings=15), exact=True, space="vertex")
    stated = stated_placement(vertex.space, whole_placement(vertex.space, vertex.placement))
    assert type(stated) is Curve


def test_knots_are_the_same() -> None:
    with pytest.raises(SettingsError, match="need the knots of the others"):
        StatedPlacement(WHOLE.times, MODEL.placement.values, Curve(WHOLE.times + 1, WHOLE.values))
