"""Examination of markers: a wrong marker has the largest residual and is a suspect."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.retargeting.correspond import MIN_EXAMINED_MARKERS, examine_markers
from mixseq.retargeting.markers import Markers
from tests.retargeting.foxes import on_bones, short, tall

pytestmark = pytest.mark.slow

SIDES = [f"{bone}.{side}" for bone in ("ear", "cheek", "arm", "forepaw", "thigh", "hindpaw") for side in "lr"]
MARKED = ("nose", "tail4", "tail2", *SIDES)


def set_markers(*bones: str) -> Markers:
    return Markers(on_bones(short(), *bones), on_bones(tall(), *bones), bones)


def test_correct_markers_have_small_residuals() -> None:
    found = examine_markers(short().mesh, tall().mesh, set_markers(*MARKED))
    assert found.residuals is not None
    assert found.residuals.shape == (len(MARKED),)
    assert np.median(found.residuals) < 0.01
    assert found.coverage > 0.95
    assert not found.refusal


def test_a_wrong_marker_has_the_largest_residual() -> None:
    markers = set_markers(*MARKED)
    wrong = MARKED.index("thigh.r")
    targets = markers.target.copy()
    targets[wrong] = on_bones(tall(), "neck")[0]
    found = examine_markers(short().mesh, tall().mesh, Markers(markers.source, targets, MARKED))
    assert found.residuals is not None
    assert int(found.residuals.argmax()) == wrong
    assert wrong in found.suspects
    assert any("thigh.r" in each.message for each in found.suspicions)


def test_few_markers_have_no_residuals() -> None:
    found = examine_markers(short().mesh, tall().mesh, set_markers(*MARKED[: MIN_EXAMINED_MARKERS - 1]))
    assert found.residuals is None
    assert not found.refusal


def test_refusal_gives_the_error_of_the_registration() -> None:
    markers = set_markers(*MARKED)
    source = markers.source.copy()
    source[1] = source[0]
    found = examine_markers(short().mesh, tall().mesh, Markers(source, markers.target))
    assert found.residuals is None
    assert "two targets" in found.refusal
