"""As few bones as an error asks for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mixseq
from mixseq.errors import MixseqWarning
from mixseq.rigging.bones import Centred
from mixseq.rigging.decomposition import fit_free_bones, fit_tree_skin
from mixseq.rigging.fitting import fit_fewest_bones, fit_skin
from tests.rigging.test_rig_fitting import skinned_bar


@dataclass
class Fits:
    """Stands for fits whose errors fall with the number of bones; a skin is this number."""

    needed: int
    power: float
    noise: int
    free_asked: list[int] = field(default_factory=list)
    hung_asked: list[int] = field(default_factory=list)

    def error(self, count: int) -> float:
        return float((self.needed / count) ** self.power)

    def roughly(self, count: int) -> float:
        return self.error(count) * np.random.default_rng([self.noise, count]).uniform(1, 2)

    def free(self, count: int) -> float:
        self.free_asked.append(count)
        return self.error(count) * np.random.default_rng([self.noise, count, 1]).uniform(0.85, 1.15)

    def hung(self, count: int) -> tuple[Any, float]:
        self.hung_asked.append(count)
        return count, self.error(count)


@given(st.integers(1, 128), st.integers(1, 128), st.floats(0.2, 4), st.integers(0, 1000))
def test_bones_are_enough_and_at_most_a_tenth_more_than_needed(
    needed: int, most: int, power: float, noise: int
) -> None:
    fits = Fits(needed, power, noise)
    found, error = fit_fewest_bones(fits.roughly, fits.free, fits.hung, 1.0, most)
    count = cast(int, found)
    assert error == fits.error(count)
    assert count <= most
    if needed > most:
        assert count == most
    else:
        assert needed <= count <= needed + 1 + count // 10
    for asked in (fits.free_asked, fits.hung_asked):
        assert len(asked) == len(set(asked)) <= 10


@pytest.mark.parametrize(("needed", "noise"), [(5, 0), (18, 1), (60, 2)])
def test_two_numbers_are_fitted_where_rough_fits_tell_the_truth(needed: int, noise: int) -> None:
    fits = Fits(needed, 1.5, noise)
    fit_fewest_bones(lambda count: fits.error(count) / 0.6, fits.free, fits.hung, 1.0, 128)
    assert len(fits.free_asked) <= 2
    assert len(fits.hung_asked) <= 2


def test_bones_that_are_too_far_off_are_hung_only_if_no_others_are_allowed() -> None:
    fits = Fits(40, 1.5, 0)
    assert cast(int, fit_fewest_bones(fits.roughly, fits.free, fits.hung, 1.0, 20)[0]) == 20
    assert fits.hung_asked == [20]


@pytest.mark.slow
def test_errors_are_those_of_a_comparison() -> None:
    sequence = skinned_bar()
    centred = Centred.from_sequence(sequence)
    free = fit_free_bones(centred, 1, 60, lambda _: None)
    skin, errors = fit_tree_skin(centred, free, 60, lambda _: None)
    found = mixseq.compare(sequence, skin)
    assert errors == pytest.approx((found.max_error, found.kg_percent), rel=1e-6)
    assert free.errors == pytest.approx(errors, rel=1e-3)


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
    monkeypatch.setattr("mixseq.rigging.fitting.MAX_BONES", 1)
    with pytest.warns(MixseqWarning, match=r"^1 bones reach an error of .* % \(KG\), not 0\.01; add correctives"):
        skin = fit_skin(skinned_bar(), kg=0.01)
    assert skin.bone_count == 1
    with pytest.warns(MixseqWarning, match=r"^1 bones reach an error of .* diagonals, not 0\.001; add correctives"):
        fit_skin(skinned_bar(), max_error=0.001)
    np.testing.assert_array_equal(skin.weights[:, 0], 1)


def test_bones_that_are_exact_are_as_few_as_can_be() -> None:
    found, error = fit_fewest_bones(
        lambda count: 4 / count, lambda _: 0.0, lambda count: (cast(Any, count), 0.0), 1.0, 128
    )
    assert (cast(int, found), error) == (1, 0.0)
