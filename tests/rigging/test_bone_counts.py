"""As few bones as an error asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mixseq
from mixseq.errors import MixseqWarning
from mixseq.rigging import fit_skin
from mixseq.rigging.bone_counts import errors, fewest_bones
from mixseq.rigging.centred import Centred
from tests.rigging.test_rig_fitting import skinned_bar


@dataclass
class Fits:
    """Stands for a skin: only the number of its bones counts."""

    asked: list[int]

    def fit(self, count: int) -> Any:
        self.asked.append(count)
        return count


def search(needed: int, most: int) -> tuple[int, list[int]]:
    fits = Fits([])
    found = fewest_bones(fits.fit, lambda count: cast(int, count) >= needed, most)
    return cast(int, found), fits.asked


@given(st.integers(1, 128), st.integers(1, 128))
def test_bones_are_enough_and_at_most_a_tenth_more_than_needed(needed: int, most: int) -> None:
    found, asked = search(needed, most)
    assert found <= most
    if needed > most:
        assert found == most
    else:
        assert needed <= found <= needed + 1 + found // 10
    assert len(asked) == len(set(asked)) <= 10


@pytest.mark.slow
def test_errors_are_those_of_a_comparison() -> None:
    sequence = skinned_bar()
    skin = fit_skin(sequence, 1)
    found = mixseq.compare(sequence, skin)
    assert errors(skin, Centred.of(sequence)) == pytest.approx((found.max_error, found.kg_percent), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("max_error", "kg"), [(1e-3, None), (None, 0.1)])
def test_two_bones_are_enough_for_a_bar_of_two(max_error: float | None, kg: float | None) -> None:
    sequence = skinned_bar()
    skin = fit_skin(sequence, max_error=max_error, kg=kg)
    found = mixseq.compare(sequence, skin)
    assert found.max_error <= 1e-3 if kg is None else found.kg_percent <= 0.1
    assert skin.bone_count <= 3  # within a tenth, and one


@pytest.mark.slow
def test_what_bones_do_not_reach_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixseq.rigging.rig_fitting.MOST_BONES", 1)
    with pytest.warns(MixseqWarning, match=r"^1 bones reach an error of .* % \(KG\), not 0\.01; correctives"):
        skin = fit_skin(skinned_bar(), kg=0.01)
    assert skin.bone_count == 1
    with pytest.warns(
        MixseqWarning, match=r"^1 bones reach an error of .* diagonals, not 0\.001; correctives"
    ):
        fit_skin(skinned_bar(), max_error=0.001)
    np.testing.assert_array_equal(skin.weights[:, 0], 1)
